"""The same planner with the paper's backends at the paper's speed: `python -m benchmarks.paper_backend --data DIR`.

Imhof (1961) by plain inversion of the characteristic function through `scipy.integrate.quad`, mode by mode, as the
paper's own code does, against `exact`; and the SOS program of its eq. 18, modelled anew for every mode in cvxpy (extra
`bench`; left out without it), against `sos`. The same tasks and seeds, and as many motions of the tree, in one run.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from scipy.integrate import quad

import riskplan as rp
from benchmarks.planning_tasks import Task, progress, tasks_of
from checkers import Checker, CheckerInfo, Kind
from checkers.base import ArrayRisk
from checkers.kernels.tail import MAX_ORDER, gaussian_form
from checkers.validate import Array

_ORDER = 4


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


@dataclass(frozen=True)
class PlainSos(Checker):
    """min E[p(g)] with p ≥ 0, and p ≥ 1 where g ≤ 0, as sums of squares (Jasour et al. 2021, eq. 18), order 4."""

    info: ClassVar[CheckerInfo] = CheckerInfo(
        name="plain-sos",
        kind=Kind.ESTIMATE,
        needs="a Gaussian mixture",
        assumption="none beyond the moments",
        source="Jasour et al. 2021, eq. 18",
        cost="ten milliseconds",
    )

    @property
    def kernel(self) -> int:
        """None: works on arrays."""
        return 0

    def modes(self, m: Array, s: Array, moments: Array, order: int) -> ArrayRisk:
        """One program after the other."""
        del moments, order
        value = np.array([programme(*pair) for pair in zip(m, s, strict=True)])
        return ArrayRisk(value, np.full(len(value), np.nan), np.full(len(value), np.nan))


def programme(mean: Array, covariance: Array) -> float:
    """One mode: model and solve."""
    import cvxpy as cp  # noqa: PLC0415  not everyone has it

    form = np.empty(MAX_ORDER + 1)
    centre, spread = gaussian_form(*mean, *covariance, _ORDER, form, np.zeros(MAX_ORDER + 1))
    below, side = -centre / spread, _ORDER // 2 + 1
    p = cp.Variable(_ORDER + 1)
    q, r = cp.Variable((side, side), PSD=True), cp.Variable((side, side), PSD=True)
    t = cp.Variable((side - 1, side - 1), PSD=True)
    held = []
    for k in range(_ORDER + 1):
        held.append(p[k] == _diagonal(q, k))
        # p − 1 = r + (x₀ − x) t on x ≤ x₀
        held.append(p[k] - (k == 0) == _diagonal(r, k) + below * _diagonal(t, k) - _diagonal(t, k - 1))
    problem = cp.Problem(cp.Minimize(form[: _ORDER + 1] @ p), held)
    try:
        problem.solve(solver=cp.CLARABEL)
    except cp.error.SolverError:
        return 1.0
    return float(np.clip(problem.value, 0.0, 1.0)) if problem.status == cp.OPTIMAL else 1.0


def _diagonal(matrix: Any, k: int) -> Any:
    """Coefficient of x^k in a form of the monomials."""
    side = matrix.shape[0]
    return sum(matrix[i, k - i] for i in range(side) if 0 <= k - i < side)


def main(arguments: list[str] | None = None) -> int:
    """Parse, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", required=True, help="directory with CommonRoad files, searched recursively")
    parser.add_argument("--files", type=int, default=12, help="how many files, spread evenly over the sorted list")
    parser.add_argument("--tasks", type=int, default=3, help="how many tasks")
    parser.add_argument("--bound", type=float, default=0.1)
    parser.add_argument("--motions", type=int, default=10, help="motions of the tree, at most")
    parser.add_argument("--limit", type=float, default=120.0, help="time limit of a search [s]")
    options = parser.parse_args(arguments)
    files = sorted(Path(options.data).rglob("*.xml"))
    chosen = [files[i] for i in np.unique(np.linspace(0, len(files) - 1, options.files).astype(int))]
    tasks = [t for f in progress(chosen, "tasks") for t in tasks_of(f, 0) if t.kind == "horizon"]
    pairs: list[tuple[Checker, Checker]] = [(rp.checker("exact"), PlainImhof())]
    if find_spec("cvxpy"):
        pairs.append((rp.checker("sos", order=_ORDER), PlainSos()))
    print(
        "| agents | ours | ms a motion | the paper's | ms a motion | motions | ratio per motion |\n"
        "|---|---|---|---|---|---|---|"
    )
    for task in tasks[: options.tasks]:
        for ours, theirs in pairs:
            measured(task, ours, options)  # loads the kernels
            (quick, _), (slow, motions) = (measured(task, each, options) for each in (ours, theirs))
            print(
                f"| {len(task.scenario.agents)} | {ours.info.name} | {1e3 * quick:.2f} | {theirs.info.name} "
                f"| {1e3 * slow:.0f} | {motions} | {slow / quick:.0f} |",
                flush=True,
            )
    return 0


def measured(task: Task, checker: Checker, options: argparse.Namespace) -> tuple[float, int]:
    """Seconds per motion of the search, and motions."""
    asked = {"bound": options.bound, "seed": task.seed, "iterations": options.motions, "time_limit": options.limit}
    with np.errstate(all="ignore"):
        stats = rp.plan(task.scenario, checker=checker, **asked).stats
    return stats["search"] / max(stats["motions"], 1), stats["motions"]


if __name__ == "__main__":
    sys.exit(main())
