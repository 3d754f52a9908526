"""One motion of the tree in one call: steer, static world, goal."""

import math

import numba as nb
import numpy as np

from riskplan.kernels.roadmap import least_time
from riskplan.kernels.steer import steer
from riskplan.kernels.world import goal_region, path_free


@nb.njit(cache=True, error_model="numpy")
def extend(kernel, node, u1, u2, u3, steps, dt, limits, lanes, world, goal, earliest, latest, out):
    """Drive from node (x, y, heading, speed, steering, step) for at most `steps` steps by the vehicle's kernel.

    `world` and `goal` are the packed tuples; out (steps, 5). Returns (steps driven, whether the last one is in the
    goal); 0 steps if the world or a limit is in the way. The motion ends early where it reaches the goal.
    """
    step = int(node[5])
    steps = min(steps, latest - step)
    possible = steer(kernel, node, u1, u2, u3, steps, dt, limits, lanes, out)
    driven, arrived = possible, False
    for i in range(max(earliest - step - 1, 0), possible):
        if goal_region(out[i, 0], out[i, 1], out[i, 2], out[i, 3], *goal) >= 0:
            driven, arrived = i + 1, True
            break
    if not arrived and possible < steps:
        return 0, False
    return (driven, arrived) if path_free(node[0], node[1], node[2], out, driven, world) else (0, False)


@nb.njit(cache=True, error_model="numpy")
def extend_towards(
    kernel, node, controls, target, weights, steps, dt, limits, lanes, world, goal, earliest, latest, out
):
    """As `extend` by that one of the controls (C, 3) which arrives, the first, or else ends nearest to the target.

    target: (5,) x, y, heading, speed, time, by the metric (2,) weights of heading and speed; its time is no matter: a
    motion lasts as long as motions do. Returns (steps driven, whether it arrived, which).
    """
    best, chosen = np.inf, -1
    driven, arrived = 0, False
    for c in range(controls.shape[0]):
        u1, u2, u3 = controls[c, 0], controls[c, 1], controls[c, 2]
        driven, arrived = extend(kernel, node, u1, u2, u3, steps, dt, limits, lanes, world, goal, earliest, latest, out)
        if arrived:
            return driven, arrived, c
        if driven == 0:
            continue
        last = out[driven - 1]
        turn = (last[2] - target[2] + math.pi) % (2.0 * math.pi) - math.pi
        off = (last[0] - target[0]) ** 2 + (last[1] - target[1]) ** 2
        off += (weights[0] * turn) ** 2 + (weights[1] * (last[3] - target[3])) ** 2
        if off < best:
            best, chosen = off, c
    if chosen < 0:
        return 0, False, 0
    if chosen < controls.shape[0] - 1:
        u1, u2, u3 = controls[chosen, 0], controls[chosen, 1], controls[chosen, 2]
        driven, arrived = extend(kernel, node, u1, u2, u3, steps, dt, limits, lanes, world, goal, earliest, latest, out)
    return driven, arrived, chosen


@nb.njit(cache=True, error_model="numpy")
def out_of_reach(x, y, speed, left, dt, boxes, acceleration, top):
    """Whether no region's box (G, 4) can be reached in the steps left, by straight distance at full acceleration."""
    if left <= 0:
        return True
    nearest = np.inf
    for g in range(boxes.shape[0]):
        dx = max(boxes[g, 0] - x, x - boxes[g, 2], 0.0)
        dy = max(boxes[g, 1] - y, y - boxes[g, 3], 0.0)
        nearest = min(nearest, dx * dx + dy * dy)
    return least_time(math.sqrt(nearest), abs(speed), acceleration, top) > left * dt + 1e-9
