"""`riskplan schema`: the JSON Schema of scenario files, for editors and other programs."""

from __future__ import annotations

import argparse

from riskplan.commands.shared import SOLVED


def add(to: argparse.ArgumentParser) -> None:
    """None."""


def run(args: argparse.Namespace) -> int:
    """Exit status."""
    from riskplan.io.schema import schema_text

    print(schema_text(), end="")
    return SOLVED
