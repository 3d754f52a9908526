"""`exact`: quadrature of the plane Gaussian over the ellipse, to rounding."""

from dataclasses import dataclass
from typing import ClassVar

from numba import carray

from checkers.base import Checker, CheckerInfo
from checkers.kernels import gaussian
from checkers.kernels.abi import kernel
from checkers.kind import Kind
from checkers.validate import Array


@kernel
def _kernel(m1, m2, s11, s12, s22, moments, order, options, out):  # type: ignore[no-untyped-def]
    value, error = gaussian.disc(m1, m2, s11, s12, s22, carray(options, 3))
    carray(out, 2)[0] = error
    return value


@dataclass(frozen=True)
class Exact(Checker):
    """P(agent in ellipse) with relative accuracy down to 1e-300; see `kernels.gaussian.disc`."""

    info: ClassVar[CheckerInfo] = CheckerInfo(
        name="exact",
        kind=Kind.EXACT,
        needs="a Gaussian mixture",
        assumption="Gaussian modes",
        source="periodic trapezoid rule, Trefethen & Weideman 2014",
        cost="3 µs",
    )

    @property
    def kernel(self) -> int:
        """Address of the compiled kernel."""
        return int(_kernel.address)

    @property
    def options(self) -> Array:
        """Full precision."""
        return gaussian.FULL

    @property
    def search_options(self) -> Array:
        """Coarse precision."""
        return gaussian.COARSE

    @property
    def search_slack(self) -> float:
        """Relative error of the coarse precision."""
        return 1e-3
