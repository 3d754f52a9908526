"""Planning again and again with flat memory: `python -m benchmarks.soak --minutes 10`.

A car's day in small: random three-lane scenes, loaded from a file, planned by rrt and prm in turn, judged by several
backends, sampled, written and read back, in one process. Prints resident memory over time and fails where it grows.
"""

from __future__ import annotations

import argparse
import gc
import os
import resource
import sys
import tempfile
from collections import Counter
from pathlib import Path
from time import monotonic

import numpy as np

import riskplan as rp
from benchmarks.cases import table

GROWTH = 5.0  # what the second half may have beyond the first [MB]


def main(arguments: list[str] | None = None) -> int:
    """Parse, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args(arguments)
    rng = np.random.default_rng(args.seed)
    began, end = monotonic(), monotonic() + 60 * args.minutes
    statuses: Counter[str] = Counter()
    marks: list[list[object]] = []
    with tempfile.TemporaryDirectory() as name:
        rounds = 0
        for rounds in range(20):  # compiled, caches filled
            one_round(Path(name), rng, rounds, statuses)
        first, interval = monotonic(), max((end - monotonic()) / 10, 1.0)
        start = megabytes()
        marks.append([0.0, rounds, start])
        while monotonic() < end:
            rounds += 1
            one_round(Path(name), rng, rounds, statuses)
            if monotonic() - first >= interval * len(marks):
                marks.append([(monotonic() - first) / 60, rounds, megabytes()])
    marks.append([(monotonic() - first) / 60, rounds, megabytes()])
    table(f"{rounds} rounds in {(monotonic() - began) / 60:.1f} min", ["minutes", "rounds", "resident [MB]"], marks)
    # the end against the middle of the first half: what is kept for good shows, what comes and goes does not
    early = float(np.median([float(str(m[2])) for m in marks[: len(marks) // 2]]))
    late = float(np.median([float(str(m[2])) for m in marks[len(marks) // 2 :]]))
    files = len(os.listdir("/proc/self/fd"))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"\nResident memory, first half {early:.1f} MB, second half {late:.1f} MB, peak {peak:.1f} MB;")
    print(f"{files} files open.")
    print("Plans: " + ", ".join(f"{count} {status}" for status, count in statuses.most_common()) + ".")
    grown = late - early > GROWTH
    print("GROWS" if grown else f"Flat: {late - early:+.1f} MB, within {GROWTH:g} MB.")
    return 1 if grown else 0


def megabytes() -> float:
    """Resident now [MB]."""
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 1e6


def one_round(folder: Path, rng: np.random.Generator, number: int, statuses: Counter[str]) -> None:
    """One scene from file to report."""
    path = folder / "scene.yaml"
    rp.save_scenario(random_scene(rng), path)
    scenario = rp.load_scenario(path)
    planner = ("rrt", "prm")[number % 2]
    plan = rp.plan(scenario, planner=planner, bound=0.05, time_limit=0.5, seed=number)
    statuses[plan.status] += 1
    if plan.solved:
        rp.audit(plan, scenario, checkers=["exact", "projected-sos", "halfspace"], monte_carlo=2000, seed=number)
    rp.save_plan(plan, folder / "plan.json")
    rp.load_plan(folder / "plan.json")


def random_scene(rng: np.random.Generator) -> rp.Scenario:
    """Three lanes, one to four cars of two modes."""
    times = np.arange(41) * 0.1
    agents = []
    for i in range(int(rng.integers(1, 5))):
        lane, x, speed = 3.5 * rng.integers(0, 3), rng.uniform(15, 60), rng.uniform(4, 14)
        means = np.empty((len(times), 2, 2))
        means[:, 0] = np.column_stack([x + speed * times, np.full(len(times), lane)])
        means[:, 1] = means[:, 0] - np.column_stack([0.5 * times**2, 0 * times])
        covariances = np.zeros((len(times), 2, 2, 2))
        covariances[..., 0, 0] = ((0.2 + 0.3 * times) ** 2)[:, None]
        covariances[..., 1, 1] = ((0.15 + 0.06 * times) ** 2)[:, None]
        agents.append(
            rp.GaussianMixturePrediction(times, [0.8, 0.2], means, covariances, name=f"{i}", length=4.6, width=1.9)
        )
    return rp.Scenario(
        start=rp.State(0.0, 3.5, 0.0, 12.0),
        goal=rp.Goal.at(42.0, 3.5, radius=5.0, heading=0.0, heading_tolerance=0.3, time=(2.5, 4.0)),
        bounds=(-10.0, -1.75, 120.0, 8.75),
        agents=tuple(agents),
        ego=rp.EgoCover.discs(4.6, 1.9, 6, relative_heading=0.0),
        lanes=tuple(np.array([[-50.0, y], [200.0, y]]) for y in (0.0, 3.5, 7.0)),
    )


if __name__ == "__main__":
    sys.exit(main())
