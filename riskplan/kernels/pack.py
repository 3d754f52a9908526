"""Agents into the rows that the hot loop reads."""

import math

import numba as nb

from riskplan.kernels.charge import C11, C12, C22, CULL, DET, MEAN_X, MEAN_Y, MOMENTS, REACH, WEIGHT


@nb.njit(cache=True, error_model="numpy")
def pack_rows(rows, first_row, means, covariances, weights, moments, reach, far):
    """Fill the modes of one agent, from column `first_row` on, into the last steps of rows (T, M, 9 + moments).

    means (S, K, 2), covariances (S, K, 4), moments (S, K, n); weights (S, K), or (0, 0) for 1. A pose farther from the
    mean than reach + far · σ is culled; `far` may be infinite.
    """
    steps = means.shape[0]
    skipped = rows.shape[0] - steps
    for t in range(steps):
        for k in range(means.shape[1]):
            row = rows[skipped + t, first_row + k]
            c11, c12, c22 = covariances[t, k, 0], covariances[t, k, 1], covariances[t, k, 2]
            row[MEAN_X], row[MEAN_Y] = means[t, k, 0], means[t, k, 1]
            row[C11], row[C12], row[C22], row[DET] = c11, c12, c22, covariances[t, k, 3]
            row[WEIGHT] = weights[t, k] if weights.shape[0] > 0 else 1.0
            row[REACH] = reach
            if math.isinf(far):
                row[CULL] = math.inf
            else:
                half = 0.5 * (c11 - c22)
                cull = reach + far * math.sqrt(0.5 * (c11 + c22) + math.sqrt(half * half + c12 * c12))
                row[CULL] = cull * cull
            for i in range(moments.shape[2]):
                row[MOMENTS + i] = moments[t, k, i]
