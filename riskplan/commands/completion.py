"""`riskplan completion`: a script for the shell that completes commands, options, names and files."""

from __future__ import annotations

import argparse

from checkers import InputError
from riskplan.commands.shared import SOLVED

SHELLS = ("bash", "zsh")


def add(to: argparse.ArgumentParser) -> None:
    """The shell."""
    to.add_argument("shell", choices=SHELLS, help='bash: eval "$(riskplan completion bash)"')


def run(args: argparse.Namespace) -> int:
    """Exit status."""
    from riskplan.commands import parser

    try:
        import shtab
    except ImportError:
        raise InputError("completion needs shtab: pip install '.[completion]' in the checkout") from None
    root = parser()
    for each in _parsers(root):
        _annotate(each)
    print(shtab.complete(root, shell=args.shell))
    return SOLVED


def _parsers(root: argparse.ArgumentParser) -> list[argparse.ArgumentParser]:
    found = [root]
    for action in root._actions:
        if isinstance(action, argparse._SubParsersAction):
            found += action.choices.values()
    return found


def _annotate(parser: argparse.ArgumentParser) -> None:
    """What the shell offers as a value: names that the option lists, else files."""
    import shtab

    from checkers import checkers
    from riskplan.planning import planners

    names = {"checker": tuple(checkers()), "audit": tuple(checkers()), "planner": tuple(planners())}
    names["dependence"] = ("independent", "persistent", "boole")
    for action in parser._actions:
        if action.dest in names and action.choices is None:
            action.choices = names[action.dest]
        elif str(action.metavar) in ("DIR", "FILE", "SCENARIO", "TRAJECTORY", "PLAN", "SOURCE"):
            action.complete = shtab.DIRECTORY if action.metavar == "DIR" else shtab.FILE  # type: ignore[attr-defined]
