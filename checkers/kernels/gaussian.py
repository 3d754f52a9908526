"""P(|y| ≤ 1) for y ~ N(m, S) in the plane: exact to rounding, with relative accuracy in the tails."""

import math

import numba as nb
import numpy as np

from checkers.kernels import series

_ROOT_HALF = math.sqrt(0.5)
_CUT = 40.0  # the window is where the integrand exceeds e^−cut of its peak
_NODES = 14.0  # in the window at first
_CHANGE = 1e-7  # of two sums that agree
_START = -0.5 * math.pi
FAR = 1391.0  # squared distance: P < Φ(−37.3) = 9e-305, of denormal numbers
_X6, _W6 = np.polynomial.legendre.leggauss(6)


@nb.njit(inline="always", error_model="numpy")
def eigen(s11, s12, s22, det):
    """Eigenvalues big ≥ small ≥ 0 and the unit vector (v1, v2) of the big one; robust for repeated ones.

    The determinant is passed, for the small eigenvalue is as accurate as it.
    """
    half = 0.5 * (s11 - s22)
    radius = math.sqrt(half * half + s12 * s12)
    big = 0.5 * (s11 + s22) + radius
    if radius == 0.0 or big <= 0.0:
        return max(big, 0.0), max(big, 0.0), 1.0, 0.0
    small = det / big
    if half >= 0.0:
        v1, v2 = half + radius, s12
    else:
        v1, v2 = s12, radius - half
    norm = 1.0 / math.sqrt(v1 * v1 + v2 * v2)
    return big, min(small, big), v1 * norm, v2 * norm


@nb.njit(inline="always", error_model="numpy")
def _below(x, y, vx, vy):
    """A ν below the solution: the first step from ν = 0, or what either coordinate alone needs."""
    nu = (x * x + y * y) * (math.sqrt(x * x + y * y) - 1.0) / (x * x * vx + y * y * vy)
    return max(nu, (abs(x) - 1.0) / vx if vx > 0.0 else 0.0, (abs(y) - 1.0) / vy if vy > 0.0 else 0.0)


@nb.njit(inline="always", error_model="numpy")
def nearest(x, y, vx, vy):
    """Most likely point of the unit disc's rim for a mean (x, y) outside, axes with variances vx, vy.

    Solves the secular equation Σ m²/(1 + ν v)² = 1 by Newton on f^(−1/2) − 1, which is concave and increasing,
    so that the iteration from ν = 0 is monotone. Returns the point and the squared Mahalanobis distance.
    """
    nu = _below(x, y, vx, vy)
    for _ in range(60):
        a, b = 1.0 / (1.0 + nu * vx), 1.0 / (1.0 + nu * vy)
        f1, f2 = (x * a) ** 2, (y * b) ** 2
        f = f1 + f2
        step = f * (math.sqrt(f) - 1.0) / (f1 * vx * a + f2 * vy * b)
        nu += step
        if step <= 1e-6 * nu:  # convergence is quadratic: what is left is of the size of its square
            break
    a, b = 1.0 + nu * vx, 1.0 + nu * vy
    return x / a, y / b, nu * nu * ((x / a) ** 2 * vx + (y / b) ** 2 * vy)


@nb.njit(inline="always", error_model="numpy")
def conditioning(m1, m2, small, exponent):
    """Relative change of P under rounding of the whitened mean and variances; exponent is −log P or d²/2.

    A mean shifted by ε(1 + |m|) shifts the distance d by as much over σ; variances off by ε shift the exponent d²/2
    by that share.
    """
    d = math.sqrt(2.0 * max(exponent, 0.0)) + 1.0
    shift = (1.0 + math.sqrt(m1 * m1 + m2 * m2)) / math.sqrt(small) if small > 0.0 else 0.0
    return 1e-12 + 1e-15 * d * shift + 2e-15 * d * d


@nb.njit(inline="always", error_model="numpy")
def distance(m1, m2, s11, s12, s22, det):
    """(d², smaller variance): squared Mahalanobis distance from the mean to the disc; 0 inside, ∞ without spread."""
    if m1 * m1 + m2 * m2 <= 1.0:
        return 0.0, 0.0
    big, small, v1, v2 = eigen(s11, s12, s22, det)
    if big == 0.0:
        return np.inf, 0.0
    return _dual_distance(-v2 * m1 + v1 * m2, v1 * m1 + v2 * m2, small, big), small


@nb.njit(inline="always", error_model="numpy")
def _dual_distance(x, y, vx, vy):
    """Squared Mahalanobis distance from (x, y) to the disc: the largest ν (x²/(1 + ν vx) + y²/(1 + ν vy) − 1).

    Any ν ≥ 0 gives a lower bound, and near the best one the error is the square of ν's. So Newton's iteration, as in
    `nearest`, can end as soon as its next step would be small, and the result errs to the safe side.
    """
    nu = _below(x, y, vx, vy)
    for _ in range(60):
        a, b = 1.0 / (1.0 + nu * vx), 1.0 / (1.0 + nu * vy)
        f1, f2 = (x * a) ** 2, (y * b) ** 2
        f = f1 + f2
        spread = f1 * vx + f2 * vy
        step = f * (math.sqrt(f) - 1.0) / (f1 * vx * a + f2 * vy * b)
        if step <= 1e-6 * nu:
            break
        nu += step
    return nu * ((f - 1.0) + nu * spread)


@nb.njit(cache=True, error_model="numpy")
def tail_slopes(means, covariances):
    """(M, N, 2) d log P / d mean at its leading order, −½ d d²/dm, of means (M, N, 2) in the axes of covariances.

    Zero for means inside the disc, where rounding of the mean costs nothing.
    """
    out = np.zeros(means.shape)
    for i in range(means.shape[0]):
        for j in range(means.shape[1]):
            m1, m2, big, small = means[i, j, 0], means[i, j, 1], covariances[i, j, 0], covariances[i, j, 2]
            if m1 * m1 + m2 * m2 > 1.0 and small > 0.0:
                p1, p2, _ = nearest(m1, m2, big, small)
                out[i, j, 0], out[i, j, 1] = -(m1 - p1) / big, -(m2 - p2) / small
    return out


@nb.njit(cache=True, error_model="numpy")
def marshall_olkin(m1, m2, s11, s12, s22, det):
    """1 / (1 + d²), rounded outward: the sharp bound for any distribution of that mean and covariance."""
    d2, _ = distance(m1, m2, s11, s12, s22, det)
    return min((1.0 + 1e-14) / (1.0 + d2 * (1.0 - 1e-12)), 1.0)


@nb.njit(cache=True, error_model="numpy")
def half_space(m1, m2, s11, s12, s22, det):
    """Φ(−d) ≥ P(|y| ≤ 1), d the Mahalanobis distance from m to the disc; 1 for a mean inside."""
    d2, small = distance(m1, m2, s11, s12, s22, det)
    if d2 == 0.0:
        return 1.0
    value = 0.5 * math.erfc(math.sqrt(0.5 * d2))
    if value == 0.0:
        return value
    # outward by what rounding of the input can do
    return min(value * (1.0 + 2.0 * conditioning(m1, m2, small, 0.5 * d2)), 1.0)


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
def _integrand(origin, offset, miss, mx, my, sx, sy):
    """At t = origin + offset, miss = sin(origin) − mx; a narrow peak at the origin loses no digits of the offset."""
    t = origin + offset
    z = (2.0 * math.cos(origin + 0.5 * offset) * math.sin(0.5 * offset) + miss) / sx
    density = math.exp(-0.5 * z * z)
    if density == 0.0:
        return 0.0
    cos = math.cos(t)
    return density * _interval(-my / sy, cos / sy) * cos


@nb.njit(cache=True, error_model="numpy")
def disc(m1, m2, s11, s12, s22, det):
    """(P(|y| ≤ 1), absolute error): Ruben's series where it is short, else quadrature."""
    big, small, v1, v2 = eigen(s11, s12, s22, det)
    along, across = v1 * m1 + v2 * m2, -v2 * m1 + v1 * m2
    gap = math.sqrt(m1 * m1 + m2 * m2) - 1.0
    if gap > 0.0 and gap * gap > FAR * big:
        return 0.0, 1e-304
    if small > 0.0 and series.serves(along, across, big, small):
        value = series.disc(along, across, big, small, 1e-16)
        if value == value:
            exponent = 0.5 * (along * along / big + across * across / small)
            return min(value, 1.0), value * conditioning(m1, m2, small, exponent) + 5e-324
    value, error, exponent = _quadrature(abs(along), abs(across), big, small)
    return value, error + value * conditioning(m1, m2, small, exponent) + 5e-324


@nb.njit(cache=True, error_model="numpy")
def _quadrature(my, mx, big, small):
    """(P(|y| ≤ 1), absolute error, half the squared distance) for the mean (mx, my) ≥ 0 in the axes of small and big.

    P = ∫ φ((sin t − mx)/sx)/sx [Φ((cos t − my)/sy) − Φ((−cos t − my)/sy)] cos t dt over |t| ≤ π/2, in the principal
    axes. The integrand continues to a smooth 2π-periodic function, even about ±π/2, so the trapezoid rule converges
    geometrically (Trefethen & Weideman 2014); all terms are positive, so relative accuracy is kept in the tails.
    Nodes outside the window where the integrand exceeds e⁻⁴⁰ of its peak are skipped; the step is halved until
    two sums agree to 1e-7, and the finer one is then good to rounding: each halving squares the relative error. The
    error returned is that square, or the difference itself where halving ended early.
    """
    sy, sx = math.sqrt(big), math.sqrt(small)
    if sx < 1e-14:  # a line or a point
        if mx > 1.0:
            return 0.0, 0.0, 0.0
        chord = math.sqrt(1.0 - mx * mx)
        if sy < 1e-14:
            return (1.0 if my <= chord else 0.0), 0.0, 0.0
        p = _interval(-my / sy, chord / sy)
        return p, (1e-12 + 1e-15 * (1.0 + my) / sy) * p, 0.0
    px, py, d2 = mx, my, 0.0
    if mx * mx + my * my > 1.0:
        px, py, d2 = nearest(mx, my, small, big)
        if d2 > FAR:
            return 0.0, 1e-304, 0.0
    # integrate along the axis in which the window is narrower
    if sy / max(px, math.sqrt(sy)) < sx / max(py, math.sqrt(sx)):
        mx, my, sx, sy, px, py = my, mx, sy, sx, py, px
    if d2 == 0.0:
        peak = math.asin(min(px, 1.0))
    else:
        peak = math.atan2(px, py)
    level = 0.5 * d2 + _CUT
    first = min(9.0 * sx / max(math.cos(peak), math.sqrt(sx)), 1.0)
    low = _edge(peak, _START, first, mx, my, sx, sy, level)
    high = _edge(peak, -_START, first, mx, my, sx, sy, level)
    n = int(math.ceil(_NODES * math.pi / (high - low)))
    h = math.pi / n
    # any grid serves a window inside the range; one that meets an end must be even about it
    inside = low - h > _START and high + h < -_START
    origin = peak if inside else _START
    total = _grid_sum(h, 0.0, origin, low, high, mx, my, sx, sy)
    scale = 1.0 / (sx * math.sqrt(2.0 * math.pi))
    change = np.inf
    for _ in range(14):
        middle = _grid_sum(h, 0.5, origin, low, high, mx, my, sx, sy)
        change = abs(middle - total) / (middle + total) if middle + total > 0.0 else 0.0
        total += middle
        h *= 0.5
        if change < _CHANGE:
            break
    value = min(total * h * scale, 1.0)
    rounding = 1e-11
    if change >= _CHANGE:
        return value, value * max(change, rounding), 0.5 * d2
    return value, value * (change * change + rounding), 0.5 * d2


@nb.njit(cache=True, error_model="numpy")
def _grid_sum(h, shift, origin, low, high, mx, my, sx, sy):
    """Sum of the integrand at t = origin + (k + shift) h inside the window, the ends ±π/2 of the range included."""
    first = int(math.floor((low - origin) / h - shift))
    last = int(math.ceil((high - origin) / h - shift))
    if origin == _START:
        first, last = max(first, 0), min(last, int(round(math.pi / h - 2.0 * shift)))
    total, miss = 0.0, math.sin(origin) - mx
    for k in range(first, last + 1):
        total += _integrand(origin, (k + shift) * h, miss, mx, my, sx, sy)
    return total
