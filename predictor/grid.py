"""Tracks brought onto one clock: every track of a scene at the same evenly spaced times."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from checkers.validate import Array, InputError, as_scalar
from predictor.recordings import Recording
from predictor.tracks import SLACK, Track

Mask = NDArray[np.bool_]
# missing observations in a row that a straight line may replace in a target's past
BRIDGE = 2


@dataclass(frozen=True, eq=False)
class Grid:
    """A scene's A tracks at K times `dt` apart.

    Attributes:
        positions: (A, K, 2) [m], NaN where a track is not or has a gap.
        headings, speeds: (A, K) [rad], [m/s], NaN likewise.
        controls: (A, K, 2), NaN where the source has none.
        observed: (A, K) where a track was recorded. The other finite positions bridge small gaps.
    """

    positions: Array
    headings: Array
    speeds: Array
    controls: Array
    observed: Mask

    @classmethod
    def of(cls, recording: Recording, dt: float, bridge: int = BRIDGE) -> Grid:
        """Every track of a recording, interpolated linearly if it was observed more often than every `dt` s.

        Raises:
            InputError: if it was observed less often: what lies between is not known.
        """
        _check_rate(f"recording {recording.name!r}", recording.dt, dt)
        tracks = recording.tracks
        begin = min((float(t.times[0]) for t in tracks), default=0.0)
        end = max((float(t.times[-1]) for t in tracks), default=begin)
        count = int((end - begin) / dt + SLACK) + 1
        times: Array = begin + dt * np.arange(count, dtype=np.float64)
        states, controls = np.full((len(tracks), count, 4), np.nan), np.full((len(tracks), count, 2), np.nan)
        observed = np.zeros((len(tracks), count), dtype=bool)
        for a, track in enumerate(tracks):
            gap = _gaps(track.times, times)
            observed[a] = gap <= 1.5 * recording.dt
            near = gap <= (bridge + 1.5) * recording.dt
            states[a, near] = _interpolated(track, times[near])
            if track.name in recording.controls and abs(recording.dt - dt) <= SLACK:
                nearest = np.clip(np.searchsorted(track.times, times - dt / 2), 0, len(track.times) - 1)
                own = np.abs(track.times[nearest] - times) <= SLACK
                controls[a, own] = recording.controls[track.name][nearest[own]]
        return cls(states[..., :2], states[..., 2], states[..., 3], controls, observed)

    @cached_property
    def known(self) -> Mask:
        """(A, K) where there is a position, observed or bridged."""
        return np.isfinite(self.positions[..., 0])

    def starts(self, past: int, future: int, least: int, every: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """(a, k) where track a was observed at k, has `past` known steps up to there and `least` of `future` observed.

        Of each track every `every`-th such step is taken.
        """
        usable = self.observed & (_run(self.known, past) == past) & (self.coming(future) >= least)
        first = np.where(usable.any(axis=1), usable.argmax(axis=1), 0)
        turn = (np.arange(usable.shape[1]) - first[:, None]) % every == 0
        a, k = np.nonzero(usable & turn)
        return a, k

    def coming(self, future: int) -> NDArray[np.int64]:
        """(A, K) how many of the `future` steps after each were observed."""
        padded = np.pad(self.observed, ((0, 0), (0, future)))
        counts: NDArray[np.int64] = _run(padded, future)[:, future:]
        return counts

    def after(self, values: Array, a: NDArray[np.int64], k: NDArray[np.int64], count: int, first: int = 1) -> Array:
        """(N, count, 2) of `values` (A, K, 2) on tracks `a` at steps k + first, …; NaN beyond the scene."""
        padded = np.concatenate([values, np.full((len(values), count + first, 2), np.nan)], axis=1)
        gathered: Array = padded[a[:, None], k[:, None] + first + np.arange(count)]
        return gathered

    @cached_property
    def truth(self) -> Array:
        """(A, K, 2) observed positions only [m]."""
        return np.where(self.observed[..., None], self.positions, np.nan)


def observed_past(track: Track, steps: int = 20, dt: float = 0.1, recorded_dt: float | None = None) -> Array:
    """(steps, 2) last positions of a track, `dt` apart, as a predictor wants them [m].

    Args:
        track: what was observed; the last observation is the present.
        steps: wanted.
        dt: [s].
        recorded_dt: between the track's observations [s]; None: the median of what it shows.

    Raises:
        InputError: naming the track: too short, observed too seldom, or with a gap of more than `BRIDGE` steps.
    """
    steps_between = np.diff(track.times)
    recorded = recorded_dt or (float(np.median(steps_between)) if len(steps_between) else dt)
    _check_rate(f"track {track.name!r}", recorded, dt)
    span, wanted = float(track.times[-1] - track.times[0]), (steps - 1) * dt
    if span < wanted - SLACK:
        raise InputError(f"track {track.name!r}: expected a past of {wanted:g} s, got {span:g} s")
    times = track.times[-1] - dt * np.arange(steps)[::-1]
    bad = np.flatnonzero(_gaps(track.times, times) > (BRIDGE + 1.5) * recorded)
    if len(bad):
        raise InputError(
            f"track {track.name!r}: expected no gap of more than {BRIDGE} observations in the past, got one at "
            f"{times[bad[-1]]:g} s"
        )
    return _interpolated(track, times)[:, :2]


def _check_rate(who: str, recorded: float, dt: float) -> None:
    as_scalar("dt", dt, low=0.0, strict=True)
    if recorded > dt * 1.05:
        raise InputError(
            f"{who}: expected an observation at least every {dt:g} s, got one every {recorded:g} s: "
            f"ask for dt={recorded:g}, or interpolate with Recording.resampled({dt:g})"
        )


def _gaps(recorded: Array, times: Array) -> Array:
    """(S,) seconds between the observations around each time; 0 at an observation, infinite outside."""
    after = np.searchsorted(recorded, times - SLACK)
    padded = np.concatenate([[-np.inf], recorded, [np.inf]])
    gap: Array = np.where(padded[after + 1] <= times + SLACK, 0.0, padded[after + 1] - padded[after])
    return gap


def _interpolated(track: Track, times: Array) -> Array:
    """(S, 4) x, y, heading, speed at times within the track."""
    columns = (*track.positions.T, np.unwrap(track.headings), track.speeds)
    return np.column_stack([np.interp(times, track.times, column) for column in columns])


def _run(mask: Mask, length: int) -> NDArray[np.int64]:
    """(A, K) how many of the last `length` entries up to each are true."""
    total = np.concatenate([np.zeros((len(mask), 1), dtype=np.int64), np.cumsum(mask, axis=1)], axis=1)
    at = np.arange(1, mask.shape[1] + 1)
    counts: NDArray[np.int64] = total[:, at] - total[:, np.maximum(at - length, 0)]
    return counts
