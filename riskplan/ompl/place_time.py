"""Place and time as OMPL's geometric planners see them: points (x, y, t) joined by straight motions forward in time."""

from __future__ import annotations

import math
from itertools import cycle
from typing import Any

import numpy as np
from ompl import base as ob
from ompl import geometric as og

from checkers.validate import Array
from riskplan.kernels.car import lane_frame
from riskplan.kernels.motion import extend
from riskplan.kernels.steer import STATE
from riskplan.kernels.world import path_free
from riskplan.search import Problem

_STANDS = 0.3  # below that speed a body keeps its lane's direction [m/s]
_GOALS = 128  # places drawn in the goal
_PERIOD = 0.5  # of a motion of a trial [s]
_TRIALS, _MARGIN = 200, 0.1  # ways that tell where the vehicle can be, and what is added around


class PlaceTime:
    """Where the vehicle can be at a time, as far as trials tell, and which straight motions are valid.

    A motion is valid iff it goes forward in time no faster than the vehicle can, the body, in the direction of the
    motion, is free of the static world, and the evaluator's bound on steps holds at all grid steps it passes.

    OMPL's coordinates are (ahead − pace t, aside, w t) in the frame of the start, as seen by one who drives on at a
    pace in the middle of what is possible: a box around what can be reached is small, and straight motions stay so.

    Attributes:
        motions, checked_steps: asked and charged so far.
        low, high: (3,) of OMPL's coordinates.
    """

    def __init__(self, problem: Problem, rng: np.random.Generator) -> None:
        self.problem = problem
        s = problem.scenario
        self.motions = self.checked_steps = 0
        self._cos, self._sin = math.cos(s.start.heading), math.sin(s.start.heading)
        reached = _reached(problem, rng)
        self._rows = reached.tolist()
        times = s.times[: len(reached)]
        pace = 0.5 * (reached[-1, 0] + reached[-1, 1]) / max(times[-1], s.time_step)
        self._pace = pace
        ahead = reached[:, :2] - (pace * times)[:, None]
        # as far in time as the box is wide to either side in place
        self._weight = max(0.5 * float(np.ptp(ahead)) / max(float(times[-1]), s.time_step), 1e-3)
        self.low = ahead.min(), reached[:, 2].min(), 0.0
        self.high = ahead.max(), reached[:, 3].max(), problem.goal.latest * s.time_step * self._weight

    def write(self, state: Any, x: float, y: float, time: float) -> None:
        """Fill OMPL's state."""
        ahead, aside = self._frame(x, y)
        state[0], state[1], state[2] = ahead - self._pace * time, aside, self._weight * time

    def point(self, state: Any) -> tuple[float, float, float]:
        """x, y, time of OMPL's state."""
        time = state[2] / self._weight
        ahead, aside, start = state[0] + self._pace * time, state[1], self.problem.scenario.start
        return start.x + self._cos * ahead - self._sin * aside, start.y + self._sin * ahead + self._cos * aside, time

    def _frame(self, x: float, y: float) -> tuple[float, float]:
        """Ahead and aside of the start's pose."""
        x, y = x - self.problem.scenario.start.x, y - self.problem.scenario.start.y
        return self._cos * x + self._sin * y, self._cos * y - self._sin * x

    def goals(self, rng: np.random.Generator) -> list[tuple[float, float, float]]:
        """x, y, time of places in the goal that are free, within reach and within the bound on steps; may be none."""
        p, dt = self.problem, self.problem.scenario.time_step
        kept = []
        for x, y, heading, _, time in p.goal_samples(rng, _GOALS).tolist():
            inside = self.within(x, y, time) and p.world.free(x, y, heading)
            if inside and steps_hold(p, np.array([[x, y, heading]]), round(time / dt)):
                kept.append((x, y, time))
        return kept

    def within(self, x: float, y: float, time: float) -> bool:
        """Whether the vehicle's trials came near there at that time."""
        place = time / self.problem.scenario.time_step
        step = int(place + 1e-9)
        if not 0 <= step < len(self._rows):
            return False
        ahead, aside = self._frame(x, y)
        low, high, right, left = self._rows[step]
        low_, high_, right_, left_ = self._rows[min(step + 1, len(self._rows) - 1)]
        return bool(min(low, low_) <= ahead <= max(high, high_) and min(right, right_) <= aside <= max(left, left_))

    def free(self, a: tuple[float, float, float], b: tuple[float, float, float]) -> bool:
        """Whether the straight motion between two points is valid."""
        self.motions += 1
        p = self.problem
        span, dt = b[2] - a[2], p.scenario.time_step
        if not span > 1e-9 or not self.within(*b):
            return False
        dx, dy = b[0] - a[0], b[1] - a[1]
        speed = math.hypot(dx, dy) / span
        if speed > max(p.scenario.vehicle.top_speed, p.start_state[3]):
            return False
        heading = math.atan2(dy, dx) if speed > _STANDS else p.start_state[2]
        if speed <= _STANDS:
            heading = lane_frame(a[0], a[1], heading, p.world.lanes)[0]
        if not path_free(a[0], a[1], heading, np.array([[b[0], b[1], heading]]), 1, p.world.packed):
            return False
        first, last = int(a[2] / dt + 1e-9) + 1, int(b[2] / dt + 1e-9)
        if last < first or not p.scenario.agents:
            return True
        share = (np.arange(first, last + 1) * dt - a[2]) / span
        poses = np.empty((len(share), 3))
        poses[:, 0], poses[:, 1], poses[:, 2] = a[0] + share * dx, a[1] + share * dy, heading
        self.checked_steps += len(poses)
        return steps_hold(p, poses, first)


def space_information(place_time: PlaceTime) -> Any:
    """OMPL's view; only it holds OMPL's objects, since callbacks that hold them leak."""
    space, bounds = ob.RealVectorStateSpace(3), ob.RealVectorBounds(3)
    for i, (low, high) in enumerate(zip(place_time.low, place_time.high, strict=True)):
        bounds.setLow(i, float(low))
        bounds.setHigh(i, float(max(high, low + 1e-6)))
    space.setBounds(bounds)
    si = ob.SpaceInformation(space)
    si.setStateValidityChecker(_Within(si, place_time))
    si.setMotionValidator(_Straight(si, place_time))
    si.setup()
    return si


def definition(si: Any, place_time: PlaceTime, goals: list[tuple[float, float, float]]) -> tuple[Any, Arrived]:
    """Start and goal for one planner, and the goal, which notes when it is reached."""
    pdef = ob.ProblemDefinition(si)
    start = si.allocState()
    place_time.write(start, *place_time.problem.start_state[:2], 0.0)
    pdef.addStartState(start)  # keeps a copy
    goal = Arrived(si, place_time, goals)
    pdef.setGoal(goal)
    return pdef, goal


def simplified(si: Any, place_time: PlaceTime, path: Any) -> Array:
    """(N, 3) x, y, time of the path, with what vertices it can do without taken out."""
    og.PathSimplifier(si).reduceVertices(path)
    return np.array([place_time.point(state) for state in path.getStates()])


class _Within(ob.StateValidityChecker):
    def __init__(self, si: Any, owner: PlaceTime) -> None:
        super().__init__(si)
        self._within, self._point = owner.within, owner.point

    def isValid(self, state: Any) -> bool:  # noqa: N802  OMPL's name
        return bool(self._within(*self._point(state)))


class _Straight(ob.MotionValidator):
    def __init__(self, si: Any, owner: PlaceTime) -> None:
        super().__init__(si)
        self._free, self._point = owner.free, owner.point

    def checkMotion(self, first: Any, second: Any) -> bool:  # noqa: N802  OMPL's name
        return bool(self._free(self._point(first), self._point(second)))


class Arrived(ob.GoalSampleableRegion):
    """Any place of a goal region within the window; heading and speed are left to the vehicle."""

    def __init__(self, si: Any, owner: PlaceTime, goals: list[tuple[float, float, float]]) -> None:
        super().__init__(si)
        self._goal, self._point = owner.problem.goal, owner.point
        dt = owner.problem.scenario.time_step
        self._window = self._goal.earliest * dt - 1e-6, self._goal.latest * dt + 1e-6
        self._write, self._samples, self._count = owner.write, cycle(goals), len(goals)
        self.reached = False

    def distanceGoal(self, state: Any) -> float:  # noqa: N802  OMPL's name
        """OMPL's only question; 0 in the goal."""
        x, y, time = self._point(state)
        late = max(self._window[0] - time, time - self._window[1], 0.0)
        distance = late + float(self._goal.distances(np.array([[x, y]]))[0])
        self.reached |= distance <= 0.0
        return distance

    def sampleGoal(self, state: Any) -> None:  # noqa: N802
        """The next of the places given."""
        self._write(state, *next(self._samples))

    def maxSampleCount(self) -> int:  # noqa: N802
        """How many there are: FMT* looks at all of them."""
        return self._count


def steps_hold(problem: Problem, poses: Array, first: int) -> bool:
    """Whether the risk of poses (S, 3) at grid steps from `first` on is within the evaluator's bound on steps."""
    if not problem.scenario.agents:
        return True
    nothing = np.zeros(problem.evaluator.groups)
    total = problem.evaluator.charge(poses, first, nothing, np.inf, np.empty_like(nothing))
    return bool(total == total)  # NaN: above it


def _reached(problem: Problem, rng: np.random.Generator) -> Array:
    """(latest + 1, 4) least and most way ahead and aside of the start's pose, at every step."""
    s, latest = problem.scenario, problem.goal.latest
    longest = max(round(_PERIOD / s.time_step), 1)
    x, y, heading = problem.start_state[:3]
    cos, sin = math.cos(heading), math.sin(heading)
    low, high = np.full((latest + 1, 2), np.inf), np.full((latest + 1, 2), -np.inf)
    low[0], high[0] = 0.0, 0.0
    out = np.empty((longest, STATE))
    fixed = s.time_step, s.vehicle.limits, problem.world.lanes, problem.world.packed, problem.goal.arrays
    for trial in range(_TRIALS):
        node, step = np.array([*problem.start_node, 0.0]), 0
        # a third brake or push all the way, the ends of what is possible
        push = float(rng.choice([-1.0, 1.0])) if trial % 3 == 0 else None
        for _ in range(4 * latest // longest + 4):
            u = rng.uniform(-1.0, 1.0, 3)
            u[0] = u[0] if push is None else push
            driven, _ = extend(s.vehicle.kernel.address, node, *u, longest, *fixed, latest + 1, latest, out)
            if not driven:
                continue
            dx, dy = out[:driven, 0] - x, out[:driven, 1] - y
            way = np.column_stack([cos * dx + sin * dy, cos * dy - sin * dx])
            rows = slice(step + 1, step + 1 + driven)
            low[rows], high[rows] = np.minimum(low[rows], way), np.maximum(high[rows], way)
            step += driven
            node[:STATE], node[STATE] = out[driven - 1], step
            if step == latest:
                break
    # where no trial came: no farther than top speed leads from where they came
    for row in np.flatnonzero(~np.isfinite(low[:, 0])):
        reach = s.vehicle.top_speed * s.time_step
        low[row], high[row] = low[row - 1] - reach, high[row - 1] + reach
    margin = _MARGIN * (high - low) + 0.5 * max(s.vehicle.body)
    return np.column_stack([low - margin, high + margin])[:, [0, 2, 1, 3]]
