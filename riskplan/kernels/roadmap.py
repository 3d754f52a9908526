"""Directed Dubins edges of a roadmap, and driving along them on the time grid."""

import math

import numba as nb
import numpy as np

from riskplan.kernels.car import ACCELERATION, DECELERATION, LATERAL, SPEED, wrap
from riskplan.kernels.dubins import along, shortest
from riskplan.kernels.world import goal_region, swept_free

# accelerations, relative to the limits, with which an edge is tried
_PACES = np.array([0.0, 0.3, -0.2, 0.8, -0.6])
# most arrival times tried on an edge into the goal
ARRIVALS = 12


@nb.njit(cache=True, error_model="numpy")
def connect(sources, targets, radii, shortest_edge, longest_edge, most):
    """Edges from every source pose to at most `most` target poses ahead of it.

    The first of the turning radii (widest first) that needs no loop makes the curve: an edge is kept if it is between
    the lengths given and hardly longer than the straight line. Targets are taken in their (random) order, so that few
    edges still point everywhere.

    Returns:
        (E, 2) int source and target, (E, 6) curves, (E,) lengths.
    """
    ends = np.empty((sources.shape[0] * most, 2), np.int64)
    curves = np.empty((sources.shape[0] * most, 6))
    lengths = np.empty(sources.shape[0] * most)
    count = 0
    for i in range(sources.shape[0]):
        found = 0
        cos, sin = math.cos(sources[i, 2]), math.sin(sources[i, 2])
        for j in range(targets.shape[0]):
            dx, dy = targets[j, 0] - sources[i, 0], targets[j, 1] - sources[i, 1]
            ahead = dx * cos + dy * sin
            if ahead < 0.5 * shortest_edge or abs(dx) > longest_edge or abs(dy) > longest_edge:
                continue
            straight = math.hypot(dx, dy)
            if straight < shortest_edge or straight > longest_edge or ahead < 0.7 * straight:
                continue
            if abs(wrap(targets[j, 2] - sources[i, 2])) > 1.7:
                continue
            length = np.inf
            for radius in radii:
                length = shortest(
                    sources[i, 0],
                    sources[i, 1],
                    sources[i, 2],
                    targets[j, 0],
                    targets[j, 1],
                    targets[j, 2],
                    radius,
                    curves[count],
                )
                if length <= 1.15 * straight + 0.2:
                    break
            if length > 1.15 * straight + 0.2:
                continue
            ends[count, 0], ends[count, 1], lengths[count] = i, j, length
            count += 1
            found += 1
            if found == most:
                break
    return ends[:count], curves[:count], lengths[:count]


@nb.njit(cache=True, error_model="numpy")
def paces(length, speed, curvature, dt, earliest, latest, limits, out):
    """Fill out (P, 2) with (steps, acceleration) that drive `length` in whole steps from `speed`; return how many.

    The acceleration is constant, so that the speed at the end follows from the number of steps. A few accelerations
    are tried, rounded to whole steps; with `earliest` > 0, for an edge into the goal, arrivals spread over
    earliest…latest steps instead.
    """
    top = limits[SPEED]
    if curvature > 0.0:
        top = min(top, math.sqrt(limits[LATERAL] / curvature))
        if speed > top * 1.0001:
            return 0
    count = 0
    if earliest > 0:
        stride = max(1, (latest - earliest) // ARRIVALS)
        for steps in range(earliest, latest + 1, stride):
            count = _add_pace(steps, length, speed, top, dt, limits, count, out)
            if count == ARRIVALS:
                break
        return count
    for p in range(_PACES.shape[0]):
        a = _PACES[p] * (limits[ACCELERATION] if _PACES[p] > 0.0 else limits[DECELERATION])
        under = speed * speed + 2.0 * a * length
        if under <= 0.0:
            continue
        after = math.sqrt(under)
        if speed + after < 1e-6:
            continue
        steps = max(int(round(2.0 * length / (speed + after) / dt)), 1)
        if steps <= latest:
            count = _add_pace(steps, length, speed, top, dt, limits, count, out)
    return count


@nb.njit(cache=True, error_model="numpy")
def _add_pace(steps, length, speed, top, dt, limits, count, out):
    """Append (steps, acceleration) if it is within the limits and not there yet."""
    duration = steps * dt
    a = 2.0 * (length - speed * duration) / (duration * duration)
    after = speed + a * duration
    if after < 0.0 or after > max(top, speed) or a > limits[ACCELERATION] or a < -limits[DECELERATION]:
        return count
    for q in range(count):
        if out[q, 0] == steps:
            return count
    out[count, 0], out[count, 1] = steps, a
    return count + 1


@nb.njit(cache=True, error_model="numpy")
def traverse(x, y, heading, speed, step, curve, steps, acceleration, dt, latest, earliest, world, goal, out):
    """Drive an edge. Returns (steps driven, arrived): 0 if the world is in the way; ends early in the goal.

    out: (S, 4) x, y, heading, speed per step.
    """
    px, py, ph = x, y, heading
    for i in range(min(steps, latest - step)):
        time = (i + 1) * dt
        s = speed * time + 0.5 * acceleration * time * time
        qx, qy, qh = px, py, ph
        px, py, ph = along(x, y, heading, curve, s)
        v = max(speed + acceleration * time, 0.0)
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = px, py, ph, v
        if not swept_free(qx, qy, qh, px, py, ph, world):
            return 0, False
        if step + i + 1 >= earliest and goal_region(px, py, ph, v, *goal) >= 0:
            return i + 1, True
    return min(steps, latest - step), False


@nb.njit(cache=True, error_model="numpy")
def expand(vertex, speed, step, earliest, latest, goals, start, lengths, curves, dt, limits, ends, distance, out):
    """Children (edge, steps, acceleration, key) of a label: all edges at all paces that can still reach the goal.

    goals: first and last+1 vertex that lies in the goal; start (V+1,) offsets of each vertex's edges; distance (V,)
    straight distance of a vertex to the goal. The key is the earliest step at which the goal could be reached that way.
    """
    count = 0
    room = np.empty((max(_PACES.shape[0], ARRIVALS), 2))
    for e in range(start[vertex], start[vertex + 1]):
        curvature = 0.0
        for i in range(3):
            if curves[e, i] > 1e-6:
                curvature = max(curvature, abs(curves[e, 3 + i]))
        # other edges may outlast the horizon: the goal can lie on the way
        soonest, last = (max(earliest - step, 1), latest - step) if goals[0] <= ends[e] < goals[1] else (0, latest)
        for p in range(paces(lengths[e], speed, curvature, dt, soonest, last, limits, room)):
            steps, a = int(room[p, 0]), room[p, 1]
            after = speed + a * steps * dt
            left = least_time(distance[ends[e]], after, limits[ACCELERATION], limits[SPEED])
            key = step + steps + left / dt
            # an edge that passes the goal's last step can still arrive on the way
            if step + steps < latest and key > latest + 1e-9:
                continue
            out[count, 0], out[count, 1], out[count, 2], out[count, 3] = e, steps, a, key
            count += 1
    return count


@nb.njit(inline="always", error_model="numpy")
def least_time(distance, speed, acceleration, top):
    """Time to cover a straight distance at full acceleration up to the top speed."""
    if distance <= 0.0:
        return 0.0
    top = max(top, speed)
    ramp = (top * top - speed * speed) / (2.0 * acceleration)
    if distance <= ramp:
        return (math.sqrt(speed * speed + 2.0 * acceleration * distance) - speed) / acceleration
    return (top - speed) / acceleration + (distance - ramp) / top
