"""One input, with a limit of time and memory. Nothing fuzzed is imported here: atheris instruments it on import."""

from __future__ import annotations

import contextlib
import faulthandler
import resource
import signal
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

_SLOW = "took more than"


class TooSlow(BaseException):
    """An input took longer than it may."""


@contextlib.contextmanager
def limits(megabytes: int) -> Iterator[None]:
    """Memory beyond what is there now is refused by the system: MemoryError, which is a finding."""
    before = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + (megabytes << 20), before[1]))
    old = [(number, signal.signal(number, _late)) for number in (signal.SIGALRM, signal.SIGPROF)]
    try:
        yield
    finally:
        for number, handler in old:
            signal.signal(number, handler)
        resource.setrlimit(resource.RLIMIT_AS, before)


def _late(number: int, frame: Any) -> None:
    raise TooSlow


def tried(target: Callable[[Any], bool], data: Any, seconds: float) -> tuple[bool | None, str, float]:
    """(accepted, finding or "", seconds). What counts is the processor's time, and much more of the clock's.

    What is too slow is tried twice more, with leisure and again in time: it may have been the first to call a kernel,
    which is compiled then.
    """
    outcome = _once(target, data, seconds)
    if outcome[1].startswith(_SLOW):
        _once(target, data, 12 * seconds)
        outcome = _once(target, data, seconds)
    return outcome


def _once(target: Callable[[Any], bool], data: Any, seconds: float) -> tuple[bool | None, str, float]:
    began = process_time()
    signal.setitimer(signal.ITIMER_PROF, seconds)
    signal.setitimer(signal.ITIMER_REAL, 12 * seconds)
    faulthandler.dump_traceback_later(
        60 + 24 * seconds, exit=True, file=sys.__stderr__
    )  # if it hangs where no signal is heard
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            return target(data), "", process_time() - began
    except TooSlow:
        return None, f"{_SLOW} {seconds:g} s at {_where(3)}", process_time() - began
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # whatever it is, it is a finding
        return (
            None,
            f"{type(error).__name__}: {' '.join(str(error).split())[:160]} at {_where(2)}",
            process_time() - began,
        )
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.setitimer(signal.ITIMER_REAL, 0)
        faulthandler.cancel_dump_traceback_later()


def _where(depth: int) -> str:
    frames = traceback.extract_tb(sys.exc_info()[2])[-depth:]
    return " < ".join(f"{Path(f.filename).name}:{f.lineno}" for f in reversed(frames))
