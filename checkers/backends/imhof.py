"""`imhof`: inversion of the characteristic function of the quadratic form (the paper's method)."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import carray

from checkers.base import Checker, CheckerInfo
from checkers.kernels.abi import kernel
from checkers.kernels.gaussian import eigen
from checkers.kernels.inversion import quadratic_form_cdf
from checkers.kind import Kind


@kernel
def _kernel(m1, m2, s11, s12, s22, moments, order, options, out):  # type: ignore[no-untyped-def]
    big, small, v1, v2 = eigen(s11, s12, s22)
    variances = np.array([big, small])
    offsets = np.array([v1 * m1 + v2 * m2, -v2 * m1 + v1 * m2])
    value, error = quadratic_form_cdf(variances, offsets)
    carray(out, 2)[0] = error
    return value


@dataclass(frozen=True)
class Imhof(Checker):
    """Imhof's (1961) inversion on a contour through the saddle point; returns a bound on its own error."""

    info: ClassVar[CheckerInfo] = CheckerInfo(
        name="imhof",
        kind=Kind.EXACT,
        needs="a Gaussian mixture",
        assumption="Gaussian modes",
        source="Imhof 1961; contour of Helstrom 1996",
        cost="25 µs",
    )

    @property
    def kernel(self) -> int:
        """Address of the compiled kernel."""
        return int(_kernel.address)
