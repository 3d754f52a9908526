"""P(N(0, I) hits any of many convex sets in the plane): an exact polar sweep.

A ray from the origin meets a convex set in one interval, so the union's mass is
    P = (1/2π) ∫ Σ_spans (e^(−l²/2) − e^(−h²/2)) dφ,
with all terms positive. The integrand is analytic between breakpoints: rays tangent to the union (square-root ends,
removed by a substitution), and kinks where another set or edge takes over the union's rim (located by the names of the
span ends at neighbouring nodes). Globally adaptive Gauss–Kronrod (3, 7), worst panel first.
"""

import math
from collections import namedtuple

import numba as nb
import numpy as np

from checkers.kernels.rays import EVEN, KRONROD, NODES, ODD, cast, expose, mass
from checkers.kernels.regions import DISTANCE, FEATURES, FULL_CIRCLE, ROW, SHAKE, end_radius
from checkers.kernels.sectors import LEFT, RIGHT, cut_circle

_KEPT = 3  # spans whose ends are remembered at every node
_WIDEST = 0.8  # rad, of a first panel

# rows, features: the sets. spans, ends: of one ray. events: angle, flag. sectors: between events: start, width, flag,
# active: the sets that reach into a sector. panels: sector, s₀, s₁, value, error, smooth. names: span ends per node.
Work = namedtuple("Work", "rows features spans ends events sectors active reach panels names cuts")


@nb.njit(cache=True)
def workspace(count):
    """Room for `count` sets, to be used again for any number of sweeps."""
    events = 12 * count + 42
    panels = 3 * events + 400
    return Work(
        np.empty((count, ROW)),
        np.empty((count, FEATURES)),
        np.empty((count + 1, 2)),
        np.empty((count + 1, 2), np.int64),
        np.empty((events, 2)),
        np.empty((events, 3)),
        np.empty((events, count), np.int64),
        np.empty(events, np.int64),
        np.empty((panels, 6)),
        np.empty((panels, 9, 1 + 2 * _KEPT), np.int64),
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
    fine = tolerance < 1e-6
    sectors = cut_circle(kind, work, count, nearest * nearest + 2.0 * math.log(1.0 / tolerance) + 20.0, fine)
    n = 0
    for k in range(sectors):
        parts = int(math.ceil(work.sectors[k, 1] / _WIDEST))
        for i in range(parts):
            _measure(kind, work, n, k, i / parts, (i + 1) / parts, fine)
            n += 1
    total, error = _sums(work, n)
    while error > 0.5 * tolerance * total and n < len(work.panels) - len(work.cuts):
        share = 0.5 * tolerance * total / n
        for k in range(n):
            if work.panels[k, 4] > share and n < len(work.panels) - len(work.cuts):
                n = _refine(kind, work, k, n, fine)
        total, error = _sums(work, n)
    if len(exposure):
        _expose_all(kind, work, n, pieces, exposure)
    return min(total, 1.0), max(error, tolerance * total) + total * (1e-13 + 4e-16 * _shake(work, count, nearest))


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
def _measure(kind, work, k, sector, low, high, ends_too):
    """Make panel k of [low, high] in a sector: value, error, names of the span ends at each node.

    `ends_too`: look for kinks between the panel's ends and the nodes next to them as well.
    """
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    fine, even, odd, smooth = 0.0, 0.0, 0.0, True
    active, reach = work.active[sector], work.reach[sector]
    names = work.names[k]
    first = 0 if ends_too else 1
    before, jump = 0.0, 0.0
    for j in range(first, 9 - first):
        angle, slope = _direction(work.sectors[sector], middle + half * NODES[j])
        spans, ends = work.spans, work.ends
        n = cast(kind, work.rows, active, reach, math.cos(angle), math.sin(angle), spans, ends)
        value = 0.0
        for i in range(n):
            value += mass(spans[i, 0], spans[i, 1])
        names[j, 0] = n
        for i in range(_KEPT):
            names[j, 1 + 2 * i], names[j, 2 + 2 * i] = (ends[i, 0], ends[i, 1]) if i < n else (-1, -1)
        for i in range(1 + 2 * _KEPT):
            smooth = smooth and names[j, i] == names[first, i]
        if j in {1, 8}:
            jump = max(jump, abs(value - before) * slope)
        before = value
        fine += KRONROD[j] * slope * value
        even += EVEN[j] * slope * value
        odd += ODD[j] * slope * value
    change = math.hypot(even, odd)
    if smooth and fine > 0.0:  # the null rules have half the order
        change *= min(1.0, 5.0 * math.sqrt(change / fine))
    elif ends_too:
        change += 0.04 * jump
    panel, scale = work.panels[k], half / FULL_CIRCLE
    panel[0], panel[1], panel[2] = sector, low, high
    panel[3], panel[4], panel[5] = fine * scale, change * scale, smooth


@nb.njit(cache=True, error_model="numpy")
def _refine(kind, work, k, n, fine):
    """Replace panel k by its parts, between kinks if any are found, else halves; return the new number of panels."""
    sector, low, high = int(work.panels[k, 0]), work.panels[k, 1], work.panels[k, 2]
    cuts = 0
    if not work.panels[k, 5]:
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        for j in range(0 if fine else 1, 8 if fine else 7):
            cuts = _kinks(kind, work, k, j, sector, middle + half * NODES[j], middle + half * NODES[j + 1], cuts)
    if cuts == 0:
        work.cuts[0], cuts = 0.5 * (low + high), 1
    left = low
    for j in range(cuts + 1):
        right = work.cuts[j] if j < cuts else high
        if right > left or j == cuts:
            _measure(kind, work, k if j == cuts else n, sector, left, right, fine)
            n += j < cuts
            left = right
    return n


@nb.njit(inline="always", error_model="numpy")
def _difference(a, b):
    """First place where span ends carry different names: (end, leaving) in each, and the place; −1 if unclear.

    Where a gap closes, the ends are the two sides of the gap.
    """
    for i in range(min(a[0], b[0], _KEPT)):
        if a[1 + 2 * i] != b[1 + 2 * i]:
            return (a[1 + 2 * i], False, b[1 + 2 * i], False, i) if a[0] == b[0] else (-1, False, -1, False, -1)
        if a[2 + 2 * i] != b[2 + 2 * i]:
            if a[0] == b[0]:
                return a[2 + 2 * i], True, b[2 + 2 * i], True, i
            more = a if a[0] > b[0] else b
            return (more[2 + 2 * i], True, more[3 + 2 * i], False, -1) if i + 1 < _KEPT else (-1, False, -1, False, -1)
    return -1, False, -1, False, -1


@nb.njit(cache=True, error_model="numpy")
def _kinks(kind, work, k, j, sector, left, right, found):
    """Append to `cuts` the places between nodes j and j + 1 where the rim passes from one set or edge to another.

    At the crossing of two curves a third may be outermost: then it lies between them, and both its crossings are cuts.
    """
    a, a_leaving, last, leaving, place = _difference(work.names[k, j], work.names[k, j + 1])
    while a >= 0 and found < len(work.cuts):
        b, x = last, right
        for _ in range(8):
            x = _crossing(kind, work.rows, work.sectors[sector], a, a_leaving, b, leaving, left, x)
            if x != x:
                return found
            if place < 0:
                break
            angle, _ = _direction(work.sectors[sector], x)
            active, reach = work.active[sector], work.reach[sector]
            cos, sin = math.cos(angle), math.sin(angle)
            n = cast(kind, work.rows, active, reach, cos, sin, work.spans, work.ends)
            outer = work.ends[place, int(leaving)] if place < n else -1
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
        if abs(x - before) < 1e-9 * width:
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
def _expose_all(kind, work, n, pieces, exposure):
    """Exposure of every step, with the nodes and weights of the final panels, so that it sums to the total."""
    exposure[:] = 0.0
    for k in range(n):
        sector, low, high = int(work.panels[k, 0]), work.panels[k, 1], work.panels[k, 2]
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        for j in range(1, 8):
            angle, slope = _direction(work.sectors[sector], middle + half * NODES[j])
            weight = KRONROD[j] * slope * half / FULL_CIRCLE
            active, reach = work.active[sector], work.reach[sector]
            ux, uy = math.cos(angle), math.sin(angle)
            expose(kind, work.rows, active, reach, ux, uy, pieces, weight, work.spans, work.ends, exposure)
