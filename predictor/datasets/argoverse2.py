"""Argoverse 2 motion forecasting (Wilson et al. 2021): a parquet file and a map in JSON a scenario, 10 Hz.

Read with pandas and pyarrow (the extra `data`); the source's own kit is not needed. Sizes are not stated: they are
the usual ones of each type of object.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from checkers.validate import FARTHEST, Array, InputError, as_array
from predictor.datasets.text import read_text
from predictor.lanes import Lane
from predictor.recordings import Files, Recording
from predictor.tracks import Track

DT = 0.1
EGO = "AV"
# of `object_category`: tracks that count in the source's metrics, and the one all of them predict
SCORED, FOCAL = 2, 3
NUMBERS = ("timestep", "position_x", "position_y", "heading", "velocity_x", "velocity_y")
COLUMNS = ["track_id", "object_type", "object_category", *NUMBERS]
# length and width [m]
SIZES = {
    "vehicle": (4.5, 1.8),
    "bus": (12.0, 2.6),
    "pedestrian": (0.6, 0.6),
    "motorcyclist": (2.2, 0.9),
    "cyclist": (1.8, 0.7),
    "riderless_bicycle": (1.8, 0.7),
}
OTHER = (1.0, 1.0)


def open_files(name: str, files: tuple[Path, ...], on_bad: Callable[[InputError], None] | None) -> Files:
    """The files as a data set."""
    return Files(name, files, read, on_bad)


def read(path: Path) -> Iterator[Recording]:
    """The recording of one scenario, with the lanes of the map beside it, if there is one.

    The focal track comes first among the focal ones, scored ones follow. Whether a step is of the observed part is not
    kept: windows choose their own present.
    """
    table = _table(path)
    maps = sorted(path.parent.glob("log_map_archive_*.json"))
    wanted = [m for m in maps if m.stem.removeprefix("log_map_archive_") in path.stem] or maps[:1]
    try:
        tracks, category = [], {}
        for name, rows in table.groupby("track_id", sort=False):
            tracks.append(_track(str(name), rows.sort_values("timestep")))
            kinds = as_array("object_category", rows["object_category"].to_numpy(dtype=np.float64), ("T",))
            category[str(name)] = int(kinds.max())
        focal = tuple(name for level in (FOCAL, SCORED) for name, c in category.items() if c == level and name != EGO)
        ego = EGO if EGO in category else None
        lanes = lanes_of(wanted[0]) if wanted else ()
        yield Recording(path.stem.removeprefix("scenario_"), DT, tuple(tracks), lanes, focal=focal, ego=ego)
    except (TypeError, ValueError, KeyError, OverflowError) as error:  # InputError is a ValueError
        text = str(error)
        raise InputError(text if wanted and text.startswith(str(wanted[0])) else f"{path}: {text}") from None


def lanes_of(path: Path) -> tuple[Lane, ...]:
    """The lanes of a map.

    Raises:
        InputError: naming the file and the lane.
    """
    try:
        segments = json.loads(read_text(path))["lane_segments"]
        lanes = {}
        for key, value in segments.items():
            try:
                lanes[str(key)] = _lane(str(key), value)
            except InputError as error:
                raise InputError(f"lane {key}: {error}") from None
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        reason = f"no {error}" if isinstance(error, KeyError) else error
        raise InputError(f"{path}: not an Argoverse 2 map: {reason}") from None
    return tuple(_linked(lane, segments[lane.name], lanes) for lane in lanes.values())


def _table(path: Path) -> Any:
    try:
        import pandas as pd  # noqa: PLC0415 (an extra)
        import pyarrow  # noqa: PLC0415, F401
    except ImportError:
        raise InputError(f"{path}: reading parquet needs pandas and pyarrow: pip install '.[data]'") from None
    try:
        return pd.read_parquet(path, columns=COLUMNS, engine="pyarrow")
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except Exception as error:  # whatever the reader trips over, the file is the cause
        raise InputError(f"{path}: not an Argoverse 2 scenario: {' '.join(str(error).split())}") from None


def _track(name: str, rows: Any) -> Track:
    kind = str(rows["object_type"].iloc[0])
    try:
        columns = {
            key: as_array(key, rows[key].to_numpy(dtype=np.float64), ("T",), largest=FARTHEST) for key in NUMBERS
        }
        heading = columns["heading"]
        speeds = columns["velocity_x"] * np.cos(heading) + columns["velocity_y"] * np.sin(heading)
        positions = np.column_stack([columns["position_x"], columns["position_y"]])
        return Track(name, columns["timestep"] * DT, positions, heading, speeds, *SIZES.get(kind, OTHER), kind)
    except InputError as error:
        raise InputError(f"track {name!r}: {error}") from None


def _lane(name: str, segment: dict[str, Any]) -> Lane:
    left, right = (_line(segment[f"{side}_lane_boundary"]) for side in ("left", "right"))
    given = segment.get("centerline")
    count = max(len(left), len(right), len(given) if given else 0, 2)
    left, right = _evenly(left, count), _evenly(right, count)
    centre = _evenly(_line(given), count) if given else (left + right) / 2
    return Lane(name, centre, left, right)


def _linked(lane: Lane, segment: dict[str, Any], lanes: dict[str, Lane]) -> Lane:
    after = tuple(str(s) for s in segment.get("successors") or () if str(s) in lanes)
    beside = [str(segment.get(f"{side}_neighbor_id")) for side in ("left", "right")]
    along = lane.centre[-1] - lane.centre[0]
    same = tuple(n for n in beside if n in lanes and (lanes[n].centre[-1] - lanes[n].centre[0]) @ along > 0)
    return Lane(lane.name, lane.centre, lane.left, lane.right, after, same)


def _line(points: list[dict[str, float]]) -> Array:
    return as_array("points", [(float(p["x"]), float(p["y"])) for p in points], ("N", 2), largest=FARTHEST)


def _evenly(line: Array, count: int) -> Array:
    """`count` points evenly along a line: the i-th of a lane's centre and bounds then lie across from each other."""
    stations = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    at = np.linspace(0.0, stations[-1], count)
    return np.column_stack([np.interp(at, stations, line[:, i]) for i in range(2)])
