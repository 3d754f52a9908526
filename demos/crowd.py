"""A round robot, free to push in any direction, crosses a square among pedestrians who go on, stop or veer off."""

import numpy as np

import riskplan as rp

TIMES = np.arange(0.0, 10.01, 0.1)
WALKERS = (  # where they are, where they go [m/s]
    ("A", (2.0, 5.0), (0.1, -1.1)),
    ("B", (3.6, 5.6), (0.0, -1.0)),
    ("C", (6.5, -5.5), (-0.15, 1.2)),
    ("D", (9.5, 4.0), (-1.2, -0.2)),
    ("E", (9.0, -2.5), (-1.0, 0.35)),
    ("F", (1.0, -4.5), (0.5, 0.9)),
)


def walker(name: str, at: tuple[float, float], velocity: tuple[float, float]) -> rp.GaussianMixturePrediction:
    """A pedestrian: 70 % go on, 15 % come to a stop, 15 % veer to their left."""
    start, pace = np.array(at), np.array(velocity)
    left = np.array([-pace[1], pace[0]])
    slowing = 1.5 * (1 - np.exp(-TIMES / 1.5))
    turn = 0.08 * TIMES**2
    modes = [TIMES[:, None] * pace, slowing[:, None] * pace, TIMES[:, None] * pace * 0.9 + turn[:, None] * left]
    spread = (0.08 + 0.03 * TIMES)[:, None, None, None] ** 2 * np.eye(2) * np.ones((1, 3, 1, 1))
    means = np.stack([start + mode for mode in modes], axis=1)
    return rp.GaussianMixturePrediction(TIMES, [0.7, 0.15, 0.15], means, spread, name=name, length=0.5, width=0.5)


def square() -> rp.Scenario:
    """Twelve metres across, a fountain in the middle."""
    angle = 2 * np.pi * np.arange(16) / 16
    fountain = np.array([5.5, 0.3]) + 0.8 * np.column_stack([np.cos(angle), np.sin(angle)])
    return rp.Scenario(
        name="a robot crosses a square",
        start=rp.State(-1.0, 0.0, 0.0, 0.8),
        goal=rp.Goal.at(12.0, 0.5, radius=0.8, time=(4.0, 10.0)),
        bounds=(-2.5, -6.5, 13.5, 6.5),
        obstacles=[fountain],
        agents=[walker(*row) for row in WALKERS],
        ego=rp.EgoEllipsoid(np.eye(2) / 0.57**2),  # both radii, and a little air
        vehicle=rp.PointRobot(radius=0.3, max_acceleration=2.0, max_speed=2.0),
    )


def main() -> None:
    """Plan and draw."""
    scenario = square()
    plan = rp.plan(scenario, planner="rrt", checker="exact", bound=0.05, time_limit=30.0, seed=1)
    print(plan.message)
    rp.render(scenario, plan, "out/demos/crowd.html", samples=40)
    rp.render(scenario, plan, "out/demos/crowd.png", time=2.5)


if __name__ == "__main__":
    main()
