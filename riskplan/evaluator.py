"""Risk on the planning grid: agents packed once into contiguous arrays, charged to motions, judged as a whole."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.special import ndtri

from checkers import Checker, EgoShape, Kind, Risk, TrajectoryRisk
from checkers.backends.cascade import Cascade
from checkers.kernels.whiten import determinant, whiten_all
from checkers.prediction import PositionPrediction
from checkers.validate import Array
from riskplan.kernels import charge as hot
from riskplan.kernels import judge as judging
from riskplan.packing import AgentGrid, on_grid, pack_agents
from riskplan.scene import Agent


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
        step_bound: on the marginal risk of every step, summed over agents; a motion that breaks it is charged NaN.
        agent_bound: on the risk of every agent over the whole trajectory; likewise.
    """

    agents: tuple[Agent, ...]
    ego: EgoShape
    checker: Checker
    times: Array
    dependence: str = "independent"
    resolution: float = 1e-15
    step_bound: float = np.inf
    agent_bound: float = np.inf

    @cached_property
    def seen(self) -> tuple[PositionPrediction, ...]:
        """The agents as the checker reads them: with their modes, or without."""
        return tuple(self.checker.seen(agent) for agent in self.agents)

    @cached_property
    def resampled(self) -> tuple[PositionPrediction, ...]:
        """The agents on the part of the grid they cover: all of it, or all but time 0."""
        return tuple(on_grid(agent, self.times) for agent in self.seen)

    @cached_property
    def grid(self) -> AgentGrid:
        """The packed agents."""
        return pack_agents(self.resampled, self.ego, self.checker, self.times)

    @cached_property
    def _call(self) -> tuple[object, ...]:
        g = self.grid
        pieces = g.index[:, 2] - g.index[:, 1]
        terms = len(self.times) * max(int(pieces.sum()), 1)
        stated = self.checker.resolution if isinstance(self.checker, Cascade) else 0.0
        bounded = self.checker.info.kind is Kind.EXACT or stated > 0.0
        # of a piece, and at least what the judge will state of it
        negligible = max(0.5 * self.resolution / terms, stated) if bounded else 0.0
        idle = 0.5 * self.resolution / len(self.times) if bounded else 0.0
        return (
            self.checker.kernel,
            self.checker.options,
            g.order,
            g.rows,
            g.index,
            g.extents,
            g.pieces,
            g.groups,
            g.group_owner,
            self.dependence == "boole",
            (negligible, float(ndtri(negligible)) ** 2 if bounded else np.inf, idle, stated),
            (float(self.step_bound), float(self.agent_bound)),
            np.array([-1]),  # a hint that charges keep for each other; it changes no verdict
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
        return total

    def levels(self, accumulators: Array) -> Array:
        """What of the accumulators tells which of two nodes at one place is riskier."""
        return accumulators

    def confirmed(self, poses: Array, total: float) -> float:  # noqa: ARG002  others have to look
        """The risk that the search may state for poses from the start on, charged as `total`: that itself."""
        return total

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
        row = g.rows[position].copy() if share > 1 - 1e-9 else (1 - share) * g.rows[left] + share * g.rows[position]
        if np.isnan(row[:, hot.WEIGHT]).any():
            return float("nan")
        row[:, hot.DET] = [determinant(*c) for c in row[:, hot.C11 : hot.C22 + 1].tolist()]
        grid = replace(g, rows=row[None])
        call = list(self._call)
        call[3], call[11] = grid.rows, (np.inf, np.inf)
        given = _NONE if self.checker.kernel else self._given(np.reshape(pose, (1, 3)), 0, grid)
        zero, after = np.zeros(self.groups), np.zeros(self.groups)
        total: float = hot.charge(*call, given, np.reshape(pose, (1, 3)), 0, zero, np.inf, after)
        return min(total, 1.0) if total == total else total

    def judge(self, poses: Array) -> tuple[TrajectoryRisk | None, tuple[Array, ...]]:
        """Risk of poses (S, 3) at the first S grid times, start included, every mode evaluated.

        Returns:
            the trajectory risk (None without agents), and per agent the marginals (S, K), NaN before its prediction.
        """
        if not self.agents:
            return None, ()
        g, additive = self.grid, self.dependence == "boole"
        rows = self._rows(np.ascontiguousarray(poses, dtype=float))
        per_agent, per_step = np.zeros(len(self.agents)), np.zeros(len(poses))
        boole, top = judging.combine(rows, g.rows, g.index, g.groups, g.group_owner, additive, per_agent, per_step)
        # a sum over events that may coincide is a bound
        summed = [Kind.UPPER_BOUND] if additive or len(self.agents) > 1 else []
        return TrajectoryRisk(
            total=np.minimum(per_agent.sum(), 1.0),
            per_agent=per_agent,
            per_step=per_step,
            boole=np.asarray(boole),
            max_step=np.asarray(top),
            kind=Kind.weakest([*self._kinds, *summed]),
            dependence=self.dependence,
        ), tuple(rows[:, mine] for mine in self._columns)

    def broken(self, risk: TrajectoryRisk | None, bound: float | None) -> str:
        """What bound a judged trajectory breaks, in words; "" if it is within all of them."""
        if risk is None:
            return ""
        if bound is not None and not risk.total <= bound:
            return f"in total, above the bound {bound:g}"
        if not (risk.per_step <= self.step_bound).all():
            return f"with {risk.per_step.max():.6g} at one step, above the bound {self.step_bound:g} on steps"
        if not (risk.per_agent <= self.agent_bound).all():
            return f"with {risk.per_agent.max():.6g} of one agent, above the bound {self.agent_bound:g} on agents"
        return ""

    def spending(self, poses: Array) -> Array:
        """(S, A) risk of each agent up to and with each step: how the budget is spent along the way."""
        g, additive = self.grid, self.dependence == "boole"
        rows = self._rows(np.ascontiguousarray(poses, dtype=float))
        out = np.zeros((len(poses), len(self.agents)))
        for s in range(len(poses)):
            judging.combine(rows[: s + 1], g.rows, g.index, g.groups, g.group_owner, additive, out[s], np.zeros(s + 1))
        return out

    def marginals(self, poses: Array) -> tuple[Risk, ...]:
        """Per agent the risk (S, K) at the first S grid times; NaN before its prediction begins."""
        rows = self._rows(np.ascontiguousarray(poses, dtype=float))
        name = self.checker.info.name
        return tuple(
            Risk(rows[:, mine], kind, checker=name) for mine, kind in zip(self._columns, self._kinds, strict=True)
        )

    @cached_property
    def _columns(self) -> list[slice]:
        """Of each agent's modes."""
        ends = np.searchsorted(self.grid.owner, np.arange(len(self.agents) + 1)).tolist()
        return [slice(*pair) for pair in pairwise(ends)]

    @property
    def _kinds(self) -> list[Kind]:
        """What is claimed of each agent's marginals."""
        counts = (self.grid.index[:, 2] - self.grid.index[:, 1]).tolist()
        known = {count: self.checker.kind_for(count) for count in set(counts)}
        return [known[counts[mine.start]] for mine in self._columns]

    def _rows(self, poses: Array) -> Array:
        """(S, M) risk of every agent mode, nothing culled or bounded; NaN before a prediction begins."""
        g = self.grid
        begun = ~np.isnan(g.rows[: len(poses), :, hot.WEIGHT])
        if self.checker.kernel:
            rows = np.empty(begun.shape)
            judging.marginals(*self._call[:8], self.checker.info.kind is Kind.EXACT, poses, rows)
            if (np.isnan(rows) & begun).any():
                rows[begun] = self.checker.answered(rows[begun])
        else:
            rows = self._given(poses, 0)
            rows[~begun] = np.nan
        return rows

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
                np.ascontiguousarray(row[near][:, :, hot.C11 : hot.DET + 1]),
                moments,
                g.order,
                g.pieces[first:last],
            )
            mean, cov, mom = (a.reshape(near.sum() * (last - first), a.shape[-1]) for a in w)
            value = self.checker.modes(mean, cov, mom, g.order).value
            out[near, m] = np.minimum(value.reshape(-1, last - first).sum(axis=1), 1.0)
        return out

    @staticmethod
    def _within_cull(row: Array, poses: Array) -> np.ndarray:
        offset = row[:, :2] - poses[:, :2]
        near: np.ndarray = (offset**2).sum(axis=1) <= row[:, hot.CULL]
        return near


_NONE = np.zeros((0, 0))
