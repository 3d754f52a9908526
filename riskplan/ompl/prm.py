"""`prm`: a roadmap sampled by OMPL, searched in time under the risk budget."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice
from time import perf_counter
from typing import NamedTuple

import numpy as np
from ompl import base as ob

from checkers import InputError
from checkers.validate import Array
from riskplan.kernels.roadmap import CHILD, CHILDREN, TURNS, expand, traverse
from riskplan.ompl.attached import AttachedEdges, free_goals
from riskplan.ompl.roadmap import EDGES, Roadmap, Sampler, about
from riskplan.ompl.validity import RiskMotionValidator
from riskplan.scene import Scenario
from riskplan.search import Budget, LowestSeen, Problem, SearchResult
from riskplan.vehicles import curve_limits

_SAME_SPEED = 1.0  # labels at one vertex and step compete within this [m/s]
TOGETHER = 5  # arrivals within so many steps are alike
_FAILURES = 0.3  # children of a label that fail put the others back by a step
_UNCONNECTED = 500  # labels made on a roadmap that does not lead to the goal
_KEPT = 4  # labels kept per vertex, step and speed
_SAFER = 0.3  # without a bound: share of the least risk seen that is looked for next
_LAST = 1e9  # rank of what is riskier, above all times
_SHARE, _GIVEN = 5, 20  # labels per vertex that are taken from the queue in the first round; of a roadmap that is kept
_LONGEST = 10**9  # labels of one round at most
_MORE = 4  # times as many in each further one
_LARGEST = 5000  # vertices: beyond, connecting takes longer than a search


# one step of a search at a time, as long as it may go on
Search = Iterator[None]


@dataclass(frozen=True)
class Prm:
    """Probabilistic roadmap (Kavraki et al. 1996) with a time-expanded label search.

    OMPL's PRM samples the vertices; its undirected edges are not used. A label is a place on an edge at a grid step,
    with a speed and the accumulated risk per agent and mode; the acceleration is chosen anew where an edge ends, where
    the ego stands, and after 15 steps. One label replaces another at the same vertex, step and speed if no component of
    its risk is higher. Larger roadmaps are searched by turns with the first while none leads to the goal and time is
    left. A vehicle that reverses can stop at vertices too, and goes on from there either way.

    Attributes:
        size: vertices at first.
        roadmap: one made earlier; None: a new one for each plan.
    """

    size: int = 150
    roadmap: Roadmap | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        check_options("prm", self.size, self.roadmap)

    def search(self, problem: Problem, budget: Budget, seed: int) -> SearchResult:
        """Search roadmaps, each larger than the one before, until the goal is reached in budget, or time is up."""
        return search_roadmaps(self.size, self.roadmap, (problem, budget, seed), Query.run)


def check_options(name: str, size: int, roadmap: Roadmap | None) -> None:
    """Refuse what is no size or no roadmap."""
    if not isinstance(size, int) or isinstance(size, bool) or size < 2:
        raise InputError(f"{name}: size: expected an integer >= 2, got {size!r}")
    if roadmap is not None and not isinstance(roadmap, Roadmap):
        raise InputError(f"{name}: roadmap: expected a Roadmap, got {type(roadmap).__name__}")


def search_roadmaps(
    size: int, roadmap: Roadmap | None, task: tuple[Problem, Budget, int], search_on: Callable[[Query], Search]
) -> SearchResult:
    """Search roadmaps in turn, the given one first, until the goal is reached in budget, or time is up.

    In every round one roadmap more is made, and each goes on with its search for several times as many labels as in the
    round before: no roadmap waits until another's labels run out, and the first of them loses little to the others.
    """
    problem, budget, seed = task
    rng = np.random.default_rng(seed)
    sampler: Sampler | None = None
    roadmap = _drivable(roadmap, problem.scenario, budget)
    lowest_seen = LowestSeen(problem.evaluator.charge, budget)
    queries: list[Query] = []
    going: list[tuple[Query, Search]] = []
    best, share = 0, 0 if roadmap is None else _GIVEN * max(len(roadmap.vertices), 1)
    while not queries or not budget.expired():
        began = perf_counter()
        if roadmap is None:
            sampler = sampler or Sampler(problem.scenario, problem.world, seed)
            roadmap = Roadmap.of(problem.scenario, sampler.grow(size, budget.expired), budget.expired)
            budget.iterations += size
        query = Query(problem, budget, roadmap, rng, lowest_seen)
        queries.append(query)
        going.append((query, search_on(query)))
        built = perf_counter() - began
        share, still = share or _SHARE * max(len(roadmap.vertices), 1), []
        for each, search in going:
            arrived = each.best
            if sum(1 for _ in islice(search, share)) == share:
                still.append((each, search))
            if each.best != arrived:
                best = queries.index(each)
                if budget.bound is not None:
                    return _result(queries, best, lowest_seen)
        going, share = still, min(_MORE * share, _LONGEST)
        # larger at first; once large, or if a larger one would take what time is left, another one of that size
        before, size, roadmap = len(roadmap.vertices), 2 * max(size, len(roadmap.vertices)), None
        if size > _LARGEST or (not budget.counted and budget.left() < 8.0 * built):
            size, sampler, seed = min(before, _LARGEST), None, seed + 1
    return _result(queries, best, lowest_seen)


def _drivable(roadmap: Roadmap | None, scenario: Scenario, budget: Budget) -> Roadmap | None:
    """The roadmap; connected anew if it was made for a nimbler vehicle, or for one that does not reverse."""
    limits = curve_limits(scenario.vehicle)
    if roadmap is None or (
        roadmap.radii.min() >= 1.0 / limits.curvature - 1e-9
        and not (limits.reverse > 0.0 and roadmap.forwards == len(roadmap.ends))
    ):
        return roadmap
    return Roadmap.of(scenario, roadmap.vertices, budget.expired)


def _result(queries: list[Query], best: int, lowest_seen: LowestSeen) -> SearchResult:
    """What that query found, and what all of them saw and did."""
    counters = {
        "vertices": queries[best].edges.count,
        "edges": len(queries[best].edges.roadmap.ends),
        "labels": sum(len(q.labels) for q in queries),
        "checked_steps": sum(q.checked for q in queries),
        "roadmaps": len(queries),
    }
    found = queries[best]
    lowest = found.labels[found.best].total if found.best >= 0 else lowest_seen.lowest
    return SearchResult(found.way, lowest, counters, found.tree)


class Label(NamedTuple):
    """The ego at a step of the grid, on the way along an edge.

    Attributes:
        pose: (3,) the last that is known: at this step, or the step before if `pending`.
        vertex: where its edges begin, which tells whether they are driven backwards, at a negative speed.
        edge: the one it is on, or −1 for any of them.
        place: beyond the vertex [m]; pending: whether the pose at this step lies on the edge that is chosen next.
        fastest: speed within the last step; poses: (S, 4) driven since the parent, x, y, heading, speed.
    """

    pose: Array
    speed: float
    step: int
    vertex: int
    edge: int
    place: float
    pending: bool
    fastest: float
    risk: Array
    total: float
    parent: int
    poses: Array

    @property
    def key(self) -> tuple[int, int, int, int, int]:
        """Labels with the same compete; one that stands at its vertex may turn."""
        place = int(self.place) if self.edge >= 0 else -1 if self.speed == 0.0 and not self.pending else 0
        return self.vertex, self.edge, self.step, int(self.speed / _SAME_SPEED), place


class _Way(NamedTuple):
    """What the kernels read of driving one way, forwards or backwards: limits, and the goal as it looks from there."""

    limits: Array
    goal: tuple[np.ndarray, Array, Array, Array]


def _about(goal: tuple[np.ndarray, Array, Array, Array]) -> tuple[np.ndarray, Array, Array, Array]:
    """The goal of the same vehicle turned round that drives forwards."""
    start, vertices, boxes, terms = goal
    wanted, tolerance, slowest, fastest = terms.T
    return start, vertices, boxes, np.column_stack([wanted + np.pi, tolerance, -fastest, -slowest])


class Query:
    """One label search over a roadmap with start and goal attached."""

    def __init__(
        self,
        problem: Problem,
        budget: Budget,
        roadmap: Roadmap,
        rng: np.random.Generator,
        lowest_seen: LowestSeen,
    ) -> None:
        self.problem, self.budget = problem, budget
        self.validator = _motion_validator(problem)
        limits = curve_limits(problem.scenario.vehicle)
        top = max(limits.speed, limits.reverse)
        self.ways = [_Way(np.array([*limits[:5], top]), problem.goal.arrays)]
        if limits.reverse > 0.0:
            backwards = limits._replace(speed=limits.reverse)
            self.ways.append(_Way(np.array([*backwards[:5], top]), _about(problem.goal.arrays)))
        self.edges = AttachedEdges(problem, roadmap, free_goals(problem, rng, 48))
        self.out = np.empty((problem.goal.latest + 2, 4))
        self.room = np.empty((10 * EDGES * CHILDREN + 2, CHILD))
        # where no edges lead to the goal one may pass it on the way; more vertices are the better bet
        self.most = np.inf if self.edges.connected else _UNCONNECTED
        pose, speed, nothing = np.array(problem.start_state[:3]), problem.start_state[3], np.zeros((0, 4))
        source = self.edges.turned(self.edges.source) if speed < 0.0 else self.edges.source
        start = (pose, speed, 0, source, -1, 0.0, False, abs(speed))
        self.labels = [Label(*start, problem.start_risk, problem.start_total, -1, nothing)]
        self.lowest_seen = lowest_seen
        self.checked, self.best = 0, -1

    def run(self) -> Search:
        """Best-first over lazily judged labels: a child is driven and charged when it is taken, not when it is made."""
        p, budget = self.problem, self.budget
        seen: dict[tuple[int, ...], list[Array]] = {}
        heap: list[tuple[float, float, int]] = []  # of labels, by the best of their children that are left
        left: dict[int, list[tuple[float, float, int, list[float]]]] = {}  # these, the best last
        failed: dict[int, int] = {}
        aim = np.inf

        def ranked(number: int, children: Iterable[list[float]]) -> None:
            label = self.labels[number]
            rank = None if label.total <= aim else _LAST + _decade(label.total)
            left[number] = sorted(
                (
                    (
                        child[3] // TOGETHER if rank is None else rank,
                        -min(label.step + child[1], p.goal.latest),
                        order,
                        child,
                    )
                    for order, child in enumerate(children)
                ),
                reverse=True,
            )

        def push(number: int) -> None:
            if left[number]:
                rank, tie, *_ = left[number][-1]
                # deep first, but not where one way after the other fails
                heapq.heappush(heap, (rank, tie + failed.get(number, 0) / _FAILURES, number))

        ranked(0, self.children(self.labels[0]))
        push(0)
        while heap and len(self.labels) < self.most and not budget.over():
            yield
            number = heapq.heappop(heap)[2]
            if self.labels[number].total > budget.limit:
                continue
            child = left[number].pop()[3]
            driven = self.driven(number, child)
            judged = None if driven is None else self.charged(*driven)
            if driven is None or judged is None:
                failed[number] = failed.get(number, 0) + 1
                push(number)
                continue
            push(number)
            label, arrived = judged, driven[1]
            if not arrived and not _undominated(seen, label.key, p.evaluator.levels(label.risk)):
                continue
            self.labels.append(label)
            if arrived:
                self.best = len(self.labels) - 1
                if budget.found(label.total):
                    return
                # without a bound: much safer ones next, as if they were the first, and then by risk
                aim = _SAFER * label.total
                heap.clear()
                for each, rows in left.items():
                    ranked(each, [row[3] for row in sorted(rows, key=lambda row: row[2])])
                    push(each)
                seen.clear()
            else:
                ranked(len(self.labels) - 1, self.children(label))
                push(len(self.labels) - 1)

    @property
    def way(self) -> Array | None:
        """(T, 4) to the last arrival, the least risky one; None if there is none."""
        return states_to(self.labels, self.best) if self.best >= 0 else None

    def children(self, label: Label) -> list[list[float]]:
        """Rows of `expand`."""
        goal = self.problem.goal
        edges, turned = self.edges.out_of(label.vertex), -1.0
        if len(self.ways) > 1:
            turns = label.edge < 0 and not label.pending
            turned = self.edges.road[self.edges.turned(label.vertex)] if turns else np.inf
        chosen = (0, len(edges.lengths)) if label.edge < 0 else (label.edge, label.edge + 1)
        here = max(self.edges.road[label.vertex] - label.place, 0.0)
        graph = edges.lengths, edges.curves, edges.final, edges.away, edges.road
        fixed = self.problem.scenario.time_step, self.ways[self._way(label)].limits, self.room
        count = expand(chosen, self.row(label), here, turned, (goal.earliest, goal.latest), *graph, *fixed)
        rows: list[list[float]] = self.room[:count].tolist()
        return rows

    def _way(self, label: Label) -> int:
        """Whether it is driven backwards."""
        return int(label.vertex >= self.edges.count)

    def row(self, label: Label) -> Array:
        """The label as the kernels read it, to whom all driving is forwards."""
        x, y, heading = label.pose
        speed = label.speed
        if self._way(label):
            heading, speed = heading + math.pi, -speed
        return np.array([x, y, heading, speed, label.place, label.step, label.pending, label.fastest])

    def driven(self, number: int, child: Sequence[float]) -> tuple[Label, bool] | None:
        """The label at the end of a child, not charged, and whether it arrived; None if the world is in the way."""
        label, edge = self.labels[number], int(child[0])
        poses, arrived = self._waited(label, int(child[1])) if edge < 0 else self._traversed(label, child)
        step = label.step + int(child[1])
        if poses is None or (not arrived and step > self.problem.goal.latest):
            return None
        pose = poses[-1, :3] if len(poses) else label.pose
        vertex, place, pending = label.vertex, child[4], child[6] > 0.0
        speed = -child[5] if child[5] > 0.0 and self._way(label) else child[5]
        if pending or child[8] > 0.0:
            vertex, edge = int(self.edges.out_of(vertex).ends[edge]), -1
        elif edge < 0:
            vertex, edge = self.edges.turned(vertex) if edge == TURNS else vertex, label.edge
        after = (pose, speed, step, vertex, edge, place, pending, child[7])
        return Label(*after, label.risk, label.total, number, poses), arrived

    def charged(self, label: Label, arrived: bool) -> Label | None:
        """The label with the risk of the way to it, as its parent has; None if that is above the limit."""
        parent, poses = self.labels[label.parent], np.ascontiguousarray(label.poses[:, :3])
        risk, total, first = parent.risk, parent.total, parent.step + (0 if parent.pending else 1)
        if len(poses):
            risk = np.empty_like(parent.risk)
            limit = self.lowest_seen.limit if arrived else self.budget.limit
            total = self.validator.charge(poses, first, parent.risk, limit, risk)
            self.checked += len(poses)
        if arrived and total <= self.budget.limit:
            path = states_to([*self.labels, label], len(self.labels))
            total = self.problem.evaluator.confirmed(path[:, :3], total)
            self.lowest_seen.saw(total)
        elif arrived:
            self.lowest_seen.above(total, poses, first, parent.risk)
        return label._replace(risk=risk, total=total) if total <= self.budget.limit else None

    def _traversed(self, label: Label, child: Sequence[float]) -> tuple[Array | None, bool]:
        p, edges, edge, way = self.problem, self.edges.out_of(label.vertex), int(child[0]), self._way(label)
        along = (
            self.edges.poses[label.vertex],
            edges.curves[edge],
            edges.lengths[edge],
            np.array(child),
            self.row(label),
        )
        grid = p.scenario.time_step, p.goal.latest, p.goal.earliest, self.ways[way].limits
        driven, arrived = traverse(*along, *grid, p.world.packed, self.ways[way].goal, self.out)
        if driven < 0:
            return None, False
        poses = self.out[:driven].copy()
        if way:
            poses[:, :3], poses[:, 3] = about(poses), 0.0 - poses[:, 3]
        return poses, arrived

    def _waited(self, label: Label, steps: int) -> tuple[Array, bool]:
        goal = self.problem.goal
        poses = np.tile(np.append(label.pose, 0.0), (steps, 1))
        if not steps:
            return poses, False
        soonest = max(goal.earliest - label.step, 1)
        if soonest <= steps and goal.holds(*poses[0].tolist()):
            return poses[:soonest], True
        return poses, False

    @property
    def tree(self) -> Array:
        """(E, 5) x0, y0, x1, y1, time of its labels."""
        dt = self.problem.scenario.time_step
        rows = [(*self.labels[x.parent].pose[:2], *x.pose[:2], x.step * dt) for x in self.labels[1:]]
        return np.array(rows).reshape(-1, 5)


def _motion_validator(problem: Problem) -> RiskMotionValidator:
    """Over poses and time, which is where the roadmap's edges are driven."""
    space = ob.CompoundStateSpace()
    space.addSubspace(ob.SE2StateSpace(), 1.0)
    space.addSubspace(ob.TimeStateSpace(), 1.0)
    checker, evaluator = problem.evaluator.checker, problem.evaluator
    return RiskMotionValidator(
        ob.SpaceInformation(space), problem.scenario.agents, problem.ego, checker, evaluator=evaluator
    )


def states_to(labels: list[Label], last: int) -> Array:
    """(T, 4) from the start to a label."""
    parts: list[Array] = []
    while labels[last].parent >= 0:
        parts.append(labels[last].poses)
        last = labels[last].parent
    start = labels[last]
    return np.concatenate([np.append(start.pose, start.speed)[None], *parts[::-1]])


def _undominated(seen: dict[tuple[int, ...], list[Array]], key: tuple[int, ...], risk: Array) -> bool:
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
