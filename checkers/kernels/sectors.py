"""The circle of directions cut where the sweep's integrand may not be smooth, or is narrow.

Events (angle, flag) are cuts, sectors (start, width, flag) what lies between them.
"""

import math

import numba as nb

from checkers.kernels.regions import (
    DISTANCE,
    FULL_CIRCLE,
    HIGH_RADIUS,
    HIGH_X,
    HIGH_Y,
    LOW_RADIUS,
    LOW_X,
    LOW_Y,
    NEAR_X,
    NEAR_Y,
    OCTAGON,
    OTHER_TIP,
    SHAKE,
    TIP,
    chord,
    level,
)

LEFT, RIGHT = 1, 2  # which end of a sector is a tangent ray
_EACH = 12  # events of a set without its peak: tangents, far ends, corners; a peak adds 20 at most


@nb.njit(cache=True, error_model="numpy")
def cut_circle(kind, rows, features, count, events, sectors, fine):
    """Fill the sectors between breakpoints that any set reaches into; return how many."""
    n = 0
    for i in range(count):
        f = features[i]
        if f[LOW_RADIUS] == f[LOW_RADIUS]:
            n = _tangent(kind, rows, count, i, f[LOW_X], f[LOW_Y], f[LOW_RADIUS], LEFT, events, n)
            n = _tangent(kind, rows, count, i, f[HIGH_X], f[HIGH_Y], f[HIGH_RADIUS], RIGHT, events, n)
            near = f[DISTANCE]
            spare = len(events) - n - _EACH * (count - i) - 20  # what is left when all others have had theirs
            if spare > 0 and not _hidden(kind, rows, count, i, f[NEAR_X] * near, f[NEAR_Y] * near):
                n = _frame_peak(kind, rows, i, f, events, n)
        if f[TIP] == f[TIP] and n < len(events) - 2:
            events[n, 0], events[n, 1] = f[TIP], 0
            events[n + 1, 0], events[n + 1, 1] = f[OTHER_TIP], 0
            n += 2
        if kind == OCTAGON and fine:
            n = _corners(rows, count, i, events, n)
    if n == 0:
        events[0, 0], events[0, 1] = 0.0, 0
        n = 1
    _sort_from_first(events, n)
    used = 0
    for k in range(n):
        end = events[k + 1, 0] if k + 1 < n else events[0, 0] + FULL_CIRCLE
        width = end - events[k, 0]
        if width < 1e-15 or not _reached(kind, rows, count, events[k, 0] + 0.5 * width):
            continue
        flag = int(events[k, 1]) & LEFT | int(events[(k + 1) % n, 1]) & RIGHT
        sectors[used, 0], sectors[used, 1], sectors[used, 2] = events[k, 0], width, flag
        used += 1
    return used


@nb.njit(cache=True, error_model="numpy")
def _tangent(kind, rows, count, i, x, y, radius, flag, events, n):
    """Add the ray along (x, y) that is tangent to set i at a radius, unless another set covers that point."""
    if not _hidden(kind, rows, count, i, x * radius, y * radius):
        events[n, 0], events[n, 1] = math.atan2(y, x), flag
        n += 1
    return n


@nb.njit(cache=True, error_model="numpy")
def _frame_peak(kind, rows, i, f, events, n):
    """Add events around the nearest point of set i, geometrically closer until the exponent rises by 2 only."""
    x, y = f[NEAR_X], f[NEAR_Y]
    middle = math.atan2(y, x)
    for at, side in ((LOW_X, -1.0), (HIGH_X, 1.0)):
        away = math.atan2(side * (x * f[at + 1] - y * f[at]), x * f[at] + y * f[at + 1]) % FULL_CIRCLE
        for _ in range(10):
            away *= 0.3
            angle = middle + side * away
            enter, leave = chord(kind, rows, i, math.cos(angle), math.sin(angle))
            rise = 0.5 * (enter * enter - f[DISTANCE] * f[DISTANCE])
            if enter > leave or rise > 60.0:
                continue
            if rise < 2.0:
                break
            events[n, 0], events[n, 1] = angle, 0
            n += 1
        f[SHAKE] = max(f[SHAKE], 4.0 / away)
    return n


@nb.njit(cache=True, error_model="numpy")
def _corners(rows, count, i, events, n):
    """Add the visible corners of octagon i: between them the rim is straight, so no kink can hide between nodes."""
    row = rows[:, i]
    for k in range(16):
        a, b = 3 * (k & 1), 6 + 3 * (k >> 1 & 1)
        u, v = (1.0 if k & 4 else -1.0) - row[a], (1.0 if k & 8 else -1.0) - row[b]
        per = 1.0 / (row[a + 1] * row[b + 2] - row[a + 2] * row[b + 1])
        x, y = (u * row[b + 2] - v * row[a + 2]) * per, (v * row[a + 1] - u * row[b + 1]) * per
        c, d = 3 - a, 15 - b  # the other strips
        on = abs(row[c] + row[c + 1] * x + row[c + 2] * y) <= 1.0 + 1e-9
        on = on and abs(row[d] + row[d + 1] * x + row[d + 2] * y) <= 1.0 + 1e-9
        if on and n < len(events) - 1 and not _hidden(OCTAGON, rows, count, i, x, y):
            events[n, 0], events[n, 1] = math.atan2(y, x), 0
            n += 1
    return n


@nb.njit(cache=True, error_model="numpy")
def _hidden(kind, rows, count, i, x, y):
    """Whether a set other than i covers this point of i's rim; neighbours in time are the likeliest.

    Of long thin sets the point may be off the rim, by rounding: two that are the same must not hide each other.
    """
    own, noise = level(kind, rows, i, x, y)
    enough = min(own, 1.0) - noise
    if not enough > 0.0:
        return False
    for step in range(1, count):
        if i >= step and _covers(kind, rows, i - step, x, y, enough):
            return True
        if i + step < count and _covers(kind, rows, i + step, x, y, enough):
            return True
    return False


@nb.njit(cache=True, error_model="numpy")
def _covers(kind, rows, j, x, y, enough):
    out, noise = level(kind, rows, j, x, y)
    return out + noise < enough


@nb.njit(cache=True, error_model="numpy")
def _sort_from_first(events, n):
    """Order by angle in the turn that begins at the first event."""
    start = events[0, 0]
    for k in range(1, n):
        angle, flag = start + (events[k, 0] - start) % FULL_CIRCLE, events[k, 1]
        j = k
        while j > 1 and events[j - 1, 0] > angle:
            events[j, 0], events[j, 1] = events[j - 1, 0], events[j - 1, 1]
            j -= 1
        events[j, 0], events[j, 1] = angle, flag


@nb.njit(cache=True, error_model="numpy")
def _reached(kind, rows, count, angle):
    """Whether the ray meets any set: between events all rays do or none, as the ends of cones are events."""
    ux, uy = math.cos(angle), math.sin(angle)
    for j in range(count):
        enter, leave = chord(kind, rows, j, ux, uy)
        if enter < leave:
            return True
    return False
