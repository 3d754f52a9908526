"""`riskplan predict`: predict the agents of a scene, or of a data set, from their observed tracks."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from checkers import InputError
from riskplan.commands.shared import SOLVED, check_out, json_option, place, progress
from riskplan.commands.train import needing_torch

if TYPE_CHECKING:
    from predictor.recordings import Recording
    from predictor.tracks import Track


def add(to: argparse.ArgumentParser) -> None:
    """Its options."""
    to.add_argument("data", type=place, metavar="DATA", help="a data set: CommonRoad, Argoverse, recorded traffic, …")
    to.add_argument("--kind", metavar="NAME", help="of the data; default: by the suffix of its files")
    to.add_argument(
        "--weights",
        default="positions",
        metavar="FILE",
        help=".safetensors of `riskplan train`, or shipped: positions (default), controls",
    )
    to.add_argument("--time", type=float, metavar="S", help="the present; default: as soon as there is a full past")
    to.add_argument("--raw", action="store_true", help="without the recalibration of the model card")
    to.add_argument("--out", type=place, required=True, metavar="DIR", help="a folder per recording, an .npz per agent")
    json_option(to)


def run(args: argparse.Namespace) -> int:
    """Exit status."""
    with needing_torch("riskplan predict"):
        from predictor.learned import SHIPPED, LearnedPredictor
    from predictor.recordings import open_data

    check_out(args.out)
    model = LearnedPredictor.shipped(args.weights) if args.weights in SHIPPED else LearnedPredictor.load(args.weights)
    model = replace(model, recalibrated=not args.raw)
    told: list[dict[str, Any]] = []
    left_out = 0
    with progress(f"predicting {args.data}"):
        for recording in open_data(args.data, args.kind).recordings():
            tracks = _known(recording, model, args.time)
            left_out += len(recording.tracks) - len(tracks)
            if not tracks:
                continue
            folder = args.out / _safe(recording.name)
            folder.mkdir(parents=True, exist_ok=True)
            for agent in model.predict(tracks, lanes=recording.lanes or None):
                path = folder / f"{_safe(agent.name)}.npz"
                agent.save(path)
                told.append({"recording": recording.name, "agent": agent.name, "file": str(path)})
    if not told:
        raise InputError(f"{args.data}: no track has the past the network reads")
    if left_out:
        print(f"riskplan: note: {left_out} tracks without the past the network reads were left out", file=sys.stderr)
    if args.json:
        print(json.dumps({"predictions": told, "left_out": left_out}))
    else:
        print(f"wrote {len(told)} predictions to {args.out}")
    return SOLVED


def _known(recording: Recording, model: Any, present: float | None) -> list[Track]:
    """The tracks as known at the present, if they are there and have been for long enough."""
    config = model.model.config
    begin = min(float(t.times[0]) for t in recording.tracks)
    now = begin + (config.observed - 1) * config.dt if present is None else present
    start = now - (config.observed - 1) * config.dt
    there = [t for t in recording.tracks if t.covers(start, now)]
    out = []
    for track in there:
        known = track.until(now)
        out.append(known if abs(known.times[-1] - now) < 1e-6 else known.at(np.append(known.times, now)))
    return out


def _safe(name: str) -> str:
    """A name as a file's."""
    return "".join(c if c.isalnum() or c in "-_." else "_" for c in name).lstrip(".") or "_"
