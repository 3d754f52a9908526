"""How right the backends are: `python -m benchmarks.accuracy --data DIR`.

Exact backends against mpmath at 50 digits, bounds against the exact value in a million cases, frames and batches
against each other. DIR holds argoverse1-predictions.npz; without it only random cases are tried.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import mpmath as mp
import numpy as np

import riskplan as rp
from benchmarks.cases import Modes, load_scenarios, random_modes, table
from checkers.validate import Array
from tests import builders, oracles

SOLVERS = {"sos": [{"solver": "clarabel"}, {"order": 6, "solver": "clarabel"}], "bivariate-sos": [{}, {"order": 6}]}
ORDERS = {"sos": (2, 4, 6, 8, 12), "projected-sos": (4, 6, 8, 12), "offline-sos": (2, 4, 6, 8)}


def main(arguments: list[str] | None = None) -> int:
    """Parse, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, help="directory of the predictions file")
    parser.add_argument("--cases", type=int, default=200, help="of each kind against mpmath (0.4 s each)")
    parser.add_argument("--bounds", type=int, default=1_000_000, help="cases for the compiled bounds")
    parser.add_argument("--programs", type=int, default=2000, help="cases for the semidefinite programs")
    parser.add_argument("--agents", type=int, default=200, help="agents of a few points each, known by their moments")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args(arguments)
    rng = np.random.default_rng(args.seed)
    oracles.DIGITS = 50
    sets = {"random": random_modes(rng, 4 * args.cases)}
    if args.data is not None:
        modes = load_scenarios(args.data).modes()
        sets["predictions file"] = modes.part(rng.integers(0, len(modes.means), 2 * args.cases))
    exact_backends(sets, args.cases)
    violations = bounds(random_modes(rng, args.bounds, 12.0), args.programs)
    if args.data is not None:
        violations += bounds(modes, args.programs, "predictions file")
    violations += moment_agents(np.random.default_rng(args.seed), args.agents)
    frames(random_modes(rng, 20_000))
    return 1 if violations else 0


def exact_backends(sets: dict[str, Modes], count: int) -> None:
    """Relative errors where P ≥ 1e-300, and whether the returned errors hold."""
    rows: list[list[object]] = []
    for label, modes in sets.items():
        guess = rp.checker("exact")(modes.poses, modes.prediction, modes.ego).value[:, 0]
        chosen = modes.part(np.flatnonzero(guess >= 1e-300)[:count])
        true = [mass(chosen, i) for i in range(len(chosen.means))]
        for name in ("exact", "imhof", "liu"):
            risk = rp.checker(name)(chosen.poses, chosen.prediction, chosen.ego)
            value, error = risk.value[:, 0], risk.error[:, 0]
            off = np.array([float(abs(mp.mpf(float(v)) - t)) for v, t in zip(value, true, strict=True)])
            relative = off / np.array([float(t) for t in true])
            broken = int((off > error).sum())
            sizes = [float(np.median(relative)), float(np.quantile(relative, 0.99)), float(relative.max())]
            rows.append([label, name, len(true), float(min(true)), *sizes, float(off.max()), broken])
    head = [
        "cases",
        "backend",
        "n",
        "smallest P",
        "median rel.",
        "p99 rel.",
        "worst rel.",
        "worst abs.",
        "error broken",
    ]
    table("Exact backends and `liu` against mpmath, 50 digits", head, rows)


def mass(modes: Modes, i: int) -> mp.mpf:
    """P of one case by the polar integral, its doubles taken as exact."""
    with mp.workdps(oracles.DIGITS):
        return oracles.cone(
            *oracles.whiten(modes.poses[i], modes.means[i], modes.covariances[i], modes.ego.Q), nodes=18
        )


def bounds(modes: Modes, programs: int, label: str = "random") -> int:
    """Count values below the truth."""
    rows: list[list[object]] = []
    true = rp.checker("exact")(modes.poses, modes.prediction, modes.ego)
    least = (true.value - true.error)[:, 0]
    few = modes.part(slice(programs))
    total = 0
    for name, info in rp.checkers().items():
        if info.kind is not rp.Kind.UPPER_BOUND:
            continue
        for options in [{"order": n} for n in ORDERS.get(name, ())] + SOLVERS.get(name, []) or [{}]:
            backend = rp.checker(name, **options)
            some = modes if backend.kernel else few
            risk = backend(some.poses, some.prediction, some.ego)
            value, known = risk.value[:, 0], least[: len(some.means)]
            below = int((value < known).sum())
            above = (
                0 if risk.lower is None else int((risk.lower[:, 0] > (true.value + true.error)[: len(value), 0]).sum())
            )
            total += below + above
            rows.append([name, options, len(value), float((value < 1.0).mean()), below, above])
    table(
        f"Bounds, {label}", ["backend", "options", "cases", "share below 1", "below the truth", "lower above it"], rows
    )
    return total


def moment_agents(rng: np.random.Generator, count: int) -> int:
    """Bounds from the moments of a few points, some rare, some in thin clusters; the truth is the share inside."""
    ego, pose = rp.EgoEllipsoid(np.eye(2)), np.zeros((1, 3))
    variants = [(name, {"order": n}) for name, orders in ORDERS.items() for n in orders]
    variants += [("chebyshev", {}), ("halfspace", {}), ("marshall-olkin", {}), ("bivariate-sos", {"order": 6})]
    backends = [rp.checker(name, **options) for name, options in variants]
    below, lowest = np.zeros(len(backends), dtype=int), np.full(len(backends), np.inf)
    for _ in range(count):
        size = int(rng.integers(2, 7))
        centre = rng.normal(size=2) * 10 ** rng.uniform(-0.5, 1.2)
        points = centre + rng.normal(size=(size, 2)) * 10 ** rng.uniform(-5, 1)
        points[0] *= rng.uniform(0, 0.999) / max(float(np.hypot(*points[0])), 1e-300)  # one inside
        weights = np.append(10 ** rng.uniform(-7, -0.5), rng.dirichlet(np.ones(size - 1)))
        weights[1:] *= 1 - weights[0]
        share = float(weights[np.hypot(points[:, 0], points[:, 1]) <= 1.0].sum())
        pred = builders.discrete(points, weights, 24)
        for i, backend in enumerate(backends):
            value = float(backend(pose, pred, ego).value[0, 0])
            below[i] += value < share * (1 - 1e-9)
            lowest[i] = min(lowest[i], value / share)
    rows: list[list[object]] = [
        [n, o, count, int(b), float(r)] for (n, o), b, r in zip(variants, below, lowest, strict=True)
    ]
    table(
        "Bounds, agents of a few points",
        ["backend", "options", "agents", "below the truth", "smallest bound / true"],
        rows,
    )
    return int(below.sum())


def frames(modes: Modes) -> None:
    """Translation by (1e5, −1e5) m, rotation (covariances of condition below 100), batches against loops."""
    grid = 2.0**-20  # on multiples of a power of two a translation is exact
    poses = modes.poses.copy()
    poses[:, :2] = np.round((poses[:, :2] - modes.means) / grid) * grid
    shift, angle = np.array([1e5, -1e5]), 0.7
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    mild = np.linalg.cond(modes.covariances) < 100.0  # a rotated covariance is another one once its digits are gone
    home = Modes(poses, np.zeros_like(modes.means), modes.covariances, modes.ego).part(mild)
    moved = Modes(home.poses + [*shift, 0.0], home.means + shift, home.covariances, home.ego)
    covariances = turn @ home.covariances @ turn.T
    covariances = 0.5 * (covariances + np.swapaxes(covariances, 1, 2))
    turned = Modes(
        np.column_stack([home.poses[:, :2] @ turn.T, home.poses[:, 2] + angle]), home.means, covariances, home.ego
    )
    rows: list[list[object]] = []
    for name in rp.checkers():
        backend = rp.checker(name)
        if not backend.kernel:
            continue
        value = _values(backend, home)
        batch = np.broadcast_to(home.poses, (3, *home.poses.shape))
        again = backend(batch, home.prediction, home.ego).value[1, :, 0]
        rows.append([name, _change(_values(backend, moved), value), _change(_values(backend, turned), value)])
        rows[-1].append("yes" if np.array_equal(again, value) else "NO")
    table(
        "Change of frame",
        ["backend", "moved by (1e5, −1e5) m, rel.", "turned, rel.", "batch = loop, bit for bit"],
        rows,
    )


def _values(backend: rp.Checker, modes: Modes) -> Array:
    value: Array = backend(modes.poses, modes.prediction, modes.ego).value[:, 0]
    return value


def _change(after: Array, before: Array) -> float:
    """Largest relative change where the risk is a normal number."""
    kept = before > 1e-290
    return float((np.abs(after - before)[kept] / before[kept]).max())


if __name__ == "__main__":
    sys.exit(main())
