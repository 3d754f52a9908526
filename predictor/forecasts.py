"""Predictions of many agents as arrays in the world frame, and the way between them and a network's own units."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from checkers.validate import Array, InputError
from predictor.frames import Frames
from predictor.network import Inputs, Mixture, NetworkConfig
from predictor.train import Examples
from predictor.windows import Windows


@dataclass(frozen=True, eq=False)
class Forecasts:
    """Gaussian mixtures of N agents at T common times, world frame.

    Attributes:
        times: (T,) after the last observation [s].
        weights: (N, T, K).
        means: (N, T, K, 2) [m].
        covariances: (N, T, K, 2, 2) [m²], of the position.
        factors: (N, T, K, 2, R) [m], or None: as in `GaussianMixturePrediction`.
        modes: "persistent" or "per_step".
    """

    times: Array
    weights: Array
    means: Array
    covariances: Array
    factors: Array | None = None
    modes: str = "persistent"

    def __len__(self) -> int:
        return len(self.means)

    def of(self, rows: Any) -> Forecasts:
        """Those rows only."""
        factors = None if self.factors is None else self.factors[rows]
        return replace(
            self,
            weights=self.weights[rows],
            means=self.means[rows],
            covariances=self.covariances[rows],
            factors=factors,
        )

    def scaled(self, variances: Array) -> Forecasts:
        """With the covariances of each step times `variances` (T,); correlations over time stay."""
        factors = None if self.factors is None else self.factors * np.sqrt(variances)[:, None, None, None]
        return replace(self, covariances=self.covariances * variances[:, None, None, None], factors=factors)


def frames_of(past: Array, headings: Array, config: NetworkConfig) -> Frames:
    """The frames a network works in: the targets' own, or for one that reads world coordinates its own for all."""
    if config.normalised:
        return Frames.of(past, headings, config.scale)
    return Frames(np.tile(np.array(config.origin), (len(past), 1)), np.zeros(len(past)), config.scale)


def inputs_of(frames: Frames, past: Array, lanes: Array | None, ego: Array | None, config: NetworkConfig) -> Inputs:
    """World positions past (N, P, 2), lane points (N, L, 2), nearest first, and ego futures (N, F, 2) [m] as read."""

    def read(points: Array) -> Tensor:
        return torch.from_numpy(frames.to_local(points)).float()

    lane_points = read(lanes[:, : config.lane_points]) if config.lanes and lanes is not None else None
    return Inputs(read(past), lane_points, read(ego) if config.ego_future and ego is not None else None)


def examples_of(samples: Windows, config: NetworkConfig) -> tuple[Examples, Frames]:
    """Windows in a network's units, and the frames they are seen in.

    Raises:
        InputError: windows of other lengths, without lanes, or without (all of) the future or the controls to learn.
    """
    for name, want in (("past", config.observed), ("future", config.predicted)):
        got = getattr(samples, name).shape[1]
        if got != want:
            raise InputError(f"{name}: the network is of {want} steps, the windows of {got}")
    if abs(samples.dt - config.dt) > 1e-6:
        raise InputError(f"dt: the network is of {config.dt:g} s, the windows of {samples.dt:g} s")
    frames = frames_of(samples.past, samples.headings, config)
    if config.target == "controls":
        truth = samples.controls * config.dt / np.array(config.control_scale)
    else:
        truth = frames.to_local(samples.future)
    bad = np.flatnonzero(~np.isfinite(truth).all(axis=(1, 2)))
    if len(bad):
        what = "controls" if config.target == "controls" else "future"
        raise InputError(f"{what}[{int(bad[0])}]: expected all {config.predicted} steps, got NaN")
    inputs = inputs_of(frames, samples.past, samples.lanes, samples.ego_future, config)
    return Examples(inputs, torch.from_numpy(truth).float()), frames


def to_world(mixture: Mixture, frames: Frames, config: NetworkConfig) -> Forecasts:
    """A mixture of positions in the world; covariances grow with the square of the network's scale."""
    spread = frames.factors_to_world(mixture.roots.double().numpy())
    factors = None
    if mixture.factors is not None:
        factors = frames.factors_to_world(mixture.factors.double().numpy())
        spread = np.concatenate([spread, factors], axis=-1)
    first, second = spread[..., 0, :], spread[..., 1, :]
    # products of the entries, written out: matrix products of this size take several times longer
    xx, xy, yy = (np.einsum("...r,...r", a, b) for a, b in ((first, first), (first, second), (second, second)))
    covariances = np.stack([xx, xy, xy, yy], axis=-1).reshape(*xx.shape, 2, 2)
    weights = mixture.log_weights.double().numpy()
    weights = np.exp(weights - weights.max(axis=-1, keepdims=True))
    return Forecasts(
        config.times,
        weights / weights.sum(axis=-1, keepdims=True),
        frames.to_world(mixture.means.double().numpy()),
        covariances,
        factors,
        config.weights,
    )


def to_mixture(forecasts: Forecasts, origins: Array) -> Mixture:
    """Forecasts as tensors about `origins` (N, 2) [m], for the likelihoods of `predictor.loss`, in double precision."""
    own = forecasts.covariances
    factors = None
    if forecasts.factors is not None:
        own = own - forecasts.factors @ np.swapaxes(forecasts.factors, -1, -2)
        factors = torch.from_numpy(np.ascontiguousarray(forecasts.factors))
    with np.errstate(divide="ignore"):
        log_weights = torch.from_numpy(np.log(forecasts.weights))
    means = torch.from_numpy(forecasts.means - origins[:, None, None])
    return Mixture(log_weights, means, torch.from_numpy(lower(own)), factors)


def lower(covariances: Array) -> Array:
    """Cholesky factors of (..., 2, 2); what rounding left of a lost variance is taken as 1e-12 of the other."""
    a = np.sqrt(covariances[..., 0, 0])
    b = covariances[..., 1, 0] / a
    least = 1e-12 * (covariances[..., 0, 0] + covariances[..., 1, 1])
    c = np.sqrt(np.maximum(covariances[..., 1, 1] - b**2, least))
    return np.stack([a, np.zeros_like(a), b, c], axis=-1).reshape(covariances.shape)
