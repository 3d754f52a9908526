"""The own scenario format, written: `Scenario` to YAML that reads back bit for bit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from checkers import EgoCover, EgoEllipsoid, GaussianMixturePrediction, InputError
from checkers.validate import Array
from riskplan.io.yaml_text import number_text, quoted
from riskplan.scene import Agent, Goal, GoalRegion, Scenario


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
        f"start: {_record(s.start)}",
        f"vehicle: {_record(s.vehicle)}",
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
    raise InputError(f"ego: expected an EgoEllipsoid or an EgoCover to write, got {type(shape).__name__}")


def _agent(agent: Agent) -> list[str]:
    gaussian = isinstance(agent, GaussianMixturePrediction)
    last = "covariances" if gaussian else "central_moments"
    lines = [f"  - name: {quoted(agent.name)}"]
    for name in ("length", "width"):
        if getattr(agent, name) is not None:
            lines.append(f"    {name}: {number_text(getattr(agent, name))}")
    if agent.headings is not None:
        lines += ["    headings:", *(f"      - {_flow(row)}" for row in agent.headings)]
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


def _record(value: Any) -> str:
    """A flat dataclass; fields that are None are left out."""
    given = {f.name: getattr(value, f.name) for f in fields(value)}
    return "{" + ", ".join(f"{k}: {number_text(v)}" for k, v in given.items() if v is not None) + "}"


def _block(name: str, items: Sequence[str]) -> list[str]:
    return [f"{name}:", *(f"  - {item}" for item in items)] if items else []


def _flow(value: Any) -> str:
    """Nested numbers in brackets; NaN, which stands for an entry that is not there, as null."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_flow, value)) + "]"
    return "null" if value != value else number_text(value)
