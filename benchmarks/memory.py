"""Memory of one process over many plans: `python -m benchmarks.memory`.

A scene is planned again and again with new seeds. The resident memory is read after a tenth of the plans, when kernels
and caches are loaded, and then on: what it grows by is what planning leaks.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

import numpy as np

import riskplan as rp


def main(arguments: list[str] | None = None) -> int:
    """Parse, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plans", type=int, default=1000, help="how many, for each planner")
    parser.add_argument("--planners", default="rrt,prm,rrt-star", help="which, comma-separated")
    parser.add_argument("--iterations", type=int, default=1500, help="of each search")
    options = parser.parse_args(arguments)
    if not Path("/proc/self/statm").exists():
        print("benchmarks.memory: reads /proc/self/statm, which is not there", file=sys.stderr)
        return 2
    print(
        "| planner | plans | solved | after a tenth [MB] | at the end [MB] | growth [MB] |\n|---|---|---|---|---|---|"
    )
    for planner in options.planners.split(","):
        solved, sizes = growth(planner, options.plans, options.iterations)
        ends = f"{sizes[0]:.1f} | {sizes[-1]:.1f} | {sizes[-1] - sizes[0]:+.1f}"
        print(f"| {planner} | {options.plans} | {solved} | {ends} |", flush=True)
    return 0


def growth(planner: str, plans: int, iterations: int) -> tuple[int, np.ndarray]:
    """How many plans were solved, and the resident memory after each from a tenth of them on [MB]."""
    scenario = rp.load_scenario(Path(rp.__file__).parent / "data" / "overtake.yaml")
    solved, sizes = 0, []
    for seed in range(plans):
        plan = rp.plan(scenario, planner, bound=0.05, time_limit=60.0, seed=seed, iterations=iterations)
        solved += plan.solved
        if seed >= plans // 10:
            sizes.append(resident())
    return solved, np.array(sizes)


def resident() -> float:
    """Resident memory of this process [MB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


if __name__ == "__main__":
    sys.exit(main())
