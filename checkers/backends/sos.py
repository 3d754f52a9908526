"""`sos`: the univariate sums-of-squares bound on P(g ≤ 0), g = |y|² − 1 (Jasour et al. 2021, eq. 18)."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import carray

from checkers.base import ArrayRisk, CheckerInfo, MomentChecker
from checkers.kernels.abi import ROOM, kernel
from checkers.kernels.tail import MAX_ORDER, gaussian_form, general_form, jacobi, sharp_tail
from checkers.kind import Kind
from checkers.validate import Array, InputError, as_option


@kernel
def _kernel(m1, m2, s11, s12, s22, det, moments, order, options, out):  # type: ignore[no-untyped-def]
    room = carray(out, ROOM)
    form, noise = room[2:16], room[16:32]
    degree = int(carray(options, 1)[0])
    if order == 0:
        mean, sd = gaussian_form(m1, m2, s11, s12, s22, det, degree, form, noise)
    else:
        mean, sd = general_form(m1, m2, carray(moments, (order + 1) ** 2), order, degree, form, noise)
    if sd == 0.0:
        upper = lower = 1.0 if mean <= 0.0 else 0.0
    else:
        upper, lower = sharp_tail(form, noise, degree, -mean / sd, room[32:])
    room[1] = lower
    return upper


@dataclass(frozen=True)
class Sos(MomentChecker):
    """The sharpest bound that `order` moments of g allow.

    Attributes:
        order: of the indicator polynomial, even, 2 to 12; needs moments of the position to twice that.
        solver: "closed-form" (canonical representation) or "clarabel" (the semidefinite program, certified).
    """

    order: int = 4
    solver: str = "closed-form"

    info: ClassVar[CheckerInfo] = CheckerInfo(
        name="sos",
        kind=Kind.UPPER_BOUND,
        needs="moments of the position to twice the order (8 by default)",
        assumption="none beyond the moments",
        source="Jasour et al. 2021, eq. 18; closed form: Krein & Nudelman 1977",
        cost="0.3 µs; Clarabel 0.4 ms",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.order, int | np.integer) or self.order not in range(2, MAX_ORDER + 1, 2):
            raise InputError(f"sos: order: expected an even integer from 2 to {MAX_ORDER}, got {self.order!r}")
        as_option("sos: solver", self.solver, ("closed-form", "clarabel"))

    @property
    def moments_needed(self) -> int:
        """Twice the order, since g is quadratic."""
        return 2 * self.order

    @property
    def gives_lower(self) -> bool:
        """The closed form does."""
        return self.solver == "closed-form"

    @property
    def kernel(self) -> int:
        """Address of the closed form's kernel; 0 for Clarabel."""
        return _kernel.address if self.solver == "closed-form" else 0

    @property
    def options(self) -> Array:
        """The order."""
        return np.array([float(self.order)])

    def modes(self, m: Array, s: Array, moments: Array, order: int) -> ArrayRisk:
        """The semidefinite program, one mode after the other."""
        from checkers.sdp import IntervalProgram  # noqa: PLC0415  scipy.sparse is only needed here

        value = np.ones(len(m))
        form, noise = np.empty(MAX_ORDER + 1), np.zeros(MAX_ORDER + 1)
        side = self.order // 2 + 1
        rooms = np.empty(side), np.empty(side), np.empty((side, side))
        programs = {degree: IntervalProgram(degree) for degree in range(2, self.order + 1, 2)}
        for i in range(len(m)):
            if order == 0:
                mean, sd = gaussian_form(*m[i], *s[i], self.order, form, noise)
            else:
                mean, sd = general_form(*m[i], moments[i], order, self.order, form, noise)
            degree = 2 * jacobi(form, noise, side, *rooms)
            if sd == 0.0:
                value[i] = 1.0 if mean <= 0.0 else 0.0
            elif degree > 0 and np.isfinite(mean / sd):
                kept = degree + 1
                value[i] = programs[degree].bound(form[:kept], noise[:kept], -mean / sd)
        unknown = np.full(len(m), np.nan)
        return ArrayRisk(value, unknown, unknown)
