"""How the risk of one whitened mode changes as the ego moves: boundary integrals, and the chain rule back to the pose.

P = ∫_A f over a body A that moves with velocity V has dP = ∮_∂A f (V·n) ds (Hadamard 1908; Flanders 1973), so with the
density φ of y ~ N(m, S) on the unit circle u = (cos t, sin t) all a pose needs is
    ∮ φ u dt    and    ∮ φ uᵀK u dt,
K = −Lᵀ J L⁻ᵀ being what turning the ego by dψ does to whitened vectors; only its symmetric part counts, the rest turns
the disc into itself. Every backend's gradient kernel has the signature of `abi` with
    options         k11, k12 of that symmetric part [[k11, k12], [k12, −k11]]
    out             −∂/∂m (two numbers) and ∂/∂ψ at a fixed centre of the piece; the rest is room
"""

import math

import numba as nb
import numpy as np

from checkers.kernels.abi import ROOM, call_kernel
from checkers.kernels.gaussian import FAR, eigen, nearest
from checkers.kernels.whiten import to_disc, to_ego, whiten_moments

_CUT = 40.0  # nodes where the density is below e^−cut of its peak on the rim are left out
_NODES = 18.0  # in the window at first
_QUARTER = 0.5 * math.pi
_CHANGE = 1e-7  # of two sums that agree; each halving squares the relative error
_POINT = 1e-14  # a smaller spread is none


@nb.njit(cache=True, error_model="numpy", nogil=True)
def batch_gradient(address, pieces, poses, means, covariances, moments, order, farthest, out):
    """Fill out (B, T, K, 3), the change of the summed pieces with x, y [1/m] and heading [1/rad].

    The arguments are those of `lift.batch_risk`; `address` is that of a gradient kernel.

    Returns:
        how many modes got a NaN, or −1 if it met a pose that is not finite or too far.
    """
    unknown = 0
    scratch, turn, found = np.empty((order + 1) ** 2), np.empty(2), np.empty(ROOM)
    scratch_at, turn_at, found_at = scratch.ctypes.data, turn.ctypes.data, found.ctypes.data
    for b in range(poses.shape[0]):
        for t in range(poses.shape[1]):
            x, y, heading = poses[b, t, 0], poses[b, t, 1], poses[b, t, 2]
            if not (abs(x) <= farthest and abs(y) <= farthest and abs(heading) <= farthest):
                return -1
            cos, sin = math.cos(heading), math.sin(heading)
            for k in range(means.shape[1]):
                cov = covariances[t, k]
                d1, d2, e11, e12, e22 = to_ego(x, y, cos, sin, means[t, k, 0], means[t, k, 1], cov[0], cov[1], cov[2])
                ahead, left, turned = 0.0, 0.0, 0.0
                for p in range(pieces.shape[0]):
                    m1, m2, s11, s12, s22, det = to_disc(pieces, p, d1, d2, e11, e12, e22, cov[3])
                    if order > 0:
                        whiten_moments(pieces, p, cos, sin, moments[t, k], order, scratch)
                    l11, l21, l22 = pieces[p, 2], pieces[p, 3], pieces[p, 4]
                    turn[0], turn[1] = -l21 / l11, 0.5 * (l11 * l11 + l21 * l21 - l22 * l22) / (l11 * l22)
                    call_kernel(address, m1, m2, s11, s12, s22, det, scratch_at, order, turn_at, found_at)
                    g1, g2 = l11 * found[0], l21 * found[0] + l22 * found[1]  # L times it: the ego frame
                    ahead += g1
                    left += g2
                    turned += found[2] + pieces[p, 0] * g2 - pieces[p, 1] * g1  # the piece's centre turns too
                out[b, t, k, 0] = cos * ahead - sin * left
                out[b, t, k, 1] = sin * ahead + cos * left
                out[b, t, k, 2] = turned
                total = ahead + left + turned
                unknown += total != total
    return unknown


@nb.njit(cache=True, error_model="numpy")
def marshall_olkin(m1, m2, s11, s12, s22, det, k11, k12):
    """Of 1 / (1 + d²): by the envelope theorem the nearest point u moves with the body, d(d²) = −2ν uᵀ dy."""
    if m1 * m1 + m2 * m2 <= 1.0:
        return 0.0, 0.0, 0.0
    big, small, v1, v2 = eigen(s11, s12, s22, det)
    if big == 0.0:
        return 0.0, 0.0, 0.0
    across, along, d2 = nearest(-v2 * m1 + v1 * m2, v1 * m1 + v2 * m2, small, big)
    nu = math.sqrt(d2 / (across * across * small + along * along * big))
    u1, u2 = v1 * along - v2 * across, v2 * along + v1 * across
    scale = 2.0 * nu / ((1.0 + d2) * (1.0 + d2))
    return scale * u1, scale * u2, -scale * (k11 * (u1 * u1 - u2 * u2) + 2.0 * k12 * u1 * u2)


@nb.njit(cache=True, error_model="numpy")
def chebyshev(m1, m2, c, n, k11, k12):
    """Of Var g / E[g²], g = |y|² − 1, from central moments c (n × n, row-major, to order 4); 0 where E g ≤ 0.

    With y = m + η: E g = |m|² − 1 + tr S, Var g = 4 mᵀS m + 4 mᵀτ + E|η|⁴ − (tr S)², τ = E[η |η|²]; turning maps
    m and η alike by K.
    """
    s11, s12, s22 = c[2 * n], c[n + 1], c[2]
    c30, c21, c12, c03 = c[3 * n], c[2 * n + 1], c[n + 2], c[3]
    c40, c31, c22, c13, c04 = c[4 * n], c[3 * n + 1], c[2 * n + 2], c[n + 3], c[4]
    trace = s11 + s22
    square = m1 * m1 + m2 * m2
    mean = (square - 1.0) + trace
    t1, t2 = c30 + c12, c21 + c03
    q1, q2 = s11 * m1 + s12 * m2, s12 * m1 + s22 * m2
    variance = 4.0 * (m1 * (q1 + t1) + m2 * (q2 + t2)) + (c40 + 2.0 * c22 + c04 - trace * trace)
    if mean <= 0.0 or variance <= 0.0:
        return 0.0, 0.0, 0.0
    k1, k2 = k11 * m1 + k12 * m2, k12 * m1 - k11 * m2  # K m
    turned = k11 * (s11 - s22) + 2.0 * k12 * s12  # E[ηᵀKη]
    cubic = m1 * (k11 * (c30 - c12) + 2.0 * k12 * c21) + m2 * (k11 * (c21 - c03) + 2.0 * k12 * c12)
    quartic = k11 * (c40 - c04) + 2.0 * k12 * (c31 + c13)
    mean_turn = 2.0 * (m1 * k1 + m2 * k2) + 2.0 * turned
    variance_turn = 16.0 * (q1 * k1 + q2 * k2) + 8.0 * (k1 * t1 + k2 * t2 + cubic) + 4.0 * (quartic - trace * turned)
    # V / (V + μ²) changes by (μ² dV − 2 V μ dμ) / (V + μ²)²
    total = variance + mean * mean
    by_variance, by_mean = mean / total * (mean / total), -2.0 * (variance / total) * (mean / total)
    g1 = by_variance * (8.0 * q1 + 4.0 * t1) + by_mean * 2.0 * m1
    g2 = by_variance * (8.0 * q2 + 4.0 * t2) + by_mean * 2.0 * m2
    return -g1, -g2, by_variance * variance_turn + by_mean * mean_turn


@nb.njit(cache=True, error_model="numpy")
def gaussian_moments(s11, s12, s22, c):
    """Fill c (5 × 5, row-major) with central moments of N(0, S) to order 4 (Isserlis 1918)."""
    c[:] = 0.0
    c[0], c[10], c[6], c[2] = 1.0, s11, s12, s22
    c[20], c[16], c[12], c[8], c[4] = (
        3 * s11 * s11,
        3 * s11 * s12,
        s11 * s22 + 2 * s12 * s12,
        3 * s12 * s22,
        3 * s22 * s22,
    )


@nb.njit(cache=True, error_model="numpy")
def disc(m1, m2, s11, s12, s22, det, k11, k12):
    """Of P(|y| ≤ 1), y ~ N(m, S): ∮ φ u dt without cancellation, and −∮ φ uᵀK u dt. A point mass has none: 0."""
    big, small, v1, v2 = eigen(s11, s12, s22, det)
    along, across = v1 * m1 + v2 * m2, -v2 * m1 + v1 * m2
    gap = math.sqrt(m1 * m1 + m2 * m2) - 1.0
    if gap > 0.0 and gap * gap > FAR * big:
        return 0.0, 0.0, 0.0
    g_along, g_across, cosine, sine = _rim(abs(along), abs(across), math.sqrt(big), math.sqrt(small))
    if along < 0.0:
        g_along, sine = -g_along, -sine
    if across < 0.0:
        g_across, sine = -g_across, -sine
    double_cos, double_sin = v1 * v1 - v2 * v2, 2.0 * v1 * v2
    c2, s2 = cosine * double_cos - sine * double_sin, cosine * double_sin + sine * double_cos
    return v1 * g_along - v2 * g_across, v2 * g_along + v1 * g_across, -(k11 * c2 + k12 * s2)


@nb.njit(cache=True, error_model="numpy")
def _rim(my, mx, sy, sx):
    """∮ φ (cos t, sin t, cos 2t, sin 2t) dt for a mean (my, mx) ≥ 0 and axes of deviations sy ≥ sx.

    The four points (± cos t, ± sin t) are taken together: with e = φ(cos t, sin t), the nearest of them, the others are
    e times e^−α, e^−β and e^−(α+β), α = 2 my cos t / sy², β = 2 mx sin t / sx². So the first, second and fourth
    integral over the quarter circle are sums of positive terms, with relative accuracy in the tails and for flat
    densities alike. In t the exponent has one minimum there (q + B/cos t = A/sin t has one root), the sum is even about
    both ends, and the trapezoid rule converges geometrically (Trefethen & Weideman 2014).
    """
    if sx < _POINT:
        return _chord(my, mx, sy)
    peak = _closest(my, mx, (sx / sy) ** 2, 1e-3 * sx)
    least = _exponent(peak, my, mx, sy, sx)
    if 2.0 * least > FAR:
        return 0.0, 0.0, 0.0, 0.0
    level = least + _CUT
    first = min(9.0 * sx / max(math.cos(peak), math.sqrt(sx)), 0.5)
    low = _edge(peak, 0.0, first, my, mx, sy, sx, level)
    high = _edge(peak, _QUARTER, first, my, mx, sy, sx, level)
    n = math.ceil(_NODES * _QUARTER / (high - low))
    h = _QUARTER / n
    # any grid serves a window inside the quarter; at an end it must be even about it
    origin = peak
    if low - h <= 0.0:
        origin = 0.0
    elif high + h >= _QUARTER:
        origin = _QUARTER
    total, more = np.zeros(5), np.empty(5)
    flat = ((1.0 + mx) / sx) ** 2 + ((1.0 + my) / sy) ** 2 < 1.0
    least = 0.0 if flat else least  # taken out of the sums, which then stay clear of denormal numbers
    _add(total, h, 0.0, origin, low, high, my, mx, sy, sx, least, flat)
    for _ in range(14):
        more[:] = 0.0
        _add(more, h, 0.5, origin, low, high, my, mx, sy, sx, least, flat)
        size, change = 0.0, 0.0
        for i in range(1, 5):
            size = max(size, abs(more[i] + total[i]))
            change = max(change, abs(more[i] - total[i]))
        total += more
        h *= 0.5
        if change <= _CHANGE * size + 1e-15 * total[0]:
            break
    scale = h * math.exp(-least) / (2.0 * math.pi * sx * sy)
    return total[1] * scale, total[2] * scale, total[3] * scale, total[4] * scale


@nb.njit(cache=True, error_model="numpy")
def _chord(my, mx, sy):
    """The same for a line, sx = 0: it meets the rim at two points."""
    if mx >= 1.0 or sy < _POINT:
        return 0.0, 0.0, 0.0, 0.0
    cos = math.sqrt((1.0 - mx) * (1.0 + mx))
    z = (cos - my) / sy
    here = math.exp(-0.5 * z * z) / (math.sqrt(2.0 * math.pi) * sy * cos)
    a = 2.0 * my * cos / (sy * sy)
    both, differ = 1.0 + math.exp(-a), -math.expm1(-a)
    return here * differ * cos, here * both * mx, here * both * (1.0 - 2.0 * mx * mx), here * differ * 2.0 * mx * cos


@nb.njit(inline="always", error_model="numpy")
def _exponent(t, my, mx, sy, sx):
    a, b = (math.sin(t) - mx) / sx, (math.cos(t) - my) / sy
    return 0.5 * (a * a + b * b)


@nb.njit(cache=True, error_model="numpy")
def _closest(my, mx, ratio, enough):
    """t in [0, π/2] where the rim's density is largest: the root of the exponent's derivative, by bracketed Newton."""
    low, high = 0.0, _QUARTER
    t = math.asin(min(mx / max(math.sqrt(mx * mx + my * my), 1.0), 1.0))
    for _ in range(80):
        sin, cos = math.sin(t), math.cos(t)
        value = (1.0 - ratio) * sin * cos - mx * cos + ratio * my * sin
        if value > 0.0:
            high = t
        else:
            low = t
        slope = (1.0 - ratio) * (cos * cos - sin * sin) + mx * sin + ratio * my * cos
        after = t - value / slope if slope > 0.0 else 0.5 * (low + high)
        if not low <= after <= high:
            after = 0.5 * (low + high)
        if abs(after - t) <= enough:
            break
        t = after
    return t


@nb.njit(cache=True, error_model="numpy")
def _edge(peak, limit, first, my, mx, sy, sx, level):
    """A t between `peak` and `limit` beyond which the density is negligible: within a factor 2 of the closest."""
    span = abs(limit - peak)
    side = 1.0 if limit > peak else -1.0
    step = min(first, span)
    if _exponent(peak + side * step, my, mx, sy, sx) > level:
        while step > 1e-300 and _exponent(peak + side * 0.5 * step, my, mx, sy, sx) > level:
            step *= 0.5
    else:
        while step < span and _exponent(peak + side * step, my, mx, sy, sx) <= level:
            step *= 2.0
    return limit if step >= span else peak + side * step


@nb.njit(cache=True, error_model="numpy")
def _add(total, h, shift, origin, low, high, my, mx, sy, sx, least, flat):
    """Add the integrands at t = origin + (k + shift) h in the window, halved at the ends of the quarter, to `total`.

    Offsets from the origin are kept apart, so that a narrow peak there loses no digits. Where the density is nearly
    flat, its deviation from a constant is what cos 2t is integrated with: the constant contributes nothing.
    """
    first = math.floor((low - origin) / h - shift)
    last = math.ceil((high - origin) / h - shift)
    s0, c0 = math.sin(origin), math.cos(origin)
    if origin == _QUARTER:
        c0 = 0.0
    miss_x, miss_y = s0 - mx, c0 - my
    for k in range(first, last + 1):
        offset = (k + shift) * h
        t = origin + offset
        if t < -1e-6 * h or t > _QUARTER + 1e-6 * h:
            continue
        half = math.sin(0.5 * offset)
        dc, ds = -2.0 * half * half, math.sin(offset)
        up, across = s0 * dc + c0 * ds, c0 * dc - s0 * ds  # sin t − sin origin, cos t − cos origin
        sin, cos = s0 + up, max(c0 + across, 0.0)
        a, b = (miss_x + up) / sx, (miss_y + across) / sy
        at_end = abs(t) <= 1e-6 * h or abs(t - _QUARTER) <= 1e-6 * h
        exponent, share = 0.5 * (a * a + b * b), 0.5 if at_end else 1.0
        value = share * math.exp(least - exponent)
        if value == 0.0:
            continue
        alpha, beta = 2.0 * my * cos / (sy * sy), 2.0 * mx * sin / (sx * sx)
        differ_y = -math.expm1(-alpha) if alpha < 40.0 else 1.0
        differ_x = -math.expm1(-beta) if beta < 40.0 else 1.0
        both_y, both_x = 2.0 - differ_y, 2.0 - differ_x
        total[0] += value * both_y * both_x
        total[1] += value * differ_y * both_x * cos
        total[2] += value * both_y * differ_x * sin
        around = value * both_y * both_x
        if flat:
            around = 4.0 * share * math.expm1(math.log1p(-0.5 * differ_y) + math.log1p(-0.5 * differ_x) - exponent)
        total[3] += around * (cos - sin) * (cos + sin)
        total[4] += value * differ_y * differ_x * 2.0 * sin * cos
