"""Colours, colour ramps and legend limits that the 3-D page and the top view share."""

from __future__ import annotations

from typing import Any

import numpy as np

from checkers.validate import Array

Ramp = tuple[str, ...]

RISK: Ramp = ("#1fa055", "#9bd13c", "#ffd23d", "#ff8f1f", "#dc2a36")
WEIGHT: Ramp = ("#7a5ce0", "#c04bc0", "#ff6f9c", "#ffb36b", "#ffe680")
TIME: Ramp = ("#5bbcec", "#3a6bd6")

GROUND = "#e7ebee"
ASPHALT = "#3c434d"
LINE = "#f4f6f7"
CASING = "#14181d"
GLASS = "#26303b"
TYRE = "#15181c"
CARGO = "#e8e6e2"
SKIN = "#e3b48f"
INK = "#1b2430"
FAINT_INK = "#5d6875"
OBSTACLE = "#9aa3ad"
GOAL = "#37c8b0"
EGO = "#3d8bfd"
AGENTS = ("#7b4fcf", "#e07b1f", "#1c9c86", "#c9487e", "#a58a1f", "#5f7486")


def rgb(colour: str) -> Array:
    """(3,) in [0, 1] of a "#rrggbb"."""
    return np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0


def ramp(stops: Ramp, fraction: Any) -> Array:
    """(…, 3) colours at `fraction` (…) of a ramp with evenly spaced stops; clipped to [0, 1]."""
    table = np.array([rgb(stop) for stop in stops])
    place = np.linspace(0.0, 1.0, len(stops))
    return np.stack([np.interp(fraction, place, table[:, i]) for i in range(3)], axis=-1)


def fill_alpha(weight: Any, modes: int) -> Array:
    """Opacity of the ellipses of a mode of an agent: likely modes are denser, unlikely ones stay visible."""
    return np.asarray(0.06 * min(1.0, 4.0 / modes) + 0.12 * np.asarray(weight, dtype=float))


def tree_alpha(edges: int) -> float:
    """Opacity of the edges of the search: the more there are, the fainter each."""
    return float(np.clip(16.0 / np.sqrt(max(edges, 1)), 0.1, 0.6))


def futures_alpha(lines: int) -> float:
    """Opacity of sampled futures: a single one is clear, a thousand still let each other through."""
    return float(np.clip(3.0 / np.sqrt(max(lines, 1)), 0.1, 0.8))


NOTHING = 1e-12  # a probability below it has no meaning


def round_up(value: float) -> float:
    """The smallest d · 10ⁿ (d = 1 … 9) that is ≥ value > 0: the end of a legend's scale."""
    exponent = int(np.floor(np.log10(value)))
    digit = int(np.ceil(value / 10.0**exponent - 1e-9))
    return float(f"{digit}e{exponent}")


def number(value: float) -> str:
    """A probability for people: two digits, plain down to 0.0001; what is below any meaning is said to be."""
    if value < NOTHING:
        return "< 1e-12"
    return f"{value:.2g}" if value >= 1e-4 else f"{value:.1e}"


def claimed(claim: str, value: float) -> str:
    """A number with what it claims, "≤ " say, in front; "< 1e-12" needs none."""
    text = number(value)
    return text if text.startswith("<") else claim + text
