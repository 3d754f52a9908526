"""What every planner is given and gives back."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from time import perf_counter
from typing import Any, Protocol

import numpy as np

from checkers import EgoShape
from checkers.validate import Array
from riskplan.evaluator import RiskEvaluator
from riskplan.scene import Scenario
from riskplan.world import PackedGoal, StaticWorld, pack_goal

_WAIT = 64  # arrivals above the limit whose risk is worked out only at the end


@dataclass(frozen=True, eq=False)
class Problem:
    """A scenario with everything precomputed that a search reads.

    Attributes:
        scenario: what is planned for.
        evaluator: of its agents.
        begun: (S, 5) states after the start on the grid, x, y, heading, speed, steering, that a search may begin from
            too, driven from the start one after the other: what is left of an earlier plan.
    """

    scenario: Scenario
    evaluator: RiskEvaluator
    begun: Array = field(default_factory=lambda: np.zeros((0, 5)))

    @property
    def world(self) -> StaticWorld:
        """Static world."""
        return self.scenario.world

    @cached_property
    def goal(self) -> PackedGoal:
        """Goal regions and window."""
        return pack_goal(self.scenario)

    @property
    def ego(self) -> EgoShape:
        """Shape of the ego."""
        return self.evaluator.ego

    @property
    def start_state(self) -> tuple[float, float, float, float]:
        """x, y, heading within [−π, π], which is where OMPL's spaces end, speed."""
        s = self.scenario.start
        heading = s.heading if abs(s.heading) <= math.pi else math.remainder(s.heading, 2.0 * math.pi)
        return s.x, s.y, heading, s.speed

    @property
    def start_node(self) -> tuple[float, float, float, float, float]:
        """x, y, heading, speed, steering."""
        return *self.start_state, self.scenario.start.steering

    @cached_property
    def _start(self) -> tuple[Array, float]:
        return self.evaluator.start(np.array(self.start_state[:3]))

    @property
    def start_risk(self) -> Array:
        """Accumulators at the start."""
        return self._start[0]

    @property
    def start_total(self) -> float:
        """Risk at the start."""
        return self._start[1]

    def goal_samples(self, rng: np.random.Generator, count: int) -> Array:
        """(count, 5) x, y, heading, speed, time in the goal regions' boxes: directions to pull, not promises."""
        s, goal = self.scenario, self.goal
        which = rng.integers(len(goal.boxes), size=count)
        boxes, (wanted, _, slowest, fastest) = goal.boxes[which], goal.terms[which].T
        any_heading = rng.uniform(-np.pi, np.pi, count)
        heading = np.where(np.isnan(wanted), any_heading, wanted)
        top = max(s.vehicle.top_speed, s.start.speed)
        steps = rng.uniform(goal.earliest, max(goal.latest, goal.earliest), count)
        return np.column_stack(
            [
                rng.uniform(boxes[:, :2], boxes[:, 2:]),
                (heading + np.pi) % (2 * np.pi) - np.pi,
                rng.uniform(np.minimum(slowest, top), np.minimum(fastest, top)),
                steps * s.time_step,
            ]
        )


class Budget:
    """How much risk, time and work a search may still spend; shared by reference with the callbacks of one search.

    With a bound the first arrival within it ends the search. Without one every arrival lowers the limit, and the
    search goes on until its time or its iterations are used up.

    Attributes:
        bound: stated for the total risk; limit: what a search may go up to at present.
        iterations: done so far; a motion of a tree, a label of a roadmap, or a vertex of one.
        counted: whether iterations are limited: then no decision may depend on the clock.
        ended_by: "plan", "time", "iterations" or "stop".
    """

    def __init__(
        self,
        bound: float | None,
        time_limit: float,
        stop: Callable[[], bool] | None = None,
        iterations: int | None = None,
    ) -> None:
        self.bound = bound
        # agents are summed uncapped: where any risk will do, totals above 1 will too
        self.limit = np.inf if bound is None or bound >= 1.0 else bound
        self.iterations, self.counted, self.ended_by = 0, iterations is not None, "plan"
        self._most = np.inf if iterations is None else iterations
        self._end = perf_counter() + time_limit
        self._stop = stop

    def over(self) -> bool:
        """Whether the search has to end before its next iteration, which is counted."""
        if self.expired():
            return True
        self.iterations += 1
        return False

    def expired(self) -> bool:
        """Whether time or iterations are used up, or someone asked to stop."""
        if self.iterations >= self._most:
            self.ended_by = "iterations"
        elif perf_counter() > self._end:
            self.ended_by = "time"
        elif self._stop is not None and self._stop():
            self.ended_by = "stop"
        else:
            return False
        return True

    def left(self) -> float:
        """Seconds left."""
        return self._end - perf_counter()

    def found(self, total: float) -> bool:
        """Report an arrival at this total risk; returns whether the search is over."""
        if self.bound is not None:
            return True
        self.limit = min(self.limit, total * (1.0 - 1e-3))
        return total <= 0.0


class LowestSeen:
    """The least risk of the arrivals of a search, also of those above its limit.

    A risk that is above the limit takes long to work out, and is told only where there is no plan: the first of them
    wait until somebody asks.
    """

    def __init__(self, charge: Callable[[Array, int, Array, float, Array], float], budget: Budget) -> None:
        self._charge, self._budget = charge, budget
        self._lowest, self._count = np.inf, 0
        self._waiting: list[tuple[Array, int, Array]] = []

    @property
    def limit(self) -> float:
        """Up to where the next arrival is to be charged."""
        return self._budget.limit if self._count < _WAIT else max(self._budget.limit, self.lowest)

    def saw(self, total: float) -> None:
        """Report the risk of an arrival."""
        self._lowest = min(self._lowest, total)

    def above(self, total: float, poses: Array, first_step: int, before: Array) -> None:
        """Report an arrival that was charged up to `limit` and is above the search's: what was charged, and how far."""
        if self._count >= _WAIT:
            self.saw(total)
        elif total == total:
            self._waiting.append((poses.copy(), first_step, before))
            self._count += 1

    @property
    def lowest(self) -> float:
        """Least total risk of any arrival so far; infinite if there was none."""
        while self._waiting:
            poses, first_step, before = self._waiting.pop(0)
            total = self._charge(poses, first_step, before, self._lowest, np.empty_like(before))
            self.saw(total)
        return self._lowest


@dataclass(frozen=True, eq=False)
class SearchResult:
    """What a search found.

    Attributes:
        states: (T, 4) x, y, heading, speed on the grid, or (T, 5) with the steering angle, start included; None if the
            goal was not reached in budget.
        lowest_seen: least total risk of any arrival seen, also above the bound; infinite if there was none.
        counters: of the planner.
        edges: (E, 5) of tree or roadmap: x0, y0, x1, y1, time.
    """

    states: Array | None
    lowest_seen: float
    counters: dict[str, Any]
    edges: Array


class Planner(Protocol):
    """A planner is a frozen value (its fields are its options) with one method."""

    def search(self, problem: Problem, budget: Budget, seed: int) -> SearchResult:
        """Look for a trajectory to the goal whose total risk is within `budget.limit`."""
