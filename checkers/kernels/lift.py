"""Scalar kernels lifted over poses × modes × pieces: the one loop behind every compiled backend."""

import math

import numba as nb
import numpy as np

from checkers.kernels.abi import ROOM, call_kernel
from checkers.kernels.whiten import to_disc, to_ego, whiten_moments


@nb.njit(cache=True, error_model="numpy", nogil=True)
def batch_risk(address, options, pieces, poses, means, covariances, moments, order, farthest, out):
    """Fill out (B, 3, T, K), value, error and lower bound, for poses (B, T, 3) and modes (T, K, …).

    Several pieces make a union bound.

    Args:
        address, options: of the kernel, see `abi`.
        pieces: (N, 5) from `packing.pack_pieces`.
        poses: finite, at most `farthest` in size.
        means: (T, K, 2); covariances: (T, K, 4) as c11, c12, c22, determinant; moments: (T, K, (order+1)²).

    Returns:
        how many values are NaN, or −1 if it met a pose that is not finite or too far.
    """
    unknown = 0
    scratch, extra = np.empty((order + 1) ** 2), np.empty(ROOM)
    # views are counted, and counting costs as much as a bound: plain addresses and scalars in the loop
    scratch_at, options_at, extra_at = scratch.ctypes.data, options.ctypes.data, extra.ctypes.data
    for b in range(poses.shape[0]):
        for t in range(poses.shape[1]):
            x, y, heading = poses[b, t, 0], poses[b, t, 1], poses[b, t, 2]
            if not (abs(x) <= farthest and abs(y) <= farthest and abs(heading) <= farthest):
                return -1
            cos, sin = math.cos(heading), math.sin(heading)
            for k in range(means.shape[1]):
                d1, d2, e11, e12, e22 = to_ego(
                    x,
                    y,
                    cos,
                    sin,
                    means[t, k, 0],
                    means[t, k, 1],
                    covariances[t, k, 0],
                    covariances[t, k, 1],
                    covariances[t, k, 2],
                )
                total, unsure, least = 0.0, 0.0, np.nan
                for p in range(pieces.shape[0]):
                    m1, m2, s11, s12, s22, det = to_disc(pieces, p, d1, d2, e11, e12, e22, covariances[t, k, 3])
                    if order > 0:
                        whiten_moments(pieces, p, cos, sin, moments[t, k], order, scratch)
                    extra[0], extra[1] = np.nan, np.nan
                    total += call_kernel(address, m1, m2, s11, s12, s22, det, scratch_at, order, options_at, extra_at)
                    unsure += extra[0]
                    if not extra[1] <= least:  # also replaces the initial NaN
                        least = extra[1]
                unknown += total != total
                out[b, 0, t, k], out[b, 2, t, k] = min(total, 1.0), least
                out[b, 1, t, k] = 1.0 if unsure > 1.0 else unsure
    return unknown
