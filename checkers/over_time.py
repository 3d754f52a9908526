"""How an agent's position at one time goes with that at another: moments over two times, from its controls."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from checkers.control_prediction import ControlPrediction
from checkers.dependence import leading_factors
from checkers.dynamics import System
from checkers.prediction import GaussianMixturePrediction, MomentPrediction
from checkers.propagation import position_moments
from checkers.random_variables import Constant
from checkers.validate import Array, InputError, as_instance

_WORDS = ("then", "hold")


def covariance_over_time(pred: ControlPrediction) -> Array:
    """(K, 2T, 2T) covariance [m²] of each mode's trajectory, ordered x₁, y₁, x₂, y₂, …; exact up to rounding.

    Cross-time moments obey the same linear moment dynamics (Jasour et al. 2021, section V): the position is copied at
    the earlier time into variables that then stand still, and the moments of both are propagated together.
    """
    if not isinstance(pred, ControlPrediction):
        raise InputError(f"prediction: expected a ControlPrediction, got {type(pred).__name__}")
    known = pred.moments(2)
    rows = np.rint(pred.times / pred.system.dt).astype(int)
    count = len(rows)
    out = np.zeros((len(pred.weights), count, 2, count, 2))
    every = np.arange(count)
    out[:, every, :, every, :] = known.covariances
    for axis, other, then, system in _copied(pred.system):
        initial = {**pred.initial, (then,): Constant(0.0)}
        for k, mode in enumerate(pred.controls):
            last = int(rows[-1])
            # one run for each earlier time; a hold of 1 copies the position of that step, 0 keeps the copy
            holds = [[Constant(float(t == row)) for t in range(last)] for row in rows[:-1]]
            runs = [[[*(draws[:last] for draws in component), hold] for component in mode.components] for hold in holds]
            if not runs:
                continue
            weights = np.broadcast_to(mode.weights[:last], (len(runs), *mode.weights[:last].shape))
            central = position_moments(system, initial, runs, np.ascontiguousarray(weights), 2).central
            for earlier in range(count - 1):
                later = rows[earlier + 1 :]
                found = central[later, earlier, 1, 1]
                out[k, earlier + 1 :, axis, earlier, other] = found
                out[k, earlier, other, earlier + 1 :, axis] = found
    return out.reshape(len(pred.weights), 2 * count, 2 * count)


def with_factors(pred: ControlPrediction, rank: int = 2, order: int = 2) -> MomentPrediction:
    """The agent's exact moments, with the leading factors of its exact trajectory covariance as `factors` (T, K, 2, R).

    Args:
        pred: the agent.
        rank: R, number of factors of each mode.
        order: of the moments, 2 to 12.
    """
    known = as_instance("pred", pred, ControlPrediction).moments(order)
    factors = [leading_factors(mode, rank)[0] for mode in covariance_over_time(pred)]
    return MomentPrediction(
        known.times,
        known.weights,
        known.means,
        known.central_moments,
        name=known.name,
        length=known.length,
        width=known.width,
        factors=np.stack(factors, axis=1),
    )


def as_gaussian(pred: MomentPrediction) -> GaussianMixturePrediction:
    """Gaussian modes of the same mean, covariance and factors: an assumption that moments do not make."""
    if not isinstance(pred, MomentPrediction):
        raise InputError(f"prediction: expected a MomentPrediction, got {type(pred).__name__}")
    return GaussianMixturePrediction(
        pred.times,
        pred.weights,
        pred.means,
        pred.covariances,
        pred.modes,
        pred.name,
        pred.length,
        pred.width,
        pred.headings,
        pred.factors,
    )


def _copied(system: System) -> Iterator[tuple[int, int, str, System]]:
    """For each axis now and each axis then, the copy's name and the system with it; its position is the pair."""
    taken = {*system.variables, *system.noises}
    then, hold = (next(n for n in (f"{word}{i}" for i in range(len(taken) + 1)) if n not in taken) for word in _WORDS)
    for axis, other in product(range(2), repeat=2):
        source = system.position[other]
        updates = {**dict(system.updates), then: f"{then} + {hold} * {source} - {hold} * {then}"}
        yield axis, other, then, System(updates, (*system.noises, hold), system.dt, (system.position[axis], then))
