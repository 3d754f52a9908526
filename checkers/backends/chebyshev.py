"""`chebyshev`: one-sided Chebyshev (Cantelli) on the quadratic form g = |y|² − 1."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import carray

from checkers.base import Checker, CheckerInfo
from checkers.kernels.abi import kernel
from checkers.kernels.tail import gaussian_form, general_form
from checkers.kind import Kind


@kernel
def _kernel(m1, m2, s11, s12, s22, moments, order, options, out):  # type: ignore[no-untyped-def]
    form, noise = np.empty(3), np.zeros(3)
    if order == 0:
        mean, sd = gaussian_form(m1, m2, s11, s12, s22, 2, form, noise)
    else:
        mean, sd = general_form(m1, m2, carray(moments, (order + 1) ** 2), order, 2, form, noise)
    mean -= noise[1] * sd  # outward: rounding must not lower the bound
    if mean <= 0.0:
        return 1.0
    variance = sd * sd * (1.0 + 1e-14)
    return min(variance / (variance + mean * mean) * (1.0 + 1e-15), 1.0)


@dataclass(frozen=True)
class Chebyshev(Checker):
    """Var g / E[g²] where E g > 0, else 1 (Jasour et al. 2021, section IV-C)."""

    info: ClassVar[CheckerInfo] = CheckerInfo(
        name="chebyshev",
        kind=Kind.UPPER_BOUND,
        needs="moments of the position to order 4",
        assumption="none beyond the moments",
        source="Cantelli 1928; Jasour et al. 2021, section IV-C",
        cost="0.1 µs",
    )

    @property
    def moments_needed(self) -> int:
        """Order 4."""
        return 4

    @property
    def kernel(self) -> int:
        """Address of the compiled kernel."""
        return int(_kernel.address)
