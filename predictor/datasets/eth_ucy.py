"""ETH and UCY pedestrians (Pellegrini et al. 2009; Lerner et al. 2007): text of `frame id x y`, metres, 2.5 Hz.

The form used by most: the frames of neighbouring observations differ by a fixed number, which stands for 0.4 s.
Pedestrians are taken to be 0.5 m across, headings come from the motion.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from checkers.validate import FARTHEST, Array, InputError
from predictor.datasets.motion import motion
from predictor.datasets.text import read_text
from predictor.recordings import Files, Recording
from predictor.tracks import Track

DT = 0.4
SIZE = 0.5


def open_files(name: str, files: tuple[Path, ...], on_bad: Callable[[InputError], None] | None) -> Files:
    """The files as a data set."""
    return Files(name, files, read, on_bad)


def read(path: Path) -> Iterator[Recording]:
    """The recording of one file; there is no map."""
    rows = _rows(path)
    frames = np.unique(rows[:, 0])
    if len(frames) < 2:
        raise InputError(f"{path}: expected at least 2 frames, got {len(frames)}")
    between, counts = np.unique(np.diff(frames), return_counts=True)
    step = float(between[counts.argmax()])
    off = np.flatnonzero(np.abs(np.diff(frames) / step - np.round(np.diff(frames) / step)) > 1e-6)
    if len(off):
        raise InputError(f"{path}: expected frames {step:g} apart, got {frames[off[0]]:g} and {frames[off[0] + 1]:g}")
    tracks = []
    order = np.lexsort((rows[:, 0], rows[:, 1]))
    rows = rows[order]
    for own in np.split(rows, np.flatnonzero(np.diff(rows[:, 1])) + 1):
        times = (own[:, 0] - frames[0]) / step * DT
        name = f"{own[0, 1]:g}"
        if np.any(np.diff(times) <= 0):
            frame = own[1:, 0][np.diff(times) <= 0][0]
            raise InputError(f"{path}: pedestrian {name}: expected one position in frame {frame:g}, got several")
        headings, speeds = motion(times, own[:, 2:])
        tracks.append(Track(name, times, own[:, 2:], headings, speeds, SIZE, SIZE, "pedestrian"))
    yield Recording(path.stem, DT, tuple(tracks))


def _rows(path: Path) -> Array:
    """(R, 4) frame, pedestrian, x, y."""
    text = read_text(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # an empty file is a warning only
            rows: Array = np.loadtxt(io.StringIO(text), ndmin=2)
    except (ValueError, UserWarning) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: expected rows of frame, pedestrian, x, y: {reason}") from None
    if rows.shape[1] != 4:
        raise InputError(f"{path}: expected rows of frame, pedestrian, x, y, got {rows.shape[1]} columns")
    bad = np.flatnonzero(~(np.abs(rows) <= FARTHEST).all(axis=1))
    if len(bad):
        got = rows[bad[0]].tolist()
        raise InputError(f"{path}: line {bad[0] + 1}: expected finite numbers up to {FARTHEST:g}, got {got}")
    return rows
