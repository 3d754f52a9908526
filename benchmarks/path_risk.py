"""Time of the exact path risk, paired against plain Monte Carlo of the same paths in the same run: prints a table.

    python -m benchmarks.path_risk [--paths 200] [--samples 10000] [--rest 0.02,0.1,0.5]

Each row is one mode of 30 steps; `sweep` is the compiled sweep of a batch of paths through one scene, per path (total
only), `exposure` the same with the first-hit distribution. Monte Carlo draws ξ once per sample and tests every step.
The second table is of agents with a rest, drawn at every step, whose deviations are a share of the factors'.
"""

from __future__ import annotations

import argparse
import time
from functools import partial
from itertools import product

import numpy as np

from checkers import EgoBox, EgoCover, EgoEllipsoid, GaussianMixturePrediction, path_risk
from checkers.kernels.path import sweep_paths
from checkers.path import _modes, shape_against

STEPS, SIZE = 30, (4.6, 1.9)


def scene(paths: int, rest: float = 0.0) -> tuple[np.ndarray, GaussianMixturePrediction]:
    """Paths that overtake, at many lateral distances and speeds, a car whose error grows over 3 s.

    Beside its factors each step has a rest of its own, whose deviations are `rest` times theirs.
    """
    rng, t = np.random.default_rng(0), np.linspace(0.1, 3.0, STEPS)
    heading = 0.05 * t
    means = np.column_stack([15.0 + 8.0 * t, 0.2 * t**2])
    c, s = np.cos(heading), np.sin(heading)
    turn = np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)
    factors = turn * np.stack([0.2 + 0.8 * t, 0.1 + 0.25 * t], -1)[:, None]
    agent = GaussianMixturePrediction(
        t,
        [1.0],
        means[:, None],
        (1.0 + rest**2) * (factors @ np.swapaxes(factors, -1, -2))[:, None],
        length=SIZE[0],
        width=SIZE[1],
        headings=heading[:, None],
        factors=factors[:, None],
    )
    speed, side = rng.uniform(8, 16, paths)[:, None], rng.uniform(-5, 5, paths)[:, None]
    poses = np.stack([speed * t, side + 0.0 * t, np.zeros((paths, 1)) + 0.0 * t], axis=-1)
    return poses, agent


def best(call, repeat: int = 5) -> float:  # type: ignore[no-untyped-def]
    """Shortest wall time of a few calls [s]; the first compiles."""
    call()
    times = []
    for _ in range(repeat):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return min(times)


def monte_carlo(poses: np.ndarray, agent: GaussianMixturePrediction, q: np.ndarray, samples: int) -> float:
    """Share of sampled trajectories that enter the ellipse."""
    xy = agent.sample(samples, np.random.default_rng(1)) - poses[None, :, :2]
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x, y = c * xy[..., 0] + s * xy[..., 1], -s * xy[..., 0] + c * xy[..., 1]
    hit = q[0, 0] * x * x + 2 * q[0, 1] * x * y + q[1, 1] * y * y <= 1.0
    return float(hit.any(axis=1).mean())


def with_rests(rests: list[float], paths: int, samples: int) -> None:
    """Print the second table: `path_risk` whole, one path and mode a call."""
    egos = {
        "ellipse": EgoEllipsoid.around(*SIZE, *SIZE, 0.0),
        "six discs": EgoCover.discs(*SIZE, 6),
        "box": EgoBox(*SIZE),
    }
    print("\n| shape | rest / factors | tolerance | median [ms] | worst [ms] | Monte Carlo [ms] | kinds |")
    print("|---|---|---|---|---|---|---|")
    for (name, ego), rest, tolerance in product(egos.items(), rests, (1e-4, 1e-8)):
        poses, agent = scene(paths, rest)
        q = egos["ellipse"].pieces(agent)[1][0]
        paired = best(partial(monte_carlo, poses[0], agent, q, samples), 2)
        kinds, times = set(), []
        for p in poses:
            call = partial(path_risk, p, [agent], ego, tolerance=tolerance)
            kinds.add(call().kind.value)
            times.append(1e3 * best(call, 1))
        line = f"| {name} | {rest:g} | {tolerance:g} | {np.median(times):.0f} | {max(times):.0f} | {1e3 * paired:.0f} |"
        print(line, ", ".join(sorted(kinds)), "|")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--paths", type=int, default=200)
    parser.add_argument("--samples", type=int, default=10_000)
    parser.add_argument("--rest", default="0.02,0.1,0.5", help="shares; empty: none")
    parser.add_argument("--rest-paths", type=int, default=8, help="of the second table")
    args = parser.parse_args()
    poses, agent = scene(args.paths)
    ellipse = EgoEllipsoid.around(*SIZE, *SIZE, 0.0)
    some = poses[:5]
    paired = best(lambda: [monte_carlo(p, agent, ellipse.Q, args.samples) for p in some], 2) / len(some) * 1e6
    print(f"{STEPS} steps, one mode; Monte Carlo with {args.samples} samples: {paired:.0f} µs per path")
    print("| shape | tolerance | sweep [µs] | with exposure [µs] | Monte Carlo / sweep | median risk |")
    print("|---|---|---|---|---|---|")
    for name, ego in (("ellipse", ellipse), ("box", EgoBox(*SIZE))):
        kind, shape = shape_against(ego, agent)
        mode = _modes(agent, kind)[0]
        value, error = np.empty((2, len(poses)))
        for tolerance in (1e-4, 1e-8):
            times = []
            for room in (0, STEPS):
                exposure = np.empty((len(poses), room))
                call = (kind, shape, poses, mode.means, mode.factors, mode.headings, tolerance, value, error, exposure)
                times.append(best(lambda call=call: sweep_paths(*call)) / len(poses) * 1e6)  # type: ignore[misc]
            print(
                f"| {name} | {tolerance:g} | {times[0]:.1f} | {times[1]:.1f} | {paired / times[0]:.0f} "
                f"| {np.median(value):.2g} |"
            )
    with_rests([float(v) for v in args.rest.split(",") if v], args.rest_paths, args.samples)


if __name__ == "__main__":
    main()
