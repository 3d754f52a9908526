"""CommonRoad XML files (2018b and 2020a) to tracks, through commonroad-io (the extra `commonroad`).

Files are untrusted. `predictor.check_commonroad` sees them first: no document type declaration, so no entity is ever
expanded, and no numbers that the reader would loop over or fill the memory with. What was checked is what is read.
"""

from __future__ import annotations

import contextlib
import io
import logging
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from checkers.validate import Array, InputError
from predictor.check_commonroad import checked_content
from predictor.lanes import Lane
from predictor.tracks import Track


def open_commonroad(path: str | Path) -> tuple[Any, Any]:
    """The commonroad-io (Scenario, PlanningProblemSet) of a file, read quietly.

    Raises:
        InputError: one line that names the file: missing, malformed, not CommonRoad, or no commonroad-io.
    """
    content = checked_content(path)
    with _quiet():
        try:
            from commonroad.common.file_reader import CommonRoadFileReader  # noqa: PLC0415 (an extra)
        except ImportError:
            raise InputError(
                f"{path}: reading CommonRoad files needs commonroad-io: pip install '.[commonroad]' in the checkout"
            ) from None
        try:
            scenario, problems = CommonRoadFileReader(content).open()  # bytes are parsed as they are
        except Exception as error:  # whatever the reader trips over, the file is the cause
            raise InputError(f"{path}: not a readable CommonRoad file: {one_line(error)}") from None
    return scenario, problems


def load_tracks(path: str | Path) -> tuple[Track, ...]:
    """The dynamic obstacles of a file as tracks."""
    scenario, _ = open_commonroad(path)
    return tracks_of(scenario, path)


def tracks_of(scenario: Any, path: str | Path) -> tuple[Track, ...]:
    """The dynamic obstacles of a commonroad-io scenario; without a trajectory, their initial state only."""
    tracks = []
    for obstacle in scenario.dynamic_obstacles:
        trajectory = getattr(obstacle.prediction, "trajectory", None)
        states = [obstacle.initial_state, *(trajectory.state_list if trajectory is not None else ())]
        try:
            tracks.append(_track(obstacle, states, float(scenario.dt)))
        except (InputError, AttributeError, TypeError, ValueError) as error:
            raise InputError(f"{path}: obstacle {obstacle.obstacle_id}: {one_line(error)}") from None
    return tuple(tracks)


def lanes_of(scenario: Any, path: str | Path) -> tuple[Lane, ...]:
    """The lanelets of a commonroad-io scenario."""
    lanes = []
    for lanelet in scenario.lanelet_network.lanelets:
        left = (lanelet.adj_left, lanelet.adj_left_same_direction)
        right = (lanelet.adj_right, lanelet.adj_right_same_direction)
        try:
            lane = Lane(
                str(lanelet.lanelet_id),
                lanelet.center_vertices,
                lanelet.left_vertices,
                lanelet.right_vertices,
                tuple(str(s) for s in lanelet.successor),
                tuple(str(name) for name, same in (left, right) if name is not None and same),
            )
        except InputError as error:
            raise InputError(f"{path}: lanelet {lanelet.lanelet_id}: {error}") from None
        lanes.append(lane)
    return tuple(lanes)


def number(value: Any) -> float:
    """A value that may be given as an interval: its middle."""
    return 0.5 * (float(value.start) + float(value.end)) if hasattr(value, "start") else float(value)


def point(value: Any) -> Array:
    """A position (2,) [m] that may be given as an area: its centroid."""
    area = getattr(value, "shapely_object", None)
    return np.asarray(value if area is None else area.centroid.coords[0], dtype=float)


def body_size(shape: Any) -> tuple[float, float]:
    """(length, width) [m] of an obstacle's shape; of the bounding rectangle if it is not one."""
    for names in (("length", "width"), ("total_length", "width")):
        if all(hasattr(shape, name) for name in names):
            return float(getattr(shape, names[0])), float(getattr(shape, names[1]))
    if hasattr(shape, "radius"):
        return 2.0 * float(shape.radius), 2.0 * float(shape.radius)
    outline = getattr(shape, "shapely_object", None)
    outline = getattr(shape, "polygon", None) if outline is None else outline
    x_min, y_min, x_max, y_max = outline.bounds if outline is not None else _vertex_bounds(shape)
    # about the position, not about the outline's own middle: the rectangle is centred where the track is
    return 2.0 * float(max(x_max, -x_min)), 2.0 * float(max(y_max, -y_min))


def one_line(error: BaseException) -> str:
    """What went wrong, on one line."""
    text = " ".join(str(error).split())
    kind = type(error).__name__
    return text if isinstance(error, InputError) else f"{kind}: {text}" if text else kind


def _vertex_bounds(shape: Any) -> tuple[float, float, float, float]:
    vertices = np.asarray(shape.vertices, dtype=float)
    (x_min, y_min), (x_max, y_max) = vertices.min(axis=0), vertices.max(axis=0)
    return x_min, y_min, x_max, y_max


def _track(obstacle: Any, states: list[Any], dt: float) -> Track:
    length, width = body_size(obstacle.obstacle_shape)
    steps = np.array([number(s.time_step) for s in states])
    # some writers repeat the initial state as the trajectory's first
    kept = np.concatenate([[True], np.diff(steps) > 0])
    states = [s for s, keep in zip(states, kept, strict=True) if keep]
    return Track(
        name=str(obstacle.obstacle_id),
        times=steps[kept] * dt,
        positions=np.array([point(s.position) for s in states]),
        headings=np.array([number(s.orientation) for s in states]),
        speeds=np.array([number(s.velocity) for s in states]),
        length=length,
        width=width,
        kind=str(obstacle.obstacle_type.value),
    )


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """commonroad-io prints, warns and logs about old formats; none of it concerns the caller."""
    logger = logging.getLogger("commonroad")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)
