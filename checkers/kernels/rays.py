"""The union of convex sets along one ray from the origin of the ξ-plane, and the Gaussian mass it holds."""

import math

import numba as nb
import numpy as np

from checkers.kernels.regions import ENDLESS, INSIDE, OCTAGON, edge_at, ellipse_chord, octagon_chord

KEPT = 4  # spans whose ends are named
ENTER, LEAVE, FROM, UNTIL = range(4)  # rows of `spans`: of each set, of each span of the union


@nb.njit(cache=True, error_model="numpy")
def mass(enter, leave):
    """e^(−enter²/2) − e^(−leave²/2) without cancellation: the share of a ray's N(0, I) between two radii."""
    less = 0.5 * (leave - enter) * (leave + enter)
    near = math.exp(-0.5 * enter * enter)
    return near if less > 37.5 else near * -math.expm1(-less)  # e^−37.5 is half a unit in the last place


@nb.njit(cache=True, error_model="numpy")
def _include(spans, ends, n, enter, leave, first, last):
    """Unite [enter, leave], whose ends are sets' first and last, with n disjoint sorted spans; return the new n."""
    at = 0
    while at < n and spans[UNTIL, at] < enter:
        at += 1
    beyond = at
    while beyond < n and spans[FROM, beyond] <= leave:
        beyond += 1
    if at == beyond:
        for k in range(n, at, -1):
            _move(spans, ends, k - 1, k)
        spans[FROM, at], spans[UNTIL, at], ends[0, at], ends[1, at] = enter, leave, first, last
        return n + 1
    if enter < spans[FROM, at]:
        spans[FROM, at], ends[0, at] = enter, first
    if leave > spans[UNTIL, beyond - 1]:
        spans[UNTIL, at], ends[1, at] = leave, last
    else:
        spans[UNTIL, at], ends[1, at] = spans[UNTIL, beyond - 1], ends[1, beyond - 1]
    gone = beyond - at - 1
    if gone > 0:
        for k in range(beyond, n):
            _move(spans, ends, k, k - gone)
    return n - gone


@nb.njit(cache=True, error_model="numpy")
def _move(spans, ends, source, target):
    spans[FROM, target], spans[UNTIL, target] = spans[FROM, source], spans[UNTIL, source]
    ends[0, target], ends[1, target] = ends[0, source], ends[1, source]


@nb.njit(cache=True, error_model="numpy")
def _chords(kind, rows, spans, count, ux, uy):
    """Fill where the ray enters and leaves every set, several at a time."""
    if kind == OCTAGON:
        for j in range(count):
            spans[ENTER, j], spans[LEAVE, j] = octagon_chord(rows, j, ux, uy)
    else:
        for j in range(count):
            spans[ENTER, j], spans[LEAVE, j] = ellipse_chord(rows, j, ux, uy)


@nb.njit(cache=True, error_model="numpy")
def cast(kind, rows, spans, ends, count, ux, uy):
    """Find the spans of the ray inside the union of the sets, and the sets at their ends; returns how many.

    Neighbours in time mostly overlap, so a span grows in registers, without branches, until a set is apart from it.

    Args:
        spans: (4, N) gets enter and leave of each set, from and until of each span.
        ends: (4, N) gets the sets at each span's ends.
    """
    _chords(kind, rows, spans, count, ux, uy)
    n, low, high, first, last = 0, np.inf, -1.0, 0, 0
    for j in range(count):
        enter, leave = spans[ENTER, j], spans[LEAVE, j]  # (inf, −1) of a set that the ray misses
        if (leave >= 0.0) & (high >= 0.0) & ((enter > high) | (leave < low)):
            spans[ENTER, n], spans[LEAVE, n], ends[2, n], ends[3, n] = low, high, first, last  # both read by now
            n, low, high = n + 1, np.inf, -1.0
        first = j if enter < low else first
        low = enter if enter < low else low
        last = j if leave > high else last
        high = leave if leave > high else high
    if n == 0:
        spans[FROM, 0], spans[UNTIL, 0], ends[0, 0], ends[1, 0] = low, high, first, last
        return 1 if high >= 0.0 else 0
    found = _include(spans, ends, 0, low, high, first, last)
    for k in range(n):
        found = _include(spans, ends, found, spans[ENTER, k], spans[LEAVE, k], ends[2, k], ends[3, k])
    return found


@nb.njit(cache=True, error_model="numpy")
def name_of(kind, rows, j, ux, uy, radius, leaving):
    """Name of the end of a span: 8 × set (+ edge of an octagon)."""
    if radius == 0.0:
        return INSIDE
    if radius > 1e140:
        return ENDLESS
    return 8 * j + (edge_at(rows, j, ux, uy, radius, leaving) if kind == OCTAGON else 0)


@nb.njit(cache=True, error_model="numpy")
def expose(kind, rows, step, spans, ends, count, ux, uy, weight, fresh):
    """Add to `fresh` (T,) the weighted mass of each step's part of the ray that no earlier step covers.

    While there is one span, a set adds what lies before it or behind it: differences of the masses beyond each end.
    """
    _chords(kind, rows, spans, count, ux, uy)
    n, low, high, before, behind = 0, np.inf, -1.0, 0.0, 0.0
    for j in range(count):
        enter, leave = spans[ENTER, j], spans[LEAVE, j]
        if not enter < leave:
            continue
        if n == 0:
            n, low, high = 1, enter, leave
            before, behind = math.exp(-0.5 * enter * enter), math.exp(-0.5 * leave * leave)
            fresh[step[j]] += weight * (before - behind)
        elif n == 1 and enter <= high and leave >= low:
            if enter < low:
                low, more = enter, math.exp(-0.5 * enter * enter)
                fresh[step[j]] += weight * (more - before)
                before = more
            if leave > high:
                high, less = leave, math.exp(-0.5 * leave * leave)
                fresh[step[j]] += weight * (behind - less)
                behind = less
        else:
            if n == 1:
                spans[FROM, 0], spans[UNTIL, 0] = low, high
            n = _expose_apart(spans, ends, n, enter, leave, weight, fresh, step[j])
            low, high = spans[FROM, 0], spans[UNTIL, 0]
            if n == 1:
                before, behind = math.exp(-0.5 * low * low), math.exp(-0.5 * high * high)


@nb.njit(cache=True, error_model="numpy")
def _expose_apart(spans, ends, n, enter, leave, weight, fresh, step):
    """Add the mass of [enter, leave] outside n sorted spans, and unite it with them; return the new n."""
    cursor, new = enter, 0.0
    for k in range(n):
        if spans[FROM, k] >= leave:
            break
        if spans[FROM, k] > cursor:
            new += mass(cursor, spans[FROM, k])
        cursor = max(cursor, spans[UNTIL, k])
    if cursor < leave:
        new += mass(cursor, leave)
    fresh[step] += weight * new
    return _include(spans, ends, n, enter, leave, 0, 0)
