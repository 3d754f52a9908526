"""What a step adds to a path given ξ, where the rest ε of the position is independent: first hits over cells of ξ.

In the plane of ε, made white, a step's collision set K_t stands still, and the agent is at z = W_t ξ plus N(0, I).
"""

import math

import numba as nb
import numpy as np

from checkers.kernels.path import ALIGNED, BOXES, aligned_piece
from checkers.kernels.rim import clearance, mass, normal, rim_distance
from checkers.kernels.whiten import to_ego

_COARSE = (
    3.0  # half-width of a cell, in standard deviations of what smooths the integrand, beyond which no rule is tried
)
SPLIT, DROPPED, DONE = 0, 1, 2  # what became of a cell
_SURELY_HIT = 1e-17  # chance to have got through below which the steps that follow add nothing


@nb.njit(cache=True, error_model="numpy")
def fill_sets(shape_kind, shape, poses, means, roots, headings, rows):
    """Fill rows (T, N, PIECE) with the sets K_t, see `rim`; roots (T, 2, 2) of the rest's covariance, invertible."""
    for t in range(len(poses)):
        cos, sin = math.cos(poses[t, 2]), math.sin(poses[t, 2])
        d1, d2, _, _, _ = to_ego(poses[t, 0], poses[t, 1], cos, sin, means[t, 0], means[t, 1], 0.0, 0.0, 0.0)
        root = roots[t]
        s11, s12 = cos * root[0, 0] + sin * root[1, 0], cos * root[0, 1] + sin * root[1, 1]
        s21, s22 = -sin * root[0, 0] + cos * root[1, 0], -sin * root[0, 1] + cos * root[1, 1]
        white = (d1, d2, s11, s12, s21, s22)
        turn = headings[t] - poses[t, 2]
        if shape_kind == BOXES:
            _fill_edges(rows[t], shape[0], turn, white)
        elif shape_kind == ALIGNED:
            _fill_piece(rows[t, 0], aligned_piece(shape[0], turn), white)
        else:
            for p in range(len(shape)):
                _fill_piece(rows[t, p], shape[p], white)


@nb.njit(cache=True, error_model="numpy")
def _whitened(white, x1, x2):
    """S⁻¹ (x − d) of a point of the ego frame."""
    d1, d2, s11, s12, s21, s22 = white
    det = s11 * s22 - s12 * s21
    return (s22 * (x1 - d1) - s12 * (x2 - d2)) / det, (s11 * (x2 - d2) - s21 * (x1 - d1)) / det


@nb.njit(cache=True, error_model="numpy")
def _fill_edges(rows, half, turn, white):
    """The eight edges of box ⊕ box: its generators in order of their angle, there and back (a zonotope)."""
    c, s = math.cos(turn), math.sin(turn)
    sides = np.array([[half[0], 0.0], [0.0, half[1]], [c * half[2], s * half[2]], [-s * half[3], c * half[3]]])
    angles = np.empty(4)
    for i in range(4):
        if sides[i, 1] < 0.0 or (sides[i, 1] == 0.0 and sides[i, 0] < 0.0):
            sides[i] = -sides[i]
        angles[i] = math.atan2(sides[i, 1], sides[i, 0])
    order = np.argsort(angles)
    x, y = -np.sum(sides[:, 0]), -np.sum(sides[:, 1])
    flipped = white[2] * white[5] - white[3] * white[4] < 0.0
    for k in range(8):
        side = sides[order[k % 4]] * (2.0 if k < 4 else -2.0)
        a1, a2 = _whitened(white, x, y)
        x, y = x + side[0], y + side[1]
        b1, b2 = _whitened(white, x, y)
        if flipped:
            a1, a2, b1, b2 = b1, b2, a1, a2
        length = math.hypot(b1 - a1, b2 - a2)
        if length == 0.0:  # a body without width
            rows[k, 0], rows[k, 1], rows[k, 2], rows[k, 3], rows[k, 4] = 0.0, 0.0, 1e300, 0.0, 0.0
            continue
        t1, t2 = (b1 - a1) / length, (b2 - a2) / length
        rows[k, 0], rows[k, 1] = t2, -t1
        rows[k, 2] = 0.5 * (t2 * (a1 + b1) - t1 * (a2 + b2))
        rows[k, 3], rows[k, 4] = t1 * a1 + t2 * a2, t1 * b1 + t2 * b2


@nb.njit(cache=True, error_model="numpy")
def _fill_piece(row, piece, white):
    """An ellipse's row, see `rim.PIECE`."""
    _, _, s11, s12, s21, s22 = white
    a, b, c = piece[2], piece[3], piece[4]
    row[0], row[1] = _whitened(white, piece[0], piece[1])
    a11, a12, a21, a22 = a * s11 + b * s21, a * s12 + b * s22, c * s21, c * s22
    square, det = a11 * a11 + a12 * a12 + a21 * a21 + a22 * a22, a11 * a22 - a12 * a21
    largest = math.sqrt(0.5 * (square + math.sqrt(max(square * square - 4.0 * det * det, 0.0))))
    row[2], row[3], row[4], row[5], row[6] = a11, a12, a21, a22, 1.0 / largest
    row[7], row[8], row[9], row[10] = a22 / det, -a12 / det, -a21 / det, a11 / det
    row[11] = largest / abs(det)


@nb.njit(cache=True, error_model="numpy")
def first_hits(octagon, rows, arcs, moves, nodes, reach, panel, out):
    """Fill out (N, T): probability that the first hit is at step t, given ξ = nodes[n]; moves: W, (T, 2, R)."""
    for n in range(len(nodes)):
        missed = 1.0
        for t in range(len(rows)):
            z1, z2 = _moved(moves[t], nodes[n])
            hit = mass(octagon, rows[t], arcs, z1, z2, reach, panel) if missed > _SURELY_HIT else 0.0
            out[n, t] = missed * hit
            missed *= 1.0 - hit


@nb.njit(cache=True, error_model="numpy")
def _moved(move, xi):
    z1, z2 = 0.0, 0.0
    for r in range(len(xi)):
        z1, z2 = z1 + move[0, r] * xi[r], z2 + move[1, r] * xi[r]
    return z1, z2


@nb.njit(cache=True, error_model="numpy")
def over_cells(octagon, rows, arcs, moves, cells, reach, panel, rules, values, errors, axes, states):
    """E[first hit at t; ξ in the cell] for every cell, by two tensor Gauss rules, where the cell is small enough.

    Args:
        moves: (T, 2, R), R one or two; cells: (N, 2, R) centre and half-width.
        reach: what has |ξ|² + |ε|² above reach² is left out.
        rules: (2, 2, Q) nodes and weights of two rules, the finer first; the other padded by weights of 0.
        values: (N, T) by the finer rule; errors: (N,) the difference; axes, states: (N,) where to split, and whether.
    """
    steps, rank = len(rows), moves.shape[2]
    active, fine, coarser = np.empty(steps, np.int64), np.empty(rank), np.empty(steps)
    for n in range(len(cells)):
        centre, half = cells[n, 0], cells[n, 1]
        values[n], errors[n] = 0.0, 0.0
        nearest = 0.0
        for r in range(rank):
            fine[r] = half[r]  # the density of ξ itself
            nearest += max(abs(centre[r]) - half[r], 0.0) ** 2
        near = math.sqrt(max(reach * reach - nearest, 0.0))
        count, sure = _active(octagon, rows, moves, centre, half, near, active, fine)
        axes[n] = np.argmax(fine)
        if near == 0.0 or (count == 0 and sure < 0):
            states[n] = DROPPED
        elif fine[axes[n]] > _COARSE:
            states[n] = SPLIT
        else:
            states[n], coarser[:] = DONE, 0.0
            steps_left = active[:count]
            _integrate(octagon, rows, arcs, moves, centre, half, near, panel, rules[0], steps_left, sure, values[n])
            _integrate(octagon, rows, arcs, moves, centre, half, near, panel, rules[1], steps_left, sure, coarser)
            errors[n] = abs(np.sum(values[n]) - np.sum(coarser))


@nb.njit(cache=True, error_model="numpy")
def _integrate(octagon, rows, arcs, moves, centre, half, reach, panel, rule, active, sure, out):
    """Add E[first hit at t; ξ in the cell] to out (T,), by a tensor rule (2, Q); `active`, `sure`: see `_active`."""
    rank = len(centre)
    xi = np.empty(rank)
    nodes, weights = rule
    for i in range(len(nodes)):
        for j in range(len(nodes) if rank == 2 else 1):
            xi[0] = centre[0] + half[0] * nodes[i]
            missed = weights[i] * half[0] * math.exp(-0.5 * xi[0] * xi[0]) / math.sqrt(2.0 * math.pi)
            if rank == 2:
                xi[1] = centre[1] + half[1] * nodes[j]
                missed *= weights[j] * half[1] * math.exp(-0.5 * xi[1] * xi[1]) / math.sqrt(2.0 * math.pi)
            least = missed * _SURELY_HIT
            for t in active:
                if missed <= least:
                    break
                z1, z2 = _moved(moves[t], xi)
                hit = mass(octagon, rows[t], arcs, z1, z2, reach, panel)
                out[t] += missed * hit
                missed *= 1.0 - hit
            if sure >= 0:
                out[sure] += missed


@nb.njit(cache=True, error_model="numpy")
def _active(octagon, rows, moves, centre, half, near, active, fine):
    """(how many steps are neither surely missed nor surely hit in a cell, first one surely hit or −1).

    Writes those steps into `active`, up to the sure one, and into `fine` (R,) the largest of the cell's half-widths in
    standard deviations of the rest, across the rims in reach.
    """
    count, rank = 0, len(centre)
    for t in range(len(rows)):
        z1, z2 = _moved(moves[t], centre)
        wide = 0.0
        for r in range(rank):
            wide += half[r] * math.hypot(moves[t, 0, r], moves[t, 1, r])
        away = clearance(octagon, rows[t], z1, z2)
        if away - wide >= near:
            continue
        if away + wide <= -near:
            return count, t
        active[count] = t
        count += 1
        for i in range(len(rows[t])):
            if abs(rim_distance(octagon, rows[t, i], z1, z2)) - wide >= near:
                continue
            n1, n2, bend = normal(octagon, rows[t, i], z1, z2, wide)
            for r in range(rank):
                w1, w2 = moves[t, 0, r], moves[t, 1, r]
                across = abs(n1 * w1 + n2 * w2) + bend * abs(n1 * w2 - n2 * w1)
                fine[r] = max(fine[r], half[r] * across)
    return count, -1
