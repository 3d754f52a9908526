"""What an agent may do: mixtures of Gaussians, or of moments, on a time grid in the world frame."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from checkers.dependence import as_factors, idiosyncratic
from checkers.moments import check_moment_matrix, check_order, gaussian_central_moments
from checkers.packing import ModeArrays
from checkers.resample import brackets, cut, labels, mixer
from checkers.show import prediction_table
from checkers.validate import (
    FARTHEST,
    LARGEST_BODY,
    Array,
    InputError,
    as_array,
    as_covariances,
    as_draws,
    as_option,
    as_scalar,
    as_times,
    as_weights,
)
from checkers.writing import written

MODES = ("persistent", "per_step")


@dataclass(frozen=True, eq=False)
class GaussianMixturePrediction:
    """A Gaussian mixture per time step (Jasour et al. 2021, section III).

    Attributes:
        times: (T,) strictly increasing [s].
        weights: (K,) or (T, K) mode weights; sums within 1e-6 of 1 are normalised, others refused.
        means: (T, K, 2) [m], world frame.
        covariances: (T, K, 2, 2) [m²], symmetric positive semi-definite.
        modes: "persistent" if one mode is drawn for the whole trajectory, "per_step" if one per step.
        name: label in reports.
        length, width: the agent's size [m], if known.
        headings: (T, K) [rad] of the agent's body, if known.
        factors: (T, K, 2, R) [m], how the position depends on itself over time, if known: x_t = mean + factors ξ + ε_t
            with one ξ ~ N(0, I) per trajectory and independent ε_t; `covariances` is the sum of both parts.

    Raises:
        InputError: naming the field and the index.
    """

    times: Array
    weights: Array
    means: Array
    covariances: Array
    modes: str = "persistent"
    name: str = ""
    length: float | None = None
    width: float | None = None
    headings: Array | None = None
    factors: Array | None = None

    def __post_init__(self) -> None:
        steps, modes = _check_common(self)
        covariances = as_covariances("covariances", self.covariances, (steps, modes))
        object.__setattr__(self, "covariances", covariances)
        object.__setattr__(self, "factors", as_factors(self.factors, covariances))

    @property
    def step_weights(self) -> Array:
        """Weights as (T, K), whatever the modes do over time."""
        return np.broadcast_to(self.weights, self.means.shape[:2])

    @property
    def order(self) -> None:
        """None: a Gaussian has every moment."""

    @cached_property
    def packed(self) -> ModeArrays:
        """As compiled loops read it."""
        from checkers.kernels.whiten import pack_covariances  # noqa: PLC0415  numba costs import time

        return ModeArrays(self.means, pack_covariances(self.covariances), np.zeros((*self.means.shape[:2], 1)), 0)

    def at(self, times: Any) -> GaussianMixturePrediction:
        """The prediction on another grid; between its own times means and covariances are interpolated linearly.

        With factors, they and the covariance of the independent part are: a trajectory known from ξ alone stays so.

        Raises:
            InputError: if a time lies outside the prediction: nothing is extrapolated.
        """
        times = as_times("times", times)
        first = int(np.searchsorted(self.times, times[0]))
        if np.array_equal(times, self.times[first : first + len(times)]):
            return cut(self, slice(first, first + len(times)))
        left, right, share = brackets(self, times)
        mix, optional = mixer(left, right, share), labels(self, left, right, share)
        if self.factors is None:
            covariances = mix(self.covariances)
        else:
            shared = optional["factors"]
            covariances = mix(idiosyncratic(self.covariances, self.factors)) + shared @ np.swapaxes(shared, -1, -2)
        return GaussianMixturePrediction(
            times,
            self.weights if self.weights.ndim == 1 else mix(self.weights),
            mix(self.means),
            covariances,
            **optional,
        )

    def moments(self, order: int) -> MomentPrediction:
        """The same agent as central moments up to `order`, exact (Isserlis 1918, as a recursion)."""
        check_order(order)
        return MomentPrediction(
            self.times,
            self.weights,
            self.means,
            gaussian_central_moments(self.covariances, order),
            **labels(self),
        )

    def sample(self, n: int, rng: np.random.Generator) -> Array:
        """(n, T, 2) trajectories; a persistent mode and the factors' ξ are drawn once, the rest per step."""
        n = as_draws(n, rng)
        steps, count = self.means.shape[:2]
        if self.modes == "persistent":
            mode = np.broadcast_to(rng.choice(count, size=(n, 1), p=self.weights), (n, steps))
        else:
            uniform = rng.random((n, steps, 1))
            mode = (uniform > np.cumsum(self.step_weights, axis=-1)[:, :-1]).sum(axis=-1)
        noise = rng.standard_normal((n, steps, 2))
        own = self.covariances if self.factors is None else idiosyncratic(self.covariances, self.factors)
        root = square_root(own)
        # one gather for mean and factor; none at all for a single mode
        pick = (slice(None), 0) if count == 1 else (np.arange(steps), mode)
        mean, factor = self.means[pick], root[pick]
        if self.factors is not None:
            xi = rng.standard_normal((n, self.factors.shape[-1]))
            shared = self.factors[:, 0] if count == 1 else self.factors[pick]
            mean = mean + np.einsum("...tir,...r->...ti" if count == 1 else "ntir,nr->nti", shared, xi)
        return np.stack(
            [mean[..., i] + factor[..., i, 0] * noise[..., 0] + factor[..., i, 1] * noise[..., 1] for i in range(2)],
            axis=-1,
        )

    def save(self, path: str | Path) -> None:
        """Write to an `.npz` (no pickle)."""
        _save(self, path)

    def _repr_html_(self) -> str:
        return prediction_table(self)


@dataclass(frozen=True, eq=False)
class MomentPrediction:
    """Mean and central moments of the position per step and mode; no family of distributions is assumed.

    Attributes:
        times, weights, means, modes, name, length, width, headings, factors: as in `GaussianMixturePrediction`.
        central_moments: (T, K, n+1, n+1), [i, j] = E[(x−μx)^i (y−μy)^j] for i + j ≤ n; the rest is NaN.
    """

    times: Array
    weights: Array
    means: Array
    central_moments: Array
    modes: str = "persistent"
    name: str = ""
    length: float | None = None
    width: float | None = None
    headings: Array | None = None
    factors: Array | None = None

    def __post_init__(self) -> None:
        steps, modes = _check_common(self)
        values = as_array("central_moments", self.central_moments, (steps, modes, "n+1", "n+1"), finite=False)
        n = values.shape[-1] - 1
        if n < 2 or values.shape[-2] != n + 1:
            raise InputError(
                f"central_moments: expected shape ({steps}, {modes}, n+1, n+1), n >= 2, got {values.shape}"
            )
        known = np.add.outer(np.arange(n + 1), np.arange(n + 1)) <= n
        bad = np.argwhere(~np.isfinite(values) & known)
        if len(bad):
            raise InputError(f"central_moments{bad[0].tolist()}: expected a finite number, got {values[tuple(bad[0])]}")
        for index, expected in (((0, 0), 1.0), ((1, 0), 0.0), ((0, 1), 0.0)):
            off = np.argwhere(np.abs(values[..., index[0], index[1]] - expected) > 1e-9)
            if len(off):
                got = values[(*off[0], *index)]
                raise InputError(f"central_moments{[*off[0].tolist(), *index]}: expected {expected:g}, got {got:g}")
        clean = np.where(known, values, np.nan)
        clean.flags.writeable = False
        object.__setattr__(self, "central_moments", clean)
        covariances = as_covariances("central_moments (order 2)", self.covariances, (steps, modes))
        object.__setattr__(self, "factors", as_factors(self.factors, covariances))
        check_moment_matrix(clean)

    @property
    def order(self) -> int:
        """Highest order of the moments carried."""
        return int(self.central_moments.shape[-1]) - 1

    def packed(self, order: int) -> ModeArrays:
        """As compiled loops read it, moments to an order ≤ the one carried; mean and covariance say all of order 2."""
        order = 0 if order == 2 else order
        if order not in self._packed:
            from checkers.kernels.whiten import pack_covariances  # noqa: PLC0415  numba costs import time

            moments = self.central_moments[..., : order + 1, : order + 1].reshape(*self.means.shape[:2], -1)
            self._packed[order] = ModeArrays(
                self.means, pack_covariances(self.covariances), np.ascontiguousarray(moments), order
            )
        return self._packed[order]

    @cached_property
    def _packed(self) -> dict[int, ModeArrays]:
        return {}

    @property
    def covariances(self) -> Array:
        """(T, K, 2, 2) [m²]."""
        m = self.central_moments
        return np.stack([m[..., 2, 0], m[..., 1, 1], m[..., 1, 1], m[..., 0, 2]], -1).reshape(*m.shape[:2], 2, 2)

    @property
    def step_weights(self) -> Array:
        """Weights as (T, K)."""
        return np.broadcast_to(self.weights, self.means.shape[:2])

    def at(self, times: Any) -> MomentPrediction:
        """The prediction on another grid, moments interpolated linearly; outside its own times an error."""
        times = as_times("times", times)
        first = int(np.searchsorted(self.times, times[0]))
        if np.array_equal(times, self.times[first : first + len(times)]):
            return cut(self, slice(first, first + len(times)))
        left, right, share = brackets(self, times)
        mix = mixer(left, right, share)
        return MomentPrediction(
            times,
            self.weights if self.weights.ndim == 1 else mix(self.weights),
            mix(self.means),
            mix(self.central_moments),
            **labels(self, left, right, share),
        )

    def moments(self, order: int) -> MomentPrediction:
        """The same agent with fewer moments; asking for more than are carried is an error."""
        check_order(order)
        if order > self.order:
            raise InputError(
                f"moments: {self.name or 'agent'} carries moments up to order {self.order}, asked for {order}"
            )
        cut = self.central_moments[..., : order + 1, : order + 1]
        return MomentPrediction(self.times, self.weights, self.means, cut, **labels(self))

    def sample(self, n: int, rng: np.random.Generator) -> Array:
        """Moments do not fix a distribution: always an error."""
        raise InputError(f"sample: {self.name or 'agent'} is known by its moments only and cannot be sampled")

    def save(self, path: str | Path) -> None:
        """Write to an `.npz` (no pickle)."""
        _save(self, path)

    def _repr_html_(self) -> str:
        return prediction_table(self)


_CLASSES: dict[str, Any] = {"gaussian": GaussianMixturePrediction, "moments": MomentPrediction}


PositionPrediction = GaussianMixturePrediction | MomentPrediction


def _check_common(pred: Any) -> tuple[int, int]:
    """Validate and freeze the fields both predictions share; return (T, K)."""
    times = as_times("times", pred.times)
    steps = len(times)
    means = as_array("means", pred.means, (steps, "K", 2), largest=FARTHEST)
    modes = means.shape[1]
    as_option("modes", pred.modes, MODES)
    weights = as_weights("weights", pred.weights, steps, modes)
    if pred.modes == "persistent" and weights.ndim == 2:
        moving = np.flatnonzero(np.abs(weights - weights[0]).max(axis=-1) > 1e-6)
        if len(moving):
            raise InputError(
                f"weights[{int(moving[0])}]: persistent modes have one weight each, got {weights[moving[0]].tolist()} "
                f"after {weights[0].tolist()}; use modes='per_step'"
            )
        weights = weights[0]
    values: dict[str, Any] = {"times": times, "weights": weights, "means": means}
    for field in ("length", "width"):
        value = getattr(pred, field)
        values[field] = None if value is None else as_scalar(field, value, low=0.0, high=LARGEST_BODY, strict=True)
    if pred.headings is not None:
        values["headings"] = as_array("headings", pred.headings, (steps, modes))
    if not isinstance(pred.name, str):
        raise InputError(f"name: expected text, got {pred.name!r}")
    for field, value in values.items():
        object.__setattr__(pred, field, value)
    return steps, modes


def square_root(covariances: Array) -> Array:
    """A factor F with F Fᵀ = Σ that also exists for singular Σ."""
    values, vectors = np.linalg.eigh(covariances)
    root: Array = vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]
    return root


def _save(pred: GaussianMixturePrediction | MomentPrediction, path: str | Path) -> None:
    kind = next(key for key, cls in _CLASSES.items() if isinstance(pred, cls))
    values = {f.name: getattr(pred, f.name) for f in fields(pred)}
    present = {key: np.asarray(value) for key, value in values.items() if value is not None}
    with written(path) as part, open(part, "wb") as file:
        np.savez(file, allow_pickle=False, type=np.asarray(kind), **present)
