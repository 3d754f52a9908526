"""The Reeds-Shepp car on the time grid: one acceleration until it has changed direction, two halves of curvature."""

import math

from riskplan.kernels.car import ACCELERATION, CURVATURE, DECELERATION, LATERAL, REVERSE, SPEED, arc, controls
from riskplan.kernels.steer import arrays, steer_kernel


@steer_kernel
def steer(node_, u1, u2, u3, steps, dt, limits_, lanes_, count, out_):
    """See `riskplan.kernels.steer`."""
    node, limits, lanes, out = arrays(node_, limits_, lanes_, count, out_, steps)
    x, y, heading, speed = node[0], node[1], node[2], node[3]
    # braking may be harder than starting off, and a sample that crosses standstill does both
    push = u1 * abs(u1)
    braking = push * speed < 0.0
    wanted = speed + push * limits[DECELERATION if braking else ACCELERATION] * steps * dt
    if speed >= 0.0 and wanted >= 0.0 and speed + wanted > 0.1:
        _, k1, k2 = controls(u1, u2, u3, x, y, heading, speed, steps, dt, limits, lanes)
    else:
        fastest = max(abs(speed), min(abs(wanted), limits[REVERSE] if wanted < 0.0 else limits[SPEED]))
        most = min(limits[CURVATURE], limits[LATERAL] / max(fastest * fastest, 1e-9))
        k1, k2 = u2 * most, u3 * most
    for i in range(steps):
        if push * speed < 0.0:
            # to a standstill at the end of a step, no further: the next step is driven the other way
            change = min(abs(push) * limits[DECELERATION] * dt, abs(speed))
        else:
            top = limits[SPEED] if push > 0.0 else limits[REVERSE]
            change = max(min(abs(push) * limits[ACCELERATION] * dt, top - abs(speed)), 0.0)
        after = speed + math.copysign(change, push)
        curvature = k1 if 2 * i < steps else k2
        if abs(curvature) * max(speed * speed, after * after) > limits[LATERAL] * 1.0001:
            return i
        x, y, heading = arc(x, y, heading, 0.5 * (speed + after) * dt, curvature)
        speed = after
        out[i, 0], out[i, 1], out[i, 2], out[i, 3], out[i, 4] = x, y, heading, speed, 0.0
    return steps
