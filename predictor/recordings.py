"""What data sets are made of: recordings, and how to open them.

A data set is a file or a folder of files of one kind; `predictor.datasets` has one reader a file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

import numpy as np

from checkers.validate import (
    Array,
    InputError,
    as_array,
    as_callable,
    as_instance,
    as_option,
    as_path,
    as_scalar,
    as_text,
    as_tuple,
)
from predictor.lanes import Lane
from predictor.tracks import Track

# kind -> (module of predictor.datasets, suffix of its files)
KINDS = {
    "argoverse1": ("argoverse1", ".csv"),
    "argoverse2": ("argoverse2", ".parquet"),
    "commonroad": ("commonroad", ".xml"),
    "eth-ucy": ("eth_ucy", ".txt"),
    "simulator": ("simulator", ".npz"),
}


@dataclass(frozen=True, eq=False)
class Recording:
    """One scene as recorded: what windows are cut from, and what training and test never share.

    Attributes:
        name: unique in its data set.
        dt: between observations [s].
        tracks: everything that moves, or could; names are unique.
        lanes: of the map, if there is one.
        controls: track name -> (T, 2) true acceleration [m/s²] and yaw rate [rad/s], where the source has them.
            Those of time t hold until the next; an entry is NaN where the source has none.
        focal: tracks the source names as those to predict; empty: any.
        ego: the track of the vehicle that recorded, if it is among them.
        group: recordings of one group share traffic and are kept together by a split; empty: the name.

    Raises:
        InputError: naming the field.
    """

    name: str
    dt: float
    tracks: tuple[Track, ...]
    lanes: tuple[Lane, ...] = ()
    controls: Mapping[str, Array] = field(default_factory=dict)
    focal: tuple[str, ...] = ()
    ego: str | None = None
    group: str = ""

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "dt", as_scalar("dt", self.dt, low=0.0, strict=True))
        for name, cls in (("tracks", Track), ("lanes", Lane)):
            put(self, name, as_tuple(name, getattr(self, name), cls))
        lengths: dict[str, int] = {}
        for i, track in enumerate(self.tracks):
            if track.name in lengths:
                raise InputError(f"tracks[{i}]: expected unique names, got {track.name!r} again")
            lengths[track.name] = len(track.times)
        put(self, "focal", as_tuple("focal", self.focal, str))
        as_instance("controls", self.controls, Mapping)
        for what in ("name", "group", "ego"):
            if what != "ego" or self.ego is not None:
                as_text(what, getattr(self, what))
        for what, names in (
            ("focal", self.focal),
            ("controls", self.controls),
            ("ego", [self.ego] if self.ego else []),
        ):
            for name in names:
                if name not in lengths:
                    raise InputError(f"{what}: expected the name of a track, got {name!r}")
        checked = {
            name: as_array(f"controls[{name!r}]", value, (lengths[name], 2), finite=False)
            for name, value in self.controls.items()
        }
        put(self, "controls", MappingProxyType(checked))
        put(self, "group", self.group or self.name)

    def resampled(self, dt: float) -> Recording:
        """The same scene observed every `dt` s, interpolated linearly; controls, which are not, are left out.

        Meant for small changes of the rate: between far observations a straight line is not what happened.
        """
        step = as_scalar("dt", dt, low=0.0, strict=True)
        tracks = []
        for track in self.tracks:
            first, last = track.times[[0, -1]]
            tracks.append(track.at(first + step * np.arange(int((last - first) / step + 1e-6) + 1)))
        return replace(self, dt=step, tracks=tuple(tracks), controls={})


class DataSet(Protocol):
    """A source of recordings, read one by one."""

    @property
    def name(self) -> str:
        """Label in reports and model cards."""

    def recordings(self) -> Iterator[Recording]:
        """Every recording, in the same order each time.

        Raises:
            InputError: naming the file that cannot be used, unless bad files are to be left out.
        """


@dataclass(frozen=True)
class Files:
    """A data set of files.

    Attributes:
        name: label.
        files: in reading order.
        read: the recordings of one file.
        on_bad: called with the error of a file that cannot be used, which is then left out; None: it is raised.
    """

    name: str
    files: tuple[Path, ...]
    read: Callable[[Path], Iterator[Recording]]
    on_bad: Callable[[InputError], None] | None = None

    def recordings(self) -> Iterator[Recording]:
        """Every recording, file by file."""
        for path in self.files:
            try:
                yield from self.read(path)
            except InputError as error:
                if self.on_bad is None:
                    raise
                self.on_bad(error)


def open_data(path: str | Path, kind: str | None = None, on_bad: Callable[[InputError], None] | None = None) -> DataSet:
    """A data set: one file, or every file of its kind in a folder and below.

    Args:
        path: file or folder.
        kind: one of `KINDS`; None: by the suffix of the files, which must then be of one kind.
        on_bad: as in `Files`.

    Raises:
        InputError: no such path, no files of the kind, or files of several kinds.
    """
    path = as_path("path", path)
    as_callable("on_bad", on_bad)
    if kind is not None:
        as_option("kind", kind, sorted(KINDS))
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    kind = kind or _kind_of(path)
    module, suffix = KINDS[kind]
    files = tuple(sorted(path.rglob(f"*{suffix}"))) if path.is_dir() else (path,)
    if not files:
        raise InputError(f"{path}: no {suffix} files, as data of kind {kind!r} are")
    stems = [f.stem for f in files]
    twice = next((s for i, s in enumerate(stems) if s in stems[:i]), "") if len(set(stems)) < len(stems) else ""
    if twice:
        raise InputError(f"{path}: recordings are named after their files, and several are called {twice}{suffix}")
    data: DataSet = import_module(f"predictor.datasets.{module}").open_files(path.resolve().name, files, on_bad)
    return data


def _kind_of(path: Path) -> str:
    kinds = {suffix: kind for kind, (_, suffix) in KINDS.items()}
    files = path.rglob("*") if path.is_dir() else [path]
    found = sorted({kinds[f.suffix.lower()] for f in files if f.suffix.lower() in kinds})
    known = ", ".join(f"{kind} ({suffix})" for kind, (_, suffix) in KINDS.items())
    if not found:
        raise InputError(f"{path}: expected data of one of the kinds {known}")
    if len(found) > 1:
        raise InputError(f"{path}: has data of several kinds, name one: {', '.join(found)}")
    return found[0]
