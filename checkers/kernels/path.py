"""From poses, one mode and a shape to collision sets, and these swept: per path or per step."""

import math

import numba as nb
import numpy as np

from checkers.kernels.regions import (
    ELLIPSE,
    OCTAGON,
    ellipse_features,
    fill_ellipse,
    fill_octagon,
    octagon_features,
)
from checkers.kernels.sweep import sweep, workspace
from checkers.kernels.whiten import to_ego

# shapes: pieces (N, 5) fixed to the ego; boxes, half sizes (1, 4); two ellipses that turn apart, semi-axes (1, 4)
FIXED, BOXES, ALIGNED = 0, 1, 2


@nb.njit(cache=True, error_model="numpy")
def kind_of(shape_kind):
    """What the shape's sets are in the plane of ξ."""
    return OCTAGON if shape_kind == BOXES else ELLIPSE


@nb.njit(cache=True, error_model="numpy")
def place(work, first, shape_kind, shape, pose, mean1, mean2, factor, heading):
    """Fill rows and features from `first` on with the collision sets of one step; factor is (2, 2)."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    d1, d2, _, _, _ = to_ego(pose[0], pose[1], cos, sin, mean1, mean2, 0.0, 0.0, 0.0)
    b11, b12 = cos * factor[0, 0] + sin * factor[1, 0], cos * factor[0, 1] + sin * factor[1, 1]
    b21, b22 = -sin * factor[0, 0] + cos * factor[1, 0], -sin * factor[0, 1] + cos * factor[1, 1]
    rows, row, out = work.rows, work.rows[:, first], work.features[first]
    if shape_kind == BOXES:
        c, s = math.cos(heading - pose[2]), math.sin(heading - pose[2])
        fill_octagon(row, shape[0], c, s, d1, d2, b11, b12, b21, b22)
        octagon_features(rows, first, shape[0], c, s, d1, d2, b11, b12, b21, b22, out)
    elif shape_kind == ALIGNED:
        piece = aligned_piece(shape[0], heading - pose[2])
        fill_ellipse(row, piece, d1, d2, b11, b12, b21, b22)
        ellipse_features(row, out)
    else:
        for p in range(len(shape)):
            fill_ellipse(rows[:, first + p], shape[p], d1, d2, b11, b12, b21, b22)
            ellipse_features(rows[:, first + p], work.features[first + p])


@nb.njit(cache=True, error_model="numpy")
def aligned_piece(axes, turn):
    """Centre and Cholesky factor of the form of two ellipses' sum: semi-axes (4,) of ego and agent, turned apart."""
    c, s = math.cos(turn), math.sin(turn)
    p11 = axes[0] ** 2 + (c * axes[2]) ** 2 + (s * axes[3]) ** 2
    p22 = axes[1] ** 2 + (s * axes[2]) ** 2 + (c * axes[3]) ** 2
    p12 = c * s * (axes[2] ** 2 - axes[3] ** 2)
    det = p11 * p22 - p12 * p12
    l11 = math.sqrt(p22 / det)
    return 0.0, 0.0, l11, -p12 / (det * l11), 1.0 / math.sqrt(p22)


@nb.njit(cache=True, error_model="numpy")
def sweep_paths(shape_kind, shape, poses, means, factors, headings, tolerance, value, error, exposure):
    """Fill value (B,), error (B,) and exposure (B, T), or (B, 0) to skip it, of one mode that ξ alone moves.

    Args:
        poses: (B, T, 3); means: (T, 2); factors: (T, 2, 2); headings: (T,), unread for fixed shapes.
    """
    steps, pieces = poses.shape[1], len(shape)
    work = workspace(steps * pieces)
    for b in range(len(poses)):
        for t in range(steps):
            place(work, t * pieces, shape_kind, shape, poses[b, t], means[t, 0], means[t, 1], factors[t], headings[t])
        value[b], error[b] = sweep(kind_of(shape_kind), work, steps * pieces, pieces, tolerance, exposure[b])


@nb.njit(cache=True, error_model="numpy")
def sweep_steps(shape_kind, shape, poses, means, roots, headings, tolerance, value, error):
    """Fill the marginal value and error (B, T) of every step; roots (T, 2, 2) of the covariances."""
    work, nothing = workspace(len(shape)), np.empty(0)
    for b in range(len(poses)):
        for t in range(poses.shape[1]):
            place(work, 0, shape_kind, shape, poses[b, t], means[t, 0], means[t, 1], roots[t], headings[t])
            value[b, t], error[b, t] = sweep(kind_of(shape_kind), work, len(shape), 1, tolerance, nothing)
