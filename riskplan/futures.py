"""Risk on the planning grid where errors persist over time: weighted futures in the search, exact at its end.

A search extends a motion by a step at a time, and a persistent error makes steps depend on each other: what a step adds
is the probability of those futures that it hits and no step before has. So futures of every agent mode are drawn once,
with weights, and a node of the search carries a bit for each (math: section 4b). What the search then proposes is
judged by `checkers.path_risk`, which is exact.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from checkers import Checker, EgoShape, GaussianMixturePrediction, InputError, Kind, Risk, TrajectoryRisk
from checkers.dependence import idiosyncratic
from checkers.kernels.path import BOXES
from checkers.path import PATH_SAFETY, headings_for, persistent_risk, shape_against, step_risk
from checkers.prediction import square_root
from checkers.resample import cut
from checkers.validate import Array
from riskplan.evaluator import RiskEvaluator
from riskplan.kernels import hits
from riskplan.packing import circumradius
from riskplan.scene import Agent

FUTURES = 1024  # of each agent mode
_TOLERANCE = 1e-6  # relative, of the judge
_COARSE = 1e-4  # and of the search's last question
_WITH_REST = 1e-3  # of both where steps err by themselves too: quadrature over the factors takes its time
_IDLE = 1e-8  # of the total: agents that add less are not worth a sweep


class Futures(NamedTuple):
    """What `riskplan.kernels.hits.charge_hits` reads of the agents, in its order; and each agent's shape's reach."""

    kind: int
    shapes: Array
    rows: Array
    offsets: np.ndarray
    farthest: np.ndarray
    owned: np.ndarray
    shares: Array
    groups: Array
    owner: np.ndarray
    reaches: Array


@dataclass(frozen=True, eq=False)
class PersistentEvaluator(RiskEvaluator):
    """As `RiskEvaluator`, for agents with `factors`; dependence "persistent".

    A charge is an estimate: `confirmed` says what a whole trajectory's risk is.

    Raises:
        InputError: for a checker other than `exact`, and agents that are no Gaussian mixtures with factors.
    """

    dependence: str = "persistent"

    def __post_init__(self) -> None:
        if self.checker.info.name != "exact":
            raise InputError(
                "dependence: 'persistent' is judged by the exact sweep; "
                f"expected the checker 'exact', got {self.checker.info.name!r}"
            )
        for i, agent in enumerate(self.agents):
            where = f"agents[{i}] ({agent.name})" if agent.name else f"agents[{i}]"
            if not isinstance(agent, GaussianMixturePrediction) or agent.modes != "persistent":
                raise InputError(
                    f"{where}: dependence 'persistent' expects a Gaussian mixture with persistent modes, "
                    f"got {type(agent).__name__}"
                )
            if agent.factors is None:
                raise InputError(
                    f"{where}: dependence 'persistent' expects factors, got none; rp.persistent(agent) makes them"
                )

    @cached_property
    def futures(self) -> Futures:
        """The futures, drawn from a fixed seed: equal evaluators search alike."""
        return _futures(self.resampled, self.ego, self.times, min(100.0 * self.resolution, 0.5))

    @property
    def groups(self) -> int:
        """Shares and words of masks that a node carries."""
        modes, words = self.futures.farthest.shape[1:]
        return int(modes * (1 + words))

    def levels(self, accumulators: Array) -> Array:
        """The shares: of two nodes at one place, the one with less in each is preferred."""
        return accumulators[: len(self.futures.groups)]

    def charge(self, poses: Array, first_step: int, before: Array, limit: float, after: Array) -> float:
        """As of `RiskEvaluator`, over the futures."""
        caps = (float(self.step_bound), float(self.agent_bound))
        total: float = hits.charge_hits(*self.futures[:-1], caps, poses, first_step, before, limit, after)
        return total

    def confirmed(self, poses: Array, total: float) -> float:  # noqa: ARG002  an estimate
        """The exact risk of poses from the start on, its error added, in place of the search's estimate of it."""
        far = self._far(poses)
        idle = 0.1 * self.resolution / len(self.agents)
        found = float(far[far <= idle].sum())
        per_step = np.zeros(len(poses))
        for a, agent, known in self._covered(poses):
            if far[a] <= idle:
                continue
            risk, exposure, _ = self._exact(agent, known, _COARSE)
            found += risk
            per_step[-len(known) :] += exposure
            if risk > self.agent_bound:
                return np.nan
        return min(found, 1.0) if per_step.max(initial=0.0) <= self.step_bound else np.nan

    def _exact(self, agent: GaussianMixturePrediction, poses: Array, tolerance: float) -> tuple[float, Array, Kind]:
        """Total with its error added, exposure (T,) that sums to it, and kind."""
        assert agent.factors is not None  # noqa: S101  checked when made
        if idiosyncratic(agent.covariances, agent.factors).any():
            tolerance = _WITH_REST
        value, error, exposure, kind = persistent_risk(poses[None], agent, self.ego, tolerance, 0)
        total = min(float(value[0] + PATH_SAFETY * error[0]), 1.0)
        return total, exposure[0] * (total / max(exposure[0].sum(), np.finfo(float).tiny)), kind

    def _far(self, poses: Array) -> Array:
        """(A,) bounds: Σ_t Φ(−d_t), the mass beyond the tangent of the shape's circle that faces the mean."""
        out = np.zeros(len(self.agents))
        for a, agent, known in self._covered(poses):
            out[a] = _beyond(agent, known, self.futures.reaches[a]).sum(axis=0) @ agent.weights
        return out

    def at_time(self, pose: Array, time: float) -> float:
        """Marginal risk at any time, as of `RiskEvaluator`."""
        if not time >= self.times[0] - 1e-9 or time > self.times[-1] + 1e-9 or not np.isfinite(pose).all():
            return float("nan")
        total = 0.0
        for agent in self.agents:
            if not agent.times[0] - 1e-6 <= time <= agent.times[-1] + 1e-6:
                return float("nan")
            found = agent.at(np.array([time]))
            assert isinstance(found, GaussianMixturePrediction)  # noqa: S101  checked when made
            total += float(found.weights @ step_risk(np.reshape(pose, (1, 3)), found, self.ego, _TOLERANCE).value[0])
        return min(total, 1.0)

    def judge(self, poses: Array) -> tuple[TrajectoryRisk | None, tuple[Array, ...]]:
        """As of `RiskEvaluator`, exact to 4e-6, high rather than low; per step the share of first hits.

        Agents so far away that they change no digit of the total are stated by their bounds.
        """
        if not self.agents:
            return None, ()
        per_step, per_agent = np.zeros(len(poses)), np.zeros(len(self.agents))
        marginals = [np.full((len(poses), a.means.shape[1]), np.nan) for a in self.resampled]
        kinds, steps = [Kind.UPPER_BOUND] if len(self.agents) > 1 else [Kind.EXACT], [np.zeros(1)]
        for a, agent, known, (per_agent[a], exposure, kind), bounds in self._by_agent(poses):
            alone = step_risk(known, agent, self.ego, _TOLERANCE).value if bounds is None else bounds
            own = alone @ agent.weights
            per_agent[a], exposure = _within_any_dependence(per_agent[a], exposure, own)
            marginals[a][-len(known) :] = alone
            kinds.append(kind)
            steps.append(own)
            per_step[-len(known) :] += exposure
        every = np.concatenate(steps)
        risk = TrajectoryRisk(
            total=np.minimum(per_agent.sum(), 1.0),
            per_agent=per_agent,
            per_step=np.minimum(per_step, 1.0),
            boole=np.minimum(every.sum(), 1.0),
            max_step=every.max(),
            kind=Kind.weakest(kinds),
            dependence="persistent",
        )
        return risk, tuple(marginals)

    def spending(self, poses: Array) -> Array:
        """As of `RiskEvaluator`: a step's share is the probability that it is the first to be hit."""
        out = np.zeros((len(poses), len(self.agents)))
        for a, _, known, (_, exposure, _), _ in self._by_agent(poses):
            out[-len(known) :, a] = np.cumsum(exposure)
        return out

    def _by_agent(
        self, poses: Array
    ) -> Iterator[tuple[int, GaussianMixturePrediction, Array, tuple[float, Array, Kind], Array | None]]:
        """Per agent its number, itself and the poses it meets, what `_exact` says of it, and None.

        The nearest come first; from where their bounds are `_IDLE` of what was found, bounds take the place of exact
        values, and those of every step and mode (T, K) that of None.
        """
        covered = [(*rest, _beyond(rest[1], rest[2], self.futures.reaches[rest[0]])) for rest in self._covered(poses)]
        covered.sort(key=lambda row: -float(row[3].sum(axis=0) @ row[1].weights))
        found = 0.0
        for a, agent, known, bounds in covered:
            exposure = bounds @ agent.weights
            if exposure.sum() <= _IDLE * found:
                yield a, agent, known, (float(exposure.sum()), exposure, Kind.UPPER_BOUND), bounds
                continue
            exact = self._exact(agent, known, _TOLERANCE)
            found += exact[0]
            yield a, agent, known, exact, None

    def _covered(self, poses: Array) -> Iterator[tuple[int, GaussianMixturePrediction, Array]]:
        """Per agent its number, its part of the grid that poses from the start on reach, and those poses."""
        for a, agent in enumerate(self.resampled):
            assert isinstance(agent, GaussianMixturePrediction)  # noqa: S101  checked when made
            skipped = int(np.count_nonzero(self.times < agent.times[0] - 1e-6))
            if len(poses) > skipped:
                yield a, cut(agent, slice(0, len(poses) - skipped)), np.ascontiguousarray(poses[skipped:])

    def marginals(self, poses: Array) -> tuple[Risk, ...]:
        """As of `RiskEvaluator`."""
        return tuple(Risk(m, Kind.EXACT, checker="exact") for m in self.judge(poses)[1])


def _within_any_dependence(total: float, exposure: Array, steps: Array) -> tuple[float, Array]:
    """Total and exposure (T,) held between the largest of the steps' marginals (T,) and their sum (Fréchet 1935)."""
    held = min(max(total, float(steps.max())), float(steps.sum()), 1.0)
    if not exposure.sum() > 0.0:
        exposure = steps
    return held, exposure * (held / max(float(exposure.sum()), np.finfo(float).tiny))


def _beyond(agent: GaussianMixturePrediction, poses: Array, reach: float) -> Array:
    """(T, K) Φ(−d): the mass beyond the tangent, facing the mean, of a circle of that reach about each pose (T, 3)."""
    offset = agent.means - poses[:, None, :2]
    distance = np.hypot(offset[..., 0], offset[..., 1])
    spread = np.sqrt(np.einsum("tki,tkij,tkj->tk", offset, agent.covariances, offset))
    gap = distance * (distance - reach)
    bound = ndtr(-np.divide(gap, spread, out=np.full_like(gap, np.inf), where=spread > 0))
    return np.where(gap > 0, bound, 1.0)


def make_evaluator(
    agents: Sequence[Agent],
    ego: EgoShape,
    checker: Checker,
    times: Array,
    dependence: str = "independent",
    resolution: float = 1e-15,
    step_bound: float = np.inf,
    agent_bound: float = np.inf,
) -> RiskEvaluator:
    """The evaluator for that dependence over time."""
    kind = PersistentEvaluator if dependence == "persistent" and agents else RiskEvaluator
    return kind(tuple(agents), ego, checker, times, dependence, resolution, step_bound, agent_bound)


def _futures(agents: Sequence[Agent], ego: EgoShape, times: Array, interest: float) -> Futures:
    shapes: list[Array] = []
    rows, offsets, index, shares, groups, reaches = [], [], [], [], [], []
    rng = np.random.default_rng(20_211)
    kind, count = 0, 0
    for agent in agents:
        assert isinstance(agent, GaussianMixturePrediction)  # noqa: S101  checked when made
        assert agent.factors is not None  # noqa: S101
        kind, shape = shape_against(ego, agent)
        covered = times >= agent.times[0] - 1e-6
        reach = circumradius(shape) if shape.shape[1] == 5 else _reach(kind, shape[0])
        headings = headings_for(agent, kind)
        for k in range(agent.means.shape[1]):
            row = np.full((len(times), 4), np.nan)
            row[covered] = np.column_stack([agent.means[:, k], headings[:, k], np.full(len(agent.times), reach)])
            drawn = np.zeros((len(times), 2, FUTURES), dtype=np.float32)
            factors, covariances = agent.factors[:, k], agent.covariances[:, k]
            xi, share = _spiral(FUTURES, factors.shape[-1], interest, rng)
            drawn[covered] = factors @ xi
            own = idiosyncratic(covariances, factors)
            if own.any():
                noise = rng.standard_normal((len(agent.times), 2, FUTURES))
                drawn[covered] += square_root(own) @ noise
            rows.append(row)
            offsets.append(drawn)
            shares.append(share)
            groups.append(float(agent.weights[k]))
            index.append((count, count + len(shape)))
        shapes.append(shape)
        reaches.append(reach)
        count += len(shape)
    away = np.stack(offsets, axis=1)
    lengths = np.hypot(away[:, :, 0], away[:, :, 1])
    return Futures(
        kind,
        np.concatenate(shapes),
        np.ascontiguousarray(np.stack(rows, axis=1)),
        np.ascontiguousarray(away),
        np.ascontiguousarray(lengths.reshape(*lengths.shape[:2], -1, hits.WORD).max(axis=-1)),
        np.array(index, dtype=np.int64),
        np.array(shares),
        np.array(groups),
        np.repeat(np.arange(len(agents)), [agent.means.shape[1] for agent in agents]),
        np.array(reaches),
    )


def _reach(kind: int, half: Array) -> float:
    """Farthest that a box ⊕ box, or an ellipse between two, can be entered from the ego's centre."""
    if kind == BOXES:
        return float(np.hypot(half[0], half[1]) + np.hypot(half[2], half[3]))
    return float(np.hypot(max(half[0], half[1]), max(half[2], half[3])))


def _spiral(count: int, rank: int, interest: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """(R, N) standard normal points with weights (N,), far ones as many as near ones; sorted by distance from 0.

    Two coordinates follow a spiral of golden angles (Vogel 1979), which fills every ring evenly; their distances are
    such that half of the points lie where less than `interest` of the probability is. Others are drawn.
    """
    power = max(np.log(interest) / np.log(0.5), 1.0)
    edges = 1.0 - np.arange(count + 1) / count
    survival = edges**power
    share = survival[:-1] - survival[1:]
    radius = np.sqrt(-2.0 * np.log(0.5 * (survival[:-1] + survival[1:])))
    angle = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count) + rng.uniform(0.0, 2.0 * np.pi)
    points = rng.standard_normal((max(rank, 2), count))
    points[:2] = radius * np.cos(angle), radius * np.sin(angle)
    return points[:rank], share
