"""The union of convex sets along one ray from the origin of the ξ-plane, and the Gaussian mass it holds."""

import math

import numba as nb

from checkers.kernels.regions import ENDLESS, INSIDE, OCTAGON, edge_at, ellipse_chord, octagon_chord

KEPT = 4  # spans whose ends are named


@nb.njit(inline="always", error_model="numpy")
def mass(enter, leave):
    """e^(−enter²/2) − e^(−leave²/2) without cancellation: the share of a ray's N(0, I) between two radii."""
    return math.exp(-0.5 * enter * enter) * -math.expm1(-0.5 * (leave - enter) * (leave + enter))


@nb.njit(inline="always", error_model="numpy")
def _include(spans, ends, n, enter, leave, first, last):
    """Unite [enter, leave] with n disjoint sorted spans (n, 2), whose ends are named in `ends`; return the new n."""
    if n == 1 and enter <= spans[0, 1] and leave >= spans[0, 0]:  # by far the most frequent
        if enter < spans[0, 0]:
            spans[0, 0], ends[0, 0] = enter, first
        if leave > spans[0, 1]:
            spans[0, 1], ends[0, 1] = leave, last
        return 1
    low = 0
    while low < n and spans[low, 1] < enter:
        low += 1
    high = low
    while high < n and spans[high, 0] <= leave:
        high += 1
    if low == high:
        for k in range(n, low, -1):
            spans[k, 0], spans[k, 1] = spans[k - 1, 0], spans[k - 1, 1]
            ends[k, 0], ends[k, 1] = ends[k - 1, 0], ends[k - 1, 1]
        spans[low, 0], spans[low, 1] = enter, leave
        ends[low, 0], ends[low, 1] = first, last
        return n + 1
    if enter < spans[low, 0]:
        spans[low, 0], ends[low, 0] = enter, first
    if leave > spans[high - 1, 1]:
        spans[low, 1], ends[low, 1] = leave, last
    else:
        spans[low, 1], ends[low, 1] = spans[high - 1, 1], ends[high - 1, 1]
    gone = high - low - 1
    if gone > 0:
        for k in range(high, n):
            spans[k - gone, 0], spans[k - gone, 1] = spans[k, 0], spans[k, 1]
            ends[k - gone, 0], ends[k - gone, 1] = ends[k, 0], ends[k, 1]
    return n - gone


@nb.njit(cache=True, error_model="numpy")
def chords(kind, rows, count, ux, uy, enter, leave):
    """Fill enter (count,) and leave (count,) of every set, several at a time."""
    if kind == OCTAGON:
        for j in range(count):
            enter[j], leave[j] = octagon_chord(rows, j, ux, uy)
    else:
        for j in range(count):
            enter[j], leave[j] = ellipse_chord(rows, j, ux, uy)


@nb.njit(cache=True, error_model="numpy")
def cast(kind, work, count, ux, uy):
    """Find the spans of the ray inside the union of the sets, and the sets at their ends; returns how many."""
    enter, leave, spans, ends = work.enter, work.leave, work.spans, work.ends
    chords(kind, work.rows, count, ux, uy, enter, leave)
    n = 0
    for j in range(count):
        if enter[j] < leave[j]:
            n = _include(spans, ends, n, enter[j], leave[j], j, j)
    return n


@nb.njit(inline="always", error_model="numpy")
def name_of(kind, rows, j, ux, uy, radius, leaving):
    """Name of the end of a span: 8 × set (+ edge of an octagon)."""
    if radius == 0.0:
        return INSIDE
    if radius > 1e140:
        return ENDLESS
    return 8 * j + (edge_at(rows, j, ux, uy, radius, leaving) if kind == OCTAGON else 0)


@nb.njit(cache=True, error_model="numpy")
def expose(kind, work, count, ux, uy, weight, fresh):
    """Add to `fresh` (T,) the weighted mass of each step's part of the ray that no earlier step covers."""
    enter, leave, spans, ends = work.enter, work.leave, work.spans, work.ends
    chords(kind, work.rows, count, ux, uy, enter, leave)
    n = 0
    for j in range(count):
        if not enter[j] < leave[j]:
            continue
        cursor, new = enter[j], 0.0
        for k in range(n):
            if spans[k, 0] >= leave[j]:
                break
            if spans[k, 0] > cursor:
                new += mass(cursor, spans[k, 0])
            cursor = max(cursor, spans[k, 1])
        if cursor < leave[j]:
            new += mass(cursor, leave[j])
        fresh[work.step[j]] += weight * new
        n = _include(spans, ends, n, enter[j], leave[j], 0, 0)
