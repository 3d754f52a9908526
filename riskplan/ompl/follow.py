"""Following a guide through place and time by the vehicle's own motions."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from checkers.validate import Array
from riskplan.kernels.motion import extend
from riskplan.kernels.steer import STATE
from riskplan.ompl.place_time import steps_hold
from riskplan.search import Budget, Problem

_PERIOD = 0.5  # of a motion [s]
_TRIED, _KEPT = 40, 6  # controls drawn for each of the ways kept, and how many of these there are


@dataclass(eq=False)
class Follower:
    """Beam search over motions: the ways kept are those nearest to the guide, now and a motion later.

    Every motion is within the vehicle's limits, free of the static world and within the evaluator's bound on steps.

    Attributes:
        problem: with the evaluator that holds the bound.
        rng: of the controls.
        motions, checked_steps: driven and charged so far.
    """

    problem: Problem
    rng: np.random.Generator
    motions: int = 0
    checked_steps: int = 0

    def follow(self, guide: Array, budget: Budget) -> Array | None:
        """(T, 5) states from the start to the goal along the guide (N, 3) x, y, time; None if the goal is missed."""
        p, dt = self.problem, self.problem.scenario.time_step
        steps = max(round(_PERIOD / dt), 1)
        ways: list[tuple[Array, list[Array]]] = [(np.array([*p.start_node, 0.0]), [])]
        step = 0
        while ways and step < p.goal.latest and not budget.expired():
            ahead = _at(guide, (step + steps) * dt), _at(guide, (step + 2 * steps) * dt)
            tried = [self._motion(node, parts, steps, ahead) for node, parts in ways for _ in range(_TRIED)]
            kept = []
            for _, arrived, node, parts in sorted((t for t in tried if t is not None), key=lambda t: t[0]):
                self.checked_steps += len(parts[-1])
                if not steps_hold(p, np.ascontiguousarray(parts[-1][:, :3]), step + 1):
                    continue
                if arrived:
                    return np.concatenate([np.array([p.start_node]), *parts])
                kept.append((node, parts))
                if len(kept) == _KEPT:
                    break
            ways, step = kept, step + steps
        return None

    def _motion(
        self, node: Array, parts: list[Array], steps: int, ahead: tuple[Array, Array]
    ) -> tuple[float, bool, Array, list[Array]] | None:
        """A motion by controls drawn at random: how far off it leads, whether it arrives, the node, the way to it."""
        p, s = self.problem, self.problem.scenario
        out = np.empty((steps, STATE))
        u = self.rng.uniform(-1.0, 1.0, 3)
        fixed = s.time_step, s.vehicle.limits, p.world.lanes, p.world.packed
        window = p.goal.arrays, p.goal.earliest, p.goal.latest
        self.motions += 1
        driven, arrived = extend(s.vehicle.kernel.address, node, *u, steps, *fixed, *window, out)
        if not driven:
            return None
        x, y, heading, speed = out[driven - 1, :4].tolist()
        reach = steps * s.time_step * speed
        off = math.hypot(x - ahead[0][0], y - ahead[0][1])
        off += math.hypot(x + reach * math.cos(heading) - ahead[1][0], y + reach * math.sin(heading) - ahead[1][1])
        # whatever arrives has done what the guide is for
        last = np.append(out[driven - 1], node[STATE] + driven)
        return (-1.0 if arrived else off), bool(arrived), last, [*parts, out[:driven]]


def _at(guide: Array, time: float) -> Array:
    """(2,) where the guide is; beyond its end it goes on as it ends."""
    if time <= guide[-1, 2]:
        return np.array([np.interp(time, guide[:, 2], guide[:, i]) for i in range(2)])
    last: Array = guide[-1, :2] - guide[-2, :2]
    beyond: Array = guide[-1, :2] + last * (time - guide[-1, 2]) / max(guide[-1, 2] - guide[-2, 2], 1e-9)
    return beyond
