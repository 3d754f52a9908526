"""CommonRoad XML files, a recording each; recorded scenes of one place overlap in time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from checkers.validate import InputError
from predictor.fit_constant_velocity import linked
from predictor.io_commonroad import lanes_of, open_commonroad, tracks_of
from predictor.recordings import Recording


@dataclass(frozen=True)
class CommonRoadFiles:
    """A folder of CommonRoad files; those that share a stretch of some vehicle's way are of one group.

    All of them are read before the first is given: which ones overlap is not known earlier.

    Attributes:
        name, files, on_bad: as in `predictor.recordings.Files`.
    """

    name: str
    files: tuple[Path, ...]
    on_bad: Callable[[InputError], None] | None = None

    def recordings(self) -> Iterator[Recording]:
        """Every recording, file by file."""
        found: dict[str, Recording] = {}
        for path in self.files:
            try:
                found.update((r.name, r) for r in read(path))
            except InputError as error:
                if self.on_bad is None:
                    raise
                self.on_bad(error)
        groups = linked({name: recording.tracks for name, recording in found.items()})
        group_of = {name: group[0] for group in groups for name in group}
        for name, recording in found.items():
            yield replace(recording, group=group_of[name])


def open_files(name: str, files: tuple[Path, ...], on_bad: Callable[[InputError], None] | None) -> CommonRoadFiles:
    """The files as a data set."""
    return CommonRoadFiles(name, files, on_bad)


def read(path: Path) -> Iterator[Recording]:
    """The recording of one file, named after the file."""
    scenario, _ = open_commonroad(path)
    try:
        yield Recording(path.stem, float(scenario.dt), tracks_of(scenario, path), lanes_of(scenario, path))
    except InputError as error:
        raise InputError(str(error) if str(error).startswith(str(path)) else f"{path}: {error}") from None
