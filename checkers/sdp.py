"""The univariate sums-of-squares program by Clarabel, with a certificate that does not trust the solver."""

from __future__ import annotations

import numpy as np
from numpy.polynomial import polynomial as P

from checkers.validate import Array


def indicator_bound(moments: Array, noise: Array, x0: float) -> float:
    """Certified upper bound on P(X ≤ x₀) from standardised moments 0…d, d even (Jasour et al. 2021, eq. 18).

    min Σ c_k E[X^k] with p = Σ c_k x^k SOS and p − 1 = s₁ + (x₀ − x) s₂, both SOS. The polynomial is scaled to the
    size of the top moment for the solver; the value returned is E[p] for the returned p, lifted by the deficits of
    p ≥ 0 on ℝ and p ≥ 1 on x ≤ x₀, found at their critical points.
    """
    degree: int = _usable(moments, noise)
    if degree == 0 or not np.isfinite(x0):
        return 1.0
    moments, noise, x0 = moments[: degree + 1], noise[: degree + 1], x0 + float(noise[1])
    scale = max(float(moments[degree]), 1.0) ** (1.0 / degree)
    scaled = moments / scale ** np.arange(degree + 1)
    coefficients = _solve(scaled, x0 / scale)
    if coefficients is None:
        return 1.0
    powers: Array = scale ** np.arange(degree + 1, dtype=float)
    uncertain = float(np.abs(coefficients) @ (noise / powers))
    return min(1.0, certified_value(coefficients, scaled, x0 / scale) + uncertain)


def certified_value(coefficients: Array, moments: Array, x0: float) -> float:
    """E[p] after lifting p until p ≥ 0 on ℝ and p ≥ 1 on (−∞, x₀] at all critical points; at most 1."""
    if not np.isfinite(coefficients).all() or coefficients[-1] < 0.0:
        return 1.0
    critical = P.polyroots(P.polyder(coefficients)) if len(coefficients) > 2 else np.zeros(0)
    # a root that is real up to rounding counts: evaluating p at extra points never hurts
    points = np.concatenate([critical.real, [x0]])
    values = np.asarray(P.polyval(points, coefficients), dtype=float)
    left = points <= x0
    lift = max(0.0, -float(values.min()), 1.0 - float(values[left].min()))
    slack = 1e-12 * float(np.abs(coefficients) @ np.abs(moments))
    mean = max(0.0, float(coefficients @ moments))
    return min(1.0, mean + lift + slack)


def _usable(moments: Array, noise: Array) -> int:
    """The highest even order whose Hankel matrix is positive definite beyond noise: of others solvers make nonsense."""
    for degree in range(len(moments) - 1, 0, -2):
        hankel = np.array([[moments[i + j] for j in range(degree // 2 + 1)] for i in range(degree // 2 + 1)])
        if not np.isfinite(hankel).all():
            continue
        size = np.sqrt(np.maximum(np.diag(hankel), 0.0))
        if (size > 0).all() and np.linalg.eigvalsh(hankel / np.outer(size, size))[0] > 1e-12:
            if float((noise[: degree + 1] / np.maximum(np.abs(moments[: degree + 1]), 1.0)).max()) < 1e-6:
                return degree
    return 0


def _solve(moments: Array, x0: float) -> Array | None:
    import clarabel  # noqa: PLC0415  0.1 s, needed by this solver only
    from scipy import sparse  # noqa: PLC0415

    degree = len(moments) - 1
    n = degree // 2 + 1  # monomials of p and s₁; s₂ has one less
    blocks = [_gram_map(n, degree), _gram_map(n, degree), _gram_map(n - 1, degree)]
    lower_s2 = np.zeros_like(blocks[2])
    lower_s2[1:] = blocks[2][:-1]
    # p − 1 − s₁ − (x₀ − x) s₂ = 0, coefficient by coefficient
    equality = np.hstack([blocks[0], -blocks[1], -(x0 * blocks[2] - lower_s2)])
    target = np.zeros(degree + 1)
    target[0] = 1.0
    count = equality.shape[1]
    cost = np.concatenate([blocks[0].T @ moments, np.zeros(count - blocks[0].shape[1])])
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    solver = clarabel.DefaultSolver(
        sparse.csc_matrix((count, count)),
        cost,
        sparse.csc_matrix(np.vstack([equality, -np.eye(count)])),
        np.concatenate([target, np.zeros(count)]),
        [
            clarabel.ZeroConeT(degree + 1),
            clarabel.PSDTriangleConeT(n),
            clarabel.PSDTriangleConeT(n),
            clarabel.PSDTriangleConeT(n - 1),
        ],
        settings,
    )
    answer = solver.solve()
    solution = np.asarray(answer.x)
    if str(answer.status) not in ("Solved", "AlmostSolved"):
        return None
    if solution.shape != (count,) or not np.isfinite(solution).all():
        return None
    coefficients: Array = blocks[0] @ solution[: blocks[0].shape[1]]
    return coefficients


def _gram_map(n: int, degree: int) -> Array:
    """(degree+1, n(n+1)/2): coefficients of vᵀXv from Clarabel's scaled upper triangle of X, v = 1, x, …, x^(n−1)."""
    columns = [(i, j) for j in range(n) for i in range(j + 1)]
    out = np.zeros((degree + 1, len(columns)))
    for c, (i, j) in enumerate(columns):
        out[i + j, c] = 1.0 if i == j else np.sqrt(2.0)
    return out
