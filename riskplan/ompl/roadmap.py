"""Roadmaps: vertices sampled by OMPL's PRM in a static world, joined by directed Dubins edges."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from checkers import InputError, checker
from checkers.archive import read_arrays
from checkers.validate import FARTHEST, Array, as_array
from riskplan.kernels.roadmap import connect, rejoin
from riskplan.ompl.sampling import LaneSampler
from riskplan.ompl.validity import RiskStateValidityChecker
from riskplan.scene import Scenario
from riskplan.vehicles import curve_limits
from riskplan.world import StaticWorld

EDGES = 16  # edges out of a vertex
_STORED = ("vertices", "ends", "kinds", "radii", "longest")  # in a file
_BLOCK = 64  # vertices connected before the clock is looked at
MOST, _MOST_RADII = 20_000, 16  # in a file: edges are made anew, which takes time in the square of the vertices


@dataclass(frozen=True, eq=False)
class Roadmap:
    """Poses and directed edges of a static world, biarcs or Dubins curves; agents do not enter: it serves them all.

    For a vehicle that reverses there are edges that it drives backwards too: a curve ahead of the vertex turned round.

    Attributes:
        vertices: (V, 3) x, y, heading.
        ends: (E, 2) int source and target of the edges; v + V is vertex v driven through backwards.
        kinds: (E,) int, 0 for a biarc, k > 0 for a Dubins curve of radius k − 1.
        curves: (E, 6) segment lengths [m] and curvatures [1/m].
        lengths: (E,) [m].
        radii: turning radii tried for the edges, widest first [m].
        longest: longest edge [m].
    """

    vertices: Array
    ends: np.ndarray
    kinds: np.ndarray
    curves: Array
    lengths: Array
    radii: Array
    longest: float

    @classmethod
    def of(cls, scenario: Scenario, vertices: Array, stop: Callable[[], bool] = lambda: False) -> Roadmap:
        """Connect the vertices in the scenario's static world; those left when told to stop get no edges."""
        radii, longest = edge_scale(scenario)
        if not len(vertices):
            vertices = np.zeros((0, 3))  # nothing is free, or no time was left
        vertices = np.ascontiguousarray(vertices, dtype=np.float64)
        parts = [(np.zeros((0, 2), np.int64), np.zeros(0, np.int64), np.zeros((0, 6)), np.zeros(0))]
        scale = radii, _shortest(longest), longest, EDGES, scenario.world.packed
        size, poses = len(vertices), [vertices]
        if curve_limits(scenario.vehicle).reverse:
            poses.append(about(vertices))
        for way, first in product(range(len(poses)), range(0, size, _BLOCK)):
            if stop():
                break
            ends, *rest = connect(poses[way][first : first + _BLOCK], poses[way], *scale)
            parts.append((ends + [way * size + first, way * size], *rest))
        ends, kinds, curves, lengths = (np.concatenate(part) for part in zip(*parts, strict=True))
        return cls(vertices, ends, kinds, curves, lengths, radii, longest)

    @property
    def shortest(self) -> float:
        """Shortest edge [m]."""
        return _shortest(self.longest)

    @property
    def forwards(self) -> int:
        """How many edges are driven forwards; they are the first."""
        return int(np.searchsorted(self.ends[:, 0], len(self.vertices)))

    @classmethod
    def build(cls, scenario: Scenario, size: int = 1000, seed: int = 0) -> Roadmap:
        """Sample `size` vertices in the scenario's static world and connect them."""
        sampler = Sampler(scenario, scenario.world, seed)
        return cls.of(scenario, sampler.grow(size))

    def save(self, path: str | Path) -> None:
        """Write to an `.npz` (no pickle); curves follow from the vertices and are made anew on loading."""
        arrays = {name: getattr(self, name) for name in _STORED}
        with open(path, "wb") as file:
            np.savez(file, allow_pickle=False, **arrays)

    @classmethod
    def load(cls, path: str | Path) -> Roadmap:
        """Read what `save` wrote.

        Raises:
            InputError: if the file is not a roadmap.
        """
        data = read_arrays(path, "roadmap")
        try:
            for key in _STORED:
                if key not in data:
                    raise InputError(f"{key}: missing")
            vertices, radii = data["vertices"], as_array("radii", data["radii"], ("R",))
            longest = float(as_array("longest", data["longest"], (), largest=FARTHEST))
            if not (radii > 0).all() or not longest > 0:
                raise InputError(f"radii, longest: expected positive numbers, got {radii.tolist()}, {longest:g}")
            if len(vertices) > MOST or len(radii) > _MOST_RADII:
                raise InputError(f"expected at most {MOST} vertices and {_MOST_RADII} radii")
            if np.shape(vertices) != (0, 3):
                vertices = as_array("vertices", vertices, ("V", 3), largest=FARTHEST)
            ends, kinds = _pairs(data["ends"], len(vertices)), _kinds(data["kinds"], len(data["ends"]), len(radii))
            curves, lengths = rejoin(np.concatenate([vertices, about(vertices)]), ends, kinds, radii)
            if not (lengths <= 2.0 * longest).all():
                raise InputError("ends: expected pairs of vertices that a curve joins")
        except (InputError, TypeError) as error:
            raise InputError(f"{path}: not a roadmap: {error}") from None
        return cls(vertices, ends, kinds, curves, lengths, radii, longest)


def _pairs(ends: Any, count: int) -> np.ndarray:
    """(E, 2) numbers of vertices either way, in order of the first."""
    ends = np.asarray(ends)
    if ends.ndim != 2 or ends.shape[1] != 2 or ends.dtype != np.int64 or len(ends) > 2 * MOST * EDGES:
        raise InputError(f"ends: expected (E, 2) int64, got {ends.shape} {ends.dtype}")
    if len(ends) and (ends.min() < 0 or ends.max() >= 2 * count or (np.diff(ends[:, 0]) < 0).any()):
        raise InputError(f"ends: expected numbers of the {count} vertices, in order of the first")
    if ((ends >= count).sum(axis=1) == 1).any():
        raise InputError("ends: expected edges that are driven one way, forwards or backwards")
    return np.ascontiguousarray(ends)


def _kinds(kinds: Any, count: int, radii: int) -> np.ndarray:
    """(E,) kinds of edges."""
    kinds = np.asarray(kinds)
    if kinds.shape != (count,) or kinds.dtype != np.int64 or (count and not 0 <= kinds.min() <= kinds.max() <= radii):
        raise InputError(f"kinds: expected ({count},) int64 in 0..{radii}, got {kinds.shape} {kinds.dtype}")
    return np.ascontiguousarray(kinds)


class Sampler:
    """Vertices from OMPL's PRM, whose own edges are switched off."""

    def __init__(self, scenario: Scenario, world: StaticWorld, seed: int) -> None:
        ou.setLogLevel(ou.LOG_NONE)
        ou.RNG.setSeed(seed + 1)
        s = scenario
        space = ob.SE2StateSpace()
        bounds = ob.RealVectorBounds(2)
        for i in range(2):
            bounds.setLow(i, float(s.bounds[i]))
            bounds.setHigh(i, float(s.bounds[i + 2]))
        space.setBounds(bounds)
        si = ob.SpaceInformation(space)
        si.setStateValidityChecker(
            RiskStateValidityChecker(
                si,
                (),
                s.ego,
                checker("exact"),
                static=world.free,
                pose_time=lambda state: (state.getX(), state.getY(), state.getYaw(), 0.0),
            )
        )
        si.setMotionValidator(_AnyMotion(si))
        lanes, box, rng = world.lanes, np.array(s.bounds), np.random.default_rng(seed)
        si.setValidStateSamplerAllocator(lambda info: LaneSampler(info, lanes, box, rng, world.free))
        si.setup()
        self._pdef = ob.ProblemDefinition(si)  # PRM segfaults without one
        self._prm = og.PRM(si)
        self._prm.setProblemDefinition(self._pdef)
        self._prm.setup()
        self._si = si

    def grow(self, size: int, stop: Callable[[], bool] = lambda: False) -> Array:
        """Sample until there are `size` vertices (fewer if next to nothing is free, or told to stop); (V, 3)."""
        prm, tries = self._prm, [0]

        def enough() -> bool:
            tries[0] += 1
            return bool(prm.milestoneCount() >= size or tries[0] > 50 * size or (tries[0] > 50 and stop()))

        prm.growRoadmapPtc(ob.PlannerTerminationCondition(enough))
        data = ob.PlannerData(self._si)
        prm.getPlannerData(data)
        out = np.empty((data.numVertices(), 3))
        for i in range(len(out)):
            state = data.getVertex(i).getState()
            out[i] = state.getX(), state.getY(), state.getYaw()
        return out


class _AnyMotion(ob.MotionValidator):
    """Lets OMPL's PRM join what it likes: its undirected edges are not used, but only joined vertices are exported."""

    def __init__(self, si: Any) -> None:
        super().__init__(si)

    def checkMotion(self, first: Any, second: Any) -> bool:  # noqa: N802, ARG002  OMPL's name
        return True


def edge_scale(scenario: Scenario) -> tuple[Array, float]:
    """(turning radii, longest edge) that suit the speeds to be expected, and slower ones round tighter corners."""
    v = curve_limits(scenario.vehicle)
    pace = min(v.speed, max(scenario.start.speed + 2.0, 5.0))
    tightest = 1.0 / v.curvature
    widest = max(tightest, pace * pace / v.lateral)
    radii = [widest / 2**k for k in range(4) if widest / 2**k > tightest]
    return np.array([*radii, tightest]), max(2.0 * pace, 10.0)


def _shortest(longest: float) -> float:
    """Shortest edge [m]: for slow vehicles shorter ones."""
    return min(2.0, 0.2 * longest)


def about(poses: Array) -> Array:
    """(N, 3) the poses turned round: forwards from there is backwards."""
    return np.column_stack([poses[:, :2], poses[:, 2] % (2.0 * np.pi) - np.pi])
