"""A scene and a plan with everything in them that pictures can show; the plan's numbers are invented."""

from __future__ import annotations

import numpy as np

from checkers import EgoCover, GaussianMixturePrediction, Kind, Risk, trajectory_risk
from riskplan.result import Plan
from riskplan.scene import Goal, GoalRegion, Scenario, State
from riskplan.vehicles.kinematic_car import KinematicCar

DT = 0.1
STEPS = 60
TIMES = DT * np.arange(STEPS + 1)


def agent(name, x, lane, speed, other, length, width, weights=(0.7, 0.2, 0.1)):
    """Keeps its lane, changes to `other`, or brakes."""
    s = TIMES / TIMES[-1]
    blend = s**2 * (3 - 2 * s)
    drive = x + speed * TIMES
    means = np.stack(
        [
            np.column_stack([drive, np.full_like(s, lane)]),
            np.column_stack([drive * 0.99 + 0.01 * x, lane + (other - lane) * blend]),
            np.column_stack([x + speed * TIMES * (1 - 0.3 * s), np.full_like(s, lane)]),
        ],
        axis=1,
    )
    spread = np.stack([np.diag([0.3 + 3.0 * u, 0.25 + 0.35 * u]) ** 2 for u in s])
    return GaussianMixturePrediction(
        TIMES, weights, means, np.repeat(spread[:, None], 3, axis=1), name=name, length=length, width=width
    )


def overtake(shift=(0.0, 0.0), name="overtake"):
    """A truck ahead in the middle of three lanes, a car behind on the left, one ahead on the right."""
    dx, dy = shift
    lanes = [np.array([[-40.0, y], [160.0, y]]) + shift for y in (-3.5, 0.0, 3.5)]
    agents = [
        agent("car left", 2.0 + dx, 3.5 + dy, 15.0, dy, 4.5, 1.8, (0.5, 0.3, 0.2)),
        agent("truck", 24.0 + dx, dy, 8.0, -3.5 + dy, 8.0, 2.5),
        agent("car/right", 42.0 + dx, -3.5 + dy, 11.0, dy, 4.5, 1.8, (0.6, 0.25, 0.15)),
    ]
    corner = np.array([[60.0, -9.0], [66.0, -9.0], [66.0, -7.0], [62.0, -7.0], [62.0, -8.0], [60.0, -8.0]])
    drivable = np.array([[-40.0, -6.3], [160.0, -6.3], [160.0, 6.3], [-40.0, 6.3]]) + shift
    goal = np.array([[80.0, -1.5], [92.0, -1.5], [92.0, 1.5], [80.0, 1.5]]) + shift
    return Scenario(
        start=State(dx, dy, 0.0, 12.0),
        goal=Goal((GoalRegion(goal),)),
        bounds=(-40.0 + dx, -6.0 + dy, 160.0 + dx, 6.0 + dy),
        obstacles=(corner + shift,),
        agents=tuple(agents),
        ego=EgoCover.discs(4.5, 1.8, relative_heading=0.0),
        vehicle=KinematicCar(),
        time_step=DT,
        horizon=TIMES[-1],
        drivable=(drivable,),
        lanes=tuple(lanes),
        name=name,
    )


def random_tree(edges, seed):
    """(E, 5) edges that grow forwards from the origin and stay on the road."""
    rng = np.random.default_rng(seed)
    nodes = np.zeros((edges + 1, 3))  # x, y, time
    parents = np.zeros(edges, dtype=int)
    turns = rng.normal(0.0, 0.12, edges)
    for i in range(edges):
        parents[i] = rng.integers(0, i + 1)
        x, y, t = nodes[parents[i]]
        if t > STEPS * DT - 0.4:
            x, y, t = nodes[0]
            parents[i] = 0
        nodes[i + 1] = x + 4.8, np.clip(y + 4.8 * turns[i], -5.0, 5.0), t + 0.4
    return np.column_stack([nodes[parents, :2], nodes[1:, :2], nodes[parents, 2]])


def overtaking_plan(scenario, edges=5000, seed=0):
    """A lane change to the left and back, with invented marginals and a random tree."""
    u = TIMES / TIMES[-1]
    x = 14.3 * TIMES
    y = 3.5 * (1 / (1 + np.exp(-18 * (u - 0.25))) - 1 / (1 + np.exp(-18 * (u - 0.8))))
    y -= y[0]
    heading = np.arctan2(np.gradient(y, TIMES), np.gradient(x, TIMES))
    start = np.array([scenario.start.x, scenario.start.y])
    poses = np.column_stack([np.column_stack([x, y]) + start, heading])
    bump = 0.004 * np.exp(-(((u - 0.3) / 0.08) ** 2))
    marginals = tuple(np.outer(bump, share) for share in ([1.0, 0.1, 0.0], [0.3, 0.2, 0.1], [0.0, 0.4, 0.0]))
    risks = [Risk(m, Kind.EXACT) for m in marginals]
    search = random_tree(edges, seed) + [*start, *start, 0.0]
    return Plan(
        "solved",
        TIMES,
        poses,
        np.full(len(TIMES), 14.3),
        trajectory_risk(risks, scenario.agents),
        marginals=marginals,
        bound=0.05,
        settings={"planner": "rrt", "checker": "exact"},
        search=search,
    )


def unsolved(search=None):
    none = np.zeros(0)
    edges = random_tree(200, 1) if search is None else search
    return Plan("no_plan_found", none, np.zeros((0, 3)), none, None, bound=0.01, search=edges)
