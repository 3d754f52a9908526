"""What is planned for: start, goal, bounds, static world, vehicle, agents. Frozen values, checked on construction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from checkers import ControlPrediction, EgoShape, InputError, Prediction
from checkers.validate import FARTHEST, Array, as_array, as_instance, as_scalar, as_text, as_tuple
from riskplan.showing import shown
from riskplan.vehicles import Vehicle, vehicle_class

if TYPE_CHECKING:
    from riskplan.world import StaticWorld

Agent = Prediction
MOST_STEPS = 100_000  # of a grid
MOST_TOUCHING = 1024  # vertices of a polygon that touches itself: checked pair by pair
_ROWS = 256


@dataclass(frozen=True)
class State:
    """State of the ego's centre: x, y [m], heading [rad], speed [m/s], steering angle [rad] of a vehicle that has one.

    A speed is negative in reverse, for vehicles that can.
    """

    x: float
    y: float
    heading: float
    speed: float = 0.0
    steering: float = 0.0

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            value = as_scalar(f"start.{name}", getattr(self, name), low=-FARTHEST, high=FARTHEST)
            object.__setattr__(self, name, value)


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
        regions = as_tuple("goal.regions", self.regions, GoalRegion)
        if not regions:
            raise InputError("goal.regions: expected at least one GoalRegion, got none")
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


@dataclass(frozen=True, eq=False)
class Scenario:
    """One planning problem on the time grid 0, time_step, …, horizon.

    Attributes:
        start: where the ego is at time 0.
        goal: where it shall be.
        bounds: (x_min, y_min, x_max, y_max) of the centre [m].
        obstacles: polygons (N, 2) the body must not touch.
        agents: predictions; each must cover the grid from its second time on (time 0 too, if it shall count there).
        ego: shape for the risk; None: the vehicle's own, see `Vehicle.shape`.
        vehicle: limits, motion and body of the ego; None: a `KinematicCar`.
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
    vehicle: Vehicle = None  # type: ignore[assignment]  # replaced on construction
    time_step: float = 0.1
    horizon: float | None = None
    drivable: tuple[Array, ...] = ()
    lanes: tuple[Array, ...] = ()
    name: str = ""

    def __post_init__(self) -> None:
        put = object.__setattr__
        if self.vehicle is None:
            put(self, "vehicle", vehicle_class("car")())
        if not isinstance(self.vehicle, Vehicle):
            raise InputError(f"vehicle: expected a Vehicle, got {self.vehicle!r}")
        bounds = tuple(float(b) for b in as_array("bounds", self.bounds, (4,), largest=FARTHEST))
        if bounds[0] >= bounds[2] or bounds[1] >= bounds[3]:
            raise InputError(f"bounds: expected x_min < x_max and y_min < y_max, got {list(bounds)}")
        put(self, "bounds", bounds)
        for name in ("obstacles", "drivable"):
            check = _simple_polygon if name == "obstacles" else _polygon
            put(self, name, tuple(check(f"{name}[{i}]", p) for i, p in enumerate(as_tuple(name, getattr(self, name)))))
        put(self, "lanes", tuple(_line(f"lanes[{i}]", p) for i, p in enumerate(as_tuple("lanes", self.lanes))))
        put(self, "time_step", as_scalar("time_step", self.time_step, low=1e-3))
        put(self, "ego", as_instance("ego", self.vehicle.shape() if self.ego is None else self.ego, EgoShape))
        as_text("name", self.name)
        self._check_task()

    def _check_task(self) -> None:
        """What changes from plan to plan in one place: start, goal, agents, horizon."""
        put = object.__setattr__
        for name, cls in (("start", State), ("goal", Goal)):
            if not isinstance(getattr(self, name), cls):
                raise InputError(f"{name}: expected a {cls.__name__}, got {getattr(self, name)!r}")
        self.vehicle.check_state(self.start.speed, self.start.steering)
        s, bounds = self.start, self.bounds
        if not (bounds[0] <= s.x <= bounds[2] and bounds[1] <= s.y <= bounds[3]):
            raise InputError(f"start: ({s.x:g}, {s.y:g}) lies outside the bounds {list(bounds)}")
        agents = as_tuple("agents", self.agents)
        for i, agent in enumerate(agents):
            if not isinstance(agent, Agent):
                raise InputError(f"agents[{i}]: expected a prediction, got {type(agent).__name__}")
        put(self, "agents", agents)
        put(self, "horizon", self._checked_horizon())

    @cached_property
    def world(self) -> StaticWorld:
        """The static world, packed for collision checks on first use."""
        from riskplan.world import StaticWorld  # noqa: PLC0415  numba and shapely cost import time

        return StaticWorld(self)

    def with_agents(self, agents: Sequence[Agent]) -> Scenario:
        """The same scene with other agents or predictions; the packed static world is shared."""
        return self.with_task(agents=tuple(agents))

    def with_task(self, **changed: Any) -> Scenario:
        """The same place with another `start`, `goal`, `agents` or `horizon`; the packed static world is shared.

        Raises:
            InputError: as on construction.
        """
        for name in changed:
            if name not in ("start", "goal", "agents", "horizon"):
                raise InputError(f"{name}: expected one of start, goal, agents, horizon; got another field")
        other = object.__new__(Scenario)
        other.__dict__.update({**self.__dict__, "world": self.world, **changed})  # made now, it is made once for all
        other._check_task()
        return other

    def _checked_horizon(self) -> float:
        ends = [float(a.times[-1]) for a in self.agents]
        if self.horizon is None and not ends:
            raise InputError("horizon: expected a number, as there are no agents to take it from")
        wanted = min(ends) if self.horizon is None else as_scalar("horizon", self.horizon)
        steps = int(min(np.floor(wanted / self.time_step + 1e-6), MOST_STEPS + 1))
        if steps > MOST_STEPS:
            raise InputError(f"horizon: expected at most {MOST_STEPS} steps of {self.time_step:g} s, got {wanted:g} s")
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
            if isinstance(agent, ControlPrediction):  # moments could be interpolated, futures could not
                grid = np.arange(steps + 1) * self.time_step
                try:
                    agent.at(grid[grid >= agent.times[0] - 1e-6])
                except InputError as error:
                    raise InputError(f"time_step {self.time_step:g} s: agents[{i}].{error}") from None
        return steps * self.time_step

    @property
    def steps(self) -> int:
        """Number of steps of the grid after the start."""
        return round(float(self.horizon or 0.0) / self.time_step)

    @property
    def times(self) -> Array:
        """(steps + 1,) grid times from 0 [s]."""
        return np.arange(self.steps + 1, dtype=np.float64) * self.time_step

    def _repr_html_(self) -> str:
        return shown(self)


def _polygon(name: str, value: Any) -> Array:
    polygon = as_array(name, value, ("N", 2), largest=FARTHEST)
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
    if len(polygon) > _ROWS:
        from shapely import LinearRing  # noqa: PLC0415  costs import time

        if LinearRing(polygon).is_simple:  # a sweep: n log n, where the pairs below are n²
            return polygon
    side = end - start
    if len(polygon) == 4:
        # maps have many: a convex one crosses nowhere
        bends = _cross(side, np.roll(side, -1, axis=0))
        if (bends > 0).all() or (bends < 0).all():
            return polygon
    for first in range(0, len(polygon), _ROWS):  # some rows at a time: memory stays small
        rows = slice(first, first + _ROWS)
        crossing = np.argwhere(
            _apart(start[rows, None], side[rows, None], start, end)
            & _apart(start, side, start[rows, None], end[rows, None])
        )
        if len(crossing):
            i, j = first + int(crossing[0, 0]), int(crossing[0, 1])
            raise InputError(f"{name}: expected a simple polygon with an area, got edges {i} and {j} that cross")
        if first >= MOST_TOUCHING:
            raise InputError(f"{name}: touches itself; expected at most {MOST_TOUCHING} vertices, got {len(polygon)}")
    return polygon


def _apart(start: Array, side: Array, a: Array, b: Array) -> np.ndarray:
    """Whether a and b lie strictly on different sides of the line of an edge; both ways round: a proper crossing."""
    apart: np.ndarray = _cross(side, a - start) * _cross(side, b - start) < 0
    return apart


def _cross(a: Array, b: Array) -> Array:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _line(name: str, value: Any) -> Array:
    line = as_array(name, value, ("N", 2), largest=FARTHEST)
    if len(line) < 2:
        raise InputError(f"{name}: expected at least 2 points, got {len(line)}")
    return line


def _interval(name: str, value: Any) -> tuple[float, float]:
    low, high = as_array(name, value, (2,), finite=False).tolist()
    if not low <= high or not np.isfinite(low):
        raise InputError(f"{name}: expected lowest <= highest, got {value!r}")
    return low, high
