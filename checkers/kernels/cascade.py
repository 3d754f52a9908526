"""The cheapest test that decides: far field, likeliest direction, tangent, and only then the exact risk."""

import math

import numba as nb
import numpy as np

from checkers.kernels.gaussian import disc, eigen, nearest
from checkers.kernels.whiten import to_disc, to_ego

FAR, DIRECTION, TANGENT, EXACT = range(4)


@nb.njit(cache=True, error_model="numpy")
def bounded_risk(m1, m2, s11, s12, s22, det, square, enough):
    """(risk, its error, stage): `enough` if a cheap stage shows that P(|y| ≤ 1) is no higher, else the exact value.

    `square` is Φ⁻¹(enough)², so that the first stages compare squares; P ≤ Φ(−d) for the distance d in σ to any
    half-space that holds the disc.
    """
    r2 = m1 * m1 + m2 * m2
    if r2 > 1.0 and square > 0.0:
        gap = math.sqrt(r2) - 1.0
        if gap * gap > square * (s11 + s22):
            return enough, 0.0, FAR
        if gap * gap * r2 > square * (m1 * m1 * s11 + 2.0 * m1 * m2 * s12 + m2 * m2 * s22):
            return enough, 0.0, DIRECTION
        big, small, v1, v2 = eigen(s11, s12, s22, det)
        _, _, d2 = nearest(-v2 * m1 + v1 * m2, v1 * m1 + v2 * m2, small, big)
        if d2 > square:
            return enough, 0.0, TANGENT
    value, error = disc(m1, m2, s11, s12, s22, det)
    return value, error, EXACT


@nb.njit(cache=True, error_model="numpy")
def union_risk(pieces, x, y, cos, sin, mean, cov, square, enough, stages):
    """Sum over the pieces of a shape, `enough` for each; counts in `stages` which one decided. mean (2,), cov (4,)."""
    d1, d2, e11, e12, e22 = to_ego(x, y, cos, sin, mean[0], mean[1], cov[0], cov[1], cov[2])
    total = 0.0
    for p in range(pieces.shape[0]):
        m1, m2, s11, s12, s22, det = to_disc(pieces, p, d1, d2, e11, e12, e22, cov[3])
        risk, _, stage = bounded_risk(m1, m2, s11, s12, s22, det, square, enough)
        total += risk
        stages[stage] += 1
    return min(total, 1.0)


@nb.njit(cache=True, error_model="numpy")
def decide(pieces, poses, means, covariances, square, limit, within, stages):
    """Fill within (T, K): is the risk at most `limit`? `square` belongs to limit / pieces."""
    enough = limit / pieces.shape[0]
    for t in range(poses.shape[0]):
        cos, sin = math.cos(poses[t, 2]), math.sin(poses[t, 2])
        for k in range(means.shape[1]):
            mean, cov = means[t, k], covariances[t, k]
            total = union_risk(pieces, poses[t, 0], poses[t, 1], cos, sin, mean, cov, square, enough, stages)
            if total > limit:
                # cheap bounds of some pieces may have pushed the sum over
                total = union_risk(pieces, poses[t, 0], poses[t, 1], cos, sin, mean, cov, 0.0, 0.0, stages)
            within[t, k] = total <= limit


@nb.njit(cache=True, error_model="numpy")
def accumulate(pieces, poses, means, covariances, weights, persistent, square, enough, budget, stages):
    """(step, total, sure): the first step after which the risk so far is above the budget, or −1, and the risk then.

    Risks found to be at most `enough` are left out; not sure if they could make a difference.
    """
    modes = means.shape[1]
    spent = np.zeros(modes)
    total, left_out = 0.0, 0.0
    for t in range(poses.shape[0]):
        cos, sin = math.cos(poses[t, 2]), math.sin(poses[t, 2])
        step = 0.0
        for k in range(modes):
            seen = stages[EXACT]
            r = union_risk(
                pieces, poses[t, 0], poses[t, 1], cos, sin, means[t, k], covariances[t, k], square, enough, stages
            )
            bounded = pieces.shape[0] - (stages[EXACT] - seen)
            r = max(r - bounded * enough, 0.0)
            left_out += bounded * enough
            if persistent:
                spent[k] -= math.log1p(-r) if r < 1.0 else -np.inf
            else:
                step += weights[t, k] * r
        if not persistent:
            spent[0] -= math.log1p(-step) if step < 1.0 else -np.inf
        total = 0.0
        for k in range(modes if persistent else 1):
            total -= (weights[0, k] if persistent else 1.0) * math.expm1(-spent[k])
        if total + left_out > budget:
            return t, total, total > budget
    return -1, total, True
