"""The edges of one query: a roadmap's, and those that attach a start and a goal to it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from checkers.validate import Array
from riskplan.kernels.roadmap import connect
from riskplan.ompl.roadmap import EDGES, Roadmap, about
from riskplan.search import Problem
from riskplan.vehicles import curve_limits

_TURN = 5.0  # to change direction is as long as [m]


class Out(NamedTuple):
    """Edges out of a vertex: targets, curves, lengths, whether they end in a goal pose.

    And, from there to the goal, a lower bound of the distance and the way along the roadmap.
    """

    ends: np.ndarray
    curves: Array
    lengths: Array
    final: np.ndarray
    away: Array
    road: Array


class AttachedEdges:
    """The roadmap's edges, and those from the start and into the goal.

    Attributes:
        poses: (N, 3) of the roadmap's vertices, poses in the goal, and the start; with edges that are driven backwards
            (2 N, 3): the same turned round follow, at which one is when driving backwards.
        count: N.
        source: the start's number.
        distance: (N,) or (2 N,) from there to the goal at least.
        road: the same, way along edges to the goal [m]; where there is none a guess, longer than any.
        connected: whether edges lead from the start to the goal.
    """

    def __init__(self, problem: Problem, roadmap: Roadmap, goals: Array) -> None:
        r, start = roadmap, np.array([problem.start_state[:3]])
        self.roadmap, self._goals = roadmap, len(goals)
        self.source = len(r.vertices) + len(goals)
        self.count, forwards = self.source + 1, np.concatenate([r.vertices, goals, start])
        ways = [forwards, about(forwards)] if curve_limits(problem.scenario.vehicle).reverse else [forwards]
        self.poses = np.concatenate(ways)
        self.distance = problem.goal.box_distances(self.poses[:, :2])
        own = r.ends + np.where(r.ends < len(r.vertices), 0, 1 + len(goals)), r.curves, r.lengths
        parts = [tuple(part[: None if len(ways) > 1 else r.forwards] for part in own)]
        for way, poses in enumerate(ways):
            parts.extend(self._attached(poses, way * self.count, problem))
        ends, self._curves, self._lengths = (np.concatenate(part) for part in zip(*parts, strict=True))
        order = np.argsort(ends[:, 0], kind="stable")
        self._ends, self._curves, self._lengths = ends[order], self._curves[order], self._lengths[order]
        self._rows = np.searchsorted(self._ends[:, 0], np.arange(len(self.poses) + 1))
        road = self._along()
        self.connected = bool(np.isfinite(road[self.source]))
        known = road[np.isfinite(road)].max(initial=0.0)
        self.road = np.where(np.isfinite(road), road, known + self.distance)
        self._known: dict[int, Out] = {}

    def _attached(self, poses: Array, number: int, problem: Problem) -> Iterator[tuple[np.ndarray, Array, Array]]:
        """(ends, curves, lengths) of edges into the goal and from the start, one way."""
        r, first = self.roadmap, len(self.roadmap.vertices)
        scale = r.radii, r.shortest, r.longest
        slowest, fastest = problem.goal.terms[:, 2].min(), problem.goal.terms[:, 3].max()
        # edges into a goal that is not to be entered this way round would lead the search astray
        goals = poses[first : self.source if (slowest <= 0.0 if number else fastest >= 0.0) else first]
        into, _, *last = connect(poses[:first], goals, *scale, 8, problem.world.packed)
        yield into + [number, number + first], *last
        out, _, *begun = connect(poses[self.source :], poses[: self.source], *scale, 10 * EDGES, problem.world.packed)
        yield out + [number + self.source, number], *begun

    def _along(self) -> Array:
        """Shortest ways to a pose in the goal, infinite where there is none."""
        size = len(self.poses)
        goals = np.flatnonzero(self._final(np.arange(size)))
        # edges the other way, and from one more vertex to every goal pose
        tails = np.concatenate([self._ends[:, 1], np.full(len(goals), size)])
        heads = np.concatenate([self._ends[:, 0], goals])
        lengths = np.concatenate([self._lengths, np.full(len(goals), 1e-9)])
        if size > self.count:
            each = np.arange(size)
            tails, heads = np.concatenate([tails, each]), np.concatenate([heads, (each + self.count) % size])
            lengths = np.concatenate([lengths, np.full(size, _TURN)])
        graph = csr_matrix((lengths, (tails, heads)), shape=(size + 1, size + 1))
        ways: Array = dijkstra(graph, indices=np.array([size]))[0, :size]
        return ways

    def _final(self, vertices: np.ndarray) -> np.ndarray:
        """Which of them are poses in the goal."""
        place = vertices % self.count
        return (place >= self.source - self._goals) & (place < self.source)

    def turned(self, vertex: int) -> int:
        """The vertex driven through the other way."""
        return (vertex + self.count) % len(self.poses)

    def out_of(self, vertex: int) -> Out:
        """The edges out of a vertex."""
        if vertex not in self._known:
            own = slice(self._rows[vertex], self._rows[vertex + 1])
            ends = np.ascontiguousarray(self._ends[own, 1])
            ways = self.distance[ends], self.road[ends]
            self._known[vertex] = Out(ends, self._curves[own], self._lengths[own], self._final(ends), *ways)
        return self._known[vertex]


def free_goals(problem: Problem, rng: np.random.Generator, count: int) -> Array:
    """Poses in the goal, free of the static world; may be fewer, or none."""
    poses: list[tuple[float, float, float]] = []
    for x, y, heading, speed, _ in problem.goal_samples(rng, 4 * count).tolist():
        if len(poses) == count:
            break
        if problem.goal.holds(x, y, heading, speed) and problem.world.free(x, y, heading):
            poses.append((x, y, heading))
    return np.array(poses).reshape(-1, 3)
