"""Charging risk to a motion whose agents' errors persist: which of the weighted futures drawn beforehand have hit."""

import math

import numba as nb
import numpy as np

from checkers.kernels.path import ALIGNED, BOXES

# columns of the agent rows
MEAN_X, MEAN_Y, HEADING, REACH = range(4)
WORD = 64  # futures in one word of a bit mask


@nb.njit(cache=True, error_model="numpy")
def charge_hits(
    kind, shapes, rows, offsets, farthest, index, shares, groups, owner, caps, poses, first_step, before, limit, after
):
    """Mark the futures that poses (S, 3) at grid steps first_step… hit; return the total so far.

    Accumulators are, for every agent mode, the share of its futures hit so far, and then, for every agent mode, the
    bit mask of those futures, its words stored in the place of floats. Stops, returning a total above `limit`, as soon
    as the limit is passed.

    Args:
        kind: of the shapes, as in `checkers.kernels.path`.
        shapes: (P, 5) pieces, or (P, 4) half sizes or semi-axes; index (M, 2): first and last of each agent mode.
        rows: (T, M, 4) mean, heading and reach of the shape; NaN before a prediction begins.
        offsets: (T, M, 2, N) of the futures from the mean; farthest (T, M, N/64) of each word's.
        shares: (M, N) weights of the futures, summing to 1; groups (M,) weights of the modes, owner (M,) their agents.
        caps: on what every step adds, over all agents, and on the risk of every agent so far; infinite for none. Above
            one of them NaN is returned, which is within no limit.
    """
    modes, words = farthest.shape[1], farthest.shape[2]
    after[:] = before
    masks = after[modes:].view(np.uint64)
    hit = np.empty(WORD, dtype=np.bool_)
    total = 0.0
    for m in range(modes):
        total += groups[m] * after[m]
    for s in range(poses.shape[0]):
        if not math.isfinite(poses[s, 0] + poses[s, 1] + poses[s, 2]):
            return np.nan
        step, so_far = first_step + s, total
        for m in range(modes):
            if math.isnan(rows[step, m, MEAN_X]):
                continue
            dx, dy = rows[step, m, MEAN_X] - poses[s, 0], rows[step, m, MEAN_Y] - poses[s, 1]
            gap = math.sqrt(dx * dx + dy * dy) - rows[step, m, REACH]
            for w in range(words):
                at = m * words + w
                if farthest[step, m, w] < gap or ~masks[at] == 0:
                    continue
                some = False
                hit[:] = False
                for p in range(index[m, 0], index[m, 1]):
                    some |= enter(
                        kind, shapes[p], dx, dy, poses[s, 2], rows[step, m, HEADING], offsets[step, m], w * WORD, hit
                    )
                if not some:
                    continue
                new = np.uint64(0)
                share = 0.0
                for j in range(WORD):
                    bit = np.uint64(1) << np.uint64(j)
                    if hit[j] and not masks[at] & bit:
                        new |= bit
                        share += shares[m, w * WORD + j]
                masks[at] |= new
                after[m] += share
                total += groups[m] * share
            if total > limit:
                return total
        if total - so_far > caps[0] or (caps[1] < np.inf and _riskiest(groups, owner, after) > caps[1]):
            return np.nan
    return total


@nb.njit(cache=True, error_model="numpy")
def _riskiest(groups, owner, accumulated):
    """The highest risk of one agent so far."""
    top, own, agent = 0.0, 0.0, -1
    for m in range(groups.shape[0]):
        if owner[m] != agent:
            own, agent = 0.0, owner[m]
        own += groups[m] * accumulated[m]
        top = max(top, own)
    return top


@nb.njit(inline="always", error_model="numpy")
def enter(kind, shape, dx, dy, heading, course, offsets, first, hit):
    """Mark those of 64 futures that are in one shape; whether any is."""
    cos, sin = math.cos(heading), math.sin(heading)
    c, s = math.cos(course - heading), math.sin(course - heading)
    if kind == BOXES:
        # separating axes of two rectangles: the sides of either (Gottschalk, Lin & Manocha 1996, in the plane)
        a1, b1, a2, b2 = shape[0], shape[1], shape[2], shape[3]
        ac, as_ = abs(c), abs(s)
        u1, u2 = math.cos(course), math.sin(course)
        return _between(
            np.float32(cos), np.float32(sin), np.float32(cos * dx + sin * dy), np.float32(a1 + ac * a2 + as_ * b2),
            np.float32(-sin), np.float32(cos), np.float32(cos * dy - sin * dx), np.float32(b1 + as_ * a2 + ac * b2),
            np.float32(u1), np.float32(u2), np.float32(u1 * dx + u2 * dy), np.float32(a2 + ac * a1 + as_ * b1),
            np.float32(-u2), np.float32(u1), np.float32(u1 * dy - u2 * dx), np.float32(b2 + as_ * a1 + ac * b1),
            offsets, first, hit,
        )  # fmt: skip
    if kind == ALIGNED:
        p11 = shape[0] ** 2 + (c * shape[2]) ** 2 + (s * shape[3]) ** 2
        p22 = shape[1] ** 2 + (s * shape[2]) ** 2 + (c * shape[3]) ** 2
        p12 = c * s * (shape[2] ** 2 - shape[3] ** 2)
        det = p11 * p22 - p12 * p12
        o1, o2, l11, l21, l22 = 0.0, 0.0, math.sqrt(p22 / det), 0.0, 1.0 / math.sqrt(p22)
        l21 = -p12 / (det * l11)
    else:
        o1, o2, l11, l21, l22 = shape[0], shape[1], shape[2], shape[3], shape[4]
    d1, d2 = cos * dx + sin * dy - o1, cos * dy - sin * dx - o2
    return _within(
        np.float32(l11 * cos - l21 * sin), np.float32(l11 * sin + l21 * cos), np.float32(l11 * d1 + l21 * d2),
        np.float32(-l22 * sin), np.float32(l22 * cos), np.float32(l22 * d2), offsets, first, hit,
    )  # fmt: skip


@nb.njit(inline="always", error_model="numpy")
def _between(a1, a2, a0, al, b1, b2, b0, bl, c1, c2, c0, cl, d1, d2, d0, dl, offsets, first, hit):
    some = False
    for j in range(WORD):
        x, y = offsets[0, first + j], offsets[1, first + j]
        inside = (
            (abs(a0 + a1 * x + a2 * y) <= al)
            & (abs(b0 + b1 * x + b2 * y) <= bl)
            & (abs(c0 + c1 * x + c2 * y) <= cl)
            & (abs(d0 + d1 * x + d2 * y) <= dl)
        )
        hit[j] |= inside
        some |= inside
    return some


@nb.njit(inline="always", error_model="numpy")
def _within(a1, a2, a0, b1, b2, b0, offsets, first, hit):
    some, one = False, np.float32(1.0)
    for j in range(WORD):
        x, y = offsets[0, first + j], offsets[1, first + j]
        m1, m2 = a0 + a1 * x + a2 * y, b0 + b1 * x + b2 * y
        inside = m1 * m1 + m2 * m2 <= one
        hit[j] |= inside
        some |= inside
    return some
