"""The terminal report of a plan: risks by every backend, Monte Carlo, times. Printed ends never understate."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from rich import box
from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from checkers import Kind
from riskplan.result import CheckerVerdict, Plan, Report, SampledRisk
from riskplan.rounding import by_kind, lower, risk_text, upper

_TIMES = 6  # columns of the budget's spending
_SIDE_BY_SIDE = 3  # backends in one table at 100 columns


def print_report(plan: Plan, report: Report | None, console: Console | None = None, title: str = "") -> None:
    """Print the outcome, and for a solved plan what its audit says."""
    (console or _console()).print(report_view(plan, report, title))


def _console() -> Console:
    """A terminal as wide as it is; a file or a pipe as wide as this report needs."""
    return Console(highlight=False, width=None if sys.stdout.isatty() else 100)


def report_view(plan: Plan, report: Report | None, title: str = "") -> RenderableType:
    """The same as something rich prints."""
    parts: list[RenderableType] = [_headline(plan, title)]
    if report is not None:
        groups = [report.verdicts[i : i + _SIDE_BY_SIDE] for i in range(0, len(report.verdicts), _SIDE_BY_SIDE)]
        for i, verdicts in enumerate(groups or [()]):
            sampled = report.sampled if i == 0 else None
            if verdicts or sampled:
                parts.append(risk_table(report, verdicts, sampled))
        if report.spending.size:
            parts.append(spending_table(report))
        parts += [Text(line) for line in _remarks(report)]
    parts.append(_times(plan, report))
    return Group(*parts)


def _headline(plan: Plan, title: str) -> Text:
    text = Text(f"{title}: " if title else "", style="bold")
    text.append(plan.status.replace("_", " "), style="bold green" if plan.solved else "bold red")
    return text.append(f". {plan.message}.", style="default not bold")


def risk_table(report: Report, verdicts: Sequence[CheckerVerdict], sampled: SampledRisk | None) -> Table:
    """Agents down, backends across; below them what holds for the whole trajectory."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
    table.add_column("collision risk", max_width=26, overflow="ellipsis", no_wrap=True)
    for v in verdicts:
        table.add_column(f"{v.checker}\n{v.kind}", justify="right")
    if sampled is not None:
        table.add_column(f"Monte Carlo, {sampled.samples}\n{sampled.confidence:.0%} interval", justify="right")
    for i, name in enumerate(report.agents):
        cells = [_cell(v, lambda r, i=i: r.per_agent[i]) for v in verdicts]
        table.add_row(Text(name), *cells, *_sampled(sampled, i), end_section=i == len(report.agents) - 1)
    for label, ends, pick in _TOTALS:
        cells = [_cell(v, pick, ends) for v in verdicts]
        table.add_row(label, *cells, *(_sampled(sampled, None) if label == "total" else ()))
    return table


def spending_table(report: Report) -> Table:
    """How the budget is spent along the way: a few times across, the risk so far, and who adds most to it."""
    steps = np.unique(np.linspace(0, len(report.spending) - 1, _TIMES).round().astype(int))
    so_far = report.spending[steps]
    added = np.diff(so_far, axis=0, prepend=0.0)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
    table.add_column("budget spent until")
    for step in steps:
        table.add_column(f"{report.times[step]:.1f} s", justify="right", max_width=12, overflow="ellipsis")
    totals = np.minimum(so_far.sum(axis=1), 1.0)
    table.add_row("risk so far", *(upper(float(total)) for total in totals))
    if report.bound:
        table.add_row("of the bound", *(f"{total / report.bound:.0%}" for total in totals))
    table.add_row("most added by", *(Text(report.agents[row.argmax()] if row.max() > 0 else "-") for row in added))
    return table


_TOTALS: tuple[tuple[str, Any, Any], ...] = (
    ("total", None, lambda r: r.total),
    ("largest step, all agents", None, lambda r: r.per_step.max()),
    ("Fréchet interval: from", lower, lambda r: r.frechet[0]),
    ("to (Boole)", upper, lambda r: r.frechet[1]),
)


def _cell(verdict: CheckerVerdict, pick: Any, ends: Any = None) -> str:
    if verdict.risk is None:
        return "-"
    value = float(pick(verdict.risk))
    return str(ends(value)) if ends else by_kind(value, verdict.kind)


def _sampled(sampled: SampledRisk | None, agent: int | None) -> tuple[str, ...]:
    if sampled is None:
        return ()
    if agent is None:
        share, (low, high) = sampled.total, sampled.interval
    else:
        share, (low, high) = float(sampled.per_agent[agent]), sampled.per_agent_interval[agent]
    if share != share:
        return ("not sampled",)
    some = "≥ " if agent is None and not sampled.complete else ""  # the others may add to it
    return (f"{some}{risk_text(share)}  [{lower(low)}, {upper(high)}]",)


def _remarks(report: Report) -> Iterable[str]:
    if report.bound is not None:
        yield f"bound {report.bound:g}: the planner's own total is {'within' if report.within_bound else 'ABOVE'} it"
    if any(v.kind != Kind.EXACT.value and v.risk is not None for v in report.verdicts):
        yield "the low end of a Fréchet interval holds for exact marginals only"
    for v in report.verdicts:
        if v.problem:
            yield f"{v.checker}: {v.problem}"
    if report.sampled is not None and not report.sampled.complete:
        yield "Monte Carlo: agents known by their moments only are left out of the total"
    if not report.consistent:
        yield "INCONSISTENT: the sampled risk lies above a total that claims to be exact or a bound"


def _times(plan: Plan, report: Report | None) -> Text:
    stats = plan.stats
    seconds = [(name, stats.get(name)) for name in ("preparation", "search", "judging")]
    if report is not None:
        sampling = 0.0 if report.sampled is None else report.sampled.seconds
        seconds += [("audit", sum(v.seconds for v in report.verdicts)), ("sampling", sampling)]
    parts = [f"{name} {value:.3f} s" for name, value in seconds if isinstance(value, float | int)]
    checks, search = stats.get("checked_steps"), stats.get("search")
    if isinstance(checks, int):
        parts.append(f"{checks} poses checked")
        if isinstance(search, float | int) and search > 0:
            parts.append(f"{checks / search:.0f}/s")
    return Text(", ".join(parts), style="dim")


def print_list(rows: dict[str, dict[str, str]], keys: Sequence[str], console: Console | None = None) -> None:
    """What there is to choose from, one row each."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
    for key in keys:
        table.add_column(key, overflow="fold", no_wrap=key in ("name", "kind"))
    for row in rows.values():
        table.add_row(*(Text(row[key]) for key in keys))
    (console or _console()).print(table)
