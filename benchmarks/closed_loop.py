"""Closed loops among recorded traffic: collisions, progress, fallbacks and latency.

    python -m benchmarks.closed_loop --data DIR [--files 24] [--planners rrt prm] [--bound 0.01]

From every CommonRoad file with recorded traffic one driver is replaced for 3 s (`horizon` tasks, see the README), by
the planner deciding every 0.1 s. Baseline in the same run: "open", the first plan driven to its end without deciding
anew (no plan: braking). Recorded vehicles do not react: one that comes from behind into a braking ego is counted apart.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import riskplan as rp
from riskplan.closed_loop import simulate_task
from riskplan.io.commonroad import CommonRoadScene, HorizonTask, load_commonroad


def main() -> None:
    """Run and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, metavar="DIR", help="searched for CommonRoad files")
    parser.add_argument("--files", type=int, default=24, help="spread over those found; default 24")
    parser.add_argument("--planners", nargs="+", default=["rrt", "prm"])
    parser.add_argument("--bound", type=float, default=0.01)
    parser.add_argument("--dependence", default="independent")
    parser.add_argument("--time-limit", type=float, default=0.08)
    args = parser.parse_args()
    tasks = list(horizon_tasks(args.data, args.files))
    if not tasks:
        sys.exit(f"no CommonRoad file with recorded traffic in {args.data}")
    options = {"bound": args.bound, "dependence": args.dependence, "time_limit": args.time_limit}
    agents = np.median([len(task.scenario.agents) for _, task in tasks])
    print(f"**{len(tasks)} recorded drivers replaced for 3 s, median {agents:g} agents within 100 m, ", end="")
    print(f"every plan within {args.bound:g} ({args.dependence}), searches of at most {1e3 * args.time_limit:g} ms**\n")
    print(
        "| planner | arrived | collisions: plan within the bound | above it | from behind | progress / driver's ",
        end="",
    )
    print("| kept | planned | fallback | median spent risk | median [ms] | p95 [ms] | worst [ms] |")
    print("|---" * 13 + "|")
    for planner in args.planners:
        for name, more in ((planner, {}), (f"{planner}, open", {"replan": 3.0})):
            runs = [(task, simulate_task(task, scene, planner=planner, **options, **more)) for scene, task in tasks]
            print(_row(name, runs), flush=True)


def horizon_tasks(folder: Path, count: int) -> Iterator[tuple[CommonRoadScene, HorizonTask]]:
    """Tasks from up to `count` files spread over those in the folder; the seed is fixed."""
    rng = np.random.default_rng(0)
    files = sorted(folder.rglob("*.xml"))
    for path in files[:: max(len(files) // max(count, 1), 1)][:count]:
        try:
            scene = load_commonroad(path)
        except rp.InputError:
            continue
        task = scene.horizon_task(rng)
        if task is not None:
            yield scene, task


def _row(name: str, runs: list) -> str:
    within = above = behind = 0
    for _, run in runs:
        if run.collision is None:
            continue
        if _from_behind(run):
            behind += 1
        elif run.collision.within_bound:
            within += 1
        else:
            above += 1
    latencies = 1e3 * np.concatenate([[c.latency for c in run.cycles] for _, run in runs])
    progress = [run.progress / max(_way(task.driver.positions), 1.0) for task, run in runs]
    shares = [np.mean([run.share(action) for _, run in runs]) for action in ("kept", "planned", "fallback")]
    cells = [
        name,
        f"{sum(run.status == 'arrived' for _, run in runs)}/{len(runs)}",
        str(within),
        str(above),
        str(behind),
        f"{np.median(progress):.2f}",
        *(f"{100 * share:.0f} %" for share in shares),
        f"{np.median([run.spent for _, run in runs]):.2g}",
        *(f"{value:.0f}" for value in (*np.quantile(latencies, [0.5, 0.95]), latencies.max())),
    ]
    return "| " + " | ".join(cells) + " |"


def _way(positions: np.ndarray) -> float:
    return float(np.hypot(*np.diff(positions, axis=0).T).sum())


def _from_behind(run: rp.Simulation) -> bool:
    """Whether the other's centre was behind the ego's rear axle, and it the faster."""
    x, y, heading, speed, _ = run.states[np.searchsorted(run.times, run.collision.time) - 1]
    track = next(t for t in run.tracks if t.name == run.collision.agent)
    at = track.at([run.collision.time])
    ahead = np.cos(heading) * (at.positions[0, 0] - x) + np.sin(heading) * (at.positions[0, 1] - y)
    return bool(ahead < -0.25 * run.body[0] and at.speeds[0] > speed)


if __name__ == "__main__":
    main()
