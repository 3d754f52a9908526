"""Second opinions on the risk of a whole path, by other mathematics than the polar sweep.

- `collision_sets`: what collides at each step, in the plane of ξ, as chords parallel to its second axis. Ellipses from
  their quadratic form, boxes from the convex hull of sums of corners.
- `union_mass`: the N(0, I) mass of a union by Cartesian slices, bisected wherever two rules differ, without looking for
  kinks. `slices_mp` sums the same in mpmath.
- `sampled_hits`: plain Monte Carlo of trajectories with true rectangles or ellipses; `hits_of_factors` the same of
  agents that ξ alone moves, compiled: a tenth of the time.
"""

from __future__ import annotations

import itertools

import mpmath as mp
import numba as nb
import numpy as np
from builders import spin
from scipy.spatial import ConvexHull
from scipy.special import erfc

SKEW = spin(0.7531)  # of the plane of ξ, so that no edge is parallel to the slices
_X, _W = np.polynomial.legendre.leggauss(12)
_X2, _W2 = np.polynomial.legendre.leggauss(7)


def ellipse_set(pose, mean, factor, q, offset=(0.0, 0.0)):
    """chords(x) -> (low, high) for {ξ : z'Qz ≤ 1}, z the centre in the ego frame less the offset; empty: low > high."""
    turn = spin(pose[2]).T
    z = turn @ (np.asarray(mean) - pose[:2]) - np.asarray(offset)
    b = turn @ np.asarray(factor) @ SKEW

    def chords(x):
        start = z[:, None] + b[:, :1] * x
        quadratic = b[:, 1] @ q @ b[:, 1]
        linear = b[:, 1] @ q @ start
        rest = np.einsum("in,ij,jn->n", start, q, start) - 1.0
        with np.errstate(all="ignore"):
            if quadratic == 0.0:
                return np.where(rest < 0, -np.inf, np.inf), np.where(rest < 0, np.inf, -np.inf)
            root = np.sqrt(linear**2 - quadratic * rest)
            low, high = (-linear - root) / quadratic, (-linear + root) / quadratic
        return np.where(root >= 0, low, np.inf), np.where(root >= 0, high, -np.inf)

    chords.kinks = np.empty(0)
    return chords


def corners(length, width, heading):
    signs = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])
    return signs * [length / 2, width / 2] @ spin(heading).T


def box_set(pose, mean, factor, ego, agent, heading):
    """The same for two rectangles of sizes `ego` and `agent` (length, width)."""
    sums = (corners(*ego, pose[2])[:, None] + corners(*agent, heading)[None]).reshape(-1, 2)
    planes = ConvexHull(sums).equations  # n·x + c ≤ 0
    z, b = np.asarray(mean) - pose[:2], np.asarray(factor) @ SKEW

    def chords(x):
        low, high = np.full(x.shape, -np.inf), np.full(x.shape, np.inf)
        for n1, n2, c in planes:
            n = np.array([n1, n2])
            value, slope = n @ z + c + (n @ b[:, 0]) * x, n @ b[:, 1]
            with np.errstate(all="ignore"):
                cut = -value / slope
            if slope > 0:
                high = np.minimum(high, cut)
            elif slope < 0:
                low = np.maximum(low, cut)
            else:
                low = np.where(value > 0, np.inf, low)
        return low, high

    away = np.asarray(sums)[ConvexHull(sums).vertices] - z
    chords.kinks = np.linalg.lstsq(b, away.T, rcond=None)[0][0]
    return chords


def _slice_mass(low, high):
    """Φ(high) − Φ(low) with relative accuracy in the tails and for thin slices."""
    flip = low + high < 0
    low, high = np.where(flip, -high, low), np.where(flip, -low, high)
    far = 0.5 * (erfc(low / np.sqrt(2)) - erfc(high / np.sqrt(2)))
    half, middle = 0.5 * (high - low), 0.5 * (high + low)
    with np.errstate(all="ignore"):
        density = np.exp(-0.5 * (middle + half * _X[:, None]) ** 2)
        thin = (_W[:, None] * density).sum(axis=0) * half / np.sqrt(2 * np.pi)
    # where the density falls by less than e over the slice, the rule is exact to rounding
    return np.where((high - low) * (1.0 + np.abs(high)) < 1.0, thin, far)


def _union_slices(sets, x):
    """For each x the mass of the union of all chords."""
    chords = [s(x) for s in sets]
    low, high = np.stack([c[0] for c in chords]), np.stack([c[1] for c in chords])
    high = np.where(low < high, high, -np.inf)
    low = np.where(low < high, low, np.inf)
    order = np.argsort(low, axis=0)
    low, high = np.take_along_axis(low, order, 0), np.take_along_axis(high, order, 0)
    total, reach = np.zeros(x.shape), np.full(x.shape, -np.inf)
    for start_, h in zip(low, high, strict=True):
        start = np.maximum(start_, reach)
        new = h > start
        total += np.where(new, _slice_mass(np.where(new, start, 0.0), np.where(new, h, 0.0)), 0.0)
        reach = np.maximum(reach, h)
    return total * np.exp(-0.5 * x * x) / np.sqrt(2 * np.pi)


def _breaks(sets, grid):
    """Abscissae where a set begins or ends, or two rims cross: sign changes over the grid, bisected."""
    found = []

    def bisect(f, values):
        bad = ~np.isfinite(values)
        change = np.flatnonzero((values[:-1] * values[1:] < 0) & ~bad[:-1] & ~bad[1:])
        left, right, sign = grid[change], grid[change + 1], np.sign(values[change])
        for _ in range(55 if len(change) else 0):
            middle = 0.5 * (left + right)
            same = np.sign(f(middle)) == sign
            left, right = np.where(same, middle, left), np.where(same, right, middle)
        found.extend([left, right])

    for s in sets:  # corners
        found.append(s.kinks[np.abs(s.kinks) < grid[-1]])
    ends = [s(grid) for s in sets]
    ends = [np.where(low < high, (low, high), np.nan) for low, high in ends]
    for i, s in enumerate(sets):
        bisect(lambda x, s=s: np.where(np.less(*s(x)), 1.0, -1.0), np.where(np.isnan(ends[i][0]), -1.0, 1.0))
        for j in range(i):
            for a, b in ((0, 0), (1, 1), (0, 1), (1, 0)):
                bisect(lambda x, s=s, t=sets[j], a=a, b=b: s(x)[a] - t(x)[b], ends[i][a] - ends[j][b])
    return np.concatenate(found)


def union_mass(sets, tolerance=1e-12):
    """Mass of the union by slices, cut where the integrand has kinks, halved wherever two rules differ."""
    grid = np.linspace(-38, 38, 1521)
    cuts = np.unique(np.concatenate([grid, _breaks(sets, grid)]))
    low, high = cuts[:-1], cuts[1:]
    total = 0.0
    for _ in range(60):
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        x = middle + half * np.concatenate([_X, _X2])[:, None]
        values = _union_slices(sets, x.ravel()).reshape(x.shape)
        fine, coarse = half * (_W @ values[:12]), half * (_W2 @ values[12:])
        loose = np.abs(fine - coarse) > tolerance * (total + fine.sum())
        total += fine[~loose].sum()
        if not loose.any():
            break
        low, high = np.concatenate([low[loose], middle[loose]]), np.concatenate([middle[loose], high[loose]])
    return total


def sampled_hits(positions, poses, headings, sizes=None, q=None):
    """First step (n,) at which each sampled centre (n, T, 2) collides, −1 for none.

    `sizes`: ego and agent length and width, true rectangles by corners and edges; else q, the ellipse of the ego frame.
    """
    first = np.full(len(positions), -1)
    for t, pose in enumerate(poses):
        away = positions[:, t] - pose[:2]
        if q is not None:
            body = away @ spin(pose[2])
            hit = np.einsum("ni,ij,nj->n", body, q, body) <= 1
        else:
            sums = corners(*sizes[:2], pose[2])[:, None] + corners(*sizes[2:], headings[t])[None]
            planes = ConvexHull(sums.reshape(-1, 2)).equations
            hit = (away @ planes[:, :2].T + planes[:, 2] <= 0).all(axis=1)
        first[(first < 0) & hit] = t
    return first


def hits_of_factors(xi, poses, means, factors, headings, sizes=None, q=None):
    """How many of the trajectories mean + factor ξ collide; ξ (2, n), sizes and q as in `sampled_hits`."""
    # at each step one ellipse, or strips |n·x + c| ≤ reach (opposite edges are parallel), in the plane of ξ
    forms, strips = np.zeros((len(poses), 6)), np.zeros((len(poses), 0 if sizes is None else 4, 4))
    for t, pose in enumerate(poses):
        away, f = means[t] - pose[:2], factors[t]
        if q is not None:
            form = spin(pose[2]) @ q @ spin(pose[2]).T
            (a, b), (_, d) = f.T @ form @ f
            forms[t] = [a, 2 * b, d, *(2 * f.T @ form @ away), away @ form @ away - 1.0]
        else:
            sums = corners(*sizes[:2], pose[2])[:, None] + corners(*sizes[2:], headings[t])[None]
            found = np.unique(ConvexHull(sums.reshape(-1, 2)).equations.round(12), axis=0)
            found = found[: len(found) // 2]  # sorted: the first half are the second's opposites
            strips[t, : len(found)] = np.column_stack([found[:, :2] @ f, found[:, :2] @ away, -found[:, 2]])
    return sum(_hits_of_factors(*xi[:, i : i + 10_000], forms, strips) for i in range(0, xi.shape[1], 10_000))


@nb.njit
def _hits_of_factors(xs, ys, forms, strips):
    hit, here = np.zeros(len(xs), np.uint8), np.empty(len(xs), np.uint8)
    for t in range(len(forms)):
        a, b, d, e, f, g = forms[t]
        for n in range(len(xs)):  # no branches: several at a time
            x, y = xs[n], ys[n]
            here[n] = (a * x + b * y + e) * x + (d * y + f) * y + g <= 0.0
        for a, b, c, reach in strips[t]:
            for n in range(len(xs)):
                here[n] &= abs(a * xs[n] + b * ys[n] + c) <= reach
        for n in range(len(xs)):
            hit[n] |= here[n]
    return np.sum(hit)


def slices_mp(sets, digits=70):
    """`union_mass` with the integral in mpmath: Gauss rules between breaks of the rims, square-root ends removed."""
    grid = np.linspace(-38, 38, 15201)
    breaks = np.unique(_breaks(sets, grid))
    inside = grid[::20][(grid[::20] > breaks[0]) & (grid[::20] < breaks[-1])]
    cuts = [float(c) for c in np.unique(np.concatenate([breaks, inside]))]
    with mp.workdps(digits):
        total, (nodes, weights) = mp.mpf(0), np.polynomial.legendre.leggauss(20)
        # square-root ends at every cut: u² on either half
        for low, high in itertools.pairwise(cuts):
            half = (high - low) / 2
            for side in (1, -1):
                start = low if side > 0 else high
                for x, w in zip(nodes, weights, strict=True):
                    u = 0.5 + 0.5 * x
                    total += w * half * u * _slice_mp(sets, start + side * half * u * u)
        return float(total)


def _slice_mp(sets, x):
    total, reach = mp.mpf(0), mp.ninf
    for low, high in sorted((mp.mpf(float(c[0][0])), mp.mpf(float(c[1][0]))) for c in (s(np.array([x])) for s in sets)):
        start = max(low, reach)
        if high > start:
            total += (mp.erfc(start / mp.sqrt(2)) - mp.erfc(high / mp.sqrt(2))) / 2
            reach = high
    return total * mp.exp(-(mp.mpf(x) ** 2) / 2) / mp.sqrt(2 * mp.pi)
