"""The contract of a collision primitive: poses and a prediction in, a `Risk` out."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from typing import Any, ClassVar, NamedTuple, get_args

import numpy as np

from checkers.agents import Prediction
from checkers.control_prediction import ControlPrediction
from checkers.kernels.gradients import batch_gradient
from checkers.kernels.lift import batch_risk
from checkers.kernels.whiten import whiten_all
from checkers.kind import Kind
from checkers.merge import merged
from checkers.packing import ModeArrays, pack_pieces
from checkers.prediction import GaussianMixturePrediction, PositionPrediction
from checkers.refine import refine
from checkers.risk import Risk
from checkers.shapes import EgoShape
from checkers.validate import FARTHEST, Array, InputError, as_array, as_option

_PREDICTIONS = get_args(Prediction)
_NO_OPTIONS = np.zeros(1)
_ALONE = 20_000  # evaluations that a second thread is not worth


@dataclass(frozen=True)
class CheckerInfo:
    """What a backend declares of itself; the contract tests, the CLI and the README table read it.

    Attributes:
        name: what `rp.checker(name)` takes.
        kind: the claim of its values for one ellipsoid.
        needs: of the agent: "a Gaussian mixture", or which moments.
        assumption: under which the claim holds.
        source: author, year.
        cost: rough time of one mode at one pose for one piece of the shape.
        gradient: whether `Checker.gradient` is there.
    """

    name: str
    kind: Kind
    needs: str
    assumption: str
    source: str
    cost: str
    gradient: bool = False


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

    @classmethod
    def defaults(cls) -> dict[str, Any]:
        """Its options and their defaults."""
        return {f.name: f.default for f in fields(cls)}  # type: ignore[arg-type]

    @property
    def moments_needed(self) -> int:
        """Order of the position's moments that must be known of a non-Gaussian agent; 0: it must be Gaussian."""
        return 0

    @property
    @abstractmethod
    def kernel(self) -> int:
        """Address of the compiled kernel (see `kernels.abi`), or 0 if there is none."""

    @property
    def gradient_kernel(self) -> int:
        """Address of the kernel of the gradient (see `kernels.gradients`), or 0 if there is none."""
        return 0

    @property
    def gives_error(self) -> bool:
        """Whether values come with an absolute error."""
        return False

    @property
    def gives_lower(self) -> bool:
        """Whether values come with a lower bound."""
        return False

    @property
    def options(self) -> Array:
        """The kernel's own numbers."""
        return _NO_OPTIONS

    def modes(self, m: Array, s: Array, moments: Array, order: int) -> ArrayRisk:
        """Risk of whitened modes m (M, 2), s (M, 4) with determinants, moments (M, (order+1)²); order 0: Gaussian."""
        raise InputError(f"{self.info.name}: has no array form")

    def arrays(self, pred: PositionPrediction) -> ModeArrays:
        """The prediction as this backend reads it.

        Raises:
            InputError: if the backend needs more than the agent carries.
        """
        if isinstance(pred, GaussianMixturePrediction):
            return pred.packed
        name, order = pred.name or "the agent", self.moments_needed
        if order == 0:
            raise InputError(
                f"{self.info.name}: needs {self.info.needs}, but {name} is known by its moments only; "
                "projected-sos, sos and marshall-olkin read moments"
            )
        if order > pred.order:
            raise InputError(
                f"{self.info.name}: needs moments of the position to order {order}, but {name} carries {pred.order}"
            )
        return pred.packed(order)

    def seen(self, pred: Prediction) -> PositionPrediction:
        """The agent as the backend reads it: by its position, with its modes or without."""
        return pred.moments(max(self.moments_needed, 2)) if isinstance(pred, ControlPrediction) else pred

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
            values (T, K) or (B, T, K); K is 1 for the mixture taken whole.

        Raises:
            InputError: on wrong shapes, poses that are not finite, or an agent that lacks what the backend needs.
        """
        check_types(pred, ego)
        agent = self.seen(pred)
        steps, count = agent.means.shape[:2]
        poses = as_poses(poses, steps)
        arrays = self.arrays(agent)
        shape = ego.pieces(agent)
        pieces = pack_pieces(*shape)
        batch = poses.reshape(-1, steps, 3)
        out = np.empty((len(batch), 3, steps, count))
        fill = self._by_kernel if self.kernel else self._by_arrays
        unknown = fill(batch, arrays, pieces, out)
        if unknown < 0:
            as_array("poses", poses, poses.shape, largest=FARTHEST)  # says which
        if self.kernel and self.info.kind is Kind.EXACT:
            refine(self.kernel, self.options, batch, arrays, shape, out)
        value, error, lower = out[0] if poses.ndim == 2 else out.transpose(1, 0, 2, 3)
        return Risk.unchecked(
            self.answered(value) if unknown else value,
            self.kind_for(len(pieces)),
            error if self.gives_error else None,
            lower if self.gives_lower else None,
            self.info.name,
        )

    def gradient(self, poses: Any, pred: Prediction, ego: EgoShape) -> Array:
        """How the risk at each pose, given each mode, changes with the pose: analytic, as accurate as the value.

        Several pieces are summed; where their sum is above 1 and the value is 1, this is still the gradient of the sum,
        so that an optimiser finds the way out. Where a bound does not apply, and is 1, it is 0.

        Args:
            poses, pred, ego: as for the call.

        Returns:
            (T, K, 3) or (B, T, K, 3): with x, y [1/m] and heading [1/rad].

        Raises:
            InputError: as the call, and for a backend without a gradient.
        """
        if not self.gradient_kernel:
            from checkers.registry import checkers  # noqa: PLC0415  it imports this module

            known = ", ".join(name for name, info in checkers().items() if info.gradient)
            raise InputError(f"{self.info.name}: has no gradient; {known} have one")
        check_types(pred, ego)
        agent = self.seen(pred)
        steps, count = agent.means.shape[:2]
        poses = as_poses(poses, steps)
        arrays, pieces = self.arrays(agent), pack_pieces(*ego.pieces(agent))
        batch = poses.reshape(-1, steps, 3)
        out = np.empty((len(batch), steps, count, 3))

        def fill(part: slice) -> int:
            found: int = batch_gradient(self.gradient_kernel, pieces, batch[part], *arrays, FARTHEST, out[part])
            return found

        unknown = _shared(fill, len(batch), out.size * len(pieces) // 3)
        if unknown < 0:
            as_array("poses", poses, poses.shape, largest=FARTHEST)  # says which
        if unknown:
            where = np.argwhere(np.isnan(out))[0, 1 if poses.ndim == 2 else 0 : -1].tolist()
            raise InputError(f"{self.info.name}: no gradient of the mode at {where}: its numbers are too extreme")
        return out[0] if poses.ndim == 2 else out

    def _by_kernel(self, poses: Array, arrays: ModeArrays, pieces: Array, out: Array) -> int:
        """Fill `out` (B, 3, T, K); return how many values are NaN, or −1 for bad poses."""
        fixed = (self.kernel, self.options, pieces)

        def fill(part: slice) -> int:
            unknown: int = batch_risk(*fixed, poses[part], *arrays, FARTHEST, out[part])
            return unknown

        return _shared(fill, len(poses), out.size * len(pieces) // 3)

    def _by_arrays(self, poses: Array, arrays: ModeArrays, pieces: Array, out: Array) -> int:
        if not (np.abs(poses) <= FARTHEST).all():
            return -1
        for b, one in enumerate(poses):
            m, s, c = whiten_all(one, *arrays, pieces)
            flat = self.modes(m.reshape(-1, 2), s.reshape(-1, 4), c.reshape(-1, c.shape[-1]), arrays.order)
            value, error, lower = (a.reshape(m.shape[:3]) for a in flat)
            out[b] = np.minimum(value.sum(axis=-1), 1.0), error.sum(axis=-1), lower.max(axis=-1)
        return int(np.isnan(out[:, 0]).sum())

    def answered(self, value: Array) -> Array:
        """The values without NaN: where a bound does not know it is 1, and an exact backend that fails says so."""
        unknown = np.isnan(value)
        if self.info.kind is Kind.UPPER_BOUND:
            return np.where(unknown, 1.0, value)
        if not unknown.any():
            return value
        where = np.argwhere(unknown)[0].tolist()
        raise InputError(f"{self.info.name}: cannot evaluate the mode at {where}: its numbers are too extreme")


@dataclass(frozen=True)
class MomentChecker(Checker):
    """A backend that reads moments, of each mode or of the whole mixture.

    Attributes:
        per: "mode" (tighter), or "mixture": one value per step from the moments of the mixture, of whose modes nothing
            need be known. Independence over time is then not given the mode.
    """

    per: str = "mode"

    def __post_init__(self) -> None:
        as_option(f"{self.info.name}: per", self.per, ("mode", "mixture"))

    def seen(self, pred: Prediction) -> PositionPrediction:
        """The agent, or its mixture taken whole."""
        return super().seen(pred) if self.per == "mode" else merged(pred, self.moments_needed)


def _shared(fill: Callable[[slice], int], count: int, work: int) -> int:
    """Let threads share large batches: the sum of what `fill` returns for parts of `count`, or −1 if any is."""
    workers = min(_processors(), count, work // _ALONE) if work >= 2 * _ALONE else 1
    if workers < 2:
        return fill(slice(None))
    ends = np.linspace(0, count, workers + 1).astype(int)
    with ThreadPoolExecutor(workers) as pool:
        found = list(pool.map(fill, [slice(*pair) for pair in zip(ends[:-1], ends[1:], strict=True)]))
    return -1 if min(found) < 0 else sum(found)


def _processors() -> int:
    """How many this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def check_types(pred: Any, ego: Any) -> None:
    """Refuse what is no prediction or no shape."""
    if not isinstance(pred, _PREDICTIONS):
        raise InputError(f"pred: expected a prediction, got {type(pred).__name__}")
    if not hasattr(ego, "pieces") or isinstance(ego, type):
        raise InputError(f"ego: expected a shape such as EgoEllipsoid, got {type(ego).__name__}")


def as_poses(value: Any, steps: int, *, batches: bool = True) -> Array:
    """(T, 3), or with `batches` also (B, T, 3); B may be 0. Compiled loops check the size of what they read."""
    expected = f"expected shape ({steps}, 3)" + (f" or (B, {steps}, 3)" if batches else "")
    try:
        if np.iscomplexobj(value):
            raise TypeError("complex numbers")
        poses = np.ascontiguousarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"poses: {expected}, got {type(value).__name__}: {error}") from None
    if poses.ndim not in ((2, 3) if batches else (2,)) or poses.shape[-2:] != (steps, 3):
        raise InputError(f"poses: {expected}, got {poses.shape}")
    return poses if batches else as_array("poses", poses, poses.shape, largest=FARTHEST)
