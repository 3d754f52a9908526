"""What a step adds to a path given ξ, where the rest ε of the position is independent: first hits, node by node.

In the plane of ε a step's sets keep their slopes and move with ξ, so that most nodes need no sweep: too far, surely
inside, or a single edge of a rectangle between hit and miss.
"""

import math

import numba as nb
import numpy as np

from checkers.kernels.path import kind_of, place
from checkers.kernels.regions import DISTANCE, OCTAGON, ROW
from checkers.kernels.sweep import sweep, workspace

# squared distance from the likeliest ξ and ε beyond which a step is not looked at: it has a density of e⁻⁵⁰ = 2e-22
_UNSEEN = 100.0
_SURE = 55.0  # squared distance by which an edge is farther than another if it holds less than 1e-12 of its mass
_SURELY_HIT = 1e-17  # chance to have got through below which the steps that follow add nothing


@nb.njit(cache=True, error_model="numpy")
def first_hits(shape_kind, shape, poses, means, factors, roots, headings, nodes, tolerance, out):
    """Fill out (N, T): probability that the first hit is at step t, given ξ = nodes[n].

    Args:
        poses: (T, 3); factors: (T, 2, R); roots: (T, 2, 2) of the covariance of what is independent; nodes: (N, R).
    """
    work, nothing, pieces, kind = workspace(len(shape)), np.empty(0), len(shape), kind_of(shape_kind)
    base, slopes = _moving_rows(work, shape_kind, shape, poses, means, factors, roots, headings)
    for n in range(len(nodes)):
        missed, left = 1.0, _UNSEEN
        for r in range(nodes.shape[1]):
            left -= nodes[n, r] * nodes[n, r]
        for t in range(len(poses)):
            hit = 0.0
            if missed > _SURELY_HIT:
                hit = _at_sight(kind, base[t], slopes[t], nodes[n], left)
                if hit < 0.0:
                    mean1, mean2 = means[t, 0], means[t, 1]
                    for r in range(nodes.shape[1]):
                        mean1 += factors[t, 0, r] * nodes[n, r]
                        mean2 += factors[t, 1, r] * nodes[n, r]
                    place(work, 0, shape_kind, shape, poses[t], mean1, mean2, roots[t], headings[t])
                    nearest = np.min(work.features[:pieces, DISTANCE])
                    hit = 0.0
                    if nearest * nearest < left:
                        hit, _ = sweep(kind, work, pieces, 1, tolerance, nothing)
            out[n, t] = missed * hit
            missed *= 1.0 - hit


@nb.njit(cache=True, error_model="numpy")
def _moving_rows(work, shape_kind, shape, poses, means, factors, roots, headings):
    """Rows (T, pieces, ROW) of the sets for ξ = 0, and their change (T, R, pieces, ROW) with each ξ_r: it is linear."""
    steps, pieces, rank = len(poses), len(shape), factors.shape[2]
    base, slopes = np.empty((steps, pieces, ROW)), np.empty((steps, rank, pieces, ROW))
    for t in range(steps):
        place(work, 0, shape_kind, shape, poses[t], means[t, 0], means[t, 1], roots[t], headings[t])
        base[t] = work.rows[:, :pieces].T
        for r in range(rank):
            mean1, mean2 = means[t, 0] + factors[t, 0, r], means[t, 1] + factors[t, 1, r]
            place(work, 0, shape_kind, shape, poses[t], mean1, mean2, roots[t], headings[t])
            slopes[t, r] = work.rows[:, :pieces].T - base[t]
    return base, slopes


@nb.njit(cache=True, error_model="numpy")
def _at_sight(kind, base, slopes, node, left):
    """P(hit | ξ) of one step where it is plain, else −1; `left`: squared distance beyond which it counts as 0."""
    if kind == OCTAGON:
        return _one_edge(base[0], slopes[:, 0], node, left)
    far = True
    for piece in range(len(base)):
        row = base[piece]
        m1, m2 = row[0], row[1]
        for r in range(len(node)):
            m1, m2 = m1 + slopes[r, piece, 0] * node[r], m2 + slopes[r, piece, 1] * node[r]
        # |A ε| ≤ size |ε|, so that a sphere of that radius around the mean stays outside the disc, or inside
        size = math.sqrt(row[2] * row[2] + row[3] * row[3] + row[4] * row[4] + row[5] * row[5])
        away = (math.sqrt(m1 * m1 + m2 * m2) - 1.0) / size
        if away < -math.sqrt(_SURE):
            return 1.0
        far = far and away > 0.0 and away * away > left
    return 0.0 if far else -1.0


@nb.njit(cache=True, error_model="numpy")
def _one_edge(row, slopes, node, left):
    """The same for an octagon: the mass of the one strip whose edges matter, if it is one."""
    worst, second, middle, per = -np.inf, -np.inf, 0.0, 0.0
    for i in (0, 3, 6, 9):
        p = row[i]
        for r in range(len(node)):
            p += slopes[r, i] * node[r]
        inverse = 1.0 / math.sqrt(row[i + 1] * row[i + 1] + row[i + 2] * row[i + 2])
        away = (abs(p) - 1.0) * inverse  # from the nearer edge, outwards
        if away > worst:
            worst, second, middle, per = away, worst, abs(p), inverse
        else:
            second = max(second, away)
    if worst == -np.inf:  # no rest at this step, and inside
        return 1.0
    if worst > 0.0 and worst * worst > left:
        return 0.0
    beyond = max(worst, 0.0)
    if not (second < 0.0 and second * second > _SURE + beyond * beyond):
        return -1.0
    return 0.5 * (math.erfc(worst / math.sqrt(2.0)) - math.erfc((1.0 + middle) * per / math.sqrt(2.0)))
