"""P(|y| ≤ 1) for y ~ N(m, S) in the plane: exact to rounding, with relative accuracy in the tails."""

import math

import numba as nb
import numpy as np

_ROOT_HALF = math.sqrt(0.5)
# rows of a precision: window where the integrand exceeds e^−cut of its peak, nodes in it at first, accepted change
FULL = np.array([40.0, 14.0, 1e-7])
COARSE = np.array([16.0, 7.0, 3e-3])  # relative error below 1e-3: for searching, not for stating
_X6, _W6 = np.polynomial.legendre.leggauss(6)


@nb.njit(inline="always", error_model="numpy")
def eigen(s11, s12, s22):
    """Eigenvalues big ≥ small ≥ 0 and the unit vector (v1, v2) of the big one; robust for repeated ones."""
    half = 0.5 * (s11 - s22)
    radius = math.hypot(half, s12)
    big = 0.5 * (s11 + s22) + radius
    if radius == 0.0 or big <= 0.0:
        return max(big, 0.0), max(big, 0.0), 1.0, 0.0
    small = max((s11 * s22 - s12 * s12) / big, 0.0)
    if half >= 0.0:
        v1, v2 = half + radius, s12
    else:
        v1, v2 = s12, radius - half
    norm = math.hypot(v1, v2)
    return big, min(small, big), v1 / norm, v2 / norm


@nb.njit(inline="always", error_model="numpy")
def nearest(x, y, vx, vy):
    """Most likely point of the unit disc's rim for a mean (x, y) outside, axes with variances vx, vy.

    Solves the secular equation Σ m²/(1 + ν v)² = 1 by Newton on f^(−1/2) − 1, which is concave and increasing,
    so that the iteration from ν = 0 is monotone. Returns the point and the squared Mahalanobis distance.
    """
    nu = 0.0
    for _ in range(60):
        a, b = 1.0 + nu * vx, 1.0 + nu * vy
        f = (x / a) ** 2 + (y / b) ** 2
        slope = (x / a) ** 2 * vx / a + (y / b) ** 2 * vy / b
        step = f * (math.sqrt(f) - 1.0) / slope
        nu += step
        if step <= 1e-13 * nu:
            break
    a, b = 1.0 + nu * vx, 1.0 + nu * vy
    return x / a, y / b, nu * nu * ((x / a) ** 2 * vx + (y / b) ** 2 * vy)


@nb.njit(inline="always", error_model="numpy")
def conditioning(m1, m2, s11, s12, s22, small, exponent):
    """Relative change of P under rounding of the whitened mean and covariance; exponent is −log P or d²/2.

    A mean shifted by ε(1 + |m|) shifts the distance d by as much over σ; entries of S off by ε shift the small
    eigenvalue, which is a difference of products, by its cancellation, and the exponent d²/2 by that share.
    """
    d = math.sqrt(2.0 * max(exponent, 0.0)) + 1.0
    shift = (1.0 + math.hypot(m1, m2)) / math.sqrt(small) if small > 0.0 else 0.0
    determinant = s11 * s22 - s12 * s12
    tilt = (s11 * s22 + s12 * s12) / determinant if determinant > 0.0 else 0.0
    return 1e-12 + 1e-15 * d * shift + 4e-16 * d * d * (1.0 + tilt)


@nb.njit(cache=True, error_model="numpy")
def half_space(m1, m2, s11, s12, s22):
    """Φ(−d) ≥ P(|y| ≤ 1), d the Mahalanobis distance from m to the disc; 1 for a mean inside."""
    if m1 * m1 + m2 * m2 <= 1.0:
        return 1.0
    big, small, v1, v2 = eigen(s11, s12, s22)
    if big == 0.0:
        return 0.0
    _, _, d2 = nearest(-v2 * m1 + v1 * m2, v1 * m1 + v2 * m2, small, big)
    value = 0.5 * math.erfc(math.sqrt(0.5 * d2))
    # outward by what rounding of the input can do
    return min(value * (1.0 + 2.0 * conditioning(m1, m2, s11, s12, s22, small, 0.5 * d2)), 1.0)


@nb.njit(cache=True, error_model="numpy")
def _interval(middle, half):
    """Φ(middle + half) − Φ(middle − half) for middle ≤ 0 ≤ half, keeping relative accuracy."""
    low, high = middle - half, middle + half
    if high > 0.0:
        return 0.5 * (math.erf(high * _ROOT_HALF) + math.erf(-low * _ROOT_HALF))
    if -4.0 * middle * half > 1.0:
        return 0.5 * (math.erfc(-high * _ROOT_HALF) - math.erfc(-low * _ROOT_HALF))
    # nearly equal arguments: integrate the density instead of subtracting
    total = 0.0
    for i in range(6):
        z = middle + half * _X6[i]
        total += _W6[i] * math.exp(-0.5 * z * z)
    return total * half * 0.3989422804014327


@nb.njit(inline="always", error_model="numpy")
def _exponent(t, mx, my, sx, sy):
    """−log of the integrand at its leading order: quasi-convex in t."""
    a = (math.sin(t) - mx) / sx
    b = max(0.0, my - math.cos(t)) / sy
    return 0.5 * (a * a + b * b)


@nb.njit(cache=True, error_model="numpy")
def _edge(peak, limit, first, mx, my, sx, sy, level):
    """A t between `peak` and `limit` beyond which the integrand is negligible: within a factor 2 of the closest."""
    span = abs(limit - peak)
    side = 1.0 if limit > peak else -1.0
    step = min(first, span)
    if _exponent(peak + side * step, mx, my, sx, sy) > level:
        while step > 1e-300 and _exponent(peak + side * 0.5 * step, mx, my, sx, sy) > level:
            step *= 0.5
    else:
        while step < span and _exponent(peak + side * step, mx, my, sx, sy) <= level:
            step *= 2.0
    return peak + side * min(step, span)


@nb.njit(cache=True, error_model="numpy")
def _integrand(t, mx, my, sx, sy):
    sin, cos = math.sin(t), math.cos(t)
    z = (sin - mx) / sx
    density = math.exp(-0.5 * z * z)
    if density == 0.0:
        return 0.0
    return density * _interval(-my / sy, cos / sy) * cos


@nb.njit(cache=True, error_model="numpy")
def disc(m1, m2, s11, s12, s22, precision):
    """(P(|y| ≤ 1), absolute error); precision is FULL or COARSE.

    P = ∫ φ((sin t − mx)/sx)/sx [Φ((cos t − my)/sy) − Φ((−cos t − my)/sy)] cos t dt over |t| ≤ π/2, in the principal
    axes. The integrand continues to a smooth 2π-periodic function, even about ±π/2, so the trapezoid rule converges
    geometrically (Trefethen & Weideman 2014); all terms are positive, so relative accuracy is kept in the tails.
    Nodes outside the window where the integrand exceeds e⁻⁴⁰ of its peak are skipped; the step is halved until
    two sums agree to 1e-7, and the finer one is then good to rounding: each halving squares the relative error. The
    error returned is that square, or the difference itself where halving ended early, plus a rounding allowance.
    """
    big, small, v1, v2 = eigen(s11, s12, s22)
    my, mx = abs(v1 * m1 + v2 * m2), abs(-v2 * m1 + v1 * m2)
    sy, sx = math.sqrt(big), math.sqrt(small)
    if sx < 1e-14:  # a line or a point
        if mx > 1.0:
            return 0.0, 0.0
        chord = math.sqrt(1.0 - mx * mx)
        if sy < 1e-14:
            return (1.0 if my <= chord else 0.0), 0.0
        p = _interval(-my / sy, chord / sy)
        return p, (1e-12 + 1e-15 * (1.0 + my) / sy) * p
    px, py, d2 = mx, my, 0.0
    if mx * mx + my * my > 1.0:
        px, py, d2 = nearest(mx, my, small, big)
        if d2 > 1391.0:  # P < Φ(−37.3) = 9e-305: the integrand would be of denormal numbers
            return 0.0, 1e-304
    # integrate along the axis in which the window is narrower
    if sy / max(px, math.sqrt(sy)) < sx / max(py, math.sqrt(sx)):
        mx, my, sx, sy, px, py = my, mx, sy, sx, py, px
    if d2 == 0.0:
        peak = math.asin(min(px, 1.0))
    else:
        peak = math.atan2(px, py)
    level = 0.5 * d2 + precision[0]
    first = min(9.0 * sx / max(math.cos(peak), math.sqrt(sx)), 1.0)
    low = _edge(peak, -0.5 * math.pi, first, mx, my, sx, sy, level)
    high = _edge(peak, 0.5 * math.pi, first, mx, my, sx, sy, level)
    n = int(math.ceil(precision[1] * math.pi / (high - low)))
    total = _grid_sum(n, 0.0, low, high, mx, my, sx, sy)
    scale = 1.0 / (sx * math.sqrt(2.0 * math.pi))
    change = np.inf
    for _ in range(14):
        middle = _grid_sum(n, 0.5, low, high, mx, my, sx, sy)
        change = abs(middle - total) / (middle + total) if middle + total > 0.0 else 0.0
        total += middle
        n *= 2
        if change < precision[2]:
            break
    value = min(total * math.pi / n * scale, 1.0)
    rounding = 1e-11 + conditioning(m1, m2, s11, s12, s22, small, 0.5 * d2)
    if change >= precision[2]:
        return value, value * max(change, rounding)
    return value, value * (change * change + rounding)


@nb.njit(cache=True, error_model="numpy")
def _grid_sum(n, shift, low, high, mx, my, sx, sy):
    """Sum of the integrand at t = −π/2 + (k + shift) π/n inside the window."""
    h = math.pi / n
    first = max(0, int(math.floor((low + 0.5 * math.pi) / h - shift)))
    last = min(n - 1 if shift > 0.0 else n, int(math.ceil((high + 0.5 * math.pi) / h - shift)))
    total = 0.0
    for k in range(first, last + 1):
        total += _integrand((k + shift) * h - 0.5 * math.pi, mx, my, sx, sy)
    return total
