"""Predicted controls as predictions of positions: a Dubins car per agent, its moments propagated exactly."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from checkers import ControlPrediction, Normal, dynamics
from checkers.validate import Array
from predictor.forecasts import Forecasts
from predictor.network import Mixture, NetworkConfig


def control_predictions(
    mixture: Mixture,
    config: NetworkConfig,
    starts: Array,
    variances: Array | None = None,
    names: Sequence[str] | None = None,
    sizes: Array | None = None,
) -> tuple[ControlPrediction, ...]:
    """A `ControlPrediction` per agent, from a mixture of controls in the network's units.

    Args:
        mixture: as stated by a network of `target="controls"`.
        config: of the network.
        starts: (N, 4) x, y [m], speed [m/s], heading [rad] at time 0.
        variances: (T,) factors on the variances of the controls.
        names, sizes: N labels, and (N, 2) length and width [m].
    """
    car = dynamics.dubins(config.dt)
    unit = np.array(config.control_scale)
    means = mixture.means.double().numpy() * unit
    spread = np.sqrt(np.ones(config.predicted) if variances is None else variances)
    deviations = mixture.roots.double().diagonal(dim1=-2, dim2=-1).numpy() * unit * spread[:, None, None]
    weights = np.exp(mixture.log_weights.double().numpy())
    weights /= weights.sum(axis=-1, keepdims=True)
    out = []
    for i, (x, y, speed, heading) in enumerate(starts.tolist()):
        modes = [
            {
                noise: [Normal(m, s) for m, s in zip(means[i, :, k, j], deviations[i, :, k, j], strict=True)]
                for j, noise in enumerate(("w_v", "w_theta"))
            }
            for k in range(config.modes)
        ]
        size = (None, None) if sizes is None else sizes[i].tolist()
        out.append(
            ControlPrediction(
                car,
                {"x": x, "y": y, "v": speed, "theta": heading},
                modes,
                config.predicted,
                weights[i, 0] if config.weights == "persistent" else weights[i],
                modes=config.weights,
                name="" if names is None else names[i],
                length=size[0],
                width=size[1],
            )
        )
    return tuple(out)


def to_forecasts(predictions: Sequence[ControlPrediction]) -> Forecasts:
    """Mean and covariance of the positions from `dt` on, a Gaussian each: for metrics, which know Gaussians only."""
    moments = [p.moments(2) for p in predictions]
    weights = np.stack([np.broadcast_to(m.weights, m.means.shape[:2])[1:] for m in moments])
    covariances = np.stack([m.covariances[1:] for m in moments])
    # at the first step the position is known from the last state alone, and its variance is 0
    covariances = covariances + 1e-6 * np.eye(2)
    return Forecasts(moments[0].times[1:], weights, np.stack([m.means[1:] for m in moments]), covariances)
