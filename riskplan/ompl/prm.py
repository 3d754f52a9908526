"""`prm`: a roadmap sampled by OMPL, searched in time under the risk budget."""

from __future__ import annotations

import heapq
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np
from ompl import base as ob

from checkers import InputError
from checkers.validate import Array
from riskplan.kernels.roadmap import ARRIVALS, connect, expand, traverse
from riskplan.ompl.roadmap import EDGES, Roadmap, Sampler, edge_scale
from riskplan.ompl.validity import RiskMotionValidator
from riskplan.search import Budget, Problem, SearchResult
from riskplan.vehicles import curve_limits

_SAME_SPEED = 1.0  # labels at one vertex and step compete within this [m/s]
_KEPT = 4  # labels kept per vertex, step and speed
_LARGEST = 5000  # vertices: beyond, connecting takes longer than a search


@dataclass(frozen=True)
class Prm:
    """Probabilistic roadmap (Kavraki et al. 1996) with a time-expanded label search.

    OMPL's PRM samples the vertices; its undirected edges are not used. A label is a vertex at a grid step with a speed
    and the accumulated risk per agent and mode; an edge lasts a whole number of steps at constant acceleration. One
    label replaces another at the same vertex, step and speed if no component of its risk is higher. The roadmap is
    made larger while the search fails and time is left.

    Attributes:
        size: vertices at first.
        roadmap: one made earlier; None: a new one for each plan.
    """

    size: int = 300
    roadmap: Roadmap | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        if not isinstance(self.size, int) or isinstance(self.size, bool) or self.size < 2:
            raise InputError(f"prm: size: expected an integer >= 2, got {self.size!r}")
        if self.roadmap is not None and not isinstance(self.roadmap, Roadmap):
            raise InputError(f"prm: roadmap: expected a Roadmap, got {type(self.roadmap).__name__}")

    def search(self, problem: Problem, budget: Budget, seed: int) -> SearchResult:
        """Search the roadmap; enlarge and search again until the goal is reached in budget, or time is up."""
        rng = np.random.default_rng(seed)
        size, roadmap, sampler = self.size, self.roadmap, None
        if roadmap is not None and roadmap.radii.min() < 1.0 / curve_limits(problem.scenario.vehicle).curvature - 1e-9:
            roadmap = Roadmap.of(roadmap.vertices, *edge_scale(problem.scenario))  # made for a nimbler car
        best: SearchResult | None = None
        counters = {"vertices": 0, "edges": 0, "labels": 0, "checked_steps": 0, "roadmaps": 0}
        lowest = np.inf
        while True:
            began = perf_counter()
            if roadmap is None:
                sampler = sampler or Sampler(problem.scenario, problem.world, seed)
                roadmap = Roadmap.of(sampler.grow(size, budget.expired), *edge_scale(problem.scenario))
                budget.iterations += size
            built = perf_counter() - began
            query = _Query(problem, budget, roadmap, rng)
            result = query.run()
            lowest = min(lowest, result.lowest_seen)
            for key, value in result.counters.items():
                counters[key] = value if key in ("vertices", "edges") else counters[key] + value
            counters["roadmaps"] += 1
            if result.states is not None or best is None:
                best = result
            if budget.expired() or (best.states is not None and budget.bound is not None):
                break
            # larger at first; once large, or if a larger one would take what time is left, another one of that size
            before, size, roadmap = len(roadmap.vertices), 2 * max(size, len(roadmap.vertices)), None
            if size > _LARGEST or (not budget.counted and budget.left() < 8.0 * built):
                size, sampler, seed = min(before, _LARGEST), None, seed + 1
        return SearchResult(best.states, lowest, counters, best.edges)


class _Query:
    """One label search over a roadmap with start and goal attached."""

    def __init__(self, problem: Problem, budget: Budget, roadmap: Roadmap, rng: np.random.Generator) -> None:
        self.problem, self.budget = problem, budget
        s = problem.scenario
        self.validator = _motion_validator(problem)
        self.limits = np.array(curve_limits(s.vehicle))
        self.edges = _Edges(roadmap, np.array([problem.start_state[:3]]), _free_goals(problem, rng, 48))
        self.distance = problem.goal.box_distances(self.edges.poses[:, :2])

    def run(self) -> SearchResult:
        """Best-first over lazily judged labels: a child is driven and charged when it is taken, not when it is made."""
        p, budget = self.problem, self.budget
        goal, dt = p.goal, p.scenario.time_step
        out = np.empty((max(goal.latest, 1), 4))
        room = np.empty((11 * EDGES * ARRIVALS, 4))
        # state, step, vertex, risk, total, parent, driven poses
        labels: list[tuple[Array, int, int, Array, float, int, Array]] = []
        labels.append(
            (np.array(p.start_state), 0, self.edges.source, p.start_risk, p.start_total, -1, np.zeros((0, 4)))
        )
        seen: dict[tuple[int, int, int], list[Array]] = {}
        heap: list[tuple[float, float, int, int, int, int, float]] = []
        serial, checked, best, lowest = 0, 0, -1, np.inf

        def push(number: int) -> None:
            nonlocal serial
            state, step, vertex, _, total, _, _ = labels[number]
            ends, curves, lengths = self.edges.out_of(vertex)
            window, goals, pick = (goal.earliest, goal.latest), self.edges.goals, np.array([0, len(ends)])
            graph = (goals, pick, lengths, curves, dt, self.limits, ends, self.distance)
            count = expand(0, state[3], step, *window, *graph, room)
            for edge, steps, acceleration, key in room[:count].tolist():
                serial += 1
                rank = max(key, goal.earliest) if budget.bound is not None else _decade(total)
                entry = (
                    rank,
                    -min(step + steps, goal.latest),
                    serial,
                    number,
                    int(edge),
                    int(steps),
                    acceleration,
                )
                heapq.heappush(heap, entry)

        push(0)
        while heap and not budget.over():
            _, _, _, number, edge, steps, acceleration = heapq.heappop(heap)
            state, step, vertex, risk, total, _, _ = labels[number]
            if total > budget.limit:
                continue
            ends, curves, _ = self.edges.out_of(vertex)
            driven, arrived = traverse(
                *state,
                step,
                curves[edge],
                steps,
                acceleration,
                dt,
                goal.latest,
                goal.earliest,
                p.world.packed,
                goal.arrays,
                out,
            )
            if driven == 0 or (not arrived and step + driven >= goal.latest):
                continue
            after = np.empty_like(risk)
            limit = max(budget.limit, lowest) if arrived else budget.limit  # or while it may be the least risky seen
            total = self.validator.charge(out[:driven, :3], step + 1, risk, limit, after)
            checked += driven
            if arrived and total <= budget.limit:
                path = np.concatenate([_states(labels, number), out[:driven]])
                total = p.evaluator.confirmed(path[:, :3], total)
            if arrived:
                lowest = min(lowest, total)
            if not total <= budget.limit:
                continue
            vertex, end = int(ends[edge]), out[driven - 1].copy()
            key = vertex, step + driven, int(end[3] / _SAME_SPEED)
            if not arrived and not _undominated(seen, key, p.evaluator.levels(after)):
                continue
            labels.append((end, step + driven, vertex, after, total, number, out[:driven].copy()))
            if arrived:
                best = len(labels) - 1
                if budget.found(total):
                    break
            else:
                push(len(labels) - 1)
        counters = {
            "vertices": len(self.edges.poses),
            "edges": len(self.edges.roadmap.ends),
            "labels": len(labels),
            "checked_steps": checked,
        }
        return SearchResult(_states(labels, best), lowest, counters, self._edges(labels, dt))

    @staticmethod
    def _edges(labels: list[Any], dt: float) -> Array:
        rows = [(*labels[x[5]][0][:2], *x[0][:2], x[1] * dt) for x in labels[1:]]
        return np.array(rows).reshape(-1, 5)


class _Edges:
    """The roadmap's edges, and those from the start and into the goal, which are worked out where a search gets to.

    Attributes:
        poses: (V + G + 1, 3) of the roadmap's vertices, poses in the goal, and the start.
        goals: first and last + 1 of those in the goal; source: the start.
    """

    def __init__(self, roadmap: Roadmap, start: Array, goals: Array) -> None:
        self.roadmap = roadmap
        self.poses = np.concatenate([roadmap.vertices, goals, start])
        self.source = len(self.poses) - 1
        self.goals = (len(roadmap.vertices), self.source)
        self._known: dict[int, tuple[np.ndarray, Array, Array]] = {}

    def out_of(self, vertex: int) -> tuple[np.ndarray, Array, Array]:
        """Targets (E,), curves (E, 6) and lengths (E,) of the edges out of a vertex."""
        if vertex not in self._known:
            self._known[vertex] = self._from_start() if vertex == self.source else self._from(vertex)
        return self._known[vertex]

    def _from_start(self) -> tuple[np.ndarray, Array, Array]:
        r = self.roadmap
        ends, curves, lengths = connect(self.poses[-1:], self.poses[:-1], r.radii, 2.0, r.longest, 10 * EDGES)
        return np.ascontiguousarray(ends[:, 1]), curves, lengths

    def _from(self, vertex: int) -> tuple[np.ndarray, Array, Array]:
        r, (first, last) = self.roadmap, self.goals
        own = slice(r.rows[vertex], r.rows[vertex + 1]) if vertex < first else slice(0)
        ends, curves, lengths = connect(
            self.poses[vertex : vertex + 1], self.poses[first:last], r.radii, 2.0, r.longest, 8
        )
        ends = np.concatenate([r.ends[own, 1], ends[:, 1] + first])
        return ends, np.concatenate([r.curves[own], curves]), np.concatenate([r.lengths[own], lengths])


def _motion_validator(problem: Problem) -> RiskMotionValidator:
    """Over poses and time, which is where the roadmap's edges are driven."""
    space = ob.CompoundStateSpace()
    space.addSubspace(ob.SE2StateSpace(), 1.0)
    space.addSubspace(ob.TimeStateSpace(), 1.0)
    checker, evaluator = problem.evaluator.checker, problem.evaluator
    return RiskMotionValidator(
        ob.SpaceInformation(space), problem.scenario.agents, problem.ego, checker, evaluator=evaluator
    )


def _states(labels: list[Any], last: int) -> Array | None:
    if last < 0:
        return None
    parts = []
    while last >= 0:
        parts.append(labels[last][6] if labels[last][5] >= 0 else labels[last][0][None])
        last = labels[last][5]
    return np.concatenate(parts[::-1])


def _undominated(seen: dict[tuple[int, int, int], list[Array]], key: tuple[int, int, int], risk: Array) -> bool:
    """Keep the label unless one there is nowhere riskier, or enough are kept already."""
    others = seen.setdefault(key, [])
    for other in others:
        if (other <= risk).all():
            return False
    others[:] = [other for other in others if not (risk <= other).all()]
    if len(others) >= _KEPT:
        return False
    others.append(risk)
    return True


def _decade(total: float) -> float:
    """Risk in coarse classes, so that within a class the search goes deep first."""
    return float(np.floor(3.0 * np.log10(max(total, 1e-9))))


def _free_goals(problem: Problem, rng: np.random.Generator, count: int) -> Array:
    """Poses in the goal, free of the static world; may be fewer, or none."""
    poses: list[tuple[float, float, float]] = []
    for x, y, heading, speed, _ in problem.goal_samples(rng, 4 * count).tolist():
        if len(poses) == count:
            break
        if problem.goal.holds(x, y, heading, speed) and problem.world.free(x, y, heading):
            poses.append((x, y, heading))
    return np.array(poses).reshape(-1, 3)
