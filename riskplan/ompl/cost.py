"""What a trajectory costs: its time, its discomfort and its risk."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from checkers.validate import Array
from riskplan.kernels.roadmap import least_time
from riskplan.search import Problem

_RATE = (
    100.0  # [m²/s]: at 10 m/s a curvature that changes at some rate changes the lateral acceleration at 100 times it
)


@dataclass
class Price:
    """The cost of trajectories in seconds: time + comfort · ∫ (a² + (100 dκ/dt)²) dt + weight · risk, in m and s.

    Attributes:
        problem: with the time step and the goal.
        comfort: seconds that a second of 1 m/s² is worth.
        risk_weight: seconds that a collision is worth.
        ceiling: cost that is known to be possible; a search looks for less.
    """

    problem: Problem
    comfort: float
    risk_weight: float
    ceiling: float = field(default=np.inf)

    def of(self, states: Array, risk: float) -> float:
        """Of a whole trajectory (T, ≥ 4) x, y, heading, speed, start included."""
        dt = self.problem.scenario.time_step
        acceleration = np.diff(states[:, 3]) / dt
        turn = (np.diff(states[:, 2]) + np.pi) % (2.0 * np.pi) - np.pi
        way = np.hypot(np.diff(states[:, 0]), np.diff(states[:, 1]))
        curvature = np.divide(turn, way, out=np.zeros_like(turn), where=way > 1e-3)
        rate = _RATE * np.diff(curvature) / dt
        discomfort = (np.square(acceleration).sum() + np.square(rate).sum()) * dt
        return float((len(states) - 1) * dt + self.comfort * discomfort + self.risk_weight * risk)

    def least(self, start: Array, states: Array) -> float:
        """What a motion from a node costs at least: its time and its acceleration."""
        dt = self.problem.scenario.time_step
        speeds = states[:, 3]
        change = (speeds[0] - start[3]) ** 2 + float(np.square(np.diff(speeds)).sum())
        return float(len(states) * dt + self.comfort * change / dt)

    def ahead(self, state: Array, step: int) -> float:
        """Least time from a state at a step to the goal."""
        vehicle, goal = self.problem.scenario.vehicle, self.problem.goal
        distance = float(goal.distances(state[None, :2])[0])
        ride = least_time(distance, abs(float(state[3])), vehicle.top_acceleration, vehicle.top_speed)
        return float(max(ride, (goal.earliest - step) * self.problem.scenario.time_step))
