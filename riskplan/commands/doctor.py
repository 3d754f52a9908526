"""`riskplan doctor`: what is installed, what is missing, and how to get it."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict

from riskplan.commands.shared import SOLVED, json_option

UNWELL = 1


def add(to: argparse.ArgumentParser) -> None:
    """Its options."""
    json_option(to)


def run(args: argparse.Namespace) -> int:
    """Exit status: 0 if everything needed is there, 1 if not."""
    from riskplan.doctor import examine

    checks = examine()
    well = all(c.ok for c in checks if c.needed)
    if args.json:
        print(json.dumps({"ok": well, "checks": [asdict(c) for c in checks]}))
        return SOLVED if well else UNWELL
    for c in checks:
        mark = "ok" if c.ok else "MISSING" if c.needed else "-"
        print(f"{mark:8}{c.name:18}{c.found}")
        if not c.ok:
            print(f"{'':26}{c.advice}")
    print("\nAll that is needed is there." if well else "\nSomething needed is missing.")
    return SOLVED if well else UNWELL
