"""`riskplan plan`: plan a trajectory within a risk bound."""

from __future__ import annotations

import argparse

from riskplan.commands.shared import (
    NO_PLAN,
    SOLVED,
    audit_options,
    check_names,
    check_out,
    for_dependence,
    names_of,
    place,
    planned,
    risk,
    scenario_options,
    show,
    write,
)


def add(to: argparse.ArgumentParser) -> None:
    """Its options."""
    scenario_options(to)
    to.add_argument("--planner", default="rrt", metavar="NAME", help="see `riskplan planners`; default rrt")
    to.add_argument("--checker", default="exact", metavar="NAME", help="see `riskplan checkers`; default exact")
    to.add_argument("--bound", type=risk, default=0.01, metavar="RISK", help="on the total, or `none`; default 0.01")
    to.add_argument("--dependence", default="independent", metavar="NAME", help="independent, persistent or boole")
    to.add_argument("--between-steps", default="grid", metavar="NAME", help="grid, or inflated: risk at all times")
    to.add_argument("--time-limit", type=float, default=1.0, metavar="S", help="of the search [s]; default 1")
    to.add_argument("--step-bound", type=risk, metavar="RISK", help="on every step, over all agents")
    to.add_argument("--agent-bound", type=risk, metavar="RISK", help="on every agent, over all steps")
    to.add_argument("--iterations", type=int, metavar="N", help="of the search, for the same plan again anywhere")
    to.add_argument("--workers", type=int, default=1, metavar="N", help="processes, one seed each; default 1")
    to.add_argument("--audit", action="append", metavar="NAMES", help="checkers for the report; default --checker")
    to.add_argument("--out", type=place, metavar="DIR", help="write plan.json, report.json, scene.html, scene.png")
    audit_options(to)


def run(args: argparse.Namespace) -> int:
    """Exit status."""
    from riskplan.io import load_scenario
    from riskplan.planning import make_planner

    names = names_of(args.audit) or [args.checker]
    check_names([args.checker, *names])
    make_planner(args.planner)
    check_out(args.out)
    scenario = for_dependence(load_scenario(args.scenario, args.problem), args.dependence)
    options = {
        "bound": args.bound,
        "dependence": args.dependence,
        "time_limit": args.time_limit,
        "seed": args.seed,
        "between_steps": args.between_steps,
        "step_bound": args.step_bound,
        "agent_bound": args.agent_bound,
        "iterations": args.iterations,
        "workers": args.workers,
    }
    plan, report = planned(scenario, args.planner, args.checker, names, args.monte_carlo, options)
    files = write(args.out, scenario, plan, report) if args.out else {}
    show(args.json, plan, report, files)
    return SOLVED if plan.solved else NO_PLAN
