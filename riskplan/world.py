"""The static world of a scenario, packed for the compiled checks; and the exact judgement of a finished path."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from checkers.validate import Array
from riskplan.kernels import world as hot
from riskplan.scene import Scenario, State

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
        margin = np.hypot(*s.vehicle.body)
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
    def centres(self) -> BaseGeometry:
        """Where the centre may be at most, as a prepared polygon: allowed and within the bounds."""
        area: BaseGeometry = shapely.box(*self.scenario.bounds)
        if self.allowed is not None:
            area = self.allowed.intersection(area)
        shapely.prepare(area)
        return area

    @cached_property
    def lanes(self) -> Array:
        """Lane pieces, see `lane_segments`."""
        return lane_segments(self.scenario)

    @cached_property
    def packed(self) -> tuple[object, ...]:
        """What `kernels.world.path_free` reads."""
        s = self.scenario
        length, width = s.vehicle.body
        half = (0.5 * length, -1.0 if s.vehicle.disc else 0.5 * width)
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
        return bool(hot.body_free(x, y, heading, self.packed))


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

    def distances(self, points: Array) -> Array:
        """(N,) straight distances of points (N, 2) to the nearest region [m], 0 inside."""
        out = np.empty(len(points))
        hot.goal_distances(np.ascontiguousarray(points), self.start, self.vertices, self.boxes, out)
        return out

    def box_distances(self, points: Array) -> Array:
        """(N,) distances of points (N, 2) to the nearest region's bounding box [m]: never above `distances`."""
        beyond = np.maximum(self.boxes[:, :2] - points[:, None], points[:, None] - self.boxes[:, 2:])
        nearest: Array = np.hypot(*np.moveaxis(np.maximum(beyond, 0.0), -1, 0)).min(axis=1)
        return nearest

    def holds(self, x: float, y: float, heading: float, speed: float) -> bool:
        """Whether some region holds the state."""
        return bool(hot.goal_region(x, y, heading, speed, *self.arrays) >= 0)


def pack_goal(scenario: Scenario) -> PackedGoal:
    """The goal's regions as contiguous arrays; the window on the grid, within the horizon."""
    regions = scenario.goal.regions
    low, high = scenario.goal.time
    step = scenario.time_step
    start = np.concatenate([[0], np.cumsum([len(r.polygon) for r in regions])])
    vertices = np.concatenate([r.polygon for r in regions])
    ends = np.minimum.reduceat(vertices, start[:-1]), np.maximum.reduceat(vertices, start[:-1])
    return PackedGoal(
        start,
        vertices,
        np.concatenate(ends, axis=1),
        np.array([(np.nan if r.heading is None else r.heading, r.heading_tolerance, *r.speed) for r in regions]),
        int(np.ceil(low / step - 1e-6)),
        int(min(np.floor(high / step + 1e-6), scenario.steps)),
    )


def goal_reachable(scenario: Scenario, world: StaticWorld, goal: PackedGoal) -> bool:
    """Whether some part of a goal region is inside the bounds and, as far as the centre goes, allowed."""
    corners = goal.vertices[goal.start[:-1]]  # of a region: one that is allowed answers for all
    if shapely.contains_xy(world.centres, corners[:, 0], corners[:, 1]).any():
        return True
    regions = [shapely.Polygon(r.polygon) for r in scenario.goal.regions]
    return bool(shapely.intersects(world.centres, regions).any())


def goal_too_far(scenario: Scenario, goal: PackedGoal) -> bool:
    """Whether no goal region can be reached by full acceleration within the time window, by straight distance."""
    s, v = scenario.start, scenario.vehicle
    time = min(scenario.goal.time[1], float(scenario.horizon or 0.0))
    speed = abs(s.speed)
    top = max(v.top_speed, speed)
    ramp = min(time, max(v.top_speed - speed, 0.0) / v.top_acceleration)
    reach = speed * ramp + 0.5 * v.top_acceleration * ramp**2 + top * (time - ramp)
    return float(goal.distances(np.array([[s.x, s.y]]))[0]) > reach + 1e-6


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
