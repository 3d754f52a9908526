"""Dubins curves (Dubins 1957; words and formulas of Shkel & Lumelsky 2001)."""

import math

import numba as nb
import numpy as np

from riskplan.kernels.car import wrap

# turn of each segment: +1 left, −1 right, 0 straight
_WORDS = np.array([[1, 0, 1], [-1, 0, -1], [1, 0, -1], [-1, 0, 1], [-1, 1, -1], [1, -1, 1]])


@nb.njit(inline="always", error_model="numpy")
def _mod(angle):
    value = angle % (2.0 * math.pi)
    # a full turn that is rounding of none
    return 0.0 if value > 2.0 * math.pi - 1e-9 else value


@nb.njit(cache=True, error_model="numpy")
def shortest(x0, y0, h0, x1, y1, h1, radius, out):
    """Length of the shortest curve; out[0:3] segment lengths [m], out[3:6] their curvatures [1/m]."""
    dx, dy = x1 - x0, y1 - y0
    d = math.hypot(dx, dy) / radius
    theta = math.atan2(dy, dx)
    a, b = _mod(h0 - theta), _mod(h1 - theta)
    sa, sb, ca, cb = math.sin(a), math.sin(b), math.cos(a), math.cos(b)
    cab = math.cos(a - b)
    best = np.inf
    for word in range(6):
        t = p = q = -1.0
        if word == 0:
            squared = 2.0 + d * d - 2.0 * cab + 2.0 * d * (sa - sb)
            if squared >= 0.0:
                angle = math.atan2(cb - ca, d + sa - sb)
                t, p, q = _mod(angle - a), math.sqrt(squared), _mod(b - angle)
        elif word == 1:
            squared = 2.0 + d * d - 2.0 * cab + 2.0 * d * (sb - sa)
            if squared >= 0.0:
                angle = math.atan2(ca - cb, d - sa + sb)
                t, p, q = _mod(a - angle), math.sqrt(squared), _mod(angle - b)
        elif word == 2:
            squared = d * d - 2.0 + 2.0 * cab + 2.0 * d * (sa + sb)
            if squared >= 0.0:
                p = math.sqrt(squared)
                angle = math.atan2(-ca - cb, d + sa + sb) - math.atan2(-2.0, p)
                t, q = _mod(angle - a), _mod(angle - b)
        elif word == 3:
            squared = d * d - 2.0 + 2.0 * cab - 2.0 * d * (sa + sb)
            if squared >= 0.0:
                p = math.sqrt(squared)
                angle = math.atan2(ca + cb, d - sa - sb) - math.atan2(2.0, p)
                t, q = _mod(a - angle), _mod(b - angle)
        elif word == 4:
            cosine = (6.0 - d * d + 2.0 * cab + 2.0 * d * (sa - sb)) / 8.0
            if abs(cosine) <= 1.0:
                p = _mod(2.0 * math.pi - math.acos(cosine))
                t = _mod(a - math.atan2(ca - cb, d - sa + sb) + 0.5 * p)
                q = _mod(a - b - t + p)
        else:
            cosine = (6.0 - d * d + 2.0 * cab + 2.0 * d * (sb - sa)) / 8.0
            if abs(cosine) <= 1.0:
                p = _mod(2.0 * math.pi - math.acos(cosine))
                t = _mod(-a + math.atan2(-ca + cb, d + sa - sb) + 0.5 * p)
                q = _mod(b - a - t + p)
        if t >= 0.0 and t + p + q < best:
            best = t + p + q
            out[0], out[1], out[2] = t * radius, p * radius, q * radius
            for i in range(3):
                out[3 + i] = _WORDS[word, i] / radius
    return best * radius


@nb.njit(cache=True, error_model="numpy")
def biarc(x0, y0, h0, x1, y1, h1, out):
    """Two arcs that join the poses smoothly, their tangents of equal length (Bolton 1975); the length, or infinity.

    out (6,) as of `shortest`, without a straight part.
    """
    c0, s0, c1, s1 = math.cos(h0), math.sin(h0), math.cos(h1), math.sin(h1)
    vx, vy = x1 - x0, y1 - y0
    squared, forward = vx * vx + vy * vy, vx * (c0 + c1) + vy * (s0 + s1)
    bend = 2.0 * (1.0 - (c0 * c1 + s0 * s1))
    under = forward + math.sqrt(forward * forward + bend * squared)
    if not under > 0.0:
        return np.inf
    d = squared / under
    mx, my = 0.5 * (x0 + x1 + d * (c0 - c1)), 0.5 * (y0 + y1 + d * (s0 - s1))
    ax, ay, bx, by = mx - x0, my - y0, x1 - mx, y1 - my
    first = math.atan2(c0 * ay - s0 * ax, c0 * ax + s0 * ay)
    second = math.atan2(bx * s1 - by * c1, bx * c1 + by * s1)
    if max(abs(first), abs(second)) > 1.5:
        return np.inf
    out[0], out[1], out[2], out[4] = (
        _arc_over(math.hypot(ax, ay), first),
        0.0,
        _arc_over(math.hypot(bx, by), second),
        0.0,
    )
    out[3], out[5] = 2.0 * first / max(out[0], 1e-12), 2.0 * second / max(out[2], 1e-12)
    return out[0] + out[2]


@nb.njit(inline="always", error_model="numpy")
def _arc_over(chord, half):
    """Length of an arc over a chord that turns by twice `half`."""
    return chord * (half / math.sin(half) if abs(half) > 1e-8 else 1.0)


@nb.njit(cache=True, error_model="numpy")
def along(x, y, heading, curve, s):
    """Pose at arclength s of the curve (6,) from `shortest` that starts at (x, y, heading)."""
    for i in range(3):
        length = curve[i] if i < 2 else s
        part = min(s, length)
        turn = part * curve[3 + i]
        half = 0.5 * turn
        chord = part * (math.sin(half) / half if abs(half) > 1e-8 else 1.0)
        x += chord * math.cos(heading + half)
        y += chord * math.sin(heading + half)
        heading += turn
        s -= part
        if s <= 0.0:
            break
    return x, y, wrap(heading)
