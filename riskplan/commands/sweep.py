"""`riskplan sweep`: what the best plan costs at other bounds."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from checkers import InputError
from riskplan import interrupt
from riskplan.commands.shared import (
    NO_PLAN,
    SOLVED,
    check_names,
    check_out,
    for_dependence,
    json_option,
    names_of,
    place,
    progress,
    scenario_options,
)


def add(to: argparse.ArgumentParser) -> None:
    """Its options."""
    scenario_options(to)
    to.add_argument("--bounds", metavar="RISKS", help="comma-separated; default 1e-5,1e-4,1e-3,0.01,0.03,0.1,0.3")
    to.add_argument("--planner", default="rrt-star", metavar="NAME", help="see `riskplan planners`; default rrt-star")
    to.add_argument("--checker", default="exact", metavar="NAME", help="see `riskplan checkers`; default exact")
    to.add_argument("--dependence", default="independent", metavar="NAME", help="independent, persistent or boole")
    to.add_argument("--time-limit", type=float, default=1.0, metavar="S", help="of each search [s]; default 1")
    to.add_argument("--iterations", type=int, metavar="N", help="of each search, for the same plans again anywhere")
    to.add_argument("--seed", type=int, default=0, metavar="N", help="of all randomness; default 0")
    to.add_argument("--out", type=place, metavar="DIR", help="write sweep.json and sweep.png")
    json_option(to)


def run(args: argparse.Namespace) -> int:
    """Exit status."""
    from riskplan.io import load_scenario
    from riskplan.pareto import BOUNDS, plot_sweep, sweep, sweep_rows
    from riskplan.planning import make_planner

    check_names([args.checker])
    make_planner(args.planner)
    check_out(args.out)
    bounds = BOUNDS if args.bounds is None else [_bound(text) for text in names_of([args.bounds])]
    scenario = for_dependence(load_scenario(args.scenario, args.problem), args.dependence)
    fixed = (args.planner, args.checker, args.dependence, args.time_limit, args.seed, interrupt.requested)
    with progress(f"planning at {len(bounds)} bounds, {args.time_limit:g} s each"):
        points = sweep(scenario, bounds, *fixed, iterations=args.iterations)
    rows = sweep_rows(points)
    told = {"format": "riskplan-sweep", "planner": args.planner, "checker": args.checker, "points": rows}
    files = {}
    if args.out:
        args.out.mkdir(parents=True, exist_ok=True)
        files = {"sweep": str(args.out / "sweep.json"), "plot": str(args.out / "sweep.png")}
        Path(files["sweep"]).write_text(json.dumps(told, indent=1, allow_nan=False) + "\n", encoding="utf-8")
        plot_sweep(points, files["plot"])
    if args.json:
        print(json.dumps({**told, "files": files}, allow_nan=False))
    else:
        from riskplan.report_table import print_list

        keys = ("bound", "arrival", "cost", "risk", "front")
        print_list({str(row["bound"]): _texts(row) for row in rows}, keys)
        for path in files.values():
            print(f"wrote {path}")
    return SOLVED if any(row["arrival"] is not None for row in rows) else NO_PLAN


def _texts(row: dict[str, object]) -> dict[str, str]:
    """A row for a person."""
    cells = {name: "-" if row[name] is None else f"{row[name]:.3g}" for name in ("bound", "arrival", "cost", "risk")}
    mark = "yes" if row["on_front"] else ("" if row["status"] == "solved" else str(row["status"]).replace("_", " "))
    return {**cells, "front": mark}


def _bound(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError(f"argument --bounds: expected numbers separated by commas, got {text!r}") from None
