"""`liu`: a non-central χ² law matched to the quadratic form (the paper's fast estimate)."""

import math
from dataclasses import dataclass
from typing import ClassVar

from numba import carray

from checkers.base import Checker, CheckerInfo
from checkers.kernels.abi import kernel
from checkers.kernels.gaussian import half_space
from checkers.kernels.matched import matched_cdf
from checkers.kernels.tail import gaussian_mean
from checkers.kind import Kind


@kernel
def _kernel(m1, m2, s11, s12, s22, det, moments, order, options, out):  # type: ignore[no-untyped-def]
    big, small, p, q, mean, variance = gaussian_mean(m1, m2, s11, s12, s22, det)
    highest = half_space(m1, m2, s11, s12, s22, det)
    if variance <= 1e-28 * mean * mean:  # no spread to match
        value = 1.0 if mean <= 0.0 else 0.0
    else:
        value = min(matched_cdf(big, small, p, q, mean, math.sqrt(variance)), highest)
    carray(out, 2)[0] = max(value, highest - value)
    return value


@dataclass(frozen=True)
class Liu(Checker):
    """Liu, Tang & Zhang (2009): off by up to 0.15, and with no accuracy at all in the tails.

    For comparison with the paper. The method has no error bound of its own: the error is what the half-space bound
    Φ(−d) leaves open, and the estimate is cut there.
    """

    info: ClassVar[CheckerInfo] = CheckerInfo(
        name="liu",
        kind=Kind.ESTIMATE,
        needs="a Gaussian mixture",
        assumption="Gaussian modes; off by up to 0.15, worthless in the tail",
        source="Liu, Tang & Zhang 2009",
        cost="0.3 µs",
    )

    @property
    def gives_error(self) -> bool:
        """Always."""
        return True

    @property
    def kernel(self) -> int:
        """Address of the compiled kernel."""
        return _kernel.address
