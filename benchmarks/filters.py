"""The usual approximations of uncertain motion, for comparison: extended Kalman filter and unscented transform.

Both keep a Gaussian over x, y, v, θ of the Dubins car and push it through one step at a time.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from checkers.validate import Array


class GaussianTrack(NamedTuple):
    """Means (T + 1, 2) and covariances (T + 1, 2, 2) of the position."""

    means: Array
    covariances: Array


def step(state: Array, noise: Array, dt: float) -> Array:
    """The car for states (…, 4) and noises (…, 2)."""
    x, y, v, theta = np.moveaxis(state, -1, 0)
    moved = [x + dt * v * np.cos(theta), y + dt * v * np.sin(theta), v + noise[..., 0], theta + noise[..., 1]]
    return np.stack(moved, axis=-1)


def extended(mean: Array, cov: Array, noise_mean: Array, noise_var: Array, dt: float, steps: int) -> GaussianTrack:
    """Linearised about the mean at each step (Jazwinski 1970)."""
    means, covs = [mean[:2]], [cov[:2, :2]]
    spread = np.diag([0.0, 0.0, *noise_var])
    for _ in range(steps):
        v, c, s = mean[2], np.cos(mean[3]), np.sin(mean[3])
        jacobian = np.eye(4)
        jacobian[0, 2:], jacobian[1, 2:] = (dt * c, -dt * v * s), (dt * s, dt * v * c)
        mean = step(mean, noise_mean, dt)
        cov = jacobian @ cov @ jacobian.T + spread
        means.append(mean[:2])
        covs.append(cov[:2, :2])
    return GaussianTrack(np.array(means), np.array(covs))


def unscented(mean: Array, cov: Array, noise_mean: Array, noise_var: Array, dt: float, steps: int) -> GaussianTrack:
    """2n + 1 sigma points of state and noise together, κ = 3 − n (Julier & Uhlmann 2004)."""
    means, covs = [mean[:2]], [cov[:2, :2]]
    n = 6
    weights = np.array([(3.0 - n) / 3.0, *[1 / 6] * (2 * n)])
    for _ in range(steps):
        joint = np.zeros((n, n))
        joint[:4, :4], joint[4:, 4:] = cov, np.diag(noise_var)
        values, vectors = np.linalg.eigh(joint)
        spread = np.sqrt(3.0) * (vectors * np.sqrt(np.maximum(values, 0.0))).T
        points = np.concatenate([mean, noise_mean]) + np.concatenate([np.zeros((1, n)), spread, -spread])
        moved = step(points[:, :4], points[:, 4:], dt)
        mean = weights @ moved
        off = moved - mean
        cov = (weights[:, None] * off).T @ off
        means.append(mean[:2])
        covs.append(cov[:2, :2])
    return GaussianTrack(np.array(means), np.array(covs))
