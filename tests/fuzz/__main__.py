"""A campaign: `python -m tests.fuzz --inputs 100000 [--only yaml]`; `--coverage TARGET` is guided by atheris.

Prints how many inputs each importer was given, how many it accepted, the slowest, the memory, and every finding: any
exception but InputError, an input that takes longer than --seconds, memory beyond --megabytes, a value out of range, a
risk below what sampling shows. Exit status 1 if there is a finding.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

# said here once more: nothing that atheris is to instrument may be imported before it; a test compares
IMPORTERS = (
    *("yaml", "plan", "npz", "xml", "roadmap", "cli", "argoverse1", "argoverse2", "nuscenes", "waymo", "waymo-bytes"),
    *("autoware", "grid", "agents-npz", "agents-parquet", "tensors", "eth-ucy", "recordings", "windows", "batch-list"),
)


def main() -> int:
    """Parse, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--inputs", type=int, default=100_000, help="in all; shared among the importers")
    parser.add_argument("--only", choices=IMPORTERS, help="one of them")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=5.0, help="of one input, on the processor")
    parser.add_argument("--megabytes", type=int, default=1500, help="of memory beyond what is there at the start")
    parser.add_argument("--keep", type=Path, help="folder for the inputs of findings")
    parser.add_argument("--coverage", choices=[name for name in IMPORTERS if name != "cli"], help="guided by atheris")
    args = parser.parse_args()
    if args.coverage:
        from .guided import guided  # noqa: PLC0415  an extra

        return guided(args.coverage, args.inputs, args.seconds, args.megabytes, args.keep)
    from .campaign import campaign  # noqa: PLC0415  not before atheris, which instruments what is imported

    return campaign(args.inputs, args.only, args.seed, args.seconds, args.megabytes, args.keep)


if __name__ == "__main__":
    sys.exit(main())
