"""`chebyshev`: one-sided Chebyshev (Cantelli) on the quadratic form g = |y|² − 1."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import carray

from checkers.base import CheckerInfo, MomentChecker
from checkers.kernels import gradients
from checkers.kernels.abi import kernel
from checkers.kernels.tail import MEAN_NOISE, gaussian_mean, general_form
from checkers.kind import Kind


@kernel
def _kernel(m1, m2, s11, s12, s22, det, moments, order, options, out):  # type: ignore[no-untyped-def]
    if order == 0:
        big, small, p, q, mean, variance = gaussian_mean(m1, m2, s11, s12, s22, det)
        mean -= MEAN_NOISE * (p + q + big + small + 1.0)  # outward: rounding must not lower the bound
    else:
        form, noise = np.empty(3), np.zeros(3)
        mean, sd = general_form(m1, m2, carray(moments, (order + 1) ** 2), order, 2, form, noise)
        mean -= noise[1] * sd
        variance = sd * sd * (1.0 + 1e-14)
    if mean <= 0.0:
        return 1.0
    return min(variance / (variance + mean * mean) * (1.0 + 2e-14), 1.0)


@kernel
def _gradient(m1, m2, s11, s12, s22, det, moments, order, options, out):  # type: ignore[no-untyped-def]
    turn, to = carray(options, 2), carray(out, 28)
    if order == 0:
        gradients.gaussian_moments(s11, s12, s22, to[3:])
        to[0], to[1], to[2] = gradients.chebyshev(m1, m2, to[3:], 5, turn[0], turn[1])
    else:
        given = carray(moments, (order + 1) ** 2)
        to[0], to[1], to[2] = gradients.chebyshev(m1, m2, given, order + 1, turn[0], turn[1])
    return 0.0


@dataclass(frozen=True)
class Chebyshev(MomentChecker):
    """Var g / E[g²] where E g > 0, else 1 (Jasour et al. 2021, section IV-C)."""

    info: ClassVar[CheckerInfo] = CheckerInfo(
        name="chebyshev",
        kind=Kind.UPPER_BOUND,
        needs="moments of the position to order 4",
        assumption="none beyond the moments",
        source="Cantelli 1928; Jasour et al. 2021, section IV-C",
        cost="0.1 µs",
        gradient=True,
    )

    @property
    def moments_needed(self) -> int:
        """Order 4."""
        return 4

    @property
    def kernel(self) -> int:
        """Address of the compiled kernel."""
        return _kernel.address

    @property
    def gradient_kernel(self) -> int:
        """Address of the gradient's kernel."""
        return _gradient.address
