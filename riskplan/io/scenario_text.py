"""The own scenario format, written: `Scenario` to YAML that reads back bit for bit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from checkers import ControlPrediction, EgoBox, EgoCover, EgoEllipsoid, GaussianMixturePrediction, InputError
from checkers.control_document import document
from checkers.shapes import AlignedEllipsoid
from checkers.validate import Array
from riskplan.io.yaml_text import number_text, quoted
from riskplan.scene import Agent, Goal, GoalRegion, Scenario
from riskplan.vehicles import Vehicle


def scenario_text(scenario: Scenario) -> str:
    """The scenario as a YAML document.

    Raises:
        InputError: for an ego shape the format does not know.
    """
    s = scenario
    lines = ["# riskplan scenario; units m, s, rad", "version: 1"]
    if s.name:
        lines.append(f"name: {quoted(s.name)}")
    lines += [
        f"time_step: {number_text(s.time_step)}",
        f"horizon: {number_text(float(s.horizon or 0.0))}",
        f"bounds: {_flow(s.bounds)}",
        f"start: {_record(s.start, () if s.start.steering else ('steering',))}",
        f"vehicle: {_vehicle(s.vehicle)}",
        f"ego: {_ego(s.ego)}",
        *_goal(s.goal),
    ]
    for name in ("obstacles", "drivable", "lanes"):
        lines += _block(name, [_flow(points) for points in getattr(s, name)])
    lines += ["agents:"] if s.agents else []
    for agent in s.agents:
        lines += _agent(agent)
    return "\n".join(lines) + "\n"


def _goal(goal: Goal) -> list[str]:
    return [
        "goal:",
        f"  time: {_flow(goal.time)}",
        "  regions:",
        *(line for r in goal.regions for line in _region(r)),
    ]


def _region(region: GoalRegion) -> list[str]:
    lines = [f"    - polygon: {_flow(region.polygon)}"]
    if region.heading is not None:
        lines.append(f"      heading: {number_text(region.heading)}")
    lines.append(f"      heading_tolerance: {number_text(region.heading_tolerance)}")
    lines.append(f"      speed: {_flow(region.speed)}")
    return lines


def _ego(shape: Any) -> str:
    if isinstance(shape, EgoEllipsoid):
        return f"{{ellipsoid: {{Q: {_flow(shape.Q)}}}}}"
    if isinstance(shape, EgoCover):
        return f"{{discs: {_record(shape)}}}"
    if isinstance(shape, EgoBox | AlignedEllipsoid):
        return f"{{{'box' if isinstance(shape, EgoBox) else 'aligned'}: {_record(shape)}}}"
    raise InputError(f"ego: expected an EgoEllipsoid, EgoCover or EgoBox to write, got {type(shape).__name__}")


def _agent(agent: Agent) -> list[str]:
    lines = [f"  - name: {quoted(agent.name)}"]
    for name in ("length", "width"):
        if getattr(agent, name) is not None:
            lines.append(f"    {name}: {number_text(getattr(agent, name))}")
    if isinstance(agent, ControlPrediction):
        return [*lines, "    controls:", *(f"      {k}: {_flow(v)}" for k, v in document(agent).items())]
    gaussian = isinstance(agent, GaussianMixturePrediction)
    last = "covariances" if gaussian else "central_moments"
    for name in ("headings", "factors"):
        if getattr(agent, name) is not None:
            lines += [f"    {name}:", *(f"      - {_flow(row)}" for row in getattr(agent, name))]
    lines += [f"    {'gaussian' if gaussian else 'moments'}:", f"      times: {_times(agent.times)}"]
    lines += [f"      modes: {agent.modes}", f"      weights: {_flow(agent.weights)}"]
    for name in ("means", last):
        lines += [f"      {name}:", *(f"        - {_flow(row)}" for row in getattr(agent, name))]
    return lines


def _times(times: Array) -> str:
    if len(times) > 2:
        start, step = float(times[0]), float(times[1] - times[0])
        if np.array_equal(start + step * np.arange(len(times)), times):
            return f"{{start: {number_text(start)}, step: {number_text(step)}, count: {len(times)}}}"
    return _flow(times)


def _vehicle(vehicle: Vehicle) -> str:
    """Its fields, and its type if that is not the one of old files."""
    record = _record(vehicle)
    return record if vehicle.type == "car" else f"{{type: {vehicle.type}, {record[1:]}"


def _record(value: Any, without: Sequence[str] = ()) -> str:
    """A flat dataclass; fields that are None are left out."""
    given = {f.name: getattr(value, f.name) for f in fields(value) if f.name not in without}
    return "{" + ", ".join(f"{k}: {number_text(v)}" for k, v in given.items() if v is not None) + "}"


def _block(name: str, items: Sequence[str]) -> list[str]:
    return [f"{name}:", *(f"  - {item}" for item in items)] if items else []


def _flow(value: Any) -> str:
    """Nested numbers and text in brackets; NaN, which stands for an entry that is not there, as null."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_flow, value)) + "]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{quoted(k)}: {_flow(v)}" for k, v in value.items()) + "}"
    if isinstance(value, str):
        return quoted(value)
    return "null" if value != value else number_text(value)
