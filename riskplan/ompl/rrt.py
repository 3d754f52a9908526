"""`rrt`: OMPL's control-based RRT whose every node carries the total risk of the way to it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import cycle
from typing import Any

import numpy as np
from ompl import base as ob
from ompl import control as oc
from ompl import util as ou

from checkers.validate import Array, as_count, as_scalar
from riskplan.kernels.motion import extend, extend_towards, out_of_reach
from riskplan.kernels.steer import NODE, STATE
from riskplan.ompl.cost import Price
from riskplan.ompl.validity import RiskMotionValidator, RiskStateValidityChecker
from riskplan.search import Budget, LowestSeen, Problem, SearchResult
from riskplan.vehicles import Vehicle

# the node's number rides along in the state, too small for the metric to see
_NUMBER = 1e-9
_AIMED = 24  # controls of which a motion towards the goal is the best
_FIRST = 128  # nodes that a tree has room for at first


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
        as_count("rrt: motion_steps", self.motion_steps, 1)
        as_scalar("rrt: goal_bias", self.goal_bias, low=0.0, high=1.0)

    def search(self, problem: Problem, budget: Budget, seed: int) -> SearchResult:
        """Grow the tree until the goal is reached within the budget, or time is up."""
        return self.grow(problem, budget, seed).result()

    def grow(self, problem: Problem, budget: Budget, seed: int, price: Price | None = None) -> Tree:
        """The same; with a price, no node is kept from which the goal cannot be reached below its ceiling."""
        ou.setLogLevel(ou.LogLevel.LOG_NONE)
        ou.RNG.setSeed(seed + 1)  # OMPL turns 0 into 1
        si = _space_information(problem)
        weights = problem.scenario.vehicle.metric
        validator = RiskMotionValidator(
            si,
            problem.scenario.agents,
            problem.ego,
            problem.evaluator.checker,
            pose_time=lambda state: (state[0], state[1], state[2] / weights.heading, state[4] / weights.time),
            evaluator=problem.evaluator,
        )
        tree = Tree(problem, budget, self.motion_steps, validator, price, seed)
        _attach(si, problem, tree)
        pdef = ob.ProblemDefinition(si)
        start = si.allocState()
        for number in range(tree.plant(problem.begun)):
            tree.write(start, number)
            pdef.addStartState(start)  # keeps a copy
        goal = _Goal(si, problem, np.random.default_rng(seed), tree)
        pdef.setGoal(goal)
        planner = oc.RRT(si)
        planner.setProblemDefinition(pdef)
        planner.setGoalBias(self.goal_bias)
        planner.setup()
        planner.solve(ob.PlannerTerminationCondition(lambda: bool(tree.done or budget.over())))
        return tree


class Tree:
    """The nodes' numbers, outside OMPL: states, controls, parents and accumulated risk, one row each."""

    def __init__(
        self,
        problem: Problem,
        budget: Budget,
        motion_steps: int,
        validator: RiskMotionValidator,
        price: Price | None = None,
        seed: int = 0,
    ) -> None:
        self.problem, self.budget, self.validator, self.price = problem, budget, validator, price
        self.steps = motion_steps
        self.count = 1
        self.done = False
        self.best: tuple[int, int] | None = None  # node and its last step in the goal
        groups = problem.evaluator.groups
        self.nodes = np.zeros((_FIRST, NODE))
        self.risk = np.zeros((_FIRST, groups))
        self.total, self.cost = np.zeros(_FIRST), np.zeros(_FIRST)
        self.parent = np.full(_FIRST, -1)
        self.poses: list[Array] = [np.zeros((0, STATE))]
        self.controls: dict[int, tuple[float, float, float]] = {}  # of the motions that a control made
        self.nodes[0] = [*problem.start_node, 0]
        self.risk[0], self.total[0] = problem.start_risk, problem.start_total
        self.motions = self.charges = 0
        self.lowest_seen = LowestSeen(validator.charge, budget)
        vehicle = problem.scenario.vehicle
        self.metric, self._kernel = vehicle.metric, vehicle.kernel.address
        goal = problem.goal
        self._fixed = (
            problem.scenario.time_step,
            vehicle.limits,
            problem.world.lanes,
            problem.world.packed,
        )
        self._goal = (goal.arrays, goal.earliest, goal.latest)
        self._reach = (goal.boxes, vehicle.top_acceleration, vehicle.top_speed)
        self._out = np.empty((motion_steps, STATE))
        self._rng = np.random.default_rng(seed)
        self.aim: Array | None = None  # a state in the goal that the next motion is to lead to

    def plant(self, states: Array) -> int:
        """Grow the states (S, 5) of an earlier plan, as far as they are within the limit; how many nodes there are."""
        for i, state in enumerate(states[: self._goal[2] - 1]):
            self._out[0] = state
            number = self.count - 1
            if i + 1 >= self._goal[1] and self.problem.goal.holds(*state[:4]):
                break  # an arrival ends a search, it begins none
            if self._charge(number, 1, False) < 0:
                break
        return self.count

    def write(self, state: Any, number: int) -> None:
        """Fill OMPL's state from a node."""
        node, weights = self.nodes[number], self.metric
        state[0], state[1], state[2] = node[0], node[1], node[2] * weights.heading
        state[3], state[4] = node[3] * weights.speed, node[5] * self._fixed[0] * weights.time
        state[5] = number * _NUMBER

    def propagate(self, state: Any, control: Any, duration: float, out: Any) -> None:
        """OMPL's propagator: writes a new node, or marks the state invalid by a negative number."""
        del duration
        parent = round(state[5] / _NUMBER)
        u = control[0], control[1], control[2]
        number, fixed = -1, (self.steps, *self._fixed, *self._goal, self._out)
        self.motions += 1
        if self.aim is None:
            driven, arrived = extend(self._kernel, self.nodes[parent], *u, *fixed)
        else:
            tried = self._rng.uniform(-1.0, 1.0, (_AIMED, 3))
            weights = self.metric.heading, self.metric.speed
            driven, arrived, which = extend_towards(self._kernel, self.nodes[parent], tried, self.aim, weights, *fixed)
            u, self.aim = tuple(tried[which].tolist()), None
        if driven and (arrived or not self._lost(parent, driven)):
            number = self._charge(parent, driven, arrived)
            self.controls[number] = u
        if number < 0:
            out[0], out[1], out[2], out[3], out[4] = state[0], state[1], state[2], state[3], state[4]
            out[5] = -1.0
        else:
            self.write(out, number)

    def _lost(self, parent: int, driven: int) -> bool:
        """Whether the goal is out of reach after the motion: no way goes on from there."""
        x, y, _, speed, _ = self._out[driven - 1].tolist()
        left = self._goal[2] - int(self.nodes[parent, STATE]) - driven
        return bool(out_of_reach(x, y, speed, left, self._fixed[0], *self._reach))

    def _charge(self, parent: int, driven: int, arrived: bool) -> int:
        if self.count == len(self.nodes):
            self._grow()
        number = self.count
        first = int(self.nodes[parent, 5]) + 1
        if self.price is not None:
            self.cost[number] = self.cost[parent] + self.price.least(self.nodes[parent], self._out[:driven])
            if not self.cost[number] + self.price.ahead(self._out[driven - 1], first + driven - 1) < self.price.ceiling:
                return -1
        limit = self.lowest_seen.limit if arrived else self.budget.limit
        poses, before = self._out[:driven, :3], self.risk[parent]
        total = self.validator.charge(poses, first, before, limit, self.risk[number])
        self.charges += driven
        if arrived and total <= self.budget.limit:
            total = self.problem.evaluator.confirmed(self._path(parent, self._out[:driven])[:, :3], total)
            self.lowest_seen.saw(total)
        elif arrived:
            self.lowest_seen.above(total, poses, first, before)
        if not total <= self.budget.limit:
            return -1
        self.nodes[number, :STATE] = self._out[driven - 1]
        self.nodes[number, STATE] = first + driven - 1
        self.total[number], self.parent[number] = total, parent
        self.poses.append(self._out[:driven].copy())
        self.count += 1
        if arrived:
            self.best = (number, driven)
            self.done = self.budget.found(total)
        return number

    def drive(self, node: Array, risk: Array, u: Array) -> tuple[Array, Array, Array, float, bool] | None:
        """A motion outside the tree: its states, the node and accumulators at its end, total, and whether it arrived.

        None if the world, a limit of the vehicle or the bound is in the way.
        """
        u1, u2, u3 = u.tolist()
        driven, arrived = extend(self._kernel, node, u1, u2, u3, self.steps, *self._fixed, *self._goal, self._out)
        if not driven:
            return None
        states, after, first = self._out[:driven].copy(), np.empty_like(risk), int(node[STATE]) + 1
        total = self.validator.charge(states[:, :3], first, risk, self.budget.limit, after)
        if not total <= self.budget.limit:
            return None
        return states, np.append(states[-1], first + driven - 1), after, total, bool(arrived)

    def _grow(self) -> None:
        for name in ("nodes", "risk", "total", "cost", "parent"):
            old = getattr(self, name)
            setattr(self, name, np.concatenate([old, np.zeros_like(old)]))

    def total_of(self, state: Any) -> float:
        """Accumulated risk of a state; NaN, within no bound, for one that could not be driven to."""
        number = state[5]
        return float(self.total[round(number / _NUMBER)]) if number >= 0.0 else np.nan

    def result(self) -> SearchResult:
        """The way to the best arrival, if there is one."""
        p = self.problem
        counters = {"nodes": self.count, "motions": self.motions, "checked_steps": self.charges}
        children, parents = self.nodes[1 : self.count], self.nodes[self.parent[1 : self.count]]
        edges = np.column_stack([parents[:, :2], children[:, :2], children[:, 5] * p.scenario.time_step])
        if self.best is None:
            return SearchResult(None, self.lowest_seen.lowest, counters, edges)
        number = self.best[0]
        states = self._path(int(self.parent[number]), self.poses[number])
        return SearchResult(states, float(self.total[number]), counters, edges)

    def _path(self, number: int, last: Array) -> Array:
        """(T, 5) from the start through a node and on."""
        parts = [last]
        while number > 0:
            parts.append(self.poses[number])
            number = int(self.parent[number])
        return np.concatenate([np.array([self.problem.start_node]), *parts[::-1]])


class _Goal(ob.GoalSampleableRegion):
    """Tells OMPL where to pull the tree; the arrival itself is noticed while driving."""

    def __init__(self, si: Any, problem: Problem, rng: np.random.Generator, tree: Tree) -> None:
        super().__init__(si)
        weights = np.array([1.0, 1.0, *problem.scenario.vehicle.metric])
        samples = problem.goal_samples(rng, 512)
        self._samples = cycle(zip((samples * weights).tolist(), samples, strict=True))
        self._tree = tree

    def isSatisfied(self, state: Any, distance: Any = None) -> bool:  # noqa: N802, ARG002  OMPL's name
        return self._tree.done

    def distanceGoal(self, state: Any) -> float:  # noqa: N802, ARG002
        return 0.0 if self._tree.done else 1.0

    def sampleGoal(self, state: Any) -> None:  # noqa: N802
        (state[0], state[1], state[2], state[3], state[4]), self._tree.aim = next(self._samples)
        state[5] = 0.0

    def maxSampleCount(self) -> int:  # noqa: N802
        return 1_000_000


def _space(problem: Problem) -> Any:
    s = problem.scenario
    space = ob.RealVectorStateSpace(6)
    bounds = ob.RealVectorBounds(6)
    x0, y0, x1, y1 = s.bounds
    weights = s.vehicle.metric
    gained = s.vehicle.top_acceleration * s.steps * s.time_step
    slow, fast = _speeds(s.vehicle, s.start.speed, gained)
    ranges = [
        (x0, x1),
        (y0, y1),
        (-np.pi * weights.heading, np.pi * weights.heading),
        (slow * weights.speed, fast * weights.speed),
        (0.0, problem.goal.latest * s.time_step * weights.time),
        (-1.0, 1e-12),
    ]
    for i, (low, high) in enumerate(ranges):
        bounds.setLow(i, float(low))
        bounds.setHigh(i, float(max(high, low + 1e-9)))
    space.setBounds(bounds)
    return space


def _speeds(vehicle: Vehicle, start: float, gained: float) -> tuple[float, float]:
    """Lowest and highest speed that can come about."""
    top = vehicle.top_speed
    fast = min(max(top, start), max(start, 0.0) + gained)
    return (max(min(-top, start), min(start, 0.0) - gained) if vehicle.reverses else 0.0), fast


def _space_information(problem: Problem) -> Any:
    space = _space(problem)
    controls = oc.RealVectorControlSpace(space, 3)
    bounds = ob.RealVectorBounds(3)
    bounds.setLow(-1.0)
    bounds.setHigh(1.0)
    controls.setBounds(bounds)
    return oc.SpaceInformation(space, controls)


def _attach(si: Any, problem: Problem, tree: Tree) -> None:
    """The tree propagates, and what it found of a node's risk and of its motion decides."""
    si.setStatePropagator(tree.propagate)
    si.setPropagationStepSize(1.0)
    si.setMinMaxControlDuration(1, 1)
    si.setMotionValidator(tree.validator)
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
