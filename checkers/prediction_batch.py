"""Many Gaussian mixtures of one shape at once: what a predictor states of all agents, checked in one go."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from checkers.dependence import as_factors
from checkers.prediction import GaussianMixturePrediction
from checkers.validate import FARTHEST, Array, InputError, as_array, as_covariances, as_times


def gaussian_mixtures(
    times: Any,
    weights: Any,
    means: Any,
    covariances: Any,
    names: Sequence[str],
    sizes: Any,
    headings: Any,
    factors: Any = None,
    modes: str = "persistent",
) -> tuple[GaussianMixturePrediction, ...]:
    """As N calls of `GaussianMixturePrediction`, with the same checks, at a hundredth of their cost.

    Args:
        times: (T,) common to all [s].
        weights: (N, K) or (N, T, K).
        means: (N, T, K, 2) [m].
        covariances: (N, T, K, 2, 2) [m²].
        names: N labels.
        sizes: (N, 2) length and width [m].
        headings: (N, T, K) [rad].
        factors: (N, T, K, 2, R) [m], or None.
        modes: "persistent" or "per_step".

    Raises:
        InputError: naming the field and the index, the agent's first.
    """
    times = as_times("times", times)
    means = as_array("means", means, ("N", len(times), "K", 2), largest=FARTHEST)
    count, shape = len(means), means.shape[:3]
    covariances = as_covariances("covariances", covariances, shape)
    factors = as_factors(factors, covariances)
    headings, sizes = as_array("headings", headings, shape), as_array("sizes", sizes, (count, 2))
    if np.any(sizes <= 0):
        raise InputError(f"sizes[{int(np.argwhere(sizes <= 0)[0, 0])}]: expected lengths and widths > 0")
    if len(names) != count or not all(isinstance(name, str) for name in names):
        raise InputError(f"names: expected {count} texts, got {len(names)}")
    first = GaussianMixturePrediction(times, np.asarray(weights)[0], means[0], covariances[0], modes=modes)
    weights = _weights(weights, first.weights.shape, count)
    out = []
    for i in range(count):
        agent = object.__new__(GaussianMixturePrediction)
        agent.__dict__.update(
            times=first.times,
            weights=weights[i],
            means=means[i],
            covariances=covariances[i],
            modes=modes,
            name=names[i],
            length=float(sizes[i, 0]),
            width=float(sizes[i, 1]),
            headings=headings[i],
            factors=None if factors is None else factors[i],
        )
        out.append(agent)
    return tuple(out)


def _weights(value: Any, shape: tuple[int, ...], count: int) -> Array:
    """(N, *shape), of each agent normalised as its own would be."""
    given = as_array("weights", value, (count, *(("T", "K") if np.ndim(value) == 3 else ("K",))))
    if np.any(given < 0) or np.any(np.abs(given.sum(axis=-1) - 1.0) > 1e-6):
        bad = np.argwhere((given < 0).any(axis=-1) | (np.abs(given.sum(axis=-1) - 1.0) > 1e-6))[0].tolist()
        raise InputError(f"weights{bad}: expected weights >= 0 that sum to 1, got {given[tuple(bad)].tolist()}")
    if given.ndim > len(shape) + 1:  # persistent modes given per step
        if np.abs(given - given[:, :1]).max() > 1e-6:
            raise InputError("weights: persistent modes have one weight each; use modes='per_step'")
        given = given[:, 0]
    exact: Array = given / given.sum(axis=-1, keepdims=True)
    exact.flags.writeable = False
    return exact
