"""Sampled futures against the ego's shape."""

import math

import numba as nb
import numpy as np

from riskplan.kernels.hits import WORD, enter


@nb.njit(cache=True, error_model="numpy")
def hits_any(paths, poses, pieces, hit):
    """Set hit[i] where path i (n, S, 2) is inside some packed piece at some of the poses (S, 3)."""
    for s in range(poses.shape[0]):
        cos, sin = math.cos(poses[s, 2]), math.sin(poses[s, 2])
        for i in range(paths.shape[0]):
            if hit[i]:
                continue
            dx, dy = paths[i, s, 0] - poses[s, 0], paths[i, s, 1] - poses[s, 1]
            d1, d2 = cos * dx + sin * dy, cos * dy - sin * dx
            for p in range(pieces.shape[0]):
                r1, r2 = d1 - pieces[p, 0], d2 - pieces[p, 1]
                y1 = pieces[p, 2] * r1 + pieces[p, 3] * r2
                y2 = pieces[p, 4] * r2
                if y1 * y1 + y2 * y2 <= 1.0:
                    hit[i] = True
                    break


@nb.njit(cache=True, error_model="numpy")
def hits_turning(kind, shape, headings, paths, poses, hit):
    """Set hit[i] where path i (n, S, 2) of an agent with headings (S,) is inside a shape that turns with it."""
    offsets, some = np.empty((2, WORD), dtype=np.float32), np.empty(WORD, dtype=np.bool_)
    for s in range(poses.shape[0]):
        for first in range(0, paths.shape[0], WORD):
            count = min(WORD, paths.shape[0] - first)
            for j in range(WORD):
                i = first + min(j, count - 1)
                offsets[0, j], offsets[1, j] = paths[i, s, 0] - poses[s, 0], paths[i, s, 1] - poses[s, 1]
            some[:] = False
            if enter(kind, shape, 0.0, 0.0, poses[s, 2], headings[s], offsets, 0, some):
                hit[first : first + count] |= some[:count]
