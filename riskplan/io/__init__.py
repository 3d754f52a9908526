"""Scenes and results from and to files.

Cheap to import: every reader is imported when first used.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from checkers import InputError

if TYPE_CHECKING:
    from riskplan.result import Plan
    from riskplan.scene import Scenario

__all__ = ["SUFFIXES", "load_plan", "load_scenario", "save_plan", "save_scenario"]

SUFFIXES = (".yaml", ".yml", ".xml")


def load_scenario(path: str | Path, problem: int = 0) -> Scenario:
    """A scenario from a file; the suffix picks the format: `.yaml`, `.yml` (own), `.xml` (CommonRoad 2018b, 2020a).

    Args:
        path: file to read.
        problem: which planning problem of a CommonRoad file; a `.yaml` has one only.

    Raises:
        InputError: one line that names the file, the field, what was expected and what came.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        later = "; Argoverse .csv and .parquet cannot be read yet" if suffix in (".csv", ".parquet") else ""
        raise InputError(
            f"{path}: expected a scenario in one of {', '.join(SUFFIXES)}; got {suffix or 'no suffix'}{later}"
        )
    if suffix == ".xml":
        from riskplan.io.commonroad import load_commonroad  # noqa: PLC0415

        scene = load_commonroad(path)
        try:
            return scene.scenario(problem)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
    if problem != 0:
        raise InputError(f"problem: expected 0, as {path} has one planning problem; got {problem!r}")
    from riskplan.io.scenario_file import read_scenario  # noqa: PLC0415

    return read_scenario(path)


def save_scenario(scenario: Scenario, path: str | Path) -> None:
    """Write a scenario to a `.yaml`, complete or not at all; `load_scenario` gives the same numbers bit for bit.

    Raises:
        InputError: for another suffix, or an ego shape the format does not know.
    """
    if Path(path).suffix.lower() not in (".yaml", ".yml"):
        raise InputError(f"{path}: expected the suffix .yaml or .yml")
    from riskplan.io.scenario_text import scenario_text  # noqa: PLC0415
    from riskplan.io.text import write_text  # noqa: PLC0415

    write_text(path, scenario_text(scenario))


def load_plan(path: str | Path) -> Plan:
    """A plan from a `plan.json`, its numbers bit for bit; without the search tree, which is not stored.

    Raises:
        InputError: one line that names the file and the field.
    """
    from riskplan.io.plan_file import read_plan  # noqa: PLC0415

    return read_plan(path)


def save_plan(plan: Plan, path: str | Path) -> None:
    """Write a plan as strict JSON, complete or not at all: trajectory, risk, settings, versions; no search tree."""
    from riskplan.io.plan_file import plan_text  # noqa: PLC0415
    from riskplan.io.text import write_text  # noqa: PLC0415

    write_text(path, plan_text(plan))
