"""Forecasts on other times, with the headings of the bodies: what turns a network's grid into a scene's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from checkers.dependence import idiosyncratic
from checkers.resample import brackets, mixer
from checkers.validate import Array
from predictor.forecasts import Forecasts

SLOWEST = 0.5  # below, a mean's motion says nothing about the body's heading [m/s]


def with_present(forecasts: Forecasts, positions: Array, spread: float) -> Forecasts:
    """With a step at time 0 put before: each agent where it was observed last, `spread` [m] about it."""
    n, _, k = forecasts.means.shape[:3]
    now = np.broadcast_to(positions[:, None, None], (n, 1, k, 2))
    own = np.broadcast_to(spread**2 * np.eye(2), (n, 1, k, 2, 2))
    factors = forecasts.factors
    if factors is not None:
        factors = np.concatenate([np.zeros_like(factors[:, :1]), factors], axis=1)
    return replace(
        forecasts,
        times=np.concatenate([[0.0], forecasts.times]),
        weights=np.concatenate([forecasts.weights[:, :1], forecasts.weights], axis=1),
        means=np.concatenate([now, forecasts.means], axis=1),
        covariances=np.concatenate([own, forecasts.covariances], axis=1),
        factors=factors,
    )


def at(forecasts: Forecasts, times: Array) -> Forecasts:
    """On other times (S,) within its own, interpolated as `GaussianMixturePrediction.at` does.

    Raises:
        InputError: for a time outside: nothing is extrapolated.
    """
    left, right, share = brackets(_Named(forecasts.times), times)
    along = mixer(left, right, share)

    def mix(values: Array) -> Array:
        return np.moveaxis(along(np.moveaxis(values, 1, 0)), 0, 1)

    covariances, factors = forecasts.covariances, forecasts.factors
    if factors is None:
        covariances = mix(covariances)
    else:
        own, factors = mix(idiosyncratic(covariances, factors)), mix(factors)
        covariances = own + factors @ np.swapaxes(factors, -1, -2)
    return replace(
        forecasts,
        times=times,
        weights=mix(forecasts.weights),
        means=mix(forecasts.means),
        covariances=covariances,
        factors=factors,
    )


def headings(forecasts: Forecasts, positions: Array, now: Array) -> Array:
    """(N, T, K) directions [rad] in which the means move, from `positions` (N, 2) at time 0, headings then `now` (N,).

    Over two steps before and after, since a network's means are not smooth. A mean slower than `SLOWEST`, or one that
    turns by more than a right angle at once, keeps the heading before: cars do not turn on the spot.
    """
    n, steps, k = forecasts.means.shape[:3]
    start = np.broadcast_to(positions[:, None, None], (n, 1, k, 2))
    course = np.concatenate([start, forecasts.means], axis=1)
    times = np.concatenate([[0.0], forecasts.times])
    at_step = np.arange(1, steps + 1)
    before, after = np.maximum(at_step - 2, 0), np.minimum(at_step + 2, steps)
    velocity = (course[:, after] - course[:, before]) / (times[after] - times[before])[:, None, None]
    speed, direction = np.hypot(velocity[..., 0], velocity[..., 1]), np.arctan2(velocity[..., 1], velocity[..., 0])
    out = np.empty((n, steps, k))
    held = np.broadcast_to(now[:, None], (n, k))
    for t in range(steps):
        turn = np.abs(np.remainder(direction[:, t] - held + np.pi, 2 * np.pi) - np.pi)
        held = np.where((speed[:, t] > SLOWEST) & (turn < np.pi / 2), direction[:, t], held)
        out[:, t] = held
    return out


class _Named:
    """What `brackets` asks of a prediction."""

    name = "the network"

    def __init__(self, times: Array) -> None:
        self.times = times
