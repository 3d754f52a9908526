"""`riskplan render`: draw a scenario and a plan."""

from __future__ import annotations

import argparse
import sys
import warnings

from riskplan.commands.shared import SOLVED, place, progress, scenario_options


def add(to: argparse.ArgumentParser) -> None:
    """Its options."""
    scenario_options(to)
    to.add_argument("plan", type=place, nargs="?", metavar="PLAN", help="a plan.json")
    to.add_argument("--out", type=place, required=True, metavar="FILE", help=".html, .png, .gif or .mp4")
    to.add_argument("--view", default="auto", metavar="NAME", help="3d (needs Chromium, but for .html), top, or auto")
    to.add_argument("--size", type=size, metavar="WxH", help="pixels, 1280x640 say")
    to.add_argument("--time", type=float, default=0.0, metavar="S", help="what a still shows [s]; default 0")
    to.add_argument("--fixed", action="store_true", help="the camera of a 3-D film stays where it is")
    to.add_argument("--samples", type=int, default=0, metavar="N", help="futures of each agent as lines; default 0")
    to.add_argument("--density", type=int, default=0, metavar="N", help="positions per agent and step as dots")
    to.add_argument("--seed", type=int, default=0, metavar="N", help="of both; default 0")


def size(text: str) -> tuple[int, int]:
    """Width and height from "WxH"; argparse quotes the name: invalid size value."""
    width, height = text.lower().split("x")
    return int(width), int(height)


def run(args: argparse.Namespace) -> int:
    """Exit status."""
    from riskplan.io import load_plan, load_scenario
    from riskplan.pictures import render

    scenario = load_scenario(args.scenario, args.problem)
    plan = load_plan(args.plan) if args.plan else None
    look = {name: getattr(args, name) for name in ("view", "size", "time", "samples", "density", "seed")}
    with warnings.catch_warnings(record=True) as notes:
        warnings.simplefilter("always", UserWarning)
        with progress(f"drawing {args.out}"):
            render(scenario, plan, args.out, follow=not args.fixed, **look)
    for note in notes:
        if note.category is UserWarning:
            print(f"riskplan: note: {note.message}", file=sys.stderr)
    return SOLVED
