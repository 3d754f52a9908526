"""Fit the spread of the constant-velocity baseline: `python -m predictor.fit_constant_velocity`.

Files are split so that no vehicle is in both parts: recordings overlap, so files that share a stretch of
varying speed are kept together. The spread is fitted on one part by maximum likelihood and judged on the
other.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize

from checkers.validate import Array, InputError
from predictor.constant_velocity import ConstantVelocity, Situation, Spread
from predictor.io_commonroad import load_tracks
from predictor.tracks import SLACK, Track

Tracks = Mapping[str, Sequence[Track]]

TIMES: Array = np.linspace(0.5, 3.0, 6)
JUDGED = (1.0, 2.0, 3.0)
LEVELS = (0.5, 0.9, 0.99)
WINDOWS = (0.5, 1.0)
# every how many seconds of a track a prediction is made
EVERY = 0.5
HELD_OUT = 0.3
# a vehicle is recognised by this many steps of its speed, most of them different
RUN, DIFFERENT = 15, 13
# recordings keep standing vehicles exactly in place, so likelihood alone would drive this to zero [m]
START = 0.05
MOVING = 2.0


@dataclass(frozen=True, eq=False)
class Samples:
    """Predictions' errors in their situations.

    Attributes:
        features: (N, F).
        errors: (N, T, 2) true position minus the constant-velocity mean at `TIMES`, longitudinal and lateral
            [m]; NaN where the vehicle has left the recording.
        speeds: (N,) [m/s].
    """

    features: Array
    errors: Array
    speeds: Array

    def of(self, rows: Any) -> Samples:
        """Those `rows` only."""
        return Samples(self.features[rows], self.errors[rows], self.speeds[rows])


def linked(tracks: Tracks) -> list[list[str]]:
    """Groups of files, each file in one, with no vehicle in two groups as far as the speeds tell."""
    group = {name: name for name in tracks}

    def root(name: str) -> str:
        while group[name] != name:
            name = group[name]
        return name

    seen: dict[bytes, str] = {}
    for name, recorded in tracks.items():
        for track in recorded:
            speeds = np.round(track.speeds, 2)
            for start in range(len(speeds) - RUN + 1):
                run = speeds[start : start + RUN]
                if len(np.unique(run)) >= DIFFERENT:
                    group[root(name)] = root(seen.setdefault(run.tobytes(), name))
    groups = defaultdict(list)
    for name in tracks:
        groups[root(name)].append(name)
    return sorted(groups.values())


def split(tracks: Tracks, seed: int) -> tuple[list[str], list[str]]:
    """Files to fit on and files held out: whole groups, about `HELD_OUT` of the tracks at every place."""
    rng = np.random.default_rng(seed)
    places = defaultdict(list)
    for group in linked(tracks):
        places[group[0].split("-")[0]].append(group)
    held: list[str] = []
    for groups in places.values():
        wanted = HELD_OUT * sum(len(tracks[name]) for group in groups for name in group)
        for i in rng.permutation(len(groups)):
            size = sum(len(tracks[name]) for name in groups[i])
            if size <= wanted:
                held += groups[i]
                wanted -= size
    return [name for name in tracks if name not in held], held


def sample(tracks: Sequence[Track], window: float, *, past: bool) -> Samples:
    """A prediction every `EVERY` s of each track; with `past` from 2 s of it, else from the state alone."""
    features, errors, speeds = [], [], []
    for track in tracks:
        last = track.times[-1]
        for now in np.arange(track.times[0], last - 1.0 + SLACK, EVERY):
            known = track.until(now)
            situation = Situation.of(known if past else known.window(known.times[-1], now), window)
            if situation.known == past:
                features.append(situation.features)
                errors.append(_errors(track, float(known.times[-1]), situation))
                speeds.append(np.hypot(*situation.velocity))
    if not features:
        raise InputError("data: expected tracks of at least 3 s, got none")
    return Samples(np.array(features), np.array(errors), np.array(speeds))


def fit(samples: Samples) -> Spread:
    """Maximum likelihood, axis by axis."""
    axes = [_fit_axis(samples.features, samples.errors[..., axis]) for axis in range(2)]
    growth = np.array([a[-1] for a in axes])
    return Spread(axes[0][:-1], axes[1][:-1], growth, START)


def nll(spread: Spread, samples: Samples) -> float:
    """Negative log-likelihood per predicted position [nat]."""
    variances = spread.variances(samples.features, TIMES)
    terms = 0.5 * (np.log(2 * np.pi * variances) + samples.errors**2 / variances).sum(axis=-1)
    return float(np.nanmean(terms))


def judge(spread: Spread, samples: Samples) -> dict[str, Any]:
    """Coverage of the 50, 90 and 99 % ellipses at 1, 2, 3 s, mean distances [m] and likelihood [nat]."""
    distance = np.hypot(samples.errors[..., 0], samples.errors[..., 1])
    squared = (samples.errors**2 / spread.variances(samples.features, TIMES)).sum(axis=-1)
    inside = {}
    for time in JUDGED:
        column = squared[:, np.searchsorted(TIMES, time - SLACK)]
        column = column[np.isfinite(column)]
        inside[f"{time:g} s"] = [round(float(np.mean(column <= -2 * np.log1p(-p))), 3) for p in LEVELS]
    whole = distance[np.isfinite(distance).all(axis=1)]
    return {
        "predictions": len(samples.features),
        "within_50_90_99": inside,
        "ade": round(float(whole.mean()), 3),
        "fde": round(float(whole[:, -1].mean()), 3),
        "nll": round(nll(spread, samples), 3),
    }


def train(tracks: Tracks, seed: int, name: str) -> ConstantVelocity:
    """Split, choose the window on the first part, fit there, judge on the other."""
    names = split(tracks, seed)
    first, held = ([t for n in part for t in tracks[n]] for part in names)
    by_window = {w: sample(first, w, past=True) for w in WINDOWS}
    spreads = {w: fit(samples) for w, samples in by_window.items()}
    window = min(WINDOWS, key=lambda w: nll(spreads[w], by_window[w]))
    initial = fit(sample(first, window, past=False))
    summary: dict[str, Any] = {
        "data": name,
        "split": "by groups of files that share no recorded vehicle",
        "seed": seed,
        "files": {"fit": len(names[0]), "held_out": len(names[1])},
        "tracks": {"fit": len(first), "held_out": len(held)},
    }
    for key, spread, past in (("past", spreads[window], True), ("initial", initial, False)):
        samples = sample(held, window, past=past)
        moving = samples.speeds >= MOVING
        summary[key] = {"all": judge(spread, samples), "moving": judge(spread, samples.of(moving))}
    return ConstantVelocity(spreads[window], initial, window, summary)


def table(model: ConstantVelocity) -> str:
    """The held-out part of the summary, for reading."""
    rows = [f"{'held out':<24}{'n':>7}{'ADE':>7}{'FDE':>7}{'NLL':>8}   within 50/90/99 % at 1, 2, 3 s"]
    for key in ("past", "initial"):
        for who, r in model.summary[key].items():
            shares = r["within_50_90_99"].values()
            inside = "   ".join("/".join(f"{100 * v:.1f}" for v in row) for row in shares)
            numbers = f"{r['predictions']:>7}{r['ade']:>7.2f}{r['fde']:>7.2f}{r['nll']:>8.3f}"
            rows.append(f"{key + ', ' + who:<24}{numbers}   {inside}")
    return "\n".join(rows)


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m predictor.fit_constant_velocity", description=__doc__)
    parser.add_argument("--data", type=Path, required=True, help="folder of recorded CommonRoad XML files")
    parser.add_argument("--out", type=Path, required=True, help="JSON file to write")
    parser.add_argument("--seed", type=int, default=0, help="of the split (default 0)")
    options = parser.parse_args(arguments)
    try:
        files = sorted(options.data.glob("*.xml"))
        if not files:
            raise InputError(f"{options.data}: no XML files")
        model = train({f.stem: load_tracks(f) for f in files}, options.seed, options.data.resolve().name)
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    sys.stdout.write(table(model) + "\n")
    options.out.write_text(json.dumps(model.to_dict(), indent=1) + "\n", encoding="utf-8")
    return 0


def _errors(track: Track, now: float, situation: Situation) -> Array:
    there = now + TIMES <= track.times[-1] + SLACK
    future = track.at(now + TIMES[there]).positions
    c, s = np.cos(situation.heading), np.sin(situation.heading)
    errors = np.full((len(TIMES), 2), np.nan)
    missed = future - situation.position - TIMES[there, None] * situation.velocity
    errors[there] = missed @ np.array([[c, -s], [s, c]])
    return errors


def _fit_axis(features: Array, errors: Array) -> Array:
    """(F + 1,) coefficients and exponent for errors (N, T), by quasi-Newton steps with the exact gradient."""
    seen = np.isfinite(errors)
    squared = np.where(seen, errors, 0.0) ** 2
    log_times = np.log(TIMES)

    def objective(x: Array) -> tuple[float, Array]:
        growth = np.exp(x[-1])
        grown = np.exp(2 * (features @ x[:-1])[:, None] + 2 * growth * log_times)
        variances = START**2 + grown
        value = np.where(seen, 0.5 * (np.log(variances) + squared / variances), 0.0).sum() / seen.sum()
        slope = np.where(seen, (1 - squared / variances) / variances, 0.0) * grown / seen.sum()
        return float(value), np.append(features.T @ slope.sum(axis=1), growth * (slope @ log_times).sum())

    limits = [(-10.0, 10.0)] * features.shape[1] + [(np.log(0.3), np.log(3.0))]
    result = minimize(objective, np.zeros(features.shape[1] + 1), jac=True, method="L-BFGS-B", bounds=limits)
    return np.append(result.x[:-1], np.exp(result.x[-1]))


if __name__ == "__main__":
    sys.exit(main())
