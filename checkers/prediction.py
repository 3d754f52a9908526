"""What an agent may do: mixtures of Gaussians, or of moments, on a time grid in the world frame."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar
from zipfile import BadZipFile

import numpy as np

from checkers.validate import (
    FARTHEST,
    Array,
    InputError,
    as_array,
    as_covariances,
    as_option,
    as_scalar,
    as_times,
    as_weights,
)

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

    def __post_init__(self) -> None:
        steps, modes = _check_common(self)
        covariances = as_covariances("covariances", self.covariances, (steps, modes))
        object.__setattr__(self, "covariances", covariances)

    @property
    def step_weights(self) -> Array:
        """Weights as (T, K), whatever the modes do over time."""
        return np.broadcast_to(self.weights, self.means.shape[:2])

    @property
    def order(self) -> None:
        """None: a Gaussian has every moment."""

    def at(self, times: Any) -> GaussianMixturePrediction:
        """The prediction on another grid; between its own times means and covariances are interpolated linearly.

        Raises:
            InputError: if a time lies outside the prediction: nothing is extrapolated.
        """
        times = as_times("times", times)
        first = int(np.searchsorted(self.times, times[0]))
        if np.array_equal(times, self.times[first : first + len(times)]):
            return _cut(self, slice(first, first + len(times)))
        left, right, share = _brackets(self, times)
        mix = _mixer(left, right, share)
        return GaussianMixturePrediction(
            times,
            self.weights if self.weights.ndim == 1 else mix(self.weights),
            mix(self.means),
            mix(self.covariances),
            **_labels(self, left, right, share),
        )

    def moments(self, order: int) -> MomentPrediction:
        """The same agent as central moments up to `order`, exact (Isserlis 1918, as a recursion)."""
        _check_order(order)
        return MomentPrediction(
            self.times,
            self.weights,
            self.means,
            gaussian_central_moments(self.covariances, order),
            **_labels(self),
        )

    def sample(self, n: int, rng: np.random.Generator) -> Array:
        """(n, T, 2) trajectories; a persistent mode is drawn once, steps are independent given the mode."""
        if not isinstance(n, int | np.integer) or n < 0:
            raise InputError(f"sample: expected a count >= 0, got {n!r}")
        steps, count = self.means.shape[:2]
        if self.modes == "persistent":
            mode = np.broadcast_to(rng.choice(count, size=(n, 1), p=self.weights), (n, steps))
        else:
            uniform = rng.random((n, steps, 1))
            mode = (uniform > np.cumsum(self.step_weights, axis=-1)[:, :-1]).sum(axis=-1)
        noise = rng.standard_normal((n, steps, 2))
        root = _square_root(self.covariances)
        # one gather for mean and factor; none at all for a single mode
        pick = (slice(None), 0) if count == 1 else (np.arange(steps), mode)
        mean, factor = self.means[pick], root[pick]
        return np.stack(
            [mean[..., i] + factor[..., i, 0] * noise[..., 0] + factor[..., i, 1] * noise[..., 1] for i in range(2)],
            axis=-1,
        )

    def save(self, path: str | Path) -> None:
        """Write to an `.npz` (no pickle)."""
        _save(self, path)


@dataclass(frozen=True, eq=False)
class MomentPrediction:
    """Mean and central moments of the position per step and mode; no family of distributions is assumed.

    Attributes:
        times, weights, means, modes, name, length, width, headings: as in `GaussianMixturePrediction`.
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
        as_covariances("central_moments (order 2)", self.covariances, (steps, modes))
        _check_moment_matrix(clean)

    @property
    def order(self) -> int:
        """Highest order of the moments carried."""
        return int(self.central_moments.shape[-1]) - 1

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
            return _cut(self, slice(first, first + len(times)))
        left, right, share = _brackets(self, times)
        mix = _mixer(left, right, share)
        return MomentPrediction(
            times,
            self.weights if self.weights.ndim == 1 else mix(self.weights),
            mix(self.means),
            mix(self.central_moments),
            **_labels(self, left, right, share),
        )

    def moments(self, order: int) -> MomentPrediction:
        """The same agent with fewer moments; asking for more than are carried is an error."""
        _check_order(order)
        if order > self.order:
            raise InputError(
                f"moments: {self.name or 'agent'} carries moments up to order {self.order}, asked for {order}"
            )
        cut = self.central_moments[..., : order + 1, : order + 1]
        return MomentPrediction(self.times, self.weights, self.means, cut, **_labels(self))

    def sample(self, n: int, rng: np.random.Generator) -> Array:
        """Moments do not fix a distribution: always an error."""
        raise InputError(f"sample: {self.name or 'agent'} is known by its moments only and cannot be sampled")

    def save(self, path: str | Path) -> None:
        """Write to an `.npz` (no pickle)."""
        _save(self, path)


Prediction = GaussianMixturePrediction | MomentPrediction
_CLASSES: dict[str, Any] = {"gaussian": GaussianMixturePrediction, "moments": MomentPrediction}


def load_prediction(path: str | Path) -> Prediction:
    """Read what `save` wrote; files with pickled objects are refused."""
    try:
        # opened here, so that it is closed even if numpy cannot read it
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as data:
            values = {key: data[key] for key in data.files}
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (ValueError, OSError, EOFError, BadZipFile, AttributeError, TypeError) as error:
        reason = "it holds pickled objects or none" if "pickle" in str(error) else error
        raise InputError(f"{path}: not a prediction file: {reason}") from None
    kind = str(values.pop("type", ""))
    as_option(f"{path}: type", kind, tuple(_CLASSES))
    plain = {key: value.item() if value.ndim == 0 else value for key, value in values.items()}
    try:
        found: Prediction = _CLASSES[kind](**plain)
        return found
    except TypeError as error:
        raise InputError(f"{path}: {error}") from None


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


def _check_order(order: Any) -> None:
    if not isinstance(order, int | np.integer) or isinstance(order, bool) or order < 2:
        raise InputError(f"moments: expected an order >= 2, got {order!r}")


def _check_moment_matrix(moments: Array) -> None:
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
        values[field] = None if value is None else as_scalar(field, value, low=0.0, strict=True)
    if pred.headings is not None:
        values["headings"] = as_array("headings", pred.headings, (steps, modes))
    if not isinstance(pred.name, str):
        raise InputError(f"name: expected text, got {pred.name!r}")
    for field, value in values.items():
        object.__setattr__(pred, field, value)
    return steps, modes


def _brackets(pred: Prediction, times: Array) -> tuple[Any, Any, Array]:
    own = pred.times
    slack = 1e-6
    outside = np.flatnonzero((times < own[0] - slack) | (times > own[-1] + slack))
    if len(outside):
        raise InputError(
            f"times[{int(outside[0])}]: {pred.name or 'the prediction'} covers {own[0]:g} to {own[-1]:g} s, "
            f"got {times[outside[0]]:g}"
        )
    right = np.clip(np.searchsorted(own, times - slack), 0, len(own) - 1)
    left = np.maximum(right - 1, 0)
    gap = np.where(right > left, own[right] - own[left], 1.0)
    share = np.clip((times - own[left]) / gap, 0.0, 1.0)
    # a grid time is a grid time: no interpolation residue from rounding in the times
    share = np.where(np.abs(times - own[right]) <= slack, 1.0, share)
    return left, right, share


_P = TypeVar("_P", GaussianMixturePrediction, MomentPrediction)


def _cut(pred: _P, steps: slice) -> _P:
    """Some steps of a prediction, which need no second validation."""
    if steps.start == 0 and steps.stop == len(pred.times):
        return pred
    part = copy(pred)
    for field in fields(pred):
        value = getattr(pred, field.name)
        if isinstance(value, np.ndarray) and not (field.name == "weights" and value.ndim == 1):
            object.__setattr__(part, field.name, value[steps])
    return part


def _mixer(left: Any, right: Any, share: Array) -> Any:
    def mix(values: Array) -> Array:
        s = share.reshape(-1, *([1] * (values.ndim - 1)))
        blend: Array = np.where(s == 1.0, values[right], (1 - s) * values[left] + s * values[right])
        return blend

    return mix


def _labels(pred: Any, left: Any = None, right: Any = None, share: Array | None = None) -> dict[str, Any]:
    headings = pred.headings
    if headings is not None and share is not None:
        # interpolate angles the short way round
        turn = np.angle(np.exp(1j * (headings[right] - headings[left])))
        headings = headings[left] + share[:, None] * turn
    return {
        "modes": pred.modes,
        "name": pred.name,
        "length": pred.length,
        "width": pred.width,
        "headings": headings,
    }


def _square_root(covariances: Array) -> Array:
    """A factor F with F Fᵀ = Σ that also exists for singular Σ."""
    values, vectors = np.linalg.eigh(covariances)
    root: Array = vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]
    return root


def _save(pred: Prediction, path: str | Path) -> None:
    kind = next(key for key, cls in _CLASSES.items() if isinstance(pred, cls))
    values = {f.name: getattr(pred, f.name) for f in fields(pred)}
    present = {key: np.asarray(value) for key, value in values.items() if value is not None}
    with open(path, "wb") as file:
        np.savez(file, allow_pickle=False, type=np.asarray(kind), **present)
