"""One motion of the tree in one call: controls, drive, static world, goal."""

import numba as nb

from riskplan.kernels.car import LATERAL, SPEED, controls, drive
from riskplan.kernels.world import goal_region, swept_free


@nb.njit(cache=True, error_model="numpy")
def extend(node, u1, u2, u3, steps, dt, limits, lanes, world, goal, earliest, latest, out):
    """Drive from node (x, y, heading, speed, step) for at most `steps` steps.

    `world` and `goal` are the packed tuples. Returns (steps driven, whether the last one is in the goal, acceleration,
    curvature 1, curvature 2); 0 steps if the world is in the way. The motion ends early where it reaches the goal.
    """
    step = int(node[4])
    steps = min(steps, latest - step)
    a, k1, k2 = controls(u1, u2, u3, node[0], node[1], node[2], node[3], steps, dt, limits, lanes)
    drive(node[0], node[1], node[2], node[3], a, k1, k2, steps, dt, limits[SPEED], out)
    px, py, ph = node[0], node[1], node[2]
    for i in range(steps):
        x, y, heading, speed = out[i, 0], out[i, 1], out[i, 2], out[i, 3]
        if abs(k1 if 2 * i < steps else k2) * speed * speed > limits[LATERAL] * 1.0001:
            return 0, False, a, k1, k2
        if not swept_free(px, py, ph, x, y, heading, world):
            return 0, False, a, k1, k2
        px, py, ph = x, y, heading
        if step + i + 1 >= earliest and goal_region(x, y, heading, speed, *goal) >= 0:
            return i + 1, True, a, k1, k2
    return steps, False, a, k1, k2
