"""What every planner is given and gives back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from time import perf_counter
from typing import Any, Protocol

import numpy as np

from checkers import EgoShape
from checkers.validate import Array
from riskplan.evaluator import RiskEvaluator
from riskplan.scene import Scenario
from riskplan.world import PackedGoal, StaticWorld, pack_goal


@dataclass(frozen=True, eq=False)
class Problem:
    """A scenario with everything precomputed that a search reads."""

    scenario: Scenario
    evaluator: RiskEvaluator

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
        """x, y, heading, speed."""
        s = self.scenario.start
        return s.x, s.y, s.heading, s.speed

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
        s = self.scenario
        regions = [s.goal.regions[i] for i in rng.integers(len(s.goal.regions), size=count)]
        low = np.array([r.polygon.min(axis=0) for r in regions])
        high = np.array([r.polygon.max(axis=0) for r in regions])
        any_heading = rng.uniform(-np.pi, np.pi, count)
        heading = np.array([a if r.heading is None else r.heading for r, a in zip(regions, any_heading, strict=True)])
        top = max(s.vehicle.max_speed, s.start.speed)
        slow, fast = (np.minimum([r.speed[i] for r in regions], top) for i in range(2))
        steps = rng.uniform(self.goal.earliest, max(self.goal.latest, self.goal.earliest), count)
        return np.column_stack(
            [
                rng.uniform(low, high),
                (heading + np.pi) % (2 * np.pi) - np.pi,
                rng.uniform(slow, fast),
                steps * s.time_step,
            ]
        )


class Budget:
    """How much risk and time a search may still spend; shared by reference with the callbacks of one search.

    With a bound the first arrival within it ends the search. Without one every arrival lowers the limit, and the
    search goes on until the time is up.
    """

    def __init__(self, bound: float | None, time_limit: float, stop: Callable[[], bool] | None = None) -> None:
        self.bound = bound
        # agents are summed uncapped: where any risk will do, totals above 1 will too
        self.limit = np.inf if bound is None or bound >= 1.0 else bound
        self._end = perf_counter() + time_limit
        self._stop = stop

    def expired(self) -> bool:
        """Whether the time is up, or someone asked to stop."""
        return perf_counter() > self._end or (self._stop is not None and self._stop())

    def left(self) -> float:
        """Seconds left."""
        return self._end - perf_counter()

    def found(self, total: float) -> bool:
        """Report an arrival at this total risk; returns whether the search is over."""
        if self.bound is not None:
            return True
        self.limit = min(self.limit, total * (1.0 - 1e-3))
        return total <= 0.0


@dataclass(frozen=True, eq=False)
class SearchResult:
    """What a search found.

    Attributes:
        states: (T, 4) x, y, heading, speed on the grid, start included; None if the goal was not reached in budget.
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
