"""`halfspace`: the least one-sided Chebyshev bound over tangent half-spaces of the ellipsoid."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import carray

from checkers.base import CheckerInfo, MomentChecker
from checkers.kernels.abi import kernel
from checkers.kind import Kind
from checkers.validate import Array, InputError


@kernel
def _kernel(m1, m2, s11, s12, s22, det, moments, order, options, out):  # type: ignore[no-untyped-def]
    count = int(carray(options, 1)[0])
    best = 1.0
    for i in range(count):
        angle = 2.0 * math.pi * i / count
        a1, a2 = math.cos(angle), math.sin(angle)
        gap = a1 * m1 + a2 * m2 - 1.0
        if gap > 0.0:
            # the sum cancels for a direction without spread: what rounding can hide is added, not lost
            variance = max(a1 * a1 * s11 + 2.0 * a1 * a2 * s12 + a2 * a2 * s22, 0.0) + 1e-15 * (s11 + s22)
            best = min(best, variance / (variance + gap * gap))
    return best


@dataclass(frozen=True)
class HalfSpace(MomentChecker):
    """`n_h` distinct tangents, equally spaced on the ellipsoid (Jasour et al. 2021, section IV-C2; they use 12)."""

    n_h: int = 12

    info: ClassVar[CheckerInfo] = CheckerInfo(
        name="halfspace",
        kind=Kind.UPPER_BOUND,
        needs="mean and covariance",
        assumption="none beyond the moments",
        source="Cantelli 1928; Jasour et al. 2021, section IV-C2",
        cost="0.2 µs",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.n_h, int | np.integer) or isinstance(self.n_h, bool) or not 3 <= self.n_h <= 10_000:
            raise InputError(f"halfspace: n_h: expected an integer from 3 to 10000, got {self.n_h!r}")

    @property
    def moments_needed(self) -> int:
        """Order 2."""
        return 2

    @property
    def kernel(self) -> int:
        """Address of the compiled kernel."""
        return _kernel.address

    @property
    def options(self) -> Array:
        """The number of tangents."""
        return np.array([float(self.n_h)])
