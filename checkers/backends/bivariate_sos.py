"""`bivariate-sos`: the sharp bound that moments of the position in the plane allow, as a semidefinite program."""

from dataclasses import dataclass
from math import comb
from typing import ClassVar

import numpy as np

from checkers.base import ArrayRisk, CheckerInfo, MomentChecker
from checkers.kernels.gaussian import marshall_olkin
from checkers.kernels.whiten import map_moments
from checkers.kind import Kind
from checkers.moments import gaussian_central_moments
from checkers.validate import Array, InputError


@dataclass(frozen=True)
class BivariateSos(MomentChecker):
    """min E p over p ≥ 1 on the ellipse, p a sum of squares in two variables; solved by Clarabel and certified.

    The reference that `projected-sos` comes close to at a thousandth of the cost.

    Attributes:
        order: highest degree of p: 2, 4, 6 or 8.
    """

    order: int = 4

    info: ClassVar[CheckerInfo] = CheckerInfo(
        name="bivariate-sos",
        kind=Kind.UPPER_BOUND,
        needs="moments of the position to the order (4 by default)",
        assumption="none beyond the moments",
        source="Lasserre 2001; Jasour et al. 2021, section IV-D",
        cost="2 to 10 ms",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.order, int | np.integer) or self.order not in (2, 4, 6, 8):
            raise InputError(f"bivariate-sos: order: expected 2, 4, 6 or 8, got {self.order!r}")

    @property
    def moments_needed(self) -> int:
        """The order itself."""
        return self.order

    @property
    def kernel(self) -> int:
        """None: works on arrays."""
        return 0

    def modes(self, m: Array, s: Array, moments: Array, order: int) -> ArrayRisk:
        """One program after the other, all even degrees up to the order.

        Degree 2 has the closed form of Marshall & Olkin. A certificate far out in the tail suffers from the solver's
        last digits, the more the higher the degree; the smallest certified value counts.
        """
        from checkers.sdp import DiscProgram  # noqa: PLC0415  scipy.sparse is only needed here

        value = np.array([marshall_olkin(*mean, *cov) for mean, cov in zip(m.tolist(), s.tolist(), strict=True)])
        for degree in range(4, self.order + 1, 2):
            program = DiscProgram(degree)
            for i in range(len(m)):
                root = _root(s[i])
                if root is not None:
                    given, noise = _standard_moments(moments[i], order, root, degree)
                    value[i] = min(value[i], program.bound(m[i], root, given, noise))
        unknown = np.full(len(m), np.nan)
        return ArrayRisk(value, unknown, unknown)


def _root(s: Array) -> Array | None:
    """Cholesky factor of a covariance s11, s12, s22, determinant; None if it is too thin to divide by."""
    s11, s12, _, det = s
    if not det > 1e-12 * (s11 + s[2]) ** 2 or not s11 > 0.0:
        return None
    a = np.sqrt(s11)
    return np.array([[a, 0.0], [s12 / a, np.sqrt(det / s11)]])


def _standard_moments(moments: Array, order: int, root: Array, degree: int) -> tuple[Array, Array]:
    """Moments of root⁻¹(y − m) and bounds on their rounding error, which a thin covariance magnifies."""
    if order == 0:
        standard = gaussian_central_moments(np.eye(2), degree)
        return standard, 1e-15 * np.nan_to_num(standard)
    n = order + 1
    given, inverse = np.nan_to_num(moments), np.linalg.inv(root)
    w, rough = np.empty(n * n), np.empty(n * n)
    map_moments(given, order, *inverse.ravel(), w)
    map_moments(_sizes(given.reshape(n, n), order), order, *np.abs(inverse).ravel(), rough)
    return w.reshape(n, n), 64.0 * (order + 2) * np.finfo(float).eps * rough.reshape(n, n)


def _sizes(moments: Array, order: int) -> Array:
    """What the terms of each whitened moment may have amounted to before they cancelled: 2^(k/2) E|η|^k, row-major."""
    radial = np.ones(order + 2)
    for k in range(2, order + 1, 2):
        half = k // 2
        radial[k] = 2.0**half * sum(comb(half, i) * moments[2 * i, k - 2 * i] for i in range(half + 1))
    for k in range(1, order, 2):
        radial[k] = np.sqrt(radial[k - 1] * radial[k + 1])
    if order % 2:
        radial[order] = radial[order - 1] * np.sqrt(radial[order - 1] / max(radial[order - 3], 1e-300))
    i, j = np.indices((order + 1, order + 1))
    sizes: Array = np.where(i + j <= order, radial[np.minimum(i + j, order)], 0.0).reshape(-1)
    return sizes
