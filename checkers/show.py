"""A prediction as a small HTML table, for notebooks."""

from __future__ import annotations

import html
from typing import Any

import numpy as np


def prediction_table(pred: Any) -> str:
    """Kind, span of time, and per mode its weight, and its mean and standard deviations at the end."""
    last_weights, means, covariances = pred.step_weights[-1], pred.means, pred.covariances
    name = html.escape(pred.name or "agent")
    order = "" if pred.order is None else f", moments to order {pred.order}"
    head = f"{name}: {type(pred).__name__}{order}, {len(pred.times)} steps, {pred.times[0]:g} to {pred.times[-1]:g} s"
    rows = []
    for k, weight in enumerate(last_weights):
        x, y = means[-1, k]
        sx, sy = np.sqrt(np.diag(covariances[-1, k]))
        cells = (str(k), f"{weight:.3g}", f"{x:.1f}, {y:.1f}", f"{sx:.2g}, {sy:.2g}")
        rows.append("<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>")
    labels = ("mode", "weight", "mean at the end [m]", "standard deviations [m]")
    titles = "".join(f"<th>{label}</th>" for label in labels)
    return f"<table><caption>{head}</caption><tr>{titles}</tr>{''.join(rows)}</table>"
