"""`cascade`: the cheapest test that decides, for planning."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numba import carray

from checkers.agents import Prediction
from checkers.base import Checker, CheckerInfo, as_poses, check_types
from checkers.kernels.abi import kernel
from checkers.kernels.cascade import accumulate, bounded_risk, decide
from checkers.kind import Kind
from checkers.packing import pack_pieces
from checkers.shapes import EgoShape
from checkers.validate import Array, as_scalar

STAGES = ("far field", "direction", "tangent", "exact")


@kernel
def _kernel(m1, m2, s11, s12, s22, det, moments, order, options, out):  # type: ignore[no-untyped-def]
    given = carray(options, 2)
    risk, error, _ = bounded_risk(m1, m2, s11, s12, s22, det, given[0], given[1])
    return min(risk + error, 1.0)  # rounded outward, for it is a bound


@dataclass(frozen=True, eq=False)
class Verdict:
    """Whether each risk is within the limit.

    Attributes:
        within: (T, K) bool, the verdict of `exact`.
        stages: how many evaluations (step × mode × piece) each stage decided.
    """

    within: np.ndarray
    stages: dict[str, int]


@dataclass(frozen=True, eq=False)
class Spending:
    """How far a budget lasts.

    Attributes:
        step: index of the first step after which the accumulated risk is above the budget; None: it lasts.
        total: accumulated risk there, or at the end.
        stages: as in `Verdict`.
    """

    step: int | None
    total: float
    stages: dict[str, int]


@dataclass(frozen=True)
class Cascade(Checker):
    """Risks above `resolution` exactly; others are stated as `resolution`, at a tenth of the cost.

    `within` and `spend` answer a planner's questions with the verdict of `exact`, up to its rounding, whatever the
    resolution.

    Attributes:
        resolution: what a single risk may be overstated to.
    """

    resolution: float = 1e-12

    info: ClassVar[CheckerInfo] = CheckerInfo(
        name="cascade",
        kind=Kind.UPPER_BOUND,
        needs="a Gaussian mixture",
        assumption="Gaussian modes",
        source="half-spaces Φ(−d), then Ruben 1962",
        cost="0.02 to 0.3 µs",
    )

    def __post_init__(self) -> None:
        as_scalar("cascade: resolution", self.resolution, low=0.0, high=1.0)

    @property
    def kernel(self) -> int:
        """Address of the compiled kernel."""
        return _kernel.address

    @property
    def options(self) -> Array:
        """Squared quantile and resolution."""
        return np.array([_square(self.resolution), self.resolution])

    def within(self, poses: Any, pred: Prediction, ego: EgoShape, limit: float) -> Verdict:
        """Is each step's risk, given each mode, at most `limit`? Poses (T, 3) at `pred.times`."""
        limit = as_scalar("limit", limit, low=0.0, high=1.0)
        poses, arrays, pieces = self._prepare(poses, pred, ego)
        answer, stages = np.empty(arrays.means.shape[:2], dtype=np.bool_), np.zeros(4, dtype=np.int64)
        decide(pieces, poses, *arrays[:2], _square(limit / len(pieces)), limit, answer, stages)
        return Verdict(answer, _counted(stages))

    def spend(self, poses: Any, pred: Prediction, ego: EgoShape, budget: float) -> Spending:
        """Accumulate risk over time, steps independent given the mode, until it is above `budget`."""
        budget = as_scalar("budget", budget, low=0.0, high=1.0)
        poses, arrays, pieces = self._prepare(poses, pred, ego)
        stages = np.zeros(4, dtype=np.int64)
        fixed = (pieces, poses, *arrays[:2], np.ascontiguousarray(pred.step_weights), pred.modes == "persistent")
        enough = 1e-6 * budget / (arrays.means[..., 0].size * len(pieces))
        step, total, sure = accumulate(*fixed, _square(enough), enough, budget, stages)
        if not sure:
            step, total, _ = accumulate(*fixed, 0.0, 0.0, budget, stages)
        return Spending(None if step < 0 else int(step), float(total), _counted(stages))

    def _prepare(self, poses: Any, pred: Prediction, ego: EgoShape) -> tuple[Array, Any, Array]:
        check_types(pred, ego)
        agent = self.seen(pred)
        return as_poses(poses, len(agent.times), batches=False), self.arrays(agent), pack_pieces(*ego.pieces(agent))


def _square(probability: float) -> float:
    """Φ⁻¹(p)², rounded outward; 0, for which no cheap stage applies, from one half on and for 0."""
    from scipy.special import ndtri  # noqa: PLC0415  scipy.special costs import time

    return float(ndtri(probability)) ** 2 * (1.0 + 1e-6) + 1e-6 if 0.0 < probability < 0.5 else 0.0


def _counted(stages: np.ndarray) -> dict[str, int]:
    return dict(zip(STAGES, stages.tolist(), strict=True))
