"""What of riskplan works here: packages, compiled kernels' cache, programs; and how to get what does not."""

from __future__ import annotations

import os
import platform
import shutil
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

REQUIRED = (
    "numpy",
    "scipy",
    "numba",
    "ompl",
    "clarabel",
    "meshcat",
    "shapely",
    "yaml",
    "jsonschema",
    "rich",
    "matplotlib",
)
# extra -> (modules, what for)
EXTRAS = {
    "predictor": (("torch",), "learned predictions"),
    "commonroad": (("commonroad",), "CommonRoad files"),
    "batch": (("joblib", "pyarrow"), "riskplan batch"),
    "cluster": (("joblib", "pyarrow", "distributed"), "riskplan batch --cluster"),
    "completion": (("shtab",), "completion in the shell"),
}
BROWSER_VARIABLE = "RISKPLAN_CHROMIUM"
BROWSERS = (
    "chromium-headless-shell",
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "chrome",
)


@dataclass(frozen=True)
class Check:
    """One thing looked at.

    Attributes:
        name: of it.
        ok: whether it is there and works.
        found: version, place or number.
        needed: whether riskplan cannot do without.
        advice: what to do if it is not ok.
    """

    name: str
    ok: bool
    found: str
    needed: bool
    advice: str = ""


def examine() -> list[Check]:
    """Everything, in the order to show it in."""
    return [*_packages(), *_extras(), *_machine(), *_programs()]


def versions() -> dict[str, str]:
    """Of Python and the packages numbers depend on; those not installed are left out."""
    names = ("riskplan", "numpy", "scipy", "numba", "ompl", "clarabel", "shapely", "torch", "commonroad-io")
    found = {name: _version(name) for name in names}
    return {"python": platform.python_version(), **{name: v for name, v in found.items() if v}}


def _packages() -> Iterator[Check]:
    right = (3, 10) <= sys.version_info[:2] < (3, 14)
    yield Check("Python", right, platform.python_version(), True, "install Python 3.10 to 3.13")
    for module in REQUIRED:
        there = find_spec(module) is not None
        advice = "pip install . in the checkout"
        yield Check(module, there, _version({"yaml": "PyYAML"}.get(module, module)), True, advice)


def _extras() -> Iterator[Check]:
    for extra, (modules, purpose) in EXTRAS.items():
        missing = [m for m in modules if find_spec(m) is None]
        found = f"{purpose}: {'without ' + ', '.join(missing) if missing else ', '.join(modules)}"
        yield Check(f"extra {extra}", not missing, found, False, f"pip install '.[{extra}]' in the checkout")


def _machine() -> Iterator[Check]:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    yield Check("cores", True, str(cores), False)
    place = kernel_cache()
    advice = "set NUMBA_CACHE_DIR to a folder that can be written: else every start compiles for half a minute"
    yield Check("kernel cache", place is not None, str(place or "no place can be written"), False, advice)


def kernel_cache() -> Path | None:
    """Where numba keeps compiled kernels: its setting, beside the source, or the user's cache; None if nowhere."""
    import checkers  # noqa: PLC0415

    own = os.environ.get("NUMBA_CACHE_DIR")
    beside = Path(checkers.__file__).parent / "kernels" / "__pycache__"
    user = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "numba"
    return next((p for p in ([Path(own)] if own else [beside, user]) if _writable(p)), None)


def _writable(folder: Path) -> bool:
    there = folder
    while not there.exists() and there != there.parent:
        there = there.parent
    try:
        with tempfile.TemporaryFile(dir=there):
            return True
    except OSError:
        return False


def find_browser() -> str | None:
    """The browser to use: RISKPLAN_CHROMIUM, or the first of the usual names on the path; None if there is none."""
    wanted = os.environ.get(BROWSER_VARIABLE)
    if wanted:
        return shutil.which(wanted)
    return next((path for path in map(shutil.which, BROWSERS) if path), None)


def _programs() -> Iterator[Check]:
    browser = find_browser()
    advice = "install Chromium, for 3-D stills and films; .html, .png and .gif from above need none"
    yield Check("browser", browser is not None, browser or "none", False, advice)
    film = shutil.which("ffmpeg") or ("imageio-ffmpeg" if find_spec("imageio_ffmpeg") else None)
    yield Check("ffmpeg", film is not None, film or "none", False, "install ffmpeg, for .mp4")


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return ""
