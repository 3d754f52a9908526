"""Digits that whitening in doubles loses: modes tight against the ellipsoid and far from it, whitened again in more.

A mode of σ = 1e-4 at 37 σ from the ellipse changes its probability by 1e-10 of it when its whitened mean is rounded.
Such modes are whitened in extended precision, rotated into their axes, and evaluated there; what rounding to doubles
still drops enters to first order.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from checkers.kernels.gaussian import tail_slopes
from checkers.kernels.lift import batch_risk
from checkers.packing import ModeArrays
from checkers.validate import FARTHEST, Array

WANTED = 3e-11  # relative error that is left alone
_SMALLEST = 1e-304
_LONG = np.longdouble
_DISC = np.array([[0.0, 0.0, 1.0, 0.0, 1.0]])  # the unit disc as a packed piece


class _Axes(NamedTuple):
    """Modes in the principal axes of the whitened plane (M, N): mean along and across, variances."""

    along: np.ndarray
    across: np.ndarray
    big: np.ndarray
    small: np.ndarray


def refine(
    kernel: int, options: Array, poses: Array, arrays: ModeArrays, shape: tuple[Array, Array], out: Array
) -> None:
    """Replace values in `out` (B, 3, T, K) whose error is above `WANTED` of them.

    Args:
        kernel, options: of an exact backend.
        poses: (B, T, 3).
        arrays: the modes.
        shape: offsets (N, 2) and forms (N, 2, 2) of the ego's pieces.
        out: values and errors; the errors stay, and hold.
    """
    # below that, 0 included, digits are lost to denormal numbers
    wanting = (out[:, 1] > WANTED * out[:, 0]) & (out[:, 0] > _SMALLEST)
    if not wanting.any():
        return
    lost = np.nonzero(wanting)
    batch, step, mode = lost
    axes = _axes(poses[batch, step], arrays.means[step, mode], arrays.covariances[step, mode], *shape)
    along, across, big, small = (np.asarray(a, dtype=np.float64) for a in axes)
    means = np.stack([along, across], axis=-1)
    covariances = np.stack([big, np.zeros_like(big), small, big * small], axis=-1)
    flat = np.empty((1, 3, *along.shape))
    nothing, order = np.zeros((*along.shape, 1)), 0
    origin = np.zeros((1, len(along), 3))
    batch_risk(kernel, options, _DISC, origin, means, covariances, nothing, order, FARTHEST, flat)
    slopes = tail_slopes(means, covariances)
    dropped = slopes[..., 0] * (axes.along - along) + slopes[..., 1] * (axes.across - across)
    # where that is no small change, the mode has next to no width: nothing is gained, and the kernel's value stays
    known = (np.abs(dropped) < 1e-3).all(axis=-1) & np.isfinite(flat[0, 0]).all(axis=-1)
    shift = np.where(known[:, None], dropped, 0.0).astype(np.float64)
    value = (flat[0, 0] * np.exp(shift)).sum(axis=-1)
    out[batch[known], 0, step[known], mode[known]] = np.minimum(value[known], 1.0)


def _axes(poses: Array, means: Array, covariances: Array, offsets: Array, forms: Array) -> _Axes:
    """Of modes (M, …) at poses (M, 3) against N pieces; the determinants given are exact already."""
    heading = poses[:, 2].astype(_LONG)
    cos, sin = np.cos(heading), np.sin(heading)
    dx, dy = (means.astype(_LONG) - poses[:, :2]).T
    c11, c12, c22, det = covariances.astype(_LONG).T
    e11 = cos * cos * c11 + 2 * cos * sin * c12 + sin * sin * c22
    e22 = sin * sin * c11 - 2 * cos * sin * c12 + cos * cos * c22
    e12 = (cos * cos - sin * sin) * c12 + cos * sin * (c22 - c11)
    q = forms.astype(_LONG)
    a = np.sqrt(q[:, 0, 0])
    b = q[:, 0, 1] / a
    c = np.sqrt(q[:, 1, 1] - b * b)
    r1 = (cos * dx + sin * dy)[:, None] - offsets[:, 0]
    r2 = (cos * dy - sin * dx)[:, None] - offsets[:, 1]
    m1, m2 = a * r1 + b * r2, c * r2
    e11, e12, e22 = e11[:, None], e12[:, None], e22[:, None]
    s11 = a * a * e11 + 2 * a * b * e12 + b * b * e22
    s12 = c * (a * e12 + b * e22)
    s22 = c * c * e22
    half = 0.5 * (s11 - s22)
    radius = np.hypot(half, s12)
    big = 0.5 * (s11 + s22) + radius
    v1 = np.where(half >= 0, half + radius, s12)
    v2 = np.where(half >= 0, s12, radius - half)
    v1 = np.where(radius > 0, v1, 1.0)
    norm = np.hypot(v1, v2)
    v1, v2 = v1 / norm, v2 / norm
    small = np.minimum(det[:, None] * (a * c) ** 2 / np.where(big > 0, big, 1.0), big)
    return _Axes(v1 * m1 + v2 * m2, v1 * m2 - v2 * m1, big, small)
