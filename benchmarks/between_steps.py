"""What a bound on the risk at all times costs, against the risk at the times of the grid.

    python -m benchmarks.between_steps --data DIR [--files 24] [--bounds 0.1 0.01]

On `horizon` tasks (recorded drivers replaced for 3 s, see the README): by how much bodies grow, what a plan made on the
grid states for all times, and how many tasks a planner solves either way. The step is halved as well: half the growth.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import numpy as np

import riskplan as rp
from benchmarks.closed_loop import horizon_tasks
from riskplan.evaluator import RiskEvaluator


def main() -> None:
    """Run and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, metavar="DIR", help="searched for CommonRoad files")
    parser.add_argument("--files", type=int, default=24, help="spread over those found; default 24")
    parser.add_argument("--bounds", nargs="+", type=float, default=[0.1, 0.01])
    parser.add_argument("--time-limit", type=float, default=1.0)
    args = parser.parse_args()
    tasks = [task.scenario for _, task in horizon_tasks(args.data, args.files)]
    print(f"**{len(tasks)} tasks, rrt, {args.time_limit:g} s**\n")
    print(
        "| step [s] | bound | growth of the ego, ends and sides [m] | of an agent | solved on the grid, median [ms] ",
        end="",
    )
    print("| solved at all times, median [ms] | risk of the grid's plans: on the grid | at all times |")
    print("|---" * 8 + "|")
    for step in (0.1, 0.05):
        scenes = [replace(s, time_step=step) for s in tasks]
        for bound in args.bounds:
            print(_row(scenes, step, bound, args.time_limit), flush=True)


def _row(scenes: list[rp.Scenario], step: float, bound: float, limit: float) -> str:
    wide = [rp.inflated(s, bound) for s in scenes]
    found = {mode: [_planned(s, bound, limit, mode) for s in scenes] for mode in ("grid", "inflated")}
    pairs = [(p, w) for (p, _), w in zip(found["grid"], wide, strict=True) if p.solved and p.risk is not None]
    on_grid = [float(p.risk.total) for p, _ in pairs]
    at_all = [_judged(p, w) for p, w in pairs]
    ego, agents = np.median([w.ego for w in wide], axis=0), np.median(np.vstack([w.agents for w in wide]), axis=0)
    cells = [
        f"{step:g}",
        f"{bound:g}",
        f"{ego[0]:.2f}, {ego[1]:.2f}",
        f"{agents[0]:.2f}, {agents[1]:.2f}",
        *(
            f"{100 * np.mean([p.solved for p, _ in found[mode]]):.0f} %, "
            f"{1e3 * np.median([t for p, t in found[mode] if p.solved] or [np.nan]):.0f}"
            for mode in ("grid", "inflated")
        ),
        *(f"{np.median(risks or [np.nan]):.2g}" for risks in (on_grid, at_all)),
    ]
    return "| " + " | ".join(cells) + " |"


def _planned(scene: rp.Scenario, bound: float, limit: float, mode: str) -> tuple[rp.Plan, float]:
    began = perf_counter()
    plan = rp.plan(scene, bound=bound, time_limit=limit, between_steps=mode)
    return plan, perf_counter() - began


def _judged(plan: rp.Plan, wide: rp.Inflated) -> float:
    s = wide.scenario
    risk, _ = RiskEvaluator(s.agents, s.ego, rp.checker("exact"), s.times).judge(plan.poses)
    return float(wide.stated(risk).total)


if __name__ == "__main__":
    main()
