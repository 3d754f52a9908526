"""Fit the multi-modal baseline: `python -m predictor.fit_manoeuvres --data DIR --out FILE`.

The same split of files as `predictor.fit_constant_velocity`: no vehicle is in both parts. Fitted on one part by maximum
likelihood of whole trajectories (joint over the times, given each mode), judged on the other, beside the
constant-velocity baseline in the same form. Needs torch (the extra `predictor`) for the gradients.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from checkers.validate import Array, InputError
from predictor.constant_velocity import ConstantVelocity, Situation
from predictor.fit_constant_velocity import EVERY, JUDGED, LEVELS, MOVING, START, TIMES, split
from predictor.io_commonroad import lanes_of, open_commonroad, tracks_of
from predictor.lanes import Lane
from predictor.manoeuvres import Axis, Manoeuvres, Mixture, courses_of, situation_features
from predictor.surroundings import look_around
from predictor.tracks import SLACK, Track

Recording = tuple[tuple[Track, ...], tuple[Lane, ...]]

WINDOW = 0.5
# manoeuvres ahead and to the left
AHEAD, LEFT = 2, 3
# of the squared coefficients, features scaled to a spread of one
PENALTY = 1e-3
RANGE = 0.002
ITERATIONS = 400
DRAWS = 200


@dataclass(frozen=True, eq=False)
class Samples:
    """Situations and what came of them.

    Attributes:
        even: (N, E), odd: (N, O) features.
        bends: (N, T) to the left, of the lane, at `TIMES` [m].
        errors: (N, T, 2) true position minus that at constant velocity, ahead and left [m]; NaN where not recorded.
        variances: (N, T, 2) stated by the constant-velocity baseline [m²].
        speeds: (N,) [m/s].
    """

    even: Array
    odd: Array
    bends: Array
    errors: Array
    variances: Array
    speeds: Array

    @property
    def drift(self) -> Array:
        """(N,) speed across the lane to the left [m/s]."""
        return self.odd[:, 1]

    def of(self, rows: Any) -> Samples:
        """Those `rows` only."""
        return Samples(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))


def sample(recordings: Sequence[Recording], *, past: bool) -> Samples:
    """A prediction every `EVERY` s of each track; with `past` from 2 s of it, else from the state alone."""
    baseline = ConstantVelocity.fitted()
    spread = baseline.past if past else baseline.initial
    rows: list[tuple[Any, ...]] = []
    for tracks, lanes in recordings:
        present: dict[int, list[Track]] = {}
        for track in tracks:
            for now in np.arange(track.times[0], track.times[-1] - 1.0 + SLACK, EVERY):
                known = track.until(now)
                now = float(known.times[-1])
                if past and known.times[0] > now - 2.0 + SLACK:
                    continue
                key = round(now / SLACK)
                if key not in present:
                    there = [t for t in tracks if t.covers(now, now)]
                    present[key] = [replace(t.window(now, now), times=np.array([now])) for t in there]
                others = [t for t in present[key] if t.name != track.name]
                one = known if past else replace(known.window(now, now), times=np.array([now]))
                rows.append((*_row(track, one, now, lanes, others, spread.variances),))
    if not rows:
        raise InputError("data: expected tracks of at least 3 s, got none")
    return Samples(*(np.array(column) for column in zip(*rows, strict=True)))


def _row(
    track: Track,
    known: Track,
    now: float,
    lanes: Sequence[Lane],
    others: Sequence[Track],
    variances: Callable[[Array, Array], Array],
) -> tuple[Any, ...]:
    situation = Situation.of(known, WINDOW)
    c, s = np.cos(situation.heading), np.sin(situation.heading)
    frame = np.array([[c, -s], [s, c]])
    speed = float(situation.velocity @ frame[:, 0])
    around = look_around(known, speed, lanes, others)
    there = now + TIMES <= track.times[-1] + SLACK
    errors = np.full((len(TIMES), 2), np.nan)
    future = track.at(now + TIMES[there]).positions - situation.position
    errors[there] = (future - TIMES[there, None] * situation.velocity) @ frame
    bends = (around.course(speed * TIMES)[0] - situation.position) @ frame[:, 1]
    features = situation_features(situation, around)
    return *features, bends, errors, variances(situation.features, TIMES), abs(speed)


def log_likelihood(errors: Any, means: Any, spreads: Any, rest: Any, start: float, xp: Any) -> Any:
    """log N of trajectories (…, T): r = mean + spread ξ + ε, ξ ~ N(0, 1) once, ε_t ~ N(0, start² + (rest spread)²).

    Missing errors (NaN) are left out. By the matrix determinant lemma and the Sherman & Morrison (1950) formula.
    """
    seen = xp.isfinite(errors) & xp.isfinite(means)
    missed = xp.nan_to_num(errors) - means
    own = start**2 + (rest * spreads) ** 2
    terms = -0.5 * (missed**2 / own + xp.log(2 * np.pi * own))
    shared, cross = spreads**2 / own, spreads * missed / own
    keep = seen * 1.0
    total = (terms * keep).sum(-1)
    gain = 1 + (shared * keep).sum(-1)
    return total + 0.5 * ((cross * keep).sum(-1) ** 2 / gain - xp.log(gain))


def fit(samples: Samples, ahead: int = AHEAD, left: int = LEFT, iterations: int = ITERATIONS) -> Mixture:
    """Maximum likelihood, axis by axis, which are independent given the situation."""
    centre, scale, even_range, odd_range = _scales(samples)
    even = (np.clip(samples.even, *even_range) - centre) / scale[0]
    odd = np.clip(samples.odd, -odd_range, odd_range) / scale[1]
    nothing = np.zeros_like(samples.bends), np.zeros_like(samples.drift)
    axes = [
        _fit_axis(ahead, even, even, nothing, samples.errors[..., 0], iterations),
        _fit_axis(left, even, odd, (samples.bends, samples.drift), samples.errors[..., 1], iterations),
    ]
    for found in axes:
        for name in ("choice", "spread", "mean"):
            if found[name].shape[1] == even.shape[1]:
                found[name] = found[name] / scale[0]
                found[name][:, 0] -= found[name][:, 1:] @ centre[1:]
            else:
                found[name] = found[name] / scale[1]
    return Mixture(Axis(**axes[0]), Axis(**axes[1]), START, even_range, odd_range)


def _fit_axis(
    count: int, even: Array, moving: Array, lead: tuple[Array, Array], errors: Array, iterations: int
) -> dict[str, Any]:
    """Parameters of an `Axis` by L-BFGS, features scaled; a small penalty on all but constants.

    The search starts from manoeuvres from tight to wide. The tightest goes on exactly as it did, as a part of the
    recordings does; the others keep to the lane.
    """
    lanes = bool(lead[0].any())
    sizes = np.append(-3.0, np.linspace(-2.0, 0.0, count - 1) if count > 2 else np.full(count - 1, -1.0))
    start = {
        "choice": np.zeros((count, even.shape[1])),
        "mean": np.zeros((count, moving.shape[1])),
        "spread": np.zeros((count, even.shape[1])),
        "sizes": sizes + (0.0 if lanes else 1.0),
        "growth": np.full(count, np.log(1.4)),
        "rest": np.full(count, np.log(0.2)),
        "lane": np.append(0.0, np.ones(count - 1)),
        "relaxation": np.zeros(count),
    }
    free = {k: torch.tensor(v, dtype=torch.float64, requires_grad=True) for k, v in start.items()}
    data = [torch.tensor(v) for v in (even, moving, *lead, errors)]
    observed = float(np.isfinite(errors).sum())
    moved = list(free.values()) if lanes else [v for k, v in free.items() if k not in ("lane", "relaxation")]
    optimiser = torch.optim.LBFGS(
        moved, max_iter=iterations, history_size=30, line_search_fn="strong_wolfe", tolerance_change=1e-9
    )

    def loss() -> Any:
        optimiser.zero_grad()
        value = -_mixed(_bounded(free, lanes), *data).sum() / observed
        value = value + PENALTY * sum((free[n][:, 1:] ** 2).sum() for n in ("choice", "mean", "spread"))
        value.backward()
        return value

    optimiser.step(loss)  # type: ignore[no-untyped-call]
    return {k: v.detach().numpy() for k, v in _bounded(free, lanes).items()}


def _scales(samples: Samples) -> tuple[Array, tuple[Array, Array], Array, Array]:
    """Centre of the even features, scales of both, and the ranges outside of which a feature counts as its limit."""
    even_range = np.quantile(samples.even, [RANGE, 1 - RANGE], axis=0)
    odd_range = np.quantile(np.abs(samples.odd), 1 - RANGE, axis=0)
    centre, spread = samples.even.mean(axis=0), samples.even.std(axis=0)
    centre[0], spread[0] = 0.0, 1.0
    return centre, (np.maximum(spread, 1e-6), np.maximum(samples.odd.std(axis=0), 1e-6)), even_range, odd_range


def _bounded(free: Mapping[str, torch.Tensor], lanes: bool) -> dict[str, Any]:
    """Parameters of an `Axis` from the unbounded ones that are searched."""
    values = dict(free)
    sizes = values.pop("sizes")[:, None]
    values["spread"] = values["spread"] + torch.nn.functional.pad(sizes, (0, values["spread"].shape[1] - 1))
    for name in ("growth", "rest", "relaxation"):
        values[name] = torch.exp(values[name])
    if not lanes:
        values["lane"] = torch.zeros_like(values["lane"])
    return values


def _mixed(values: Mapping[str, Any], even: Any, moving: Any, bends: Any, drift: Any, errors: Any) -> Any:
    """(N,) log-likelihood of whole trajectories along one axis, summed over its manoeuvres."""
    means, spreads = courses_of(values, even, moving, (bends, drift), torch.tensor(TIMES))
    each = log_likelihood(errors[:, None], means, spreads, values["rest"][:, None], START, torch)
    return torch.logsumexp(torch.log_softmax(even @ values["choice"].T, -1) + each, -1)


def joint(model: Mixture, samples: Samples) -> Array:
    """(N,) log-likelihood of each whole trajectory."""
    even, odd = model.clipped(samples.even, samples.odd)
    total = np.zeros(len(even))
    lead = samples.bends, samples.drift
    for i, (axis, moving) in enumerate(((model.ahead, even), (model.left, odd))):
        values = {k: torch.tensor(v) for k, v in vars(axis).items()}
        data = (torch.tensor(v) for v in (even, moving, *lead, samples.errors[..., i]))
        total += _mixed(values, *data).numpy()
    return total


def joint_of_baseline(samples: Samples, rest: float) -> Array:
    """(N,) the same of the constant-velocity baseline, of whose deviations the share `rest` does not persist."""
    total = np.zeros(len(samples.errors))
    for axis in range(2):
        spread = np.sqrt(np.maximum(samples.variances[..., axis] - START**2, 1e-12) / (1 + rest**2))
        total += log_likelihood(samples.errors[..., axis], 0.0 * spread, spread, rest, START, np)
    return total


def judge(samples: Samples, whole: Array, modes: tuple[Array, Array, Array], seed: int = 0) -> dict[str, Any]:
    """Likelihoods [nat a predicted position] and coverage of the smallest regions of 50, 90, 99 % at 1, 2, 3 s.

    Args:
        samples: situations and what came of them.
        whole: (N,) log-likelihood of trajectories.
        modes: log-weights (N, K), means and variances (N, K, T, 2) relative to constant velocity.
        seed: of the draws that tell how much of a mixture is denser than what happened.
    """
    weights, means, variances = modes
    seen: Array = np.asarray(np.isfinite(samples.errors).all(axis=-1))
    density = _log_density(samples.errors[:, None], *modes)[:, 0]
    inside, rng = {}, np.random.default_rng(seed)
    for time in JUDGED:
        t = int(np.searchsorted(TIMES, time - SLACK))
        rows = np.flatnonzero(seen[:, t])
        mode = (weights[rows].cumsum(axis=1)[:, None] < rng.random((len(rows), DRAWS, 1))).sum(axis=-1)
        pick = (rows[:, None], np.minimum(mode, weights.shape[1] - 1), t)
        drawn = means[pick] + np.sqrt(variances[pick]) * rng.standard_normal((len(rows), DRAWS, 2))
        one = (weights[rows], means[rows, :, t : t + 1], variances[rows, :, t : t + 1])
        denser = (_log_density(drawn[:, :, None], *one)[..., 0] > density[rows, t, None]).mean(axis=1)
        inside[f"{time:g} s"] = [round(float(np.mean(denser < level)), 3) for level in LEVELS]
    return {
        "predictions": len(seen),
        "joint_nll": round(float(-whole.sum() / seen.sum()), 3),
        "marginal_nll": round(float(-density[seen].mean()), 3),
        "within_50_90_99": inside,
    }


def _log_density(points: Array, weights: Array, means: Array, variances: Array) -> Array:
    """(N, S, T) of points (N, S, T, 2); NaN stays."""
    missed = points[:, :, None] - means[:, None]
    terms = -0.5 * (missed**2 / variances[:, None] + np.log(2 * np.pi * variances[:, None])).sum(axis=-1)
    terms = terms + np.log(weights)[:, None, :, None]
    top = terms.max(axis=2)
    found: Array = top + np.log(np.exp(terms - top[:, :, None]).sum(axis=2))
    return found


def _stated(model: Mixture, samples: Samples) -> tuple[Array, Array, Array]:
    weights, means, deviations = model.stated(samples.even, samples.odd, samples.bends, samples.drift, TIMES)
    return weights, means, deviations**2


def collect(recordings: Mapping[str, Recording], seed: int) -> tuple[dict[str, list[str]], dict[str, list[Samples]]]:
    """Names of the files fitted on and held out, and with and without a past the samples of both."""
    first, held = split({key: tracks for key, (tracks, _) in recordings.items()}, seed)
    samples = {
        key: [sample([recordings[n] for n in part], past=past) for part in (first, held)]
        for key, past in (("past", True), ("initial", False))
    }
    return {"fitted_on": first, "held_out": held}, samples


def train(names: Mapping[str, list[str]], samples: Mapping[str, Sequence[Samples]], seed: int, data: str) -> Manoeuvres:
    """Fit on the first part, judge on the other, beside the constant-velocity baseline."""
    summary: dict[str, Any] = {
        "data": data,
        "split": "by groups of files that share no recorded vehicle",
        "seed": seed,
        **names,
    }
    found = {}
    for key, (first, held) in samples.items():
        found[key] = model = fit(first)
        shares = np.linspace(0.05, 1.0, 20)
        rest = float(min(shares, key=lambda share: -joint_of_baseline(first, share).sum()))
        summary[key] = {"baseline_rest": round(rest, 2)}
        for who, rows in (("all", held.speeds >= 0), ("moving", held.speeds >= MOVING)):
            some = held.of(rows)
            plain = np.ones((len(some.speeds), 1)), np.zeros((len(some.speeds), 1, len(TIMES), 2)), some.variances
            summary[key][who] = {
                "manoeuvres": judge(some, joint(model, some), _stated(model, some)),
                "constant_velocity": judge(
                    some, joint_of_baseline(some, rest), (plain[0], plain[1], plain[2][:, None])
                ),
            }
    return Manoeuvres(found["past"], found["initial"], WINDOW, summary)


def table(model: Manoeuvres) -> str:
    """The held-out part of the summary, for reading."""
    rows = [f"{'held out':<38}{'n':>7}{'joint NLL':>11}{'NLL':>8}   within 50/90/99 % at 1, 2, 3 s"]
    for key in ("past", "initial"):
        for who in ("all", "moving"):
            for which, r in model.summary[key][who].items():
                shares = r["within_50_90_99"].values()
                inside = "   ".join("/".join(f"{100 * v:.1f}" for v in row) for row in shares)
                numbers = f"{r['predictions']:>7}{r['joint_nll']:>11.3f}{r['marginal_nll']:>8.3f}"
                rows.append(f"{f'{key}, {who}, {which}':<38}{numbers}   {inside}")
    return "\n".join(rows)


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m predictor.fit_manoeuvres", description=__doc__)
    parser.add_argument("--data", type=Path, required=True, help="folder of recorded CommonRoad XML files")
    parser.add_argument("--out", type=Path, required=True, help="JSON file to write")
    parser.add_argument("--seed", type=int, default=0, help="of the split (default 0)")
    options = parser.parse_args(arguments)
    try:
        files = sorted(options.data.glob("*.xml"))
        if not files:
            raise InputError(f"{options.data}: no XML files")
        recordings = {}
        for file in files:
            recorded, _ = open_commonroad(file)
            recordings[file.stem] = (tracks_of(recorded, file), lanes_of(recorded, file))
        names, samples = collect(recordings, options.seed)
        model = train(names, samples, options.seed, options.data.resolve().name)
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    sys.stdout.write(table(model) + "\n")
    options.out.write_text(json.dumps(model.to_dict(), indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
