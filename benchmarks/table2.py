"""The paper's Table II on this machine: `python -m benchmarks.table2 --data DIR`.

Time per scenario of 30 steps × 3 modes on one core, over all scenarios of the predictions file, every call with a
prediction it has not seen; paired in one run with Monte Carlo in numpy, written twice: whole arrays of samples a mode
and step, as in the released code, and the leanest we know. Then single poses, batches on both cores, memory, and what
the arithmetic alone would cost.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numba as nb
import numpy as np

import riskplan as rp
from benchmarks.cases import Scenarios, load_scenarios, table
from checkers.validate import Array

BACKENDS: list[tuple[str, dict[str, Any], float | None]] = [
    ("exact", {}, 1000),
    ("imhof", {}, 100),
    ("liu", {}, 500),
    ("cascade", {}, None),
    ("chebyshev", {}, 2500),
    ("marshall-olkin", {}, 2500),
    ("halfspace", {}, None),
    ("unimodal-halfspace", {}, None),
    ("sos", {"order": 4}, 500),
    ("offline-sos", {"order": 4}, None),
    ("projected-sos", {"order": 4}, 500),
    ("projected-sos", {"order": 8}, None),
]
PAPER = {"imhof": "91", "liu": "26.7", "chebyshev": "80 (with propagation)", "sos": "42 to 49 per step"}
RELEASED = {"imhof": "31", "liu": "18", "chebyshev": "169 (with propagation)"}


def main(arguments: list[str] | None = None) -> int:
    """Parse, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="directory of the predictions file")
    parser.add_argument(
        "--rounds", type=int, default=5, help="the fastest of so many rounds counts, for each backend alike"
    )
    parser.add_argument("--monte-carlo", type=int, default=40, help="scenarios sampled per round")
    args = parser.parse_args(arguments)
    scenarios = load_scenarios(args.data)
    per_scenario(scenarios, args.rounds, args.monte_carlo)
    programs(scenarios)
    single_poses(scenarios)
    batches(scenarios)
    limit()
    return 0


def per_scenario(scenarios: Scenarios, rounds: int, sampled: int) -> None:
    """The table."""
    best: dict[str, float] = {}
    for _ in range(rounds):
        for label, sampler, samples in SAMPLERS:
            some = range(sampled if samples == 10_000 else max(sampled // 10, 1))
            rng = np.random.default_rng(0)
            seconds = _timed(lambda i, f=sampler, n=samples, r=rng: f(scenarios, i, n, r), some)
            _keep(best, label, seconds)
        for name, options, _ in BACKENDS:
            backend = rp.checker(name, **options)
            backend(scenarios.poses[0], scenarios.predictions[0], scenarios.ego)
            fresh = [replace(p) for p in scenarios.predictions]  # no arrays kept from the round before
            everything = range(len(fresh))
            seconds = _timed(lambda i, b=backend, f=fresh: b(scenarios.poses[i], f[i], scenarios.ego), everything)
            _keep(best, _label(name, options), seconds)
    plain, lean = best["Monte Carlo 1e4"], best["Monte Carlo 1e4, lean"]
    known = {"Monte Carlo 1e4": ("107", "67"), "Monte Carlo 1e5": ("1329", "925")}
    rows: list[list[object]] = []
    for label, seconds in best.items():
        name = label.split(" ")[0]
        aim = next((f"{a:g}" for n, o, a in BACKENDS if _label(n, o) == label and a is not None), "")
        paper, released = known.get(label, (PAPER.get(name, ""), RELEASED.get(name, "")))
        rows.append([label, seconds * 1e3, f"{plain / seconds:.3g}", aim, f"{lean / seconds:.3g}", paper, released])
    head = [
        "method",
        "ms",
        "× Monte Carlo 1e4",
        "aim",
        "× the lean one",
        "paper [ms]",
        "released code, like machine [ms]",
    ]
    table("One scenario: 30 steps × 3 modes, one core", head, rows)


def plain_monte_carlo(scenarios: Scenarios, i: int, samples: int, rng: np.random.Generator) -> Array:
    """Shares (30, 3) of fresh samples inside the ellipse, one mode and step after the other."""
    pred, poses = scenarios.predictions[i], scenarios.poses[i]
    out = np.empty(pred.means.shape[:2])
    for t, k in np.ndindex(out.shape):
        c, s = np.cos(poses[t, 2]), np.sin(poses[t, 2])
        turn = np.array([[c, -s], [s, c]])
        x = rng.multivariate_normal(pred.means[t, k], pred.covariances[t, k], samples) - poses[t, :2]
        out[t, k] = np.mean(np.sum((x @ (turn @ scenarios.ego.Q @ turn.T)) * x, axis=1) <= 1.0)
    return out


def lean_monte_carlo(scenarios: Scenarios, i: int, samples: int, rng: np.random.Generator) -> Array:
    """The same from one block of normals a step, small enough for the cache, and one matrix product."""
    pred, poses = scenarios.predictions[i], scenarios.poses[i]
    root, form = np.linalg.cholesky(pred.covariances), np.linalg.cholesky(scenarios.ego.Q)
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    turn = form.T @ np.stack([c, s, -s, c], axis=-1).reshape(-1, 2, 2)
    out = np.empty(pred.means.shape[:2])
    for t in range(len(out)):
        noise = rng.standard_normal((pred.means.shape[1], 2, samples))
        y = (turn[t] @ root[t]) @ noise + (turn[t] @ (pred.means[t] - poses[t, :2])[..., None])
        out[t] = np.count_nonzero(y[:, 0] * y[:, 0] + y[:, 1] * y[:, 1] <= 1.0, axis=-1) / samples
    return out


SAMPLERS = (
    ("Monte Carlo 1e4", plain_monte_carlo, 10_000),
    ("Monte Carlo 1e5", plain_monte_carlo, 100_000),
    ("Monte Carlo 1e4, lean", lean_monte_carlo, 10_000),
)


def programs(scenarios: Scenarios) -> None:
    """Semidefinite programs, per step."""
    rows: list[list[object]] = []
    for name, options in (
        ("sos", {"order": 4, "solver": "clarabel"}),
        ("sos", {"order": 4, "solver": "clarabel", "per": "mixture"}),
        ("sos", {"order": 6, "solver": "clarabel"}),
        ("bivariate-sos", {"order": 4}),
        ("bivariate-sos", {"order": 6}),
    ):
        backend = rp.checker(name, **options)
        backend(scenarios.poses[0], scenarios.predictions[0], scenarios.ego)
        count = 20 if name == "sos" else 4
        seconds = min(
            _timed(lambda i, b=backend: b(scenarios.poses[i], scenarios.predictions[i], scenarios.ego), range(count))
            for _ in range(3)
        )
        solved = 1 if "per" in options else 3
        rows.append([_label(name, options), solved, seconds / 30 * 1e3, seconds / 30 / solved * 1e3])
    table(
        "Semidefinite programs (aim: `sos` Clarabel ≤ 0.6 ms per step)",
        ["program", "programs a step", "ms per step", "ms per program"],
        rows,
    )


def single_poses(scenarios: Scenarios) -> None:
    """What a call costs for one pose and one mode."""
    pred = scenarios.predictions[0].at(scenarios.predictions[0].times[:1])
    one = rp.GaussianMixturePrediction(pred.times, [1.0], pred.means[:, :1], pred.covariances[:, :1])
    pose = scenarios.poses[0, :1]
    rows: list[list[object]] = []
    for name in ("chebyshev", "exact", "projected-sos"):
        backend = rp.checker(name)
        seconds = min(_timed(lambda _, b=backend: b(pose, one, scenarios.ego), range(2000)) for _ in range(5))
        rows.append([name, seconds * 1e6])
    table("A call with one pose and one mode (aim: overhead below 20 µs)", ["backend", "µs"], rows)


def batches(scenarios: Scenarios) -> None:
    """Batches of trajectories on one and on all cores, and their memory."""
    pred, ego = scenarios.predictions[0], scenarios.ego
    rng = np.random.default_rng(0)
    rows: list[list[object]] = []
    cores = sorted(os.sched_getaffinity(0))
    for name in ("exact", "chebyshev", "projected-sos"):
        backend = rp.checker(name)
        for size in (1_112, 11_112):
            poses = scenarios.poses[rng.integers(0, 1, size)] + rng.normal(0, 2.0, (size, 1, 3)) * [1, 1, 0.1]
            backend(poses, pred, ego)
            seconds = []
            for use in (cores[:1], cores):
                os.sched_setaffinity(0, use)
                seconds.append(min(_timed(lambda _, p=poses, b=backend: b(p, pred, ego), range(1)) for _ in range(5)))
            os.sched_setaffinity(0, cores)
            tracemalloc.start()
            backend(poses, pred, ego)
            peak = tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
            count = size * pred.means.shape[0] * pred.means.shape[1]
            rows.append([name, count, seconds[0] / count * 1e9, seconds[0] / seconds[1], peak / 1e6])
    head = ["backend", "mode-steps", "ns each, one core", f"speed-up on {len(cores)} cores", "MB above the inputs"]
    table("Batches (aim: ≥ 1.8 on two cores, ≤ 200 MB for 1e6 mode-steps)", head, rows)


@nb.njit(error_model="numpy")
def _arithmetic(x: Array, rounds: int) -> tuple[float, float]:
    a = b = 0.0
    for _ in range(rounds):
        for v in x:
            a += math.exp(-v)
            b += math.erfc(v)
    return a, b


@nb.njit(error_model="numpy")
def _exponentials(x: Array, rounds: int) -> float:
    a = 0.0
    for _ in range(rounds):
        for v in x:
            a += math.exp(-v)
    return a


def limit() -> None:
    """What exp and erfc alone cost for 90 modes: one exp is the least any of these methods takes."""
    x = np.linspace(0.1, 5.0, 90)
    _exponentials(x, 1)
    _arithmetic(x, 1)
    exp = min(_timed(lambda _: _exponentials(x, 1000), range(1)) for _ in range(5)) / 1000
    both = min(_timed(lambda _: _arithmetic(x, 1000), range(1)) for _ in range(5)) / 1000
    rows: list[list[object]] = [["exp", exp * 1e6], ["erfc", (both - exp) * 1e6]]
    table("Arithmetic alone, one per mode of a scenario", ["function", "µs per 90"], rows)


def _timed(call: Callable[[int], Any], arguments: range) -> float:
    """Mean seconds per call."""
    began = perf_counter()
    for i in arguments:
        call(i)
    return (perf_counter() - began) / len(arguments)


def _keep(best: dict[str, float], label: str, seconds: float) -> None:
    best[label] = min(best.get(label, np.inf), seconds)


def _label(name: str, options: dict[str, Any]) -> str:
    return " ".join([name, *map(str, options.values())])


if __name__ == "__main__":
    sys.exit(main())
