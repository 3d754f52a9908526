"""`riskplan assess`: judge a stored trajectory again."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from checkers import InputError
from riskplan.commands.shared import (
    NO_PLAN,
    SOLVED,
    audit_options,
    check_names,
    for_dependence,
    names_of,
    place,
    progress,
    scenario_options,
    show,
)

if TYPE_CHECKING:
    from checkers import Checker
    from riskplan.result import Plan


def add(to: argparse.ArgumentParser) -> None:
    """Its options."""
    scenario_options(to)
    to.add_argument("trajectory", type=place, metavar="TRAJECTORY", help="a plan.json")
    to.add_argument("--checker", action="append", metavar="NAMES", help="repeatable, by comma; default the plan's own")
    audit_options(to)


def run(args: argparse.Namespace) -> int:
    """Exit status."""
    from riskplan.assess import judge_again
    from riskplan.io import load_plan, load_scenario
    from riskplan.report import audit

    stored = load_plan(args.trajectory)
    scenario = load_scenario(args.scenario, args.problem)
    scenario = for_dependence(scenario, str(stored.settings.get("dependence", "independent")))
    if not stored.solved:
        raise InputError(f"{args.trajectory}: expected a plan with a trajectory, got status {stored.status!r}")
    own = str(stored.settings.get("checker", "exact"))
    names = names_of(args.checker) or [own]
    check_names([own, *names])
    backends: list[str | Checker] = [_as_planned(name, stored) for name in names]
    with progress("judging the trajectory"):
        plan, same = judge_again(stored, scenario, _as_planned(own, stored))
        report = audit(plan, scenario, backends, args.monte_carlo, args.seed)
    if not same:
        note = "states other numbers: another scenario, version or machine"
        print(f"riskplan: note: {args.trajectory} {note}", file=sys.stderr)
    show(args.json, plan, report, {}, reproduced=same)
    return NO_PLAN if report.within_bound is False else SOLVED


def _as_planned(name: str, plan: Plan) -> Checker:
    """A backend; the plan's own one with the options it was planned with."""
    from checkers import checker

    options = plan.settings.get("checker_options") if name == plan.settings.get("checker") else None
    return checker(name, **(options or {}))
