"""`riskplan export`: a stored plan in another program's format."""

from __future__ import annotations

import argparse
import json

from checkers import InputError
from riskplan.commands.shared import SOLVED, json_option, place

FORMATS = ("csv", "parquet", "ros-path", "autoware", "commonroad")


def add(to: argparse.ArgumentParser) -> None:
    """Its options."""
    to.add_argument("plan", type=place, metavar="PLAN", help="a plan.json")
    to.add_argument("--to", required=True, metavar="FORMAT", help=", ".join(FORMATS))
    to.add_argument("--out", type=place, required=True, metavar="FILE", help="file to write")
    to.add_argument("--frame", default="map", metavar="NAME", help="frame of the messages; default map")
    of = to.add_argument_group("commonroad")
    of.add_argument("--scenario", type=place, metavar="XML", help="the CommonRoad file the plan was made for")
    of.add_argument("--problem", type=int, default=0, metavar="N", help="of that file; default 0")
    of.add_argument("--vehicle-model", default="PM", metavar="NAME", help="PM or KS; default PM")
    of.add_argument("--vehicle-type", type=int, default=2, metavar="N", help="1, 2 or 3; default 2 (BMW 320i)")
    of.add_argument("--cost-function", default="JB1", metavar="NAME", help="default JB1")
    json_option(to)


def run(args: argparse.Namespace) -> int:
    """Exit status."""
    from checkers.validate import as_option
    from riskplan.io import load_plan, save_solution, save_trajectory

    as_option("--to", args.to, FORMATS)
    if args.to == "commonroad" and args.scenario is None:
        raise InputError("--scenario: expected the CommonRoad file the plan was made for, got none")
    plan = load_plan(args.plan)
    if args.to == "commonroad":
        save_solution(
            plan,
            args.out,
            args.scenario,
            args.problem,
            vehicle_model=args.vehicle_model,
            vehicle_type=args.vehicle_type,
            cost_function=args.cost_function,
        )
    else:
        save_trajectory(plan, args.out, args.to, args.frame)
    print(json.dumps({"files": {args.to: str(args.out)}}) if args.json else f"wrote {args.out}")
    return SOLVED
