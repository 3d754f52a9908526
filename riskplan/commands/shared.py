"""What several subcommands share: options, progress, the way results are shown and written."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from checkers.validate import InputError, as_path
from riskplan import interrupt

if TYPE_CHECKING:
    from riskplan.result import Plan, Report
    from riskplan.scene import Scenario

SOLVED, NO_PLAN = 0, 1
SAMPLES = 20_000


def scenario_options(to: argparse.ArgumentParser) -> None:
    """The scenario, and which problem of it."""
    to.add_argument(
        "scenario", type=place, metavar="SCENARIO", help=".yaml, CommonRoad .xml, Argoverse .csv or .parquet"
    )
    to.add_argument("--problem", type=int, default=0, metavar="N", help="of a CommonRoad file; default 0")


def audit_options(to: argparse.ArgumentParser) -> None:
    """Samples, seed, JSON."""
    to.add_argument("--monte-carlo", type=int, default=SAMPLES, metavar="N", help=f"samples, or 0; default {SAMPLES}")
    to.add_argument("--seed", type=int, default=0, metavar="N", help="of all randomness; default 0")
    json_option(to)


def place(text: str) -> Path:
    """A path that a file system may have."""
    try:
        return as_path("path", text)
    except InputError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def json_option(to: argparse.ArgumentParser) -> None:
    """The option of every command that answers."""
    to.add_argument("--json", action="store_true", help="print one JSON object on stdout, nothing else")


def risk(text: str) -> float | None:
    """A bound as text; "none" for none. argparse quotes the name: invalid risk value."""
    return None if text.lower() == "none" else float(text)


def for_dependence(scenario: Scenario, dependence: str) -> Scenario:
    """The scenario with agents that carry what the dependence needs; says on stderr what was taken for granted."""
    from riskplan.persisting import persisting

    scenario, note = persisting(scenario, dependence)
    if note:
        print(f"riskplan: note: {note}", file=sys.stderr)
    return scenario


def planned(
    scenario: Scenario,
    planner: str,
    checker: str,
    names: Sequence[str],
    samples: int,
    options: dict[str, Any],
) -> tuple[Plan, Report | None]:
    """A plan, audited if it is one."""
    from riskplan.planning import plan as make_plan
    from riskplan.report import audit

    limit = f"time limit {options['time_limit']:g} s; the first run ever compiles for about 20 s"
    with progress(f"planning with {planner} ({limit})"):
        plan = make_plan(scenario, planner=planner, checker=checker, stop=interrupt.requested, **options)
    if not plan.solved:
        return plan, None
    with progress("judging the plan"):
        return plan, audit(plan, scenario, names, samples, options["seed"])


def names_of(given: Sequence[str] | None) -> list[str]:
    """Names from repeated options, each a list by comma."""
    return [name.strip() for text in given or () for name in text.split(",") if name.strip()]


def check_names(names: Sequence[str]) -> None:
    """Refuse unknown backends."""
    from checkers import checker

    for name in names:
        checker(name)


def check_out(out: Path | None) -> None:
    """Refuse a directory that cannot be written."""
    from riskplan.outputs import check_folder

    if out is not None:
        check_folder(out)


def write(out: Path, scenario: Scenario, plan: Plan, report: Report | None) -> dict[str, str]:
    """Write the result's files; their paths."""
    from riskplan.outputs import write_results

    with progress(f"writing {out}"):
        return write_results(out, scenario, plan, report)


def as_dict(plan: Plan, report: Report | None, files: dict[str, str]) -> dict[str, Any]:
    """A result for `--json`."""
    from riskplan.io.plan_file import plan_to_dict, report_to_dict

    told = None if report is None else report_to_dict(report)
    return {
        "status": plan.status,
        "message": plan.message,
        "plan": plan_to_dict(plan),
        "report": told,
        "files": files,
    }


def show(as_json: bool, plan: Plan, report: Report | None, files: dict[str, str], title: str = "", **more: Any) -> None:
    """Print a result."""
    if as_json:
        print(json.dumps({**as_dict(plan, report, files), **more}, allow_nan=False))
        return
    from riskplan.report_table import print_report

    print_report(plan, report, title=title)
    for path in files.values():
        print(f"wrote {path}")


def show_list(as_json: bool, rows: dict[str, dict[str, str]], keys: Sequence[str]) -> None:
    """Print rows."""
    if as_json:
        print(json.dumps(rows))
        return
    from riskplan.report_table import print_list

    print_list(rows, keys)


@contextmanager
def progress(message: str) -> Iterator[None]:
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
