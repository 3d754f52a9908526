"""One place for the change of frame: ego ellipsoid → unit disc, agent mode → mean and moments of y."""

import math

import numba as nb
import numpy as np


@nb.njit(cache=True, error_model="numpy")
def pack_covariances(covariances):
    """(T, K, 4) c11, c12, c22 and the determinant of covariances (T, K, 2, 2)."""
    steps, modes = covariances.shape[:2]
    out = np.empty((steps, modes, 4))
    for t in range(steps):
        for k in range(modes):
            c11, c12, c22 = covariances[t, k, 0, 0], covariances[t, k, 0, 1], covariances[t, k, 1, 1]
            out[t, k, 0], out[t, k, 1], out[t, k, 2] = c11, c12, c22
            out[t, k, 3] = determinant(c11, c12, c22)
    return out


@nb.njit(cache=True, error_model="numpy")
def determinant(c11, c12, c22):
    """c11 c22 − c12², at least 0, to full relative accuracy by exact products (Dekker 1971)."""
    p, p_low = _exact_product(c11, c22)
    q, q_low = _exact_product(c12, c12)
    return max((p - q) + (p_low - q_low), 0.0)


@nb.njit(inline="always", error_model="numpy")
def _exact_product(a, b):
    """a·b as a double and the remainder that rounding dropped, from Veltkamp's halves of 26 bits."""
    a1, b1 = 134217729.0 * a, 134217729.0 * b
    a1 = a1 - (a1 - a)
    b1 = b1 - (b1 - b)
    a2, b2 = a - a1, b - b1
    product = a * b
    return product, ((a1 * b1 - product) + a1 * b2 + a2 * b1) + a2 * b2


@nb.njit(inline="always", error_model="numpy")
def to_ego(x, y, cos, sin, mu1, mu2, c11, c12, c22):
    """Mean and covariance of the agent in the ego frame at (x, y, heading)."""
    dx, dy = mu1 - x, mu2 - y
    d1 = cos * dx + sin * dy
    d2 = -sin * dx + cos * dy
    e11 = cos * cos * c11 + 2 * cos * sin * c12 + sin * sin * c22
    e22 = sin * sin * c11 - 2 * cos * sin * c12 + cos * cos * c22
    e12 = (cos * cos - sin * sin) * c12 + cos * sin * (c22 - c11)
    return d1, d2, e11, e12, e22


@nb.njit(inline="always", error_model="numpy")
def to_disc(pieces, p, d1, d2, e11, e12, e22, det):
    """y = Lᵀ(d − o) with Q = L Lᵀ: the piece becomes the unit disc. The determinant only scales, in any frame."""
    a, b, c = pieces[p, 2], pieces[p, 3], pieces[p, 4]
    r1, r2 = d1 - pieces[p, 0], d2 - pieces[p, 1]
    m1 = a * r1 + b * r2
    m2 = c * r2
    s11 = a * a * e11 + 2 * a * b * e12 + b * b * e22
    s12 = c * (a * e12 + b * e22)
    s22 = c * c * e22
    return m1, m2, s11, s12, s22, det * (a * c) ** 2


@nb.njit(cache=True, error_model="numpy")
def map_moments(moments, order, t11, t12, t21, t22, out):
    """Central moments of T η from those of η, both (order+1)² row-major; entries beyond the order are unset."""
    n = order + 1
    for i in range(n):
        for j in range(n - i):
            total = 0.0
            left = 1.0  # C(i, k) t11^(i-k) t12^k, built term by term
            for k in range(i + 1):
                left = _binomial(i, k) * t11 ** (i - k) * t12**k
                for q in range(j + 1):
                    right = _binomial(j, q) * t21 ** (j - q) * t22**q
                    total += left * right * moments[(i - k + j - q) * n + k + q]
            out[i * n + j] = total


@nb.njit(inline="always", error_model="numpy")
def _binomial(n, k):
    value = 1.0
    for i in range(k):
        value = value * (n - i) / (i + 1)
    return value


@nb.njit(cache=True, error_model="numpy")
def whiten_moments(pieces, p, cos, sin, moments, order, out):
    """Central moments of y for one piece; the map is Lᵀ R(−ψ)."""
    a, b, c = pieces[p, 2], pieces[p, 3], pieces[p, 4]
    map_moments(moments, order, a * cos - b * sin, a * sin + b * cos, -c * sin, c * cos, out)


@nb.njit(cache=True, error_model="numpy")
def whiten_all(poses, means, covariances, moments, order, pieces):
    """Whitened modes for backends that work on arrays.

    Args:
        poses: (S, 3); means: (S, K, 2); covariances: (S, K, 4) as c11, c12, c22, determinant.
        moments: (S, K, (order+1)²).
        pieces: (N, 5) from `packing.pack_pieces`.

    Returns:
        (S, K, N, 2) means, (S, K, N, 4) covariances with determinants, (S, K, N, (order+1)²) moments.
    """
    steps, modes = means.shape[0], means.shape[1]
    count = pieces.shape[0]
    m = np.empty((steps, modes, count, 2))
    s = np.empty((steps, modes, count, 4))
    c = np.full((steps, modes, count, moments.shape[2]), np.nan)
    for t in range(steps):
        cos, sin = math.cos(poses[t, 2]), math.sin(poses[t, 2])
        for k in range(modes):
            cov = covariances[t, k]
            d1, d2, e11, e12, e22 = to_ego(
                poses[t, 0], poses[t, 1], cos, sin, means[t, k, 0], means[t, k, 1], cov[0], cov[1], cov[2]
            )
            for p in range(count):
                m1, m2, s11, s12, s22, det = to_disc(pieces, p, d1, d2, e11, e12, e22, cov[3])
                m[t, k, p, 0], m[t, k, p, 1] = m1, m2
                s[t, k, p, 0], s[t, k, p, 1], s[t, k, p, 2], s[t, k, p, 3] = s11, s12, s22, det
                if order > 0:
                    whiten_moments(pieces, p, cos, sin, moments[t, k], order, c[t, k, p])
    return m, s, c
