"""Scenes the tests share."""

import numpy as np

import riskplan as rp

TIMES = np.arange(61) * 0.1


def agent(name, x, y, speed, modes=((1.0, 0.0, 0.0),), spread=1.0, times=TIMES):
    """An agent along +x; modes are (weight, acceleration, sideways shift within 4 s)."""
    means = np.zeros((len(times), len(modes), 2))
    covariances = np.zeros((len(times), len(modes), 2, 2))
    for k, (_, acceleration, sideways) in enumerate(modes):
        s = np.clip(times / 4, 0, 1)
        means[:, k, 0] = x + speed * times + 0.5 * acceleration * times**2
        means[:, k, 1] = y + sideways * s * s * (3 - 2 * s)
        covariances[:, k, 0, 0] = (spread * (0.2 + 0.25 * times)) ** 2
        covariances[:, k, 1, 1] = (spread * (0.15 + 0.06 * times)) ** 2
    weights = [m[0] for m in modes]
    return rp.GaussianMixturePrediction(times, weights, means, covariances, name=name, length=4.6, width=1.9)


def overtake(agents=3, modes=3, gap=25.0):
    """Three lanes; a slow car ahead, one coming up on the left, one on the right."""
    lanes = tuple(np.array([[-50.0, y], [200.0, y]]) for y in (0.0, 3.5, 7.0))
    road = np.array([[-50, -1.75], [200, -1.75], [200, 8.75], [-50, 8.75]])
    cars = [
        agent(
            "slow",
            gap,
            3.5,
            8,
            ((0.7, 0, 0), (0.2, -0.8, 0), (0.1, 0, 3.5))[:modes] if modes > 1 else ((1.0, 0, 0),),
        ),
        agent(
            "left",
            -10,
            7,
            14,
            ((0.6, 0, 0), (0.3, 0.5, 0), (0.1, 0, -3.5))[:modes] if modes > 1 else ((1.0, 0, 0),),
        ),
        agent(
            "right",
            35,
            0,
            10,
            ((0.8, 0, 0), (0.15, -0.5, 0), (0.05, 0, 3.5))[:modes] if modes > 1 else ((1.0, 0, 0),),
        ),
    ]
    return rp.Scenario(
        start=rp.State(0, 3.5, 0, 12),
        goal=rp.Goal.at(70, 3.5, radius=8, heading=0, heading_tolerance=0.2, time=(4.5, 6)),
        bounds=(-10, -1.75, 120, 8.75),
        agents=tuple(cars[:agents]),
        drivable=(road,),
        lanes=lanes,
        ego=rp.EgoCover.discs(4.6, 1.9, 6, relative_heading=0.0),
        name="overtake",
    )
