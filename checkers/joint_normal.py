"""A Gaussian over several variables of an uncertain start."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from checkers.validate import FARTHEST, Array, InputError, as_array


@dataclass(frozen=True, eq=False)
class JointNormal:
    """N(mean, covariance), mean (n,), covariance (n, n) symmetric positive semi-definite.

    Raises:
        InputError: naming the field.
    """

    mean: Array
    covariance: Array

    def __post_init__(self) -> None:
        mean = as_array("JointNormal: mean", self.mean, ("n",), largest=FARTHEST)
        n = len(mean)
        covariance = as_array("JointNormal: covariance", self.covariance, (n, n), largest=FARTHEST**2)
        scale = np.abs(covariance).max()
        if np.abs(covariance - covariance.T).max() > 1e-9 * scale:
            raise InputError(f"JointNormal: covariance: expected a symmetric matrix, got {covariance.tolist()}")
        covariance = 0.5 * (covariance + covariance.T)
        if np.linalg.eigvalsh(covariance)[0] < -1e-12 * scale:
            raise InputError(
                f"JointNormal: covariance: expected a positive semi-definite matrix, got {covariance.tolist()}"
            )
        covariance.flags.writeable = False
        object.__setattr__(self, "mean", mean)
        object.__setattr__(self, "covariance", covariance)

    def central_moment(self, powers: Any) -> float:
        """E[Π (X_i − μ_i)^powers_i] by Stein's lemma (Isserlis 1918)."""
        return _central_moment(self.covariance, tuple(int(p) for p in powers), {})

    def sample(self, n: int, rng: np.random.Generator) -> Array:
        """Draws (n, len(mean)); the covariance may be singular."""
        values, vectors = np.linalg.eigh(self.covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        return np.asarray(self.mean + rng.standard_normal((n, len(self.mean))) @ root.T)


def _central_moment(covariance: Array, powers: tuple[int, ...], known: dict[tuple[int, ...], float]) -> float:
    if sum(powers) % 2 or min(powers) < 0:
        return 0.0
    if not any(powers):
        return 1.0
    if powers not in known:
        first = next(i for i, p in enumerate(powers) if p)
        left = list(powers)
        left[first] -= 1
        total = 0.0
        for i, power in enumerate(left):
            if power:
                rest = tuple(p - (k == i) for k, p in enumerate(left))
                total += covariance[first, i] * power * _central_moment(covariance, rest, known)
        known[powers] = total
    return known[powers]
