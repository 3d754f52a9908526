"""`riskplan demo`: plan a shipped scene with rrt and with prm."""

from __future__ import annotations

import argparse
import json
import sys
from typing import TYPE_CHECKING

from checkers import InputError
from riskplan.commands.shared import (
    NO_PLAN,
    SAMPLES,
    SOLVED,
    as_dict,
    check_out,
    json_option,
    place,
    planned,
    show,
    write,
)

if TYPE_CHECKING:
    from riskplan.scene import Scenario

DEMO_BOUND, DEMO_TIME_LIMIT = 0.05, 10.0


def add(to: argparse.ArgumentParser) -> None:
    """Its options."""
    to.add_argument("--out", type=place, metavar="DIR", help="write DIR/rrt and DIR/prm")
    to.add_argument(
        "--scene",
        metavar="NAME",
        help="traffic (agents predicted by the shipped network) or overtake; default: traffic, without torch overtake",
    )
    json_option(to)


def run(args: argparse.Namespace) -> int:
    """Exit status."""
    check_out(args.out)
    scenario = _scene(args.scene)
    options = {"bound": DEMO_BOUND, "time_limit": DEMO_TIME_LIMIT, "seed": 0, "dependence": "independent"}
    names = ["exact", "imhof", "sos", "chebyshev"]
    results = {p: planned(scenario, p, "exact", names, SAMPLES, options) for p in ("rrt", "prm")}
    files = {p: write(args.out / p, scenario, *r) if args.out else {} for p, r in results.items()}
    if args.json:
        print(json.dumps({p: as_dict(*r, files[p]) for p, r in results.items()}, allow_nan=False))
    else:
        for p, r in results.items():
            show(False, *r, files[p], title=f"{scenario.name}, {p}")
            print()
        if not args.out:
            print("--out DIR writes plan, report and pictures")
    return SOLVED if all(plan.solved for plan, _ in results.values()) else NO_PLAN


def _scene(name: str | None) -> Scenario:
    """The scene asked for; by default the one with learned agents if torch is there."""
    from riskplan.demo_scene import demo_scene

    if name is not None:
        return demo_scene(name)
    try:
        return demo_scene("traffic")
    except InputError as error:
        if "pip install" not in str(error):
            raise
        print(f"riskplan: note: planning the hand-made scene instead: {error}", file=sys.stderr)
        return demo_scene("overtake")
