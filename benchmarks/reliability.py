"""Is stated collision risk true? `python -m benchmarks.reliability --data DIR --cache DIR --weights FILE --plot FILE`.

Ego-like trajectories are thrown at the recorded agents of the test scenes of `benchmarks.prediction` (same cache, same
split): the risk stated by a model's predictions, recalibrated or not, with errors that persist or not, against hits.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from benchmarks.cases import table
from benchmarks.prediction import samples_of
from checkers import InputError
from predictor.fit import Parts, forecasts
from predictor.kinematic import COURSES, Kinematic
from predictor.learned import one_thread
from predictor.model_files import load_model
from predictor.reliability import Reliability, hits, stated_risk, thrown, without_factors


def main(arguments: list[str] | None = None) -> int:
    """Parse, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--cache", type=Path, required=True, help="of benchmarks.prediction")
    parser.add_argument("--weights", type=Path, required=True, help=".safetensors of a model of positions")
    parser.add_argument("--every", type=int, default=5)
    parser.add_argument("--throws", type=int, default=2, help="trajectories per window")
    parser.add_argument("--plot", type=Path)
    args = parser.parse_args(arguments)
    try:
        with one_thread():
            found = run(args)
    except InputError as error:
        print(f"benchmarks.reliability: {error}", file=sys.stderr)
        return 2
    for name, r in found.items():
        rows: list[list[object]] = [
            [int(n), float(s), float(o), f"{a:.3f} to {b:.3f}"]
            for n, s, o, a, b in zip(r.count, r.stated, r.observed, r.low, r.high, strict=True)
        ]
        table(
            f"{name}: {r.expected:.1f} hits expected, {r.hits} observed",
            ["trajectories", "mean stated risk", "share that hit", "95 % interval"],
            rows,
        )
    if args.plot:
        draw(found, args.plot)
    return 0


def run(args: argparse.Namespace) -> dict[str, Reliability]:
    """Reliability by how the risk was stated; the same trajectories for all."""
    parts = Parts.of(samples_of(args.data, args.cache, args.every), seed=0)
    model = load_model(args.weights)
    test, training = parts.test, parts.training
    raw = forecasts(model.network, test)
    physics = Kinematic.fitted(
        COURSES["constant velocity, last step"], training.past, training.headings, training.future, training.dt
    ).predict(test.past, test.headings)
    stated = {"network": raw}
    if model.recalibration is not None:
        stated["network, recalibrated"] = model.recalibration.apply(raw)
    stated |= {"network, errors taken as independent": without_factors(raw), "constant velocity": physics}
    egos = [thrown(raw, np.random.default_rng(i)) for i in range(args.throws)]
    hit = np.concatenate([hits(test.future, ego) for ego in egos])
    return {
        name: Reliability.of(np.concatenate([stated_risk(f, ego, np.random.default_rng(9)) for ego in egos]), hit)
        for name, f in stated.items()
    }


def draw(found: dict[str, Reliability], path: Path) -> None:
    """Observed against stated, a panel each."""
    import matplotlib as mpl  # noqa: PLC0415

    mpl.use("Agg")
    import matplotlib.pyplot as plt  # noqa: PLC0415

    figure, axes = plt.subplots(1, len(found), figsize=(3.4 * len(found), 3.4), sharey=True, layout="constrained")
    for axis, (name, r) in zip(np.atleast_1d(axes), found.items(), strict=True):
        axis.plot([0, 1], [0, 1], color="0.7", linewidth=1)
        axis.errorbar(r.stated, r.observed, [r.observed - r.low, r.high - r.observed], fmt="o", markersize=4)
        axis.set(xlabel="stated collision risk", title=name)
        axis.title.set_fontsize(9)
    np.atleast_1d(axes)[0].set_ylabel("share that hit")
    figure.savefig(path, dpi=130)


if __name__ == "__main__":
    sys.exit(main())
