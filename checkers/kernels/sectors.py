"""The circle of directions cut where the sweep's integrand may not be smooth, or is narrow.

`work` is the sweep's workspace; events are cuts, sectors what lies between them.
"""

import math

import numba as nb

from checkers.kernels.regions import (
    DISTANCE,
    FULL_CIRCLE,
    HIGH_RADIUS,
    LOW,
    LOW_RADIUS,
    NEAR,
    OCTAGON,
    SHAKE,
    TIP,
    WIDTH,
    chord,
)

LEFT, RIGHT = 1, 2  # which end of a sector is a tangent ray


@nb.njit(cache=True, error_model="numpy")
def cut_circle(kind, work, count, fine):
    """Fill the sectors between breakpoints that any set reaches into; return how many."""
    n, features, events = 0, work.features, work.events
    for i in range(count):
        f = features[i]
        if f[WIDTH] < FULL_CIRCLE:
            for angle, radius, flag in ((f[LOW], f[LOW_RADIUS], LEFT), (f[LOW] + f[WIDTH], f[HIGH_RADIUS], RIGHT)):
                if not _hidden(kind, work, count, i, angle, radius):
                    events[n, 0], events[n, 1] = angle, flag
                    n += 1
            if n < len(events) - 40 and not _hidden(kind, work, count, i, f[NEAR], f[DISTANCE]):
                n = _frame_peak(kind, work, i, n)
        if f[TIP] == f[TIP] and n < len(events) - 1:
            events[n, 0], events[n, 1] = f[TIP], 0
            n += 1
        if kind == OCTAGON and fine:
            n = _corners(work, count, i, n)
    if n == 0:
        events[0, 0], events[0, 1] = 0.0, 0
        n = 1
    _sort_from_first(events, n)
    used = 0
    for k in range(n):
        end = events[k + 1, 0] if k + 1 < n else events[0, 0] + FULL_CIRCLE
        width = end - events[k, 0]
        if width < 1e-15 or not _reached(work.features, count, events[k, 0], width):
            continue
        flag = int(events[k, 1]) & LEFT | int(events[(k + 1) % n, 1]) & RIGHT
        work.sectors[used, 0], work.sectors[used, 1], work.sectors[used, 2] = events[k, 0], width, flag
        used += 1
    return used


@nb.njit(inline="always", error_model="numpy")
def _frame_peak(kind, work, i, n):
    """Add events around the nearest point of set i, geometrically closer until the exponent rises by 2 only."""
    f = work.features[i]
    ahead = (f[NEAR] - f[LOW]) % FULL_CIRCLE
    for side, room in ((-1.0, min(ahead, f[WIDTH])), (1.0, f[WIDTH] - min(ahead, f[WIDTH]))):
        away = room
        for _ in range(10):
            away *= 0.3
            angle = f[NEAR] + side * away
            enter, leave = chord(kind, work.rows, i, math.cos(angle), math.sin(angle))
            rise = 0.5 * (enter * enter - f[DISTANCE] * f[DISTANCE])
            if enter > leave or rise > 60.0:
                continue
            if rise < 2.0:
                break
            work.events[n, 0], work.events[n, 1] = angle, 0
            n += 1
        f[SHAKE] = max(f[SHAKE], 4.0 / away)
    return n


@nb.njit(cache=True, error_model="numpy")
def _corners(work, count, i, n):
    """Add the visible corners of octagon i: between them the rim is straight, so no kink can hide between nodes."""
    row = work.rows[:, i]
    for k in range(16):
        a, b = 3 * (k & 1), 6 + 3 * (k >> 1 & 1)
        u, v = (1.0 if k & 4 else -1.0) - row[a], (1.0 if k & 8 else -1.0) - row[b]
        det = row[a + 1] * row[b + 2] - row[a + 2] * row[b + 1]
        x, y = (u * row[b + 2] - v * row[a + 2]) / det, (v * row[a + 1] - u * row[b + 1]) / det
        c, d = 3 - a, 15 - b  # the other strips
        inside = abs(row[c] + row[c + 1] * x + row[c + 2] * y) <= 1.0 + 1e-9
        inside = inside and abs(row[d] + row[d + 1] * x + row[d + 2] * y) <= 1.0 + 1e-9
        if inside and n < len(work.events) - 1:
            angle = math.atan2(y, x)
            if not _hidden(OCTAGON, work, count, i, angle, math.hypot(x, y)):
                work.events[n, 0], work.events[n, 1] = angle, 0
                n += 1
    return n


@nb.njit(inline="always", error_model="numpy")
def _hidden(kind, work, count, i, angle, radius):
    """Whether another set covers this point; neighbours in time are the likeliest."""
    ux, uy = math.cos(angle), math.sin(angle)
    for step in range(1, count):
        for j in (i - step, i + step):
            if 0 <= j < count:
                enter, leave = chord(kind, work.rows, j, ux, uy)
                if enter < radius * (1.0 - 1e-12) and leave > radius * (1.0 + 1e-12):
                    return True
    return False


@nb.njit(inline="always", error_model="numpy")
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


@nb.njit(inline="always", error_model="numpy")
def _reached(features, count, start, width):
    """Whether any set's cone reaches into the sector."""
    for i in range(count):
        f = features[i]
        ahead = (f[LOW] - start) % FULL_CIRCLE
        if f[WIDTH] >= FULL_CIRCLE or ahead < width - 1e-15 or ahead + f[WIDTH] > FULL_CIRCLE + 1e-15:
            return True
    return False
