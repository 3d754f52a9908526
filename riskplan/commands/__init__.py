"""The subcommands of `riskplan`, a module each: `add(parser)` declares its options, `run(args)` does the work."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from importlib import import_module
from typing import Any, NoReturn

from checkers import InputError

# adding a command: one file, one line
_COMMANDS = {
    "plan": "plan a trajectory within a risk bound",
    "simulate": "drive in a closed loop, planning anew while the agents move",
    "assess": "judge a stored trajectory again",
    "sweep": "plan at several bounds: risk against arrival time and cost",
    "render": "draw a scenario and a plan",
    "batch": "plan or score many scenarios, resumable",
    "export": "write a stored plan in another program's format",
    "checkers": "list the checkers",
    "planners": "list the planners",
    "record": "simulate traffic and write it as training data",
    "train": "train a predictor on recorded tracks",
    "predict": "predict agents from their observed tracks",
    "demo": "plan the shipped scene with rrt and with prm",
    "schema": "print the JSON Schema of scenario files",
    "completion": "print a completion script for bash or zsh",
    "doctor": "tell what is installed, what is missing, and how to get it",
}


class _Parser(argparse.ArgumentParser):
    """Reports a wrong command line the way all bad input is reported; takes no abbreviated options."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**{**options, "allow_abbrev": False})

    def error(self, message: str) -> NoReturn:
        raise InputError(f"{message} (see {self.prog} --help)")


class _Version(argparse.Action):
    """Looks the versions up only when asked."""

    def __call__(self, parser: argparse.ArgumentParser, *args: Any) -> NoReturn:
        from riskplan import __version__
        from riskplan.doctor import versions

        others = ", ".join(f"{name} {v}" for name, v in versions().items() if name != "riskplan")
        print(f"riskplan {__version__} ({others})")
        parser.exit()


def parser() -> argparse.ArgumentParser:
    """Of the whole command; the chosen subcommand's `run` ends up in `run`."""
    root = _Parser(prog="riskplan", description="Motion planning under a stated bound on collision risk.")
    root.add_argument(
        "--version", action=_Version, nargs=0, help="print it, and those of the packages numbers depend on"
    )
    commands = root.add_subparsers(metavar="COMMAND", required=True, dest="command")
    for name, summary in _COMMANDS.items():
        module = import_module(f"riskplan.commands.{name}")
        command = commands.add_parser(name, help=summary)
        module.add(command)
        command.set_defaults(run=module.run)
    return root


def run(argv: Sequence[str] | None) -> int:
    """Run a command line; everything that goes wrong is raised."""
    args = parser().parse_args(argv)
    status: int = args.run(args)
    return status
