"""Recordings as one `.npz`: what the recorder writes, and a form any other data can be kept in.

No pickle: arrays, and names and counts as JSON. Recordings are written and read one at a time.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from checkers.validate import Array, InputError, as_instance, as_iterable
from checkers.writing import written
from predictor.lanes import Lane
from predictor.npz import open_npz
from predictor.recordings import Files, Recording
from predictor.tracks import Track

FORMAT = "riskplan-recordings-1"


def open_files(name: str, files: tuple[Path, ...], on_bad: Callable[[InputError], None] | None) -> Files:
    """The files as a data set."""
    return Files(name, files, read, on_bad)


def save_recordings(recordings: Iterable[Recording], path: str | Path) -> int:
    """Write recordings to an `.npz`, complete or not at all; how many there were.

    Raises:
        InputError: if the place cannot be written.
    """
    as_iterable("recordings", recordings)
    count = 0
    with written(path) as part, zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as archive:
        put = partial(_put, archive)
        put("format", np.asarray(FORMAT))
        for recording in recordings:
            as_instance(f"recordings[{count}]", recording, Recording)
            for key, value in _packed(recording).items():
                put(f"{count}.{key}", value)
            count += 1
        put("count", np.asarray(count))
    return count


def read(path: Path) -> Iterator[Recording]:
    """The recordings of one file."""
    with open_npz(path, FORMAT) as data:
        count = data.get("count")
        if count is None or count.shape != () or count.dtype.kind != "i":
            raise InputError(f"{path}: count: expected a whole number, got {count!r}")
        for i in range(int(count)):
            try:
                yield _unpacked(json.loads(str(data[f"{i}.meta"])), data[f"{i}.states"], data[f"{i}.lanes"])
            except InputError as error:
                raise InputError(f"{path}: recording {i}: {error}") from None
            except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
                raise InputError(f"{path}: recording {i}: not as written: {type(error).__name__}: {error}") from None


def _put(archive: zipfile.ZipFile, key: str, value: Any) -> None:
    # a name gives the entry a fixed date: the same recordings make the same file
    with archive.open(f"{key}.npy", "w", force_zip64=True) as file:
        np.lib.format.write_array(file, value, allow_pickle=False)


def _packed(recording: Recording) -> dict[str, Any]:
    blocks, lines = [np.zeros((0, 7))], [np.zeros((0, 6))]
    for track in recording.tracks:
        controls = recording.controls.get(track.name, np.full((len(track.times), 2), np.nan))
        blocks.append(np.column_stack([track.times, track.positions, track.headings, track.speeds, controls]))
    lines += [np.column_stack([lane.centre, lane.left, lane.right]) for lane in recording.lanes]
    meta = {
        "name": recording.name,
        "dt": recording.dt,
        "group": recording.group,
        "ego": recording.ego,
        "focal": recording.focal,
        "tracks": [[t.name, t.kind, t.length, t.width, len(t.times)] for t in recording.tracks],
        "controls": list(recording.controls),
        "lanes": [[x.name, x.successors, x.neighbours, len(x.centre)] for x in recording.lanes],
    }
    return {"meta": np.asarray(json.dumps(meta)), "states": np.concatenate(blocks), "lanes": np.concatenate(lines)}


def _unpacked(meta: dict[str, Any], states: Array, lines: Array) -> Recording:
    tracks, controls, lanes = [], {}, []
    for (name, kind, length, width, _), rows in zip(meta["tracks"], _cut(states, meta["tracks"], 7), strict=True):
        tracks.append(Track(name, rows[:, 0], rows[:, 1:3], rows[:, 3], rows[:, 4], length, width, kind))
        if name in meta["controls"]:
            controls[name] = rows[:, 5:]
    for (name, after, beside, _), rows in zip(meta["lanes"], _cut(lines, meta["lanes"], 6), strict=True):
        lanes.append(Lane(name, rows[:, :2], rows[:, 2:4], rows[:, 4:], tuple(after), tuple(beside)))
    return Recording(
        meta["name"],
        meta["dt"],
        tuple(tracks),
        tuple(lanes),
        controls,
        tuple(meta["focal"]),
        meta["ego"],
        meta["group"],
    )


def _cut(rows: Array, entries: list[Any], columns: int) -> list[Array]:
    """The rows in pieces as long as the entries say."""
    counts = [entry[-1] for entry in entries]
    if rows.ndim != 2 or rows.shape[1] != columns or sum(counts) != len(rows) or any(c < 1 for c in counts):
        raise InputError(f"rows: expected shape ({sum(counts)}, {columns}), got {rows.shape}")
    return np.split(np.asarray(rows, dtype=np.float64), np.cumsum(counts)[:-1]) if counts else []
