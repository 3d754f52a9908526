"""`imhof`: inversion of the characteristic function of the quadratic form (the paper's method)."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import carray

from checkers.base import Checker, CheckerInfo
from checkers.kernels.abi import kernel
from checkers.kernels.gaussian import FAR, conditioning, eigen, nearest
from checkers.kernels.inversion import quadratic_form_cdf
from checkers.kind import Kind


@kernel
def _kernel(m1, m2, s11, s12, s22, det, moments, order, options, out):  # type: ignore[no-untyped-def]
    result = carray(out, 2)
    big, small, v1, v2 = eigen(s11, s12, s22, det)
    along, across = v1 * m1 + v2 * m2, -v2 * m1 + v1 * m2
    room = 1.0 - across * across
    guess = 1.0
    if room < along * along and small > 0.0:
        far, near, d2 = nearest(along, across, big, small)
        if d2 > FAR:
            result[0] = 1e-304
            return 0.0
        guess += 0.5 * math.sqrt(d2 / (far * far * big + near * near * small))  # the multiplier of the nearest point
    if small < 1e-28:  # a line or a point
        result[0] = 0.0
        if room < 0.0:
            return 0.0
        if big < 1e-28:
            return 1.0 if along * along <= room else 0.0
        if room == 0.0:
            return 0.0
        variances, offsets = np.array([big / room]), np.array([along / math.sqrt(room)])
    else:
        variances, offsets = np.array([big, small]), np.array([along, across])
    value, error = quadratic_form_cdf(variances, offsets, guess)
    result[0] = min(error + value * conditioning(m1, m2, small, -math.log(max(value, 1e-308))), 1.0)
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
        cost="3 µs",
    )

    @property
    def gives_error(self) -> bool:
        """Always."""
        return True

    @property
    def kernel(self) -> int:
        """Address of the compiled kernel."""
        return _kernel.address
