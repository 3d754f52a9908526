"""Argoverse 1 motion forecasting (Chang et al. 2019): a CSV of positions a scenario, at about 10 Hz.

The source states neither sizes nor headings: vehicles are taken to be 4.5 × 1.8 m, headings come from the motion.

About one scenario in six was recorded at 5 to 8 Hz. Its time stamps are true, the ego's steps are as long as they say,
so those scenarios are interpolated to 10 Hz; taken for 10 Hz, speeds would be up to twice too high.
"""

from __future__ import annotations

import csv
import io
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from checkers.validate import FARTHEST, Array, InputError
from predictor.datasets.motion import motion
from predictor.datasets.text import read_text
from predictor.recordings import Files, Recording
from predictor.tracks import Track

DT = 0.1
# a median step within this share of 0.1 s is 10 Hz with jitter; longer ones than `SLOWEST` [s] are refused
JITTER, SLOWEST = 0.1, 0.35
LENGTH, WIDTH = 4.5, 1.8
COLUMNS = ("TIMESTAMP", "TRACK_ID", "OBJECT_TYPE", "X", "Y")


def open_files(name: str, files: tuple[Path, ...], on_bad: Callable[[InputError], None] | None) -> Files:
    """The files as a data set."""
    return Files(name, files, read, on_bad)


def read(path: Path) -> Iterator[Recording]:
    """The recording of one file: the AGENT is focal, the AV is the ego; time 0 is the last observation."""
    try:
        rows = list(csv.reader(io.StringIO(read_text(path), newline="")))
    except csv.Error as error:
        raise InputError(f"{path}: not CSV: {error}") from None
    if not rows or not set(COLUMNS) <= set(rows[0]):
        missing = ", ".join(c for c in COLUMNS if not rows or c not in rows[0])
        raise InputError(f"{path}: not an Argoverse forecasting file: no column {missing}")
    at = {name: rows[0].index(name) for name in COLUMNS}
    states: dict[str, list[tuple[float, float, float]]] = defaultdict(list)
    kinds: dict[str, str] = {}
    for line, row in enumerate(rows[1:], 2):
        try:
            state = (float(row[at["TIMESTAMP"]]), float(row[at["X"]]), float(row[at["Y"]]))
            track, kind = row[at["TRACK_ID"]], row[at["OBJECT_TYPE"]]
        except (ValueError, IndexError) as error:
            raise InputError(f"{path}: line {line}: expected numbers in TIMESTAMP, X, Y: {error}") from None
        if not np.all(np.abs(state) <= FARTHEST):
            raise InputError(f"{path}: line {line}: expected finite numbers up to {FARTHEST:g}, got {state}")
        states[track].append(state)
        kinds[track] = kind
    if not states:
        raise InputError(f"{path}: expected observations, got none")
    stamps = np.unique([s[0] for rows_of in states.values() for s in rows_of])
    between = np.diff(stamps)
    usual = float(np.median(between)) if len(between) else DT
    if usual > SLOWEST:
        raise InputError(f"{path}: expected an observation about every {DT:g} s, got one every {usual:.3g} s")
    regular = abs(usual - DT) <= JITTER * DT
    clock = _counted(stamps) if regular else stamps - stamps[-1]
    try:
        tracks = tuple(
            _track(name, kinds[name], np.array(rows_of), stamps, clock, regular) for name, rows_of in states.items()
        )
        av, agent = (tuple(name for name, kind in kinds.items() if kind == wanted) for wanted in ("AV", "AGENT"))
        yield Recording(path.stem, DT, tracks, focal=agent, ego=av[0] if av else None)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _track(name: str, kind: str, rows: Array, stamps: Array, clock: Array, regular: bool) -> Track:
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    times, positions = clock[np.searchsorted(stamps, rows[:, 0])], rows[:, 1:]
    twice = np.flatnonzero(np.diff(times) <= 0)
    if len(twice):
        raise InputError(f"track {name!r}: expected one position at {rows[twice[0], 0]:.3f} s, got several")
    if not regular:
        times, positions = _interpolated(times, positions)
    headings, speeds = motion(times, positions)
    return Track(name, times, positions, headings, speeds, LENGTH, WIDTH, kind.lower())


def _counted(stamps: Array) -> Array:
    """The stamps' times on a grid of 0.1 s that ends at 0: sensors jitter, and a missing step is a gap."""
    steps = np.maximum(np.round(np.diff(stamps) / DT), 1.0)
    behind: Array = np.concatenate([np.cumsum(steps[::-1])[::-1], [0.0]]) * -DT
    return behind


def _interpolated(times: Array, positions: Array) -> tuple[Array, Array]:
    """The same track on the grid of 0.1 s that ends at 0, where observations up to `SLOWEST` apart surround it."""
    if len(times) == 1:
        return times, positions
    grid: Array = np.arange(np.ceil(times[0] / DT - 1e-6), np.floor(times[-1] / DT + 1e-6) + 1) * np.float64(DT)
    after = np.clip(np.searchsorted(times, grid - 1e-6), 1, len(times) - 1)
    kept = times[after] - times[after - 1] <= SLOWEST
    if not kept.any():
        return times[-1:], positions[-1:]
    return grid[kept], np.column_stack([np.interp(grid[kept], times, positions[:, i]) for i in range(2)])
