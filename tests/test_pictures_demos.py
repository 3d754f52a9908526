"""Every demo runs, within its time, and leaves pictures."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

DEMOS = Path(__file__).parent.parent / "demos"
PICTURED = sorted(
    path.stem for path in DEMOS.glob("*.py") if '"out/demos' in path.read_text() and path.stem != "gallery"
)


@pytest.mark.parametrize("name", PICTURED)
def test_demos_are_one_short_file(name):
    assert len((DEMOS / f"{name}.py").read_text().splitlines()) <= 100


@pytest.mark.slow
@pytest.mark.parametrize("name", PICTURED)
def test_every_demo_draws(name, tmp_path):
    (tmp_path / "riskplan").symlink_to(DEMOS.parent / "riskplan")
    environment = {**os.environ, "PYTHONPATH": str(DEMOS.parent)}
    run = subprocess.run(
        [sys.executable, DEMOS / f"{name}.py"],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        timeout=300,
        text=True,
    )
    assert run.returncode == 0, run.stderr
    drawn = list((tmp_path / "out" / "demos").iterdir())
    assert drawn
    assert all(path.stat().st_size > 10_000 for path in drawn)
