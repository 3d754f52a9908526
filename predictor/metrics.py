"""How good predictions are: distances of the best mode, likelihoods, and the share of truth within stated regions."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from checkers.validate import Array
from predictor.forecasts import Forecasts, lower, to_mixture
from predictor.loss import joint_log_likelihood, marginal_log_likelihood

LEVELS = (0.5, 0.9, 0.99)
HORIZONS = (1.0, 2.0, 3.0)
SAMPLES = 256
_CHUNK = 128


def min_ade(forecasts: Forecasts, truth: Array) -> Array:
    """(N,) least mean distance over the modes from the truth (N, T, 2) [m] (Chang et al. 2019, Argoverse)."""
    out: Array = _distances(forecasts, truth).mean(axis=1).min(axis=1)
    return out


def min_fde(forecasts: Forecasts, truth: Array) -> Array:
    """(N,) least distance over the modes at the last step [m]."""
    out: Array = _distances(forecasts, truth)[:, -1].min(axis=1)
    return out


def marginal_nll(forecasts: Forecasts, truth: Array) -> Array:
    """(N,) negative log-likelihood of the positions one by one, mean over the steps [nat, densities per m²]."""
    mixture = to_mixture(forecasts, truth[:, 0])
    own = torch.from_numpy(truth - truth[:, :1])
    out: Array = -marginal_log_likelihood(mixture, own).mean(dim=1).numpy()
    return out


def joint_nll(forecasts: Forecasts, truth: Array) -> Array:
    """(N,) negative log-likelihood of the whole trajectory per step, comparable with `marginal_nll` [nat per step].

    Persistent modes (and factors) are drawn once; modes per step and independent errors make it the marginal one.
    """
    if forecasts.modes == "per_step":
        return marginal_nll(forecasts, truth)
    mixture = to_mixture(forecasts, truth[:, 0])
    own = torch.from_numpy(truth - truth[:, :1])
    out: Array = -joint_log_likelihood(mixture, own).numpy() / truth.shape[1]
    return out


def region_mass(forecasts: Forecasts, truth: Array, rows: Any, samples: int = SAMPLES) -> Array:
    """(N, H) mass of the highest-density region on whose edge the truth lies, at steps `rows` (H,).

    P(f(X) > f(truth)) for X of the mixture of density f (Hyndman 1996): the truth lies within the region of mass p
    exactly where this is at most p, so of a calibrated prediction it is uniform on [0, 1]. By quadrature with
    `samples` points of equal weight per mode on a spiral (Vogel 1979): for one Gaussian within half a point of exact.
    """
    rows = np.atleast_1d(np.asarray(rows))
    turn = np.arange(samples)
    radius, angle = np.sqrt(-2.0 * np.log1p(-(turn + 0.5) / samples)), turn * np.pi * (3.0 - np.sqrt(5.0))
    normal = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)]).astype(np.float32)
    parts = [
        _mass(forecasts.of(slice(i, i + _CHUNK)), truth[i : i + _CHUNK], rows, normal)
        for i in range(0, len(forecasts), _CHUNK)
    ]
    return np.concatenate(parts).astype(float)


def coverage(mass: Array, levels: Any = LEVELS) -> Array:
    """(L, H) share of truth within the highest-density regions of mass `levels` (L,)."""
    out: Array = (mass[None] <= np.asarray(levels)[:, None, None]).mean(axis=1)
    return out


def summary(forecasts: Forecasts, truth: Array) -> dict[str, Any]:
    """Plain numbers for a report or a model card."""
    rows = [int(np.argmin(np.abs(forecasts.times - h))) for h in HORIZONS if h <= forecasts.times[-1] + 1e-6]
    shares = coverage(region_mass(forecasts, truth, rows))
    inside = {f"{forecasts.times[r]:.3g} s": [round(float(v), 4) for v in shares[:, i]] for i, r in enumerate(rows)}
    return {
        "windows": len(forecasts),
        "min_ade": round(float(min_ade(forecasts, truth).mean()), 4),
        "min_fde": round(float(min_fde(forecasts, truth).mean()), 4),
        "nll": round(float(marginal_nll(forecasts, truth).mean()), 4),
        "joint_nll": round(float(joint_nll(forecasts, truth).mean()), 4),
        "within_50_90_99": inside,
    }


def _distances(forecasts: Forecasts, truth: Array) -> Array:
    """(N, T, K) [m]."""
    return np.asarray(np.linalg.norm(forecasts.means - truth[:, :, None], axis=-1))


def _mass(forecasts: Forecasts, truth: Array, rows: Array, normal: Any) -> Any:
    """Single precision and small chunks: most of the time goes here, and the arrays then stay in the cache."""
    single = np.float32
    roots = lower(forecasts.covariances[:, rows]).astype(single)[:, None]  # (N, 1, H, K, 2, 2)
    offsets = (forecasts.means[:, rows] - truth[:, rows][:, :, None]).astype(single)[:, None]  # the truth is the origin
    weights = forecasts.weights[:, rows].astype(single)[:, None]  # (N, 1, H, K)
    with np.errstate(divide="ignore"):
        peaks = np.log(weights) - np.log(roots[..., 0, 0] * roots[..., 1, 1])

    def log_density(x: Any, y: Any) -> Any:
        """Of points (N, S, H), up to log 2π; below e^-80 of the highest peak all is alike."""
        total, highest = np.float32(0.0), peaks.max(axis=-1)
        for k in range(weights.shape[-1]):
            first = (x - offsets[..., k, 0]) / roots[..., k, 0, 0]
            second = (y - offsets[..., k, 1] - roots[..., k, 1, 0] * first) / roots[..., k, 1, 1]
            total = total + np.exp(np.maximum(peaks[..., k] - highest - 0.5 * (first**2 + second**2), -80.0))
        return np.log(total)

    nowhere = np.zeros((len(truth), 1, len(rows)), dtype=single)
    at_truth = log_density(nowhere, nowhere)
    mass = np.zeros((len(truth), len(rows)), dtype=single)
    for k in range(weights.shape[-1]):  # the same points for every mode, each with the mode's weight
        x = offsets[..., k, 0] + roots[..., k, 0, 0] * normal[:, 0, None]
        y = offsets[..., k, 1] + roots[..., k, 1, 0] * normal[:, 0, None] + roots[..., k, 1, 1] * normal[:, 1, None]
        mass += weights[:, 0, :, k] * (log_density(x, y) > at_truth).mean(axis=1)
    return mass
