"""Write `riskplan/data/overtake.yaml`, the demo scene: a slow car ahead, faster traffic in both lanes beside it.

Run `python demos/make_overtake.py` after a change; the same script gives the same bytes.
"""

from pathlib import Path

import numpy as np

import riskplan as rp

TARGET = Path(rp.__file__).parent / "data" / "overtake.yaml"
LANE = 3.5  # width of a lane [m]; centre lines at y = 0, 3.5, 7
STEPS, DT = 60, 0.1


def agent(name, x, lane, speed, modes):
    """A car at `x` in `lane`; modes are (weight, acceleration [m/s²], lanes changed to the left)."""
    times = np.arange(STEPS + 1) * DT
    ease = np.clip(times / 4.0, 0.0, 1.0) ** 2 * (3.0 - 2.0 * np.clip(times / 4.0, 0.0, 1.0))
    means = np.zeros((STEPS + 1, len(modes), 2))
    for k, (_, acceleration, lanes) in enumerate(modes):
        means[:, k, 0] = x + speed * times + 0.5 * acceleration * times**2
        means[:, k, 1] = LANE * (lane + lanes * ease)
    covariances = np.zeros((STEPS + 1, len(modes), 2, 2))
    covariances[..., 0, 0] = ((0.2 + 0.15 * times) ** 2)[:, None]
    covariances[..., 1, 1] = ((0.15 + 0.04 * times) ** 2)[:, None]
    return rp.GaussianMixturePrediction(
        times, [m[0] for m in modes], means.round(4), covariances.round(6), name=name, length=4.6, width=1.9
    )


def overtake():
    """Three lanes; the ego comes up behind a slow leader and has to be past it, in its lane, within six seconds."""
    road = np.array([[-60.0, -LANE / 2], [200.0, -LANE / 2], [200.0, 2.5 * LANE], [-60.0, 2.5 * LANE]])
    finish = np.array([[76.0, 1.0], [104.0, 1.0], [104.0, 8.0], [76.0, 8.0]])
    return rp.Scenario(
        name="overtake on a three-lane road",
        start=rp.State(0.0, LANE, 0.0, 14.0),
        goal=rp.Goal((rp.GoalRegion(finish, heading=0.0, heading_tolerance=0.25),), time=(5.0, 6.0)),
        bounds=(-20.0, -LANE / 2, 140.0, 2.5 * LANE),
        agents=[
            agent("leader", 26.0, 1, 6.5, [(0.75, 0.0, 0), (0.2, -0.8, 0), (0.05, 0.0, 1)]),
            agent("left, from behind", -22.0, 2, 14.0, [(0.65, 0.0, 0), (0.25, 0.5, 0), (0.1, 0.0, -1)]),
            agent("right", 36.0, 0, 9.5, [(0.8, 0.0, 0), (0.15, -0.6, 0), (0.05, 0.0, 1)]),
        ],
        ego=rp.EgoCover.discs(4.6, 1.9, 6, relative_heading=0.0),
        vehicle=rp.KinematicCar(length=4.6, width=1.9),
        drivable=[road],
        lanes=[np.array([[-60.0, y], [200.0, y]]) for y in (0.0, LANE, 2 * LANE)],
    )


if __name__ == "__main__":
    rp.save_scenario(overtake(), TARGET)
    print(f"wrote {TARGET}")
