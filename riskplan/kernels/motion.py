"""One motion of the tree in one call: steer, static world, goal."""

import numba as nb

from riskplan.kernels.steer import steer
from riskplan.kernels.world import goal_region, swept_free


@nb.njit(cache=True, error_model="numpy")
def extend(kernel, node, u1, u2, u3, steps, dt, limits, lanes, world, goal, earliest, latest, out):
    """Drive from node (x, y, heading, speed, steering, step) for at most `steps` steps by the vehicle's kernel.

    `world` and `goal` are the packed tuples; out (steps, 5). Returns (steps driven, whether the last one is in the
    goal); 0 steps if the world or a limit is in the way. The motion ends early where it reaches the goal.
    """
    step = int(node[5])
    steps = min(steps, latest - step)
    possible = steer(kernel, node, u1, u2, u3, steps, dt, limits, lanes, out)
    px, py, ph = node[0], node[1], node[2]
    for i in range(possible):
        x, y, heading, speed = out[i, 0], out[i, 1], out[i, 2], out[i, 3]
        if not swept_free(px, py, ph, x, y, heading, world):
            return 0, False
        px, py, ph = x, y, heading
        if step + i + 1 >= earliest and goal_region(x, y, heading, speed, *goal) >= 0:
            return i + 1, True
    return (steps if possible == steps else 0), False
