"""The point robot on the time grid: two halves of constant acceleration, exact parabolas."""

import math

from riskplan.kernels.car import lane_frame
from riskplan.kernels.steer import arrays, steer_kernel

# limits
ACCELERATION, SPEED = range(2)


@steer_kernel
def steer(node_, u1, u2, u3, steps, dt, limits_, lanes_, count, out_):
    """See `riskplan.kernels.steer`."""
    node, limits, lanes, out = arrays(node_, limits_, lanes_, count, out_, steps)
    x, y, heading, speed = node[0], node[1], node[2], node[3]
    vx, vy = speed * math.cos(heading), speed * math.sin(heading)
    top = max(limits[SPEED], speed)
    lane, offset = lane_frame(x, y, heading, lanes)
    # along: u1; across: u2 in the first half, u3 in the second. One that stands sets off in any direction
    frame = heading if math.isnan(offset) else lane
    if speed < 0.05 * limits[SPEED]:
        frame = math.pi * u3
    cos, sin = math.cos(frame), math.sin(frame)
    for half in range(2):
        first, last = (0, (steps + 1) // 2) if half == 0 else ((steps + 1) // 2, steps)
        if last == first:
            continue
        time = (last - first) * dt
        u = u2 if half == 0 else u3
        along, across = u1 * abs(u1), u * abs(u)
        scale = limits[ACCELERATION] / max(math.hypot(along, across), 1.0)
        wx = vx + time * scale * (along * cos - across * sin)
        wy = vy + time * scale * (along * sin + across * cos)
        # the nearest velocity within the limit: a projection onto a convex set lengthens no step to it
        over = max(math.hypot(wx, wy) / top, 1.0)
        ax, ay = (wx / over - vx) / time, (wy / over - vy) / time
        for i in range(first, last):
            x += (vx + 0.5 * ax * dt) * dt
            y += (vy + 0.5 * ay * dt) * dt
            vx, vy = vx + ax * dt, vy + ay * dt
            speed = math.hypot(vx, vy)
            if speed > 1e-6:
                heading = math.atan2(vy, vx)
            out[i, 0], out[i, 1], out[i, 2], out[i, 3], out[i, 4] = x, y, heading, speed, 0.0
    return steps
