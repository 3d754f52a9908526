"""What the subcommands of `riskplan` do. Each takes the parsed arguments and returns the exit status."""

# ruff: noqa: T201  printing is what they are for

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from checkers import InputError
from riskplan import arguments, interrupt

if TYPE_CHECKING:
    from checkers import Checker
    from riskplan.result import Plan, Report
    from riskplan.scene import Scenario

SOLVED, NO_PLAN = 0, 1
DEMO = Path(__file__).parent / "data" / "overtake.yaml"
DEMO_BOUND, DEMO_TIME_LIMIT = 0.05, 10.0


def run(argv: Sequence[str] | None) -> int:
    """Run a command line; everything that goes wrong is raised."""
    args = arguments.parser().parse_args(argv)
    return _COMMANDS[args.command](args)


def _plan(args: argparse.Namespace) -> int:
    from riskplan.io import load_scenario  # noqa: PLC0415
    from riskplan.planning import make_planner  # noqa: PLC0415

    names = _names(args.audit) or [args.checker]
    _known([args.checker, *names])
    make_planner(args.planner)
    _check_out(args.out)
    scenario = load_scenario(args.scenario, args.problem)
    options = {
        "bound": args.bound,
        "dependence": args.dependence,
        "time_limit": args.time_limit,
        "seed": args.seed,
    }
    plan, report = _planned(scenario, args.planner, args.checker, names, args.monte_carlo, options)
    files = _write(args.out, scenario, plan, report) if args.out else {}
    _show(args.json, plan, report, files)
    return SOLVED if plan.solved else NO_PLAN


def _planned(
    scenario: Scenario,
    planner: str,
    checker: str,
    names: Sequence[str],
    samples: int,
    options: dict[str, Any],
) -> tuple[Plan, Report | None]:
    from riskplan.planning import plan as make_plan  # noqa: PLC0415
    from riskplan.report import audit  # noqa: PLC0415

    limit = f"time limit {options['time_limit']:g} s; the first run ever compiles for about 20 s"
    with _progress(f"planning with {planner} ({limit})"):
        plan = make_plan(scenario, planner=planner, checker=checker, stop=interrupt.requested, **options)
    if not plan.solved:
        return plan, None
    with _progress("judging the plan"):
        return plan, audit(plan, scenario, names, samples, options["seed"])


def _assess(args: argparse.Namespace) -> int:
    from riskplan.assess import judge_again  # noqa: PLC0415
    from riskplan.io import load_plan, load_scenario  # noqa: PLC0415
    from riskplan.report import audit  # noqa: PLC0415

    scenario, stored = load_scenario(args.scenario, args.problem), load_plan(args.trajectory)
    if not stored.solved:
        raise InputError(f"{args.trajectory}: expected a plan with a trajectory, got status {stored.status!r}")
    own = str(stored.settings.get("checker", "exact"))
    names = _names(args.checker) or [own]
    _known([own, *names])
    backends: list[str | Checker] = [_as_planned(name, stored) for name in names]
    with _progress("judging the trajectory"):
        plan, same = judge_again(stored, scenario, _as_planned(own, stored))
        report = audit(plan, scenario, backends, args.monte_carlo, args.seed)
    if not same:
        note = "states other numbers: another scenario, version or machine"
        print(f"riskplan: note: {args.trajectory} {note}", file=sys.stderr)
    _show(args.json, plan, report, {}, reproduced=same)
    return NO_PLAN if report.within_bound is False else SOLVED


def _as_planned(name: str, plan: Plan) -> Checker:
    """A backend; the plan's own one with the options it was planned with."""
    from checkers import checker  # noqa: PLC0415

    options = plan.settings.get("checker_options") if name == plan.settings.get("checker") else None
    return checker(name, **(options or {}))


def _render(args: argparse.Namespace) -> int:
    from riskplan.io import load_plan, load_scenario  # noqa: PLC0415
    from riskplan.pictures import render  # noqa: PLC0415

    scenario = load_scenario(args.scenario, args.problem)
    plan = load_plan(args.plan) if args.plan else None
    with _progress(f"drawing {args.out}"):
        render(scenario, plan, args.out)
    return SOLVED


def _checkers(args: argparse.Namespace) -> int:
    from checkers import checkers  # noqa: PLC0415

    found = {name: {**vars(info), "kind": info.kind.value} for name, info in checkers().items()}
    _list(args.json, found, ("name", "kind", "needs", "assumption", "source", "cost"))
    return SOLVED


def _planners(args: argparse.Namespace) -> int:
    from riskplan.planning import planners  # noqa: PLC0415

    keys = ("name", "summary", "source")
    _list(args.json, {name: {k: getattr(info, k) for k in keys} for name, info in planners().items()}, keys)
    return SOLVED


def _demo(args: argparse.Namespace) -> int:
    from riskplan.io import load_scenario  # noqa: PLC0415

    _check_out(args.out)
    scenario = load_scenario(DEMO)
    options = {"bound": DEMO_BOUND, "time_limit": DEMO_TIME_LIMIT, "seed": 0, "dependence": "independent"}
    names = ["exact", "imhof", "sos", "chebyshev"]
    results = {p: _planned(scenario, p, "exact", names, arguments.SAMPLES, options) for p in ("rrt", "prm")}
    files = {p: _write(args.out / p, scenario, *r) if args.out else {} for p, r in results.items()}
    if args.json:
        print(json.dumps({p: _as_dict(*r, files[p]) for p, r in results.items()}, allow_nan=False))
    else:
        for p, r in results.items():
            _show(False, *r, files[p], title=f"{scenario.name}, {p}")
            print()
        if not args.out:
            print("--out DIR writes plan, report and pictures")
    return SOLVED if all(plan.solved for plan, _ in results.values()) else NO_PLAN


def _names(given: Sequence[str] | None) -> list[str]:
    """Names from repeated options, each a list by comma."""
    return [name.strip() for text in given or () for name in text.split(",") if name.strip()]


def _known(names: Sequence[str]) -> None:
    from checkers import checker  # noqa: PLC0415

    for name in names:
        checker(name)


def _check_out(out: Path | None) -> None:
    from riskplan.outputs import check_folder  # noqa: PLC0415

    if out is not None:
        check_folder(out)


def _write(out: Path, scenario: Scenario, plan: Plan, report: Report | None) -> dict[str, str]:
    from riskplan.outputs import write_results  # noqa: PLC0415

    with _progress(f"writing {out}"):
        return write_results(out, scenario, plan, report)


def _as_dict(plan: Plan, report: Report | None, files: dict[str, str]) -> dict[str, Any]:
    from riskplan.io.plan_file import plan_to_dict, report_to_dict  # noqa: PLC0415

    told = None if report is None else report_to_dict(report)
    return {
        "status": plan.status,
        "message": plan.message,
        "plan": plan_to_dict(plan),
        "report": told,
        "files": files,
    }


def _show(
    as_json: bool, plan: Plan, report: Report | None, files: dict[str, str], title: str = "", **more: Any
) -> None:
    if as_json:
        print(json.dumps({**_as_dict(plan, report, files), **more}, allow_nan=False))
        return
    from riskplan.report_table import print_report  # noqa: PLC0415

    print_report(plan, report, title=title)
    for path in files.values():
        print(f"wrote {path}")


def _list(as_json: bool, rows: dict[str, dict[str, str]], keys: Sequence[str]) -> None:
    if as_json:
        print(json.dumps(rows))
        return
    from riskplan.report_table import print_list  # noqa: PLC0415

    print_list(rows, keys)


@contextmanager
def _progress(message: str) -> Iterator[None]:
    """A line on a terminal's stderr while something runs; it is gone afterwards."""
    shown = sys.stderr.isatty()
    interrupt.check()
    if shown:
        print(f"{message} …", end="", file=sys.stderr, flush=True)
    try:
        yield
    finally:
        if shown:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)
    interrupt.check()


_COMMANDS: dict[str, Callable[[argparse.Namespace], int]] = {
    "plan": _plan,
    "assess": _assess,
    "render": _render,
    "checkers": _checkers,
    "planners": _planners,
    "demo": _demo,
}
