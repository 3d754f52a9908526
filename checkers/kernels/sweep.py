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

from checkers.kernels.panels import (
    CORNERS,
    ERROR,
    HIGH,
    KINKED,
    LIKELY_SMOOTH,
    LOW,
    MASS,
    PANEL,
    RAY,
    SECTOR,
    STATE,
    direction,
    integrate,
    kinks,
    look,
    measure,
    poke,
)
from checkers.kernels.rays import expose
from checkers.kernels.regions import DISTANCE, FEATURES, ROW, SHAKE
from checkers.kernels.sectors import cut_circle

_WIDEST = 0.4  # rad, of a first panel
_EDGE = 5e-5  # of a sector's width: where its end rays are, beside tangents and corners
_MOST_CUTS = 64  # of one panel

# rows, features, step: the sets. spans, ends: of one ray. events: angle, flag. sectors: between events: start, width,
# flag. panels, rays: see `panels`. Arrays are handed to what runs for every ray: a field taken costs a reference count.
Work = namedtuple("Work", "rows features step spans ends events sectors panels rays cuts")


@nb.njit(cache=True)
def workspace(count):
    """Room for `count` sets, to be used again for any number of sweeps."""
    events = 20 * count + 80
    panels = 3 * events + 400
    return Work(
        np.empty((ROW, count)),
        np.empty((count, FEATURES)),
        np.empty(count, np.int64),
        np.empty((4, count + 1)),
        np.empty((4, count + 1), np.int64),
        np.empty((events, 2)),
        np.empty((events, 3)),
        np.empty((panels, PANEL)),
        np.empty((5 * panels + 16, RAY)),
        np.empty(_MOST_CUTS),
    )


@nb.njit(cache=True, error_model="numpy")
def sweep(kind, work, count, pieces, tolerance, exposure):
    """(P, absolute error) for the union of the first `count` sets of `work`, whose rows and features are filled.

    Args:
        pieces: sets per step, in order of the steps.
        tolerance: relative, aimed at.
        exposure: (T,) gets the probability that the first hit is at each step; they sum to P. Skipped if empty.
    """
    rows, features, spans, ends, panels, rays = work.rows, work.features, work.spans, work.ends, work.panels, work.rays
    nearest = np.inf
    for i in range(count):
        nearest = min(nearest, features[i, DISTANCE])
    if nearest > 37.3:  # P < count × Φ(−37.3) = 9e-305: the integrand would be of denormal numbers
        exposure[:] = 0.0
        return 0.0, (count * 1e-304 if nearest < np.inf else 0.0)
    farthest = nearest * nearest + 2.0 * math.log(1.0 / tolerance) + 20.0
    count = _keep_near(rows, features, work.step, count, pieces, farthest)
    fine = tolerance < 1e-6
    sectors = cut_circle(kind, rows, features, count, work.events, work.sectors, fine)
    n, used = _first_panels(kind, rows, spans, ends, count, rays, panels, work.sectors[:sectors])
    total, error = _sums(panels, n)
    room, most = len(panels) - _MOST_CUTS, len(rays) - 6 * _MOST_CUTS
    while error > 0.5 * tolerance * total and n < room and used < most:
        share = 0.5 * tolerance * total / n
        for k in range(n):
            if panels[k, ERROR] > share and n < room and used < most:
                n, used = _refine(
                    kind, rows, spans, ends, count, rays, used, panels, k, n, work.sectors, fine, work.cuts
                )
        total, error = _sums(panels, n)
        if fine and not error > 0.5 * tolerance * total:
            n, used = _cut_pokes(kind, rows, spans, ends, count, rays, used, panels, n, work.sectors, room, most)
            total, error = _sums(panels, n)
    if len(exposure):
        _expose_all(kind, work, count, n, exposure)
    shake = _shake(features, count, nearest)
    return min(total, 1.0), max(error, tolerance * total) + total * (1e-13 + 4e-16 * shake)


@nb.njit(cache=True, error_model="numpy")
def _keep_near(rows, features, step, count, pieces, farthest):
    """Move the sets of which a point is nearer than √farthest to the front; return how many."""
    n = 0
    for i in range(count):
        distance = features[i, DISTANCE]
        if distance * distance < farthest:
            step[n] = i // pieces
            if n < i:
                rows[:, n] = rows[:, i]
                features[n] = features[i]
            n += 1
    return n


@nb.njit(cache=True, error_model="numpy")
def _sums(panels, n):
    total, error = 0.0, 0.0
    for k in range(n):
        total, error = total + panels[k, MASS], error + panels[k, ERROR]
    return total, error


@nb.njit(cache=True, error_model="numpy")
def _shake(features, count, nearest):
    """How strongly rounding of rows and angles moves the integrand, over the sets that matter."""
    shake = 0.0
    for i in range(count):
        distance = features[i, DISTANCE]
        if distance * distance < nearest * nearest + 40.0:
            shake = max(shake, features[i, SHAKE])
    return shake


@nb.njit(cache=True, error_model="numpy")
def _first_panels(kind, rows, spans, ends, count, rays, panels, sectors):
    """Panels of every sector, none wider than _WIDEST; return how many, and how many rays."""
    n, used = 0, 0
    for k in range(len(sectors)):
        start, width, flag = sectors[k, 0], sectors[k, 1], sectors[k, 2]
        parts = int(math.ceil(width / _WIDEST))
        left, used = used, used + 1
        angle, slope = direction(start, width, flag, _EDGE)
        look(kind, rows, spans, ends, count, rays, left, angle, slope)
        for i in range(parts):
            right, used = used, used + 1
            angle, slope = direction(start, width, flag, min((i + 1) / parts, 1.0 - _EDGE))
            look(kind, rows, spans, ends, count, rays, right, angle, slope)
            bounds, panels[n, SECTOR] = (i / parts, (i + 1) / parts), k
            sector = (start, width, flag)
            used = measure(kind, rows, spans, ends, count, rays, used, panels[n], sector, bounds, left, -1, right)
            n, left = n + 1, right
    return n, used


@nb.njit(cache=True, error_model="numpy")
def _refine(kind, rows, spans, ends, count, rays, used, panels, k, n, sectors, fine, cuts):
    """Integrate panel k by its ends if it looks smooth, or replace it by its parts: between kinks, if found, or halves.

    Returns how many panels and rays there are then.
    """
    panel, low, high = panels[k], panels[k, LOW], panels[k, HIGH]
    at = int(panel[SECTOR])
    sector = (sectors[at, 0], sectors[at, 1], sectors[at, 2])
    if panel[STATE] == LIKELY_SMOOTH:
        integrate(kind, rows, spans, ends, count, rays, panel, sector)
        return n, used
    left, right = int(panel[CORNERS]), int(panel[CORNERS + 4])
    before, centre, behind = int(panel[CORNERS + 1]), int(panel[CORNERS + 2]), int(panel[CORNERS + 3])
    found, beside = 0, 1e-6 * (high - low)
    if fine and panel[STATE] == KINKED:
        step = 0.25 * (high - low)
        for j in range(4):
            a, b = rays[int(panel[CORNERS + j])], rays[int(panel[CORNERS + j + 1])]
            near, far = low + j * step, low + (j + 1) * step
            found = kinks(kind, rows, spans, ends, count, a, b, sector, near, far, cuts, found)
        found = _apart_by(cuts, found, low, high, 2.0 * beside)
    if found == 0:
        middle, panels[n, SECTOR] = 0.5 * (low + high), at
        first, second, half = (low, middle), (middle, high), panels[n]
        used = measure(kind, rows, spans, ends, count, rays, used, half, sector, first, left, before, centre)
        used = measure(kind, rows, spans, ends, count, rays, used, panel, sector, second, centre, behind, right)
        return n + 1, used
    start = low
    for j in range(found):
        end, following, used = used, used + 1, used + 2
        angle, slope = direction(sector[0], sector[1], sector[2], cuts[j] - beside)
        look(kind, rows, spans, ends, count, rays, end, angle, slope)
        angle, slope = direction(sector[0], sector[1], sector[2], cuts[j] + beside)
        look(kind, rows, spans, ends, count, rays, following, angle, slope)
        panels[n, SECTOR], bounds = at, (start, cuts[j])
        used = measure(kind, rows, spans, ends, count, rays, used, panels[n], sector, bounds, left, -1, end)
        start, left, n = cuts[j], following, n + 1
    used = measure(kind, rows, spans, ends, count, rays, used, panel, sector, (start, high), left, -1, right)
    return n, used


@nb.njit(cache=True, error_model="numpy")
def _cut_pokes(kind, rows, spans, ends, count, rays, used, panels, n, sectors, room, most):
    """Cut the panels in which another set reaches over ends that all its rays find."""
    for k in range(n):
        panel = panels[k]
        if panel[STATE] == KINKED or n >= room or used >= most:
            continue
        at, low, high = int(panel[SECTOR]), panel[LOW], panel[HIGH]
        sector = (sectors[at, 0], sectors[at, 1], sectors[at, 2])
        left, right = int(panel[CORNERS]), int(panel[CORNERS + 4])
        s = poke(kind, rows, count, rays, sector, (low, high), int(panel[CORNERS + 2]))
        if not (s > low and s < high):
            continue
        middle, used = used, used + 1
        angle, slope = direction(sector[0], sector[1], sector[2], s)
        look(kind, rows, spans, ends, count, rays, middle, angle, slope)
        panels[n, SECTOR] = at
        used = measure(kind, rows, spans, ends, count, rays, used, panels[n], sector, (low, s), left, -1, middle)
        used = measure(kind, rows, spans, ends, count, rays, used, panel, sector, (s, high), middle, -1, right)
        n += 1
    return n, used


@nb.njit(cache=True, error_model="numpy")
def _apart_by(cuts, count, low, high, least):
    """Drop the cuts that are too near to their left neighbour or to `high`; return how many are left."""
    kept = 0
    for j in range(count):
        if cuts[j] - low > least and high - cuts[j] > least:
            cuts[kept], low, kept = cuts[j], cuts[j], kept + 1
    return kept


@nb.njit(cache=True, error_model="numpy")
def _expose_all(kind, work, count, n, exposure):
    """Exposure of every step, by two rays in each of the final panels and scaled so that it sums to the total."""
    rows, step, spans, ends, panels, sectors = work.rows, work.step, work.spans, work.ends, work.panels, work.sectors
    exposure[:] = 0.0
    fresh = np.zeros(len(exposure))
    for k in range(n):
        at, low, high = int(panels[k, SECTOR]), panels[k, LOW], panels[k, HIGH]
        fresh[:] = 0.0
        for node in (0.21132486540518713, 0.7886751345948129):
            s = low + (high - low) * node
            angle, slope = direction(sectors[at, 0], sectors[at, 1], sectors[at, 2], s)
            expose(kind, rows, step, spans, ends, count, math.cos(angle), math.sin(angle), slope, fresh)
        total = fresh.sum()
        if total > 0.0:
            exposure += fresh * (panels[k, MASS] / total)
