"""`riskplan planners`: list the planners."""

from __future__ import annotations

import argparse

from riskplan.commands.shared import SOLVED, json_option, show_list


def add(to: argparse.ArgumentParser) -> None:
    """Its options."""
    json_option(to)


def run(args: argparse.Namespace) -> int:
    """Exit status."""
    from riskplan.planning import planners

    keys = ("name", "summary", "source")
    show_list(args.json, {name: {k: getattr(info, k) for k in keys} for name, info in planners().items()}, keys)
    return SOLVED
