"""How a position depends on itself over time: x_t = μ_t + B_t ξ + ε_t, one ξ ~ N(0, I) per trajectory."""

from __future__ import annotations

from typing import Any

import numpy as np

from checkers.validate import FARTHEST, Array, InputError, as_array, lowest_eigenvalue

_ROUNDING = 1e-9  # of the covariance: what is negative by less is zero


def as_factors(value: Any, covariances: Array) -> Array | None:
    """Factors (…, 2, R) whose B Bᵀ the covariances (…, 2, 2) exceed or equal; None stays None."""
    if value is None:
        return None
    factors = as_array("factors", value, (*covariances.shape[:-2], 2, "R"), largest=FARTHEST)
    rest = covariances - factors @ np.swapaxes(factors, -1, -2)
    lowest, scale = lowest_eigenvalue(rest), np.abs(covariances).max(axis=(-2, -1))
    bad = np.argwhere(lowest < -_ROUNDING * scale)
    if len(bad):
        raise InputError(
            f"factors{bad[0].tolist()}: expected factors @ factors.T of at most the covariance, got a rest with "
            f"eigenvalue {lowest[tuple(bad[0])]:g} m²"
        )
    return factors


def idiosyncratic(covariances: Array, factors: Array) -> Array:
    """Covariance (…, 2, 2) of the part that is independent from step to step; what is left of rounding is exactly 0."""
    values, vectors = np.linalg.eigh(covariances - factors @ np.swapaxes(factors, -1, -2))
    scale = np.abs(covariances).max(axis=(-2, -1))[..., None]
    values = np.where(values > _ROUNDING * scale, values, 0.0)
    rest: Array = (vectors * values[..., None, :]) @ np.swapaxes(vectors, -1, -2)
    return rest


def leading_factors(covariance: Any, rank: int) -> tuple[Array, Array]:
    """Factors (T, 2, R) and covariances (T, 2, 2) of a trajectory covariance (2T, 2T), ordered x₁, y₁, x₂, y₂, ….

    Principal factors: the leading eigenvectors, scaled; then B Bᵀ ⪯ the covariance, so that every E_t ⪰ 0. The marginal
    covariances are kept exactly, of the covariance between steps its best approximation of that rank.

    Raises:
        InputError: on a matrix that is not a covariance or a rank outside 1 … 2T.
    """
    full = as_array("covariance", covariance, ("2T", "2T"), largest=FARTHEST**2)
    size = len(full)
    if full.shape != (size, size) or size % 2:
        raise InputError(f"covariance: expected shape (2T, 2T), got {full.shape}")
    if not isinstance(rank, int | np.integer) or isinstance(rank, bool) or not 1 <= rank <= size:
        raise InputError(f"rank: expected an integer from 1 to {size}, got {rank!r}")
    values, vectors = np.linalg.eigh(0.5 * (full + full.T))
    scale = np.abs(full).max()
    if np.abs(full - full.T).max() > 1e-9 * scale or values[0] < -1e-9 * scale:
        raise InputError("covariance: expected a symmetric positive semi-definite matrix")
    lead = vectors[:, ::-1][:, :rank] * np.sqrt(np.maximum(values[::-1][:rank], 0.0))
    factors = lead.reshape(size // 2, 2, rank)
    blocks = full.reshape(size // 2, 2, size // 2, 2)
    marginal = blocks[np.arange(size // 2), :, np.arange(size // 2)]
    # rounding must not leave a negative rest
    own = idiosyncratic(marginal, factors)
    return factors, own + factors @ np.swapaxes(factors, -1, -2)


def fit_factors(residuals: Any, rank: int) -> tuple[Array, Array]:
    """Factors (T, 2, R) and covariances (T, 2, 2) from recorded residuals (n, T, 2) = observed − predicted mean [m].

    The second moment about zero is taken, so that a bias of the prediction counts as spread.

    Raises:
        InputError: on wrong shapes or fewer than two trajectories.
    """
    values = as_array("residuals", residuals, ("n", "T", 2), largest=FARTHEST)
    if len(values) < 2:
        raise InputError(f"residuals: expected at least 2 trajectories, got {len(values)}")
    flat = values.reshape(len(values), -1)
    return leading_factors(flat.T @ flat / len(flat), rank)
