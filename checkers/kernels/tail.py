"""Moments of the quadratic form g = |y|² − 1, and the sharp bound on P(X ≤ x₀) they allow."""

import math

import numba as nb
import numpy as np

from checkers.kernels.gaussian import eigen

MAX_ORDER = 12


@nb.njit(cache=True)
def gaussian_form(m1, m2, s11, s12, s22, order, out):
    """Mean of g and, in `out`, its standardised central moments 0…order for y ~ N(m, S). Returns (mean, sd).

    Cumulants κ_r = 2^(r−1) (r−1)! [tr S^r + r mᵀ S^(r−1) m] (Provost & Mathai 1992), then μ_n by the recursion
    μ_n = Σ C(n−1, k−1) κ_k μ_(n−k); everything in units of the standard deviation.
    """
    big, small, v1, v2 = eigen(s11, s12, s22)
    p, q = (v1 * m1 + v2 * m2) ** 2, (-v2 * m1 + v1 * m2) ** 2
    mean = (p - 1.0) + q + big + small if p >= q else (q - 1.0) + p + big + small
    variance = 2.0 * (big * big + small * small) + 4.0 * (p * big + q * small)
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
    return mean, sd


@nb.njit(cache=True)
def general_form(m1, m2, moments, moments_order, order, out):
    """The same from central moments of y (row-major (n+1)², to order 2·`order`). Returns (mean, sd).

    g − E g = 2 mᵀη + |η|² − tr S is a polynomial in the centred η, so nothing is differenced at the size of |m|².
    """
    n = moments_order + 1
    trace = moments[2 * n] + moments[2]
    mean = (m1 * m1 + m2 * m2 - 1.0) + trace
    power = np.zeros((2 * order + 1, 2 * order + 1))
    power[0, 0] = 1.0
    raw = np.zeros(MAX_ORDER + 1)
    for k in range(1, order + 1):
        for i in range(2 * k, -1, -1):  # multiply by the polynomial in place, highest degree first
            for j in range(2 * k - i, -1, -1):
                value = -trace * power[i, j]
                if i > 0:
                    value += 2.0 * m1 * power[i - 1, j]
                if i > 1:
                    value += power[i - 2, j]
                if j > 0:
                    value += 2.0 * m2 * power[i, j - 1]
                if j > 1:
                    value += power[i, j - 2]
                power[i, j] = value
        total = 0.0
        for i in range(2 * k + 1):
            for j in range(2 * k + 1 - i):
                total += power[i, j] * moments[i * n + j]
        raw[k] = total
    sd = math.sqrt(max(raw[2], 0.0)) if order >= 2 else 0.0
    out[0] = 1.0
    if order >= 1:
        out[1] = 0.0
    if sd > 0.0:
        scale = sd
        for k in range(2, order + 1):
            scale *= sd
            out[k] = raw[k] / scale
    return mean, sd


@nb.njit(cache=True)
def sharp_tail(moments, order, x0):
    """(upper, lower) on P(X ≤ x₀) over all distributions with the standardised moments 0…order, order even.

    Chebyshev–Markov–Stieltjes (Akhiezer 1965, ch. 2; Krein & Nudelman 1977): the extreme is the mass on (−∞, x₀] of
    the canonical quadrature with a node at x₀. Hankel → Cholesky → Jacobi matrix (Golub & Welsch 1969), last
    diagonal entry moved so that x₀ is an eigenvalue (Gauss–Radau; Golub 1973). Where Cholesky fails, the moments
    below it still give a valid bound.
    """
    n = order // 2
    alpha, beta = np.zeros(n + 1), np.zeros(n + 1)
    n = _jacobi(moments, n, alpha, beta)
    if n == 0:
        return 1.0, 0.0
    # orthonormal polynomials at x₀: p_(k+1) = ((x₀ − α_k) p_k − β_(k−1) p_(k−1)) / β_k
    before, here, christoffel = 0.0, 1.0, 0.0
    for k in range(n):
        christoffel += here * here
        link = beta[k - 1] * before if k > 0 else 0.0
        before, here = here, ((x0 - alpha[k]) * here - link) / beta[k]
    christoffel += here * here
    if here == 0.0:  # x₀ is a node of the n-point Gauss rule already
        size = n
    else:
        alpha[n] = x0 - beta[n - 1] * before / here
        size = n + 1
    nodes, weights = _golub_welsch(alpha, beta, size)
    at = 1.0 / christoffel
    closest = 0
    for i in range(size):
        if abs(nodes[i] - x0) < abs(nodes[closest] - x0):
            closest = i
    left = 0.0
    for i in range(size):
        if i != closest and nodes[i] < x0:
            left += weights[i]
    return min(left + at, 1.0), max(min(left, 1.0), 0.0)


@nb.njit(cache=True)
def _jacobi(moments, n, alpha, beta):
    """Fill the Jacobi matrix from the moments; return how many rows exist."""
    size = n + 1
    r = np.zeros((size, size))
    rank = size
    for i in range(size):
        pivot = moments[2 * i]
        for k in range(i):
            pivot -= r[k, i] * r[k, i]
        # a pivot lost to rounding ends the usable moments
        if not pivot > 1e-13 * moments[2 * i]:
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


@nb.njit(cache=True)
def _golub_welsch(alpha, beta, size):
    """Nodes and weights of the Jacobi matrix: eigenvalues, squared first components of the eigenvectors."""
    d, e, z = alpha[:size].copy(), np.zeros(size), np.zeros(size)
    for i in range(size - 1):
        e[i] = beta[i]
    z[0] = 1.0
    for low in range(size):  # implicit QL, one eigenvalue at a time
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
                f = z[i + 1]
                z[i + 1] = s * z[i] + c * f
                z[i] = c * z[i] - s * f
            else:
                d[low] -= p
                e[low] = g
                e[m] = 0.0
    return d, z * z
