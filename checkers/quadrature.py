"""Quadrature rules of standard distributions: points and weights, cached by how fast a wave they must carry."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from checkers.validate import Array, InputError

HIGHEST_POWER = 24


class Rule(NamedTuple):
    """E f(X) = Σ weights · f(mean + deviations) to rounding, for f of degree 24 at most and waves of the frequency."""

    deviations: Array
    weights: Array


def quarters_of(frequency: float) -> int:
    """A frequency rounded up to quarters: rules are cached, and few of them suffice."""
    quarters = int(np.ceil(4.0 * abs(frequency)))
    if quarters > 4000:
        raise InputError(f"random variable: waves of {quarters / 4:g} rad per spread cannot be integrated")
    return quarters


@lru_cache(maxsize=256)
def standard_normal(quarters: int) -> tuple[Array, Array]:
    """For N(0, 1)."""
    # 14 σ: x²⁴ times the density has fallen to 1e-16 of its integral there
    reach = 14.0
    count = int(np.ceil(reach * (12.0 + quarters / 4) / (2 * np.pi)))
    points = np.linspace(-reach, reach, 2 * count + 1)
    weights = np.exp(-0.5 * points**2)
    return _frozen(points, weights)


@lru_cache(maxsize=256)
def jacobi(alpha: float, beta: float, quarters: int) -> tuple[Array, Array]:
    """For the density (1 − x)^alpha (1 + x)^beta on [−1, 1]."""
    from scipy.special import roots_jacobi  # noqa: PLC0415  scipy.special costs import time

    return _frozen(*roots_jacobi(20 + quarters // 4, alpha, beta))


@lru_cache(maxsize=256)
def standard_gamma(shape: float, quarters: int) -> tuple[Array, Array]:
    """x = exp(u − exp(−u)); deviations from the mean `shape`."""
    # fine enough for the density, of spread √shape, and for the wave at x ≈ shape
    step = 1.0 / (16.0 + 2.0 * np.sqrt(shape) + quarters * (4.0 + shape / 20.0))
    # from where x^shape is e⁻⁵⁰
    u = np.arange(-np.log(50.0 / min(shape, 0.1)), 8.0 + np.log1p(shape), step)
    log_x = u - np.exp(-u)
    # the largest term is scaled to 1, so that no shape overflows
    log_weight = shape * log_x - np.exp(log_x) + np.log1p(np.exp(-u))
    weights = np.exp(log_weight - log_weight.max())
    kept = weights > 1e-40
    return _frozen(np.exp(log_x[kept]) - shape, weights[kept])


def _frozen(points: Array, weights: Array) -> tuple[Array, Array]:
    weights = weights / weights.sum()
    points.flags.writeable = weights.flags.writeable = False
    return points, weights
