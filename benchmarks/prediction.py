"""Predictors on recorded or simulated traffic: `python -m benchmarks.prediction --data DIR --cache DIR`.

The paper's Table I and more: physics, the paper's network with and without normalisation, ego and map, a head whose
errors persist, and a small MLP. Scenes are split, never windows. Each row and seed is kept in the cache directory when
it is done, and so is training in between: the command may be killed and started again. `--show` prints what is done.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cases import table
from checkers import InputError
from predictor.calibration import Recalibration
from predictor.fit import Parts, fit
from predictor.kinematic import COURSES, Kinematic
from predictor.learned import one_thread
from predictor.manoeuvres import Manoeuvres
from predictor.metrics import summary
from predictor.model_files import save_model
from predictor.network import NetworkConfig
from predictor.recordings import open_data
from predictor.train import TrainSettings
from predictor.windows import Windows, windows

# normalised in the output too (`NetworkConfig.anchor`): what is stated is small, and as large at each step
_NORMALISED = NetworkConfig(anchor="growing")
_OURS = replace(_NORMALISED, weights="persistent", head="persistent")
NETWORKS = {
    "LSTM unnormalised": NetworkConfig(normalised=False),
    "LSTM normalised, absolute output": NetworkConfig(),
    "LSTM normalised": _NORMALISED,
    "LSTM normalised + ego": replace(_NORMALISED, ego_future=True),
    "LSTM normalised + ego + map": replace(_NORMALISED, ego_future=True, lanes=True),
    "LSTM normalised, persistent head": _OURS,
    "LSTM normalised, persistent head + ego": replace(_OURS, ego_future=True),
    "LSTM normalised, persistent head + map": replace(_OURS, lanes=True),
    "MLP normalised, persistent head": replace(_OURS, architecture="mlp"),
}
HEAD = [
    "model",
    "seeds",
    "minADE [m]",
    "minFDE [m]",
    "NLL",
    "joint NLL",
    "in 50/90/99 % at 1, 3 s",
    "recalibrated: NLL",
    "joint NLL",
    "in 50/90/99 % at 1, 3 s",
    "trained to within 2 % [s]",
]


def main(arguments: list[str] | None = None) -> int:
    """Parse, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="a data set, or windows as `Windows.save` wrote them")
    parser.add_argument("--cache", type=Path, required=True, help="directory for windows and finished rows")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--epochs", type=int, default=30)
    parser.add_argument("--rows", action="append", metavar="NAME", help="only rows whose name contains this")
    parser.add_argument("--split", type=int, default=0, help="seed of the split by scene; one cache directory for each")
    parser.add_argument("--every", type=int, default=5, help="steps from one window of a track to its next")
    parser.add_argument(
        "--fitted-on", action="store_true", help="only files the shipped parameters were fitted on, not those held out"
    )
    parser.add_argument("--show", action="store_true", help="print what is done and stop")
    args = parser.parse_args(arguments)
    args.cache.mkdir(parents=True, exist_ok=True)
    try:
        if not args.show:
            with one_thread():
                _run(args)
        _print(args)
    except InputError as error:
        print(f"benchmarks.prediction: {error}", file=sys.stderr)
        return 2
    return 0


def samples_of(data: Path, cache: Path, every: int, *, fitted_on: bool = False) -> Windows:
    """Windows with complete futures, cached; `fitted_on`: none of the files that `benchmarks.truth` judges by."""
    kept = cache / f"windows-{every}.npz"
    if not kept.exists():
        held = set(Manoeuvres.fitted().summary["held_out"]) if fitted_on else set()
        recordings = (r for r in open_data(data).recordings() if r.name not in held)
        windows(recordings, every=every, least=30).save(kept)
    return Windows.load(kept)


def _run(args: argparse.Namespace) -> None:
    # one split for all rows and seeds: seeds differ by initial weights and order
    parts = Parts.of(samples_of(args.data, args.cache, args.every, fitted_on=args.fitted_on), seed=args.split)
    wanted = [n for n in [*COURSES, *NETWORKS] if not args.rows or any(r in n for r in args.rows)]
    for seed in range(args.seeds):
        for name in wanted:
            path = args.cache / f"{_slug(name)}-{seed}.json"
            if path.exists() or (name in COURSES and seed):
                continue
            begin = time.perf_counter()
            metrics = _kinematic(name, parts) if name in COURSES else _network(name, parts, seed, args)
            metrics["seconds"] = round(time.perf_counter() - begin, 1)
            path.write_text(json.dumps(metrics, indent=1), encoding="utf-8")
            test = metrics["test"]
            print(f"{name}, seed {seed}: minADE {test['min_ade']}, {metrics['seconds']} s", file=sys.stderr, flush=True)


def _kinematic(name: str, parts: Parts) -> dict[str, Any]:
    training, validation, test = parts.training, parts.validation, parts.test
    model = Kinematic.fitted(COURSES[name], training.past, training.headings, training.future, training.dt)
    recalibration = Recalibration.fitted(model.predict(validation.past, validation.headings), validation.future)
    raw = model.predict(test.past, test.headings)
    return {
        "test": summary(raw, test.future),
        "test_recalibrated": summary(recalibration.apply(raw), test.future),
    }


def _network(name: str, parts: Parts, seed: int, args: argparse.Namespace) -> dict[str, Any]:
    settings = TrainSettings(epochs=args.epochs, patience=10, seed=seed)
    folder = args.cache / f"{_slug(name)}-{seed}"
    model = fit(NETWORKS[name], parts, settings, {"name": args.data.name}, folder)
    save_model(folder / "model.safetensors", model)
    return {**model.card["metrics"], "training": model.card["training"]}


def within(folder: Path, share: float = 0.02) -> float:
    """Seconds of training until the validation part was first as likely as ever up to `share` (a step), by the log.

    The L2 term counts too, so this is late rather than early.
    """
    with (folder / "log.csv").open(newline="", encoding="utf-8") as file:
        log = list(csv.DictReader(file))
    losses = np.array([float(row["valid_loss"]) for row in log])
    return float(log[int((losses <= losses.min() + np.log1p(share)).argmax())]["seconds"])


def _print(args: argparse.Namespace) -> None:
    rows, tested = [], 0
    for name in [*COURSES, *NETWORKS]:
        done = sorted(args.cache.glob(f"{_slug(name)}-[0-9].json"))
        found = [json.loads(path.read_text(encoding="utf-8")) for path in done]
        if found:
            taken = [within(path.with_suffix("")) for path in done if path.with_suffix("").is_dir()]
            rows.append([*_row(name, found), _spread(taken, 0) if taken else ""])
            tested = found[0]["test"]["windows"]
    if not rows:
        raise InputError(f"{args.cache}: nothing done yet")
    table(f"{args.data.name}: {tested} test windows, 3 s", HEAD, rows)


def _row(name: str, found: list[Mapping[str, Any]]) -> list[object]:
    raw, scaled = ([m[key] for m in found] for key in ("test", "test_recalibrated"))
    return [
        name,
        len(found),
        *[_spread([m[key] for m in raw]) for key in ("min_ade", "min_fde", "nll", "joint_nll")],
        _inside(raw),
        *[_spread([m[key] for m in scaled]) for key in ("nll", "joint_nll")],
        _inside(scaled),
    ]


def _spread(values: list[float], digits: int = 2) -> str:
    mean = f"{np.mean(values):.{digits}f}"
    return mean if len(values) == 1 else f"{mean} ± {np.std(values, ddof=1):.{digits}f}"


def _inside(found: list[Mapping[str, Any]]) -> str:
    shares = np.mean([[m["within_50_90_99"][h] for h in ("1 s", "3 s")] for m in found], axis=0)
    return ", ".join("/".join(f"{100 * v:.0f}" for v in row) for row in shares)


def _slug(name: str) -> str:
    return "".join(c if c.isalnum() else "-" for c in name.lower())


if __name__ == "__main__":
    sys.exit(main())
