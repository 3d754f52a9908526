"""The contract of a collision primitive: poses and a prediction in, a `Risk` out."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from checkers.kernels.lift import batch_risk
from checkers.kernels.whiten import pack_pieces, whiten_all
from checkers.kind import Kind
from checkers.prediction import GaussianMixturePrediction, MomentPrediction, Prediction
from checkers.risk import Risk
from checkers.shapes import EgoShape
from checkers.validate import FARTHEST, Array, InputError, as_array


@dataclass(frozen=True)
class CheckerInfo:
    """What a backend declares of itself; the contract tests, the CLI and the README table read it.

    Attributes:
        name: what `rp.checker(name)` takes.
        kind: the claim of its values for one ellipsoid.
        needs: of the agent: "a Gaussian mixture", or which moments.
        assumption: under which the claim holds.
        source: author, year.
        cost: rough time of one mode at one pose.
    """

    name: str
    kind: Kind
    needs: str
    assumption: str
    source: str
    cost: str


class ModeArrays(NamedTuple):
    """A prediction as contiguous arrays: means (T, K, 2), covariances (T, K, 3), moments (T, K, (order+1)²)."""

    means: Array
    covariances: Array
    moments: Array
    order: int


class ArrayRisk(NamedTuple):
    """Values (M,) for whitened modes, with errors and lower bounds where known (NaN elsewhere)."""

    value: Array
    error: Array
    lower: Array


class Checker(ABC):
    """A collision primitive. Subclasses are frozen dataclasses whose fields are their options.

    A compiled backend returns its kernel's address from `kernel`; one that works on arrays returns 0 there and
    implements `modes`. Both are reached through the same call and through the planners.
    """

    info: ClassVar[CheckerInfo]

    @property
    def moments_needed(self) -> int:
        """Order of the position's moments that must be known of a non-Gaussian agent; 0: it must be Gaussian."""
        return 0

    @property
    @abstractmethod
    def kernel(self) -> int:
        """Address of the compiled kernel (see `kernels.abi`), or 0 if there is none."""

    @property
    def options(self) -> Array:
        """The kernel's own numbers."""
        return np.zeros(1)

    @property
    def search_options(self) -> Array:
        """Options for the inner loop of a search, where `search_slack` of relative error buys speed."""
        return self.options

    @property
    def search_slack(self) -> float:
        """How far, relatively, the kernel may be below its stated value under `search_options`."""
        return 0.0

    def modes(self, m: Array, s: Array, moments: Array, order: int) -> ArrayRisk:
        """Risk of whitened modes m (M, 2), s (M, 3) = s11, s12, s22, moments (M, (order+1)²); order 0: Gaussian."""
        raise InputError(f"{self.info.name}: has no array form")

    def arrays(self, pred: Prediction) -> ModeArrays:
        """The prediction as this backend reads it.

        Raises:
            InputError: if the backend needs more than the agent carries.
        """
        c = pred.covariances
        covariances = np.ascontiguousarray(np.stack([c[..., 0, 0], c[..., 0, 1], c[..., 1, 1]], axis=-1))
        means = np.ascontiguousarray(pred.means)
        steps, count = means.shape[:2]
        if isinstance(pred, GaussianMixturePrediction):
            return ModeArrays(means, covariances, np.zeros((steps, count, 1)), 0)
        name, order = pred.name or "the agent", self.moments_needed
        if order == 0:
            raise InputError(f"{self.info.name}: needs {self.info.needs}, but {name} is known by its moments only")
        if order > pred.order:
            raise InputError(
                f"{self.info.name}: needs moments of the position to order {order}, but {name} carries {pred.order}"
            )
        if order == 2:  # mean and covariance say it all
            order = 0
        moments = pred.central_moments[..., : order + 1, : order + 1].reshape(steps, count, -1)
        return ModeArrays(means, covariances, np.ascontiguousarray(moments), order)

    def kind_for(self, pieces: int) -> Kind:
        """The claim for a shape of several pieces: their union bound is no longer exact."""
        exact = self.info.kind is Kind.EXACT and pieces > 1
        return Kind.UPPER_BOUND if exact else self.info.kind

    def __call__(self, poses: Any, pred: Prediction, ego: EgoShape) -> Risk:
        """Probability that the agent is inside the ego shape at each pose, given each mode.

        Args:
            poses: (T, 3) or (B, T, 3) x, y [m], heading [rad] at `pred.times`.
            pred: the agent, T steps and K modes.
            ego: shape in the ego frame; several pieces are summed (union bound), at most 1.

        Returns:
            values (T, K) or (B, T, K).

        Raises:
            InputError: on wrong shapes, poses that are not finite, or an agent that lacks what the backend needs.
        """
        if not isinstance(pred, GaussianMixturePrediction | MomentPrediction):
            raise InputError(f"pred: expected a prediction, got {type(pred).__name__}")
        if not hasattr(ego, "pieces"):
            raise InputError(f"ego: expected a shape such as EgoEllipsoid, got {type(ego).__name__}")
        steps, count = pred.means.shape[:2]
        poses = _as_poses(poses, steps)
        arrays = self.arrays(pred)
        pieces = pack_pieces(*ego.pieces(pred))
        batch = np.ascontiguousarray(poses.reshape(-1, steps, 3))
        if self.kernel:
            out = np.empty((3, len(batch), steps, count))
            batch_risk(self.kernel, self.options, pieces, batch, *arrays[:3], arrays.order, out[0], out[1], out[2])
        else:
            out = np.empty((3, len(batch), steps, count))
            for b, one in enumerate(batch):
                out[:, b] = self._by_arrays(one, arrays, pieces)
        shape = (*poses.shape[:-1], count)
        value, error, lower = (a.reshape(shape) for a in out)
        value = self.answered(value)
        return Risk(
            value,
            self.kind_for(len(pieces)),
            None if np.isnan(error).all() else error,
            None if np.isnan(lower).all() else lower,
            self.info.name,
        )

    def answered(self, value: Array) -> Array:
        """The values without NaN: where a bound does not know it is 1, and an exact backend that fails says so."""
        unknown = np.isnan(value)
        if not unknown.any():
            return value
        if self.info.kind is Kind.UPPER_BOUND:
            return np.where(unknown, 1.0, value)
        where = np.argwhere(unknown)[0].tolist()
        raise InputError(f"{self.info.name}: cannot evaluate the mode at {where}: its numbers are too extreme")

    def _by_arrays(self, poses: Array, arrays: ModeArrays, pieces: Array) -> Array:
        m, s, c = whiten_all(poses, *arrays, pieces)
        flat = self.modes(m.reshape(-1, 2), s.reshape(-1, 3), c.reshape(-1, c.shape[-1]), arrays.order)
        value, error, lower = (a.reshape(m.shape[:3]) for a in flat)
        return np.stack([np.minimum(value.sum(axis=-1), 1.0), error.sum(axis=-1), lower.max(axis=-1)])


def _as_poses(value: Any, steps: int) -> Array:
    """(T, 3) or (B, T, 3) finite numbers; B may be 0."""
    expected = f"expected shape ({steps}, 3) or (B, {steps}, 3)"
    try:
        poses = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"poses: {expected}, got {type(value).__name__}: {error}") from None
    if poses.ndim not in (2, 3) or poses.shape[-2:] != (steps, 3):
        raise InputError(f"poses: {expected}, got {poses.shape}")
    return as_array("poses", poses, poses.shape, largest=FARTHEST)
