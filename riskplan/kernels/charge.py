"""Charging risk to a motion: the hot loop of planning, over steps × agents × modes × pieces."""

import math

import numba as nb
import numpy as np

from checkers.kernels.abi import call_kernel
from checkers.kernels.whiten import to_disc, to_ego, whiten_moments

# columns of the agent rows; central moments follow
MEAN_X, MEAN_Y, C11, C12, C22, WEIGHT, CULL, MOMENTS = range(8)


# a piece bounded by less than this share of what is charged already is charged its bound
_MINOR = 3e-3


@nb.njit(cache=True, error_model="numpy")
def row_risk(address, options, order, row, pieces, first, last, x, y, cos, sin, negligible, scratch, out):
    """Risk of one agent mode at one pose: the union bound over its pieces.

    Where `negligible` > 0 (Gaussian modes under an exact backend) the half-space bound P ≤ Φ(−(|m| − 1)/σ_m), which
    holds for every direction and hence for that of m, is charged for every piece where it is below `negligible` or
    small beside the likeliest piece: the value is then high by at most `_MINOR` per piece.
    """
    d1, d2, e11, e12, e22 = to_ego(x, y, cos, sin, row[MEAN_X], row[MEAN_Y], row[C11], row[C12], row[C22])
    value, top, largest = 0.0, -1, 0.0
    if negligible > 0.0:
        for p in range(first, last):
            m1, m2, s11, s12, s22 = to_disc(pieces[p], d1, d2, e11, e12, e22)
            bound = _direction_bound(m1, m2, s11, s12, s22)
            if bound > largest:
                largest, top = bound, p
        if largest <= negligible:
            return largest * (last - first)
        m1, m2, s11, s12, s22 = to_disc(pieces[top], d1, d2, e11, e12, e22)
        value = call_kernel(
            address, m1, m2, s11, s12, s22, scratch.ctypes.data, 0, options.ctypes.data, out.ctypes.data
        )
    for p in range(first, last):
        if p == top:
            continue
        m1, m2, s11, s12, s22 = to_disc(pieces[p], d1, d2, e11, e12, e22)
        if negligible > 0.0:
            bound = _direction_bound(m1, m2, s11, s12, s22)
            if bound <= max(negligible, _MINOR * value):
                value += bound
                continue
        if order > 0:
            whiten_moments(pieces[p], cos, sin, row[MOMENTS:], order, scratch)
        value += call_kernel(
            address, m1, m2, s11, s12, s22, scratch.ctypes.data, order, options.ctypes.data, out.ctypes.data
        )
    return min(value, 1.0)


@nb.njit(inline="always", error_model="numpy")
def _direction_bound(m1, m2, s11, s12, s22):
    r2 = m1 * m1 + m2 * m2
    if not r2 > 1.0:  # NaN too: what is not known is not far
        return 1.0
    spread = math.sqrt(2.0 * (m1 * m1 * s11 + 2.0 * m1 * m2 * s12 + m2 * m2 * s22) / r2)
    return 0.5 * math.erfc((math.sqrt(r2) - 1.0) / spread) if spread > 0.0 else 0.0


@nb.njit(cache=True, error_model="numpy")
def marginals(address, options, order, rows, index, pieces, poses, first_step, out):
    """Fill out (S, M) with the risk of every agent mode at poses (S, 3), nothing culled or bounded."""
    scratch, extra = np.empty(max((order + 1) ** 2, 1)), np.empty(2)
    for s in range(poses.shape[0]):
        x, y = poses[s, 0], poses[s, 1]
        cos, sin = math.cos(poses[s, 2]), math.sin(poses[s, 2])
        for m in range(index.shape[0]):
            row = rows[first_step + s, m]
            out[s, m] = np.nan
            if not math.isnan(row[WEIGHT]):
                out[s, m] = row_risk(
                    address,
                    options,
                    order,
                    row,
                    pieces,
                    index[m, 1],
                    index[m, 2],
                    x,
                    y,
                    cos,
                    sin,
                    0.0,
                    scratch,
                    extra,
                )


@nb.njit(cache=True, error_model="numpy")
def charge(
    address,
    options,
    order,
    rows,
    index,
    pieces,
    groups,
    additive,
    negligible,
    given,
    poses,
    first_step,
    before,
    limit,
    after,
):
    """Add the risk of poses (S, 3) at grid steps first_step… to the accumulators; return the total so far.

    A group is what accumulates by itself: one mode of an agent with persistent modes, or a whole agent with per-step
    modes. after[g] = before[g] − Σ log(1 − r_g) (or + Σ r_g if `additive`), total = Σ_g outer_g (1 − e^−after[g]).
    Stops, returning a total above `limit`, as soon as the limit is passed.

    Args:
        rows: (T, M, 7 + moments) of all agent modes on the grid, WEIGHT NaN before a prediction begins.
        index: (M, 3) group, first and last piece of each row.
        groups: (G,) outer weights.
        given: (S, M) risks worked out elsewhere, or (0, 0).
    """
    count = groups.shape[0]
    step_risk = np.zeros(count)
    after[:] = before
    scratch, out = np.empty(max((order + 1) ** 2, 1)), np.empty(2)
    total = total_of(groups, after, additive)
    for s in range(poses.shape[0]):
        step = first_step + s
        x, y, heading = poses[s, 0], poses[s, 1], poses[s, 2]
        if not math.isfinite(x + y + heading):
            return np.nan
        cos, sin = math.cos(heading), math.sin(heading)
        touched = False
        for m in range(index.shape[0]):
            row = rows[step, m]
            weight = row[WEIGHT]
            if not weight > 0.0:  # NaN: the agent's prediction has not begun
                continue
            if given.shape[0] > 0:
                r = given[s, m]
            else:
                dx, dy = row[MEAN_X] - x, row[MEAN_Y] - y
                if dx * dx + dy * dy > row[CULL]:
                    continue
                r = row_risk(
                    address,
                    options,
                    order,
                    row,
                    pieces,
                    index[m, 1],
                    index[m, 2],
                    x,
                    y,
                    cos,
                    sin,
                    negligible,
                    scratch,
                    out,
                )
            g = index[m, 0]
            step_risk[g] += weight * r
            touched = True
            # one mode alone may break the budget
            if groups[g] * step_risk[g] > limit:
                return np.inf
        if not touched:
            continue
        for g in range(count):
            r = step_risk[g]
            if r > 0.0:
                if additive:
                    after[g] += r
                else:
                    after[g] -= math.log1p(-r) if r < 1.0 else -np.inf
                step_risk[g] = 0.0
            elif r != r:  # a backend that does not know must not pass for no risk
                return np.inf
        total = total_of(groups, after, additive)
        if total > limit:
            return total
    return total


@nb.njit(cache=True, error_model="numpy")
def total_of(groups, accumulated, additive):
    """Total risk of the accumulators: the sum over agents."""
    total = 0.0
    for g in range(groups.shape[0]):
        if accumulated[g] > 0.0:
            total += groups[g] * (accumulated[g] if additive else -math.expm1(-accumulated[g]))
    return total
