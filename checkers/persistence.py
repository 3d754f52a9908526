"""An error that persists, where a prediction does not say how its errors depend on each other over time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from checkers.prediction import GaussianMixturePrediction, PositionPrediction
from checkers.validate import Array, InputError, as_instance


def persistent(pred: GaussianMixturePrediction) -> GaussianMixturePrediction:
    """The agent as if one standard normal ahead and one aside moved its whole trajectory: `factors` of rank 2, no rest.

    As a speed and a lateral drift that were estimated wrong do. In the frame of the agent's headings the two are
    independent, as they are in the covariances of predictors that state them there; what covariances correlate
    between ahead and aside goes into the first factor. Covariances stay what they are. Headings not carried are
    taken to be the direction in which the mean moves, and the result carries them; where a mean stands still the two
    are along x and y.
    """
    as_instance("pred", pred, GaussianMixturePrediction)
    headings = _moving(pred) if pred.headings is None else pred.headings
    frames = np.zeros(pred.means.shape[:2]) if headings is None else headings
    c, s = np.cos(frames), np.sin(frames)
    frame = np.stack([c, -s, s, c], axis=-1).reshape(*c.shape, 2, 2)
    own = np.swapaxes(frame, -1, -2) @ pred.covariances @ frame
    # Cholesky by hand: singular covariances have one too
    ahead = np.sqrt(np.maximum(own[..., 0, 0], 0.0))
    cross = np.divide(own[..., 0, 1], ahead, out=np.zeros_like(ahead), where=ahead > 0)
    aside = np.sqrt(np.maximum(own[..., 1, 1] - cross**2, 0.0))
    root = np.stack([ahead, np.zeros_like(ahead), cross, aside], axis=-1).reshape(*c.shape, 2, 2)
    factors = frame @ root
    return replace(pred, headings=headings, factors=factors, covariances=factors @ np.swapaxes(factors, -1, -2))


def course(pred: PositionPrediction) -> Array:
    """(T, K) headings [rad]: the agent's own, or the direction in which its mean moves.

    Raises:
        InputError: if headings are not carried and a mean does not move.
    """
    found = _moving(pred) if pred.headings is None else pred.headings
    if found is None:
        raise InputError(
            f"headings: the mean of {pred.name or 'an agent'} has one step or stands still at another; "
            "expected an agent that carries headings"
        )
    return found


def _moving(pred: PositionPrediction) -> Array | None:
    """(T, K) directions of motion; None where a mean has none at some step."""
    if len(pred.times) < 2:
        return None
    speed = np.gradient(pred.means, pred.times, axis=0)
    if (np.hypot(speed[..., 0], speed[..., 1]) < 1e-3).any():
        return None
    found: Array = np.arctan2(speed[..., 1], speed[..., 0])
    return found
