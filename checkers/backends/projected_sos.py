"""`projected-sos`: the univariate sharp bound on the projection across the likeliest tangent, or on g, the smaller."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import carray

from checkers.base import CheckerInfo, MomentChecker
from checkers.kernels.abi import ROOM, kernel
from checkers.kernels.gaussian import eigen, nearest
from checkers.kernels.tail import MAX_ORDER, gaussian_form, general_form, projection, sharp_tail
from checkers.kind import Kind
from checkers.validate import Array, InputError

# cosine and sine of the directions tried about the Marshall-Olkin tangent
_AROUND = ((1.0, 0.0), (math.cos(0.15), math.sin(0.15)), (math.cos(0.15), -math.sin(0.15)))


@kernel
def _kernel(m1, m2, s11, s12, s22, det, moments, order, options, out):  # type: ignore[no-untyped-def]
    degree = int(carray(options, 1)[0])
    room = carray(out, ROOM)
    form, noise = room[2:16], room[16:32]
    half = 2 * (degree // 4)
    if order == 0:
        mean, sd = gaussian_form(m1, m2, s11, s12, s22, det, max(half, 2), form, noise)
    else:
        mean, sd = general_form(m1, m2, carray(moments, (order + 1) ** 2), order, max(half, 2), form, noise)
    if sd == 0.0:
        best = lower = 1.0 if mean <= 0.0 else 0.0
    else:
        best, lower = sharp_tail(form, noise, max(half, 2), -mean / sd, room[32:])
    if m1 * m1 + m2 * m2 > 1.0:
        big, small, v1, v2 = eigen(s11, s12, s22, det)
        x, y = m1, m2
        if big > 0.0:
            px, py, _ = nearest(-v2 * m1 + v1 * m2, v1 * m1 + v2 * m2, small, big)
            x, y = -v2 * px + v1 * py, v1 * px + v2 * py
        length = math.sqrt(x * x + y * y)
        # a Gaussian's projections differ by their distance only, and the tangent's is the largest
        for i in range(3 if order > 0 else 1):
            cos, sin = _AROUND[i]
            a1, a2 = (cos * x - sin * y) / length, (sin * x + cos * y) / length
            # the disc lies where aᵀy ≤ 1; outward for a direction that is not quite of unit length
            gap = a1 * m1 + a2 * m2 - (1.0 + 1e-15)
            if gap <= 0.0:
                continue
            variance = a1 * a1 * s11 + 2.0 * a1 * a2 * s12 + a2 * a2 * s22
            spread = math.sqrt(max(variance, 0.0) + 1e-15 * (s11 + s22))
            if spread == 0.0:
                best = 0.0
                continue
            if order == 0:
                projection(a1, a2, spread, carray(moments, 1), 0, degree, form, noise)
            else:
                projection(a1, a2, spread, carray(moments, (order + 1) ** 2), order, degree, form, noise)
            noise[1] += 4e-16 * (1.0 + abs(m1) + abs(m2)) / spread
            best = min(best, sharp_tail(form, noise, degree, -gap / spread, room[32:])[0])
    room[1] = min(lower, best)
    return best


@dataclass(frozen=True)
class ProjectedSos(MomentChecker):
    """P(|y| ≤ 1) ≤ P(aᵀy ≤ 1) for every tangent; the moments of aᵀy have the order of the position's own.

    Attributes:
        order: of the moments of the position used, even, 4 to 12.
    """

    order: int = 4

    info: ClassVar[CheckerInfo] = CheckerInfo(
        name="projected-sos",
        kind=Kind.UPPER_BOUND,
        needs="moments of the position to the order (4 by default)",
        assumption="none beyond the moments",
        source="Krein & Nudelman 1977, on the tangent of Marshall & Olkin 1960",
        cost="0.6 µs",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.order, int | np.integer) or self.order not in range(4, MAX_ORDER + 1, 2):
            raise InputError(
                f"projected-sos: order: expected an even integer from 4 to {MAX_ORDER}, got {self.order!r}"
            )

    @property
    def moments_needed(self) -> int:
        """The order itself."""
        return self.order

    @property
    def gives_lower(self) -> bool:
        """Always."""
        return True

    @property
    def kernel(self) -> int:
        """Address of the compiled kernel."""
        return _kernel.address

    @property
    def options(self) -> Array:
        """The order."""
        return np.array([float(self.order)])
