"""Risk of many candidate trajectories at once, as lattice and MPPI planners need it: prints a table.

    python -m benchmarks.candidates [--candidates 10000] [--backends exact,marshall-olkin,cascade] [--samples 1000]

The agents are those of the shipped overtaking scene (three, of three modes) over 3 s; the candidates are arcs from the
ego's start. `one call` is `checker(poses (B, T, 3), agent, ego)` per agent and `trajectory_risk`; `loop` the same one
candidate at a time; Monte Carlo samples each agent's trajectories once and tests all candidates against them in numpy.
All in one run, the fastest of a few rounds, per candidate with all agents.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from importlib.resources import files
from time import perf_counter

import numpy as np

import riskplan as rp
from benchmarks.cases import table
from checkers.validate import Array


def main(arguments: list[str] | None = None) -> int:
    """Parse, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--candidates", type=int, default=10_000)
    parser.add_argument("--backends", default="exact,marshall-olkin,cascade", metavar="NAMES")
    parser.add_argument("--samples", type=int, default=1_000, help="of Monte Carlo")
    parser.add_argument("--rounds", type=int, default=3)
    args = parser.parse_args(arguments)
    scenario = rp.load_scenario(str(files("riskplan") / "data" / "overtake.yaml"))
    times = np.arange(1, 31) * 0.1
    agents = [agent.at(times) for agent in scenario.agents]
    poses = arcs(scenario.start, times, args.candidates)
    shapes = {"six discs": scenario.ego, "ellipse": rp.EgoEllipsoid.around(4.6, 1.9, 4.6, 1.9, 0.0)}
    rows: list[list[object]] = []
    for shape, ego in shapes.items():
        few = min(200, args.candidates)
        sampled, _ = best(lambda e=ego, n=few: monte_carlo(poses[:n], agents, e, args.samples), args.rounds)
        rows.append([f"Monte Carlo {args.samples}", shape, sampled / few * 1e6, "", ""])
        for name in args.backends.split(","):
            checker = rp.checker(name)
            one, together = best(lambda c=checker, e=ego: totals(c, poses, agents, e), args.rounds)
            loop, apart = best(lambda c=checker, e=ego, n=few: in_a_loop(c, poses[:n], agents, e), args.rounds)
            if not np.array_equal(together[:few], apart):
                raise SystemExit(f"{name}: one call and the loop differ")
            each, looped = one / args.candidates, loop / few
            rows.append([name, shape, each * 1e6, f"{looped / each:.1f}", f"{sampled / few / each:.0f}"])
            if checker.info.gradient:
                some = poses[: max(args.candidates // 10, 1)]
                seconds, _ = best(lambda c=checker, e=ego, p=some: gradients(c, p, agents, e), args.rounds)
                rows.append([f"{name}, with gradient", shape, seconds / len(some) * 1e6, "", ""])
    cores = len(os.sched_getaffinity(0))
    title = f"{args.candidates} candidates × {len(agents)} agents × {len(times)} steps × 3 modes, {cores} cores"
    table(title, ["method", "ego", "µs per candidate", "× loop", f"× Monte Carlo {args.samples}"], rows)
    return 0


def arcs(start: rp.State, times: Array, count: int) -> Array:
    """(B, T, 3) poses at constant acceleration and yaw rate, drawn at random."""
    rng = np.random.default_rng(0)
    speed = np.maximum(start.speed + rng.uniform(-4.0, 2.0, count)[:, None] * times, 0.0)
    heading = start.heading + rng.normal(0.0, 0.05, count)[:, None] * times
    step = np.diff(times, prepend=0.0)
    x, y = np.cumsum(step * speed * np.cos(heading), -1), np.cumsum(step * speed * np.sin(heading), -1)
    return np.stack([start.x + x, start.y + y, heading], axis=-1)


def totals(checker: rp.Checker, poses: Array, agents: list[rp.Prediction], ego: rp.EgoShape) -> Array:
    """(B,) risks of the candidates."""
    return rp.trajectory_risk([checker(poses, a, ego) for a in agents], agents).total


def in_a_loop(checker: rp.Checker, poses: Array, agents: list[rp.Prediction], ego: rp.EgoShape) -> Array:
    """The same, one candidate after the other."""
    return np.array([float(totals(checker, one, agents, ego)) for one in poses])


def gradients(checker: rp.Checker, poses: Array, agents: list[rp.Prediction], ego: rp.EgoShape) -> Array:
    """(B, T, 3): of the totals, which are computed as well."""
    risks = [checker(poses, a, ego) for a in agents]
    return rp.trajectory_risk_gradient(risks, [checker.gradient(poses, a, ego) for a in agents], agents)


def monte_carlo(poses: Array, agents: list[rp.Prediction], ego: rp.EgoShape, samples: int) -> Array:
    """(B,) shares of sampled futures that enter any piece at any step."""
    rng, out = np.random.default_rng(1), np.zeros(len(poses))
    c, s = np.cos(poses[..., 2]), np.sin(poses[..., 2])
    for agent in agents:
        future = agent.sample(samples, rng).transpose(1, 2, 0)  # (T, 2, n)
        centres, forms = ego.pieces(agent)
        for b in range(len(poses)):
            dx, dy = future[:, 0] - poses[b, :, :1], future[:, 1] - poses[b, :, 1:2]
            ahead, left = c[b, :, None] * dx + s[b, :, None] * dy, c[b, :, None] * dy - s[b, :, None] * dx
            hit = np.zeros(samples, dtype=bool)
            for (ox, oy), q in zip(centres, forms, strict=True):
                u, v = ahead - ox, left - oy
                hit |= (q[0, 0] * u * u + 2 * q[0, 1] * u * v + q[1, 1] * v * v <= 1.0).any(axis=0)
            out[b] += hit.mean()
    return np.minimum(out, 1.0)


def best(call: Callable[[], Array], rounds: int) -> tuple[float, Array]:
    """Shortest wall time [s] after one call that compiles, and the answer."""
    answer, seconds = call(), np.inf
    for _ in range(rounds):
        start = perf_counter()
        answer = call()
        seconds = min(seconds, perf_counter() - start)
    return seconds, answer


if __name__ == "__main__":
    raise SystemExit(main())
