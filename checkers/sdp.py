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

from checkers.kernels.tail import jacobi
from checkers.validate import Array

_ROOT2 = float(np.sqrt(2.0))
_EPS = float(np.finfo(float).eps)


class _Program:
    """The program over the coordinates of y in some basis: data change between calls, shape and pattern never."""

    def __init__(self, sides: tuple[int, int], pattern: Array, tolerance: float) -> None:
        """Sides of M(y) and M(h·y), and where the maps from y to the triangles of M(y), M(h·y) and M(y) are not 0."""
        self._sides, self._shape, self._tolerance = sides, (pattern.shape[0], pattern.shape[1]), tolerance
        self._pattern = np.nonzero(pattern.T)[::-1]
        self._solver: Any = None

    def solve(self, rows: Array, cut: Array, target: Array, cost: Array) -> list[Array] | None:
        """Gram matrices of s₀, s₁ and p in p − 1 = s₀ + s₁ h, to the solver's accuracy; None if it fails.

        They come as Clarabel's scaled triangles; G gives the values `rows`ᵀ G of its sum of squares.

        Args:
            rows: from y to the scaled triangle of M(y).
            cut: the same for M(h·y).
            target: triangle of M(m).
            cost: −y₀ as a function of y, in any unit; the Gram matrices come in the same.
        """
        import clarabel  # noqa: PLC0415  0.1 s, needed by these programs only
        from scipy import sparse  # noqa: PLC0415

        data = np.vstack([-rows, -cut, rows])[self._pattern]
        target = np.concatenate([np.zeros(self._shape[0] - len(rows)), target])
        if self._solver is None:
            settings = clarabel.DefaultSettings()
            settings.verbose = settings.presolve_enable = settings.chordal_decomposition_enable = False
            settings.equilibrate_enable = False  # it would scale every later mode by the first one's data
            settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = self._tolerance
            cones = [clarabel.PSDTriangleConeT(n) for n in (*self._sides, self._sides[0])]
            at, columns = self._pattern
            matrix = sparse.csc_matrix((data, (at, columns)), self._shape)
            nothing = sparse.csc_matrix((len(cost), len(cost)))
            self._solver = clarabel.DefaultSolver(nothing, cost, matrix, target, cones, settings)
        else:
            self._solver.update(A=data, b=target, q=cost)
        answer = self._solver.solve()
        z = np.asarray(answer.z)
        if str(answer.status) not in ("Solved", "AlmostSolved") or not np.isfinite(z).all():
            return None
        ends = np.cumsum([len(rows), len(cut)])
        return [z[: ends[0]], z[ends[0] : ends[1]], z[ends[1] :]]


class IntervalProgram(_Program):
    """P(X ≤ x₀) from standardised moments 0…d of X, d even.

    Squares are of polynomials φ orthonormal under the moments, so that M(m) = I whatever the moments; y is a signed
    measure on d + 1 points (Löfberg & Parrilo 2004), each in units of 1 / Σ φ(x)², the largest mass there. Monomials
    lose the digits from d = 8 on.
    """

    def __init__(self, degree: int) -> None:
        self.degree, n = degree, degree // 2
        self._powers = np.arange(n + 1)
        self._outer, self._inner = np.tril_indices(n + 1), np.tril_indices(n)
        self._weights = [np.where(i == j, 1.0, _ROOT2) for i, j in (self._outer, self._inner)]
        self._identity = np.where(self._weights[0] == 1.0, 1.0, 0.0)
        sizes = [len(w) for w in self._weights]
        super().__init__((n + 1, n), np.ones((2 * sizes[0] + sizes[1], degree + 1)), 1e-8)

    def bound(self, moments: Array, noise: Array, x0: float) -> float:
        """Certified upper bound; 1 if the moments end before the degree or the solver fails."""
        n = self.degree // 2
        x0 = max(x0 + float(noise[1]), -1e9)  # outward, and its powers stay finite
        alpha, beta, root = np.zeros(n + 1), np.zeros(n + 1), np.zeros((n + 1, n + 1))
        if x0 > 1e9 or jacobi(moments, noise, n + 1, alpha, beta, root) < n:
            return 1.0
        basis = np.linalg.inv(root)  # columns: coefficients of φ₀…φₙ, lowest first
        there = x0**self._powers @ basis
        points = _points(alpha, beta, there, x0)
        phi = points[:, None] ** self._powers @ basis
        mass = 1.0 / (phi * phi).sum(axis=1)
        phi *= np.sqrt(mass)[:, None]
        h = (x0 - points) / max(1.0, abs(x0))
        (i, j), (a, b) = self._outer, self._inner
        rows = (phi[:, i] * phi[:, j] * self._weights[0]).T
        cut = (h[:, None] * phi[:, a] * phi[:, b] * self._weights[1]).T
        # the mass that x₀ can carry is at most the answer: in its units the solver's tolerance is a relative one
        unit = max(1.0 / float(there @ there), 1e-4)
        grams = self.solve(rows, cut, self._identity, -mass / unit)
        if grams is None:
            return 1.0
        gram = np.zeros_like(root)
        gram[self._outer] = grams[2] / self._weights[0]
        values, vectors = np.linalg.eigh(gram)  # reads what is below the diagonal
        values = unit * np.maximum(values, 0.0)
        mean, best = float(values.sum()), 1.0
        # far left of x₀ a last digit of p may be much; there a little of Σ φ² is more
        for lift in (1e-9, 1e-8, 1e-7, 1e-6):
            factor = basis @ (vectors * np.sqrt(values + lift * mean))
            best = min(best, certified_value(factor.T, moments, noise, x0))
            if best <= (1.0 + 100.0 * lift) * mean:
                break
        return best


def _points(alpha: Array, beta: Array, there: Array, x0: float) -> Array:
    """Zeros of φₙ and, between and around them, nodes of the canonical quadrature with a node at x₀ (Golub 1973).

    Args:
        alpha, beta: (n + 1,) the Jacobi matrix, whose last diagonal entry is found here.
        there: (n + 1,) φ₀…φₙ at x₀.
        x0: where φₙ is 0 a node is at infinity; none is put beyond a thousand times the spread of the others.
    """
    matrix = np.diag(alpha)
    matrix.ravel()[len(alpha) :: len(alpha) + 1] = beta[:-1]  # below the diagonal, where eigvalsh reads
    last, limit = alpha[-2], 1e3 * beta[-2]
    away = x0 - last - (beta[-2] * there[-2] / there[-1] if there[-1] != 0.0 else np.inf)
    matrix[-1, -1] = last + min(max(away, -limit), limit)
    return np.concatenate([np.linalg.eigvalsh(matrix[:-1, :-1]), np.linalg.eigvalsh(matrix)])


def certified_value(factor: Array, moments: Array, noise: Array, x0: float) -> float:
    """Markov's inequality P(X ≤ x₀) ≤ E p / min p over (−∞, x₀] for p = |factor · (1, x, x², …)|²; at most 1.

    p is ≥ 0 whatever the factor; its minimum is sought at all critical points; both are rounded outward.

    Args:
        factor: (r, n + 1) coefficients of the polynomials whose squares are summed, lowest first.
        moments, noise: of X, 0…2n, and bounds on their errors.
        x0: threshold.
    """
    if not np.isfinite(factor).all():
        return 1.0
    powers = np.arange(factor.shape[1])
    sums = powers[:, None] + powers
    p = np.bincount(sums.ravel(), (factor.T @ factor).ravel())
    if not p[-1] > 0.0:
        return 1.0
    slopes = (p * np.arange(len(p)))[:0:-1]
    companion = np.eye(len(slopes) - 1, k=-1)
    companion[0] = -slopes[1:] / slopes[0]
    if not np.isfinite(companion[0]).all():
        return 1.0
    # a root that is real up to rounding counts: evaluating p at extra points never hurts
    critical = np.linalg.eigvals(companion).real
    monomials = np.append(critical[critical <= x0], x0)[:, None] ** powers
    size, rounding = np.abs(factor), _EPS * len(p) ** 2
    roots = np.abs(monomials @ factor.T) - rounding * (np.abs(monomials) @ size.T)
    least = float((np.maximum(roots, 0.0) ** 2).sum(axis=1).min())
    mean = float(((factor @ moments[sums]) * factor).sum())
    slack = float(((size @ (rounding * np.abs(moments[sums]) + noise[sums])) * size).sum())
    return min(1.0, (max(mean, 0.0) + slack) / least) if least > 0.0 else 1.0


class DiscProgram(_Program):
    """P(|y| ≤ 1) from the moments of y in the plane to an even degree."""

    def __init__(self, degree: int) -> None:
        powers = [a for a in product(range(degree + 1), repeat=2) if sum(a) <= degree]
        self.powers = sorted(powers, key=lambda a: (sum(a), a))
        self.index = {a: i for i, a in enumerate(self.powers)}
        self.basis = [a for a in self.powers if 2 * sum(a) <= degree]
        inner = [a for a in self.powers if 2 * sum(a) <= degree - 2]
        self.rows = self._gram_rows(self.basis, (0, 0))
        self.shifted = [self._gram_rows(inner, b) for b in self.powers if sum(b) <= 2]
        self.cost = np.where(np.arange(len(self.powers)) == 0, -1.0, 0.0)
        pattern = np.vstack([self.rows, sum(self.shifted), self.rows])  # of a set whose coefficients are all there
        super().__init__((len(self.basis), len(inner)), pattern, 1e-10)

    def _gram_rows(self, basis: list[tuple[int, ...]], shift: tuple[int, ...]) -> Array:
        """Rows of Clarabel's scaled upper triangle of M(x^shift · y) over the moments y."""
        pairs = [(a, b) for j, b in enumerate(basis) for a in basis[: j + 1]]
        rows = np.zeros((len(pairs), len(self.powers)))
        for r, (a, b) in enumerate(pairs):
            total = tuple(i + j + k for i, j, k in zip(a, b, shift, strict=True))
            rows[r, self.index[total]] = 1.0 if a == b else _ROOT2
        return rows

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
        cut = np.asarray(sum(c * rows for c, rows in zip(h, self.shifted, strict=True)))
        grams = self.solve(self.rows, cut, self.rows @ given, self.cost)
        if grams is None:
            return 1.0
        s0, s1, gram = _matrix(grams[0]), _triangle(_positive(grams[1])), _triangle(_positive(grams[2]))
        p = self.rows.T @ gram
        # p − 1 − s₁h, whose Gram matrix is s₀ up to what the solver left over, must be a sum of squares
        rest = p - cut.T @ s1
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
