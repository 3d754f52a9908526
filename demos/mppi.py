"""MPPI (Williams et al. 2017) with risk as a cost: 10,000 candidate trajectories judged in one call per agent.

Controls are acceleration and yaw rate; each iteration perturbs them, drives all candidates, and averages the
perturbations by their cost, in which the trajectory's total risk counts like a wall at the bound.
"""

from time import perf_counter

import numpy as np

import riskplan as rp

DT, STEPS, CANDIDATES, ITERATIONS, BOUND = 0.1, 40, 10_000, 8, 0.01
SPREAD, TEMPERATURE = np.array([2.0, 0.12]), 1.0


def drive(start, controls):
    """(B, T, 3) poses and (B, T) speeds under controls (B, T, 2) from `start`."""
    speed = np.clip(start.speed + DT * np.cumsum(controls[..., 0], axis=-1), 0.0, 25.0)
    heading = start.heading + DT * np.cumsum(controls[..., 1], axis=-1)
    x = start.x + DT * np.cumsum(speed * np.cos(heading), axis=-1)
    y = start.y + DT * np.cumsum(speed * np.sin(heading), axis=-1)
    return np.stack([x, y, heading], axis=-1), speed


def risk(checker, poses, agents, ego):
    """(B,) total risks, all agents, all steps."""
    return rp.trajectory_risk([checker(poses, a, ego) for a in agents], agents).total


def cost(poses, speed, controls, total, low, high):
    """Fast, straight, smooth, on the road, and within the bound."""
    off_road = np.maximum(low - poses[..., 1], 0.0) + np.maximum(poses[..., 1] - high, 0.0)
    rough = (controls**2 * [0.02, 20.0]).sum(axis=(-1, -2))
    turned = 20.0 * poses[:, -1, 2] ** 2
    return (
        0.3 * (20.0 - speed).clip(0.0).sum(-1)
        + rough
        + turned
        + 1e3 * off_road.sum(-1)
        + 200.0 * (np.maximum(np.log(total + 1e-12) - np.log(0.5 * BOUND), 0.0))
    )


def main() -> None:
    """Sample, judge, average; print what it found and what a candidate cost."""
    scenario, rng = rp.load_scenario("riskplan/data/overtake.yaml"), np.random.default_rng(0)
    checker = rp.checker("cascade", resolution=1e-9)
    times = DT * np.arange(1, STEPS + 1)
    agents = [a.at(times) for a in scenario.agents]
    low, high = scenario.bounds[1] + 1.2, scenario.bounds[3] - 1.2
    mean, spent = np.zeros((STEPS, 2)), 0.0
    risk(checker, drive(scenario.start, mean[None])[0], agents, scenario.ego)  # compiles
    for _ in range(ITERATIONS):
        noise = rng.normal(size=(CANDIDATES, STEPS // 5, 2)).repeat(5, axis=1) * SPREAD
        noise[0] = 0.0
        controls = np.clip(mean + noise, [-6.0, -0.4], [3.0, 0.4])
        poses, speed = drive(scenario.start, controls)
        began = perf_counter()
        total = risk(checker, poses, agents, scenario.ego)
        spent += perf_counter() - began
        costs = cost(poses, speed, controls, total, low, high)
        weights = np.exp(-(costs - costs.min()) / TEMPERATURE)
        mean = (weights[:, None, None] * controls).sum(axis=0) / weights.sum()
    poses, speed = drive(scenario.start, mean[None])
    judged = float(risk(rp.checker("exact"), poses[0], agents, scenario.ego))
    print(f"{spent / CANDIDATES / ITERATIONS * 1e6:.0f} µs per candidate of {len(agents)} agents × {STEPS} steps")
    print(f"driven {poses[0, -1, 0]:.1f} m in {times[-1]:.1f} s, lane position {poses[0, -1, 1]:.1f} m")
    print(f"risk {judged:.2g}, bound {BOUND}: within {judged <= BOUND}")


if __name__ == "__main__":
    main()
