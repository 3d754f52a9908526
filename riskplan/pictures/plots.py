"""Plots for papers, in matplotlib: figures of their own, no pyplot, so no shared state; `save` writes one.

Risk over time and budget of a plan, risk maps, and from plain arrays: Pareto fronts, reliability, tightness.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from checkers import Checker, InputError
from checkers.backends.monte_carlo import clopper_pearson
from checkers.validate import Array
from riskplan.pictures import geometry, palette
from riskplan.pictures.picture import picture, spent
from riskplan.pictures.risk_map import RiskMap
from riskplan.result import Plan
from riskplan.scene import Agent, Scenario

__all__ = [
    "blank",
    "budget",
    "pareto",
    "reliability",
    "risk_map",
    "risk_over_time",
    "risk_surface",
    "save",
    "tightness",
]

COLOURS = ("#3a6bd6", "#e07b1f", "#1c9c86", "#7b4fcf", "#c9487e", "#a58a1f", "#5f7486")
_LEVELS = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 0.5)
_HEAT = LinearSegmentedColormap.from_list("risk", palette.RISK)


def save(figure: Figure, path: str | os.PathLike[str]) -> Path:
    """Write a figure; the suffix picks the format. The same figure gives the same bytes (.png)."""
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(target, metadata={"Software": None} if target.suffix == ".png" else None)
    return target


def risk_over_time(
    scenario: Scenario,
    plan: Plan,
    checkers: Sequence[str | Checker] = ("exact", "projected-sos", "halfspace"),
    *,
    samples: int = 20_000,
    seed: int = 0,
    confidence: float = 0.99,
) -> Figure:
    """Risk of each step by each backend, with the band that sampling allows.

    Args:
        scenario, plan: a solved plan and what it was made for.
        checkers: names, or backends with options.
        samples: futures of each agent for the Clopper–Pearson band; 0 for none.
        seed: of these.
        confidence: of the band.

    Raises:
        InputError: as `audit`.
    """
    from riskplan.report import audit  # noqa: PLC0415  compiles kernels

    report = audit(plan, scenario, checkers, monte_carlo=0)
    figure, axes = blank("time [s]", "risk of the step")
    lowest = 1e-9
    if samples and any(_known(agent) for agent in scenario.agents):
        hits = sampled_hits(scenario, plan, samples, seed)
        low, high = clopper_pearson(hits, samples, confidence)
        label = f"Monte Carlo, {samples}, {confidence:.0%}"
        lowest = 0.05 / samples
        axes.fill_between(plan.times, np.maximum(low, lowest), high, color="#b9c4d0", alpha=0.55, lw=0, label=label)
    for i, verdict in enumerate(report.verdicts):
        if verdict.risk is not None:
            label = f"{verdict.checker} ({verdict.kind})"
            risk = verdict.risk.per_step
            axes.plot(plan.times, np.where(risk < lowest, np.nan, risk), color=_colour(i), lw=1.8, label=label)
    axes.set_yscale("log")
    axes.set_ylim(lowest, 1.3)
    axes.set_xlim(plan.times[0], plan.times[-1])
    figure.legend(loc="outside upper left", ncols=3, frameon=False, fontsize=8.5)  # bounds fill the axes
    return figure


def sampled_hits(scenario: Scenario, plan: Plan, samples: int, seed: int = 0) -> Array:
    """(T,) in how many of the sampled futures some agent is inside the ego's pieces at each step.

    Agents known by their moments only are left out.
    """
    rng = np.random.default_rng(seed)
    found = np.zeros((samples, len(plan.times)), dtype=bool)
    cos, sin = np.cos(plan.poses[:, 2]), np.sin(plan.poses[:, 2])
    for agent in filter(_known, scenario.agents):
        covered = plan.times >= agent.times[0] - 1e-6
        away = agent.at(plan.times[covered]).sample(samples, rng) - plan.poses[covered, :2]
        c, s = cos[covered], sin[covered]
        local = np.stack([c * away[..., 0] + s * away[..., 1], c * away[..., 1] - s * away[..., 0]], axis=-1)
        for centre, form in zip(*scenario.ego.pieces(agent), strict=True):
            off = local - centre
            found[:, covered] |= np.einsum("...i,ij,...j->...", off, form, off) <= 1.0
    return np.asarray(found.sum(axis=0), dtype=np.float64)


def budget(scenario: Scenario, plan: Plan) -> Figure:
    """How the bound is spent over time, agent by agent.

    Raises:
        InputError: if the plan does not tell the risk of each agent.
    """
    rows = spent(scenario, plan)
    if not rows.shape[1]:
        raise InputError("plan.marginals: expected one per agent of the scenario, got none")
    figure, axes = blank("time [s]", "risk so far")
    names = [agent.name or f"agent {i}" for i, agent in enumerate(scenario.agents)]
    colours = [palette.AGENTS[i % len(palette.AGENTS)] for i in range(len(names))]
    axes.stackplot(plan.times, rows.T, labels=names, colors=colours, alpha=0.85, lw=0)
    top = float(rows[-1].sum())
    if plan.bound is not None:
        axes.axhline(plan.bound, color="#dc2a36", lw=1.6, ls=(0, (5, 3)), label=f"bound {plan.bound:g}")
        top = max(top, plan.bound)
    axes.set_ylim(0.0, 1.12 * top)
    axes.set_xlim(plan.times[0], plan.times[-1])
    _legend(axes, loc="upper left")
    return figure


def pareto(series: Mapping[str, tuple[ArrayLike, ArrayLike]], cost: str = "arrival time [s]") -> Figure:
    """Risk against cost, one front per name; what another point beats in both is shown faintly.

    Args:
        series: name: (costs (N,), risks (N,)).
        cost: label of the axis.
    """
    figure, axes = blank(cost, "total risk")
    for i, (name, (costs, risks)) in enumerate(series.items()):
        c, r = _pair(name, costs, risks)
        order = np.lexsort([r, c])
        best = order[r[order] <= np.minimum.accumulate(r[order])]
        axes.plot(c, r, "o", ms=4, color=_colour(i), alpha=0.3, mec="none")
        axes.step(c[best], r[best], "-o", where="post", ms=5, lw=1.6, color=_colour(i), mec="white", label=name)
    axes.set_yscale("log")
    _legend(axes)
    return figure


def reliability(
    stated: Mapping[str, tuple[ArrayLike, ArrayLike]], *, bins: int = 10, confidence: float = 0.95
) -> Figure:
    """How often collisions happened against how likely they were said to be, with Clopper–Pearson bars.

    Args:
        stated: name: (stated risks (N,), whether it happened (N,)).
        bins: of equally many cases.
        confidence: of the bars.
    """
    figure, axes = blank("stated risk", "share that happened")
    lowest = 1.0
    for i, (name, (risks, happened)) in enumerate(stated.items()):
        r, h = _pair(name, risks, happened)
        groups = [g for g in np.array_split(np.argsort(r, kind="stable"), min(bins, len(r))) if len(g)]
        said = np.array([r[g].mean() for g in groups])
        count, hits = np.array([len(g) for g in groups]), np.array([h[g].sum() for g in groups])
        low, high = np.array([clopper_pearson(k, int(n), confidence) for k, n in zip(hits, count, strict=True)]).T
        share = hits / count
        lowest = min(lowest, float(said[said > 0].min(initial=1.0)), float(share[share > 0].min(initial=1.0)))
        bars = np.maximum([share - low, high - share], 0.0)
        axes.errorbar(said, share, bars, fmt="o-", ms=4, lw=1.2, elinewidth=1.0, color=_colour(i), label=name)
    lowest = max(0.3 * lowest, 1e-9)
    axes.plot([lowest, 1], [lowest, 1], color=palette.FAINT_INK, lw=1, ls=(0, (4, 3)), label="as stated")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(lowest, 1.0)
    axes.set_ylim(lowest, 1.3)
    _legend(axes, loc="upper left")
    return figure


def tightness(true: ArrayLike, bounds: Mapping[str, ArrayLike]) -> Figure:
    """Share of cases in which each bound is within a factor of the truth.

    Args:
        true: (N,) exact risks > 0.
        bounds: name: (N,).
    """
    figure, axes = blank("bound / true risk", "share of cases within")
    for i, (name, values) in enumerate(bounds.items()):
        exact, bound = _pair(name, true, values)
        ratio = np.sort(bound / exact)
        axes.step(ratio, np.arange(1, len(ratio) + 1) / len(ratio), where="post", lw=1.8, color=_colour(i), label=name)
    axes.set_xscale("log")
    axes.set_xlim(left=1.0)
    axes.set_ylim(0.0, 1.0)
    _legend(axes, loc="lower right")
    return figure


def risk_map(found: RiskMap, scenario: Scenario | None = None, plan: Plan | None = None) -> Figure:
    """A risk map from above: contours at 1e-6, 1e-5, … 0.5, with the road, the bodies and the plan if given."""
    span_x, span_y = np.ptp(found.x), np.ptp(found.y)
    wide = span_y < 0.45 * span_x
    size = (9.0, 8.4 * span_y / span_x + 1.2) if wide else (7.6 * min(1.0, span_x / span_y) + 1.2, 7.0)
    figure, axes = blank("x [m]", "y [m]", size)
    axes.grid(visible=False)
    axes.set_facecolor(palette.GROUND)
    if scenario is not None:
        _backdrop(axes, scenario, found.time)
    risk = np.maximum(found.risk, 1e-300)
    style: dict[str, Any] = {"levels": [*_LEVELS, 1.0], "cmap": _HEAT, "norm": LogNorm(1e-6, 1.0)}
    filled = axes.contourf(found.x, found.y, risk, alpha=0.78, zorder=3, **style)
    axes.contour(found.x, found.y, risk, levels=_LEVELS, colors="#1b2430", linewidths=0.6, alpha=0.7, zorder=4)
    if plan is not None and len(plan.poses):
        axes.plot(plan.poses[:, 0], plan.poses[:, 1], color="white", lw=3.4, zorder=7, solid_capstyle="round")
        axes.plot(plan.poses[:, 0], plan.poses[:, 1], color=palette.EGO, lw=2.0, zorder=8, solid_capstyle="round")
        at = [np.interp(found.time, plan.times, plan.poses[:, i]) for i in (0, 1)]
        axes.plot(*at, "o", ms=8, color=palette.EGO, mec="white", mew=1.5, zorder=9)
    axes.set_aspect("equal")
    axes.set_xlim(found.x[0], found.x[-1])
    axes.set_ylim(found.y[0], found.y[-1])
    where: dict[str, Any] = {"orientation": "horizontal", "aspect": 60} if wide else {"aspect": 30}
    bar = figure.colorbar(filled, ax=axes, ticks=_LEVELS, pad=0.03, **where)
    bar.set_ticklabels([f"{level:g}" for level in _LEVELS], fontsize=8)
    axes.set_title(_map_title(found), loc="left", fontsize=10, color=palette.INK)
    return figure


def risk_surface(found: RiskMap) -> Figure:
    """A risk map as a surface in 3-D: height is the risk, colour its logarithm."""
    figure = Figure(figsize=(9.0, 5.0), dpi=150)
    FigureCanvasAgg(figure)
    axes: Any = figure.add_axes((0.0, 0.03, 1.0, 0.97), projection="3d")
    x, y = np.meshgrid(found.x, found.y)
    colours = _HEAT(LogNorm(1e-6, 1.0)(np.clip(found.risk, 1e-6, 1.0)))
    colours[found.risk < 1e-6] = (*palette.rgb(palette.ASPHALT), 1.0)
    axes.plot_surface(x, y, found.risk, facecolors=colours, rstride=1, cstride=1, lw=0, antialiased=False, shade=True)
    share = np.ptp(found.y) / np.ptp(found.x)
    axes.set_box_aspect((1.0, float(np.clip(share, 0.35, 1.0)), 0.35), zoom=1.22)
    axes.view_init(elev=38, azim=-62)
    for axis, label in ((axes.xaxis, "x [m]"), (axes.yaxis, "y [m]"), (axes.zaxis, "risk")):
        axis.set_label_text(label, fontsize=9)
        axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
        axis.set_tick_params(labelsize=8)
    axes.set_zlim(0.0, 1.0)
    figure.text(0.02, 0.95, _map_title(found), fontsize=10, color=palette.INK)
    return figure


def _map_title(found: RiskMap) -> str:
    return f"risk of being here at t = {found.time:g} s ({found.checker}, {found.kind})"


def _backdrop(axes: Axes, scenario: Scenario, time: float) -> None:
    """Road, lines, obstacles, and the agents' bodies where they most likely are."""
    pic = picture(scenario)
    origin = np.array([scenario.start.x, scenario.start.y])

    def areas(polygons: Iterable[Array], **style: Any) -> None:
        axes.add_collection(PolyCollection([p / pic.zoom + origin for p in polygons], **style), autolim=False)

    areas(pic.road, facecolors="#c9d0d8", zorder=1)
    lines = [*pic.edges, *(dash for line in pic.dividers for dash in geometry.dashes(line))]
    axes.add_collection(
        LineCollection([p / pic.zoom + origin for p in lines], colors="white", linewidths=1.2, zorder=2)
    )
    areas(pic.obstacles, facecolors=palette.OBSTACLE, zorder=5)
    step = int(np.abs(pic.times - time).argmin())
    bodies = [geometry.place(geometry.rectangle(a.length, a.width), a.track[step]) for a in pic.agents]
    areas(bodies, facecolors="none", edgecolors=palette.INK, linewidths=1.2, zorder=6)


def blank(x: str, y: str, size: tuple[float, float] = (6.4, 3.6)) -> tuple[Figure, Axes]:
    """An empty figure in this module's style, and its axes; `x`, `y` are their labels."""
    figure = Figure(figsize=size, dpi=150, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.set_xlabel(x, color=palette.INK)
    axes.set_ylabel(y, color=palette.INK)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.grid(visible=True, color="#e3e7eb", lw=0.8)
    axes.set_axisbelow(True)
    axes.tick_params(colors=palette.FAINT_INK, labelsize=9)
    return figure, axes


def _legend(axes: Axes, **style: Any) -> None:
    axes.legend(frameon=True, framealpha=0.9, edgecolor="none", fontsize=8.5, **style)


def _colour(i: int) -> str:
    return COLOURS[i % len(COLOURS)]


def _known(agent: Agent) -> bool:
    return agent.order is None


def _pair(name: str, one: ArrayLike, other: ArrayLike) -> tuple[Array, Array]:
    a, b = np.asarray(one, dtype=np.float64), np.asarray(other, dtype=np.float64)
    if a.ndim != 1 or a.shape != b.shape or not len(a):
        raise InputError(f"{name}: expected two arrays (N,) of one length, got {a.shape} and {b.shape}")
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise InputError(f"{name}: expected finite numbers")
    return a, b
