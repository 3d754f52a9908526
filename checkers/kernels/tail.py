"""Moments of the quadratic form g = |y|² − 1, and the sharp bound on P(X ≤ x₀) they allow."""

import math

import numba as nb
import numpy as np

from checkers.kernels.gaussian import eigen

MAX_ORDER = 12
_EPS = 2.220446049250313e-16
MEAN_NOISE = 16.0 * _EPS  # of the mean of g, relative to the sum of its terms


@nb.njit(inline="always", error_model="numpy")
def gaussian_mean(m1, m2, s11, s12, s22, det):
    """Variances of y in its axes, squares of its mean there, and mean and variance of g = |y|² − 1, y ~ N(m, S)."""
    big, small, v1, v2 = eigen(s11, s12, s22, det)
    p, q = (v1 * m1 + v2 * m2) ** 2, (-v2 * m1 + v1 * m2) ** 2
    mean = (p - 1.0) + q + big + small if p >= q else (q - 1.0) + p + big + small
    variance = 2.0 * (big * big + small * small) + 4.0 * (p * big + q * small)
    return big, small, p, q, mean, variance


@nb.njit(cache=True, error_model="numpy")
def gaussian_form(m1, m2, s11, s12, s22, det, order, out, noise):
    """Mean of g and, in `out`, its standardised central moments 0…order for y ~ N(m, S). Returns (mean, sd).

    `noise` gets the absolute rounding error of each; noise[1] is that of the mean, in standard deviations.

    Cumulants κ_r = 2^(r−1) (r−1)! [tr S^r + r mᵀ S^(r−1) m] (Provost & Mathai 1992), then μ_n by the recursion
    μ_n = Σ C(n−1, k−1) κ_k μ_(n−k); everything in units of the standard deviation.
    """
    big, small, p, q, mean, variance = gaussian_mean(m1, m2, s11, s12, s22, det)
    sd = math.sqrt(variance)
    out[0] = 1.0
    if order >= 1:
        out[1] = 0.0
    if sd == 0.0:
        return mean, 0.0
    kappa = np.empty(MAX_ORDER + 1)
    factor = 1.0 / sd  # 2^(r−1) (r−1)! / sd^r
    pb, ps = 1.0, 1.0  # big^(r−1), small^(r−1)
    for r in range(1, order + 1):
        kappa[r] = factor * (big * pb + small * ps + r * (p * pb + q * ps))
        factor *= 2.0 * r / sd
        pb *= big
        ps *= small
    for n in range(2, order + 1):
        total = 0.0
        choose = float(n - 1)  # C(n−1, k−1) for k = 2
        for k in range(2, n + 1):
            total += choose * kappa[k] * out[n - k]
            choose *= (n - k) / k
        out[n] = total
        noise[n] = 16.0 * n * _EPS * total  # no term is negative
    noise[0] = 0.0
    noise[1] = MEAN_NOISE * (p + q + big + small + 1.0) / sd
    return mean, sd


@nb.njit(cache=True, error_model="numpy")
def general_form(m1, m2, moments, moments_order, order, out, noise):
    """The same from central moments of y (row-major (n+1)², to order 2·`order`). Returns (mean, sd).

    g − E g = 2 mᵀη + |η|² − tr S is a polynomial in the centred η, so nothing is differenced at the size of |m|².
    """
    n = moments_order + 1
    trace = moments[2 * n] + moments[2]
    mean = (m1 * m1 + m2 * m2 - 1.0) + trace
    power, size = np.zeros((2 * order + 1, 2 * order + 1)), np.zeros((2 * order + 1, 2 * order + 1))
    power[0, 0] = size[0, 0] = 1.0
    raw, rough = np.zeros(MAX_ORDER + 1), np.zeros(MAX_ORDER + 1)
    for k in range(1, order + 1):
        _times_form(power, k, -trace, 2.0 * m1, 2.0 * m2)
        _times_form(size, k, trace, 2.0 * abs(m1), 2.0 * abs(m2))
        total, most = 0.0, 0.0
        for i in range(2 * k + 1):
            for j in range(2 * k + 1 - i):
                total += power[i, j] * moments[i * n + j]
                most += size[i, j] * abs(moments[i * n + j])
        raw[k], rough[k] = total, 4.0 * (k + 2) * _EPS * most
    # an even moment is at least its noise: what cancelled away may still be there
    sd = math.sqrt(max(raw[2], 0.0) + rough[2]) if order >= 2 else 0.0
    out[0] = 1.0
    noise[0] = 0.0
    if order >= 1:
        out[1] = 0.0
        noise[1] = 8.0 * _EPS * (m1 * m1 + m2 * m2 + 1.0 + trace) / sd if sd > 0.0 else 0.0
    if sd > 0.0:
        scale = sd
        for k in range(2, order + 1):
            scale *= sd
            out[k], noise[k] = raw[k] / scale, rough[k] / scale
    return mean, sd


@nb.njit(cache=True, error_model="numpy")
def _times_form(power, k, constant, linear_1, linear_2):
    """Multiply a polynomial of degree 2(k−1) by constant + linear + |η|², in place, highest degree first."""
    for i in range(2 * k, -1, -1):
        for j in range(2 * k - i, -1, -1):
            value = constant * power[i, j]
            if i > 0:
                value += linear_1 * power[i - 1, j]
            if i > 1:
                value += power[i - 2, j]
            if j > 0:
                value += linear_2 * power[i, j - 1]
            if j > 1:
                value += power[i, j - 2]
            power[i, j] = value


@nb.njit(cache=True, error_model="numpy")
def sharp_tail(moments, noise, order, x0, room):
    """(upper, lower) on P(X ≤ x₀) over all distributions with the standardised moments 0…order, order even.

    Chebyshev–Markov–Stieltjes (Akhiezer 1965, ch. 2; Krein & Nudelman 1977): the extreme is the mass on (−∞, x₀] of
    the canonical quadrature with a node at x₀. Hankel → Cholesky → Jacobi matrix (Golub & Welsch 1969), last
    diagonal entry moved so that x₀ is an eigenvalue (Gauss–Radau; Golub 1973). The nodes serve only to make the
    polynomial that touches the indicator there; it dominates the indicator wherever the nodes are (Rolle), so its
    mean, with the moments' noise added, is a bound whatever rounding did to the nodes. The best over all even orders
    up to the one asked for is returned.

    Args:
        moments: of X, mean 0.
        noise: absolute error of each moment; noise[1] is that of the mean.
        order: highest moment used.
        x0: threshold.
        room: 112 numbers to work in.
    """
    upper, lower = 1.0, 0.0
    x0 += noise[1]
    side = order // 2 + 1
    alpha, beta, nodes, links = room[:8], room[8:16], room[16:24], room[24:32]
    rows = jacobi(moments, noise, side, alpha, beta, room[32 : 32 + side * side].reshape(side, side))
    for n in range(rows, 0, -1):
        size = radau(alpha, beta, n, x0, nodes, links)
        leftmost = True
        for i in range(1, size):
            leftmost = leftmost and nodes[i] > x0
        if leftmost:
            above, below = _square_mean(nodes, size, x0, moments, noise, room[32:40], room[40:48]), 0.0
        else:
            above, below = _touching_means(nodes, size, x0, moments, noise, room[32:])
        upper, lower = min(upper, above), max(lower, below)
        if above < 1.0 and n == rows and noise[2 * n] <= 1e-10 * moments[2 * n]:
            break  # the highest order is the sharpest, unless noise spoils it
    return upper, min(max(lower, 0.0), upper)


@nb.njit(cache=True, error_model="numpy")
def radau(alpha, beta, n, x0, nodes, links):
    """Count of nodes of the quadrature with n+1 of them, filled in, one of them x₀ itself and put first."""
    before, here = 0.0, 1.0
    for k in range(n):
        link = beta[k - 1] * before if k > 0 else 0.0
        before, here = here, ((x0 - alpha[k]) * here - link) / beta[k]
    size = n
    if here != 0.0:
        alpha[n] = x0 - beta[n - 1] * before / here
        size = n + 1
    if size <= 3:  # the other eigenvalues are roots of what is left of the characteristic polynomial
        nodes[0] = x0
        others = -x0
        for i in range(size):
            others += alpha[i]
        if size == 2:
            nodes[1] = others
        if size == 3:
            minors = alpha[0] * (alpha[1] + alpha[2]) + alpha[1] * alpha[2] - beta[0] ** 2 - beta[1] ** 2
            half = 0.5 * others
            root = math.sqrt(max(half * half - (minors - x0 * others), 0.0))
            nodes[1], nodes[2] = half - root, half + root
        return size
    _eigenvalues(alpha, beta, size, nodes, links)
    closest = 0
    for i in range(size):
        if abs(nodes[i] - x0) < abs(nodes[closest] - x0):
            closest = i
    nodes[closest] = nodes[0]
    nodes[0] = x0
    return size


@nb.njit(cache=True, error_model="numpy")
def _square_mean(nodes, size, x0, moments, noise, q, rough):
    """Upper bound on P(X ≤ x₀) from nodes right of x₀: the mean of Π (x − t)² / (x₀ − t)², which is ≥ 1 left of x₀.

    What `_touching_means` gives when no node lies left of x₀, at a fraction of its cost; rounded outward likewise.
    """
    q[0] = rough[0] = scale = 1.0
    for i in range(1, size):
        t = nodes[i]
        scale *= x0 - t
        q[i] = rough[i] = 1.0
        for k in range(i - 1, 0, -1):
            q[k], rough[k] = q[k - 1] - t * q[k], rough[k - 1] + abs(t) * rough[k]
        q[0], rough[0] = -t * q[0], abs(t) * rough[0]
    mean, slack = 0.0, 0.0
    for j in range(size):
        for k in range(size):
            mean += q[j] * q[k] * moments[j + k]
            slack += rough[j] * rough[k] * (4.0 * size * size * _EPS * abs(moments[j + k]) + noise[j + k])
    value = (max(mean, 0.0) + slack) / (scale * scale) * (1.0 + 4.0 * size * _EPS)
    return min(value, 1.0) if math.isfinite(value) else 1.0


@nb.njit(cache=True, error_model="numpy")
def _touching_means(nodes, size, x0, moments, noise, room):
    """Means of the polynomials that touch the indicator of (−∞, x₀] at the nodes, from above and from below.

    Hermite interpolation with value and slope at every node but x₀ (nodes[0]), where the value alone is set: 1 above,
    0 below. Rounded outward: every coefficient's error is bounded by the same recursion on absolute values.
    """
    count = 2 * size - 1
    t, f, g, c = room[:13], room[13:26], room[26:39], room[39:52]
    e, size_c, result = room[52:65], room[65:78], room[78:80]
    t[0] = x0
    for i in range(1, size):
        t[2 * i - 1] = t[2 * i] = nodes[i]
    for side in range(2):
        for i in range(count):  # divided differences f, and bounds g on their rounding in units of ε
            f[i] = 1.0 if t[i] < x0 or (i == 0 and side == 0) else 0.0
            g[i] = c[i] = e[i] = size_c[i] = 0.0
        for level in range(1, count):
            for i in range(count - 1, level - 1, -1):
                gap = t[i] - t[i - level]
                if gap == 0.0:
                    f[i], g[i] = 0.0, 0.0  # a double node: slope 0
                else:
                    f[i] = (f[i] - f[i - 1]) / gap
                    g[i] = (g[i] + g[i - 1]) / abs(gap) + 4.0 * abs(f[i])
        for i in range(count - 1, -1, -1):  # Newton form to monomials, Horner's way
            for k in range(count - 1, 0, -1):
                c[k] = c[k - 1] - t[i] * c[k]
                size_c[k] = size_c[k - 1] + abs(t[i]) * size_c[k]
                e[k] = e[k - 1] + abs(t[i]) * e[k]
            c[0], size_c[0], e[0] = -t[i] * c[0] + f[i], abs(t[i]) * size_c[0] + abs(f[i]), abs(t[i]) * e[0] + g[i]
        mean, slack = 0.0, 0.0
        for k in range(count):
            mean += c[k] * moments[k]
            slack += (e[k] + 4.0 * count * size_c[k]) * _EPS * abs(moments[k]) + abs(c[k]) * noise[k]
        result[side] = mean + slack if side == 0 else mean - slack
    if not (math.isfinite(result[0]) and math.isfinite(result[1])):
        return 1.0, 0.0
    return min(max(result[0], 0.0) + 1e-14, 1.0), result[1]


@nb.njit(cache=True, error_model="numpy")
def jacobi(moments, noise, size, alpha, beta, r):
    """Fill the Jacobi matrix from the moments by the Cholesky factor r of their Hankel matrix; return its rows."""
    rank = size
    for i in range(size):
        pivot = moments[2 * i]
        for k in range(i):
            pivot -= r[k, i] * r[k, i]
        # a pivot lost to rounding ends the usable moments
        if not pivot > 1e-13 * moments[2 * i] + 10.0 * noise[2 * i]:
            rank = i
            break
        r[i, i] = math.sqrt(pivot)
        for j in range(i + 1, size):
            value = moments[i + j]
            for k in range(i):
                value -= r[k, i] * r[k, j]
            r[i, j] = value / r[i, i]
    n = rank - 1
    for j in range(n):
        alpha[j] = r[j, j + 1] / r[j, j] - (r[j - 1, j] / r[j - 1, j - 1] if j > 0 else 0.0)
        beta[j] = r[j + 1, j + 1] / r[j, j]
    return max(n, 0)


@nb.njit(cache=True, error_model="numpy")
def _eigenvalues(alpha, beta, size, d, e):
    """Fill d with the eigenvalues of a symmetric tridiagonal matrix by implicit QL; e is room for as many numbers."""
    for i in range(size):
        d[i], e[i] = alpha[i], beta[i] if i < size - 1 else 0.0
    for low in range(size):
        for _ in range(60):
            m = low
            while m < size - 1 and abs(e[m]) > 1e-16 * (abs(d[m]) + abs(d[m + 1])):
                m += 1
            if m == low:
                break
            g = (d[low + 1] - d[low]) / (2.0 * e[low])
            r = math.hypot(g, 1.0)
            g = d[m] - d[low] + e[low] / (g + math.copysign(r, g))
            s, c, p = 1.0, 1.0, 0.0
            for i in range(m - 1, low - 1, -1):
                f, b = s * e[i], c * e[i]
                r = math.hypot(f, g)
                e[i + 1] = r
                if r == 0.0:
                    d[i + 1] -= p
                    e[m] = 0.0
                    break
                s, c = f / r, g / r
                g = d[i + 1] - p
                r = (d[i] - g) * s + 2.0 * c * b
                p = s * r
                d[i + 1] = g + p
                g = c * r - b
            else:
                d[low] -= p
                e[low] = g
                e[m] = 0.0


@nb.njit(cache=True, error_model="numpy")
def projection(a1, a2, spread, moments, moments_order, order, out, noise):
    """Fill `out` with the moments 0…order of aᵀη / spread and `noise` with their rounding error.

    From central moments of y (row-major (n+1)²), or of a Gaussian if moments_order is 0.
    """
    n = moments_order + 1
    out[0], noise[0] = 1.0, 0.0
    for k in range(1, order + 1):
        if moments_order == 0:
            out[k] = (k - 1) * out[k - 2] if k > 1 else 0.0
            noise[k] = 4.0 * k * _EPS * out[k]
            continue
        total, most, choose = 0.0, 0.0, 1.0
        for j in range(k + 1):  # C(k, j) a1^(k−j) a2^j E[η1^(k−j) η2^j]
            term = choose * a1 ** (k - j) * a2**j * moments[(k - j) * n + j]
            total += term
            most += abs(term)
            choose *= (k - j) / (j + 1.0)
        scale = spread**k
        out[k], noise[k] = total / scale, 4.0 * (k + 2) * _EPS * most / scale
    if order >= 1:
        out[1], noise[1] = 0.0, 4.0 * _EPS


@nb.njit(cache=True, error_model="numpy")
def table_bound(mean, sd, moments, noise, table, room):
    """Smallest mean of the polynomials Π (1 − u/t)² of u = g / E g over the rows t − 1 > −1 of `table`; 1 for E g ≤ 0.

    Args:
        mean, sd: of g.
        moments, noise: standardised moments of g and their error; noise[1] is that of the mean.
        table: (N, n), the moments going to order 2n.
        room: 24 numbers to work in.
    """
    mean -= noise[1] * sd  # outward
    best = 1.0
    if mean <= 0.0:
        return best
    size = table.shape[1] + 1
    nodes = room[:8]
    for i in range(table.shape[0]):
        for k in range(1, size):
            nodes[k] = table[i, k - 1] * (mean / sd)
        best = min(best, _square_mean(nodes, size, -mean / sd, moments, noise, room[8:16], room[16:24]))
    return best
