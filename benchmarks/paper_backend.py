"""The same planner with the paper's backend at the paper's speed: `python -m benchmarks.paper_backend --data DIR`.

Imhof (1961) by plain inversion of the characteristic function through `scipy.integrate.quad`, mode by mode, as the
paper's own code does, against `exact`: the same tasks, the same seeds, the same number of motions.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import ClassVar

import numpy as np
from scipy.integrate import quad

import riskplan as rp
from benchmarks.planning import progress, tasks_of
from checkers import Checker, CheckerInfo, Kind
from checkers.base import ArrayRisk
from checkers.validate import Array


@dataclass(frozen=True)
class PlainImhof(Checker):
    """P(|y| ≤ 1) = 1/2 − (1/π) ∫ sin θ(u) / (u ρ(u)) du (Imhof 1961, eq. 3.2), absolute accuracy 1e-8."""

    info: ClassVar[CheckerInfo] = CheckerInfo(
        name="plain-imhof",
        kind=Kind.ESTIMATE,
        needs="a Gaussian mixture",
        assumption="Gaussian modes",
        source="Imhof 1961",
        cost="milliseconds",
    )

    @property
    def kernel(self) -> int:
        """None: works on arrays."""
        return 0

    def modes(self, m: Array, s: Array, moments: Array, order: int) -> ArrayRisk:
        """One integral after the other."""
        del moments, order
        value = np.array([inverted(*pair) for pair in zip(m, s, strict=True)])
        return ArrayRisk(value, np.full(len(value), 1e-8), np.full(len(value), np.nan))


def inverted(mean: Array, covariance: Array) -> float:
    """One mode."""
    variances, axes = np.linalg.eigh(np.array([[covariance[0], covariance[1]], [covariance[1], covariance[2]]]))
    variances = np.maximum(variances, 1e-12)
    shift = (axes.T @ mean) ** 2 / variances

    def integrand(u: float) -> float:
        if u == 0.0:
            return 0.5 * float((variances * (1.0 + shift)).sum() - 1.0)
        scaled = variances * u
        theta = 0.5 * float((np.arctan(scaled) + shift * scaled / (1.0 + scaled**2)).sum() - u)
        damping = float(
            np.prod((1.0 + scaled**2) ** 0.25) * np.exp(0.5 * (shift * scaled**2 / (1.0 + scaled**2)).sum())
        )
        return float(np.sin(theta) / (u * damping))

    area, _ = quad(integrand, 0.0, np.inf, limit=200, epsabs=1e-8)
    return float(np.clip(0.5 - area / np.pi, 0.0, 1.0))


def main(arguments: list[str] | None = None) -> int:
    """Parse, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", required=True, help="directory with CommonRoad files, searched recursively")
    parser.add_argument("--files", type=int, default=12, help="how many files, spread evenly over the sorted list")
    parser.add_argument("--tasks", type=int, default=3, help="how many tasks that `exact` solves soon")
    parser.add_argument("--bound", type=float, default=0.1)
    parser.add_argument("--limit", type=float, default=60.0, help="time limit of a search [s]")
    options = parser.parse_args(arguments)
    files = sorted(Path(options.data).rglob("*.xml"))
    chosen = [files[i] for i in np.unique(np.linspace(0, len(files) - 1, options.files).astype(int))]
    tasks = [t for f in progress(chosen, "tasks") for t in tasks_of(f, 0) if t.kind == "horizon"]
    print(
        "| agents | exact [ms] | motions | plain Imhof [s] | motions | status | ratio per motion |\n"
        "|---|---|---|---|---|---|---|"
    )
    done = 0
    for task in tasks:
        asked = {"bound": options.bound, "seed": task.seed}
        rp.plan(task.scenario, time_limit=0.1, **asked)
        began = perf_counter()
        ours = rp.plan(task.scenario, time_limit=1.0, **asked)
        quick = perf_counter() - began
        if not ours.solved or ours.stats["motions"] > 60:
            continue
        began = perf_counter()
        with np.errstate(all="ignore"):
            theirs = rp.plan(task.scenario, checker=PlainImhof(), time_limit=options.limit, **asked)
        slow = perf_counter() - began
        ratio = (slow / max(theirs.stats["motions"], 1)) / (quick / ours.stats["motions"])
        print(
            f"| {len(task.scenario.agents)} | {1e3 * quick:.1f} | {ours.stats['motions']} | {slow:.1f} "
            f"| {theirs.stats['motions']} | {theirs.status} | {ratio:.0f} |",
            flush=True,
        )
        done += 1
        if done == options.tasks:
            break
    return 0


if __name__ == "__main__":
    sys.exit(main())
