"""Pictures of a scenario and a plan: a 3-D page, a still top view, an animated top view."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from checkers import InputError
from riskplan.pictures.picture import Picture, picture
from riskplan.result import Plan
from riskplan.scene import Scenario

__all__ = ["FORMATS", "render"]

FORMATS = (".html", ".png", ".gif")


def render(
    scenario: Scenario,
    plan: Plan | None,
    path: str | os.PathLike[str],
    *,
    title: str | None = None,
    size: tuple[int, int] | None = None,
) -> Path:
    """Draw a scenario and its plan into a file; the suffix picks the format.

    `.html` is a 3-D page that needs neither a server nor a network, `.png` a top view, `.gif` one that moves.
    The same input gives the same bytes.

    Args:
        scenario: what was planned for.
        plan: what came out; None or one without a trajectory shows the scenario and the search.
        path: file to write; it appears complete or not at all.
        title: heading; None: the scenario's name.
        size: width, height [pixel] of `.png` and `.gif`; None: as the scene wants it.

    Returns:
        The path written.

    Raises:
        InputError: on an unknown suffix, a directory that cannot be made, or a size below 200 by 150.
    """
    target = Path(path)
    suffix = target.suffix.lower()
    if suffix not in FORMATS:
        valid = ", ".join(FORMATS)
        raise InputError(f"{target}: expected a suffix out of {valid}; got {suffix or 'none'!r}")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{target}: cannot make the directory: {error.strerror}") from None
    if size is not None and not (size[0] >= 200 and size[1] >= 150):
        raise InputError(f"size: expected at least (200, 150) pixels, got {size}")
    drawers: dict[str, Callable[[Picture], bytes]] = {
        ".html": _html,
        ".png": lambda pic: _top(pic, size, moving=False),
        ".gif": lambda pic: _top(pic, size, moving=True),
    }
    _write(target, drawers[suffix](picture(scenario, plan, title)))
    return target


def _html(pic: Picture) -> bytes:
    # meshcat and matplotlib take half a second each to import: only when they are needed
    from riskplan.pictures import page, scene3d

    return page.page(pic, scene3d.viewer_script(), scene3d.messages(pic)).encode()


def _top(pic: Picture, size: tuple[int, int] | None, *, moving: bool) -> bytes:
    from riskplan.pictures import top

    return top.gif(pic, size) if moving else top.png(pic, size)


def _write(path: Path, content: bytes) -> None:
    """All or nothing: an interrupt leaves what was there before."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        part.write_bytes(content)
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)
