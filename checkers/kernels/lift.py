"""Scalar kernels lifted over poses × modes × pieces: the one loop behind every compiled backend."""

import math

import numba as nb
import numpy as np

from checkers.kernels.abi import call_kernel
from checkers.kernels.whiten import to_disc, to_ego, whiten_moments


@nb.njit(cache=True, error_model="numpy")
def mode_risk(address, options, pieces, x, y, cos, sin, mu, cov, moments, order, scratch, out):
    """Risk of one mode at one pose: the union bound over the pieces. out[0] its error, out[1] its lower bound.

    `scratch` has room for (order+1)² numbers; cov is c11, c12, c22.
    """
    d1, d2, e11, e12, e22 = to_ego(x, y, cos, sin, mu[0], mu[1], cov[0], cov[1], cov[2])
    value, error, lower = 0.0, 0.0, np.nan
    for p in range(pieces.shape[0]):
        m1, m2, s11, s12, s22 = to_disc(pieces[p], d1, d2, e11, e12, e22)
        if order > 0:
            whiten_moments(pieces[p], cos, sin, moments, order, scratch)
        out[0], out[1] = np.nan, np.nan
        value += call_kernel(
            address, m1, m2, s11, s12, s22, scratch.ctypes.data, order, options.ctypes.data, out.ctypes.data
        )
        error += out[0]
        if not out[1] <= lower:  # also replaces the initial NaN
            lower = out[1]
    out[0], out[1] = error, lower
    return min(value, 1.0)


@nb.njit(cache=True, error_model="numpy")
def batch_risk(address, options, pieces, poses, means, covariances, moments, order, value, error, lower):
    """Fill value, error, lower (B, T, K) for poses (B, T, 3) and modes (T, K, …)."""
    scratch, out = np.empty(max((order + 1) ** 2, 1)), np.empty(2)
    for b in range(poses.shape[0]):
        for t in range(poses.shape[1]):
            cos, sin = math.cos(poses[b, t, 2]), math.sin(poses[b, t, 2])
            for k in range(means.shape[1]):
                value[b, t, k] = mode_risk(
                    address,
                    options,
                    pieces,
                    poses[b, t, 0],
                    poses[b, t, 1],
                    cos,
                    sin,
                    means[t, k],
                    covariances[t, k],
                    moments[t, k],
                    order,
                    scratch,
                    out,
                )
                error[b, t, k], lower[b, t, k] = out[0], out[1]


@nb.njit(cache=True, error_model="numpy")
def array_risk(address, options, m, s, moments, order, value, error, lower):
    """Fill value, error, lower (M,) for whitened modes m (M, 2), s (M, 3), moments (M, (order+1)²)."""
    out = np.empty(2)
    for i in range(m.shape[0]):
        out[0], out[1] = np.nan, np.nan
        value[i] = call_kernel(
            address,
            m[i, 0],
            m[i, 1],
            s[i, 0],
            s[i, 1],
            s[i, 2],
            moments[i].ctypes.data,
            order,
            options.ctypes.data,
            out.ctypes.data,
        )
        error[i], lower[i] = out[0], out[1]
