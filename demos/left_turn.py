"""An unprotected left turn: two cars come towards us and may brake or not; a pedestrian may cross the side road."""

import numpy as np

import riskplan as rp

HALF, LANE = 4.7, 2.4  # half the width of a road, and how far its lanes are from the middle [m]
FAR = 60.0
TIMES = np.arange(0.0, 7.01, 0.1)


def oncoming(name: str, y: float, speed: float, weights: list[float]) -> rp.GaussianMixturePrediction:
    """A car from the north: it goes on, brakes for us, or hurries."""
    runs = []
    for acceleration in (0.0, -4.0, 1.0):
        until = np.minimum(TIMES, speed / 4.0 if acceleration < 0 else np.inf)
        runs.append(speed * until + 0.5 * acceleration * until**2)
    means = np.stack([np.column_stack([np.full_like(TIMES, -LANE), y - run]) for run in runs], axis=1)
    spread = np.stack([np.diag([0.15 + 0.02 * t, 0.3 + 0.2 * t]) ** 2 for t in TIMES])
    covariances = np.repeat(spread[:, None], 3, axis=1)
    headings = np.full(means.shape[:2], -np.pi / 2)
    return rp.GaussianMixturePrediction(
        TIMES, weights, means, covariances, name=name, length=4.6, width=1.9, headings=headings
    )


def pedestrian() -> rp.GaussianMixturePrediction:
    """Waits at the side road we turn into, or crosses it."""
    waits = np.tile([-12.5, 7.4], (len(TIMES), 1))
    crosses = np.column_stack([np.full_like(TIMES, -12.5), 7.4 - 1.2 * TIMES])
    spread = (0.15 + 0.04 * TIMES)[:, None, None, None] ** 2 * np.eye(2) * np.ones((1, 2, 1, 1))
    means = np.stack([waits, crosses], axis=1)
    return rp.GaussianMixturePrediction(TIMES, [0.95, 0.05], means, spread, name="pedestrian", length=0.5, width=0.5)


def crossing() -> rp.Scenario:
    """Two roads, rounded corners, our way as a lane."""
    arc = np.linspace(0.0, np.pi / 2, 12)
    bend = np.array([-5.6, -5.6]) + 8.0 * np.column_stack([np.cos(arc), np.sin(arc)])
    ours = np.concatenate([[[LANE, -FAR]], bend, [[-FAR, LANE]]])
    roads = [np.array([[-a, -b], [a, -b], [a, b], [-a, b]]) for a, b in ((HALF, FAR), (FAR, HALF))]
    for sx, sy in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        quarter = np.array([10.7, 10.7]) - 6.0 * np.column_stack([np.cos(arc), np.sin(arc)])
        roads.append(np.concatenate([[[4.5, 4.5]], quarter]) * [sx, sy])
    stubs = [[[-LANE, FAR], [-LANE, 10.7]], [[LANE, 10.7], [LANE, FAR]], [[-LANE, -10.7], [-LANE, -FAR]]]
    stubs += [[[FAR, LANE], [10.7, LANE]], [[10.7, -LANE], [FAR, -LANE]], [[-FAR, -LANE], [-10.7, -LANE]]]
    stubs += [[[LANE, -FAR], [LANE, -10.7]], [[-10.7, LANE], [-FAR, LANE]]]
    goal = np.array([[-34.0, 0.8], [-18.0, 0.8], [-18.0, 3.8], [-34.0, 3.8]])
    return rp.Scenario(
        name="unprotected left turn",
        start=rp.State(LANE, -22.0, np.pi / 2, 7.0),
        goal=rp.Goal((rp.GoalRegion(goal, heading=np.pi, heading_tolerance=0.35),), time=(3.0, 7.0)),
        bounds=(-45.0, -35.0, 25.0, 45.0),
        agents=[
            oncoming("first", 26.0, 11.0, [0.75, 0.15, 0.1]),
            oncoming("second", 66.0, 9.0, [0.6, 0.3, 0.1]),
            pedestrian(),
        ],
        ego=rp.EgoCover.discs(4.6, 1.9, n=6),
        vehicle=rp.KinematicCar(length=4.6, width=1.9),
        drivable=roads,
        lanes=[ours, *map(np.array, stubs)],
    )


def main() -> None:
    """Plan and draw."""
    scenario = crossing()
    plan = rp.plan(scenario, planner="prm", checker="exact", bound=0.02, time_limit=30.0, seed=1)
    print(plan.message)
    rp.render(scenario, plan, "out/demos/left-turn.html")
    rp.render(scenario, plan, "out/demos/left-turn.png", time=2.6)


if __name__ == "__main__":
    main()
