"""`sweep`: what the best plan costs at other bounds, the Pareto front of risk bound against arrival time and cost."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from checkers import Checker, InputError
from checkers.validate import as_scalar, as_tuple
from riskplan.planning import plan as make_plan
from riskplan.result import Plan
from riskplan.scene import Scenario
from riskplan.search import Planner

BOUNDS = (1e-5, 1e-4, 1e-3, 1e-2, 3e-2, 0.1, 0.3)


@dataclass(frozen=True, eq=False)
class SweepPoint:
    """One bound of a sweep.

    Attributes:
        bound: on the total risk.
        plan: what planning at this bound returned.
        best: the best plan known to be within the bound, maybe one made for a tighter bound; None if there is none.
        on_front: whether no tighter bound has a plan that arrives as early, or costs as little.
    """

    bound: float
    plan: Plan
    best: Plan | None
    on_front: bool

    @property
    def arrival(self) -> float:
        """Of the best plan [s]; NaN without one."""
        return np.nan if self.best is None else float(self.best.times[-1])

    @property
    def cost(self) -> float:
        """Of the best plan, as its planner states it [s]; NaN where it states none."""
        return np.nan if self.best is None else float(self.best.stats.get("cost", np.nan))

    @property
    def risk(self) -> float:
        """Of the best plan, as judged; NaN without one."""
        if self.best is None:
            return np.nan
        return 0.0 if self.best.risk is None else float(self.best.risk.total)


def sweep(
    scenario: Scenario,
    bounds: Sequence[float] = BOUNDS,
    planner: str | Planner = "rrt-star",
    checker: str | Checker = "exact",
    dependence: str = "independent",
    time_limit: float = 1.0,
    seed: int = 0,
    stop: Callable[[], bool] | None = None,
    **options: Any,
) -> tuple[SweepPoint, ...]:
    """Plan at each bound, from the tightest to the loosest.

    A plan within a tighter bound is within every looser one, so what is known at a bound never gets worse with it.

    Args:
        scenario: what is planned for.
        bounds: on the total risk, in any order.
        planner: one that goes on after its first plan, as `rrt-star` does, shows what a bound costs; others show luck.
        checker, dependence, time_limit, seed, stop: of every plan, as of `plan`.
        **options: of `plan` and of the planner.

    Returns:
        a point per bound, in increasing order.

    Raises:
        InputError: on bounds that are none, and as `plan`.
    """
    given = as_tuple("bounds", bounds)
    values = sorted({as_scalar(f"bounds[{i}]", value, low=0.0, high=1.0) for i, value in enumerate(given)})
    if not values:
        raise InputError("bounds: expected at least one, got none")
    points: list[SweepPoint] = []
    best: Plan | None = None
    for bound in values:
        found = make_plan(scenario, planner, checker, bound, dependence, time_limit, seed, stop, **options)
        better = found.solved and (best is None or _merit(found) < _merit(best))
        best = found if better else best
        points.append(SweepPoint(bound, found, best, bool(better)))
    return tuple(points)


def _merit(plan: Plan) -> tuple[float, float]:
    """Less is better: cost where the planner states it, then arrival."""
    return float(plan.stats.get("cost", 0.0)), float(plan.times[-1])


def sweep_rows(points: Sequence[SweepPoint]) -> list[dict[str, Any]]:
    """The numbers of a sweep, None for what there is not; for JSON and tables."""
    names = ("arrival", "cost", "risk")
    return [
        {
            "bound": p.bound,
            "status": p.plan.status,
            **{name: (None if np.isnan(getattr(p, name)) else getattr(p, name)) for name in names},
            "on_front": p.on_front,
        }
        for p in points
    ]


def plot_sweep(points: Sequence[SweepPoint], path: str | Path) -> None:
    """Arrival time and cost over the bound, as a picture."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415  half a second
    from matplotlib.figure import Figure  # noqa: PLC0415

    figure = Figure(figsize=(6.0, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    bounds = np.array([p.bound for p in points])
    for name, colour, label in (("arrival", "#3060a0", "arrival [s]"), ("cost", "#c05020", "cost [s]")):
        values = np.array([getattr(p, name) for p in points])
        if np.isfinite(values).any():
            axes.step(bounds, values, where="post", color=colour, linewidth=1.0, alpha=0.6)
            axes.plot(bounds, values, "o", color=colour, label=label)
    axes.set_xscale("log")
    axes.set_xlabel("bound on the collision risk")
    axes.set_ylabel("seconds")
    axes.grid(alpha=0.3)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(frameon=False)
    figure.savefig(path, dpi=150)
