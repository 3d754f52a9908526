"""`riskplan simulate`: drive in a closed loop, planning anew while the agents move."""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING

from riskplan import interrupt
from riskplan.commands.shared import (
    NO_PLAN,
    SOLVED,
    check_names,
    check_out,
    json_option,
    place,
    progress,
    scenario_options,
)

if TYPE_CHECKING:
    from riskplan.closed_loop_result import Simulation


def add(to: argparse.ArgumentParser) -> None:
    """Its options."""
    scenario_options(to)
    to.add_argument("--planner", default="rrt", metavar="NAME", help="see `riskplan planners`; default rrt")
    to.add_argument("--checker", default="exact", metavar="NAME", help="see `riskplan checkers`; default exact")
    to.add_argument("--bound", type=float, default=0.01, metavar="RISK", help="on every plan; default 0.01")
    to.add_argument("--dependence", default="independent", metavar="NAME", help="independent, persistent or boole")
    to.add_argument("--between-steps", default="grid", metavar="NAME", help="grid, or inflated: risk at all times")
    to.add_argument("--steps", type=int, metavar="N", help="most decisions; default: the scenario's horizon")
    to.add_argument("--replan", type=float, default=0.1, metavar="S", help="between decisions [s]; default 0.1")
    to.add_argument("--time-limit", type=float, default=0.08, metavar="S", help="of each search [s]; default 0.08")
    to.add_argument("--seed", type=int, default=0, metavar="N", help="of all randomness; default 0")
    to.add_argument("--out", type=place, metavar="DIR", help="write simulation.json")
    json_option(to)


def run(args: argparse.Namespace) -> int:
    """Exit status: 0 if it arrived."""
    from riskplan.closed_loop import simulate
    from riskplan.io import load_scenario
    from riskplan.io.commonroad import load_commonroad

    check_names([args.checker])
    check_out(args.out)
    recorded = args.scenario.suffix.lower() == ".xml"
    scene = load_commonroad(args.scenario) if recorded else load_scenario(args.scenario, args.problem)
    with progress(f"driving with {args.planner}"):
        done = simulate(
            scene,
            planner=args.planner,
            checker=args.checker,
            bound=args.bound,
            dependence=args.dependence,
            steps=args.steps,
            replan=args.replan,
            time_limit=args.time_limit,
            seed=args.seed,
            problem=args.problem,
            between_steps=args.between_steps,
            stop=interrupt.requested,
        )
    files = {}
    if args.out is not None:
        args.out.mkdir(parents=True, exist_ok=True)
        files["simulation"] = str(args.out / "simulation.json")
        done.save(files["simulation"])
    if args.json:
        print(json.dumps({**done.summary(), "files": files}, allow_nan=False))
    else:
        print("\n".join(_lines(done)))
        for path in files.values():
            print(f"wrote {path}")
    return SOLVED if done.status == "arrived" else NO_PLAN


def _lines(done: Simulation) -> list[str]:
    s = done.summary()
    median, p95, worst = (1e3 * s["latency"][name] for name in ("median", "p95", "worst"))
    shares = ", ".join(f"{name} {100 * s[name]:.0f} %" for name in ("kept", "planned", "fallback"))
    met = s["collision"]
    contact = "none" if met is None else f"with {met['agent']} at {met['time']:.2f} s, what was driven: {met['action']}"
    return [
        f"{s['name'] or 'scenario'}: {s['status']} after {s['duration']:.1f} s and {s['progress']:.1f} m",
        f"  decisions  {s['decisions']}: {shares}",
        f"  latency    median {median:.0f} ms, p95 {p95:.0f} ms, worst {worst:.0f} ms",
        f"  risk       spent {s['spent']:.3g}, bound on every plan {s['bound']:g}",
        f"  collision  {contact}",
    ]
