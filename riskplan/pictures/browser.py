"""One headless Chromium, run once on a page that draws its own frames and writes them into itself.

No driver, no port, no server: `--dump-dom` prints the page when it has loaded, frames included.
"""

from __future__ import annotations

import os
import signal
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

from checkers import InputError
from riskplan.doctor import BROWSER_VARIABLE, find_browser

FLAGS = (
    "--headless",
    "--use-angle=swiftshader",  # software: the same pixels everywhere, and no graphics card needed
    "--enable-unsafe-swiftshader",
    "--hide-scrollbars",
    "--mute-audio",
    "--no-first-run",
    "--disable-extensions",
    "--disable-sync",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-default-apps",
)


def need() -> str:
    """What `find_browser` finds.

    Raises:
        InputError: saying what to install.
    """
    found = find_browser()
    if found is not None:
        return found
    wanted = os.environ.get(BROWSER_VARIABLE)
    if wanted:
        raise InputError(f"{BROWSER_VARIABLE}: no program at {wanted!r}")
    raise InputError(
        "a 3-D picture needs Chromium: install chromium-headless-shell, chromium or google-chrome, or name one in "
        f"{BROWSER_VARIABLE}; view='top' and .html need none"
    )


def dump(page: str, *, timeout: float = 180.0, flags: Sequence[str] = ()) -> str:
    """The document, as HTML, that a page has become when it has loaded.

    Args:
        page: HTML.
        timeout: after which Chromium is ended [s].
        flags: further ones.

    Raises:
        InputError: without a browser, or if it fails or takes too long.
    """
    program = need()
    with tempfile.TemporaryDirectory(prefix="riskplan-", ignore_cleanup_errors=True) as folder:
        file = Path(folder) / "page.html"
        file.write_text(page, encoding="utf-8")
        command = [program, *FLAGS, *flags, f"--user-data-dir={folder}/profile", "--dump-dom", file.as_uri()]
        if hasattr(os, "geteuid") and os.geteuid() == 0:
            command.insert(1, "--no-sandbox")  # Chromium refuses to start as root otherwise
        with subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True
        ) as process:
            try:
                out, err = process.communicate(timeout=timeout)
            except subprocess.TimeoutExpired:
                raise InputError(f"{program}: no answer within {timeout:g} s") from None
            finally:
                _end(process)
    if process.returncode or not out:
        reason = err.decode(errors="replace").strip().splitlines()
        raise InputError(f"{program}: failed with status {process.returncode}: {reason[-1] if reason else 'no output'}")
    return out.decode("utf-8", errors="replace")


def _end(process: subprocess.Popen[bytes]) -> None:
    """Whatever of it still runs, helpers included: they are a process group of their own."""
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except (ProcessLookupError, PermissionError):
        pass
