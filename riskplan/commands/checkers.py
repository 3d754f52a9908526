"""`riskplan checkers`: list the backends."""

from __future__ import annotations

import argparse
from typing import Any

from riskplan.commands.shared import SOLVED, json_option, show_list


def add(to: argparse.ArgumentParser) -> None:
    """Its options."""
    json_option(to)


def run(args: argparse.Namespace) -> int:
    """Exit status."""
    from checkers import checker, checkers

    found = {
        name: {**vars(info), "kind": info.kind.value, "options": _options(checker(name).defaults())}
        for name, info in checkers().items()
    }
    show_list(args.json, found, ("name", "kind", "needs", "assumption", "source", "cost", "options"))
    return SOLVED


def _options(defaults: dict[str, Any]) -> str:
    return ", ".join(f"{key}={value}" for key, value in defaults.items())
