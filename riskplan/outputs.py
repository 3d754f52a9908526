"""The files of a result in one directory: written aside, then moved into place together."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path

from checkers import InputError
from riskplan.io import save_plan
from riskplan.io.plan_file import json_text, report_to_dict
from riskplan.io.text import write_text
from riskplan.pictures import render
from riskplan.result import Plan, Report
from riskplan.scene import Scenario


def check_folder(folder: Path) -> None:
    """Refuse, before any work is done, a directory that cannot be made or written.

    Raises:
        InputError: naming it.
    """
    there = _nearest(folder)
    if not there.is_dir():
        raise InputError(f"{folder}: cannot be a directory, as {there} is a file")
    if not os.access(there, os.W_OK | os.X_OK):
        raise InputError(f"{folder}: cannot be written")


def write_results(folder: Path, scenario: Scenario, plan: Plan, report: Report | None) -> dict[str, str]:
    """Write `plan.json`, `report.json` (if there is a report), `scene.html` and `scene.png`; returns their paths.

    Everything is written into a hidden directory beside and moved at the end: an interrupt or an error before leaves
    nothing behind.
    """
    try:
        aside = Path(tempfile.mkdtemp(prefix=".riskplan-", dir=_nearest(folder)))
        try:
            save_plan(plan, aside / "plan.json")
            if report is not None:
                write_text(aside / "report.json", json_text(report_to_dict(report)))
            render(scenario, plan, aside / "scene.html")
            render(scenario, plan, aside / "scene.png", view="top")  # the same with and without a browser
            names = sorted(p.name for p in aside.iterdir())
            folder.mkdir(parents=True, exist_ok=True)
            for name in names:
                os.replace(aside / name, folder / name)
        finally:
            shutil.rmtree(aside, ignore_errors=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error.strerror}") from None
    return {name: str(folder / name) for name in names}


def _nearest(folder: Path) -> Path:
    """The directory itself, or the first above it that is there."""
    there = folder.absolute()
    while not there.exists() and there != there.parent:
        there = there.parent
    return there
