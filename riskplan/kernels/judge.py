"""Judging a whole trajectory: the risk of every agent mode at every pose, and what they add up to."""

import math

import numba as nb
import numpy as np

from checkers.kernels.abi import ROOM
from riskplan.kernels.charge import (
    AHEAD,
    ASIDE,
    C11,
    C12,
    C22,
    CULL,
    FAR_RISK,
    MEAN_X,
    MEAN_Y,
    REACH,
    WEIGHT,
    beyond,
    piece_bounds,
    row_risk,
    spend,
    squared_gap,
    squared_gap_of_sides,
)

_ROUNDING = 1e-14  # what all that is bounded adds at most, relative to the largest marginal
_IDLE = 1e-20  # share of the largest that a mode has to add, by a loose bound, for a tighter one to be of use
_PART = 1.0 / 3.0  # of what pieces may still be bounded by, for those of one mode
_UNLIKELY = 1e-10  # a largest loose bound below which the risk of a culled mode may count
_EXPONENTS = 1076  # of numbers from the smallest, 2^−1074, to 1


@nb.njit(cache=True, error_model="numpy")
def marginals(address, options, order, rows, index, extents, pieces, groups, bounded, poses, out):
    """Fill out (S, M) with the risk of every agent mode at poses (S, 3), NaN before its prediction begins.

    Where the backend is exact (`bounded`), modes and pieces that all together are less than rounding beside the largest
    marginal are stated by their bounds: far tails are slow to work out, and change no digit of any sum. None of these
    marginals is itself above that share of it.
    """
    room = (np.empty(pieces.shape[0]), np.empty((order + 1) ** 2), np.empty(ROOM))
    fixed = (address, options, order, pieces)
    negligible, minor, spare = 0.0, 0.0, 0.0
    if bounded and len(index) > 0:
        minor = _ROUNDING
        spare = 0.5 * _ROUNDING * _bounds(fixed, rows, index, extents, groups, poses, out, room)
        negligible = _threshold(out, spare)
    left = spare  # for pieces, first come, first served
    for s in range(poses.shape[0]):
        x, y = poses[s, 0], poses[s, 1]
        cos, sin = math.cos(poses[s, 2]), math.sin(poses[s, 2])
        for m in range(index.shape[0]):
            share = rows[s, m, WEIGHT] * groups[index[m, 0]]
            if not share >= 0.0:
                out[s, m] = np.nan
            elif share > 0.0 and bounded and out[s, m] < negligible and out[s, m] <= spare * share:
                out[s, m] /= share
            else:
                first, last = index[m, 1], index[m, 2]
                idle = _PART * left / (share * (last - first)) if share > 0.0 else 0.0
                out[s, m], idled = row_risk(fixed, rows[s, m], first, last, x, y, cos, sin, 0.0, idle, 0.0, minor, room)
                left -= idled * share


@nb.njit(cache=True, error_model="numpy")
def _bounds(fixed, rows, index, extents, groups, poses, out, room):
    """Fill out (S, M) with bounds of what every mode adds to a sum; returns what the likeliest of them does add.

    The one with the largest loose bound says how likely others have to be to be looked at again.
    """
    pieces = fixed[3]
    at_step, at_mode, largest = _loose_bounds(rows, index, extents, groups, poses, FAR_RISK, out)
    if largest < _UNLIKELY:
        at_step, at_mode, largest = _loose_bounds(rows, index, extents, groups, poses, 0.0, out)
    if at_step < 0:
        return 0.0
    first_look, largest = at_step, 0.0
    for turn in range(-1, poses.shape[0]):
        s = first_look if turn < 0 else turn
        mode, bound = _tightened(pieces, rows[s], index, extents, groups, poses[s], largest, out[s], room[0])
        if bound > largest:
            at_step, at_mode, largest = s, mode, bound
    x, y, heading = poses[at_step, 0], poses[at_step, 1], poses[at_step, 2]
    cos, sin = math.cos(heading), math.sin(heading)
    row, first, last = rows[at_step, at_mode], index[at_mode, 1], index[at_mode, 2]
    risk, _ = row_risk(fixed, row, first, last, x, y, cos, sin, 0.0, 0.0, 0.0, _ROUNDING, room)
    return risk * row[WEIGHT] * groups[index[at_mode, 0]]


@nb.njit(cache=True, error_model="numpy")
def _tightened(pieces, rows, index, extents, groups, pose, largest, out, bounds):
    """Tighten the bounds (M,) of a step that are not far below `largest`; the mode that may be above it, and its bound.

    Bounds by the sides of the whole shape, by its pieces for who may be the likeliest, and at last by the likeliest
    points of those: each takes several times as long as the one before.
    """
    x, y, cos, sin = pose[0], pose[1], math.cos(pose[2]), math.sin(pose[2])
    likeliest, most = -1, largest
    for m in range(index.shape[0]):
        if not out[m] > _IDLE * largest:
            continue
        share, dx, dy = rows[m, WEIGHT] * groups[index[m, 0]], rows[m, MEAN_X] - x, rows[m, MEAN_Y] - y
        c11, c12, c22, ahead, aside = rows[m, C11], rows[m, C12], rows[m, C22], extents[m, AHEAD], extents[m, ASIDE]
        out[m] = min(out[m], beyond(squared_gap_of_sides(dx, dy, c11, c12, c22, cos, sin, ahead, aside)) * share)
        if out[m] > most:  # who is within the shape's reach need not be near its pieces
            first, last = index[m, 1], index[m, 2]
            together, _, _ = piece_bounds(pieces, rows[m], first, last, x, y, cos, sin, np.inf, 0.0, bounds)
            out[m] = min(out[m], together * share)
            if out[m] > most:
                likeliest, most = m, out[m]
    if likeliest < 0:
        return -1, 0.0
    row, first, last = rows[likeliest], index[likeliest, 1], index[likeliest, 2]
    together, _, _ = piece_bounds(pieces, row, first, last, x, y, cos, sin, 0.0, 0.0, bounds)
    out[likeliest] = min(most, together * row[WEIGHT] * groups[index[likeliest, 0]])
    return likeliest, out[likeliest]


@nb.njit(cache=True, error_model="numpy")
def _loose_bounds(rows, index, extents, groups, poses, culled, out):
    """Fill out (S, M) with bounds along the line of centres, e^(−d²/2)/2 ≥ Φ(−d); the largest's step, mode and value.

    Modes beyond their cull distance are bounded by `culled`, unless that is 0.
    """
    at_step, at_mode, largest = -1, -1, 0.0
    for s in range(poses.shape[0]):
        x, y = poses[s, 0], poses[s, 1]
        for m in range(index.shape[0]):
            out[s, m] = 0.0
            share = rows[s, m, WEIGHT] * groups[index[m, 0]]
            if not share > 0.0:
                continue
            dx, dy = rows[s, m, MEAN_X] - x, rows[s, m, MEAN_Y] - y
            if culled > 0.0 and dx * dx + dy * dy > rows[s, m, CULL]:
                out[s, m] = share * culled
            else:
                c11, c12, c22 = rows[s, m, C11], rows[s, m, C12], rows[s, m, C22]
                gap = squared_gap(dx, dy, c11, c12, c22, extents[m, REACH])
                out[s, m] = share * (0.5 * math.exp(-0.5 * gap) if gap > 0.0 else 1.0)
            if out[s, m] > largest:
                at_step, at_mode, largest = s, m, out[s, m]
    return at_step, at_mode, largest


@nb.njit(cache=True, error_model="numpy")
def _threshold(values, spare):
    """A threshold so that the values in [0, 1] below it sum up to at most `spare`."""
    sums = np.zeros(_EXPONENTS)
    for value in values.flat:
        if value > 0.0:
            at = math.frexp(value)[1] + _EXPONENTS - 2  # 2^(at − 1075) ≤ value < 2^(at − 1074)
            sums[at] += value
    total = 0.0
    for at in range(_EXPONENTS):
        total += sums[at]
        if total > spare:
            return math.ldexp(1.0, at - 1075)
    return np.inf


@nb.njit(cache=True, error_model="numpy")
def combine(values, rows, index, groups, group_owner, additive, per_agent, per_step):
    """The risk of a whole trajectory from its marginals (S, M); the formulas of `checkers.trajectory_risk`, as charged.

    Fills per_agent (A,) and per_step (S,), both zero before and at most 1 after. Returns Boole's sum, at most 1, and
    the largest marginal of one agent at one step. NaN, before a prediction begins, counts for nothing.
    """
    spent, step_risk = np.zeros(groups.shape[0]), np.zeros(groups.shape[0])
    boole = top = 0.0
    for s in range(values.shape[0]):
        for m in range(index.shape[0]):
            weight = rows[s, m, WEIGHT]
            if weight > 0.0:
                step_risk[index[m, 0]] += weight * values[s, m]
        agent, at_once = -1, 0.0
        for g in range(groups.shape[0]):
            if group_owner[g] != agent:
                top, agent, at_once = max(top, at_once), group_owner[g], 0.0
            r = step_risk[g]
            if r > 0.0:
                spent[g] = spend(spent[g], r, additive)
                at_once += groups[g] * r
                per_step[s] += groups[g] * r
                step_risk[g] = 0.0
        top = max(top, at_once)
        boole += per_step[s]
        per_step[s] = min(per_step[s], 1.0)
    for g in range(groups.shape[0]):
        per_agent[group_owner[g]] += groups[g] * (spent[g] if additive else -math.expm1(-spent[g])) + 0.0
    for a in range(per_agent.shape[0]):
        per_agent[a] = min(per_agent[a], 1.0)
    return min(boole, 1.0), min(top, 1.0)
