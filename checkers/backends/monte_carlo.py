"""`monte-carlo`: the baseline: the share of seeded samples inside the ellipse."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from checkers.base import ArrayRisk, Checker, CheckerInfo
from checkers.kind import Kind
from checkers.prediction import _square_root
from checkers.validate import Array, InputError, as_scalar


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
        needs="a Gaussian mixture",
        assumption="Gaussian modes",
        source="Clopper & Pearson 1934",
        cost="200 µs for 1e4 samples",
    )

    def __post_init__(self) -> None:
        for name, low in (("samples", 1), ("seed", 0)):
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or value < low:
                raise InputError(f"monte-carlo: {name}: expected an integer >= {low}, got {value!r}")
        if not 0.0 < as_scalar("monte-carlo: confidence", self.confidence) < 1.0:
            raise InputError(f"monte-carlo: confidence: expected a number in (0, 1), got {self.confidence!r}")

    @property
    def kernel(self) -> int:
        """None: works on arrays."""
        return 0

    def modes(self, m: Array, s: Array, moments: Array, order: int) -> ArrayRisk:
        """Estimate mode by mode, so that memory stays that of one mode's samples."""
        del moments, order
        noise = np.random.default_rng(self.seed).standard_normal((2, self.samples))
        root = _square_root(s[:, [0, 1, 1, 2]].reshape(-1, 2, 2))
        hits = np.empty(len(m))
        for i in range(len(m)):
            y = m[i, :, None] + root[i] @ noise
            hits[i] = np.count_nonzero(y[0] * y[0] + y[1] * y[1] <= 1.0)
        low, high = clopper_pearson(hits, self.samples, self.confidence)
        value = hits / self.samples
        return ArrayRisk(value, np.maximum(high - value, value - low), np.full(len(m), np.nan))


def clopper_pearson(hits: Array, samples: int, confidence: float) -> tuple[Array, Array]:
    """Exact interval for a binomial share (Clopper & Pearson 1934)."""
    from scipy.special import betaincinv  # noqa: PLC0415  scipy.special costs import time

    hits = np.asarray(hits, dtype=float)
    tail = (1.0 - confidence) / 2.0
    with np.errstate(all="ignore"):
        low = np.where(hits > 0, betaincinv(np.maximum(hits, 1), samples - hits + 1, tail), 0.0)
        high = np.where(hits < samples, betaincinv(hits + 1, np.maximum(samples - hits, 1), 1 - tail), 1.0)
    return low, high
