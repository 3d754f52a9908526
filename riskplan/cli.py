"""The command `riskplan`.

Exit status: 0 solved, 1 no plan within the bound, 2 bad input (one line on stderr), 70 a bug, 130 interrupted.
Files appear complete or not at all, and only after everything that could fail. Nothing heavy is imported here, so that
Ctrl-C is answered from the first moment on.
"""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Sequence

from riskplan import interrupt

BAD_INPUT, BROKEN, INTERRUPTED = 2, 70, 130


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command line and return the exit status."""
    try:
        with interrupt.listening():
            return _guarded(argv)
    except (KeyboardInterrupt, Exception) as error:
        # an interrupted import surfaces as ImportError
        if not isinstance(error, KeyboardInterrupt) and not interrupt.requested():
            raise
        _complain("interrupted", INTERRUPTED)
        if argv is None:  # as a program
            # about one in a hundred interrupts hits OMPL's bindings half imported or half unwound, and their teardown
            # at interpreter exit then crashes; every file is closed by now
            sys.stderr.flush()
            os._exit(INTERRUPTED)
        return INTERRUPTED


def _guarded(argv: Sequence[str] | None) -> int:
    from checkers import InputError  # noqa: PLC0415
    from riskplan.commands import run  # noqa: PLC0415

    try:
        if isinstance(sys.stdout, io.TextIOWrapper):
            sys.stdout.reconfigure(errors="replace")  # a terminal without µ or é still gets its report
        status = run(argv)
        sys.stdout.flush()
        return status
    except InputError as error:
        interrupt.check()
        return _complain(f"error: {error}", BAD_INPUT)
    except BrokenPipeError:
        # whoever read stdout has gone; nothing is left to be flushed into it at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN
    except Exception:
        interrupt.check()  # an interrupted import or callback may surface as anything
        # a bug must not look like "no plan within the bound", which is what status 1 means
        import traceback  # noqa: PLC0415

        traceback.print_exc()
        return BROKEN


def _complain(message: str, status: int) -> int:
    print(f"riskplan: {' '.join(message.split())}", file=sys.stderr)
    return status
