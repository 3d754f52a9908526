"""`monte-carlo`: the baseline: the share of seeded samples inside the ellipse."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from checkers.agents import Prediction
from checkers.base import ArrayRisk, Checker, CheckerInfo, as_poses, check_types
from checkers.control_prediction import ControlPrediction
from checkers.kind import Kind
from checkers.packing import pack_pieces
from checkers.prediction import square_root
from checkers.risk import Risk
from checkers.shapes import EgoShape
from checkers.validate import FARTHEST, Array, InputError, as_array, as_scalar


@dataclass(frozen=True)
class MonteCarlo(Checker):
    """Share of `samples` draws inside, with the half-width of its Clopper–Pearson (1934) interval as the error.

    The same standard normals serve every mode, so a mode's estimate does not depend on what else is in the batch.

    Attributes:
        samples: number of draws per mode.
        seed: of the draws.
        confidence: of the interval.
    """

    samples: int = 10_000
    seed: int = 0
    confidence: float = 0.99

    info: ClassVar[CheckerInfo] = CheckerInfo(
        name="monte-carlo",
        kind=Kind.ESTIMATE,
        needs="a Gaussian mixture, or controls",
        assumption="Gaussian modes, or the control model",
        source="Clopper & Pearson 1934",
        cost="200 µs for 1e4 samples",
    )

    def __post_init__(self) -> None:
        for name, low, high in (("samples", 1, 10**8), ("seed", 0, 2**63)):
            value = getattr(self, name)
            if not isinstance(value, int | np.integer) or isinstance(value, bool) or not low <= value <= high:
                raise InputError(f"monte-carlo: {name}: expected an integer from {low} to {high}, got {value!r}")
        if not 0.0 < as_scalar("monte-carlo: confidence", self.confidence) < 1.0:
            raise InputError(f"monte-carlo: confidence: expected a number in (0, 1), got {self.confidence!r}")

    @property
    def gives_error(self) -> bool:
        """Always."""
        return True

    @property
    def kernel(self) -> int:
        """None: works on arrays."""
        return 0

    def __call__(self, poses: Any, pred: Prediction, ego: EgoShape) -> Risk:
        """As every backend's; an agent known by its controls is simulated, pieces of a shape then being united."""
        check_types(pred, ego)
        if not isinstance(pred, ControlPrediction):
            return super().__call__(poses, pred, ego)
        poses = as_poses(poses, len(pred.times))
        batch = as_array("poses", poses, poses.shape, largest=FARTHEST).reshape(-1, len(pred.times), 3)
        pieces = pack_pieces(*ego.pieces(pred))
        hits = np.empty((*batch.shape[:2], len(pred.weights)))
        for k in range(len(pred.weights)):
            futures = pred.sample_mode(k, self.samples, np.random.default_rng(self.seed))
            for b, one in enumerate(batch):
                hits[b, :, k] = _inside(futures, one, pieces).sum(axis=0)
        shape = (*poses.shape[:-1], len(pred.weights))
        value, error = (a.reshape(shape) for a in self._shares(hits))
        return Risk(value, self.info.kind, error, None, self.info.name)

    def modes(self, m: Array, s: Array, moments: Array, order: int) -> ArrayRisk:
        """Estimate mode by mode, so that memory stays that of one mode's samples."""
        del moments, order
        noise = np.random.default_rng(self.seed).standard_normal((2, self.samples))
        root = square_root(s[:, [0, 1, 1, 2]].reshape(-1, 2, 2))
        hits = np.empty(len(m))
        for i in range(len(m)):
            y = m[i, :, None] + root[i] @ noise
            hits[i] = np.count_nonzero(y[0] * y[0] + y[1] * y[1] <= 1.0)
        return ArrayRisk(*self._shares(hits), np.full(len(m), np.nan))

    def _shares(self, hits: Array) -> tuple[Array, Array]:
        low, high = clopper_pearson(hits, self.samples, self.confidence)
        value = hits / self.samples
        return value, np.maximum(high - value, value - low)


def _inside(points: Array, poses: Array, pieces: Array) -> NDArray[np.bool_]:
    """(n, T): whether points (n, T, 2) lie in any piece at poses (T, 3)."""
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    dx, dy = points[..., 0] - poses[:, 0], points[..., 1] - poses[:, 1]
    x, y = cos * dx + sin * dy, cos * dy - sin * dx
    found = np.zeros(x.shape, dtype=bool)
    for ox, oy, a, b, c in pieces:
        found |= (a * (x - ox) + b * (y - oy)) ** 2 + (c * (y - oy)) ** 2 <= 1.0
    return found


def clopper_pearson(hits: Array, samples: int, confidence: float) -> tuple[Array, Array]:
    """Exact interval for a binomial share (Clopper & Pearson 1934)."""
    from scipy.special import betaincinv  # noqa: PLC0415  scipy.special costs import time

    hits = np.asarray(hits, dtype=float)
    tail = (1.0 - confidence) / 2.0
    with np.errstate(all="ignore"):
        low = np.where(hits > 0, betaincinv(np.maximum(hits, 1), samples - hits + 1, tail), 0.0)
        high = np.where(hits < samples, betaincinv(hits + 1, np.maximum(samples - hits, 1), 1 - tail), 1.0)
    return low, high
