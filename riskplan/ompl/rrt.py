"""`rrt`: OMPL's control-based RRT whose every node carries the total risk of the way to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import cycle
from typing import Any

import numpy as np
from ompl import base as ob
from ompl import control as oc
from ompl import util as ou

from checkers import InputError
from checkers.validate import Array
from riskplan.kernels.car import pack_limits
from riskplan.kernels.motion import extend
from riskplan.ompl.validity import RiskStateValidityChecker
from riskplan.search import Budget, Problem, SearchResult
from riskplan.world import lane_segments

# OMPL's nearest neighbour sees x, y [m] and these weights of heading [m/rad], speed [s] and time [m/s]
_HEADING, _SPEED, _TIME = 3.0, 0.5, 4.0
# the node's number rides along in the state, too small for the metric to see
_NUMBER = 1e-9


@dataclass(frozen=True)
class Rrt:
    """Rapidly-exploring random tree over (x, y, heading, speed, time) (LaValle & Kuffner 2001).

    A motion lasts `motion_steps` grid steps under constant acceleration and two halves of constant curvature. The
    accumulated risk of every agent and mode is kept per node; a node whose total is above the bound is invalid. With
    no bound the tree keeps growing, under the least risk found so far, until the time limit.

    Attributes:
        motion_steps: grid steps a motion lasts.
        goal_bias: share of samples drawn from the goal.
    """

    motion_steps: int = 15
    goal_bias: float = 0.2

    def __post_init__(self) -> None:
        if not isinstance(self.motion_steps, int) or self.motion_steps < 1:
            raise InputError(f"rrt: motion_steps: expected an integer >= 1, got {self.motion_steps!r}")
        if not 0.0 <= self.goal_bias <= 1.0:
            raise InputError(f"rrt: goal_bias: expected a number in [0, 1], got {self.goal_bias!r}")

    def search(self, problem: Problem, budget: Budget, seed: int) -> SearchResult:
        """Grow the tree until the goal is reached within the budget, or time is up."""
        ou.setLogLevel(ou.LogLevel.LOG_NONE)
        ou.RNG.setSeed(seed + 1)  # OMPL turns 0 into 1
        tree = _Tree(problem, budget, self.motion_steps)
        space = _space(problem)
        si = _space_information(space, problem, tree)
        pdef = ob.ProblemDefinition(si)
        start = si.allocState()
        tree.write(start, 0)
        pdef.addStartState(start)
        goal = _Goal(si, problem, np.random.default_rng(seed), lambda: tree.done)
        pdef.setGoal(goal)
        planner = oc.RRT(si)
        planner.setProblemDefinition(pdef)
        planner.setGoalBias(self.goal_bias)
        planner.setup()
        planner.solve(ob.PlannerTerminationCondition(lambda: bool(tree.done or budget.expired())))
        return tree.result()


class _Tree:
    """The nodes' numbers, outside OMPL: states, controls, parents and accumulated risk, one row each."""

    def __init__(self, problem: Problem, budget: Budget, motion_steps: int) -> None:
        self.problem, self.budget = problem, budget
        self.steps = motion_steps
        self.count = 1
        self.done = False
        self.best: tuple[int, int] | None = None  # node and its last step in the goal
        groups = problem.evaluator.groups
        self.nodes = np.zeros((1024, 5))
        self.risk = np.zeros((1024, groups))
        self.total = np.zeros(1024)
        self.parent = np.full(1024, -1)
        self.poses: list[Array] = [np.zeros((0, 4))]
        self.nodes[0] = [*problem.start_state, 0]
        self.risk[0], self.total[0] = problem.start_risk, problem.start_total
        self.motions = self.charges = 0
        self.lowest_seen = np.inf
        limits = pack_limits(problem.scenario.vehicle)
        goal = problem.goal
        self._fixed = (
            problem.scenario.time_step,
            limits,
            lane_segments(problem.scenario),
            problem.world.packed,
        )
        self._goal = (goal.arrays, goal.earliest, goal.latest)
        self._out = np.empty((motion_steps, 4))

    def write(self, state: Any, number: int) -> None:
        node = self.nodes[number]
        state[0], state[1], state[2] = node[0], node[1], node[2] * _HEADING
        state[3], state[4] = node[3] * _SPEED, node[4] * self._fixed[0] * _TIME
        state[5] = number * _NUMBER

    def propagate(self, state: Any, control: Any, duration: float, out: Any) -> None:
        """OMPL's propagator: writes a new node, or marks the state invalid by a negative number."""
        del duration
        parent = round(state[5] / _NUMBER)
        u1, u2, u3 = control[0], control[1], control[2]
        number = -1
        self.motions += 1
        driven, arrived, _, _, _ = extend(
            self.nodes[parent], u1, u2, u3, self.steps, *self._fixed, *self._goal, self._out
        )
        if driven:
            number = self._charge(parent, driven, arrived)
        if number < 0:
            out[0], out[1], out[2], out[3], out[4] = state[0], state[1], state[2], state[3], state[4]
            out[5] = -1.0
        else:
            self.write(out, number)

    def _charge(self, parent: int, driven: int, arrived: bool) -> int:
        if self.count == len(self.nodes):
            self._grow()
        number = self.count
        first = int(self.nodes[parent, 4]) + 1
        limit = np.inf if arrived else self.budget.limit
        total = self.problem.evaluator.charge(
            self._out[:driven, :3], first, self.risk[parent], limit, self.risk[number]
        )
        self.charges += driven
        if arrived:
            self.lowest_seen = min(self.lowest_seen, total)
        if not total <= self.budget.limit:
            return -1
        self.nodes[number, :4] = self._out[driven - 1]
        self.nodes[number, 4] = first + driven - 1
        self.total[number], self.parent[number] = total, parent
        self.poses.append(self._out[:driven].copy())
        self.count += 1
        if arrived:
            self.best = (number, driven)
            self.done = self.budget.found(total)
        return number

    def _grow(self) -> None:
        for name in ("nodes", "risk", "total", "parent"):
            old = getattr(self, name)
            setattr(self, name, np.concatenate([old, np.zeros_like(old)]))

    def total_of(self, state: Any) -> float:
        """Accumulated risk of a state; NaN, within no bound, for one that could not be driven to."""
        number = state[5]
        return float(self.total[round(number / _NUMBER)]) if number >= 0.0 else np.nan

    def result(self) -> SearchResult:
        p = self.problem
        counters = {"nodes": self.count, "motions": self.motions, "checked_steps": self.charges}
        children, parents = self.nodes[1 : self.count], self.nodes[self.parent[1 : self.count]]
        edges = np.column_stack([parents[:, :2], children[:, :2], children[:, 4] * p.scenario.time_step])
        if self.best is None:
            return SearchResult(None, self.lowest_seen, counters, edges)
        parts, number = [], self.best[0]
        while number > 0:
            parts.append(self.poses[number])
            number = int(self.parent[number])
        start = np.array([p.start_state])
        return SearchResult(np.concatenate([start, *parts[::-1]]), self.lowest_seen, counters, edges)


class _Goal(ob.GoalSampleableRegion):
    """Tells OMPL where to pull the tree; the arrival itself is noticed while driving."""

    def __init__(self, si: Any, problem: Problem, rng: np.random.Generator, done: Callable[[], bool]) -> None:
        super().__init__(si)
        weights = np.array([1.0, 1.0, _HEADING, _SPEED, _TIME])
        self._samples = cycle((problem.goal_samples(rng, 512) * weights).tolist())
        self._done = done

    def isSatisfied(self, state: Any, distance: Any = None) -> bool:  # noqa: N802, ARG002  OMPL's name
        return self._done()

    def distanceGoal(self, state: Any) -> float:  # noqa: N802, ARG002
        return 0.0 if self._done() else 1.0

    def sampleGoal(self, state: Any) -> None:  # noqa: N802
        state[0], state[1], state[2], state[3], state[4] = next(self._samples)
        state[5] = 0.0

    def maxSampleCount(self) -> int:  # noqa: N802
        return 1_000_000


def _space(problem: Problem) -> Any:
    s = problem.scenario
    space = ob.RealVectorStateSpace(6)
    bounds = ob.RealVectorBounds(6)
    x0, y0, x1, y1 = s.bounds
    top = max(s.vehicle.max_speed, s.start.speed)
    ranges = [
        (x0, x1),
        (y0, y1),
        (-np.pi * _HEADING, np.pi * _HEADING),
        (0.0, min(top, s.start.speed + s.vehicle.max_acceleration * s.steps * s.time_step) * _SPEED),
        (0.0, problem.goal.latest * s.time_step * _TIME),
        (-1.0, 1e-12),
    ]
    for i, (low, high) in enumerate(ranges):
        bounds.setLow(i, float(low))
        bounds.setHigh(i, float(max(high, low + 1e-9)))
    space.setBounds(bounds)
    return space


def _space_information(space: Any, problem: Problem, tree: _Tree) -> Any:
    controls = oc.RealVectorControlSpace(space, 3)
    bounds = ob.RealVectorBounds(3)
    bounds.setLow(-1.0)
    bounds.setHigh(1.0)
    controls.setBounds(bounds)
    si = oc.SpaceInformation(space, controls)
    si.setStatePropagator(tree.propagate)
    si.setPropagationStepSize(1.0)
    si.setMinMaxControlDuration(1, 1)
    s = problem.scenario
    si.setStateValidityChecker(
        RiskStateValidityChecker(
            si,
            s.agents,
            problem.ego,
            problem.evaluator.checker,
            total=tree.total_of,
            total_bound=lambda: tree.budget.limit,
        )
    )
    si.setup()
    return si
