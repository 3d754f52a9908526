"""Pictures of a scenario and a plan: 3-D pages, stills and films, top views, plots."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from checkers import InputError
from checkers.validate import as_count, as_flag, as_option, as_path, as_scalar, as_text, as_tuple
from checkers.writing import written
from riskplan.pictures.agent_view import Detail
from riskplan.pictures.picture import Picture, picture
from riskplan.result import Plan
from riskplan.scene import Scenario

__all__ = ["FORMATS", "VIEWS", "draw", "render"]

FORMATS = (".html", ".png", ".gif", ".mp4")
VIEWS = ("auto", "3d", "top")


def render(
    scenario: Scenario,
    plan: Plan | None,
    path: str | os.PathLike[str],
    *,
    view: str = "auto",
    title: str | None = None,
    size: tuple[int, int] | None = None,
    time: float = 0.0,
    follow: bool = True,
    samples: int = 0,
    density: int = 0,
    seed: int = 0,
) -> Path:
    """Draw a scenario and its plan into a file; the suffix picks the format.

    `.html` is a 3-D page to turn, play and take apart; it needs neither a server, nor a network, nor a browser to be
    written. `.png` is a still, `.gif` and `.mp4` move. In 3-D these three are drawn by a headless Chromium (found
    through RISKPLAN_CHROMIUM, or as chromium-headless-shell, chromium or google-chrome); the top view needs none.
    `.mp4` needs the extra `video`. The same input gives the same bytes.

    Args:
        scenario: what was planned for.
        plan: what came out; None or one without a trajectory shows the scenario and the search.
        path: file to write; it appears complete or not at all.
        view: "3d", "top", or "auto": 3-D if there is a Chromium, else the top view, with a warning.
        title: heading; None: the scenario's name.
        size: width, height [pixel] of all but `.html`, even for `.mp4`; None: as the scene wants it.
        time: what a still shows [s]; the nearest step.
        follow: whether the camera of a 3-D film goes with the ego.
        samples: futures of each agent drawn as lines. Agents known by their moments only have none; errors of a
            Gaussian that does not say how they depend over time are drawn as persisting.
        density: positions drawn as dots, per agent and step, from each step's own distribution.
        seed: of both.

    Returns:
        The path written.

    Raises:
        InputError: on an unknown suffix or view, a directory that cannot be made, a size below 200 by 150, a
            negative count, or if what the picture needs is not there.
    """
    target = as_path("path", path)
    suffix = target.suffix.lower()
    if suffix not in FORMATS:
        valid = ", ".join(FORMATS)
        raise InputError(f"{target}: expected a suffix out of {valid}; got {suffix or 'none'!r}")
    detail = _detail(samples, density, seed)
    time = as_scalar("time", time)
    as_flag("follow", follow)
    if title is not None:
        as_text("title", title)
    size = _checked_size(size, suffix)
    solid = _solid(view, suffix)
    if suffix == ".mp4":
        from riskplan.pictures.encode import need_video

        need_video()
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{target}: cannot make the directory: {error.strerror}") from None
    pic = picture(scenario, plan, title, detail)
    step = int(np.abs(pic.times - time).argmin())
    drawers: dict[str, Callable[[], bytes]] = {
        ".html": lambda: _html(pic),
        ".png": lambda: _still(pic, size, step, solid),
        ".gif": lambda: _film(pic, size, follow, solid, "gif"),
        ".mp4": lambda: _film(pic, size, follow, solid, "mp4"),
    }
    _write(target, drawers[suffix]())
    return target


def draw(
    vis: Any,
    scenario: Scenario,
    plan: Plan | None = None,
    *,
    samples: int = 0,
    density: int = 0,
    seed: int = 0,
) -> None:
    """Draw into a `meshcat.Visualizer` of your own, below its `/riskplan`, in place of what was drawn there before.

    Nothing is started and no port is opened: that is up to whoever made the visualiser.

    Args:
        vis: a `meshcat.Visualizer`.
        scenario, plan, samples, density, seed: as in `render`.
    """
    from riskplan.pictures import scene3d

    if not all(hasattr(vis, name) for name in ("__getitem__", "delete", "set_object")):
        raise InputError(f"vis: expected a meshcat Visualizer, got {type(vis).__name__}")
    pic = picture(scenario, plan, None, _detail(samples, density, seed))
    vis["/riskplan"].delete()
    scene3d.draw(vis, pic)


def _detail(samples: int, density: int, seed: int) -> Detail:
    counts = (("samples", samples, 100_000), ("density", density, 100_000), ("seed", seed, 2**31 - 1))
    return Detail(*(as_count(name, count, 0, most) for name, count, most in counts))


def _solid(view: str, suffix: str) -> bool:
    """Whether to draw in 3-D."""
    as_option("view", view, VIEWS)
    if suffix == ".html":
        if view == "top":
            raise InputError("view: .html is drawn in 3-D only; for a top view ask for .png, .gif or .mp4")
        return True
    from riskplan.doctor import BROWSER_VARIABLE, find_browser
    from riskplan.pictures import browser

    if view == "auto" and find_browser() is None:
        warnings.warn(
            "no Chromium found: drawing the top view instead of 3-D (view='top' asks for it; "
            f"{BROWSER_VARIABLE} names a browser)",
            stacklevel=3,
        )
        return False
    if view != "top":
        browser.need()
    return view != "top"


def _checked_size(size: tuple[int, int] | None, suffix: str) -> tuple[int, int] | None:
    if size is None:
        return None
    given = as_tuple("size", size, int, np.integer)
    if len(given) != 2 or not (given[0] >= 200 and given[1] >= 150):
        raise InputError(f"size: expected at least (200, 150) pixels, got {given}")
    if max(given) > 10_000:
        raise InputError(f"size: expected at most 10000 pixels a side, got {given}")
    if suffix == ".mp4" and (given[0] % 2 or given[1] % 2):
        raise InputError(f"size: expected even numbers for .mp4, got {given}")
    return int(given[0]), int(given[1])


# meshcat and matplotlib take half a second each to import: only when they are needed


def _html(pic: Picture) -> bytes:
    from riskplan.pictures import page, scene3d

    return page.page(pic, scene3d.viewer_script(), scene3d.messages(pic)).encode()


def _still(pic: Picture, size: tuple[int, int] | None, step: int, solid: bool) -> bytes:
    from riskplan.pictures import encode

    if solid:
        from riskplan.pictures import film

        return encode.png(film.still(pic, size, step))
    from riskplan.pictures import top

    return encode.png(top.still(pic, size, step))


def _film(pic: Picture, size: tuple[int, int] | None, follow: bool, solid: bool, kind: str) -> bytes:
    from riskplan.pictures import encode

    if solid:
        from riskplan.pictures import film

        frames, times = film.moving(pic, size, following=follow)
    else:
        from riskplan.pictures import top

        frames, times = top.moving(pic, size)
    return encode.gif(frames, times) if kind == "gif" else encode.mp4(frames, times)


def _write(path: Path, content: bytes) -> None:
    """All or nothing: an interrupt leaves what was there before."""
    with written(path) as part:
        part.write_bytes(content)
