"""Directed edges of a roadmap, and driving along them on the time grid."""

import math

import numba as nb
import numpy as np

from riskplan.kernels.car import ACCELERATION, DECELERATION, LATERAL, SPEED, wrap
from riskplan.kernels.dubins import along, biarc, shortest
from riskplan.kernels.world import goal_region, path_free

# accelerations, relative to the limits, with which an edge is driven
_PACES = np.array([0.0, 0.3, -0.2, 0.8, -0.6, -1.0])
# most arrival times tried on an edge into the goal
ARRIVALS = 12
_GREED = 0.5  # by which a least ride is longer in the rank
# steps after which one who drives on, or stands, decides anew
_LONGEST, _WAIT = 15, 5
# longest way to a standstill at the end of an edge, in steps
_HALT = 40
# edge numbers of children that stay where they are: one waits, the other turns to driving the other way
WAITS, TURNS = -1, -2
# columns of a child, see `expand`, and most children of an edge
CHILD, CHILDREN = 9, _PACES.shape[0] + ARRIVALS + 1
# limits, after those of `vehicles.CurveLimits` as far as LATERAL: the top speed of a vehicle that may turn later
TOP = LATERAL + 1


@nb.njit(cache=True, error_model="numpy")
def join(a, b, radii, kind, curve):
    """Fill `curve` (6,) with a way from pose a to pose b; its length, or infinity if it turns more than it must.

    Kind 0 is a biarc, if the last radius, the tightest, allows for it: of the ways without a straight part it bends
    least. Kind k > 0 is the Dubins curve of radius k − 1, which may keep closer to a lane round a corner.
    """
    most = 1.15 * math.hypot(b[0] - a[0], b[1] - a[1]) + 0.2
    if kind == 0:
        length = biarc(a[0], a[1], a[2], b[0], b[1], b[2], curve)
        if max(abs(curve[3]), abs(curve[5])) * radii[-1] > 1.0:
            return np.inf
    else:
        length = shortest(a[0], a[1], a[2], b[0], b[1], b[2], radii[kind - 1], curve)
    return length if length <= most else np.inf


@nb.njit(cache=True, error_model="numpy")
def connect(sources, targets, radii, shortest_edge, longest_edge, most, world):
    """Edges from every source pose to at most `most` target poses ahead of it, free of the static world.

    An edge is kept if it is between the lengths given and hardly longer than the straight line; of the kinds of `join`
    the first that is free is taken. Targets come in their (random) order, so that few edges still point everywhere.

    Returns:
        (E, 2) int source and target, (E,) kinds, (E, 6) curves, (E,) lengths.
    """
    ends = np.empty((sources.shape[0] * most, 2), np.int64)
    kinds = np.empty(sources.shape[0] * most, np.int64)
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
            for kind in range(radii.shape[0] + 1):
                length = join(sources[i], targets[j], radii, kind, curves[count])
                kinds[count] = kind
                if length < np.inf and _free(sources[i], curves[count], length, world):
                    break
                length = np.inf
            if length == np.inf:
                continue
            ends[count, 0], ends[count, 1], lengths[count] = i, j, length
            count += 1
            found += 1
            if found == most:
                break
    return ends[:count], kinds[:count], curves[:count], lengths[:count]


@nb.njit(cache=True, error_model="numpy")
def rejoin(vertices, ends, kinds, radii):
    """(E, 6) curves and (E,) lengths of the edges between given pairs of vertices; infinite where there is none."""
    curves, lengths = np.zeros((ends.shape[0], 6)), np.empty(ends.shape[0])
    for e in range(ends.shape[0]):
        lengths[e] = join(vertices[ends[e, 0]], vertices[ends[e, 1]], radii, kinds[e], curves[e])
    return curves, lengths


@nb.njit(cache=True, error_model="numpy")
def _free(source, curve, length, world):
    """Whether the body is off the static world all along."""
    count = int(length / world[0]) + 1
    poses = np.empty((count, 3))
    for i in range(count):
        poses[i, 0], poses[i, 1], poses[i, 2] = along(source[0], source[1], source[2], curve, length * (i + 1) / count)
    return path_free(source[0], source[1], source[2], poses, count, world)


@nb.njit(inline="always", error_model="numpy")
def _bend(curve, begin, end):
    """Largest |curvature| between two arclengths."""
    most, at = 0.0, 0.0
    for i in range(3):
        after = at + curve[i] if i < 2 else np.inf
        if after > begin and at < end:
            most = max(most, abs(curve[3 + i]))
        at = after
    return most


@nb.njit(inline="always", error_model="numpy")
def _faster(speed, a, dt, top):
    """Speed a step later: to a standstill, or to the top speed, at the end of a step, not within it."""
    return max(min(speed + a * dt, max(top, speed)), 0.0)


@nb.njit(cache=True, error_model="numpy")
def _cornering(curve, begin, length, limits):
    """Speed at which the sharpest bend that is left of an edge can be taken."""
    bend = _bend(curve, begin, length)
    return min(limits[SPEED], math.sqrt(limits[LATERAL] / bend)) if bend > 0.0 else limits[SPEED]


@nb.njit(cache=True, error_model="numpy")
def traverse(pose, curve, length, child, label, dt, latest, earliest, limits, world, goal, out):
    """Drive a child along its edge. Returns (steps driven, arrived), −1 steps if the world is in the way.

    pose: (3,) where the edge begins; child: a row of `expand`; label: (x, y, heading, speed, place, step, pending,
    fastest), see `expand`. A pending pose is driven first. Ends early in the goal. out: (S, 4) x, y, heading, speed.
    """
    steps, a, pending, brakes = int(child[1]), child[2], child[6] > 0.0, int(child[8])
    speed, place, step = label[3], label[4], int(label[5])
    top = _cornering(curve, place, length, limits)
    count, arrived = 0, False
    for i in range(0 if label[6] > 0.0 else 1, steps if pending else steps + 1):
        if step + i > latest:
            break
        if i > 0:
            after = _faster(speed, a, dt, top) if brakes == 0 or i <= brakes else speed - speed / (steps - i + 1)
            place, speed = place + 0.5 * (speed + after) * dt, after
        px, py, ph = along(pose[0], pose[1], pose[2], curve, place)
        out[count, 0], out[count, 1], out[count, 2], out[count, 3] = px, py, ph, speed
        count += 1
        if step + i >= earliest and goal_region(px, py, ph, speed, *goal) >= 0:
            arrived = True
            break
    if not path_free(label[0], label[1], label[2], out, count, world):
        return -1, False
    return count, arrived


@nb.njit(cache=True, error_model="numpy")
def expand(edges, label, here, turned, window, lengths, curves, final, away, road, dt, limits, out):
    """Children of a label: its edges at all paces that can still reach the goal. Returns how many.

    A label stands for the ego at a step, at a place beyond the vertex where its edges begin. Where that vertex has
    just been passed the pose is pending: it lies on the edge that is chosen next, which drives it first.

    Args:
        edges: (first, last + 1) of the edges it may take.
        label: as of `traverse`.
        here: way to the goal from where the label is, for the rank; turned: the same for driving the other way from
            there; negative for a vehicle that cannot, infinite where it may not.
        window: earliest and latest step of an arrival.
        final: (E,) whether an edge ends in a goal pose.
        away: (E,) lower bound of the distance from an edge's end to the goal; road: (E,) way there, for the rank.
        out: (children, CHILD): edge (or WAITS, TURNS), steps, acceleration, rank (see `_rank`), place and speed
            afterwards, whether the pose is pending then, the fastest of the last step, and after how many steps it
            brakes evenly to a standstill at the end of the edge (0: it does not).
    """
    speed, place, step = label[3], label[4], int(label[5])
    earliest, latest = window
    count = 0
    if speed < 0.0:
        return 0  # of a vehicle whose roadmap goes forwards
    if speed == 0.0 and step + _WAIT <= latest:
        count = _stays(WAITS, _WAIT, place, step, here, earliest, dt, limits, count, out)
    if speed == 0.0 and 0.0 <= turned < np.inf:
        count = _stays(TURNS, 0, place, step, turned, earliest, dt, limits, count, out)
    for e in range(edges[0], edges[1]):
        if place >= lengths[e]:
            continue
        if label[6] > 0.0 and _bend(curves[e], 0.0, place) * label[7] ** 2 > limits[LATERAL] * 1.0001:
            continue
        left = lengths[e] - place
        top = _cornering(curves[e], place, lengths[e], limits)
        for p in range(_PACES.shape[0]):
            a = _PACES[p] * (limits[ACCELERATION] if _PACES[p] > 0.0 else limits[DECELERATION])
            if speed == 0.0 and a <= 0.0:
                continue
            count = _child(
                e, a, speed, place, step, curves[e], lengths[e], top, dt, window, limits, away[e], road[e], count, out
            )
        if final[e]:
            soonest = max(earliest - step, 1)
            stride = max(1, (latest - step - soonest) // ARRIVALS)
            tried = 0
            for steps in range(soonest, latest - step + 1, stride):
                duration = steps * dt
                a = 2.0 * (left - speed * duration) / (duration * duration)
                after = speed + a * duration
                fits = -limits[DECELERATION] <= a <= limits[ACCELERATION] and 0.0 <= after <= max(top, speed)
                if fits and _bends(curves[e], speed, a, place, steps, dt, limits):
                    out[count, 0], out[count, 1], out[count, 2], out[count, 3] = e, steps, a, step + steps
                    out[count, 4], out[count, 5], out[count, 6], out[count, 7] = lengths[e], after, 0.0, 0.0
                    out[count, 8] = 0.0
                    count += 1
                    tried += 1
                    if tried == ARRIVALS:
                        break
        if turned >= 0.0:
            steps, first, peak = _halt(speed, left, top, dt, limits)
            if 0 < steps <= latest - step:
                ride = least_time(road[e], 0.0, limits[ACCELERATION], limits[TOP]) / dt
                out[count, 0], out[count, 1], out[count, 2] = e, steps, (peak - speed) / (first * dt)
                out[count, 3] = _rank(step + steps, ride, road[e], 0.0, earliest, dt, limits)
                out[count, 4], out[count, 5], out[count, 6], out[count, 7], out[count, 8] = 0.0, 0.0, 0.0, 0.0, first
                count += 1
    return count


@nb.njit(inline="always", error_model="numpy")
def _stays(kind, steps, place, step, way, earliest, dt, limits, count, out):
    """Append a child that stands."""
    ride = least_time(way, 0.0, limits[ACCELERATION], limits[TOP]) / dt
    out[count, 0], out[count, 1], out[count, 2] = kind, steps, 0.0
    out[count, 3] = _rank(step + steps, ride, way, 0.0, earliest, dt, limits)
    out[count, 4], out[count, 5], out[count, 6], out[count, 7], out[count, 8] = place, 0.0, 0.0, 0.0, 0.0
    return count + 1


@nb.njit(cache=True, error_model="numpy")
def _halt(speed, left, top, dt, limits):
    """The quickest way to a standstill after a distance: an even change of speed, and then even braking.

    Returns (steps, steps of the first part, speed after it); 0 steps if there is none.
    """
    if speed > top:
        return 0, 0, 0.0
    for steps in range(2, _HALT + 1):
        for first in range(1, steps):
            # of ½ dt (first (speed + peak) + (steps − first) peak) = left
            peak = (2.0 * left / dt - first * speed) / steps
            gain = (peak - speed) / (first * dt)
            fits = 0.0 < peak <= top and -limits[DECELERATION] <= gain <= limits[ACCELERATION]
            if fits and peak <= limits[DECELERATION] * (steps - first) * dt:
                return steps, first, peak
    return 0, 0, 0.0


@nb.njit(cache=True, error_model="numpy")
def _child(e, a, speed, place, step, curve, length, top, dt, window, limits, away, road, count, out):
    """Append the way along an edge at one acceleration, until its end, a standstill, or for `_LONGEST` steps."""
    latest, lateral = window[1], limits[LATERAL] * 1.0001
    steps, fastest = 0, speed
    while place < length and steps < _LONGEST and (steps == 0 or speed > 0.0):
        after = _faster(speed, a, dt, top)
        fastest, begin = max(speed, after), place
        place, speed = place + 0.5 * (speed + after) * dt, after
        steps += 1
        # what of the step is beyond the end lies on another edge
        if step + steps <= latest and _bend(curve, begin, min(place, length)) * fastest * fastest > lateral:
            return count
    beyond = max(place - length, 0.0)
    distance = max(away - abs(place - length), 0.0)
    ride = least_time(distance, speed, limits[ACCELERATION], limits[TOP]) / dt
    # an edge that passes the goal's last step can still arrive on the way
    if step + steps < latest and step + steps + ride > latest + 1e-9:
        return count
    passed = place >= length
    out[count, 0], out[count, 1], out[count, 2] = e, steps, a
    left = max(road + length - place, 0.0)
    ride = least_time(left, speed, limits[ACCELERATION], limits[TOP]) / dt
    out[count, 3] = _rank(step + steps, ride, left, speed, window[0], dt, limits)
    out[count, 4], out[count, 5] = beyond if passed else place, speed
    out[count, 6], out[count, 7], out[count, 8] = 1.0 if passed else 0.0, fastest, 0.0
    return count + 1


@nb.njit(inline="always", error_model="numpy")
def _rank(step, ride, distance, speed, earliest, dt, limits):
    """Step of the arrival to be hoped for: that of the least `ride`, half as long again; not before the first allowed,

    and later by the time it takes to change to the speed at which one would arrive then.
    """
    soon = step + (1.0 + _GREED) * ride
    if step >= earliest:
        return soon
    wanted = distance / ((earliest - step) * dt)
    return max(soon, earliest) + abs(wanted - speed) / (limits[ACCELERATION] * dt)


@nb.njit(cache=True, error_model="numpy")
def _bends(curve, speed, a, place, steps, dt, limits):
    """Whether no bend is taken too fast for so many steps."""
    for _ in range(steps):
        after, begin = speed + a * dt, place
        place += 0.5 * (speed + after) * dt
        if _bend(curve, begin, place) * max(speed, after) ** 2 > limits[LATERAL] * 1.0001:
            return False
        speed = after
    return True


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
