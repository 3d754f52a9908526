"""`marshall-olkin`: the sharp bound that mean and covariance allow."""

from dataclasses import dataclass
from typing import ClassVar

from numba import carray

from checkers.base import CheckerInfo, MomentChecker
from checkers.kernels import gradients
from checkers.kernels.abi import kernel
from checkers.kernels.gaussian import marshall_olkin
from checkers.kind import Kind


@kernel
def _kernel(m1, m2, s11, s12, s22, det, moments, order, options, out):  # type: ignore[no-untyped-def]
    return marshall_olkin(m1, m2, s11, s12, s22, det)


@kernel
def _gradient(m1, m2, s11, s12, s22, det, moments, order, options, out):  # type: ignore[no-untyped-def]
    turn, to = carray(options, 2), carray(out, 3)
    to[0], to[1], to[2] = gradients.marshall_olkin(m1, m2, s11, s12, s22, det, turn[0], turn[1])
    return 0.0


@dataclass(frozen=True)
class MarshallOlkin(MomentChecker):
    """1 / (1 + d²), d the Mahalanobis distance from the mean to the ellipsoid: the limit of ever more half-spaces."""

    info: ClassVar[CheckerInfo] = CheckerInfo(
        name="marshall-olkin",
        kind=Kind.UPPER_BOUND,
        needs="mean and covariance",
        assumption="none beyond the moments",
        source="Marshall & Olkin 1960",
        cost="0.1 µs",
        gradient=True,
    )

    @property
    def moments_needed(self) -> int:
        """Order 2."""
        return 2

    @property
    def kernel(self) -> int:
        """Address of the compiled kernel."""
        return _kernel.address

    @property
    def gradient_kernel(self) -> int:
        """Address of the gradient's kernel."""
        return _gradient.address
