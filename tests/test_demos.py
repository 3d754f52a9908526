"""The demos run and keep their bounds."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


@pytest.mark.slow
@pytest.mark.parametrize("name", ["smoothing", "mppi", "sampling_planner", "own_ompl"])
def test_demo_keeps_its_bound(name):
    source = ROOT / "demos" / f"{name}.py"
    assert len(source.read_text().splitlines()) <= 100
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    run = subprocess.run(
        [sys.executable, str(source)],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    assert "within True" in run.stdout
    assert "drivable False" not in run.stdout
