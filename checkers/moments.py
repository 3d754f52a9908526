"""Arrays of central moments: those of a Gaussian, and which ones some distribution has."""

from __future__ import annotations

from typing import Any

import numpy as np

from checkers.validate import Array, InputError, as_count

HIGHEST = 100  # beyond, powers of deviations leave the doubles


def gaussian_central_moments(covariances: Any, order: int) -> Array:
    """Central moments (…, order+1, order+1) of N(0, Σ) by Stein's recursion; NaN where i + j > order."""
    covariances = np.asarray(covariances, dtype=float)
    a, b, c = covariances[..., 0, 0], covariances[..., 0, 1], covariances[..., 1, 1]
    out = np.full((*covariances.shape[:-2], order + 1, order + 1), np.nan)
    out[..., 0, 0] = 1.0
    for j in range(1, order + 1):
        out[..., 0, j] = c * (j - 1) * out[..., 0, j - 2] if j > 1 else 0.0
    for i in range(1, order + 1):
        for j in range(order + 1 - i):
            value = a * (i - 1) * out[..., i - 2, j] if i > 1 else np.zeros_like(a)
            out[..., i, j] = value + (b * j * out[..., i - 1, j - 1] if j else 0.0)
    return out


def check_order(order: Any) -> None:
    """Refuse anything but an integer from 2 to `HIGHEST`."""
    as_count("moments: order", order, 2, HIGHEST)


def check_moment_matrix(moments: Array) -> None:
    """Refuse moments that no distribution has: E[p(x, y)²] must not be negative for any polynomial p.

    The matrix of E[x^(a+c) y^(b+d)] over monomials up to half the order, scaled to a unit diagonal, must be positive
    semi-definite; singular ones (point masses) pass.
    """
    half = (moments.shape[-1] - 1) // 2
    powers = [(a, b) for a in range(half + 1) for b in range(half + 1 - a)]
    matrix = np.array([[moments[..., a + c, b + d] for c, d in powers] for a, b in powers])
    matrix = np.moveaxis(matrix, (0, 1), (-2, -1))
    diagonal = np.diagonal(matrix, axis1=-2, axis2=-1)
    size = np.sqrt(np.maximum(diagonal, 0.0))
    scaled = matrix / np.where(size > 0, size, 1.0)[..., :, None] / np.where(size > 0, size, 1.0)[..., None, :]
    bad = np.argwhere((np.linalg.eigvalsh(scaled)[..., 0] < -1e-8) | (diagonal < 0).any(axis=-1))
    if len(bad):
        t, k = (int(i) for i in bad[0])
        raise InputError(
            f"central_moments[{t}, {k}]: expected moments that some distribution has, "
            "got a moment matrix that is not positive semi-definite"
        )
