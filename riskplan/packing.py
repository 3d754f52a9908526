"""Agents on the planning grid, packed once into the contiguous arrays that the hot loop reads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from checkers import Checker, EgoShape, GaussianMixturePrediction, Kind, MomentPrediction
from checkers.packing import pack_pieces
from checkers.prediction import PositionPrediction
from checkers.resample import cut
from checkers.validate import Array
from riskplan.kernels.charge import FAR, MOMENTS
from riskplan.kernels.pack import farthest, lay_out, pack_rows

_SLACK = 1e-6  # [s]: times closer than this are the same
_ALL_ONE, _ONE, _NOTHING = np.zeros((0, 0)), np.ones(1), np.zeros(0)
_NO_PIECES, _NO_MOMENTS = np.zeros((0, 5)), np.zeros((0, 0, 0))


@dataclass(frozen=True, eq=False)
class AgentGrid:
    """All that the hot path reads of the agents.

    Attributes:
        rows: (T, M, 8 + moments) per step and agent mode: mean, covariance and determinant, weight, squared cull
            distance, moments; NaN before a prediction begins.
        index: (M, 3) group, first and last piece.
        extents: (M, 3) [m] of the shape about the ego's centre, along the ego's axis and across.
        pieces: (P, 5) packed pieces of the ego shape for all agents.
        groups: (G,) outer weights of the accumulators.
        owner: (M,) agent of each row; group_owner (G,) of each accumulator.
        order: of the moments carried, 0 for Gaussian modes.
    """

    rows: Array
    index: np.ndarray
    extents: Array
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
    begin = agent.times[0] - _SLACK
    skipped = 0 if begin <= times[0] else int(np.searchsorted(times, begin))
    wanted = times[skipped:]
    # most agents come on the grid, which comparing bytes shows soonest
    if agent.times[: len(wanted)].tobytes() == wanted.tobytes():
        return cut(agent, slice(0, len(wanted)))
    return agent.at(wanted)


def pack_agents(agents: Sequence[PositionPrediction], ego: EgoShape, checker: Checker, times: Array) -> AgentGrid:
    """Pack agents that are on the grid already, from some step on to its end.

    Raises:
        InputError: if a backend needs more than an agent carries.
    """
    if checker.moments_needed > 2 and any(isinstance(a, MomentPrediction) for a in agents):
        agents = [a.moments(checker.moments_needed) for a in agents]
    order, moments = 0, None
    if not all(isinstance(agent, GaussianMixturePrediction) for agent in agents):
        arrays = [checker.arrays(agent) for agent in agents]
        order, moments = arrays[-1].order, [a.moments for a in arrays]
    persistent = [agent.modes == "persistent" for agent in agents]
    shapes = _pieces(agents, ego)
    sizes = [(a.means.shape[1], own, len(p)) for a, own, p in zip(agents, persistent, shapes, strict=True)]
    pieces = np.concatenate([_NO_PIECES, *shapes])
    index, owner, group_owner, extents = lay_out(np.array(sizes, dtype=np.int64).reshape(-1, 3), pieces)
    rows = np.empty((len(times), len(owner), MOMENTS + (moments[-1].shape[-1] if moments else 0)))
    # bounds that are not Gaussian, or that state a least risk, do not vanish far away
    far = FAR if checker.moments_needed == 0 and checker.info.kind is not Kind.UPPER_BOUND else np.inf
    # one call for all agents of equally many steps: a call each would take longer than its work
    lengths = np.array([len(agent.times) for agent in agents], dtype=int)
    for steps in set(lengths.tolist()):
        mine = np.flatnonzero(lengths == steps).tolist()
        pack_rows(
            rows,
            np.flatnonzero(lengths[owner] == steps),
            np.concatenate([agents[a].means for a in mine], axis=1),
            np.concatenate([agents[a].covariances for a in mine], axis=1),
            np.concatenate([_given_group(agents[a]) for a in mine], axis=1) if not all(persistent) else _ALL_ONE,
            np.concatenate([moments[a] for a in mine], axis=1) if moments else _NO_MOMENTS,
            extents,
            far,
        )
    weights = [agent.weights if own else _ONE for agent, own in zip(agents, persistent, strict=True)]
    return AgentGrid(rows, index, extents, pieces, np.concatenate([_NOTHING, *weights]), owner, group_owner, order)


def _given_group(agent: PositionPrediction) -> Array:
    """(T, K) weights of the modes within the accumulator they are charged to; a persistent mode has its own."""
    return np.ones(agent.means.shape[:2]) if agent.modes == "persistent" else agent.step_weights


def _pieces(agents: Sequence[PositionPrediction], ego: EgoShape) -> list[Array]:
    """Packed pieces of the shape for each agent; agents of one size share them."""
    sizes = [(agent.length, agent.width) for agent in agents]
    first = {size: agent for size, agent in zip(sizes, agents, strict=True)}
    known = {size: pack_pieces(*ego.pieces(agent)) for size, agent in first.items()}
    return [known[size] for size in sizes]


def circumradius(pieces: Array) -> float:
    """Radius about the ego's centre that holds all pieces."""
    return float(farthest(np.array(pieces), 0, len(pieces)))
