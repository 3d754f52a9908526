"""P(N(0, I) hits any of many convex sets in the plane): an exact polar sweep.

A ray from the origin meets a convex set in one interval, so the union's mass is
    P = (1/2π) ∫ Σ_spans (e^(−l²/2) − e^(−h²/2)) dφ,
with all terms positive. The integrand is analytic between breakpoints: rays tangent to the union (square-root ends,
removed by a substitution), and kinks where another set or edge takes over the union's rim. Panels are looked at by a
few rays: where all find the same ends of spans, Gauss–Kronrod (3, 7) of these alone; else Simpson's rule, until its
error is small or the kinks between the rays are found. Globally adaptive, the panels that err most first.
"""

import math
from collections import namedtuple

import numba as nb
import numpy as np

from checkers.kernels.rays import KEPT, cast, expose, mass, name_of
from checkers.kernels.regions import DISTANCE, FEATURES, FULL_CIRCLE, ROW, SHAKE, end_radius
from checkers.kernels.sectors import LEFT, RIGHT, cut_circle

_WIDEST = 0.4  # rad, of a first panel
_NARROW = 0.1  # rad, of a panel that three rays suffice to know
_EDGE = 5e-5  # of a sector's width: where its end rays are, beside tangents and corners

# the Kronrod (1965) extension of the 3-node Gauss rule on [−1, 1]
_NODES = np.array([0.9604912687080202, 0.7745966692414834, 0.4342437493468026])
_NODES = np.array([*-_NODES, 0.0, *_NODES[::-1]])
_KRONROD = np.array([0.1046562260264673, 0.2684880898683334, 0.4013974147759622])
_KRONROD = np.array([*_KRONROD, 0.4509165386584741, *_KRONROD[::-1]])
# what a smooth integrand leaves over: Kronrod minus Gauss, and the odd null rule of the same norm (Laurie 1985),
# without which the difference of the two rules is now and then small by accident
_EVEN = _KRONROD - np.array([0.0, 5 / 9, 0.0, 8 / 9, 0.0, 5 / 9, 0.0])
_ODD = np.array([-0.198417263, 0.438915142, -0.34405598, 0.0, 0.34405598, -0.438915142, 0.198417263])

# rows, features, step: the sets. enter, leave, spans, ends: of one ray. events: angle, flag. sectors: between events:
# start, width, flag. panels: sector, s₀, s₁, value, error, smooth; corners: their five rays, −1 where there is none.
# values, names: of each ray: integrand, number of spans and names of their ends. used: number of rays.
Work = namedtuple(
    "Work", "rows features step enter leave spans ends events sectors panels corners values names used cuts"
)


@nb.njit(cache=True)
def workspace(count):
    """Room for `count` sets, to be used again for any number of sweeps."""
    events = 12 * count + 42
    panels = 3 * events + 400
    return Work(
        np.empty((ROW, count)),
        np.empty((count, FEATURES)),
        np.empty(count, np.int64),
        np.empty(count),
        np.empty(count),
        np.empty((count + 1, 2)),
        np.empty((count + 1, 2), np.int64),
        np.empty((events, 2)),
        np.empty((events, 3)),
        np.empty((panels, 6)),
        np.empty((panels, 5), np.int64),
        np.empty(5 * panels + 16),
        np.empty((5 * panels + 16, 1 + 2 * KEPT), np.int64),
        np.zeros(1, np.int64),
        np.empty(64),
    )


@nb.njit(cache=True, error_model="numpy")
def sweep(kind, work, count, pieces, tolerance, exposure):
    """(P, absolute error) for the union of the first `count` sets of `work`, whose rows and features are filled.

    Args:
        pieces: sets per step, in order of the steps.
        tolerance: relative, aimed at.
        exposure: (T,) gets the probability that the first hit is at each step; they sum to P. Skipped if empty.
    """
    nearest = np.inf
    for i in range(count):
        nearest = min(nearest, work.features[i, DISTANCE])
    if nearest > 37.3:  # P < count × Φ(−37.3) = 9e-305: the integrand would be of denormal numbers
        exposure[:] = 0.0
        return 0.0, (count * 1e-304 if nearest < np.inf else 0.0)
    count = _keep_near(work, count, pieces, nearest * nearest + 2.0 * math.log(1.0 / tolerance) + 20.0)
    fine = tolerance < 1e-6
    work.used[0] = 0
    n = _first_panels(kind, work, count, cut_circle(kind, work, count, fine))
    total, error = _sums(work, n)
    room = len(work.panels) - len(work.cuts)
    while error > 0.5 * tolerance * total and n < room:
        share = 0.5 * tolerance * total / n
        for k in range(n):
            if work.panels[k, 4] > share and n < room and work.used[0] < len(work.values) - 6 * len(work.cuts):
                n = _refine(kind, work, count, k, n, fine)
        total, error = _sums(work, n)
        if work.used[0] >= len(work.values) - 6 * len(work.cuts):
            break
    if len(exposure):
        _expose_all(kind, work, count, n, exposure)
    return min(total, 1.0), max(error, tolerance * total) + total * (1e-13 + 4e-16 * _shake(work, count, nearest))


@nb.njit(inline="always", error_model="numpy")
def _keep_near(work, count, pieces, farthest):
    """Move the sets of which a point is nearer than √farthest to the front; return how many."""
    n = 0
    for i in range(count):
        distance = work.features[i, DISTANCE]
        if distance * distance < farthest:
            work.step[n] = i // pieces
            if n < i:
                work.rows[:, n] = work.rows[:, i]
                work.features[n] = work.features[i]
            n += 1
    return n


@nb.njit(inline="always", error_model="numpy")
def _sums(work, n):
    total, error = 0.0, 0.0
    for k in range(n):
        total, error = total + work.panels[k, 3], error + work.panels[k, 4]
    return total, error


@nb.njit(inline="always", error_model="numpy")
def _shake(work, count, nearest):
    """How strongly rounding of rows and angles moves the integrand, over the sets that matter."""
    shake = 0.0
    for i in range(count):
        distance = work.features[i, DISTANCE]
        if distance * distance < nearest * nearest + 40.0:
            shake = max(shake, work.features[i, SHAKE])
    return shake


@nb.njit(inline="always", error_model="numpy")
def _direction(sector, s):
    """(angle, dangle/ds) at s in [0, 1]: quadratic at a tangent ray, where the integrand grows like a square root."""
    start, width, flag = sector[0], sector[1], int(sector[2])
    if flag == LEFT:
        return start + width * s * s, 2.0 * width * s
    if flag == RIGHT:
        return start + width * s * (2.0 - s), 2.0 * width * (1.0 - s)
    if flag == LEFT | RIGHT:
        return start + width * s * s * (3.0 - 2.0 * s), 6.0 * width * s * (1.0 - s)
    return start + width * s, width


@nb.njit(cache=True, error_model="numpy")
def _first_panels(kind, work, count, sectors):
    """Panels of every sector, none wider than _WIDEST; return how many."""
    n = 0
    for k in range(sectors):
        parts = int(math.ceil(work.sectors[k, 1] / _WIDEST))
        left = _ray(kind, work, count, k, _EDGE)
        for i in range(parts):
            right = _ray(kind, work, count, k, min((i + 1) / parts, 1.0 - _EDGE))
            _measure(kind, work, count, n, k, i / parts, (i + 1) / parts, left, -1, right)
            n, left = n + 1, right
    return n


@nb.njit(cache=True, error_model="numpy")
def _ray(kind, work, count, sector, s):
    """Look along one ray: its integrand over s and the names of its spans' ends; returns its number."""
    angle, slope = _direction(work.sectors[sector], s)
    ux, uy = math.cos(angle), math.sin(angle)
    n, r, spans, ends = cast(kind, work, count, ux, uy), work.used[0], work.spans, work.ends
    names, value = work.names[r], 0.0
    for i in range(n):
        value += mass(spans[i, 0], spans[i, 1])
    names[0] = n
    for i in range(min(n, KEPT)):
        names[1 + 2 * i] = name_of(kind, work.rows, ends[i, 0], ux, uy, spans[i, 0], False)
        names[2 + 2 * i] = name_of(kind, work.rows, ends[i, 1], ux, uy, spans[i, 1], True)
    work.values[r] = slope * value
    work.used[0] = r + 1
    return r


@nb.njit(inline="always", error_model="numpy")
def _alike(names, a, b):
    """Whether rays a and b find the same ends."""
    for i in range(1 + 2 * min(names[a, 0], KEPT)):
        if names[a, i] != names[b, i]:
            return False
    return True


@nb.njit(cache=True, error_model="numpy")
def _measure(kind, work, count, k, sector, low, high, left, centre, right):
    """Make panel k of [low, high] in a sector, whose rays at the ends, and in the middle if not −1, are known."""
    corners, names, panel = work.corners[k], work.names, work.panels[k]
    if centre < 0:
        centre = _ray(kind, work, count, sector, 0.5 * (low + high))
    corners[0], corners[1], corners[2], corners[3], corners[4] = left, -1, centre, -1, right
    panel[0], panel[1], panel[2] = sector, low, high
    smooth = _alike(names, left, centre) and _alike(names, centre, right)
    wide = _direction(work.sectors[sector], high)[0] - _direction(work.sectors[sector], low)[0] > _NARROW
    if wide or not smooth:
        corners[1] = _ray(kind, work, count, sector, 0.75 * low + 0.25 * high)
        corners[3] = _ray(kind, work, count, sector, 0.25 * low + 0.75 * high)
        smooth = smooth and _alike(names, centre, corners[1]) and _alike(names, centre, corners[3])
    panel[5] = smooth
    scale = (high - low) / FULL_CIRCLE
    if smooth:
        value, error = _smooth(kind, work, count, sector, low, high, centre)
    else:
        f = work.values
        ends, middle, quarters = f[left] + f[right], f[centre], f[corners[1]] + f[corners[3]]
        value = (ends + 2.0 * middle + 4.0 * quarters) / 12.0
        error = abs(value - (ends + 4.0 * middle) / 6.0)
    panel[3], panel[4] = value * scale, error * scale


@nb.njit(inline="always", error_model="numpy")
def _smooth(kind, work, count, sector, low, high, ray):
    """(mean, its error) of the integrand over [low, high], where all rays find the ends that `ray` does."""
    middle, half, names = 0.5 * (low + high), 0.5 * (high - low), work.names[ray]
    value, even, odd = 0.0, 0.0, 0.0
    for j in range(7):
        angle, slope = _direction(work.sectors[sector], middle + half * _NODES[j])
        ux, uy = math.cos(angle), math.sin(angle)
        f = 0.0
        if names[0] <= KEPT:
            for i in range(names[0]):
                enter = end_radius(kind, work.rows, names[1 + 2 * i], False, ux, uy)
                leave = end_radius(kind, work.rows, names[2 + 2 * i], True, ux, uy)
                if enter < leave:
                    f += mass(enter, leave)
        else:
            for i in range(cast(kind, work, count, ux, uy)):
                f += mass(work.spans[i, 0], work.spans[i, 1])
        value += 0.5 * _KRONROD[j] * slope * f
        even += 0.5 * _EVEN[j] * slope * f
        odd += 0.5 * _ODD[j] * slope * f
    change = math.hypot(even, odd)
    if value > 0.0:  # the null rules have half the order
        change *= min(1.0, 5.0 * math.sqrt(change / value))
    return value, change


@nb.njit(cache=True, error_model="numpy")
def _refine(kind, work, count, k, n, fine):
    """Replace panel k by its parts, between kinks if they are looked for and found, else halves; return the new n."""
    sector, low, high = int(work.panels[k, 0]), work.panels[k, 1], work.panels[k, 2]
    left, before, centre, behind, right = work.corners[k]
    cuts, beside = 0, 1e-6 * (high - low)
    if fine and not work.panels[k, 5]:
        width = 0.25 * (high - low)
        for j in range(4):
            a, b = work.corners[k, j], work.corners[k, j + 1]
            cuts = _kinks(kind, work, count, a, b, sector, low + j * width, low + (j + 1) * width, cuts)
        cuts = _apart_by(work.cuts, cuts, low, high, 2.0 * beside)
    if cuts == 0:
        middle = 0.5 * (low + high)
        _measure(kind, work, count, n, sector, low, middle, left, before, centre)
        _measure(kind, work, count, k, sector, middle, high, centre, behind, right)
        return n + 1
    start = low
    for j in range(cuts):
        cut = work.cuts[j]
        _measure(kind, work, count, n, sector, start, cut, left, -1, _ray(kind, work, count, sector, cut - beside))
        start, left, n = cut, _ray(kind, work, count, sector, cut + beside), n + 1
    _measure(kind, work, count, k, sector, start, high, left, -1, right)
    return n


@nb.njit(inline="always", error_model="numpy")
def _apart_by(cuts, count, low, high, least):
    """Drop the cuts that are too near to their left neighbour or to `high`; return how many are left."""
    kept = 0
    for j in range(count):
        if cuts[j] - low > least and high - cuts[j] > least:
            cuts[kept], low, kept = cuts[j], cuts[j], kept + 1
    return kept


@nb.njit(inline="always", error_model="numpy")
def _difference(a, b):
    """First place where span ends carry different names: (end, leaving) in each, and the place; −1 if unclear.

    Where a gap closes, the ends are the two sides of the gap.
    """
    for i in range(min(a[0], b[0], KEPT)):
        if a[1 + 2 * i] != b[1 + 2 * i]:
            return (a[1 + 2 * i], False, b[1 + 2 * i], False, i) if a[0] == b[0] else (-1, False, -1, False, -1)
        if a[2 + 2 * i] != b[2 + 2 * i]:
            if a[0] == b[0]:
                return a[2 + 2 * i], True, b[2 + 2 * i], True, i
            more = a if a[0] > b[0] else b
            return (more[2 + 2 * i], True, more[3 + 2 * i], False, -1) if i + 1 < KEPT else (-1, False, -1, False, -1)
    return -1, False, -1, False, -1


@nb.njit(cache=True, error_model="numpy")
def _kinks(kind, work, count, ray, other, sector, left, right, found):
    """Append to `cuts` the places between two rays where the rim passes from one set or edge to another.

    At the crossing of two curves a third may be outermost: then it lies between them, and both its crossings are cuts.
    """
    a, a_leaving, last, leaving, place = _difference(work.names[ray], work.names[other])
    while a >= 0 and found < len(work.cuts):
        b, x = last, right
        for _ in range(8):
            x = _crossing(kind, work.rows, work.sectors[sector], a, a_leaving, b, leaving, left, x)
            if x != x:
                return found
            if place < 0:
                break
            angle, _ = _direction(work.sectors[sector], x)
            ux, uy = math.cos(angle), math.sin(angle)
            if not place < cast(kind, work, count, ux, uy):
                break
            at = int(leaving)
            radius = work.spans[place, at]
            outer = name_of(kind, work.rows, work.ends[place, at], ux, uy, radius, leaving)
            if outer < 0 or outer in {a, b}:
                break
            b = outer
        work.cuts[found], found = x, found + 1
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


@nb.njit(inline="always", error_model="numpy")
def _apart(kind, rows, sector, a, a_leaving, b, b_leaving, s):
    angle, _ = _direction(sector, s)
    ux, uy = math.cos(angle), math.sin(angle)
    return end_radius(kind, rows, a, a_leaving, ux, uy) - end_radius(kind, rows, b, b_leaving, ux, uy)


@nb.njit(cache=True, error_model="numpy")
def _expose_all(kind, work, count, n, exposure):
    """Exposure of every step, by two rays in each of the final panels and scaled so that it sums to the total."""
    exposure[:] = 0.0
    fresh = np.zeros(len(exposure))
    for k in range(n):
        sector, low, high = int(work.panels[k, 0]), work.panels[k, 1], work.panels[k, 2]
        fresh[:] = 0.0
        for node in (0.21132486540518713, 0.7886751345948129):
            angle, slope = _direction(work.sectors[sector], low + (high - low) * node)
            expose(kind, work, count, math.cos(angle), math.sin(angle), slope, fresh)
        total = fresh.sum()
        if total > 0.0:
            exposure += fresh * (work.panels[k, 3] / total)
