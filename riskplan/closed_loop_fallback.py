"""What is driven where no plan to the goal is within the bound: ways to brake, judged like everything else."""

from __future__ import annotations

import numpy as np

from checkers.validate import Array
from riskplan.kernels.motion import extend
from riskplan.kernels.steer import NODE, STATE, steer
from riskplan.search import Problem
from riskplan.world import lane_segments

# how hard, in the terms of the vehicle's motion, which squares them; and where to: 0 keeps to the path
_BRAKES = (0.0, -0.25, -0.5, -0.75, -1.0)
_ASIDE = (0.0, -0.62, 0.62, -0.75, 0.75, -0.9, 0.9)
_NO_GOAL = (np.zeros(1, np.int64), np.zeros((0, 2)), np.zeros((0, 4)), np.zeros((0, 4)))


def braking(problem: Problem, steps: int) -> list[Array]:
    """Ways (steps, 5) to drive on or to brake, that the vehicle can drive and the static world allows, gentlest first.

    Never empty: where the world allows none, straight braking is what is left.
    """
    s = problem.scenario
    vehicle, lanes = s.vehicle, lane_segments(s)
    node = np.zeros(NODE)
    node[:STATE] = problem.start_node
    found = []
    # reversing vehicles brake the other way
    sign = -1.0 if node[3] < 0.0 else 1.0
    for brake in _BRAKES:
        for aside in _ASIDE:
            out = np.empty((steps, STATE))
            driven, _ = extend(
                vehicle.kernel.address,
                node,
                sign * brake,
                aside,
                0.0,
                steps,
                s.time_step,
                vehicle.limits,
                lanes,
                problem.world.packed,
                _NO_GOAL,
                steps + 1,
                steps,
                out,
            )
            if driven == steps:
                found.append(out if not vehicle.reverses else _standing(out, sign))
    if found:
        return found
    out = np.empty((steps, STATE))
    address = vehicle.kernel.address
    driven = steer(address, node, -sign, 0.0, 0.0, steps, s.time_step, vehicle.limits, lanes[:0], out)
    out[driven:] = out[driven - 1] if driven else node[:STATE]
    return [_standing(out, sign) if vehicle.reverses else out]


def _standing(states: Array, sign: float) -> Array:
    """The states until it stands, and then standing: a vehicle that can would go on the other way."""
    over = np.flatnonzero(sign * states[:, 3] <= 0.0)
    if len(over):
        states[over[0] :] = states[over[0]]
        states[over[0] :, 3] = 0.0
    return states
