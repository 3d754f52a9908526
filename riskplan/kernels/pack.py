"""Agents into the rows that the hot loop reads."""

import math

import numba as nb
import numpy as np

from checkers.kernels.whiten import determinant
from riskplan.kernels.charge import AHEAD, ASIDE, C11, C12, C22, CULL, DET, MEAN_X, MEAN_Y, MOMENTS, REACH, WEIGHT


@nb.njit(cache=True, error_model="numpy")
def lay_out(sizes, pieces):
    """Where agents of sizes (A, 3), modes, whether each of them accumulates by itself, and pieces, have their numbers.

    Returns:
        index (M, 3) group, first and last piece of each mode; owner (M,) and group_owner (G,): the agents of modes and
        groups; extents (M, 3) [m] of the pieces (P, 5), which come in the agents' order: about the ego's centre, along
        its axis and across.
    """
    modes = groups = 0
    for a in range(sizes.shape[0]):
        modes += sizes[a, 0]
        groups += sizes[a, 0] if sizes[a, 1] else 1
    index, owner, extents = np.empty((modes, 3), np.int64), np.empty(modes, np.int64), np.empty((modes, 3))
    group_owner = np.empty(groups, np.int64)
    m = g = first = 0
    for a in range(sizes.shape[0]):
        last = first + sizes[a, 2]
        reach, ahead, aside = farthest(pieces, first, last), 0.0, 0.0
        for p in range(first, last):
            l11, l21, l22 = pieces[p, 2], pieces[p, 3], pieces[p, 4]
            ahead = max(ahead, abs(pieces[p, 0]) + math.hypot(l21, l22) / (l11 * l22))
            aside = max(aside, abs(pieces[p, 1]) + 1.0 / l22)
        for k in range(sizes[a, 0]):
            if k == 0 or sizes[a, 1]:
                group_owner[g] = a
                g += 1
            index[m, 0], index[m, 1], index[m, 2] = g - 1, first, last
            owner[m] = a
            extents[m, REACH], extents[m, AHEAD], extents[m, ASIDE] = reach, ahead, aside
            m += 1
        first = last
    return index, owner, group_owner, extents


@nb.njit(cache=True, error_model="numpy")
def farthest(pieces, first, last):
    """The largest offset plus longest semi-axis, 1/√λ_min of L Lᵀ, without cancellation."""
    most = 0.0
    for p in range(first, last):
        l11, l21, l22 = pieces[p, 2], pieces[p, 3], pieces[p, 4]
        trace, det = l11 * l11 + l21 * l21 + l22 * l22, (l11 * l22) ** 2
        longest = math.sqrt(0.5 * (trace + math.sqrt(max(trace * trace - 4.0 * det, 0.0))) / det)
        most = max(most, math.hypot(pieces[p, 0], pieces[p, 1]) + longest)
    return most


@nb.njit(cache=True, error_model="numpy")
def pack_rows(rows, columns, means, covariances, weights, moments, extents, far):
    """Fill modes into the columns (K,) of rows (T, M, 8 + moments): their last steps, and NaN before.

    means (S, K, 2), covariances (S, K, 2, 2); weights (S, K), or (0, 0) for 1; moments (S, K, n), or (0, 0, 0); extents
    (M, 3). A pose farther from the mean than reach + far · σ is culled; `far` may be infinite.
    """
    steps = means.shape[0]
    skipped = rows.shape[0] - steps
    for t in range(skipped):
        for k in range(columns.shape[0]):
            rows[t, columns[k]] = math.nan
    for t in range(steps):
        for k in range(columns.shape[0]):
            row, reach = rows[skipped + t, columns[k]], extents[columns[k], REACH]
            c11, c12, c22 = covariances[t, k, 0, 0], covariances[t, k, 0, 1], covariances[t, k, 1, 1]
            row[MEAN_X], row[MEAN_Y] = means[t, k, 0], means[t, k, 1]
            row[C11], row[C12], row[C22], row[DET] = c11, c12, c22, determinant(c11, c12, c22)
            row[WEIGHT] = weights[t, k] if weights.shape[0] > 0 else 1.0
            if math.isinf(far):
                row[CULL] = math.inf
            else:
                half = 0.5 * (c11 - c22)
                cull = reach + far * math.sqrt(0.5 * (c11 + c22) + math.sqrt(half * half + c12 * c12))
                row[CULL] = cull * cull
            for i in range(moments.shape[2]):
                row[MOMENTS + i] = moments[t, k, i]
