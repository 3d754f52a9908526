"""Samples for training and testing: stretches of recordings, each with a past to know and a future to predict."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from checkers.validate import (
    Array,
    InputError,
    as_array,
    as_count,
    as_flag,
    as_instance,
    as_iterable,
    as_scalar,
    as_seed,
    as_tuple,
)
from checkers.writing import written
from predictor.grid import Grid
from predictor.lane_points import MOST, RADIUS, LanePoints
from predictor.npz import open_npz, read_npz
from predictor.recordings import Recording

FORMAT = "riskplan-windows-1"


@dataclass(frozen=True, eq=False)
class Windows:
    """N samples in the world frame, of P observed and F predicted steps of `dt`, with up to L lane points.

    Attributes:
        past: (N, P, 2) the target's observed positions, the last one at time 0 [m].
        headings, speeds: (N,) of the target at time 0, as recorded [rad], [m/s].
        future: (N, F, 2) its true positions from `dt` on [m], NaN where not recorded.
        lanes: (N, L, 2) points of the centre lines within 50 m of the target at time 0, nearest first, padded with
            NaN [m].
        lane_headings: (N, L) driving directions there [rad].
        ego_future: (N, F, 2) of the ego, or of another vehicle that stands for it [m]; NaN where none.
        controls: (N, F, 2) true acceleration [m/s²] and yaw rate [rad/s] of the target; those of step k bring it from
            step k − 1 (time 0 for the first) to k. NaN where none.
        scenes: (N,) index into `names`.
        names: of the groups of recordings; what a split keeps together.
        sizes: (N, 2) length and width of the target [m].
        dt: [s].
    """

    past: Array
    headings: Array
    speeds: Array
    future: Array
    lanes: Array
    lane_headings: Array
    ego_future: Array
    controls: Array
    scenes: NDArray[np.int64]
    names: tuple[str, ...]
    sizes: Array
    dt: float = 0.1

    def __post_init__(self) -> None:
        past, future, lanes = (_shape(getattr(self, name)) for name in ("past", "future", "lanes"))
        n, f = (past or (0,))[0], future[1] if len(future) == 3 else "F"
        shapes: dict[str, tuple[int | str, ...]] = {
            "past": (n, "P", 2),
            "headings": (n,),
            "speeds": (n,),
            "future": (n, f, 2),
            "lanes": (n, lanes[1] if len(lanes) == 3 else "L", 2),
            "lane_headings": (n, lanes[1] if len(lanes) == 3 else "L"),
            "ego_future": (n, f, 2),
            "controls": (n, f, 2),
            "sizes": (n, 2),
        }
        known = ("past", "headings", "speeds", "sizes")
        for name, shape in shapes.items():
            object.__setattr__(self, name, _checked(name, getattr(self, name), shape, finite=name in known))
        given = _checked("scenes", self.scenes, (n,), finite=True)
        scenes = given.astype(np.int64)
        object.__setattr__(self, "names", as_tuple("names", self.names, str))
        object.__setattr__(self, "dt", as_scalar("dt", self.dt, low=0.0, strict=True))
        if scenes.shape != (n,) or np.any((scenes != given) | (scenes < 0) | (scenes >= len(self.names))):
            raise InputError(f"scenes: expected ({n},) indices below {len(self.names)}, got shape {scenes.shape}")
        scenes.flags.writeable = False
        object.__setattr__(self, "scenes", scenes)

    def __len__(self) -> int:
        return len(self.past)

    def of(self, rows: Any) -> Windows:
        """Those `rows` (indices or booleans) only; the names stay."""
        per_row = [f.name for f in fields(self) if f.name not in ("names", "dt")]
        return replace(self, **{name: getattr(self, name)[rows] for name in per_row})

    def save(self, path: str | Path) -> None:
        """Write to an `.npz` (no pickle), complete or not at all."""
        values = {f.name: np.asarray(getattr(self, f.name)) for f in fields(self)}
        with written(path) as part, open(part, "wb") as file:
            np.savez_compressed(file, allow_pickle=False, format=np.asarray(FORMAT), **values)

    @classmethod
    def load(cls, path: str | Path) -> Windows:
        """Read what `save` wrote.

        Raises:
            InputError: naming the file and the field.
        """
        values = read_npz(path, FORMAT)
        known = {f.name for f in fields(cls)}
        for key in sorted((known ^ set(values)) - {"dt"}):
            raise InputError(f"{path}: {key}: {'missing' if key in known else 'unknown'} field")
        values["names"] = values["names"].tolist()
        values["dt"] = np.asarray(values.get("dt", 0.1)).tolist()
        try:
            return cls(**values)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None


def windows(
    recordings: Iterable[Recording],
    *,
    past: int = 20,
    future: int = 30,
    dt: float = 0.1,
    every: int = 10,
    least: int = 1,
    lane_points: int = MOST,
    focal: bool = False,
    rng: int | np.random.Generator = 0,
) -> Windows:
    """Every window of every track with an unbroken past; small gaps in it are bridged by straight lines.

    The ego of a window is the recording's, or else a vehicle drawn by `rng` among those within 50 m whose future is
    complete. A recording's ego is no target.

    Args:
        recordings: read one by one.
        past, future: steps observed, including the present, and to predict.
        dt: of a step [s]; recordings observed more often are interpolated.
        every: steps from one window of a track to its next.
        least: fewest future steps that must be recorded.
        lane_points: how many of the nearest lane points are kept.
        focal: only of the tracks the source names as those to predict, where it names any.
        rng: generator or seed for the choice of egos.

    Raises:
        InputError: no window at all, or a recording observed too seldom for `dt`.
    """
    counts = {"past": (past, 2), "future": (future, 1), "every": (every, 1), "least": (least, 0)}
    for name, (value, low) in {**counts, "lane_points": (lane_points, 0)}.items():
        as_count(name, value, low, 1_000_000)
    as_flag("focal", focal)
    rng = rng if isinstance(rng, np.random.Generator) else np.random.default_rng(as_seed("rng", rng))
    groups: dict[str, int] = {}
    parts: list[dict[str, Any]] = []
    tracks = 0
    for i, recording in enumerate(as_iterable("recordings", recordings)):
        as_instance(f"recordings[{i}]", recording, Recording)
        tracks += len(recording.tracks)
        grid = Grid.of(recording, dt)
        a, k = grid.starts(past, future, least, every)
        allowed = np.array([_is_target(recording, t.name, focal) for t in recording.tracks], dtype=bool)
        a, k = a[allowed[a]], k[allowed[a]]
        if not len(a):
            continue
        now = grid.positions[a, k]
        points, directions = LanePoints.of(recording.lanes).near(now, lane_points)
        scene = groups.setdefault(recording.group, len(groups))
        part = {
            "past": grid.positions[a[:, None], k[:, None] + np.arange(1 - past, 1)],
            "headings": grid.headings[a, k],
            "speeds": grid.speeds[a, k],
            "future": grid.after(grid.truth, a, k, future),
            "lanes": points,
            "lane_headings": directions,
            "ego_future": _ego_future(recording, grid, a, k, future, rng),
            "controls": grid.after(grid.controls, a, k, future, first=0),
            "scenes": np.full(len(a), scene),
            "sizes": np.array([(t.length, t.width) for t in recording.tracks])[a],
        }
        parts.append(part)
    if not parts:
        raise InputError(
            f"recordings: expected tracks with {past} steps of past and at least {least} of future, {dt:g} s each, "
            f"got none among {tracks} tracks"
        )
    joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return Windows(**joined, names=tuple(groups), dt=dt)


def is_windows(path: str | Path) -> bool:
    """Whether a file is one that `Windows.save` wrote, as far as its format says."""
    try:
        with open_npz(path, FORMAT):
            return True
    except InputError:
        return False


def split(samples: Windows, fractions: Sequence[float], seed: int) -> tuple[Windows, ...]:
    """Parts with about those `fractions` of the windows, no scene in two of them.

    Scenes are taken in an order drawn by `seed`; each goes to the first of the later parts that still has room for
    it, else to the first part.

    Raises:
        InputError: fractions that do not sum to 1, or a part that stays empty.
    """
    as_instance("samples", samples, Windows)
    as_seed("seed", seed)
    shares = as_array("fractions", fractions, ("S",))
    if np.any(shares <= 0) or abs(shares.sum() - 1.0) > 1e-9:
        raise InputError(f"fractions: expected numbers > 0 that sum to 1, got {shares.tolist()}")
    counts = np.bincount(samples.scenes, minlength=len(samples.names))
    room, part_of = shares * len(samples), np.zeros(len(counts), dtype=np.int64)
    for scene in np.random.default_rng(seed).permutation(len(counts)):
        fits = np.flatnonzero(room[1:] >= counts[scene] - 1e-9)
        part_of[scene] = fits[0] + 1 if len(fits) else 0
        room[part_of[scene]] -= counts[scene]
    parts = tuple(samples.of(part_of[samples.scenes] == i) for i in range(len(shares)))
    for i, part in enumerate(parts):
        if not len(part):
            raise InputError(f"fractions[{i}]: no scene is small enough for a part of {shares[i]:g}: add recordings")
    return parts


def _is_target(recording: Recording, name: str, focal: bool) -> bool:
    return name != recording.ego and (not focal or not recording.focal or name in recording.focal)


def _ego_future(
    recording: Recording,
    grid: Grid,
    a: NDArray[np.int64],
    k: NDArray[np.int64],
    future: int,
    rng: np.random.Generator,
) -> Array:
    """(N, F, 2) of the recording's ego, or of another vehicle near each target."""
    names = [t.name for t in recording.tracks]
    if recording.ego is not None:
        return grid.after(grid.truth, np.full(len(a), names.index(recording.ego)), k, future)
    complete = grid.observed & (grid.coming(future) == future)
    apart = np.hypot(*np.moveaxis(grid.truth[:, k] - grid.positions[a, k], -1, 0))
    near = complete[:, k] & (apart <= RADIUS) & (np.arange(len(names))[:, None] != a)
    drawn = np.where(near, rng.random(near.shape), -1.0).argmax(axis=0)
    return np.where(near.any(axis=0)[:, None, None], grid.after(grid.truth, drawn, k, future), np.nan)


def _shape(value: Any) -> tuple[int, ...]:
    """() for rows of unequal length, which are refused where they are converted."""
    try:
        return np.shape(value)
    except ValueError:
        return ()


def _checked(name: str, value: Any, shape: tuple[int | str, ...], *, finite: bool) -> Array:
    """As `as_array`, but axes may be empty: a data set may have no lanes, or no samples left."""
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name}: expected numbers of shape {shape}, got {type(value).__name__}: {error}") from None
    if array.ndim != len(shape) or any(isinstance(w, int) and w != s for w, s in zip(shape, array.shape, strict=True)):
        raise InputError(f"{name}: expected shape {shape}, got {array.shape}")
    if finite and array.size:
        return as_array(name, array, array.shape)
    array.flags.writeable = False
    return array
