"""`unimodal-halfspace`: one-sided Vysochanskij–Petunin across the likeliest tangent."""

from dataclasses import dataclass
from typing import ClassVar

from checkers.base import Checker, CheckerInfo
from checkers.kernels.abi import kernel
from checkers.kernels.gaussian import distance
from checkers.kind import Kind


@kernel
def _kernel(m1, m2, s11, s12, s22, det, moments, order, options, out):  # type: ignore[no-untyped-def]
    d2, _ = distance(m1, m2, s11, s12, s22, det)
    if d2 == 0.0:
        return 1.0
    d2 *= 1.0 - 1e-12
    return min(max(4.0 / (9.0 * (1.0 + d2)), 4.0 / (3.0 * (1.0 + d2)) - 1.0 / 3.0) * (1.0 + 1e-14), 1.0)


@dataclass(frozen=True)
class UnimodalHalfSpace(Checker):
    """max{4 / (9(1 + d²)), (3 − d²) / (3(1 + d²))}: holds where the projection is unimodal, as in a Gaussian mode.

    It does not hold for a mixture taken whole, nor for propagated moments; hence Gaussian modes only.
    """

    info: ClassVar[CheckerInfo] = CheckerInfo(
        name="unimodal-halfspace",
        kind=Kind.UPPER_BOUND,
        needs="a Gaussian mixture",
        assumption="unimodal projections, as Gaussian modes have",
        source="Vysochanskij & Petunin 1980; one-sided: Mercadier & Strobel 2021",
        cost="0.1 µs",
    )

    @property
    def kernel(self) -> int:
        """Address of the compiled kernel."""
        return _kernel.address
