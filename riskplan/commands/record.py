"""`riskplan record`: simulate traffic and write it as training data."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

from checkers import InputError
from riskplan import interrupt
from riskplan.commands.shared import SOLVED, json_option, names_of, place

if TYPE_CHECKING:
    from predictor.recordings import Recording


def add(to: argparse.ArgumentParser) -> None:
    """Its options."""
    to.add_argument("--out", type=place, required=True, metavar="FILE", help="an .npz to write")
    to.add_argument("--samples", type=int, default=10_000, metavar="N", help="windows of 5 s, at least; default 10000")
    to.add_argument("--seed", type=int, default=0, metavar="N", help="of all randomness; default 0")
    to.add_argument("--map", action="append", metavar="NAME", help="highway, merge, intersection, roundabout; all")
    json_option(to)


def run(args: argparse.Namespace) -> int:
    """Exit status."""
    from predictor.datasets.simulator import save_recordings
    from predictor.recorder import MAPS, record, windows_in

    if args.out.suffix != ".npz":
        raise InputError(f"{args.out}: expected the suffix .npz")
    if not args.out.resolve().parent.is_dir():
        raise InputError(f"{args.out}: no such folder: {args.out.resolve().parent}")
    begin, found, vehicles = time.perf_counter(), 0, 0

    def counted() -> Iterator[Recording]:
        nonlocal found, vehicles
        for recording in record(args.samples, args.seed, names_of(args.map) or MAPS):
            found, vehicles = found + windows_in(recording), vehicles + len(recording.tracks)
            _progress(f"recording: {found} of {args.samples} samples, {time.perf_counter() - begin:.0f} s")
            interrupt.check()
            yield recording

    scenes = save_recordings(counted(), args.out)
    _progress("")
    told = {
        "file": str(args.out),
        "scenes": scenes,
        "vehicles": vehicles,
        "samples": found,
        "seed": args.seed,
        "seconds": round(time.perf_counter() - begin, 1),
    }
    if args.json:
        print(json.dumps(told))
    else:
        print(f"{found} samples of {vehicles} vehicles in {scenes} scenes, {told['seconds']} s")
        print(f"wrote {args.out}")
    return SOLVED


def _progress(message: str) -> None:
    if sys.stderr.isatty():
        print(f"\r\x1b[K{message}", end="", file=sys.stderr, flush=True)
