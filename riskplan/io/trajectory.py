"""Plans as trajectories for other programs: tables, and the shapes of ROS messages as JSON."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import Any

import numpy as np

from checkers import InputError
from checkers.validate import Array, as_instance, as_option, as_path, as_text
from checkers.writing import written
from riskplan.io.text import write_text
from riskplan.result import Plan

FORMATS = ("csv", "parquet", "ros-path", "autoware")
_COLUMNS = ("time", "x", "y", "heading", "speed", "acceleration", "curvature", "risk")


def save_trajectory(plan: Plan, path: str | Path, format: str | None = None, frame: str = "map") -> None:
    """Write a plan's trajectory, complete or not at all.

    "csv" and "parquet" (which needs pyarrow, the extra `data`) have the columns time [s], x, y [m], heading [rad],
    speed [m/s], acceleration [m/s²] and curvature [1/m] of the step that follows, and risk, the marginal one of the
    step summed over agents (empty without agents). "ros-path" is a `nav_msgs/Path`, "autoware" an Autoware planning
    `Trajectory`, as JSON with stamp 0; wheel angles, which a plan does not state, are 0 there.

    Args:
        plan: with a trajectory.
        path: file to write.
        format: one of `FORMATS`; None: by the suffix .csv or .parquet.
        frame: `frame_id` of the messages.

    Raises:
        InputError: for a plan without a trajectory, an unknown format, or a place that cannot be written.
    """
    as_instance("plan", plan, Plan)
    as_text("frame", frame)
    suffix = as_path("path", path).suffix.lower().lstrip(".")
    if format is None and suffix not in ("csv", "parquet"):
        raise InputError(f"{path}: expected the suffix .csv or .parquet, or a format: {', '.join(FORMATS)}")
    kind = as_option("format", suffix if format is None else format, FORMATS)
    if kind == "csv":
        return write_text(path, _csv(columns(plan)))
    if kind == "parquet":
        return _parquet(columns(plan), path)
    message = path_message(plan, frame) if kind == "ros-path" else trajectory_message(plan, frame)
    return write_text(path, json.dumps(message, allow_nan=False) + "\n")


def columns(plan: Plan) -> dict[str, Array]:
    """The table's columns (T,); risk is NaN without agents."""
    acceleration, curvature = _derived(plan)
    risk = np.full(len(plan.times), np.nan) if plan.risk is None else plan.risk.per_step
    given = (plan.times, *plan.poses.T, plan.speeds, acceleration, curvature, risk)
    return dict(zip(_COLUMNS, given, strict=True))


def path_message(plan: Plan, frame: str = "map") -> dict[str, Any]:
    """A `nav_msgs/Path` as a mapping; the stamp of each pose is its time from the start."""
    _derived(plan)
    poses = [
        {"header": {"stamp": _duration(t), "frame_id": frame}, "pose": _pose(*pose)}
        for t, pose in zip(plan.times.tolist(), plan.poses.tolist(), strict=True)
    ]
    return {"header": {"stamp": _duration(0.0), "frame_id": frame}, "poses": poses}


def trajectory_message(plan: Plan, frame: str = "map") -> dict[str, Any]:
    """An autoware_planning_msgs `Trajectory` as a mapping."""
    acceleration, curvature = _derived(plan)
    points = [
        {
            "time_from_start": _duration(t),
            "pose": _pose(*pose),
            "longitudinal_velocity_mps": speed,
            "lateral_velocity_mps": 0.0,
            "acceleration_mps2": a,
            "heading_rate_rps": speed * k,
            "front_wheel_angle_rad": 0.0,
            "rear_wheel_angle_rad": 0.0,
        }
        for t, pose, speed, a, k in zip(
            *(v.tolist() for v in (plan.times, plan.poses, plan.speeds, acceleration, curvature)), strict=True
        )
    ]
    return {"header": {"stamp": _duration(0.0), "frame_id": frame}, "points": points}


def _derived(plan: Plan) -> tuple[Array, Array]:
    """Acceleration and curvature (T,) of the step after each time; 0 at the last, and no curvature at rest.

    Raises:
        InputError: if the plan has no trajectory.
    """
    if not len(plan.times):
        raise InputError(f"plan: expected a trajectory, got status {plan.status!r}")
    steps = np.diff(plan.times)
    turn = (np.diff(plan.poses[:, 2]) + np.pi) % (2.0 * np.pi) - np.pi
    travelled = 0.5 * (plan.speeds[:-1] + plan.speeds[1:]) * steps
    curvature = np.divide(turn, travelled, out=np.zeros_like(turn), where=travelled > 1e-6)
    return np.append(np.diff(plan.speeds) / steps, 0.0), np.append(curvature, 0.0)


def _duration(seconds: float) -> dict[str, int]:
    nanoseconds = round(seconds * 1e9)
    return {"sec": nanoseconds // 1_000_000_000, "nanosec": nanoseconds % 1_000_000_000}


def _pose(x: float, y: float, heading: float) -> dict[str, Any]:
    half = 0.5 * heading
    turn = {"x": 0.0, "y": 0.0, "z": float(np.sin(half)), "w": float(np.cos(half))}
    return {"position": {"x": x, "y": y, "z": 0.0}, "orientation": turn}


def _csv(table: dict[str, Array]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table)
    for row in zip(*(c.tolist() for c in table.values()), strict=True):
        writer.writerow("" if v != v else repr(v) for v in row)
    return text.getvalue()


def _parquet(table: dict[str, Array], path: str | Path) -> None:
    try:
        import pyarrow as pa  # noqa: PLC0415
        from pyarrow import parquet  # noqa: PLC0415
    except ImportError:
        raise InputError(f"{path}: writing parquet needs pyarrow: pip install '.[data]'") from None
    with written(path) as part:
        parquet.write_table(pa.table({name: pa.array(c, from_pandas=True) for name, c in table.items()}), part)
