"""What is planned for: start, goal, bounds, static world, vehicle, agents. Frozen values, checked on construction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from checkers import EgoCover, EgoShape, GaussianMixturePrediction, InputError, MomentPrediction
from checkers.validate import Array, as_array, as_scalar

if TYPE_CHECKING:
    from riskplan.world import StaticWorld

Agent = GaussianMixturePrediction | MomentPrediction


@dataclass(frozen=True)
class State:
    """Pose and speed of the ego's centre: x, y [m], heading [rad], speed [m/s] ≥ 0."""

    x: float
    y: float
    heading: float
    speed: float = 0.0

    def __post_init__(self) -> None:
        for name in ("x", "y", "heading"):
            object.__setattr__(self, name, as_scalar(f"start.{name}", getattr(self, name)))
        object.__setattr__(self, "speed", as_scalar("start.speed", self.speed, low=0.0))


@dataclass(frozen=True, eq=False)
class GoalRegion:
    """A place to arrive at.

    Attributes:
        polygon: (N, 2) vertices the centre must lie within [m].
        heading: wanted heading [rad], or None for any.
        heading_tolerance: largest deviation from it [rad].
        speed: (lowest, highest) [m/s].
    """

    polygon: Array
    heading: float | None = None
    heading_tolerance: float = np.pi
    speed: tuple[float, float] = (0.0, np.inf)

    def __post_init__(self) -> None:
        object.__setattr__(self, "polygon", _simple_polygon("goal.polygon", self.polygon))
        if self.heading is not None:
            object.__setattr__(self, "heading", as_scalar("goal.heading", self.heading))
        tolerance = as_scalar("goal.heading_tolerance", self.heading_tolerance, low=0.0)
        object.__setattr__(self, "heading_tolerance", tolerance)
        object.__setattr__(self, "speed", _interval("goal.speed", self.speed))


@dataclass(frozen=True, eq=False)
class Goal:
    """Any of several regions, reached at a time within the window.

    Attributes:
        regions: at least one `GoalRegion`.
        time: (earliest, latest) arrival [s] from the start.
    """

    regions: tuple[GoalRegion, ...]
    time: tuple[float, float] = (0.0, np.inf)

    def __post_init__(self) -> None:
        regions = tuple(self.regions)
        if not regions or not all(isinstance(r, GoalRegion) for r in regions):
            raise InputError(f"goal.regions: expected at least one GoalRegion, got {self.regions!r}")
        object.__setattr__(self, "regions", regions)
        object.__setattr__(self, "time", _interval("goal.time", self.time))

    @classmethod
    def at(
        cls,
        x: float,
        y: float,
        *,
        radius: float = 2.0,
        heading: float | None = None,
        heading_tolerance: float = np.pi,
        speed: tuple[float, float] = (0.0, np.inf),
        time: tuple[float, float] = (0.0, np.inf),
    ) -> Goal:
        """A disc about (x, y), as the 32-gon inscribed in it."""
        angle = 2 * np.pi * np.arange(32) / 32
        centre = [as_scalar("goal.x", x), as_scalar("goal.y", y)]
        ring = np.column_stack([np.cos(angle), np.sin(angle)]) * as_scalar("goal.radius", radius, low=0.0, strict=True)
        return cls((GoalRegion(ring + centre, heading, heading_tolerance, speed),), time)


@dataclass(frozen=True)
class KinematicCar:
    """Size and limits of the ego: a point moving along its heading with bounded acceleration and curvature.

    Attributes:
        length, width: of the body, for static obstacles and pictures [m].
        max_acceleration, max_deceleration: [m/s²], both positive.
        max_curvature: [1/m].
        max_speed: [m/s].
        max_lateral_acceleration: limit of speed² × curvature [m/s²].
    """

    length: float = 4.5
    width: float = 1.8
    max_acceleration: float = 4.0
    max_deceleration: float = 8.0
    max_curvature: float = 0.2
    max_speed: float = 40.0
    max_lateral_acceleration: float = 5.0

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            object.__setattr__(self, name, as_scalar(f"vehicle.{name}", getattr(self, name), low=0.0, strict=True))


@dataclass(frozen=True, eq=False)
class Scenario:
    """One planning problem on the time grid 0, time_step, …, horizon.

    Attributes:
        start: where the ego is at time 0.
        goal: where it shall be.
        bounds: (x_min, y_min, x_max, y_max) of the centre [m].
        obstacles: polygons (N, 2) the body must not touch.
        agents: predictions; each must cover the grid from its second time on (time 0 too, if it shall count there).
        ego: shape for the risk; None: `default_ego`.
        vehicle: limits and body of the ego.
        time_step: of the planning grid [s].
        horizon: latest arrival [s], a whole number of steps; None: as long as the agents are predicted.
        drivable: polygons (N, 2) whose union the body must stay in; empty: everywhere.
        lanes: centre lines (N, 2) in driving direction; a hint to the planners and for pictures.
        name: label.

    Raises:
        InputError: naming the field; also for a start outside the bounds.
    """

    start: State
    goal: Goal
    bounds: tuple[float, float, float, float]
    obstacles: tuple[Array, ...] = ()
    agents: tuple[Agent, ...] = ()
    ego: EgoShape = None  # type: ignore[assignment]  # replaced on construction
    vehicle: KinematicCar = field(default_factory=KinematicCar)
    time_step: float = 0.1
    horizon: float | None = None
    drivable: tuple[Array, ...] = ()
    lanes: tuple[Array, ...] = ()
    name: str = ""

    def __post_init__(self) -> None:
        put = object.__setattr__
        for name, cls in (("start", State), ("goal", Goal), ("vehicle", KinematicCar)):
            if not isinstance(getattr(self, name), cls):
                raise InputError(f"{name}: expected a {cls.__name__}, got {getattr(self, name)!r}")
        bounds = tuple(float(b) for b in as_array("bounds", self.bounds, (4,)))
        if bounds[0] >= bounds[2] or bounds[1] >= bounds[3]:
            raise InputError(f"bounds: expected x_min < x_max and y_min < y_max, got {list(bounds)}")
        put(self, "bounds", bounds)
        s = self.start
        if not (bounds[0] <= s.x <= bounds[2] and bounds[1] <= s.y <= bounds[3]):
            raise InputError(f"start: ({s.x:g}, {s.y:g}) lies outside the bounds {list(bounds)}")
        for name in ("obstacles", "drivable"):
            check = _simple_polygon if name == "obstacles" else _polygon
            put(self, name, tuple(check(f"{name}[{i}]", p) for i, p in enumerate(getattr(self, name))))
        put(self, "lanes", tuple(_line(f"lanes[{i}]", p) for i, p in enumerate(self.lanes)))
        agents = tuple(self.agents)
        for i, agent in enumerate(agents):
            if not isinstance(agent, GaussianMixturePrediction | MomentPrediction):
                raise InputError(f"agents[{i}]: expected a prediction, got {type(agent).__name__}")
        put(self, "agents", agents)
        put(self, "time_step", as_scalar("time_step", self.time_step, low=1e-3))
        put(self, "horizon", self._checked_horizon())
        put(self, "ego", self.ego if self.ego is not None else default_ego(self.vehicle))

    @cached_property
    def world(self) -> StaticWorld:
        """The static world, packed for collision checks on first use."""
        from riskplan.world import StaticWorld  # noqa: PLC0415  numba and shapely cost import time

        return StaticWorld(self)

    def with_agents(self, agents: Sequence[Agent]) -> Scenario:
        """The same scene with other agents or predictions; the packed static world is shared."""
        other = replace(self, agents=tuple(agents))
        if "world" in self.__dict__:
            other.__dict__["world"] = self.__dict__["world"]
        return other

    def _checked_horizon(self) -> float:
        ends = [float(a.times[-1]) for a in self.agents]
        if self.horizon is None and not ends:
            raise InputError("horizon: expected a number, as there are no agents to take it from")
        wanted = min(ends) if self.horizon is None else as_scalar("horizon", self.horizon)
        steps = int(np.floor(wanted / self.time_step + 1e-6))
        if steps < 1:
            raise InputError(f"horizon: expected at least one step of {self.time_step:g} s, got {wanted:g} s")
        if self.horizon is not None and abs(steps * self.time_step - wanted) > 1e-6:
            raise InputError(f"horizon: expected a whole number of steps of {self.time_step:g} s, got {wanted:g} s")
        for i, agent in enumerate(self.agents):
            if agent.times[-1] < steps * self.time_step - 1e-6 or agent.times[0] > self.time_step + 1e-6:
                raise InputError(
                    f"agents[{i}].times: expected to cover {self.time_step:g} to {steps * self.time_step:g} s, "
                    f"got {agent.times[0]:g} to {agent.times[-1]:g} s"
                )
        return steps * self.time_step

    @property
    def steps(self) -> int:
        """Number of steps of the grid after the start."""
        return round(float(self.horizon or 0.0) / self.time_step)

    @property
    def times(self) -> Array:
        """(steps + 1,) grid times from 0 [s]."""
        return np.arange(self.steps + 1, dtype=np.float64) * self.time_step


def default_ego(vehicle: KinematicCar) -> EgoShape:
    """Six discs around the Minkowski sum of the vehicle and each agent's own size, at any heading."""
    return EgoCover.discs(vehicle.length, vehicle.width)


def _polygon(name: str, value: Any) -> Array:
    polygon = as_array(name, value, ("N", 2))
    if len(polygon) < 3:
        raise InputError(f"{name}: expected at least 3 vertices, got {len(polygon)}")
    return polygon


def _simple_polygon(name: str, value: Any) -> Array:
    """A polygon with an area and without crossing edges: of others "inside" is a matter of taste."""
    polygon = _polygon(name, value)
    start, end = polygon, np.roll(polygon, -1, axis=0)
    centred = polygon - polygon.mean(axis=0)
    area = 0.5 * np.sum(_cross(centred, np.roll(centred, -1, axis=0)))
    if not abs(area) > 1e-12 * np.ptp(polygon, axis=0).max() ** 2:
        raise InputError(f"{name}: expected a simple polygon with an area, got one of no area")
    side = end - start
    # proper crossings of edge i with edge j: each edge's ends lie strictly on different sides of the other
    first = _cross(side[:, None], start[None] - start[:, None])
    second = _cross(side[:, None], end[None] - start[:, None])
    apart = first * second < 0
    crossing = np.argwhere(apart & apart.T)
    if len(crossing):
        i, j = (int(k) for k in crossing[0])
        raise InputError(f"{name}: expected a simple polygon with an area, got edges {i} and {j} that cross")
    return polygon


def _cross(a: Array, b: Array) -> Array:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _line(name: str, value: Any) -> Array:
    line = as_array(name, value, ("N", 2))
    if len(line) < 2:
        raise InputError(f"{name}: expected at least 2 points, got {len(line)}")
    return line


def _interval(name: str, value: Any) -> tuple[float, float]:
    if np.shape(value) != (2,):
        raise InputError(f"{name}: expected (lowest, highest), got {value!r}")
    low, high = float(value[0]), float(value[1])
    if not low <= high or not np.isfinite(low):
        raise InputError(f"{name}: expected lowest <= highest, got {value!r}")
    return low, high
