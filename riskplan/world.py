"""The static world of a scenario, packed for the compiled checks; and the exact judgement of a finished path."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from checkers.validate import Array
from riskplan.kernels import world as hot
from riskplan.scene import GoalRegion, Scenario, State

_CELL = 2.0
_MOST_CELLS = 250_000
# the grid is shifted so that the middle of no cell lies on an edge with round coordinates, where "inside" is ambiguous
_SHIFT = np.array([0.381966011250105, 0.236067977499790])


@dataclass(frozen=True, eq=False)
class StaticWorld:
    """Bounds, obstacles and drivable area around a body that turns with the heading."""

    scenario: Scenario

    @cached_property
    def allowed(self) -> BaseGeometry | None:
        """Where the body may be, as a polygon; None: everywhere within the bounds."""
        s = self.scenario
        if not s.drivable and not s.obstacles:
            return None
        # the body reaches over the bounds of its centre
        margin = np.hypot(s.vehicle.length, s.vehicle.width)
        box = shapely.box(*s.bounds).buffer(margin, join_style="mitre")
        area: BaseGeometry = box
        if s.drivable:
            # buffering there and back closes hairline gaps between neighbouring polygons
            union = shapely.union_all([shapely.Polygon(p).buffer(1e-2) for p in s.drivable]).buffer(-1e-2)
            area = union.intersection(box)
        if s.obstacles:
            area = area.difference(shapely.union_all([shapely.Polygon(p).buffer(0) for p in s.obstacles]))
        # touching shapes leave points and lines behind, which have no inside
        return shapely.union_all([part for part in shapely.get_parts(area) if part.geom_type == "Polygon"])

    @cached_property
    def packed(self) -> tuple[object, ...]:
        """Arguments of `kernels.world.body_free` after the pose."""
        s = self.scenario
        half = (0.5 * s.vehicle.length, 0.5 * s.vehicle.width)
        bounds = np.array(s.bounds)
        segments = _boundary(self.allowed)
        if not len(segments):
            free = self.allowed is None
            empty = np.zeros(0, np.int64)
            return (*half, bounds, bounds[:2], 1.0, 0, 0, empty, empty, segments, np.array([free]))
        extent = bounds[2:] - bounds[:2]
        cell = max(_CELL, float(np.sqrt(extent.prod() / _MOST_CELLS)))
        origin = bounds[:2] - cell * _SHIFT
        cells = np.ceil(extent / cell).astype(int) + 2
        # whatever a body centred in a cell, or the line from there to the middle of the cell, can touch
        reach = max(float(np.hypot(*half)), cell)
        start, items = hot.bucket_segments(segments, origin, cell, int(cells[0]), int(cells[1]), reach)
        middles = origin + (np.stack(np.meshgrid(*map(np.arange, cells), indexing="ij"), -1) + 0.5) * cell
        shapely.prepare(self.allowed)
        inside = shapely.contains_xy(self.allowed, middles[..., 0].ravel(), middles[..., 1].ravel())
        return (*half, bounds, origin, cell, int(cells[0]), int(cells[1]), start, items, segments, inside)

    def free(self, x: float, y: float, heading: float) -> bool:
        """Whether the body at the pose lies within bounds and drivable area and off every obstacle."""
        return bool(hot.body_free(x, y, heading, *self.packed))


@dataclass(frozen=True, eq=False)
class PackedGoal:
    """The goal as the kernels read it, and its window in steps."""

    start: np.ndarray
    vertices: Array
    boxes: Array
    terms: Array
    earliest: int
    latest: int

    @property
    def arrays(self) -> tuple[np.ndarray, Array, Array, Array]:
        """Arguments of `kernels.world.goal_region` after the state."""
        return self.start, self.vertices, self.boxes, self.terms

    def holds(self, x: float, y: float, heading: float, speed: float) -> bool:
        """Whether some region holds the state."""
        return bool(hot.goal_region(x, y, heading, speed, *self.arrays) >= 0)


def pack_goal(scenario: Scenario) -> PackedGoal:
    """The goal's regions as contiguous arrays; the window on the grid, within the horizon."""
    regions = scenario.goal.regions
    low, high = scenario.goal.time
    step = scenario.time_step
    return PackedGoal(
        np.concatenate([[0], np.cumsum([len(r.polygon) for r in regions])]),
        np.concatenate([r.polygon for r in regions]),
        np.array([[*r.polygon.min(axis=0), *r.polygon.max(axis=0)] for r in regions]),
        np.array([[np.nan if r.heading is None else r.heading, r.heading_tolerance, *r.speed] for r in regions]),
        int(np.ceil(low / step - 1e-6)),
        int(min(np.floor(high / step + 1e-6), scenario.steps)),
    )


def reachable_regions(scenario: Scenario, world: StaticWorld) -> list[GoalRegion]:
    """Goal regions of which some part is inside the bounds and, as far as the centre goes, allowed."""
    area: BaseGeometry = shapely.box(*scenario.bounds)
    if world.allowed is not None:
        area = world.allowed.intersection(area)
    return [r for r in scenario.goal.regions if area.intersects(shapely.Polygon(r.polygon).buffer(0))]


def goal_too_far(scenario: Scenario) -> bool:
    """Whether no goal region can be reached by full acceleration within the time window, by straight distance."""
    s, v = scenario.start, scenario.vehicle
    time = min(scenario.goal.time[1], float(scenario.horizon or 0.0))
    top = max(v.max_speed, s.speed)
    ramp = min(time, max(v.max_speed - s.speed, 0.0) / v.max_acceleration)
    reach = s.speed * ramp + 0.5 * v.max_acceleration * ramp**2 + top * (time - ramp)
    here = shapely.Point(s.x, s.y)
    return all(here.distance(shapely.Polygon(r.polygon).buffer(0)) > reach + 1e-6 for r in scenario.goal.regions)


def start_is_free(world: StaticWorld, start: State) -> bool:
    """Whether the body at the start is allowed."""
    return world.free(start.x, start.y, start.heading)


def lane_segments(scenario: Scenario) -> Array:
    """(E, 6) lane pieces near the bounds, as `kernels.car.lane_frame` reads them."""
    rows = []
    b = scenario.bounds
    for lane in scenario.lanes:
        d = np.diff(lane, axis=0)
        length = np.hypot(d[:, 0], d[:, 1])
        low, high = np.minimum(lane[:-1], lane[1:]), np.maximum(lane[:-1], lane[1:])
        margin = 10.0
        near = (high > np.array(b[:2]) - margin).all(axis=1) & (low < np.array(b[2:]) + margin).all(axis=1)
        keep = near & (length > 1e-6)
        d, length = d[keep], length[keep]
        rows.append(np.column_stack([lane[:-1][keep], d / length[:, None], length, np.arctan2(d[:, 1], d[:, 0])]))
    return np.ascontiguousarray(np.concatenate(rows)) if rows else np.zeros((0, 6))


def _boundary(area: BaseGeometry | None) -> Array:
    """(E, 4) boundary segments, none longer than two cells."""
    if area is None or area.is_empty:
        return np.zeros((0, 4))
    lines = shapely.get_parts(shapely.segmentize(area.boundary, 2 * _CELL))
    rows = []
    for line in lines:
        points = shapely.get_coordinates(line)
        rows.append(np.hstack([points[:-1], points[1:]]))
    return np.ascontiguousarray(np.concatenate(rows)) if rows else np.zeros((0, 4))
