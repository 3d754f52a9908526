"""The own scenario format, read: YAML to `Scenario`. `scenario.schema.json` documents every field."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

import numpy as np

from checkers import (
    ControlPrediction,
    EgoBox,
    EgoCover,
    EgoEllipsoid,
    EgoShape,
    GaussianMixturePrediction,
    InputError,
    MomentPrediction,
    load_prediction,
)
from checkers.control_document import prediction
from checkers.validate import Array
from riskplan.io import load_occupancy_grid
from riskplan.io.schema import check_document
from riskplan.io.text import numbers, read_bytes
from riskplan.io.yaml_text import parse_yaml
from riskplan.scene import Agent, Goal, GoalRegion, Scenario, State
from riskplan.vehicles import Vehicle, vehicle_class


def read_scenario(path: str | Path) -> Scenario:
    """The scenario in a `.yaml` file.

    Raises:
        InputError: one line: the file, the field, what was expected and what came.
    """
    document = parse_yaml(read_bytes(path), str(path))
    try:
        check_document(document)
        return scenario_of(document, Path(path).parent)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def scenario_of(document: dict[str, Any], folder: Path) -> Scenario:
    """The scenario of a document that fits the schema; agents' files are looked up in `folder`."""
    d = document
    keys = ("bounds", "time_step", "horizon", "drivable", "lanes", "name")
    given: dict[str, Any] = {key: d[key] for key in keys if key in d}
    if "obstacles" in d:
        given["obstacles"] = _obstacles(d["obstacles"], folder)
    if "ego" in d:
        given["ego"] = _ego(d["ego"])
    return Scenario(
        start=State(**d["start"]),
        goal=_goal(d["goal"]),
        agents=tuple(_agent(i, a, folder) for i, a in enumerate(d.get("agents", ()))),
        vehicle=_vehicle(d.get("vehicle", {})),
        **given,
    )


def _obstacles(d: list[Any] | dict[str, Any], folder: Path) -> Sequence[Any]:
    if isinstance(d, list):
        return d
    if not _inside(d["map"]) or not d["map"].endswith((".yaml", ".yml")):
        raise InputError(f"obstacles.map: expected a .yaml in the scenario's directory or below, got {d['map']!r}")
    grid = load_occupancy_grid(folder / d["map"], d.get("unknown", "occupied"))
    return [*grid.obstacles, *d.get("polygons", ())]


def _inside(name: str) -> bool:
    """Whether a path stays in the directory it is relative to."""
    return not (PurePosixPath(name).is_absolute() or PureWindowsPath(name).drive or ".." in Path(name).parts)


def _vehicle(d: dict[str, Any]) -> Vehicle:
    name = d.get("type", "car")
    cls = vehicle_class(name)
    valid = [f.name for f in fields(cls)]  # type: ignore[arg-type]  # every vehicle is a dataclass
    for key in d:
        if key not in ("type", *valid):
            raise InputError(f"vehicle.{key}: unknown key of a {name}; expected one of type, {', '.join(valid)}")
    return cls(**{key: value for key, value in d.items() if key != "type"})


def _goal(d: dict[str, Any]) -> Goal:
    regions = tuple(_region(f"goal.regions[{i}]", r) for i, r in enumerate(d["regions"]))
    return Goal(regions, **({"time": tuple(d["time"])} if "time" in d else {}))


def _region(where: str, d: dict[str, Any]) -> GoalRegion:
    terms: dict[str, Any] = {key: d[key] for key in ("heading", "heading_tolerance") if key in d}
    if "speed" in d:
        terms["speed"] = tuple(d["speed"])
    try:
        if "circle" in d:
            return Goal.at(**d["circle"], **terms).regions[0]
        return GoalRegion(_box(d["box"]) if "box" in d else d["polygon"], **terms)
    except InputError as error:
        raise InputError(f"{where}.{str(error).removeprefix('goal.')}") from None


def _box(bounds: list[float]) -> Array:
    x0, y0, x1, y1 = bounds
    if not (x0 < x1 and y0 < y1):
        raise InputError(f"box: expected x_min < x_max and y_min < y_max, got {bounds}")
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], dtype=float)


def _ego(d: dict[str, Any]) -> EgoShape:
    (kind, values), *_ = d.items()
    try:
        if kind == "discs":
            return EgoCover.discs(**{**values, "n": int(values.get("n", 6))})
        if kind == "box":
            return EgoBox(**values)
        if kind == "aligned":
            return EgoEllipsoid.aligned(**values)
        return EgoEllipsoid(values["Q"]) if "Q" in values else EgoEllipsoid.around(**values)
    except InputError as error:
        raise InputError(f"ego.{kind}.{error}") from None


_CLASSES: dict[str, Callable[..., Agent]] = {
    "gaussian": GaussianMixturePrediction,
    "moments": MomentPrediction,
}


def _agent(index: int, d: dict[str, Any], folder: Path) -> Agent:
    name = f" ({d['name']})" if d.get("name") else ""
    labels: dict[str, Any] = {key: d[key] for key in ("name", "length", "width") if key in d}
    try:
        labels |= {key: numbers(key, d[key]) for key in ("headings", "factors") if key in d}
        if "file" in d or "controls" in d:
            found = _from_file(d["file"], folder) if "file" in d else prediction(d["controls"])
            for key in ("headings", "factors"):
                if isinstance(found, ControlPrediction) and key in labels:
                    raise InputError(f"{key}: expected none for an agent known by its controls, which say it all")
            return replace(found, **labels)
        kind = "gaussian" if "gaussian" in d else "moments"
        values = {key: v if key == "modes" else _array(key, v) for key, v in d[kind].items()}
        agent: Agent = _CLASSES[kind](**values, **labels)
        return agent
    except InputError as error:
        raise InputError(f"agents[{index}]{name}: {error}") from None


def _array(key: str, value: Any) -> Array:
    if key == "times" and isinstance(value, dict):
        grid: Array = value.get("start", 0.0) + value["step"] * np.arange(int(value["count"]))
        return grid
    return numbers(key, value)


def _from_file(name: str, folder: Path) -> Agent:
    if not _inside(name) or not name.endswith(".npz"):
        raise InputError(f"file: expected an .npz in the scenario's directory or below, got {name!r}")
    return load_prediction(folder / name)
