"""The kinematic car on the time grid: constant acceleration, two halves of constant curvature."""

import math

import numba as nb
import numpy as np

from riskplan.kernels.steer import arrays, steer_kernel

# limits, in the order of `vehicles.CurveLimits`
ACCELERATION, DECELERATION, CURVATURE, SPEED, LATERAL, REVERSE = range(6)


@nb.njit(inline="always", error_model="numpy")
def wrap(angle):
    """The same angle in [−π, π)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


@nb.njit(inline="always", error_model="numpy")
def arc(x, y, heading, distance, curvature):
    """Pose after an arc; backwards for a negative distance."""
    turn = distance * curvature
    # chord of an arc: exact, and smooth where the turn vanishes
    half = 0.5 * turn
    chord = distance * (math.sin(half) / half if abs(half) > 1e-8 else 1.0)
    return x + chord * math.cos(heading + half), y + chord * math.sin(heading + half), wrap(heading + turn)


@nb.njit(cache=True, error_model="numpy")
def drive(x, y, heading, speed, acceleration, curvature_1, curvature_2, steps, dt, top_speed, out):
    """Fill out (steps, 5) with x, y, heading, speed, 0 at the end of every step.

    Acceleration is constant until the speed reaches 0 or `top_speed`; curvature changes after half of the steps.
    Every step is an exact arc.
    """
    for i in range(steps):
        after = speed + acceleration * dt
        if after < 0.0:
            distance = 0.5 * speed * speed / -acceleration
            after = 0.0
        elif after > top_speed and acceleration > 0.0:
            ramp = max(top_speed - speed, 0.0) / acceleration
            after = max(top_speed, speed)
            distance = 0.5 * (speed + after) * ramp + after * (dt - ramp)
        else:
            distance = 0.5 * (speed + after) * dt
        x, y, heading = arc(x, y, heading, distance, curvature_1 if 2 * i < steps else curvature_2)
        speed = after
        out[i, 0], out[i, 1], out[i, 2], out[i, 3], out[i, 4] = x, y, heading, speed, 0.0


@nb.njit(cache=True, error_model="numpy")
def lane_frame(x, y, heading, lanes):
    """(direction, offset) of the closest lane piece that does not run against `heading`; offset is NaN without one.

    lanes: (E, 6) rows x0, y0, direction cos, direction sin, length, heading.
    """
    best, direction, offset = np.inf, heading, np.nan
    for e in range(lanes.shape[0]):
        rx, ry = x - lanes[e, 0], y - lanes[e, 1]
        along = rx * lanes[e, 2] + ry * lanes[e, 3]
        across = ry * lanes[e, 2] - rx * lanes[e, 3]
        beyond = max(-along, along - lanes[e, 4], 0.0)
        distance = across * across + beyond * beyond
        if distance < best and abs(wrap(heading - lanes[e, 5])) < 1.6:
            best, direction, offset = distance, lanes[e, 5], across
    return direction, offset


@nb.njit(cache=True, error_model="numpy")
def controls(u1, u2, u3, x, y, heading, speed, steps, dt, limits, lanes):
    """(acceleration, curvature 1, curvature 2) for u in [−1, 1]³, chosen so that plain motions are likely.

    u1 sets the acceleration, u2 the sideways displacement, u3 the heading at the end, both relative to the lane (or to
    the car itself where there is none). Cubes put most samples near "stay in lane, keep speed" and still reach the
    limits. The two curvatures solve the small-angle boundary problem and are then clipped to what the car can do.
    """
    acceleration = u1 * abs(u1) * (limits[ACCELERATION] if u1 > 0.0 else limits[DECELERATION])
    duration = steps * dt
    after = min(max(speed + acceleration * duration, 0.0), limits[SPEED])
    length = 0.5 * (speed + after) * duration
    fastest = max(speed, after)
    most = min(limits[CURVATURE], limits[LATERAL] / max(fastest * fastest, 1e-9))
    if length < 1e-3:
        return acceleration, 0.0, 0.0
    lane, offset = lane_frame(x, y, heading, lanes)
    start = wrap(heading - lane)
    half = 0.5 * length
    if math.isnan(offset):
        end = u3 * min(most * length, math.pi)
        sideways = u2 * 0.5 * most * half * half
    else:
        ahead, _ = lane_frame(x + length * math.cos(lane), y + length * math.sin(lane), lane, lanes)
        end = wrap(ahead - lane) + 0.3 * u3 * u3 * u3
        # half of the samples steer to the middle of the lane, the others to a place beside
        if abs(u2) < 0.5:
            sideways = -offset * min(2.0 * abs(u2), 1.0)
        else:
            spread = 2.0 * (abs(u2) - 0.5)
            sideways = math.copysign(4.0 * spread * spread, u2)
    middle = sideways / half - 0.5 * (start + end)
    curvature_1 = min(max((middle - start) / half, -most), most)
    reached = start + curvature_1 * half
    curvature_2 = min(max((end - reached) / half, -most), most)
    return acceleration, curvature_1, curvature_2


@steer_kernel
def steer(node_, u1, u2, u3, steps, dt, limits_, lanes_, count, out_):
    """See `riskplan.kernels.steer`."""
    node, limits, lanes, out = arrays(node_, limits_, lanes_, count, out_, steps)
    x, y, heading, speed = node[0], node[1], node[2], node[3]
    a, k1, k2 = controls(u1, u2, u3, x, y, heading, speed, steps, dt, limits, lanes)
    drive(x, y, heading, speed, a, k1, k2, steps, dt, limits[SPEED], out)
    for i in range(steps):
        if abs(k1 if 2 * i < steps else k2) * out[i, 3] ** 2 > limits[LATERAL] * 1.0001:
            return i
    return steps
