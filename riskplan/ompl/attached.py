"""The edges of one query: a roadmap's, and those that attach a start and a goal to it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from checkers.validate import Array
from riskplan.kernels.roadmap import connect
from riskplan.ompl.roadmap import EDGES, Roadmap
from riskplan.search import Problem


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
        poses: (V + G + 1, 3) of the roadmap's vertices, poses in the goal, and the start.
        source: the start's number.
        distance: (V + G + 1,) from there to the goal at least.
        road: (V + G + 1,) way along edges to the goal [m]; where there is none a guess, longer than any.
        connected: whether edges lead from the start to the goal.
    """

    def __init__(self, problem: Problem, roadmap: Roadmap, goals: Array) -> None:
        r, start, first = roadmap, np.array([problem.start_state[:3]]), len(roadmap.vertices)
        self.roadmap = roadmap
        self.poses = np.concatenate([r.vertices, goals, start])
        self.source = first + len(goals)
        self.distance = problem.goal.box_distances(self.poses[:, :2])
        scale = r.radii, r.shortest, r.longest
        world = problem.world.packed
        into, _, *last = connect(r.vertices, goals, *scale, 8, world)
        out, _, *begun = connect(start, self.poses[: self.source], *scale, 10 * EDGES, world)
        parts = zip(
            (r.ends, r.curves, r.lengths),
            (into + [0, first], *last),
            (out + [self.source, 0], *begun),
            strict=True,
        )
        ends, self._curves, self._lengths = (np.concatenate(part) for part in parts)
        order = np.argsort(ends[:, 0], kind="stable")
        self._ends, self._curves, self._lengths = ends[order], self._curves[order], self._lengths[order]
        self._rows = np.searchsorted(self._ends[:, 0], np.arange(self.source + 2))
        road = self._along()
        self.connected = bool(np.isfinite(road[self.source]))
        known = road[np.isfinite(road)].max(initial=0.0)
        self.road = np.where(np.isfinite(road), road, known + self.distance)
        self._known: dict[int, Out] = {}

    def _along(self) -> Array:
        """(V + G + 1,) shortest ways to a pose in the goal, infinite where there is none."""
        size, first = self.source + 2, len(self.roadmap.vertices)
        goals = np.arange(first, self.source)
        # edges the other way, and from one more vertex to every goal pose
        tails = np.concatenate([self._ends[:, 1], np.full(len(goals), size - 1)])
        heads = np.concatenate([self._ends[:, 0], goals])
        lengths = np.concatenate([self._lengths, np.full(len(goals), 1e-9)])
        graph = csr_matrix((lengths, (tails, heads)), shape=(size, size))
        ways: Array = dijkstra(graph, indices=np.array([size - 1]))[0, : size - 1]
        return ways

    def out_of(self, vertex: int) -> Out:
        """The edges out of a vertex."""
        if vertex not in self._known:
            own = slice(self._rows[vertex], self._rows[vertex + 1])
            ends = np.ascontiguousarray(self._ends[own, 1])
            final = (ends >= len(self.roadmap.vertices)) & (ends < self.source)
            ways = self.distance[ends], self.road[ends]
            self._known[vertex] = Out(ends, self._curves[own], self._lengths[own], final, *ways)
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
