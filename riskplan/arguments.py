"""The command line's grammar."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, NoReturn

from checkers import InputError

SAMPLES = 20_000


class _Parser(argparse.ArgumentParser):
    """Reports a wrong command line the way all bad input is reported; takes no abbreviated options."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**{**options, "allow_abbrev": False})

    def error(self, message: str) -> NoReturn:
        raise InputError(f"{message} (see {self.prog} --help)")


def parser() -> argparse.ArgumentParser:
    """Of the whole command; the chosen subcommand ends up in `command`."""
    from riskplan import __version__  # noqa: PLC0415

    root = _Parser(prog="riskplan", description="Motion planning under a stated bound on collision risk.")
    root.add_argument("--version", action="version", version=f"riskplan {__version__}")
    commands = root.add_subparsers(metavar="COMMAND", required=True, dest="command")
    _plan(commands.add_parser("plan", help="plan a trajectory within a risk bound"))
    _assess(commands.add_parser("assess", help="judge a stored trajectory again"))
    _render(commands.add_parser("render", help="draw a scenario and a plan"))
    for name in ("checkers", "planners"):
        _json(commands.add_parser(name, help=f"list the {name}"))
    demo = commands.add_parser("demo", help="plan the shipped scene with rrt and with prm")
    demo.add_argument("--out", type=Path, metavar="DIR", help="write DIR/rrt and DIR/prm")
    _json(demo)
    return root


def _plan(to: argparse.ArgumentParser) -> None:
    _scenario(to)
    to.add_argument("--planner", default="rrt", metavar="NAME", help="see `riskplan planners`; default rrt")
    to.add_argument("--checker", default="exact", metavar="NAME", help="see `riskplan checkers`; default exact")
    to.add_argument("--bound", type=_bound, default=0.01, metavar="RISK", help="on the total, or `none`; default 0.01")
    to.add_argument("--dependence", default="independent", metavar="NAME", help="independent (default) or boole")
    to.add_argument("--time-limit", type=float, default=1.0, metavar="S", help="of the search [s]; default 1")
    to.add_argument("--audit", action="append", metavar="NAMES", help="checkers for the report; default --checker")
    to.add_argument("--out", type=Path, metavar="DIR", help="write plan.json, report.json, scene.html, scene.png")
    _audit(to)


def _assess(to: argparse.ArgumentParser) -> None:
    _scenario(to)
    to.add_argument("trajectory", type=Path, metavar="TRAJECTORY", help="a plan.json")
    to.add_argument("--checker", action="append", metavar="NAMES", help="repeatable, by comma; default the plan's own")
    _audit(to)


def _render(to: argparse.ArgumentParser) -> None:
    _scenario(to)
    to.add_argument("plan", type=Path, nargs="?", metavar="PLAN", help="a plan.json")
    to.add_argument("--out", type=Path, required=True, metavar="FILE", help=".html, .png or .gif")


def _scenario(to: argparse.ArgumentParser) -> None:
    to.add_argument("scenario", type=Path, metavar="SCENARIO", help=".yaml, or CommonRoad .xml")
    to.add_argument("--problem", type=int, default=0, metavar="N", help="of a CommonRoad file; default 0")


def _audit(to: argparse.ArgumentParser) -> None:
    to.add_argument("--monte-carlo", type=int, default=SAMPLES, metavar="N", help=f"samples, or 0; default {SAMPLES}")
    to.add_argument("--seed", type=int, default=0, metavar="N", help="of all randomness; default 0")
    _json(to)


def _json(to: argparse.ArgumentParser) -> None:
    to.add_argument("--json", action="store_true", help="print one JSON object on stdout, nothing else")


def _bound(text: str) -> float | None:
    return None if text.lower() == "none" else float(text)


_bound.__name__ = "risk"  # argparse: invalid risk value: 'x'
