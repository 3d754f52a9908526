"""Charging risk to a motion: the hot loop of planning, over steps × agents × modes × pieces."""

import math

import numba as nb
import numpy as np

from checkers.kernels.abi import ROOM, call_kernel
from checkers.kernels.gaussian import half_space
from checkers.kernels.whiten import to_disc, to_ego, whiten_moments

# columns of the agent rows; central moments follow
MEAN_X, MEAN_Y, C11, C12, C22, DET, WEIGHT, CULL, MOMENTS = range(9)
REACH, AHEAD, ASIDE = range(3)  # of the extents


FAR = 13.0  # a mode is culled beyond as many σ
FAR_RISK = 6.2e-39  # > Φ(−13): what a culled mode can at most add per step

# a piece bounded by less than this share of what is charged already is charged its bound
_MINOR = 3e-3
_SMALL = 0.1  # share of what is left to overstate that the whole shape of one mode may take


@nb.njit(cache=True, error_model="numpy")
def row_risk(fixed, row, first, last, x, y, cos, sin, negligible, idle, floor, minor, room):
    """(risk of one agent mode at one pose, what of it idle pieces were bounded by): the union bound over its pieces.

    Where `minor` > 0 (Gaussian modes under an exact backend) a half-space bound, P ≤ Φ(−(|m| − 1)/σ_m) in the direction
    of m or that of the likeliest point, stands for the whole shape where their sum is at most `negligible`, and for a
    piece where it is at most `idle`, or `minor` times the likeliest piece: the value is then high by no more.
    """
    address, options, order, pieces = fixed
    bounds, scratch, out = room
    d1, d2, e11, e12, e22 = to_ego(x, y, cos, sin, row[MEAN_X], row[MEAN_Y], row[C11], row[C12], row[C22])
    scratch_at, options_at, out_at = scratch.ctypes.data, options.ctypes.data, out.ctypes.data
    value, bounded, top = 0.0, 0.0, -1
    if minor > 0.0:
        together, largest, top = piece_bounds(pieces, row, first, last, x, y, cos, sin, idle, floor, bounds)
        if together <= negligible or largest <= idle:
            return min(together, 1.0), together
        m1, m2, s11, s12, s22, det = to_disc(pieces, top, d1, d2, e11, e12, e22, row[DET])
        value = call_kernel(address, m1, m2, s11, s12, s22, det, scratch_at, 0, options_at, out_at)
    for p in range(first, last):
        if p == top:
            continue
        if minor > 0.0 and bounds[p] <= max(minor * value, idle):
            value += bounds[p]
            if bounds[p] <= idle:
                bounded += bounds[p]
            continue
        m1, m2, s11, s12, s22, det = to_disc(pieces, p, d1, d2, e11, e12, e22, row[DET])
        if order > 0:
            whiten_moments(pieces, p, cos, sin, row[MOMENTS:], order, scratch)
        value += call_kernel(address, m1, m2, s11, s12, s22, det, scratch_at, order, options_at, out_at)
    return min(value, 1.0), bounded


@nb.njit(cache=True, error_model="numpy")
def piece_bounds(pieces, row, first, last, x, y, cos, sin, idle, floor, bounds):
    """Fill bounds (P,) of the pieces' risks; their sum, the largest and whose it is."""
    d1, d2, e11, e12, e22 = to_ego(x, y, cos, sin, row[MEAN_X], row[MEAN_Y], row[C11], row[C12], row[C22])
    top, largest, together = -1, 0.0, 0.0
    for p in range(first, last):
        m1, m2, s11, s12, s22, det = to_disc(pieces, p, d1, d2, e11, e12, e22, row[DET])
        bound = _direction_bound(m1, m2, s11, s12, s22)
        if bound > idle:
            bound = min(bound, half_space(m1, m2, s11, s12, s22, det))
        bounds[p] = max(bound, floor)
        together += bounds[p]
        if bounds[p] > largest:
            largest, top = bounds[p], p
    return together, largest, top


@nb.njit(inline="always", error_model="numpy")
def _direction_bound(m1, m2, s11, s12, s22):
    r2 = m1 * m1 + m2 * m2
    if not r2 > 1.0:  # NaN too: what is not known is not far
        return 1.0
    spread = math.sqrt(2.0 * (m1 * m1 * s11 + 2.0 * m1 * m2 * s12 + m2 * m2 * s22) / r2)
    return 0.5 * math.erfc((math.sqrt(r2) - 1.0) / spread) if spread > 0.0 else 0.0


@nb.njit(inline="always", error_model="numpy")
def squared_gap(dx, dy, c11, c12, c22, reach):
    """Squared distance in σ along the line of centres from the mean to the whole shape; 0 within its reach."""
    r2 = dx * dx + dy * dy
    gap = math.sqrt(r2) - reach
    along, across = dx * dx * c11, dy * dy * c22
    # in a covariance of rank 1 rounding may leave less than nothing
    spread = max(along + 2.0 * dx * dy * c12 + across, 4e-16 * (along + across))
    return gap * gap * r2 / spread if gap > 0.0 else 0.0


@nb.njit(inline="always", error_model="numpy")
def squared_gap_of_sides(dx, dy, c11, c12, c22, cos, sin, ahead, aside):
    """The same along the ego's axes to the box |x| ≤ ahead, |y| ≤ aside about the whole shape, the larger of both.

    Traffic in the next lane is within the reach of a long body, and beside it all the same.
    """
    d1, d2 = abs(cos * dx + sin * dy) - ahead, abs(cos * dy - sin * dx) - aside
    mixed = 2.0 * cos * sin * c12
    gap = 0.0
    # the spread is rounded up: what is left of a difference may be rounding alone
    if d1 > 0.0:
        turned = cos * cos * c11 + sin * sin * c22
        gap = d1 * d1 / (turned + mixed + 1e-15 * turned)
    if d2 > 0.0:
        turned = sin * sin * c11 + cos * cos * c22
        gap = max(gap, d2 * d2 / (turned - mixed + 1e-15 * turned))
    return gap


@nb.njit(inline="always", error_model="numpy")
def beyond(gap):
    """Φ(−d) for a squared gap d²; 1 within the shape's reach."""
    return 0.5 * math.erfc(math.sqrt(0.5 * gap)) if gap > 0.0 else 1.0


@nb.njit(cache=True, error_model="numpy")
def charge(
    address,
    options,
    order,
    rows,
    index,
    extents,
    pieces,
    groups,
    group_owner,
    additive,
    small,
    caps,
    suspect,
    given,
    poses,
    first_step,
    before,
    limit,
    after,
):
    """Add the risk of poses (S, 3) at grid steps first_step… to the accumulators; return the total so far.

    A group is what accumulates by itself: one mode of an agent with persistent modes, or a whole agent with per-step
    modes. after[g] = before[g] − Σ log(1 − r_g) (or + Σ r_g if `additive`), total = Σ_g outer_g (1 − e^−after[g]).
    Stops, returning a total above `limit`, as soon as the limit is passed. The mode that broke the limit last is asked
    first: if it alone breaks it again, no other is.

    Args:
        rows: (T, M, 8 + moments) of all agent modes on the grid, WEIGHT NaN before a prediction begins.
        index: (M, 3) group, first and last piece of each row; extents (M, 3) [m] of its shape about the ego's centre,
            along the ego's axis and across.
        groups: (G,) outer weights; group_owner (G,) their agents, in order.
        caps: on the risk of every step, over all agents, and on that of every agent so far; infinite for none. Above
            one of them NaN is returned, which is within no limit.
        small: (negligible, Φ⁻¹(negligible)², idle, floor): risk of a piece that is charged by a bound instead, and of
            all modes together per step of the motion, first come, first served; the least that the backend states of a
            piece. All are 0 for backends that are no Gaussian's.
        suspect: (1,) the row that broke the limit last, −1 for none; updated.
        given: (S, M) risks worked out elsewhere, or (0, 0).
    """
    steps = poses.shape[0]
    room = (np.empty(pieces.shape[0]), np.empty((order + 1) ** 2), np.empty(ROOM))
    fixed = (address, options, order, pieces)
    elsewhere, spare = given.shape[0] > 0, small[2] * steps
    asked, likely = np.empty(steps), -1 if elsewhere or limit == np.inf else suspect[0]
    if likely >= 0:
        g = index[likely, 0]
        if _breaks(
            fixed,
            rows,
            index,
            extents,
            likely,
            groups[g],
            additive,
            small,
            poses,
            first_step,
            before[g],
            limit,
            asked,
            room,
        ):
            return np.inf
    step_risk = np.zeros(groups.shape[0])
    near, gaps = np.empty(index.shape[0], np.int64), np.empty(index.shape[0])
    negligible, _, _, floor = small
    minor = _MINOR if negligible > 0.0 else 0.0
    after[:] = before
    most = total_of(groups, after, additive)  # never below the total
    for s in range(steps - 1, -1, -1):  # what breaks a limit is rather at the end
        x, y, heading = poses[s, 0], poses[s, 1], poses[s, 2]
        if not math.isfinite(x + y + heading):
            return np.nan
        cos, sin = math.cos(heading), math.sin(heading)
        step = first_step + s
        if likely >= 0:
            step_risk[index[likely, 0]] += asked[s]
        count = _cull(rows, step, index, extents, x, y, cos, sin, small, likely, step_risk, near, gaps)
        for n in range(count):
            m = near[n]
            g, first, last, weight = index[m, 0], index[m, 1], index[m, 2], rows[step, m, WEIGHT]
            # each of the pieces lies beyond what the whole shape lies beyond
            r = weight * (last - first) * beyond(gaps[n]) if minor > 0.0 else np.inf
            if elsewhere:
                r = weight * given[s, m]
            elif r > _SMALL * spare:
                r, _ = row_risk(
                    fixed, rows[step, m], first, last, x, y, cos, sin, spare, negligible, floor, minor, room
                )
                r *= weight
            if r <= spare:
                spare -= r
            step_risk[g] += r
            if groups[g] * step_risk[g] > limit:  # one mode alone
                suspect[0] = m
                return np.inf
        grown = _settle(step_risk, groups, after, additive)
        if not grown <= caps[0] or (caps[1] < np.inf and _riskiest(groups, group_owner, after, additive) > caps[1]):
            return np.nan
        most += grown
        if most > limit:
            most = total_of(groups, after, additive)
            if most > limit:
                suspect[0] = _largest(groups, after, index)
                return most
    return total_of(groups, after, additive)


@nb.njit(cache=True, error_model="numpy")
def _cull(rows, step, index, extents, x, y, cos, sin, small, skipped, step_risk, near, gaps):
    """List in near (M,) the modes that have to be looked at, with squared gaps (M,), and charge far ones their bound.

    No view of an array is made here: counting references would take longer than all else.
    """
    negligible, quantile, _, _ = small
    count = 0
    for m in range(index.shape[0]):
        weight = rows[step, m, WEIGHT]
        if not weight > 0.0 or m == skipped:
            continue
        dx, dy = rows[step, m, MEAN_X] - x, rows[step, m, MEAN_Y] - y
        if dx * dx + dy * dy > rows[step, m, CULL]:
            continue
        gap = 0.0
        if negligible > 0.0:
            c11, c12, c22 = rows[step, m, C11], rows[step, m, C12], rows[step, m, C22]
            gap = squared_gap(dx, dy, c11, c12, c22, extents[m, REACH])
            if gap <= quantile:
                ahead, aside = extents[m, AHEAD], extents[m, ASIDE]
                gap = max(gap, squared_gap_of_sides(dx, dy, c11, c12, c22, cos, sin, ahead, aside))
            if gap > quantile:  # every piece lies beyond a half-space as unlikely as that
                step_risk[index[m, 0]] += weight * negligible * (index[m, 2] - index[m, 1])
                continue
        near[count], gaps[count] = m, gap
        count += 1
    return count


@nb.njit(cache=True, error_model="numpy")
def _breaks(fixed, rows, index, extents, mode, weight, additive, small, poses, first_step, spent, limit, asked, room):
    """Whether one mode alone breaks the limit; fills asked (S,) with its risks on the way."""
    negligible, _, _, floor = small
    minor = _MINOR if negligible > 0.0 else 0.0
    near, gaps, nothing = np.empty(1, np.int64), np.empty(1), np.zeros(1)
    alone = np.array([[0, index[mode, 1], index[mode, 2]]])
    for s in range(poses.shape[0]):
        x, y = poses[s, 0], poses[s, 1]
        cos, sin = math.cos(poses[s, 2]), math.sin(poses[s, 2])
        row = rows[first_step + s, mode]
        nothing[0] = 0.0
        only = rows[:, mode : mode + 1]
        if _cull(only, first_step + s, alone, extents[mode : mode + 1], x, y, cos, sin, small, -1, nothing, near, gaps):
            first, last = index[mode, 1], index[mode, 2]
            r, _ = row_risk(fixed, row, first, last, x, y, cos, sin, 0.0, negligible, floor, minor, room)
            r *= row[WEIGHT]
        else:
            r = nothing[0]
        asked[s] = r
        if r > 0.0:
            spent = spend(spent, r, additive)
        if weight * (spent if additive else -math.expm1(-spent)) > limit:
            return True
    return False


@nb.njit(inline="always", error_model="numpy")
def spend(spent, risk, additive):
    """What is spent after one more risk: the sum, or −Σ log(1 − r)."""
    if additive:
        return spent + risk
    if risk < 1e-8:
        return spent + risk * (1.0 + 0.5 * risk)  # −log(1 − r), to rounding
    return spent - math.log1p(-risk) if risk < 1.0 else np.inf


@nb.njit(cache=True, error_model="numpy")
def _settle(step_risk, groups, after, additive):
    """Spend what the groups risk at a step, and forget it; returns by how much the total grows at most.

    NaN if a backend does not know: that must not pass for no risk.
    """
    grown = 0.0
    for g in range(groups.shape[0]):
        r = step_risk[g]
        if r > 0.0:
            after[g] = spend(after[g], r, additive)
            grown += groups[g] * r
        elif r != r:
            return np.nan
        step_risk[g] = 0.0
    return grown


@nb.njit(cache=True, error_model="numpy")
def _riskiest(groups, group_owner, accumulated, additive):
    """The highest risk of one agent so far."""
    top, own, agent = 0.0, 0.0, -1
    for g in range(groups.shape[0]):
        if group_owner[g] != agent:
            own, agent = 0.0, group_owner[g]
        own += groups[g] * (accumulated[g] if additive else -math.expm1(-accumulated[g]))
        top = max(top, own)
    return top


@nb.njit(cache=True, error_model="numpy")
def _largest(groups, accumulated, index):
    """A row of the group that has spent most."""
    best = 0
    for m in range(index.shape[0]):
        g, h = index[m, 0], index[best, 0]
        if groups[g] * accumulated[g] > groups[h] * accumulated[h]:
            best = m
    return best


@nb.njit(cache=True, error_model="numpy")
def total_of(groups, accumulated, additive):
    """Total risk of the accumulators: the sum over agents."""
    total = 0.0
    for g in range(groups.shape[0]):
        spent = accumulated[g]
        if spent > 0.0:
            total += groups[g] * (spent if additive or spent < 1e-8 else -math.expm1(-spent))
    return total
