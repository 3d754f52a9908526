"""What a 3-D still or film says in letters: a card with the legend, and the readout of time and risk."""

from __future__ import annotations

import re
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from checkers.validate import Array
from riskplan.pictures import palette
from riskplan.pictures.camera import Camera, look, project
from riskplan.pictures.picture import Picture, legend

_FINE = 2  # the card is drawn finer and reduced: Pillow's shapes have no smooth edges


def card(pic: Picture, size: tuple[int, int], camera: Camera) -> Image.Image:
    """A transparent layer of `size` with the legend in that corner where it hides least."""
    scale = _FINE * max(0.62, size[1] / 800)
    width = round(410 * scale)
    bars = legend(pic)
    lines = _wrapped(pic.title, 21 * scale, width - 44 * scale)
    facts = _facts(pic)
    notes = [line for note in pic.notes for line in _wrapped(note, 14 * scale, width - 44 * scale)]
    height = round((30 + 27 * len(lines) + 22 * len(facts) + 46 * len(bars) + 21 * len(notes)) * scale)
    box = Image.new("RGBA", (width, height), (0, 0, 0, 0))
    draw = ImageDraw.Draw(box)
    draw.rounded_rectangle((0, 0, width - 1, height - 1), 10 * scale, fill=(255, 255, 255, 240), outline=(0, 0, 0, 26))
    y = 30 * scale
    for line in lines:
        write(draw, (22 * scale, y), line, 21 * scale, palette.INK)
        y += 27 * scale
    for fact in facts:
        write(draw, (22 * scale, y - 3 * scale), fact, 15 * scale, palette.FAINT_INK)
        y += 22 * scale
    for label, ramp, low, high in bars:
        write(draw, (22 * scale, y + 10 * scale), label, 16 * scale, palette.INK)
        left, right = round(180 * scale), round(388 * scale)
        colours = (palette.ramp(ramp, np.linspace(0, 1, right - left)) * 255).round().astype(np.uint8)
        box.paste(Image.fromarray(np.tile(colours, (round(11 * scale), 1, 1))), (left, round(y - 1 * scale)))
        write(draw, (left, y + 25 * scale), low, 14 * scale, palette.FAINT_INK)
        write(draw, (right, y + 25 * scale), high, 14 * scale, palette.FAINT_INK, right=True)
        y += 46 * scale
    for note in notes:
        write(draw, (22 * scale, y + 5 * scale), note, 14 * scale, palette.FAINT_INK)
        y += 20 * scale
    box = box.resize((width // _FINE, height // _FINE), Image.Resampling.LANCZOS)
    layer = Image.new("RGBA", size, (0, 0, 0, 0))
    layer.paste(box, _corner(pic, size, box.size, camera)[0])
    return layer


def view(pic: Picture, size: tuple[int, int]) -> Camera:
    """The camera for a picture with a card: where it would hide something anywhere, room is left for it."""
    aspect, scale = size[0] / size[1], max(0.62, size[1] / 800)
    camera = look(pic, aspect)
    box = round(410 * scale), round((56 + 46 * len(legend(pic)) + 40 * len(pic.notes) + 44) * scale)
    if _corner(pic, size, box, camera)[1] == 0 or box[0] > 0.4 * size[0]:
        return camera
    return look(pic, aspect, (box[0] + 0.04 * size[1]) / size[0])


def readout(image: Image.Image, pic: Picture, step: int) -> None:
    """Time and risk so far, bottom right, onto an RGB image."""
    scale = max(0.62, image.height / 800)
    text = f"t = {pic.times[step]:.1f} s"
    if pic.so_far is not None:
        text += f"    risk so far {palette.claimed(pic.claim, float(pic.so_far[step]))}"
    size, margin = 24 * scale, 26 * scale
    draw = ImageDraw.Draw(image, "RGBA")
    right, base = image.width - margin, image.height - margin
    left = right - sum(_font(run, size).getlength(run) for run in _runs(text))
    pad = 10 * scale
    area = (left - pad, base - size, right + pad, base + 0.5 * size)
    draw.rounded_rectangle(area, 6 * scale, fill=(*(round(255 * c) for c in palette.rgb(palette.GROUND)), 215))
    write(draw, (right, base), text, size, palette.INK, right=True)


def write(
    draw: ImageDraw.ImageDraw, at: tuple[float, float], text: str, size: float, colour: str, *, right: bool = False
) -> None:
    """A line of text with its base line at `at`; `right`: ending there."""
    x, y = at
    runs = [(run, _font(run, size)) for run in _runs(text)]
    if right:
        x -= sum(font.getlength(run) for run, font in runs)
    for run, font in runs:
        draw.text((x, y), run, fill=colour, font=font, anchor="ls")
        x += font.getlength(run)


def _facts(pic: Picture) -> list[str]:
    known = dict(pic.facts)
    lines = []
    if "total risk" in known:
        bound = f", bound {known['risk bound']}" if "risk bound" in known else ""
        lines.append(f"total risk {known['total risk']}{bound}")
    elif "status" in known:
        lines.append(known["status"] + (f" within {known['risk bound']}" if "risk bound" in known else ""))
    made = [known[key] for key in ("planner", "checker") if key in known]
    return [*lines, " with ".join(made)] if made else lines


def _wrapped(text: str, size: float, width: float) -> list[str]:
    """At most two lines; what does not fit is cut."""
    lines = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".strip()
        if not lines[-1] or _length(longer, size) <= width:
            lines[-1] = longer
        else:
            lines.append(word)
    kept = lines[:2]
    if len(lines) > 2:
        kept[1] += " …"
    for i, line in enumerate(kept):
        while _length(kept[i], size) > width and len(kept[i]) > 2:
            line = line[:-1]
            kept[i] = f"{line}…"
    return [line for line in kept if line]


def _length(text: str, size: float) -> float:
    return sum(_font(run, size).getlength(run) for run in _runs(text))


def _corner(pic: Picture, size: tuple[int, int], box: tuple[int, int], camera: Camera) -> tuple[tuple[int, int], int]:
    """Top left of the card, and how many of the points that matter it hides."""
    margin = round(0.03 * size[1])
    right, bottom = size[0] - box[0] - margin, size[1] - box[1] - margin
    spots = [
        pic.ego[:, :2],
        *(agent.track[:1, :2] for agent in pic.agents),
        *(goal.mean(axis=0, keepdims=True) for goal in pic.goals),
    ]
    seen = project(camera, np.concatenate(spots), size[0] / size[1]) * size
    corners = [(margin, margin), (right, margin), (margin, bottom)]
    hidden = [int(_within(seen, at, box).sum()) for at in corners]
    best = int(np.argmin(hidden))
    return corners[best], hidden[best]


def _within(points: Array, at: tuple[int, int], box: tuple[int, int]) -> Array:
    return np.asarray(((points >= at) & (points <= np.add(at, box))).all(axis=-1))


def _runs(text: str) -> list[str]:
    """Split where the font has to change: Pillow's own has Latin letters only."""
    return re.findall(r"[\x20-\x7e]+|[^\x20-\x7e]+", text)


@cache
def _font(run: str, size: float) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    if run.isascii():
        return ImageFont.load_default(size)
    return ImageFont.truetype(_dejavu(), size)


@cache
def _dejavu() -> str:
    """matplotlib brings DejaVu Sans along; looked up without importing matplotlib."""
    spec = find_spec("matplotlib")
    return str(Path(str(spec.origin)).parent / "mpl-data" / "fonts" / "ttf" / "DejaVuSans.ttf") if spec else ""
