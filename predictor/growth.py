"""How far the truth may lie from a predicted trajectory, as time goes on: for models that do not say."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from checkers.validate import FARTHEST, Array, InputError, as_array, as_times

# slower than this, a trajectory has no direction [m/s]
MOVING = 0.3
# parameters are kept within these factors of 1
LIMITS = np.log([1e-3, 1e3])


@runtime_checkable
class Growth(Protocol):
    """A model of the spread about predicted trajectories."""

    def covariances(self, times: Array, trajectories: Array) -> Array:
        """(K, T, 2, 2) [m²] about trajectories (K, T, 2) [m] at times (T,) [s]."""


@dataclass(frozen=True)
class PowerGrowth:
    """Standard deviations √(start² + (rate · t^power)²) along and across the direction of motion.

    Where a trajectory stands still it has no direction; the larger of both then holds on every side.

    Attributes:
        along, across: (start [m], rate [m], power) each; at 1 s the spread is √(start² + rate²).
    """

    along: tuple[float, float, float]
    across: tuple[float, float, float]

    def __post_init__(self) -> None:
        for name in ("along", "across"):
            values = as_array(name, getattr(self, name), (3,))
            if np.any(values < 0) or not values[:2].any():
                raise InputError(f"{name}: expected start, rate, power >= 0, not both first 0, got {values.tolist()}")
            object.__setattr__(self, name, tuple(values.tolist()))

    def variances(self, times: Array) -> Array:
        """(T, 2) along and across [m²]."""
        starts, rates, powers = np.array([self.along, self.across]).T
        grown: Array = starts**2 + (rates * np.asarray(times)[:, None] ** powers) ** 2
        return grown

    def covariances(self, times: Any, trajectories: Any) -> Array:
        """(K, T, 2, 2) [m²] about trajectories (K, T, 2) [m] at times (T,) ≥ 0 [s] after the last observation."""
        times, trajectories = _checked(times, trajectories)
        frames, moving = directions(times, trajectories)
        own = self.variances(times)
        widest = np.broadcast_to(own.max(axis=1, keepdims=True), own.shape)
        variances = np.where(moving[..., None], own, widest)
        covariances: Array = np.einsum("ktij,ktj,ktlj->ktil", frames, variances, frames)
        return covariances

    @classmethod
    def fit(cls, times: Any, trajectories: Any, probabilities: Any, truth: Any) -> PowerGrowth:
        """By maximum likelihood of the recorded positions under the mixture at each time.

        Judging the best trajectory alone would promise too little spread: which one is best is not known beforehand.

        Args:
            times: (T,) of the steps [s].
            trajectories: (n, K, T, 2) predicted [m].
            probabilities: (n, K).
            truth: (n, T, 2) recorded [m], NaN where not.

        Raises:
            InputError: on wrong shapes or no recorded position.
        """
        from scipy.optimize import minimize  # noqa: PLC0415  costs import time

        times = as_times("times", times)
        paths = as_array("trajectories", trajectories, ("n", "K", len(times), 2), largest=FARTHEST)
        weights = as_array("probabilities", probabilities, paths.shape[:2])
        recorded = as_array("truth", truth, (len(paths), len(times), 2), finite=False)
        seen: Any = np.isfinite(recorded).all(axis=-1)
        if not seen.any():
            raise InputError("truth: expected recorded positions, got none")
        if np.any(weights < 0) or np.any(np.abs(weights.sum(axis=1) - 1) > 1e-6):
            raise InputError("probabilities: expected numbers >= 0 that sum to 1 for each prediction")
        frames, moving = directions(times, paths.reshape(-1, len(times), 2))
        missed = np.where(seen[..., None], recorded, 0.0)[:, None] - paths
        local = np.einsum("aktij,akti->aktj", frames.reshape(*paths.shape, 2), missed)
        squared, goes = local**2, moving.reshape(paths.shape[:3])
        with np.errstate(divide="ignore"):
            log_weights = np.log(weights)[..., None]
        count = seen.sum()

        def loss(x: Array) -> tuple[float, Array]:
            model = cls(tuple(np.exp(x[:3])), tuple(np.exp(x[3:])))
            own = model.variances(times)
            widest = own.argmax(axis=1)
            variances = np.where(goes[..., None], own, own.max(axis=1, keepdims=True))
            terms = log_weights - 0.5 * (np.log(variances) + squared / variances).sum(axis=-1)
            most = terms.max(axis=1, keepdims=True)
            shares = np.exp(terms - most)
            total = shares.sum(axis=1, keepdims=True)
            shares = np.where(seen[:, None], shares / total, 0.0)
            slope = 0.5 * shares[..., None] * (1 - squared / variances) / variances
            # (T, 2): of who stands, both directions hang on the wider spread
            standing = np.where(goes, 0.0, slope.sum(axis=-1)).sum(axis=(0, 1))
            by_variance = np.where(goes[..., None], slope, 0.0).sum(axis=(0, 1))
            by_variance[np.arange(len(times)), widest] += standing
            likelihood = (most + np.log(total))[:, 0][seen].sum()
            return -float(likelihood) / count, np.einsum("ta,tap->ap", by_variance, model.slopes(times)).ravel() / count

        first = np.log([0.3, 0.5, 1.0] * 2)
        result = minimize(loss, first, jac=True, method="L-BFGS-B", bounds=[tuple(LIMITS)] * 6)
        along, across = np.exp(result.x[:3]), np.exp(result.x[3:])
        return cls(tuple(along), tuple(across))

    def slopes(self, times: Array) -> Array:
        """(T, 2, 3) derivatives of `variances` by the logarithms of start, rate and power."""
        starts, rates, powers = np.array([self.along, self.across]).T
        grown = (rates * times[:, None] ** powers) ** 2
        log_times = np.log(np.where(times > 0, times, 1.0))[:, None]
        parts = [np.broadcast_to(2 * starts**2, grown.shape), 2 * grown, 2 * powers * log_times * grown]
        return np.stack(parts, axis=-1)


def directions(times: Array, trajectories: Array) -> tuple[Array, Any]:
    """Frames (K, T, 2, 2), columns along and across, and where (K, T) the trajectories have such a direction."""
    if len(times) < 2:
        return np.broadcast_to(np.eye(2), (*trajectories.shape, 2)), np.zeros(trajectories.shape[:2], dtype=bool)
    velocity = np.gradient(trajectories, times, axis=1)
    speed = np.hypot(velocity[..., 0], velocity[..., 1])
    moving = speed >= MOVING
    c, s = (np.where(moving, velocity[..., i] / np.maximum(speed, MOVING), 1.0 - i) for i in range(2))
    return np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2), moving


def _checked(times: Any, trajectories: Any) -> tuple[Array, Array]:
    times = as_times("times", times)
    if times[0] < 0:
        raise InputError(f"times[0]: expected a time >= 0 after the last observation, got {times[0]:g}")
    return times, as_array("trajectories", trajectories, ("K", len(times), 2), largest=FARTHEST)
