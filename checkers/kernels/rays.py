"""The union of convex sets along one ray from the origin of the ξ-plane, and the Gaussian mass it holds."""

import math

import numba as nb
import numpy as np

from checkers.kernels.regions import OCTAGON, ellipse_chord, octagon_chord

# the Kronrod (1965) extension of the 3-node Gauss rule on [−1, 1], between two nodes of no weight that look at the ends
NODES = np.array([0.9604912687080202, 0.7745966692414834, 0.4342437493468026])
NODES = np.array([-0.9999, *-NODES, 0.0, *NODES[::-1], 0.9999])
KRONROD = np.array([0.0, 0.1046562260264673, 0.2684880898683334, 0.4013974147759622])
KRONROD = np.array([*KRONROD, 0.4509165386584741, *KRONROD[::-1]])
# what a smooth integrand leaves over: Kronrod minus Gauss, and the odd null rule of the same norm (Laurie 1985),
# without which the difference of the two rules is now and then small by accident
EVEN = KRONROD - np.array([0.0, 0.0, 5 / 9, 0.0, 8 / 9, 0.0, 5 / 9, 0.0, 0.0])
ODD = np.array([0.0, -0.198417263, 0.438915142, -0.34405598, 0.0, 0.34405598, -0.438915142, 0.198417263, 0.0])


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
def cast(kind, rows, active, count, ux, uy, spans, ends):
    """Spans of the ray inside the union of the `active` sets; returns how many. Ends are 8 × set + edge."""
    n = 0
    for j in range(count):
        i = active[j]
        if kind == OCTAGON:
            enter, leave, first, last = octagon_chord(rows, i, ux, uy)
        else:
            enter, leave = ellipse_chord(rows, i, ux, uy)
            first, last = 0, 0
        if enter < leave:
            n = _include(spans, ends, n, enter, leave, 8 * i + first, 8 * i + last)
    return n


@nb.njit(cache=True, error_model="numpy")
def expose(kind, rows, active, count, ux, uy, pieces, weight, spans, ends, exposure):
    """Add to `exposure` (T,) the weighted mass of each step's part of the ray that no earlier step covers."""
    n = 0
    for j in range(count):
        i = active[j]
        if kind == OCTAGON:
            enter, leave, _, _ = octagon_chord(rows, i, ux, uy)
        else:
            enter, leave = ellipse_chord(rows, i, ux, uy)
        if not enter < leave:
            continue
        cursor, new = enter, 0.0
        for k in range(n):
            if spans[k, 0] >= leave:
                break
            if spans[k, 0] > cursor:
                new += mass(cursor, spans[k, 0])
            cursor = max(cursor, spans[k, 1])
        if cursor < leave:
            new += mass(cursor, leave)
        exposure[i // pieces] += weight * new
        n = _include(spans, ends, n, enter, leave, 0, 0)
