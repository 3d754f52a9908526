"""How values show themselves in a notebook: a top view or a table, as HTML."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Iterable

import numpy as np

from riskplan.pictures.picture import Picture, picture
from riskplan.result import Plan, Report
from riskplan.scene import Goal, Scenario, State

_WIDTH = 900


def html_of(value: Scenario | Plan | Report) -> str:
    """The picture of a scenario or a solved plan, the table of a report."""
    if isinstance(value, Report):
        return _report(value)
    if isinstance(value, Scenario):
        return _image(picture(value))
    rows = [("status", value.status.replace("_", " ")), ("message", value.message)]
    facts = picture(_alone(value), value).facts if value.solved else ()
    table = _table(facts or rows)
    return f"<div>{_image(picture(_alone(value), value))}{table}</div>" if value.solved else table


def _alone(plan: Plan) -> Scenario:
    """As much of a world as a plan knows by itself: its own way, on open ground."""
    points = np.concatenate([plan.poses[:, :2], plan.search[:, :2], plan.search[:, 2:4]])
    (x0, y0), (x1, y1) = points.min(axis=0) - 5.0, points.max(axis=0) + 5.0
    x, y, heading = plan.poses[0].tolist()
    end = plan.poses[-1].tolist()
    step = float(plan.times[1] - plan.times[0]) if len(plan.times) > 1 else 0.1
    return Scenario(
        start=State(x, y, heading),
        goal=Goal.at(end[0], end[1], radius=0.5),
        bounds=(float(x0), float(y0), float(x1), float(y1)),
        time_step=step,
        horizon=max(float(plan.times[-1]), step),
        name="plan",
    )


def _image(pic: Picture) -> str:
    from riskplan.pictures import encode, top  # noqa: PLC0415  matplotlib costs import time

    data = base64.b64encode(encode.png(top.still(pic, top.natural(pic, _WIDTH)), small=True)).decode("ascii")
    return f'<img alt="{html.escape(pic.title)}" src="data:image/png;base64,{data}">'


def _table(rows: Iterable[tuple[str, str]]) -> str:
    cells = "".join(f"<tr><th>{html.escape(k)}</th><td>{html.escape(v)}</td></tr>" for k, v in rows)
    return f"<table>{cells}</table>"


def _report(report: Report) -> str:
    from rich.console import Console  # noqa: PLC0415

    from riskplan.report_table import risk_table  # noqa: PLC0415

    console = Console(record=True, file=io.StringIO(), width=160, highlight=False)
    console.print(risk_table(report, report.verdicts, report.sampled))
    return console.export_html(inline_styles=True, code_format="<pre>{code}</pre>")
