"""Panels of the sweep's integrand: looked at by a few rays, integrated, and cut where the rim has kinks.

All functions read `rows` (ROW, N), the sets, and write `spans` (4, N) and `ends` (4, N), see `rays`; a sector is
(start, width, flag). `rays` (M, RAY) holds of each ray its integrand, how many spans, and the names of their ends.
`panels` (P, PANEL) holds sector, s₀, s₁, value, error, state, and the numbers of five rays, −1 where there is none.
"""

import math

import numba as nb
import numpy as np

from checkers.kernels.rays import FROM, KEPT, UNTIL, cast, mass, name_of
from checkers.kernels.regions import FULL_CIRCLE, OCTAGON, ellipse_chord, end_radius
from checkers.kernels.sectors import LEFT, RIGHT

RAY, PANEL = 2 + 2 * KEPT, 11
VALUE, SPANS, NAMES = range(3)  # of a ray
SECTOR, LOW, HIGH, MASS, ERROR, STATE, CORNERS = range(7)  # of a panel
KINKED, LIKELY_SMOOTH, DONE = range(3)  # its rays find different ends; the same ones; and it was integrated by them
_SQRT7 = math.sqrt(7.0)
_NARROW = 0.1  # rad, of a panel that three rays suffice to know

# the Kronrod (1965) extension of the 3-node Gauss rule on [−1, 1]
_NODES = np.array([0.9604912687080202, 0.7745966692414834, 0.4342437493468026])
_NODES = np.array([*-_NODES, 0.0, *_NODES[::-1]])
_KRONROD = np.array([0.1046562260264673, 0.2684880898683334, 0.4013974147759622])
_KRONROD = np.array([*_KRONROD, 0.4509165386584741, *_KRONROD[::-1]])
# what a smooth integrand leaves over: Kronrod minus Gauss, and the odd null rule of the same norm (Laurie 1985),
# without which the difference of the two rules is now and then small by accident
_EVEN = _KRONROD - np.array([0.0, 5 / 9, 0.0, 8 / 9, 0.0, 5 / 9, 0.0])
_ODD = np.array([-0.198417263, 0.438915142, -0.34405598, 0.0, 0.34405598, -0.438915142, 0.198417263])


@nb.njit(cache=True, error_model="numpy")
def direction(start, width, flag, s):
    """(angle, dangle/ds) at s in [0, 1]: quadratic at a tangent ray, where the integrand grows like a square root."""
    if flag == LEFT:
        return start + width * s * s, 2.0 * width * s
    if flag == RIGHT:
        return start + width * s * (2.0 - s), 2.0 * width * (1.0 - s)
    if flag == LEFT | RIGHT:
        return start + width * s * s * (3.0 - 2.0 * s), 6.0 * width * s * (1.0 - s)
    return start + width * s, width


@nb.njit(cache=True, error_model="numpy")
def look(kind, rows, spans, ends, count, rays, r, angle, slope):
    """Look along one ray and write it down as number r."""
    ux, uy = math.cos(angle), math.sin(angle)
    n, value = cast(kind, rows, spans, ends, count, ux, uy), 0.0
    for i in range(n):
        value += mass(spans[FROM, i], spans[UNTIL, i])
    rays[r, VALUE], rays[r, SPANS] = slope * value, n
    for i in range(min(n, KEPT)):
        rays[r, NAMES + 2 * i] = name_of(kind, rows, ends[0, i], ux, uy, spans[FROM, i], False)
        rays[r, NAMES + 1 + 2 * i] = name_of(kind, rows, ends[1, i], ux, uy, spans[UNTIL, i], True)


@nb.njit(cache=True, error_model="numpy")
def _alike(rays, a, b):
    """Whether rays a and b find the same ends."""
    alike = rays[a, SPANS] == rays[b, SPANS]
    for i in range(NAMES, NAMES + 2 * min(int(rays[a, SPANS]), KEPT)):
        alike = alike and rays[a, i] == rays[b, i]
    return alike


@nb.njit(cache=True, error_model="numpy")
def measure(kind, rows, spans, ends, count, rays, used, panel, sector, bounds, left, centre, right):
    """Fill `panel` (PANEL,) of s from `bounds` in a sector, of whose rays those at the ends, and in the middle if not
    −1, are known; returns how many rays there are then.
    """
    start, width, flag = sector
    low, high = bounds
    if centre < 0:
        centre, used = used, used + 1
        angle, slope = direction(start, width, flag, 0.5 * (low + high))
        look(kind, rows, spans, ends, count, rays, centre, angle, slope)
    before, behind = -1, -1
    smooth = _alike(rays, left, centre) and _alike(rays, centre, right)
    wide = direction(start, width, flag, high)[0] - direction(start, width, flag, low)[0] > _NARROW
    if wide or not smooth:
        before, behind, used = used, used + 1, used + 2
        angle, slope = direction(start, width, flag, 0.75 * low + 0.25 * high)
        look(kind, rows, spans, ends, count, rays, before, angle, slope)
        angle, slope = direction(start, width, flag, 0.25 * low + 0.75 * high)
        look(kind, rows, spans, ends, count, rays, behind, angle, slope)
        smooth = smooth and _alike(rays, centre, before) and _alike(rays, centre, behind)
    if smooth and before < 0:
        state, (value, error) = DONE, _smooth(kind, rows, spans, ends, count, rays, sector, bounds, centre)
    else:
        state = LIKELY_SMOOTH if smooth else KINKED
        f0, f1, f2, f3, f4 = (
            rays[left, VALUE],
            rays[before, VALUE],
            rays[centre, VALUE],
            rays[behind, VALUE],
            rays[right, VALUE],
        )
        value = (f0 + 4.0 * f1 + 2.0 * f2 + 4.0 * f3 + f4) / 12.0
        # its difference from the coarser rule, and the odd null rule of the same norm: one of them may vanish at a kink
        even, odd = f0 - 4.0 * f1 + 6.0 * f2 - 4.0 * f3 + f4, _SQRT7 * (f4 - 2.0 * f3 + 2.0 * f1 - f0)
        error = math.hypot(even, odd) / 24.0
    scale = (high - low) / FULL_CIRCLE
    panel[LOW], panel[HIGH], panel[MASS], panel[ERROR], panel[STATE] = low, high, value * scale, error * scale, state
    panel[CORNERS], panel[CORNERS + 1], panel[CORNERS + 2] = left, before, centre
    panel[CORNERS + 3], panel[CORNERS + 4] = behind, right
    return used


@nb.njit(cache=True, error_model="numpy")
def integrate(kind, rows, spans, ends, count, rays, panel, sector):
    """Replace Simpson's rule in a panel whose rays find the same ends."""
    bounds = (panel[LOW], panel[HIGH])
    value, error = _smooth(kind, rows, spans, ends, count, rays, sector, bounds, int(panel[CORNERS + 2]))
    scale = (bounds[1] - bounds[0]) / FULL_CIRCLE
    panel[MASS], panel[ERROR], panel[STATE] = value * scale, error * scale, DONE


@nb.njit(cache=True, error_model="numpy")
def _smooth(kind, rows, spans, ends, count, rays, sector, bounds, ray):
    """(mean, its error) of the integrand over the bounds, where all rays find the ends that `ray` does."""
    start, width, flag = sector
    middle, half, known = 0.5 * (bounds[0] + bounds[1]), 0.5 * (bounds[1] - bounds[0]), int(rays[ray, SPANS])
    value, even, odd = 0.0, 0.0, 0.0
    for j in range(7):
        angle, slope = direction(start, width, flag, middle + half * _NODES[j])
        ux, uy = math.cos(angle), math.sin(angle)
        f = 0.0
        if known <= KEPT:
            for i in range(known):
                enter = end_radius(kind, rows, int(rays[ray, NAMES + 2 * i]), False, ux, uy)
                leave = end_radius(kind, rows, int(rays[ray, NAMES + 1 + 2 * i]), True, ux, uy)
                if enter < leave:
                    f += mass(enter, leave)
        else:
            for i in range(cast(kind, rows, spans, ends, count, ux, uy)):
                f += mass(spans[FROM, i], spans[UNTIL, i])
        value += 0.5 * _KRONROD[j] * slope * f
        even += 0.5 * _EVEN[j] * slope * f
        odd += 0.5 * _ODD[j] * slope * f
    change = math.hypot(even, odd)
    if value > 0.0:  # the null rules have half the order
        change *= min(1.0, 5.0 * math.sqrt(change / value))
    return value, change


@nb.njit(cache=True, error_model="numpy")
def _difference(a, b):
    """First place where span ends carry different names: (end, leaving) in each, and the place; −1 if unclear.

    Where a gap closes, the ends are the two sides of the gap.
    """
    for i in range(min(int(a[SPANS]), int(b[SPANS]), KEPT)):
        at = NAMES + 2 * i
        if a[at] != b[at]:
            return (a[at], False, b[at], False, i) if a[SPANS] == b[SPANS] else (-1.0, False, -1.0, False, -1)
        if a[at + 1] != b[at + 1]:
            if a[SPANS] == b[SPANS]:
                return a[at + 1], True, b[at + 1], True, i
            more = a if a[SPANS] > b[SPANS] else b
            return (more[at + 1], True, more[at + 2], False, -1) if i + 1 < KEPT else (-1.0, False, -1.0, False, -1)
    return -1.0, False, -1.0, False, -1


@nb.njit(cache=True, error_model="numpy")
def kinks(kind, rows, spans, ends, count, ray, other, sector, left, right, cuts, found):
    """Append to `cuts` the places between two rays (RAY,) where the rim passes from one set or edge to another.

    At the crossing of two curves a third may be outermost: then it lies between them, and both its crossings are cuts.
    Returns how many cuts there are then.
    """
    start, width, flag = sector
    a, a_leaving, last, leaving, place = _difference(ray, other)
    while a >= 0 and found < len(cuts):
        b, x = last, right
        for _ in range(8):
            x = _crossing(kind, rows, sector, int(a), a_leaving, int(b), leaving, left, x)
            if x != x:
                return found
            if place < 0:
                break
            angle, _ = direction(start, width, flag, x)
            ux, uy = math.cos(angle), math.sin(angle)
            if not place < cast(kind, rows, spans, ends, count, ux, uy):
                break
            radius = spans[UNTIL if leaving else FROM, place]
            outer = name_of(kind, rows, ends[int(leaving), place], ux, uy, radius, leaving)
            if outer < 0 or outer in {a, b}:
                break
            b = float(outer)
        cuts[found], found = x, found + 1
        if b == last:
            return found
        a, left = b, x
    return found


@nb.njit(cache=True, error_model="numpy")
def _crossing(kind, rows, sector, a, a_leaving, b, b_leaving, low, high):
    """Place in (low, high) where the two ends have the same radius (Illinois), or NaN if they do not cross."""
    f_low = _apart(kind, rows, sector, a, a_leaving, b, b_leaving, low)
    f_high = _apart(kind, rows, sector, a, a_leaving, b, b_leaving, high)
    if not f_low * f_high < 0.0:
        return np.nan
    width, x = high - low, 0.5 * (low + high)
    for _ in range(20):
        before, x = x, (low * f_high - high * f_low) / (f_high - f_low)
        if abs(x - before) < 1e-7 * width:
            break
        f = _apart(kind, rows, sector, a, a_leaving, b, b_leaving, x)
        if f * f_high < 0.0:
            low, f_low = high, f_high
        else:
            f_low *= 0.5
        high, f_high = x, f
        if f == 0.0 or f != f:
            break
    return x


@nb.njit(cache=True, error_model="numpy")
def _apart(kind, rows, sector, a, a_leaving, b, b_leaving, s):
    angle, _ = direction(sector[0], sector[1], sector[2], s)
    ux, uy = math.cos(angle), math.sin(angle)
    return end_radius(kind, rows, a, a_leaving, ux, uy) - end_radius(kind, rows, b, b_leaving, ux, uy)


@nb.njit(cache=True, error_model="numpy")
def poke(kind, rows, count, rays, sector, bounds, ray):
    """Where in the bounds another ellipse may reach over the ends that `ray` finds, or NaN.

    How far it stays behind such an end is a parabola, nearly: least where that has its vertex.
    """
    if kind == OCTAGON or rays[ray, SPANS] != 1:
        return np.nan
    low, high = bounds
    half, best, at = 0.5 * (high - low), 0.0, np.nan
    ends, others, unit = np.zeros((2, 3)), np.empty((2, 3)), np.empty((3, 2))
    for i in range(3):
        angle, _ = direction(sector[0], sector[1], sector[2], low + i * half)
        unit[i, 0], unit[i, 1] = math.cos(angle), math.sin(angle)
    names = (int(rays[ray, NAMES]), int(rays[ray, NAMES + 1]))  # negative for no end
    for leaving in range(2):
        if names[leaving] >= 0:
            _chords(rows, names[leaving] >> 3, unit, others)
            ends[leaving] = others[leaving]
    for j in range(count):
        _chords(rows, j, unit, others)
        for leaving in range(2):
            if names[leaving] < 0 or j == names[leaving] >> 3:
                continue
            side = -1.0 if leaving else 1.0
            g0 = side * (others[leaving, 0] - ends[leaving, 0])
            g1 = side * (others[leaving, 1] - ends[leaving, 1])
            g2 = side * (others[leaving, 2] - ends[leaving, 2])
            bend, tilt = 0.5 * (g0 + g2) - g1, 0.5 * (g2 - g0)
            if bend > 0.0 and abs(tilt) < 2.0 * bend and g1 - 0.25 * tilt * tilt / bend < best:
                best, at = g1 - 0.25 * tilt * tilt / bend, low + half * (1.0 - 0.5 * tilt / bend)
    return at


@nb.njit(inline="always", error_model="numpy")
def _chords(rows, j, unit, out):
    """Where three rays enter and leave an ellipse: fills out (2, 3)."""
    for i in range(3):
        out[0, i], out[1, i] = ellipse_chord(rows, j, unit[i, 0], unit[i, 1])
