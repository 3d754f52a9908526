"""Moments through dynamics: `python -m benchmarks.propagation` prints the tables, `--plot FILE` draws two of them.

Speed of exact propagation against simulation of the same agent; the paper's experiment (Jasour et al. 2021, section
VII-B); the bias of the extended Kalman filter and of the unscented transform, which assume Gaussians.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from statistics import median
from time import perf_counter

import numpy as np

import riskplan as rp
from benchmarks.filters import extended, unscented
from checkers.backends.monte_carlo import clopper_pearson
from checkers.deviations import times
from checkers.kernels.propagate import propagate
from checkers.moment_closure import compiled
from checkers.propagation import kernel_input, kernel_program
from checkers.validate import Array

DT, STEPS = 0.1, 30
EGO = rp.EgoEllipsoid.around(4.5, 1.8, 4.5, 1.8, relative_heading=0.0)
BACKENDS = {"halfspace": 2, "marshall-olkin": 2, "chebyshev": 4, "projected-sos": 4, "sos": 8}  # and their moments


def main(arguments: list[str] | None = None) -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenarios", type=int, default=50, help="of the paper's experiment")
    parser.add_argument("--samples", type=int, default=1_000_000, help="simulated futures per scenario")
    parser.add_argument("--repeats", type=int, default=200, help="timed calls")
    parser.add_argument("--plot", type=Path, help="picture to write (.png or .svg)")
    args = parser.parse_args(arguments)
    speed(args.repeats, args.samples)
    experiment(args.scenarios, args.samples)
    bias(args.samples)
    if args.plot:
        from benchmarks.propagation_plot import draw  # noqa: PLC0415  matplotlib costs time

        rng = np.random.default_rng(14)  # a scene in which futures do collide
        args.plot.parent.mkdir(parents=True, exist_ok=True)
        draw(args.plot, random_agent(rng), ego_poses(rng), args.samples)
        print(f"\nwrote {args.plot}")
    return 0


def random_agent(rng: np.random.Generator) -> rp.ControlPrediction:
    """A known start and three modes of Gaussian increments of speed and heading, like the paper's network predicts."""
    modes = []
    for _ in range(3):
        acceleration, turn_rate = rng.normal(0.0, 1.0), rng.normal(0.0, 0.03)
        modes.append(
            {
                "w_v": [rp.Normal(acceleration * DT, rng.uniform(0.02, 0.1)) for _ in range(STEPS)],
                "w_theta": [rp.Normal(turn_rate * DT, rng.uniform(0.002, 0.01)) for _ in range(STEPS)],
            }
        )
    start = {
        "x": rng.uniform(5, 15),
        "y": rng.choice([-1, 1]) * rng.uniform(2.5, 5),
        "v": rng.uniform(6, 12),
        "theta": 0,
    }
    return rp.ControlPrediction(rp.dynamics.dubins(DT), start, modes, STEPS, weights=rng.dirichlet(np.full(3, 4.0)))


def ego_poses(rng: np.random.Generator) -> Array:
    """Straight on along x at a constant speed, (STEPS + 1, 3)."""
    x = rng.uniform(7, 12) * DT * np.arange(STEPS + 1)
    return np.column_stack([x, np.zeros((STEPS + 1, 2))])


def timed(call: Callable[[], object], repeats: int) -> float:
    """Median seconds of a call."""
    seconds = []
    for _ in range(repeats):
        began = perf_counter()
        call()
        seconds.append(perf_counter() - began)
    return median(seconds)


def speed(repeats: int, samples: int) -> None:
    """Time per mode: the compiled loop, and everything from random variables to a validated prediction."""
    agent = random_agent(np.random.default_rng(0))
    count = len(agent.weights)
    modes = [[list(component) for component in mode.components] for mode in agent.controls]
    print(f"\nDubins car, {STEPS} steps, one core; per mode of {count}\n")
    print("| order | compile [ms] | moments | terms | loop [ms] | random variables to prediction [ms] | goal [ms] |")
    print("|---|---|---|---|---|---|---|")
    agent.moments(2)  # numba's own compilation, cached on disk
    for order, goal in ((2, "0.02"), (4, "0.2"), (8, "3"), (12, "")):
        system = rp.dynamics.dubins(DT + 1e-6 * order)  # another system, so that it is compiled anew
        times.cache_clear()
        began = perf_counter()
        compiled(system, order)
        compile_time = perf_counter() - began
        program = compiled(agent.system, order)
        given = kernel_input(agent.system, program, agent.initial, modes, np.ones((count, STEPS, 1)))
        packed, means = kernel_program(program), np.empty((count, STEPS + 1, 2))
        out = np.empty((count, STEPS + 1, order + 1, order + 1))
        reals, angles = given.reals.copy(), given.angles.copy()

        def loop(given=given, packed=packed, means=means, out=out, reals=reals, angles=angles):  # type: ignore[no-untyped-def]
            given.reals[:], given.angles[:] = reals, angles
            propagate(packed, *given, means, out)

        def whole(order=order):  # type: ignore[no-untyped-def]
            rp.ControlPrediction(agent.system, agent.initial, agent.controls, STEPS, weights=agent.weights).moments(
                order
            )

        loop()
        whole()
        row = [timed(loop, repeats) / count, timed(whole, max(repeats // 10, 3)) / count]
        print(
            f"| {order} | {1e3 * compile_time:.0f} | {len(program.powers)} | {len(program.terms.sources)} | "
            f"{1e3 * row[0]:.3f} | {1e3 * row[1]:.2f} | {goal} |"
        )
    began = perf_counter()
    agent.sample(samples // 10, np.random.default_rng(1))
    print(f"\nSimulating {samples // 10} futures of the same agent: {1e3 * (perf_counter() - began):.0f} ms.")


def experiment(scenarios: int, samples: int) -> None:
    """Worst gap to Monte Carlo over the steps of a trajectory, averaged over scenarios."""
    checkers = {name: rp.checker(name) for name in BACKENDS}
    rows = []
    sampling = 0.0
    for seed in range(scenarios):
        rng = np.random.default_rng(seed)
        agent, poses = random_agent(rng), ego_poses(rng)
        began = perf_counter()
        share = sampled_risk(agent, poses, samples, rng)
        sampling += perf_counter() - began
        low, _ = clopper_pearson(share * samples, samples, 0.9999)
        row = []
        for name, checker in checkers.items():
            agent.__dict__.pop("_moments", None)  # every backend pays for its own propagation
            if seed == 0:
                checker(poses, agent.moments(BACKENDS[name]), EGO)
                agent.__dict__.pop("_moments", None)
            began = perf_counter()
            bound = checker(poses, agent, EGO).value @ agent.weights
            row.append((perf_counter() - began, float((bound - share).max()), bool((bound < low).any())))
        rows.append(row)
    print(f"\n{scenarios} random scenarios, {STEPS} steps, three modes; Monte Carlo {samples} futures each\n")
    print(
        "| method | propagation and risk [ms] | worst gap to Monte Carlo: mean | median | largest | below Monte Carlo |"
    )
    print("|---|---|---|---|---|---|")
    for k, name in enumerate(checkers):
        seconds = median(row[k][0] for row in rows)
        gaps = [row[k][1] for row in rows]
        below = sum(row[k][2] for row in rows)
        print(
            f"| {name} | {1e3 * seconds:.2f} | {np.mean(gaps):.4f} | {median(gaps):.4f} | {max(gaps):.4f} | {below} |"
        )
    print(f"| Monte Carlo | {1e3 * sampling / scenarios:.0f} | | | | |")
    print("\nThe paper: 80 ms with 12 half-spaces and 140 s for Monte Carlo 1e6, gap 0.012, on predictions in CARLA.")


def sampled_risk(agent: rp.ControlPrediction, poses: Array, samples: int, rng: np.random.Generator) -> Array:
    """(T,) share of simulated futures inside the ego's ellipse."""
    hits, done, chunk = np.zeros(len(poses)), 0, 50_000
    while done < samples:
        n = min(chunk, samples - done)
        paths = agent.sample(n, rng)
        for t, (x, y, heading) in enumerate(poses):
            c, s = np.cos(heading), np.sin(heading)
            body = (paths[:, t] - [x, y]) @ np.array([[c, -s], [s, c]])
            hits[t] += np.count_nonzero(((body @ EGO.Q) * body).sum(axis=1) <= 1.0)
        done += n
    return hits / samples


def bias(samples: int) -> None:
    """Errors of the mean and covariance after 3 s, for growing steering noise."""
    print("\nDubins car at 10 m/s after 3 s; errors against the exact moments; simulation's own error beside\n")
    print("| steering noise [rad/step] | method | mean [m] | covariance, relative | skewness across |")
    print("|---|---|---|---|---|")
    for sd in (0.01, 0.05, 0.1):
        controls = {"w_v": rp.Normal(0.0, 0.1), "w_theta": rp.Normal(0.02, sd)}
        agent = rp.ControlPrediction(rp.dynamics.dubins(DT), [0, 0, 10, 0], controls, STEPS)
        exact = agent.moments(4)
        mean, cov = exact.means[-1, 0], exact.covariances[-1, 0]
        central = exact.central_moments[-1, 0]
        points = agent.sample(min(samples, 200_000), np.random.default_rng(2))[:, -1]
        start = (np.array([0.0, 0.0, 10.0, 0.0]), np.zeros((4, 4)), np.array([0.0, 0.02]), np.array([0.1**2, sd**2]))
        tracks = {"EKF": extended(*start, DT, STEPS), "unscented": unscented(*start, DT, STEPS)}
        found = {name: (track.means[-1], track.covariances[-1], 0.0) for name, track in tracks.items()}
        skew = ((points - points.mean(axis=0)) ** 3).mean(axis=0)[1] / points[:, 1].std() ** 3
        found[f"{len(points)} simulations"] = (points.mean(axis=0), np.cov(points.T), skew)
        for name, (m, c, skewness) in found.items():
            off = np.linalg.norm(c - cov) / np.linalg.norm(cov)
            print(f"| {sd} | {name} | {np.linalg.norm(m - mean):.4f} | {off:.4f} | {skewness:.3f} |")
        print(f"| {sd} | exact | 0 | 0 | {central[0, 3] / central[0, 2] ** 1.5:.3f} |")


if __name__ == "__main__":
    sys.exit(main())
