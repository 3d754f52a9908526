"""Roadmaps built once and asked again: `python -m benchmarks.roadmaps --data DIR`.

For each `horizon` task of `benchmarks.planning`: sample and connect the vertices, save and load them, and plan on that
roadmap at several bounds, each time for predictions that are new to it. A re-query is a whole `rp.plan`, preparation
of the agents and judging included; only those answered by this roadmap count, for else `prm` makes a larger one.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from time import perf_counter, process_time

import numpy as np

import riskplan as rp
from benchmarks.planning_tasks import Task, progress, tasks_of


def main(arguments: list[str] | None = None) -> int:
    """Parse, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", required=True, help="directory with CommonRoad files, searched recursively")
    parser.add_argument("--files", type=int, default=12, help="how many files, spread evenly over the sorted list")
    parser.add_argument("--size", type=int, default=1000, help="vertices of a roadmap")
    parser.add_argument("--bounds", default="0.3,0.1,0.01,0.001", help="on the total, comma-separated")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--cpu", action="store_true", help="processor time instead of wall clock, for a busy machine")
    options = parser.parse_args(arguments)
    files = sorted(Path(options.data).rglob("*.xml"))
    if not files:
        print(f"benchmarks.roadmaps: no .xml files under {options.data}", file=sys.stderr)
        return 2
    chosen = [files[i] for i in np.unique(np.linspace(0, len(files) - 1, options.files).astype(int))]
    tasks = [t for f in progress(chosen, "tasks") for t in tasks_of(f, options.seed) if t.kind == "horizon"]
    rp.plan(tasks[0].scenario, "prm", time_limit=0.2)  # loads the kernels
    built, loaded, roadmaps = zip(*(build(task, options) for task in progress(tasks, "building")), strict=True)
    print(
        f"{len(tasks)} tasks, {options.size} vertices, median {np.median([len(r.ends) for r in roadmaps]):.0f} edges: "
    )
    for name, values in (("build", built), ("load", loaded)):
        print(f"{name} median {1e3 * np.median(values):.0f} ms, slowest {1e3 * max(values):.0f} ms")
    print("\n| bound | answered | median [ms] | p95 [ms] |\n|---|---|---|---|")
    for bound in map(float, options.bounds.split(",")):
        times = [
            t for task, roadmap in zip(tasks, roadmaps, strict=True) if (t := query(task, roadmap, bound, options)) > 0
        ]
        cells = "– | –" if not times else f"{1e3 * np.median(times):.1f} | {1e3 * np.quantile(times, 0.95):.1f}"
        print(f"| {bound:g} | {len(times)}/{len(tasks)} | {cells} |")
    return 0


def build(task: Task, options: argparse.Namespace) -> tuple[float, float, rp.Roadmap]:
    """Seconds to build and to load, and the roadmap; the static world is packed before."""
    clock = process_time if options.cpu else perf_counter
    _ = task.scenario.world.packed
    began = clock()
    roadmap = rp.Roadmap.build(task.scenario, options.size, task.seed)
    built = clock()
    with tempfile.TemporaryDirectory() as folder:
        roadmap.save(Path(folder) / "map.npz")
        saved = clock()
        again = rp.Roadmap.load(Path(folder) / "map.npz")
        return built - began, clock() - saved, again


def query(task: Task, roadmap: rp.Roadmap, bound: float, options: argparse.Namespace) -> float:
    """Seconds of a plan on this roadmap; 0 if it has none."""
    clock = process_time if options.cpu else perf_counter
    began = clock()
    plan = rp.plan(task.scenario, rp.Prm(roadmap=roadmap), bound=bound, time_limit=0.5, seed=task.seed)
    seconds = clock() - began
    return seconds if plan.solved and plan.stats["roadmaps"] == 1 else 0.0


if __name__ == "__main__":
    sys.exit(main())
