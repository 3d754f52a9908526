"""How far above the truth the bounds are: `python -m benchmarks.tightness --data DIR [--plot FILE]`.

Bound / true over the quadratic forms of the predictions file with an ego ellipse of 5.5 × 2.6 m and 1e-12 < P < 1e-2;
and the paper's figure, risk along a trajectory by `chebyshev` and `sos` of orders 2, 4 and 6, as a plot.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

import riskplan as rp
from benchmarks.cases import Modes, load_scenarios, table
from checkers.validate import Array

BOUNDS: list[tuple[str, dict[str, Any]]] = [
    ("chebyshev", {}),
    ("halfspace", {}),
    ("marshall-olkin", {}),
    ("unimodal-halfspace", {}),
    *[("sos", {"order": n}) for n in (2, 4, 6, 8, 12)],
    *[("offline-sos", {"order": n}) for n in (2, 4, 6, 8)],
    *[("projected-sos", {"order": n}) for n in (4, 6, 8, 12)],
    ("sos", {"order": 4, "solver": "clarabel"}),
    *[("bivariate-sos", {"order": n}) for n in (4, 6)],
]
# medians of the prototype, see the project's mathematics page
PROTOTYPE = {"chebyshev": 18100, "halfspace": 8400, "marshall-olkin": 8300, "sos 4": 3750, "projected-sos 4": 924}
PROTOTYPE["projected-sos 8"] = 54
EGO = rp.EgoEllipsoid(np.diag([1 / 5.5**2, 1 / 2.6**2]))


def main(arguments: list[str] | None = None) -> int:
    """Parse, run, print, plot."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="directory of the predictions file")
    parser.add_argument("--forms", type=int, default=100_000, help="at most so many modes for the compiled bounds")
    parser.add_argument("--programs", type=int, default=500, help="of them for the semidefinite programs")
    parser.add_argument("--plot", type=Path, help="write the paper's figure here (.png)")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args(arguments)
    scenarios = load_scenarios(args.data)
    modes = scenarios.modes(EGO)
    true = rp.checker("exact")(modes.poses, modes.prediction, EGO).value[:, 0]
    eligible = np.flatnonzero((true > 1e-12) & (true < 1e-2))
    chosen = np.random.default_rng(args.seed).choice(eligible, min(args.forms, len(eligible)), replace=False)
    forms, true = modes.part(chosen), true[chosen]
    values: dict[str, Array] = {}
    rows: list[list[object]] = []
    for name, options in BOUNDS:
        backend = rp.checker(name, **options)
        count = len(true) if backend.kernel else min(args.programs, len(true))
        ratio = _value(backend, forms.part(slice(count))) / true[:count]
        label = " ".join([name, *map(str, options.values())])
        values[label] = ratio
        quartiles = [float(q) for q in np.quantile(ratio, (0.25, 0.5, 0.75))]
        rows.append([label, count, *quartiles, int((ratio < 1).sum()), PROTOTYPE.get(label, "")])
    head = [
        "bound",
        "forms",
        "lower quartile",
        "median bound / true",
        "upper quartile",
        "below the truth",
        "prototype's median",
    ]
    table("Tightness", head, rows)
    better = values["projected-sos 4"] / values["chebyshev"]
    print(
        f"\n`projected-sos` order 4 is at most `chebyshev` on {np.mean(better <= 1):.2%} of the forms, "
        f"and {np.median(1 / better):.1f} times tighter in the median."
    )
    if args.plot is not None:
        plot(args.plot, scenarios.poses, scenarios.predictions)
    return int(any((ratio < 1).any() for ratio in values.values()))


def _value(backend: rp.Checker, modes: Modes) -> Array:
    value: Array = backend(modes.poses, modes.prediction, modes.ego).value[:, 0]
    return value


def plot(path: Path, poses: Array, predictions: tuple[rp.GaussianMixturePrediction, ...]) -> None:
    """The scenario with the most steps of risk between 1e-8 and 0.1, step by step."""
    from riskplan.pictures import plots  # noqa: PLC0415

    shown = []
    for pose, pred in zip(poses, predictions, strict=True):
        risk = (pred.weights * rp.checker("exact")(pose, pred, EGO).value).sum(axis=1)
        shown.append(np.count_nonzero((risk > 1e-8) & (risk < 0.1)))
    pick = int(np.argmax(shown))
    pose, pred = poses[pick], predictions[pick]
    figure, axes = plots.blank("time [s]", "risk of the step", (7.0, 4.2))
    lines: list[tuple[str, dict[str, Any]]] = [("sos", {"order": n}) for n in (2, 4, 6)]
    # order 2 is Chebyshev's bound: dashed, so that both are seen
    styles = {"exact": {"color": "black", "lw": 2.2}, "chebyshev": {"color": "#14181d", "ls": (0, (3, 4)), "lw": 1.6}}
    for i, (name, options) in enumerate([*lines, ("projected-sos", {"order": 8}), ("chebyshev", {}), ("exact", {})]):
        value = (pred.weights * rp.checker(name, **options)(pose, pred, EGO).value).sum(axis=1)
        style = styles.get(name, {"color": plots.COLOURS[i % len(plots.COLOURS)], "lw": 2.0})
        axes.semilogy(pred.times, value, label=" ".join([name, *map(str, options.values())]), **style)
    axes.set(ylim=(1e-5, 2), xlim=(pred.times[0], pred.times[-1]))
    figure.legend(loc="outside upper center", ncols=6, frameon=False, fontsize=8.5)
    plots.save(figure, path)


if __name__ == "__main__":
    sys.exit(main())
