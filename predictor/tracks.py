"""Where an agent was observed: a track of poses and speeds on increasing times, world frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from checkers.validate import LARGEST_BODY, Array, InputError, as_array, as_scalar, as_times

# times are multiples of a step kept as floats: equal up to rounding
SLACK = 1e-6


@dataclass(frozen=True, eq=False)
class Track:
    """One agent's recorded states.

    Attributes:
        name: label; predictions inherit it.
        times: (T,) strictly increasing [s].
        positions: (T, 2) of the body's centre [m].
        headings: (T,) of the body [rad].
        speeds: (T,) along the heading [m/s]; negative in reverse.
        length, width: of the body [m].
        kind: what it is, as its source calls it ("car", "truck", "bicycle", ...).

    Raises:
        InputError: naming the field.
    """

    name: str
    times: Array
    positions: Array
    headings: Array
    speeds: Array
    length: float
    width: float
    kind: str = "car"

    def __post_init__(self) -> None:
        put = object.__setattr__
        for field in ("name", "kind"):
            if not isinstance(getattr(self, field), str):
                raise InputError(f"{field}: expected text, got {getattr(self, field)!r}")
        put(self, "times", as_times("times", self.times))
        count = len(self.times)
        for field, shape in (("positions", (count, 2)), ("headings", (count,)), ("speeds", (count,))):
            put(self, field, as_array(field, getattr(self, field), shape))
        for field in ("length", "width"):
            put(self, field, as_scalar(field, getattr(self, field), low=0.0, high=LARGEST_BODY, strict=True))

    def until(self, time: float) -> Track:
        """The states up to and including `time`: all that may be known then."""
        return self._only(self.times <= time + SLACK, f"a state at or before {time:g} s")

    def window(self, start: float, end: float) -> Track:
        """The states in [start, end], with times counted from `start`."""
        kept = (self.times >= start - SLACK) & (self.times <= end + SLACK)
        part = self._only(kept, f"a state between {start:g} and {end:g} s")
        return part._with(part.times - start, part.positions, part.headings, part.speeds)

    def at(self, times: Any) -> Track:
        """The states at other `times` (S,), interpolated linearly, headings the short way round.

        Raises:
            InputError: for a time outside the track.
        """
        times = as_times("times", times)
        first, last = self.times[0], self.times[-1]
        outside = np.flatnonzero((times < first - SLACK) | (times > last + SLACK))
        if len(outside):
            raise InputError(
                f"times[{int(outside[0])}]: track {self.name!r} covers {first:g} to {last:g} s, "
                f"got {times[outside[0]]:g}"
            )
        columns = (self.positions[:, 0], self.positions[:, 1], np.unwrap(self.headings), self.speeds)
        x, y, headings, speeds = (np.interp(times, self.times, column) for column in columns)
        return self._with(times, np.column_stack([x, y]), headings, speeds)

    def covers(self, start: float, end: float) -> bool:
        """Whether it was observed at the latest from `start` and at least to `end`."""
        return bool(self.times[0] <= start + SLACK and self.times[-1] >= end - SLACK)

    def _only(self, kept: Any, wanted: str) -> Track:
        if not np.any(kept):
            raise InputError(
                f"times: expected {wanted}, got track {self.name!r} from {self.times[0]:g} to {self.times[-1]:g} s"
            )
        return self._with(self.times[kept], self.positions[kept], self.headings[kept], self.speeds[kept])

    def _with(self, times: Array, positions: Array, headings: Array, speeds: Array) -> Track:
        return Track(self.name, times, positions, headings, speeds, self.length, self.width, self.kind)
