"""`rrt-star`: the first plan of `rrt`, made cheaper until the time limit, within the bound all along."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter
from typing import Any, ClassVar

import numpy as np

from checkers import InputError
from checkers.validate import Array, as_scalar
from riskplan.kernels.steer import STATE
from riskplan.ompl.cost import Price
from riskplan.ompl.rrt import Rrt, Tree
from riskplan.search import Budget, Problem, SearchResult

_POLISH = 400  # changes of the controls tried between two trees
_FIRST, _LONGEST = 300, 20_000  # motions of a tree: fewest and most
_WIDEST, _FINEST = 0.5, 0.01  # changes of a control in [−1, 1]


@dataclass(frozen=True)
class RrtStar:
    """Anytime planning by cost (AO-RRT; Hauser & Zhou 2016): trees under a ceiling that is the best cost so far.

    A node is kept only if the goal can still be reached from it below that ceiling. Between trees the controls of the
    best plan are changed at random, driven anew and kept if they cost less. What the cost is: `riskplan.ompl.cost`.
    Every node and every change is within the bound, by the same evaluator as in `rrt`.

    Attributes:
        motion_steps, goal_bias: as of `rrt`.
        comfort: seconds that a second of 1 m/s² is worth.
        risk_weight: seconds that a collision is worth.
    """

    motion_steps: int = 15
    goal_bias: float = 0.2
    comfort: float = 0.02
    risk_weight: float = 10.0

    anytime: ClassVar[bool] = True

    def __post_init__(self) -> None:
        try:
            Rrt(self.motion_steps, self.goal_bias)
        except InputError as error:
            raise InputError(str(error).replace("rrt:", "rrt-star:", 1)) from None
        for name in ("comfort", "risk_weight"):
            object.__setattr__(self, name, as_scalar(f"rrt-star: {name}", getattr(self, name), low=0.0))

    def search(self, problem: Problem, budget: Budget, seed: int) -> SearchResult:
        """Plan, then improve until time or iterations are used up."""
        began = perf_counter()
        rng = np.random.default_rng(seed)
        price = Price(problem, self.comfort, self.risk_weight)
        rrt = Rrt(self.motion_steps, self.goal_bias)
        best: _Line | None = None
        improvement: list[tuple[float, float]] = []
        counters = {"nodes": 0, "motions": 0, "checked_steps": 0, "trees": 0, "changes": 0}
        lowest, length, edges = np.inf, np.inf, np.zeros((0, 5))
        while not budget.expired():
            tree = rrt.grow(problem, _Share(budget, length), (seed + 7919 * counters["trees"]) % 2**31, price)
            counters["trees"] += 1
            result = tree.result()
            for key, value in result.counters.items():
                counters[key] += value
            lowest = min(lowest, result.lowest_seen)
            edges = result.edges if best is None or len(result.edges) > len(edges) else edges
            line = _Line.of(tree, price)
            if line is not None and line.cost < price.ceiling:
                best, price.ceiling, length = line, line.cost, _FIRST
                improvement.append((perf_counter() - began, line.cost))
            elif best is not None:
                length = min(2 * length, _LONGEST)
            if best is not None:
                best = self._polished(
                    best, tree, price, budget, rng, counters, lambda: perf_counter() - began, improvement
                )
        told: dict[str, Any] = {**counters, "improvement": improvement}
        if best is None:
            return SearchResult(None, lowest, told, edges)
        return SearchResult(best.states, min(lowest, best.total), {**told, "cost": best.cost}, edges)

    def _polished(
        self,
        best: _Line,
        tree: Tree,
        price: Price,
        budget: Budget,
        rng: np.random.Generator,
        counters: dict[str, int],
        clock: Any,
        improvement: list[tuple[float, float]],
    ) -> _Line:
        """The best of a row of changes, wide ones after a success and finer ones after failures."""
        width = 0.5 * _WIDEST
        for _ in range(_POLISH):
            if budget.over():
                break
            counters["changes"] += 1
            other = best.changed(tree, price, rng, width)
            if other is not None and other.cost < best.cost:
                best, price.ceiling = other, other.cost
                improvement.append((clock(), best.cost))
                width = min(1.5 * width, _WIDEST)
            else:
                width = max(0.98 * width, _FINEST)
        return best


@dataclass(frozen=True, eq=False)
class _Line:
    """A trajectory that arrives: motion by motion the node it starts from, its risk so far, and its controls.

    The first `given` motions were not made by controls.
    """

    nodes: Array
    risks: Array
    controls: Array
    given: int
    parts: list[Array]
    total: float
    cost: float

    @property
    def states(self) -> Array:
        """(T, 5) start included."""
        return np.concatenate([self.nodes[:1, :STATE], *self.parts])

    @classmethod
    def of(cls, tree: Tree, price: Price) -> _Line | None:
        """The arrival of a tree."""
        if tree.best is None:
            return None
        numbers = [tree.best[0]]
        while tree.parent[numbers[-1]] >= 0:
            numbers.append(int(tree.parent[numbers[-1]]))
        numbers.reverse()
        begun, driven = numbers[:-1], numbers[1:]
        parts = [tree.poses[i] for i in driven]
        states = np.concatenate([tree.nodes[:1, :STATE], *parts])
        total = float(tree.total[driven[-1]])
        given = sum(i not in tree.controls for i in driven)  # all at the start
        controls = np.array([tree.controls.get(i, (0.0, 0.0, 0.0)) for i in driven])
        nodes, risks = tree.nodes[begun].copy(), tree.risk[begun].copy()
        return cls(nodes, risks, controls, given, parts, total, price.of(states, total))

    def changed(self, tree: Tree, price: Price, rng: np.random.Generator, width: float) -> _Line | None:
        """The same with other controls from some motion on; None if it does not arrive in the limit, or costs more."""
        if self.given == len(self.controls):
            return None
        first = int(rng.integers(self.given, len(self.controls)))
        controls = self.controls.copy()
        some = slice(first, first + int(rng.integers(1, len(controls) - first + 1)))
        controls[some] = np.clip(controls[some] + width * rng.standard_normal(controls[some].shape), -1.0, 1.0)
        nodes, risks = [*self.nodes[: first + 1]], [*self.risks[: first + 1]]
        parts = self.parts[:first]
        for i in range(first, len(controls) + 1):
            u = controls[min(i, len(controls) - 1)]
            driven = tree.drive(nodes[i], risks[i], u)
            if driven is None:
                return None
            part, node, after, total, arrived = driven
            parts = [*parts, part]
            if arrived:
                states = np.concatenate([self.nodes[:1, :STATE], *parts])
                cost = price.of(states, total)
                if cost >= self.cost:
                    return None
                total = tree.problem.evaluator.confirmed(states[:, :3], total)
                cost = price.of(states, total)
                if not (total <= tree.budget.limit and cost < self.cost):
                    return None
                used = np.concatenate([controls, controls[-1:]])[: i + 1]
                return _Line(np.array(nodes), np.array(risks), used, self.given, parts, total, cost)
            nodes.append(node)
            risks.append(after)
        return None


class _Share(Budget):
    """Part of a search's budget for one tree, which ends with its first arrival, whatever the bound."""

    def __init__(self, whole: Budget, iterations: float) -> None:
        super().__init__(whole.bound, np.inf)
        self.limit = whole.limit
        self._whole, self._left = whole, iterations

    def over(self) -> bool:
        self._left -= 1
        return self._left < 0 or self._whole.over()

    def expired(self) -> bool:
        return self._left < 0 or self._whole.expired()

    def found(self, total: float) -> bool:
        del total
        return True
