"""`exact`: quadrature of the plane Gaussian over the ellipse, to rounding."""

from dataclasses import dataclass
from typing import ClassVar

from numba import carray

from checkers.base import Checker, CheckerInfo
from checkers.kernels import gradients
from checkers.kernels.abi import kernel
from checkers.kernels.gaussian import disc
from checkers.kind import Kind


@kernel
def _kernel(m1, m2, s11, s12, s22, det, moments, order, options, out):  # type: ignore[no-untyped-def]
    value, error = disc(m1, m2, s11, s12, s22, det)
    carray(out, 2)[0] = error
    return value


@kernel
def _gradient(m1, m2, s11, s12, s22, det, moments, order, options, out):  # type: ignore[no-untyped-def]
    turn, to = carray(options, 2), carray(out, 3)
    to[0], to[1], to[2] = gradients.disc(m1, m2, s11, s12, s22, det, turn[0], turn[1])
    return 0.0


@dataclass(frozen=True)
class Exact(Checker):
    """P(agent in ellipse) with relative accuracy down to 1e-300; see `kernels.gaussian.disc`."""

    info: ClassVar[CheckerInfo] = CheckerInfo(
        name="exact",
        kind=Kind.EXACT,
        needs="a Gaussian mixture",
        assumption="Gaussian modes",
        source="Ruben 1962; periodic trapezoid rule, Trefethen & Weideman 2014",
        cost="0.3 µs; 3 µs for tight covariances",
        gradient=True,
    )

    @property
    def gives_error(self) -> bool:
        """Always."""
        return True

    @property
    def kernel(self) -> int:
        """Address of the compiled kernel."""
        return _kernel.address

    @property
    def gradient_kernel(self) -> int:
        """Address of the gradient's kernel."""
        return _gradient.address
