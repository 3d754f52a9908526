"""Memoryless baselines: every step of the grid is held below a share of the bound, so that no total is carried.

Let the plan last at most T steps after its start, whose risk is r₀. Where the risk of every later step, summed over
modes and agents, is at most

    (bound − r₀) / T,

the sum over steps, and with it the total under any dependence (Boole), is within the bound whatever way was taken:
a state needs to know nothing of the way to it, and any planner that asks "is this motion valid?" can be used. The price
is that risk which one step leaves over is lost to the others; how much that is, is what these baselines show.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from checkers import InputError
from checkers.validate import Array
from riskplan.ompl.follow import Follower
from riskplan.ompl.place_time import PlaceTime, definition, simplified, space_information
from riskplan.ompl.rrt import Rrt
from riskplan.search import Budget, Problem, SearchResult

_ROUNDING = 1e-9  # share of the cap that pays for the order in which risks are added
_LONGER = 300  # samples by which RRT* goes on after it has reached the goal
_FIRST = 5000  # of OMPL's questions whether to go on, in a first search for a guide; twice as many after each failure


def capped(problem: Problem, budget: Budget, name: str) -> Problem:
    """The problem with the bound shared out equally among the steps.

    Raises:
        InputError: without a bound there is nothing to share.
    """
    if budget.bound is None:
        raise InputError(f"bound: expected a number for {name}, whose cap on steps follows from it; got None")
    left = max(budget.limit - problem.start_total, 0.0)
    cap = (1.0 - _ROUNDING) * left / max(problem.goal.latest, 1)
    evaluator = problem.evaluator
    return replace(problem, evaluator=replace(evaluator, step_bound=min(cap, evaluator.step_bound)))


@dataclass(frozen=True)
class RrtCapped:
    """`rrt` without its memory: the same tree under the same controls, but a cap on every step in place of the total.

    Attributes:
        motion_steps, goal_bias: as of `rrt`.
    """

    motion_steps: int = 15
    goal_bias: float = 0.2

    def __post_init__(self) -> None:
        try:
            Rrt(self.motion_steps, self.goal_bias)
        except InputError as error:
            raise InputError(str(error).replace("rrt:", "rrt-capped:", 1)) from None

    def search(self, problem: Problem, budget: Budget, seed: int) -> SearchResult:
        """As `rrt`; the risk of the way to a node never decides, for it cannot be above the sum of the caps."""
        return Rrt(self.motion_steps, self.goal_bias).search(capped(problem, budget, "rrt-capped"), budget, seed)


@dataclass(frozen=True)
class Capped(ABC):
    """A geometric planner of OMPL over place and time, whose paths the vehicle then follows by its own motions.

    The planner knows straight motions at constant speed (see `PlaceTime`), which no car drives; so what it proposes is
    a guide, the trajectory is what `Follower` drives along it, and cap, world, goal and bound are held by that. Where
    the vehicle cannot follow, another guide is asked for.
    """

    name: ClassVar[str]

    @abstractmethod
    def method(self, si: Any) -> Any:
        """OMPL's planner."""

    def search(self, problem: Problem, budget: Budget, seed: int) -> SearchResult:
        """Propose and follow until a trajectory arrives, or time is up."""
        held = capped(problem, budget, self.name)
        rng = np.random.default_rng(seed)
        ou.setLogLevel(ou.LogLevel.LOG_NONE)
        place_time = PlaceTime(held, rng)
        si, goals = space_information(place_time), place_time.goals(rng)
        follower = Follower(held, rng)
        counters = {"searches": 0, "guides": 0, "motions": 0, "checked_steps": 0}
        lowest, edges = np.inf, np.zeros((0, 5))
        states: Array | None = None
        patience = _FIRST
        while states is None and not budget.expired():
            if not goals:
                goals, budget.iterations = place_time.goals(rng), budget.iterations + 1
                continue
            ou.RNG.setSeed((seed + 7919 * counters["searches"]) % 2**31 + 1)
            guide = self._guide(si, place_time, goals, budget, patience)
            counters["searches"] += 1
            if guide is None:
                patience *= 2
                continue
            counters["guides"] += 1
            edges = np.column_stack([guide[:-1, :2], guide[1:, :2], guide[1:, 2]])
            driven = follower.follow(guide, budget)
            if driven is None:
                continue
            total = problem.evaluator.charge(
                driven[1:, :3], 1, problem.start_risk, np.inf, np.empty_like(held.start_risk)
            )
            total = problem.evaluator.confirmed(driven[:, :3], total)
            lowest = min(lowest, total)
            if total <= budget.limit and budget.found(total):
                states = driven
        counters["motions"] = place_time.motions + follower.motions
        counters["checked_steps"] = place_time.checked_steps + follower.checked_steps
        return SearchResult(states, lowest, counters, edges)

    def _guide(
        self,
        si: Any,
        place_time: PlaceTime,
        goals: list[tuple[float, float, float]],
        budget: Budget,
        patience: int,
    ) -> Array | None:
        """(N, 3) x, y, time from the start to the goal; None if time, iterations or patience ended first."""
        planner = self.method(si)
        pdef, goal = definition(si, place_time, goals)
        planner.setProblemDefinition(pdef)
        planner.setup()
        asked = after = 0

        def enough() -> bool:
            nonlocal asked, after
            asked, after = asked + 1, after + goal.reached
            return bool(asked > patience or after > _LONGER or budget.over())

        planner.solve(ob.PlannerTerminationCondition(enough))
        return simplified(si, place_time, pdef.getSolutionPath()) if pdef.hasExactSolution() else None


@dataclass(frozen=True)
class RrtConnectCapped(Capped):
    """RRT-Connect (Kuffner & LaValle 2000): without a total to carry, a tree may grow from the goal, too."""

    name: ClassVar[str] = "rrt-connect-capped"

    def method(self, si: Any) -> Any:
        """OMPL's planner."""
        return og.RRTConnect(si)


@dataclass(frozen=True)
class RrtStarCapped(Capped):
    """RRT* (Karaman & Frazzoli 2011) by length in place and time, which prefers constant speeds."""

    name: ClassVar[str] = "rrt-star-capped"

    def method(self, si: Any) -> Any:
        """OMPL's planner."""
        return og.RRTstar(si)


@dataclass(frozen=True)
class FmtCapped(Capped):
    """FMT* (Janson et al. 2015) by length in place and time.

    Attributes:
        samples: of place and time.
    """

    name: ClassVar[str] = "fmt-capped"
    samples: int = 1000

    def __post_init__(self) -> None:
        if not isinstance(self.samples, int) or isinstance(self.samples, bool) or self.samples < 1:
            raise InputError(f"fmt-capped: samples: expected an integer >= 1, got {self.samples!r}")

    def method(self, si: Any) -> Any:
        """OMPL's planner."""
        planner = og.FMT(si)
        planner.setNumSamples(self.samples)
        return planner
