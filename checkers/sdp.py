"""Sums-of-squares programs by Clarabel, in their moment form, with certificates that do not trust the solver.

The largest mass that a measure with the given moments can put on a set {h ≥ 0} is a linear program over the moments y
of its part there: max y₀ with M(y) ⪰ 0, M(h·y) ⪰ 0 and M(m − y) ⪰ 0 (Lasserre 2001). The multiplier of the last
constraint is the Gram matrix of the sum of squares p ≥ 1 on the set, whose mean E p is the bound (Jasour et al. 2021,
eq. 18).
"""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np

from checkers.validate import Array

_ROOT2 = float(np.sqrt(2.0))


class _Program:
    """The program for moments of `variables` variables to an even degree: data change between calls, shape never."""

    def __init__(self, variables: int, degree: int, set_degree: int, tolerance: float) -> None:
        powers = [a for a in product(range(degree + 1), repeat=variables) if sum(a) <= degree]
        self.powers = sorted(powers, key=lambda a: (sum(a), a))
        self.index = {a: i for i, a in enumerate(self.powers)}
        self.basis = [a for a in self.powers if 2 * sum(a) <= degree]
        self.inner = [a for a in self.powers if 2 * sum(a) <= degree - set_degree]
        self.support = [a for a in self.powers if sum(a) <= set_degree]
        self._tolerance = tolerance
        self.rows = self._gram_rows(self.basis, (0,) * variables)
        self.shifted = [self._gram_rows(self.inner, b) for b in self.support]
        self._solver: Any = None
        self._pattern: Any = None

    def _gram_rows(self, basis: list[tuple[int, ...]], shift: tuple[int, ...]) -> Array:
        """Rows of Clarabel's scaled upper triangle of M(x^shift · y) over the moments y."""
        pairs = [(a, b) for j, b in enumerate(basis) for a in basis[: j + 1]]
        rows = np.zeros((len(pairs), len(self.powers)))
        for r, (a, b) in enumerate(pairs):
            total = tuple(i + j + k for i, j, k in zip(a, b, shift, strict=True))
            rows[r, self.index[total]] = 1.0 if a == b else _ROOT2
        return rows

    def solve(self, moments: Array, inside: Array) -> list[Array] | None:
        """Gram matrices of s₀, s₁ and p in p − 1 = s₀ + s₁ h, to the solver's accuracy; None if it fails.

        They come as Clarabel's scaled triangles; G gives the coefficients `rows`ᵀ G of its sum of squares.

        Args:
            moments: in the order of `powers`.
            inside: coefficients of h over `support`.
        """
        import clarabel  # noqa: PLC0415  0.1 s, needed by these programs only
        from scipy import sparse  # noqa: PLC0415

        cut = sum(c * rows for c, rows in zip(inside, self.shifted, strict=True))
        dense = np.vstack([-self.rows, -np.asarray(cut), self.rows])
        target = np.concatenate([np.zeros(len(dense) - len(self.rows)), self.rows @ moments])
        if self._solver is None:
            # the pattern of a set whose coefficients are all there
            full = np.vstack([self.rows, sum(np.abs(rows) for rows in self.shifted), self.rows])
            self._pattern = np.nonzero(full.T)[::-1]
            settings = clarabel.DefaultSettings()
            settings.verbose = settings.presolve_enable = settings.chordal_decomposition_enable = False
            settings.equilibrate_enable = False  # it would scale every later mode by the first one's data
            settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = self._tolerance
            count = len(self.powers)
            rows, columns = self._pattern
            matrix = sparse.csc_matrix((dense[rows, columns], (rows, columns)), dense.shape)
            sizes = (len(self.basis), len(self.inner), len(self.basis))
            cones = [clarabel.PSDTriangleConeT(n) for n in sizes]
            cost = np.zeros(count)
            cost[0] = -1.0
            nothing = sparse.csc_matrix((count, count))
            self._solver = clarabel.DefaultSolver(nothing, cost, matrix, target, cones, settings)
        else:
            self._solver.update(A=np.ascontiguousarray(dense[self._pattern]), b=target)
        answer = self._solver.solve()
        z = np.asarray(answer.z)
        if str(answer.status) not in ("Solved", "AlmostSolved") or not np.isfinite(z).all():
            return None
        ends = np.cumsum([len(self.rows), len(self.shifted[0])])
        return [z[: ends[0]], z[ends[0] : ends[1]], z[ends[1] :]]


class IntervalProgram(_Program):
    """P(X ≤ x₀) from standardised moments 0…d of X, d even."""

    def __init__(self, degree: int) -> None:
        super().__init__(1, degree, 1, 1e-8)
        self.degree = degree

    def bound(self, moments: Array, noise: Array, x0: float) -> float:
        """Certified upper bound; 1 if the solver fails.

        The variable is scaled to the size of the top moment for the solver.
        """
        x0 = x0 + float(noise[1])
        scale = max(float(moments[self.degree]), 1.0) ** (1.0 / self.degree)
        powers: Array = scale ** np.arange(self.degree + 1, dtype=float)
        scaled = moments / powers
        grams = self.solve(scaled, np.array([x0 / scale, -1.0]))
        if grams is None:
            return 1.0
        p = self.rows.T @ grams[2]
        uncertain = float(np.abs(p) @ (noise / powers))
        return min(1.0, certified_value(p, scaled, x0 / scale) + uncertain)


def certified_value(coefficients: Array, moments: Array, x0: float) -> float:
    """E[p] after lifting p until p ≥ 0 on ℝ and p ≥ 1 on (−∞, x₀] at all critical points; at most 1."""
    if not np.isfinite(coefficients).all() or not coefficients[-1] > 0.0:
        return 1.0
    highest_first = coefficients[::-1]
    slopes = highest_first[:-1] * np.arange(len(coefficients) - 1, 0, -1)
    companion = np.eye(len(slopes) - 1, k=-1)
    companion[0] = -slopes[1:] / slopes[0]
    critical = np.linalg.eigvals(companion)
    # a root that is real up to rounding counts: evaluating p at extra points never hurts
    points = np.append(critical.real, x0)
    values = np.polyval(highest_first, points)
    lift = max(0.0, -float(values.min()), 1.0 - float(values[points <= x0].min()))
    slack = 1e-12 * float(np.abs(coefficients) @ np.abs(moments))
    mean = max(0.0, float(coefficients @ moments))
    return min(1.0, mean + lift + slack)


class DiscProgram(_Program):
    """P(|y| ≤ 1) from the moments of y in the plane to an even degree."""

    def __init__(self, degree: int) -> None:
        super().__init__(2, degree, 2, 1e-10)
        self.degree = degree

    def bound(self, mean: Array, root: Array, moments: Array, noise: Array) -> float:
        """Certified upper bound; 1 if the solver fails.

        Args:
            mean: (2,) of y.
            root: (2, 2) so that y = mean + root w.
            moments: of w, at least to the degree, [i, j] = E[w₁^i w₂^j].
            noise: bounds on their errors.
        """
        given, unsure = (np.array([v[a] for a in self.powers]) for v in (moments, noise))
        # h = 1 − |mean + root w|², scaled
        form, linear = root.T @ root, root.T @ mean
        h = np.array([1 - mean @ mean, -2 * linear[1], -2 * linear[0], -form[1, 1], -2 * form[0, 1], -form[0, 0]])
        h /= np.abs(h).max()
        grams = self.solve(given, h)
        if grams is None:
            return 1.0
        s0, s1, gram = _matrix(grams[0]), _triangle(_positive(grams[1])), _triangle(_positive(grams[2]))
        p = self.rows.T @ gram
        # p − 1 − s₁h, whose Gram matrix is s₀ up to what the solver left over, must be a sum of squares
        rest = p - sum(c * rows.T @ s1 for c, rows in zip(h, self.shifted, strict=True))
        rest[0] -= 1.0
        left = self.rows @ ((rest - self.rows.T @ grams[0]) / (self.rows**2).sum(axis=0))
        lowest = float(np.linalg.eigvalsh(s0 + _matrix(left))[0]) - 1e-14 * float(np.abs(rest).max())
        # lifting p by that much of the sum of squared monomials makes it one
        squares = float(sum(moments[2 * a, 2 * b] + noise[2 * a, 2 * b] for a, b in self.basis))
        rounding = float(np.abs(p) @ (1e-13 * np.abs(given) + unsure))
        return min(1.0, max(float(p @ given), 0.0) + max(-lowest, 0.0) * squares + rounding)


def _matrix(triangle: Array) -> Array:
    """The matrix of Clarabel's scaled upper triangle, column by column."""
    n = int((np.sqrt(8 * len(triangle) + 1) - 1) / 2)
    columns, rows = np.tril_indices(n)
    full = np.zeros((n, n))
    full[rows, columns] = full[columns, rows] = triangle / np.where(rows == columns, 1.0, _ROOT2)
    return full


def _triangle(matrix: Array) -> Array:
    columns, rows = np.tril_indices(len(matrix))
    out: Array = matrix[rows, columns] * np.where(rows == columns, 1.0, _ROOT2)
    return out


def _positive(triangle: Array) -> Array:
    """The nearest positive semi-definite matrix."""
    values, vectors = np.linalg.eigh(_matrix(triangle))
    clean: Array = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return clean
