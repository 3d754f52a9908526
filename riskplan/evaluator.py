"""Risk on the planning grid: agents packed once into contiguous arrays, charged to motions, judged as a whole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from checkers import Checker, EgoShape, Kind, MomentPrediction, Risk, TrajectoryRisk, trajectory_risk
from checkers.kernels.whiten import pack_pieces, whiten_all
from checkers.validate import Array
from riskplan.kernels import charge as hot
from riskplan.scene import Agent

_FAR = 13.0  # Φ(−13) = 6e-39: what a culled mode can at most add per step


@dataclass(frozen=True, eq=False)
class AgentGrid:
    """All that the hot path reads of the agents.

    Attributes:
        rows: (T, M, 7 + moments) per step and agent mode: mean, covariance, weight, squared cull distance, moments.
        index: (M, 3) group, first and last piece.
        pieces: (P, 5) packed pieces of the ego shape for all agents.
        groups: (G,) outer weights of the accumulators.
        owner: (M,) agent of each row.
        order: of the moments carried, 0 for Gaussian modes.
    """

    rows: Array
    index: np.ndarray
    pieces: Array
    groups: Array
    owner: np.ndarray
    order: int


@dataclass(frozen=True, eq=False)
class RiskEvaluator:
    """The risk of trajectories among `agents`, by one checker, on one grid.

    Planning asks `charge`, step by step and with far agents bounded instead of evaluated; the finished plan goes to
    `judge`, which evaluates everything. A charge is never below the judged value for the backends that bound.

    Attributes:
        agents: predictions.
        ego: shape.
        checker: backend.
        times: (T,) grid, from 0 [s].
        dependence: "independent" or "boole".
        resolution: total risk that does not matter [1]: together, the bounds charged in place of exact values
            overstate a trajectory by less.
    """

    agents: tuple[Agent, ...]
    ego: EgoShape
    checker: Checker
    times: Array
    dependence: str = "independent"
    resolution: float = 1e-15

    @cached_property
    def resampled(self) -> tuple[Agent, ...]:
        """The agents on the part of the grid they cover: all of it, or all but time 0."""
        return tuple(agent.at(self.times[self.times >= agent.times[0] - 1e-6]) for agent in self.agents)

    @cached_property
    def grid(self) -> AgentGrid:
        """The packed agents."""
        return pack_agents(self.resampled, self.ego, self.checker, self.times)

    @cached_property
    def _call(self) -> tuple[object, ...]:
        g = self.grid
        terms = len(self.times) * max(int((g.index[:, 2] - g.index[:, 1]).sum()), 1)
        bounded = self.checker.info.kind is Kind.EXACT
        return (
            self.checker.kernel,
            self.checker.search_options,
            g.order,
            g.rows,
            g.index,
            g.pieces,
            g.groups,
            self.dependence == "boole",
            self.resolution / terms if bounded else 0.0,
        )

    @property
    def groups(self) -> int:
        """How many accumulators a node of a search carries."""
        return len(self.grid.groups)

    def start(self, pose: Array) -> tuple[Array, float]:
        """Accumulators and total after grid step 0, where agents are charged whose prediction covers it."""
        after = np.zeros(self.groups)
        total = self.charge(np.asarray(pose, dtype=float).reshape(1, 3), 0, np.zeros(self.groups), np.inf, after)
        return after, total

    def charge(self, poses: Array, first_step: int, before: Array, limit: float, after: Array) -> float:
        """Fill `after` with the accumulators at the end of the motion and return the total.

        Args:
            poses: (S, 3) at grid steps first_step, first_step + 1, …
            before: (G,) accumulators so far.
            limit: the charging stops once the total is above it; `after` is then unfinished.
            after: (G,) filled.
        """
        given = _NONE if self.checker.kernel else self._given(poses, first_step)
        total: float = hot.charge(*self._call, given, poses, first_step, before, limit, after)
        return total * (1.0 + self.checker.search_slack)

    def at_time(self, pose: Array, time: float) -> float:
        """Marginal risk at any time, summed over agents, at most 1; agents are interpolated between grid steps.

        NaN where it is not known: at a time that some agent's prediction does not cover, or a pose that is not finite.
        """
        if not self.agents:
            return 0.0
        position = np.searchsorted(self.times, time - 1e-9)
        if not time >= self.times[0] - 1e-9 or position >= len(self.times) or not np.isfinite(pose).all():
            return float("nan")
        left = max(int(position) - 1, 0)
        gap = self.times[position] - self.times[left]
        share = 1.0 if gap == 0 else min(max((time - self.times[left]) / gap, 0.0), 1.0)
        g = self.grid
        row = g.rows[position] if share > 1.0 - 1e-9 else (1 - share) * g.rows[left] + share * g.rows[position]
        if np.isnan(row[:, hot.WEIGHT]).any():
            return float("nan")
        grid = AgentGrid(row[None], g.index, g.pieces, g.groups, g.owner, g.order)
        call = list(self._call)
        call[3] = grid.rows
        given = _NONE if self.checker.kernel else self._given(np.reshape(pose, (1, 3)), 0, grid)
        zero, after = np.zeros(self.groups), np.zeros(self.groups)
        total: float = hot.charge(*call, given, np.reshape(pose, (1, 3)), 0, zero, np.inf, after)
        return min(total * (1.0 + self.checker.search_slack), 1.0) if total == total else total

    def judge(self, poses: Array) -> tuple[TrajectoryRisk | None, tuple[Array, ...]]:
        """Risk of poses (S, 3) at the first S grid times, start included, every mode evaluated.

        Returns:
            the trajectory risk (None without agents), and per agent the marginals (S, K), NaN before its prediction.
        """
        marginals = self.marginals(poses)
        if not marginals:
            return None, ()
        times = self.times[: len(poses)]
        known = [replace(r, value=np.where(np.isnan(r.value), 0.0, r.value)) for r in marginals]
        risk = trajectory_risk(known, [_on_grid(a, times) for a in self.agents], self.dependence)
        return risk, tuple(r.value for r in marginals)

    def marginals(self, poses: Array) -> tuple[Risk, ...]:
        """Per agent the risk (S, K) at the first S grid times; NaN before its prediction begins."""
        g, poses = self.grid, np.ascontiguousarray(poses, dtype=float)
        if self.checker.kernel:
            rows = np.empty((len(poses), len(g.index)))
            options = self.checker.options
            hot.marginals(self.checker.kernel, options, g.order, g.rows, g.index, g.pieces, poses, 0, rows)
            begun = ~np.isnan(g.rows[: len(poses), :, hot.WEIGHT])
            rows[begun] = self.checker.answered(rows[begun])
        else:
            rows = self._given(poses, 0)
            rows[np.isnan(g.rows[: len(poses), :, hot.WEIGHT])] = np.nan
        name = self.checker.info.name
        out = []
        for a in range(len(self.agents)):
            mine = np.flatnonzero(g.owner == a)
            kind = self.checker.kind_for(int(g.index[mine[0], 2] - g.index[mine[0], 1]))
            out.append(Risk(rows[:, mine], kind, checker=name))
        return tuple(out)

    def _given(self, poses: Array, first_step: int, grid: AgentGrid | None = None) -> Array:
        """(S, M) risks by a backend that works on arrays."""
        g = grid or self.grid
        steps = slice(first_step, first_step + len(poses))
        out = np.zeros((len(poses), len(g.index)))
        for m, (_, first, last) in enumerate(g.index):
            row = g.rows[steps, m : m + 1]
            near = (row[:, 0, hot.WEIGHT] >= 0) & self._within_cull(row[:, 0], poses)
            if not near.any():
                continue
            moments = np.ascontiguousarray(row[near][:, :, hot.MOMENTS :])
            w = whiten_all(
                np.ascontiguousarray(poses[near]),
                np.ascontiguousarray(row[near][:, :, :2]),
                np.ascontiguousarray(row[near][:, :, hot.C11 : hot.C22 + 1]),
                moments,
                g.order,
                g.pieces[first:last],
            )
            mean, cov, mom = (a.reshape(-1, a.shape[-1]) for a in w)
            value = self.checker.modes(mean, cov, mom, g.order).value
            out[near, m] = np.minimum(value.reshape(-1, last - first).sum(axis=1), 1.0)
        return out

    @staticmethod
    def _within_cull(row: Array, poses: Array) -> np.ndarray:
        offset = row[:, :2] - poses[:, :2]
        near: np.ndarray = (offset**2).sum(axis=1) <= row[:, hot.CULL]
        return near


_NONE = np.zeros((0, 0))


def pack_agents(agents: Sequence[Agent], ego: EgoShape, checker: Checker, times: Array) -> AgentGrid:
    """Pack agents that are on the grid already, from some step on to its end.

    Raises:
        InputError: if a backend needs more than an agent carries.
    """
    blocks, index, pieces, groups, owner = [], [], [], [], []
    order = count = 0
    packed_for: dict[tuple[float | None, float | None], Array] = {}
    gaussian_only = checker.moments_needed == 0
    if checker.moments_needed > 2 and any(isinstance(a, MomentPrediction) for a in agents):
        agents = [a.moments(checker.moments_needed) for a in agents]
    for a, agent in enumerate(agents):
        covered = times >= agent.times[0]
        arrays = checker.arrays(agent)
        steps, modes = len(times), arrays.means.shape[1]
        order = arrays.order
        size = (agent.length, agent.width)
        if size not in packed_for:
            packed_for[size] = pack_pieces(*ego.pieces(agent))
        packed = packed_for[size]
        reach = circumradius(packed)
        block = np.full((steps, modes, hot.MOMENTS + arrays.moments.shape[-1]), np.nan)
        c11, c12, c22 = np.moveaxis(arrays.covariances, -1, 0)
        spread = np.sqrt(0.5 * (c11 + c22) + np.hypot(0.5 * (c11 - c22), c12))
        persistent = agent.modes == "persistent"
        weights = 1.0 if persistent else agent.step_weights
        block[covered, :, :2] = arrays.means
        block[covered, :, hot.C11 : hot.C22 + 1] = arrays.covariances
        block[covered, :, hot.WEIGHT] = weights
        block[covered, :, hot.CULL] = (reach + _FAR * spread) ** 2 if gaussian_only else np.inf
        block[covered, :, hot.MOMENTS :] = arrays.moments
        for k in range(modes):
            if persistent or k == 0:
                groups.append(float(agent.weights[k]) if persistent else 1.0)
            index.append((len(groups) - 1, count, count + len(packed)))
            owner.append(a)
        pieces.append(packed)
        count += len(packed)
        blocks.append(block)
    width = max((b.shape[2] for b in blocks), default=hot.MOMENTS + 1)
    rows = np.concatenate(blocks, axis=1) if blocks else np.zeros((len(times), 0, width))
    return AgentGrid(
        np.ascontiguousarray(rows),
        np.array(index, dtype=np.int64).reshape(-1, 3),
        np.concatenate(pieces) if pieces else np.zeros((0, 5)),
        np.array(groups),
        np.array(owner, dtype=np.int64),
        order,
    )


def circumradius(pieces: Array) -> float:
    """Radius about the ego's centre that holds all pieces."""
    root = np.zeros((len(pieces), 2, 2))
    root[:, 0, 0], root[:, 1, 0], root[:, 1, 1] = pieces[:, 2], pieces[:, 3], pieces[:, 4]
    longest = 1.0 / np.linalg.svd(root, compute_uv=False)[:, 1]
    return float((np.hypot(pieces[:, 0], pieces[:, 1]) + longest).max())


def _on_grid(agent: Agent, times: Array) -> Agent:
    """The agent on `times`; a missing time 0 repeats its first prediction, of which only the weights are then read."""
    if agent.times[0] <= times[0]:
        return agent.at(times)
    if len(times) == 1:
        return replace(agent.at(agent.times[:1]), times=times)
    later = agent.at(times[1:])
    names = ["means", "central_moments" if isinstance(later, MomentPrediction) else "covariances", "headings"]
    if later.weights.ndim == 2:
        names.append("weights")
    values = {name: getattr(later, name) for name in names}
    repeated: dict[str, Any] = {name: np.concatenate([v[:1], v]) for name, v in values.items() if v is not None}
    return replace(later, times=times, **repeated)
