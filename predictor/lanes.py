"""Lanes of a road map: centre lines with bounds, linked by what follows and what lies beside."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import shapely

from checkers.validate import Array, InputError, as_array

LONGEST = 1e5  # of a lane [m]; it is looked at every half metre


@dataclass(frozen=True, eq=False)
class Lane:
    """A piece of one lane, in driving direction.

    Attributes:
        name: identifier in its map.
        centre, left, right: (N, 2) points [m], N ≥ 2; the i-th of each lie on one cross-section.
        successors: names of the lanes that go on where this one ends.
        neighbours: names of the lanes beside it with the same driving direction.
    """

    name: str
    centre: Array
    left: Array
    right: Array
    successors: tuple[str, ...] = ()
    neighbours: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", as_array("centre", self.centre, ("N", 2)))
        if len(self.centre) < 2:
            raise InputError(f"centre: expected at least 2 points, got {len(self.centre)}")
        if not self.stations[-1] <= LONGEST:
            raise InputError(f"centre: expected a length of at most {LONGEST:g} m, got {self.stations[-1]:g}")
        for field in ("left", "right"):
            object.__setattr__(self, field, as_array(field, getattr(self, field), self.centre.shape))

    @cached_property
    def line(self) -> Any:
        """The centre line as a shapely geometry."""
        return shapely.LineString(self.centre)

    @cached_property
    def area(self) -> Any:
        """The outline as a valid shapely geometry."""
        area = shapely.make_valid(shapely.Polygon(self.outline))
        shapely.prepare(area)
        return area

    @property
    def outline(self) -> Array:
        """(2N, 2) polygon between the bounds."""
        return np.concatenate([self.left, self.right[::-1]])

    @property
    def stations(self) -> Array:
        """(N,) arclength of the centre line's points [m]."""
        return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(self.centre, axis=0).T))])

    @property
    def directions(self) -> Array:
        """(N − 1,) heading of the centre line's segments [rad], unwrapped."""
        step = np.diff(self.centre, axis=0)
        return np.unwrap(np.arctan2(step[:, 1], step[:, 0]))

    def direction_at(self, position: Any) -> float:
        """Heading of the centre line where it is nearest to `position` (2,)."""
        line = shapely.LineString(self.centre)
        station = line.project(shapely.Point(position))
        segment = np.searchsorted(self.stations, station, side="right") - 1
        return float(self.directions[np.clip(segment, 0, len(self.centre) - 2)])

    def cut(self, start: float, longest: float, turn: float) -> tuple[tuple[Array, float], ...]:
        """The lane beyond the station `start` [m] in pieces (polygon, heading of the centre line).

        No piece is longer than `longest` [m] or turns more than `turn` [rad], as far as the points tell.
        """
        stations = self.stations
        if start >= stations[-1] - 1e-6:
            return ()
        turning = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(self.directions)))])
        effort = stations / longest + np.append(turning, turning[-1]) / turn
        first = float(np.interp(start, stations, effort))
        count = max(1, int(np.ceil(effort[-1] - first - 1e-9)))
        ends = np.interp(np.linspace(first, effort[-1], count + 1), effort, stations)
        ends[0] = max(start, 0.0)
        return tuple(self._piece(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True) if b - a > 1e-6)

    def _piece(self, a: float, b: float) -> tuple[Array, float]:
        stations = self.stations
        inner = stations[(stations > a + 1e-6) & (stations < b - 1e-6)]
        at = np.concatenate([[a], inner, [b]])

        def along(line: Array) -> Array:
            return np.column_stack([np.interp(at, stations, line[:, i]) for i in range(2)])

        chord = np.diff(along(self.centre)[[0, -1]], axis=0)[0]
        polygon = np.concatenate([along(self.left), along(self.right)[::-1]])
        return polygon, float(np.arctan2(chord[1], chord[0]))

    def station(self, line: Any, least: float) -> float:
        """Where on the lane [m] the projection onto `line` passes `least` [m]; its end if nowhere."""
        stations = self.stations
        fine = np.append(np.arange(0.0, stations[-1], 0.5), stations[-1])
        points = np.column_stack([np.interp(fine, stations, self.centre[:, i]) for i in range(2)])
        progress = shapely.line_locate_point(line, shapely.points(points))
        beyond = np.flatnonzero(progress >= least)
        if not len(beyond):
            return float(stations[-1])
        k = int(beyond[0])
        if k == 0:
            return 0.0
        share = (least - progress[k - 1]) / (progress[k] - progress[k - 1])
        return float(fine[k - 1] + share * (fine[k] - fine[k - 1]))
