"""Agents on the planning grid, packed once into the contiguous arrays that the hot loop reads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from checkers import Checker, EgoShape, Kind, MomentPrediction
from checkers.packing import pack_pieces
from checkers.prediction import PositionPrediction
from checkers.resample import cut
from checkers.validate import Array
from riskplan.kernels.charge import MOMENTS
from riskplan.kernels.pack import pack_rows

_FAR = 13.0  # Φ(−13) = 6e-39: what a culled mode can at most add per step
_SLACK = 1e-6  # [s]: times closer than this are the same
_ALL_ONE = np.zeros((0, 0))


@dataclass(frozen=True, eq=False)
class AgentGrid:
    """All that the hot path reads of the agents.

    Attributes:
        rows: (T, M, 9 + moments) per step and agent mode: mean, covariance, weight, squared cull distance, reach of the
            shape, moments; NaN before a prediction begins.
        index: (M, 3) group, first and last piece.
        pieces: (P, 5) packed pieces of the ego shape for all agents.
        groups: (G,) outer weights of the accumulators.
        owner: (M,) agent of each row; group_owner (G,) of each accumulator.
        order: of the moments carried, 0 for Gaussian modes.
    """

    rows: Array
    index: np.ndarray
    pieces: Array
    groups: Array
    owner: np.ndarray
    group_owner: np.ndarray
    order: int


def on_grid(agent: PositionPrediction, times: Array) -> PositionPrediction:
    """The agent on the part of the grid that it covers: all of it, or all but the first times.

    Raises:
        InputError: if it ends before the grid does.
    """
    skipped = int(np.count_nonzero(times < agent.times[0] - _SLACK))
    wanted = times[skipped:]
    count = len(wanted)
    if count <= len(agent.times) and np.array_equal(agent.times[:count], wanted):
        return cut(agent, slice(0, count))
    return agent.at(wanted)


def pack_agents(agents: Sequence[PositionPrediction], ego: EgoShape, checker: Checker, times: Array) -> AgentGrid:
    """Pack agents that are on the grid already, from some step on to its end.

    Raises:
        InputError: if a backend needs more than an agent carries.
    """
    if checker.moments_needed > 2 and any(isinstance(a, MomentPrediction) for a in agents):
        agents = [a.moments(checker.moments_needed) for a in agents]
    arrays = [checker.arrays(agent) for agent in agents]
    modes = [a.means.shape[1] for a in arrays]
    order = arrays[-1].order if arrays else 0
    # bounds that are not Gaussian, or that state a least risk, do not vanish far away
    far = _FAR if checker.moments_needed == 0 and checker.info.kind is not Kind.UPPER_BOUND else np.inf
    width = MOMENTS + (arrays[-1].moments.shape[-1] if arrays else 1)
    rows = np.full((len(times), sum(modes), width), np.nan)
    pieces, reaches = _pieces(agents, ego)
    index: list[tuple[int, int, int]] = []
    groups: list[float] = []
    group_owner: list[int] = []
    row = piece = 0
    for a, (agent, packed) in enumerate(zip(agents, arrays, strict=True)):
        persistent = agent.modes == "persistent"
        weights = _ALL_ONE if persistent else np.ascontiguousarray(agent.step_weights)
        pack_rows(rows, row, packed.means, packed.covariances, weights, packed.moments, reaches[a], far)
        own = agent.weights.tolist() if persistent else [1.0]
        last = piece + len(pieces[a])
        index += [(len(groups) + (k if persistent else 0), piece, last) for k in range(modes[a])]
        groups += own
        group_owner += [a] * len(own)
        row, piece = row + modes[a], last
    return AgentGrid(
        rows,
        np.array(index, dtype=np.int64).reshape(-1, 3),
        np.concatenate(pieces) if pieces else np.zeros((0, 5)),
        np.array(groups, dtype=np.float64),
        np.repeat(np.arange(len(agents)), modes),
        np.array(group_owner, dtype=np.int64),
        order,
    )


def _pieces(agents: Sequence[PositionPrediction], ego: EgoShape) -> tuple[list[Array], list[float]]:
    """Packed pieces of the shape, and how far they reach, for each agent's size; agents of one size share them."""
    sizes = [(agent.length, agent.width) for agent in agents]
    first = {size: agent for size, agent in zip(sizes, agents, strict=True)}
    known = {size: pack_pieces(*ego.pieces(agent)) for size, agent in first.items()}
    if not known:
        return [], []
    starts = np.cumsum([0, *(len(packed) for packed in known.values())])[:-1]
    reaches = np.maximum.reduceat(_farthest(np.concatenate(list(known.values()))), starts)
    reach = dict(zip(known, reaches.tolist(), strict=True))
    return [known[size] for size in sizes], [reach[size] for size in sizes]


def circumradius(pieces: Array) -> float:
    """Radius about the ego's centre that holds all pieces."""
    return float(_farthest(pieces).max())


def _farthest(pieces: Array) -> Array:
    """(P,) offset plus longest semi-axis, 1/√λ_min of L Lᵀ, without cancellation."""
    ox, oy, l11, l21, l22 = pieces.T
    trace, det = l11 * l11 + l21 * l21 + l22 * l22, (l11 * l22) ** 2
    longest = np.sqrt(0.5 * (trace + np.sqrt(np.maximum(trace * trace - 4.0 * det, 0.0))) / det)
    radius: Array = np.hypot(ox, oy) + longest
    return radius
