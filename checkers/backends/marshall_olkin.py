"""`marshall-olkin`: the sharp bound that mean and covariance allow."""

from dataclasses import dataclass
from typing import ClassVar

from checkers.base import Checker, CheckerInfo
from checkers.kernels.abi import kernel
from checkers.kernels.gaussian import eigen, nearest
from checkers.kind import Kind


@kernel
def _kernel(m1, m2, s11, s12, s22, moments, order, options, out):  # type: ignore[no-untyped-def]
    if m1 * m1 + m2 * m2 <= 1.0:
        return 1.0
    # outward by what rounding can hide in a covariance
    floor = 1e-15 * (s11 + s22)
    big, small, v1, v2 = eigen(s11 + floor, s12, s22 + floor)
    if big == 0.0:
        return 0.0
    _, _, d2 = nearest(-v2 * m1 + v1 * m2, v1 * m1 + v2 * m2, small, big)
    return min((1.0 + 1e-14) / (1.0 + d2 * (1.0 - 1e-12)), 1.0)


@dataclass(frozen=True)
class MarshallOlkin(Checker):
    """1 / (1 + d²), d the Mahalanobis distance from the mean to the ellipsoid: the limit of ever more half-spaces."""

    info: ClassVar[CheckerInfo] = CheckerInfo(
        name="marshall-olkin",
        kind=Kind.UPPER_BOUND,
        needs="mean and covariance",
        assumption="none beyond the moments",
        source="Marshall & Olkin 1960",
        cost="0.1 µs",
    )

    @property
    def moments_needed(self) -> int:
        """Order 2."""
        return 2

    @property
    def kernel(self) -> int:
        """Address of the compiled kernel."""
        return int(_kernel.address)
