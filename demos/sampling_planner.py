"""A sampling planner in plain numpy: a tree over (x, y, heading, speed), grown by layers of a second.

Every node keeps what its branch has survived, per agent and mode, so the bound holds for the *total* risk of the path.
"""

import numpy as np

import riskplan as rp

DT, LAYER, WIDTH, BOUND = 0.1, 10, 400, 0.02


def extend(states, controls):
    """(N, LAYER, 4) states x, y, heading, speed under constant acceleration and curvature (N, 2)."""
    t = DT * np.arange(1, LAYER + 1)
    speed = np.maximum(states[:, 3:] + controls[:, :1] * t, 0.0)
    travelled = DT * np.cumsum(0.5 * (np.column_stack([states[:, 3], speed[:, :-1]]) + speed), axis=1)
    half = 0.5 * controls[:, 1:] * travelled
    chord = travelled * np.sinc(half / np.pi)  # an arc, exactly
    x, y = states[:, :1] + chord * np.cos(states[:, 2:3] + half), states[:, 1:2] + chord * np.sin(states[:, 2:3] + half)
    return np.stack([x, y, states[:, 2:3] + 2.0 * half, speed], axis=-1)


def main() -> None:
    """Grow six layers, keep the most promising nodes of each, print the best path within the bound."""
    scenario, rng = rp.load_scenario("riskplan/data/overtake.yaml"), np.random.default_rng(0)
    checker = rp.checker("exact")
    s, agents = scenario.start, scenario.agents
    states = np.array([[s.x, s.y, s.heading, s.speed]])
    survived = [np.ones((1, len(a.weights))) for a in agents]
    paths, checked, low, high = states[:, None], 0, scenario.bounds[1] + 1.1, scenario.bounds[3] - 1.1
    for layer in range(6):
        grid = DT * (LAYER * layer + np.arange(1, LAYER + 1))
        parent = rng.integers(len(states), size=6 * WIDTH)
        bend = np.clip(-states[parent, 2] / 14.0 + rng.normal(0.0, 0.006, len(parent)), -0.02, 0.02)
        motion = extend(states[parent], np.column_stack([rng.uniform(-4.0, 3.0, len(parent)), bend]))
        keep = (motion[..., 1] > low).all(1) & (motion[..., 1] < high).all(1) & (abs(motion[:, -1, 2]) < 0.3)
        parent, motion = parent[keep], motion[keep]
        total, after = np.zeros(len(parent)), []
        for agent, alive in zip(agents, survived, strict=True):  # the trajectory's risk, a layer further
            risk = checker(motion[..., :3], agent.at(grid), scenario.ego).value  # (N, LAYER, K), one call
            after.append(alive[parent] * np.prod(1.0 - risk, axis=1))
            total += (agent.weights * (1.0 - after[-1])).sum(-1)
        checked += len(parent) * len(agents) * LAYER
        fine = np.flatnonzero(total <= BOUND)
        if not len(fine):
            raise SystemExit(f"no path within {BOUND} at {grid[0]:.1f} s")
        progress = motion[fine, -1, 0] - 20.0 * abs(motion[fine, -1, 2])
        best = fine[np.argsort(-progress)[:WIDTH]]
        states, survived = motion[best, -1], [a[best] for a in after]
        paths = np.concatenate([paths[parent[best]], motion[best]], axis=1)
    path, times = paths[0, 1:], DT * np.arange(1, 6 * LAYER + 1)
    judged = [a.at(times) for a in agents]
    risks = [checker(path[:, :3], a, scenario.ego) for a in judged]
    total = float(rp.trajectory_risk(risks, judged).total)
    print(f"{checked} pairs of state and agent judged; {path[-1, 0]:.1f} m in {times[-1]:.0f} s")
    print(f"risk {total:.4f}, bound {BOUND}: within {total <= BOUND}")


if __name__ == "__main__":
    main()
