"""The kinematic bicycle on the time grid: one acceleration, two halves of a steering angle aimed at; Runge-Kutta."""

import math

import numba as nb
import numpy as np

from riskplan.kernels.car import controls, wrap
from riskplan.kernels.steer import LIMITS, arrays, steer_kernel

# limits
ACCELERATION, DECELERATION, WHEELBASE, REAR, ANGLE, RATE, SPEED, GRIP = range(8)
_LONGEST = 0.0251  # of an integration step [s]: the error of a grid step of 0.1 s is then below 1e-8 m


@nb.njit(cache=True, error_model="numpy")
def _turning(angle, limits):
    """(slip angle β, turn of the body per distance) at a steering angle."""
    tangent = math.tan(angle)
    slip = math.atan(limits[REAR] * tangent / limits[WHEELBASE])
    return slip, math.cos(slip) * tangent / limits[WHEELBASE]


@nb.njit(cache=True, error_model="numpy")
def _across(speed, angle, rate, limits):
    """Acceleration of the centre across its course, v (ψ̇ + β̇)."""
    slip, turn = _turning(angle, limits)
    share = limits[REAR] / limits[WHEELBASE]
    slip_rate = share * (math.cos(slip) / math.cos(angle)) ** 2 * rate
    return speed * (speed * turn + slip_rate)


@nb.njit(cache=True, error_model="numpy")
def _angle_for(curvature, limits):
    """Steering angle at which the body turns by `curvature` per distance, within the limit."""
    under = 1.0 - (limits[REAR] * curvature) ** 2
    angle = math.copysign(1.5, curvature)
    if under > 0.0:
        # tan δ cos β = wheelbase κ with cos β = 1 / √(1 + (rear tan δ / wheelbase)²)
        angle = math.atan(limits[WHEELBASE] * curvature / math.sqrt(under))
    return min(max(angle, -limits[ANGLE]), limits[ANGLE])


@nb.njit(cache=True, error_model="numpy")
def _slope(heading, speed, angle, limits):
    slip, turn = _turning(angle, limits)
    return speed * math.cos(heading + slip), speed * math.sin(heading + slip), speed * turn


@nb.njit(cache=True, error_model="numpy")
def _integrate(x, y, heading, speed, angle, a, rate, dt, limits):
    """Pose after dt."""
    count = int(dt / _LONGEST) + 1
    h = dt / count
    for i in range(count):
        v, d = speed + a * i * h, angle + rate * i * h
        x1, y1, h1 = _slope(heading, v, d, limits)
        vm, dm = v + 0.5 * a * h, d + 0.5 * rate * h
        x2, y2, h2 = _slope(heading + 0.5 * h * h1, vm, dm, limits)
        x3, y3, h3 = _slope(heading + 0.5 * h * h2, vm, dm, limits)
        x4, y4, h4 = _slope(heading + h * h3, v + a * h, d + rate * h, limits)
        x += h / 6.0 * (x1 + 2.0 * (x2 + x3) + x4)
        y += h / 6.0 * (y1 + 2.0 * (y2 + y3) + y4)
        heading += h / 6.0 * (h1 + 2.0 * (h2 + h3) + h4)
    return x, y, wrap(heading)


@nb.njit(cache=True, error_model="numpy")
def _holds(speed, after, angle, turned, a, rate, limits):
    """Whether the tyres hold over a step: at its ends and, between them, at fifths."""
    for i in range(6):
        share = 0.2 * i
        across = _across(speed + share * (after - speed), angle + share * (turned - angle), rate, limits)
        if a * a + across * across > limits[GRIP] ** 2:
            return False
    return True


@nb.njit(cache=True, error_model="numpy")
def _rate_that_holds(speed, angle, wanted, a, dt, limits):
    """The steering rate nearest to `wanted` at which the tyres hold, of a few from it to straightening; NaN: none."""
    after = speed + a * dt
    straighten = min(max(-angle / dt, -limits[RATE]), limits[RATE])
    for i in range(7):
        rate = wanted + (straighten - wanted) * i / 6.0
        if _holds(speed, after, angle, angle + rate * dt, a, rate, limits):
            return rate
    return math.nan


@steer_kernel
def steer(node_, u1, u2, u3, steps, dt, limits_, lanes_, count, out_):
    """See `riskplan.kernels.steer`."""
    node, limits, lanes, out = arrays(node_, limits_, lanes_, count, out_, steps)
    x, y, heading, speed, angle = node[0], node[1], node[2], node[3], node[4]
    # what is left across of the friction circle while accelerating so, with a reserve for steering
    hardest = min(limits[ACCELERATION] if u1 > 0.0 else limits[DECELERATION], 0.95 * limits[GRIP])
    a = u1 * abs(u1) * hardest
    car = np.zeros(LIMITS)
    _, turn = _turning(limits[ANGLE], limits)
    car[0] = car[1] = hardest
    car[2], car[3] = turn, limits[SPEED]
    car[4] = 0.9 * math.sqrt(max(limits[GRIP] ** 2 - a * a, 0.0))
    slip, _ = _turning(angle, limits)
    # the centre moves along its course: that is what shall run along the lane
    _, k1, k2 = controls(u1, u2, u3, x, y, wrap(heading + slip), speed, steps, dt, car, lanes)
    first, second = _angle_for(k1, limits), _angle_for(k2, limits)
    for i in range(steps):
        # the acceleration of a step is such that it ends at a standstill or at top speed, not within it
        push = a
        if speed + a * dt < 0.0:
            push = -speed / dt
        elif a > 0.0 and speed + a * dt > limits[SPEED]:
            push = max(limits[SPEED] - speed, 0.0) / dt
        aim = first if 2 * i < steps else second
        wanted = min(max((aim - angle) / dt, -limits[RATE]), limits[RATE])
        rate = _rate_that_holds(speed, angle, wanted, push, dt, limits)
        if math.isnan(rate):
            return i
        x, y, heading = _integrate(x, y, heading, speed, angle, push, rate, dt, limits)
        speed, angle = max(speed + push * dt, 0.0), angle + rate * dt
        out[i, 0], out[i, 1], out[i, 2], out[i, 3], out[i, 4] = x, y, heading, speed, angle
    return steps
