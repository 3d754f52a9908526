"""The risk of a whole path, with the agents' dependence over time: `path_risk`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from checkers.agents import AGENTS, Prediction
from checkers.base import as_poses
from checkers.control_prediction import ControlPrediction
from checkers.cubature import over_factors
from checkers.dependence import idiosyncratic
from checkers.kernels.path import ALIGNED, BOXES, FIXED, sweep_paths, sweep_steps
from checkers.kind import Kind
from checkers.packing import pack_pieces
from checkers.persistence import course
from checkers.prediction import GaussianMixturePrediction, MomentPrediction, PositionPrediction, square_root
from checkers.registry import checker
from checkers.risk import PATH_DEPENDENCE, Risk, TrajectoryRisk, trajectory_risk
from checkers.shapes import AlignedEllipsoid, EgoBox, EgoShape, agent_size
from checkers.validate import FARTHEST, Array, InputError, as_array, as_option, as_scalar, as_seed, as_tuple

PATH_SAFETY = 4.0  # what the rules estimate of their own error was exceeded by 1.6 in one of a hundred hard scenes


@dataclass(frozen=True, eq=False)
class PathRisk(TrajectoryRisk):
    """Risk of a whole path. As `TrajectoryRisk`, leading batch axes in front, but

    Attributes:
        per_step: (T,) exposure: probability that the first hit with an agent is at each step, summed over agents; it
            sums to `total`. Under "persistent" its own error is up to 2e-3 of the total. Under "boole": marginals.
        error: () absolute error of the numerics in `total`.
    """

    error: Array | None = None


class _Mode(NamedTuple):
    """One mode, as kernels read it."""

    means: Array
    covariances: Array
    factors: Array | None
    headings: Array


def path_risk(
    poses: Any,
    predictions: Sequence[Prediction],
    ego: EgoShape,
    dependence: str = "persistent",
    tolerance: float = 1e-8,
    seed: int = 0,
) -> PathRisk:
    """Probability that any agent enters the ego's shape at any step of a path.

    "persistent": an agent's factors persist (x_t = μ_t + B_t ξ + ε_t); without ε and with up to two factors this is
    exact by a polar sweep in the plane of ξ, else E_ξ[1 − Π_t (1 − r_t(ξ))] by quadrature. An agent without factors is
    independent over time. "independent": factors are ignored. "boole": the sum of the marginals, an upper bound under
    any dependence; the only choice for agents known by moments, whose marginals are then Marshall & Olkin's bound.
    Pieces of a cover are united, not summed.

    Args:
        poses: (T, 3) or (B, T, 3) x, y [m], heading [rad] at the predictions' times.
        predictions: the agents, on one time grid; their risks are summed.
        ego: any shape; `EgoBox` and `EgoEllipsoid.aligned` turn with each agent's heading.
        dependence: over time, given the mode.
        tolerance: relative error aimed at, 1e-14 to 1e-2; 1e-4 is about five times as fast as the default.
        seed: of the directions drawn for three or more factors.

    Raises:
        InputError: on wrong shapes, agents that lack what the shape or the dependence needs, or unknown options.
    """
    as_option("dependence", dependence, PATH_DEPENDENCE)
    as_scalar("tolerance", tolerance, low=1e-14, high=1e-2)
    if not as_tuple("predictions", predictions, *AGENTS):
        raise InputError("predictions: expected at least one, got none")
    as_seed("seed", seed)
    agents = [p.moments(2) if isinstance(p, ControlPrediction) else p for p in predictions]
    poses = as_poses(poses, len(predictions[0].times))
    as_array("poses", poses, poses.shape, largest=FARTHEST)
    batch = np.ascontiguousarray(poses.reshape(-1, *poses.shape[-2:]))
    summary, totals, exposures, kinds, steps, doubts = _summary(batch, agents, ego, dependence, tolerance)
    errors = np.zeros(len(batch))
    for i, pred in enumerate(agents):
        if dependence == "persistent" and pred.factors is not None:
            total, error, exposure, kind = persistent_risk(batch, pred, ego, tolerance, seed)
            total, error, kind = within_any_dependence(total, error, kind, steps[i], doubts[i])
            totals[:, i], exposures[:, i], kinds[i] = total, exposure, kind
            errors += PATH_SAFETY * error
        else:
            errors += PATH_SAFETY * totals[:, i] * tolerance
    total = np.minimum(totals.sum(axis=-1), 1.0)
    raw = exposures.sum(axis=1)
    scale = total / np.maximum(raw.sum(axis=-1), np.finfo(float).tiny)
    many = len(predictions) > 1 or dependence == "boole"
    lead = poses.shape[:-2]
    return PathRisk(
        total.reshape(lead),
        totals.reshape(*lead, -1),
        (raw * scale[:, None]).reshape(*lead, -1),
        summary.boole.reshape(lead),
        summary.max_step.reshape(lead),
        Kind.weakest([*kinds, *([Kind.UPPER_BOUND] if many else [])]),
        dependence,
        errors.reshape(lead),
    )


def _summary(
    batch: Array, predictions: Sequence[PositionPrediction], ego: EgoShape, dependence: str, tolerance: float
) -> tuple[TrajectoryRisk, Array, Array, list[Kind], list[Array], list[Array]]:
    """Marginals combined: what holds without factors, totals (B, A), exposures (B, A, T), kinds, steps, their errors.

    The last two are (B, T) each.
    """
    risks = [_marginals(batch, pred, ego, dependence, tolerance) for pred in predictions]
    combined = trajectory_risk(risks, predictions, "boole" if dependence == "boole" else "independent")
    exposures, steps, doubts = [], [], []
    for risk, pred in zip(risks, predictions, strict=True):
        weighted = pred.step_weights * risk.value
        steps.append(weighted.sum(axis=-1))
        doubts.append(np.zeros_like(steps[-1]) if risk.error is None else (pred.step_weights * risk.error).sum(axis=-1))
        if dependence == "boole":
            exposures.append(weighted.sum(axis=-1))
        elif pred.modes == "persistent":
            exposures.append((pred.weights * _first(risk.value)).sum(axis=-1))
        else:
            exposures.append(_first(weighted.sum(axis=-1)[..., None])[..., 0])
    return combined, combined.per_agent.copy(), np.stack(exposures, axis=1), [r.kind for r in risks], steps, doubts


def within_any_dependence(
    total: Array, error: Array, kind: Kind, steps: Array, doubts: Array
) -> tuple[Array, Array, Kind]:
    """An agent's total (B,), error (B,) and kind, held between the largest of its steps (B, T) and their sum.

    The truth lies there whatever the dependence (Fréchet 1935). A total moved by more than its error was no exact one;
    `doubts` (B, T) are the errors of the steps, by which a better total may be outside.
    """
    held = np.clip(total, steps.max(axis=-1), np.minimum(steps.sum(axis=-1), 1.0))
    moved = np.abs(held - total)
    if (moved > PATH_SAFETY * (error + doubts.sum(axis=-1)) + 1e-5 * held).any():
        kind = Kind.weakest([kind, Kind.ESTIMATE])
    return held, error + moved, kind


def _first(risk: Array) -> Array:
    """Probability that the first hit is at each step, for independent steps (B, T, K)."""
    missed = np.cumprod(1.0 - risk, axis=1)
    before: Array = np.concatenate([np.ones_like(missed[:, :1]), missed[:, :-1]], axis=1)
    return risk * before


def _marginals(batch: Array, pred: PositionPrediction, ego: EgoShape, dependence: str, tolerance: float) -> Risk:
    """(B, T, K), each by the sweep of one step."""
    if isinstance(pred, MomentPrediction):
        if dependence != "boole":
            raise InputError(
                f"dependence: {pred.name or 'an agent'} is known by its moments only; "
                f"expected 'boole', got {dependence!r}"
            )
        return checker("marshall-olkin")(batch, pred, ego)
    return step_risk(batch, pred, ego, tolerance)


def step_risk(poses: Array, pred: GaussianMixturePrediction, ego: EgoShape, tolerance: float) -> Risk:
    """Marginals (…, T, K) of poses (…, T, 3) in one agent's shape, exact, pieces of a cover united."""
    shape_kind, shape = shape_against(ego, pred)
    batch = np.ascontiguousarray(poses.reshape(-1, *poses.shape[-2:]))
    value = np.empty((*batch.shape[:2], pred.means.shape[1]))
    error = np.empty_like(value)
    for k, mode in enumerate(_modes(pred, shape_kind)):
        one = np.empty((2, *batch.shape[:2]))
        roots = square_root(mode.covariances)
        sweep_steps(shape_kind, shape, batch, mode.means, roots, mode.headings, tolerance, one[0], one[1])
        value[..., k], error[..., k] = one
    lead = (*poses.shape[:-1], -1)
    return Risk(value.reshape(lead), Kind.EXACT, error.reshape(lead), None, "sweep")


def persistent_risk(
    batch: Array, pred: PositionPrediction, ego: EgoShape, tolerance: float, seed: int
) -> tuple[Array, Array, Array, Kind]:
    """Total (B,), estimate of its error (B,), exposure (B, T) and kind: poses (B, T, 3), one agent with factors."""
    if pred.modes != "persistent":
        raise InputError(
            f"modes: factors of {pred.name or 'an agent'} persist; expected persistent modes, got per_step"
        )
    shape_kind, shape = shape_against(ego, pred)
    total, error, exposure, kind = np.zeros(len(batch)), np.zeros(len(batch)), np.zeros(batch.shape[:2]), Kind.EXACT
    for weight, mode in zip(pred.weights, _modes(pred, shape_kind), strict=True):
        assert mode.factors is not None  # noqa: S101  told apart by the caller
        own = idiosyncratic(mode.covariances, mode.factors)
        rank = mode.factors.shape[-1]
        value, spread, first = np.empty(len(batch)), np.empty(len(batch)), np.empty(batch.shape[:2])
        if rank <= 2 and not own.any():
            plane = np.zeros((len(mode.means), 2, 2))
            plane[..., :rank] = mode.factors
            sweep_paths(shape_kind, shape, batch, mode.means, plane, mode.headings, tolerance, value, spread, first)
        else:
            inputs = (mode.means, mode.factors, own, mode.headings)
            for b, poses in enumerate(batch):
                first[b], spread[b], one = over_factors(shape_kind, shape, poses, inputs, tolerance, seed)
                value[b], kind = first[b].sum(), Kind.weakest([kind, one])
        total += weight * value
        error += weight * spread
        exposure += weight * first
    return total, error, exposure, kind


def _modes(pred: PositionPrediction, shape_kind: int) -> list[_Mode]:
    headings = headings_for(pred, shape_kind)
    factors = pred.factors
    return [
        _Mode(
            np.ascontiguousarray(pred.means[:, k]),
            np.ascontiguousarray(pred.covariances[:, k]),
            None if factors is None else np.ascontiguousarray(factors[:, k]),
            np.ascontiguousarray(headings[:, k]),
        )
        for k in range(pred.means.shape[1])
    ]


def shape_against(ego: EgoShape, pred: PositionPrediction) -> tuple[int, Array]:
    """The shape against this agent, as `kernels.path` reads it."""
    if isinstance(ego, EgoBox):
        if pred.headings is None:
            raise InputError(f"headings: EgoBox needs agents that carry them, {pred.name or 'an agent'} has None")
        return BOXES, np.array([[ego.length, ego.width, *agent_size("EgoBox", pred)]]) / 2
    if isinstance(ego, AlignedEllipsoid):
        return ALIGNED, np.array([ego.forms(pred)])
    if not hasattr(ego, "pieces"):
        raise InputError(f"ego: expected a shape such as EgoBox, got {type(ego).__name__}")
    return FIXED, pack_pieces(*ego.pieces(pred))


def headings_for(pred: PositionPrediction, shape_kind: int) -> Array:
    """(T, K): the agent's own, or the direction in which its mean moves; 0 where no shape reads them.

    Raises:
        InputError: if headings are needed, not carried, and a mean does not move.
    """
    if shape_kind == FIXED:
        return np.zeros(pred.means.shape[:2])
    return course(pred)
