"""Ctrl-C that cannot get lost.

Python raises KeyboardInterrupt wherever it happens to be. Inside a callback from compiled code (llvmlite's, while
kernels load) or a finaliser it is printed and forgotten; so it is written down too, for the search and for the steps of
a command to ask for.
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

_seen: list[int] = []


def requested() -> bool:
    """Whether Ctrl-C was pressed while `listening`."""
    return bool(_seen)


def check() -> None:
    """Raise KeyboardInterrupt if one was requested."""
    if _seen:
        raise KeyboardInterrupt


@contextmanager
def listening() -> Iterator[None]:
    """Write down every Ctrl-C; without effect where Ctrl-C is ignored, or outside the main thread."""
    _seen.clear()
    try:
        usual = signal.getsignal(signal.SIGINT) is signal.default_int_handler
        before = signal.signal(signal.SIGINT, _note) if usual else None
    except ValueError:  # not the main thread
        before = None
    hook, sys.unraisablehook = sys.unraisablehook, _forget
    try:
        yield
    finally:
        sys.unraisablehook = hook
        if before is not None:
            signal.signal(signal.SIGINT, before)


def _forget(lost: Any) -> None:
    """An interrupt lost in a callback has been written down: no need to tell."""
    if not (_seen and issubclass(lost.exc_type, KeyboardInterrupt)):
        sys.__unraisablehook__(lost)


def _note(number: int, frame: FrameType | None) -> None:
    _seen.append(number)
    raise KeyboardInterrupt
