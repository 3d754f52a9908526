"""Scenes and results from and to files.

Cheap to import: every reader is imported when first used.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from checkers import InputError
from checkers.validate import as_count, as_instance, as_path

if TYPE_CHECKING:
    from riskplan.io.occupancy_grid import OccupancyGrid
    from riskplan.io.predictions import load_predictions as load_predictions
    from riskplan.io.solution import save_solution as save_solution
    from riskplan.io.trajectory import save_trajectory as save_trajectory
    from riskplan.result import Plan
    from riskplan.scene import Scenario

__all__ = [
    "SUFFIXES",
    "load_occupancy_grid",
    "load_plan",
    "load_predictions",
    "load_scenario",
    "save_plan",
    "save_scenario",
    "save_solution",
    "save_trajectory",
]

SUFFIXES = (".yaml", ".yml", ".xml", ".csv", ".parquet")
_LATER = {"load_predictions": "predictions", "save_solution": "solution", "save_trajectory": "trajectory"}


def __getattr__(name: str) -> Any:
    if name not in _LATER:
        raise AttributeError(f"module 'riskplan.io' has no attribute {name!r}")
    from importlib import import_module  # noqa: PLC0415

    return getattr(import_module(f"riskplan.io.{_LATER[name]}"), name)


def load_scenario(path: str | Path, problem: int = 0) -> Scenario:
    """A scenario from a file; the suffix picks the format.

    `.yaml`, `.yml` (own), `.xml` (CommonRoad 2018b, 2020a), `.csv` (Argoverse 1), `.parquet` (Argoverse 2).

    Args:
        path: file to read.
        problem: which planning problem of a CommonRoad file; the others have one only.

    Raises:
        InputError: one line that names the file, the field, what was expected and what came.
    """
    suffix = as_path("path", path).suffix.lower()
    as_count("problem", problem)
    if suffix not in SUFFIXES:
        raise InputError(f"{path}: expected a scenario in one of {', '.join(SUFFIXES)}; got {suffix or 'no suffix'}")
    if suffix == ".xml":
        from riskplan.io.commonroad import load_commonroad  # noqa: PLC0415

        scene = load_commonroad(path)
        try:
            return scene.scenario(problem)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        except Exception as error:  # geometry that the reader lets through but shapely or the scene cannot use
            text = f"{type(error).__name__}: {error}"
            raise InputError(f"{path}: not a usable CommonRoad file: {text}") from None
    if problem != 0:
        raise InputError(f"problem: expected 0, as {path} has one planning problem; got {problem!r}")
    if suffix in (".csv", ".parquet"):
        from riskplan.io.argoverse import load_argoverse  # noqa: PLC0415

        return load_argoverse(path)
    from riskplan.io.scenario_file import read_scenario  # noqa: PLC0415

    return read_scenario(path)


def load_occupancy_grid(path: str | Path, unknown: str = "occupied") -> OccupancyGrid:
    """A ROS map from its `map.yaml`; `.obstacles` are a scenario's. See `riskplan.io.occupancy_grid`.

    Args:
        path: of the `map.yaml`.
        unknown: "occupied" blocks unknown cells and all outside the map, "free" neither.

    Raises:
        InputError: one line that names the file and the field.
    """
    from riskplan.io.occupancy_grid import load_occupancy_grid as load  # noqa: PLC0415

    return load(path, unknown)


def save_scenario(scenario: Scenario, path: str | Path) -> None:
    """Write a scenario to a `.yaml`, complete or not at all; `load_scenario` gives the same numbers bit for bit.

    Raises:
        InputError: for another suffix, or an ego shape the format does not know.
    """
    from riskplan.scene import Scenario  # noqa: PLC0415

    as_instance("scenario", scenario, Scenario)
    if as_path("path", path).suffix.lower() not in (".yaml", ".yml"):
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
    from riskplan.result import Plan  # noqa: PLC0415

    write_text(path, plan_text(as_instance("plan", plan, Plan)))
