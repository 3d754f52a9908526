"""The top view in matplotlib: stills and animations. Figures of its own, no pyplot, so no shared state."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from matplotlib.text import Text

from checkers.validate import Array
from riskplan.pictures import geometry, palette
from riskplan.pictures.agent_view import AgentView
from riskplan.pictures.encode import Pixels, frame_steps
from riskplan.pictures.picture import SIGMAS, Picture, legend

_DPI = 100
_HEAD, _FOOT = 92, 34  # pixels above the view, for title and legend, and below it, for the readout and small print
_LOW = 260  # pictures lower than that spare the foot: what would stand there lies over the view


def still(pic: Picture, size: tuple[int, int] | None = None, step: int = 0) -> Pixels:
    """(H, W, 4) at `Picture.times[step]`. `size` in pixels (width, height); None: 1600 wide, as high as needed."""
    sheet = _sheet(pic, size or natural(pic, 1600))
    _still(sheet, pic)
    _Movers(sheet, pic).show(step)
    sheet.canvas.draw()
    return _pixels(sheet)


def moving(pic: Picture, size: tuple[int, int] | None = None) -> tuple[list[Pixels], Array]:
    """Frames (H, W, 4) and their times, in at most 60 steps. `size` None: 960 wide."""
    sheet = _sheet(pic, size or natural(pic, 960))
    _still(sheet, pic)
    sheet.canvas.draw()
    ground = sheet.canvas.copy_from_bbox(sheet.figure.bbox)
    movers = _Movers(sheet, pic)
    steps = frame_steps(pic.times)
    frames = []
    for step in steps.tolist():
        sheet.canvas.restore_region(ground)
        movers.show(step)
        movers.blit()
        frames.append(_pixels(sheet))
    return frames, pic.times[steps]


_OVER: dict[str, Any] = {"facecolor": palette.GROUND, "edgecolor": "none", "alpha": 0.85, "pad": 4.0}


class _Sheet(NamedTuple):
    """A figure, the axes of the view in it, in metres, and its canvas (untyped in matplotlib)."""

    figure: Figure
    axes: Axes
    canvas: Any


class _Movers:
    """What changes with time: the bodies, the ego's risk shape and the readout."""

    def __init__(self, sheet: _Sheet, pic: Picture) -> None:
        self._sheet, self._pic = sheet, pic
        self._patches: list[tuple[Polygon, Array, Array]] = []  # patch, outline in the body frame, track
        self._rings: list[tuple[Polygon, Array]] = []  # patch, outlines over time
        for agent in pic.agents:
            self._modes(agent, pic.limits[1])
        for agent in pic.agents:
            self._car(agent.track, agent.length, agent.width, agent.colour, disc=agent.length < 1.2)
        for ring in pic.ego_rings:
            fill = np.array([*palette.rgb(palette.EGO), 0.28])
            self._add(ring, pic.ego, facecolor=fill, edgecolor="#8fc0ff", linewidth=1.0, zorder=8)
        self._car(pic.ego, *pic.ego_size, palette.EGO, disc=pic.ego_round)
        size = 13 if sheet.figure.get_figwidth() >= 12 else 10
        self._readout: Text = sheet.figure.text(
            0.988,
            8 / (sheet.figure.get_figheight() * _DPI),
            "",
            ha="right",
            va="bottom",
            color=palette.INK,
            fontsize=size,
        )
        self._readout.set_bbox(_OVER)

    def show(self, step: int) -> None:
        """Move everything to `Picture.times[step]`."""
        for patch, outline, track in self._patches:
            patch.set_xy(geometry.place(outline, track[step]))
        for patch, rings in self._rings:
            patch.set_xy(rings[step])
        risk = self._pic.so_far
        text = "" if risk is None else f"    risk so far {palette.claimed(self._pic.claim, float(risk[step]))}"
        self._readout.set_text(f"t = {self._pic.times[step]:.1f} s{text}")

    def blit(self) -> None:
        """Draw the moving artists only, onto what is there."""
        for patch in [ring[0] for ring in self._rings] + [moved[0] for moved in self._patches]:
            self._sheet.axes.draw_artist(patch)
        self._sheet.figure.draw_artist(self._readout)

    def _modes(self, agent: AgentView, limit: float) -> None:
        """Where each mode is at the moment."""
        weights, means, covariances = agent.now
        rings = geometry.ellipses(means, covariances, SIGMAS)  # (T, K, n, 2)
        for mode in range(rings.shape[1]):
            tint = palette.ramp(palette.WEIGHT, weights[0, mode] / limit)
            patch = Polygon(rings[0, mode], closed=True, facecolor=(*tint, 0.30), edgecolor=tint, linewidth=1.6)
            patch.set_zorder(5.5)
            self._sheet.axes.add_patch(patch)
            self._rings.append((patch, rings[:, mode]))

    def _car(self, track: Array, length: float, width: float, colour: str, *, disc: bool = False) -> None:
        length, width = length * self._pic.grown, width * self._pic.grown
        if disc:  # people are round from above, too
            outline = geometry.disc(length, width)
            self._add(outline, track, facecolor=colour, edgecolor="#ffffff", linewidth=1.0, zorder=9)
            return
        body = geometry.rectangle(length, width)
        self._add(body, track, facecolor=colour, edgecolor="#ffffff", linewidth=1.2, zorder=9)
        cabin = geometry.rectangle(0.48 * length, 0.76 * width) - [0.06 * length, 0.0]
        self._add(cabin, track, facecolor=palette.GLASS, edgecolor="none", zorder=10)

    def _add(self, outline: Array, track: Array, **style: Any) -> None:
        patch = Polygon(geometry.place(outline, track[0]), closed=True, **style)
        self._sheet.axes.add_patch(patch)
        self._patches.append((patch, outline, track))


def natural(pic: Picture, width: int) -> tuple[int, int]:
    """The size [pixel] that a top view of this width wants."""
    x0, y0, x1, y1 = pic.window
    share = min(max((y1 - y0) / (x1 - x0), 0.13), 0.7)
    return width, _HEAD + _FOOT + round(width * share) // 2 * 2


def _pixels(sheet: _Sheet) -> Pixels:
    """(H, W, 4), a copy: the canvas goes on changing."""
    return np.array(sheet.canvas.buffer_rgba(), dtype=np.uint8)


def _sheet(pic: Picture, size: tuple[int, int]) -> _Sheet:
    """A figure of exactly `size` pixels with the legend on top and the view, equally scaled, below it."""
    width, height = size
    figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI, facecolor=palette.GROUND)
    canvas = FigureCanvasAgg(figure)
    foot = _FOOT if height >= _LOW else 0
    view = height - _HEAD - foot
    axes = figure.add_axes((0.0, foot / height, 1.0, view / height))
    axes.set_axis_off()
    x0, y0, x1, y1 = pic.window
    scale = max((x1 - x0) / width, (y1 - y0) / view)  # metres a pixel
    x, y = (x0 + x1) / 2, (y0 + y1) / 2
    axes.set_xlim(x - scale * width / 2, x + scale * width / 2)
    axes.set_ylim(y - scale * view / 2, y + scale * view / 2)
    _legend(figure, pic, width, height)
    return _Sheet(figure, axes, canvas)


def _legend(figure: Figure, pic: Picture, width: int, height: int) -> None:
    """Title, facts and colour scales in the strip above the view; places in pixels from the top left."""

    def text(x: float, y: float, label: str, size: float, colour: str, **style: Any) -> Text:
        style |= {"fontsize": size, "color": colour, "va": "center"}
        return figure.text(x / width, 1 - y / height, label, **style)

    margin = 0.014 * width
    small = 9.5 if width >= 1200 else 7.5 if width >= 720 else 5.8
    facts = [f"{key} {value}" for key, value in pic.facts]
    known = text(width - margin, 20, "     ".join(facts), 1.1 * small, palette.INK, ha="right")
    while len(facts) > 1 and known.get_window_extent().width > 0.62 * width:
        facts.pop()  # how it was planned before what came out
        known.set_text("     ".join(facts))
    title = text(margin, 20, pic.title, 1.3 * small, palette.INK, weight="bold")
    room, shown = width - 3 * margin - known.get_window_extent().width, pic.title
    while len(shown) > 1 and title.get_window_extent().width > room:
        shown = shown[:-1]
        title.set_text(f"{shown}…")
    column = (width - 2 * margin) / 3
    for i, (label, ramp, low, high) in enumerate(legend(pic)):
        left = margin + i * column
        text(left, 50, label, small, palette.INK)
        left, right = left + 0.4 * column, left + 0.92 * column
        bar = figure.add_axes((left / width, 1 - 56 / height, (right - left) / width, 12 / height))
        bar.set_axis_off()
        bar.imshow(palette.ramp(ramp, np.linspace(0, 1, 256))[None], aspect="auto", interpolation="bilinear")
        text(left, 70, low, small - 1, palette.FAINT_INK)
        text(right, 70, high, small - 1, palette.FAINT_INK, ha="right")
    note = text(margin, height - 16, "     ".join(pic.notes), small, palette.FAINT_INK)
    note.set_bbox(_OVER)
    while note.get_window_extent().width > 0.66 * width and small > 4:
        small -= 0.5
        note.set_fontsize(small)


def _still(sheet: _Sheet, pic: Picture) -> None:
    """Everything that does not move."""
    goal = palette.rgb(palette.GOAL)
    cuts = [dash for line in pic.dividers for dash in geometry.dashes(line)]
    tree = palette.ramp(palette.TIME, pic.tree[:, 4] / max(pic.limits[2], 1e-9))
    _areas(sheet, pic.road, 0, facecolors=palette.ASPHALT, edgecolors=palette.ASPHALT)
    _lines(sheet, pic.edges, 1, colors=palette.LINE, linewidths=1.6)
    _lines(sheet, cuts, 1, colors=palette.LINE, linewidths=1.4)
    _areas(sheet, pic.goals, 2, facecolors=[(*goal, 0.25)], edgecolors=[(*goal, 0.9)])
    faint = palette.tree_alpha(len(tree))
    _lines(sheet, pic.tree[:, :4].reshape(-1, 2, 2), 3, colors=tree, linewidths=0.6, alpha=faint)
    for agent in pic.agents:
        tint = 0.35 + 0.65 * palette.rgb(agent.colour)
        if len(agent.dots):
            _dots(sheet, agent.dots, tint)
        _lines(sheet, agent.futures, 3.6, colors=tint, linewidths=0.7, alpha=palette.futures_alpha(len(agent.futures)))
        _modes(sheet, agent, pic.limits[1])
    if len(pic.path) > 1:
        _ribbon(sheet, pic)
    _areas(sheet, pic.obstacles, 7, facecolors=palette.OBSTACLE, edgecolors="#6c7681")


def _modes(sheet: _Sheet, agent: AgentView, limit: float) -> None:
    rings = geometry.ellipses(agent.means, agent.covariances, SIGMAS)  # (S, K, n, 2)
    n = rings.shape[2]
    tint = palette.ramp(palette.WEIGHT, agent.weights / limit)
    fill = np.concatenate([tint, palette.fill_alpha(agent.weights, agent.weights.shape[1])[..., None]], axis=-1)
    _areas(sheet, rings.reshape(-1, n, 2), 4, facecolors=fill.reshape(-1, 4), edgecolors="none")
    rim, edge = rings[agent.rims].reshape(-1, n, 2), tint[agent.rims].reshape(-1, 3)
    _areas(sheet, rim, 5, facecolors="none", edgecolors=edge, linewidths=1.3, alpha=0.85)


def _dots(sheet: _Sheet, points: Array, tint: Array) -> None:
    """Many small dots as one image-like artist, cheaper than markers of their own."""
    style: dict[str, Any] = {"linestyle": "none", "marker": ",", "alpha": 0.35, "zorder": 3.5}
    sheet.axes.add_line(Line2D(points[:, 0], points[:, 1], color=tuple(tint), **style))


def _ribbon(sheet: _Sheet, pic: Picture) -> None:
    """The plan in pieces from half-way point to half-way point, in the colour of the step between them."""
    at = pic.path[:, :2]
    middle = (at[1:] + at[:-1]) / 2
    pieces = np.stack([np.concatenate([at[:1], middle]), at, np.concatenate([middle, at[-1:]])], axis=1)
    left, right = sheet.axes.get_xlim()
    width = max(0.7 * pic.stroke * sheet.figure.get_figwidth() * 72 / (right - left), 2.0)  # 0.7 m, in points
    _lines(sheet, at[None], 6, colors=palette.CASING, linewidths=1.35 * width, capstyle="round")
    colours = palette.ramp(palette.RISK, pic.path_risk / pic.limits[0])
    _lines(sheet, pieces, 6.1, colors=colours, linewidths=width, capstyle="round")


def _areas(sheet: _Sheet, polygons: Iterable[Array], zorder: float, **style: Any) -> None:
    sheet.axes.add_collection(PolyCollection(list(polygons), zorder=zorder, **style), autolim=False)


def _lines(sheet: _Sheet, lines: Iterable[Array], zorder: float, **style: Any) -> None:
    sheet.axes.add_collection(LineCollection(list(lines), zorder=zorder, **style), autolim=False)
