"""A road map as a predictor sees it: the points of centre lines near each target."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from checkers.validate import Array
from predictor.lanes import Lane

RADIUS = 50.0
SPACING = 5.0
MOST = 128


@dataclass(frozen=True, eq=False)
class LanePoints:
    """Centre lines as points.

    Attributes:
        points: (M, 2), evenly along each lane [m].
        headings: (M,) driving direction [rad].
    """

    points: Array
    headings: Array

    @classmethod
    def of(cls, lanes: Sequence[Lane], spacing: float = SPACING) -> LanePoints:
        """The lanes' centre lines, points about `spacing` [m] apart."""
        points, headings = [np.zeros((0, 2))], [np.zeros(0)]
        for lane in lanes:
            stations = lane.stations
            count = max(1, round(stations[-1] / spacing))
            # in the middle of each piece: where one lane ends and the next begins there is not a double point
            at = (np.arange(count) + 0.5) * stations[-1] / count
            segment = np.clip(np.searchsorted(stations, at, side="right") - 1, 0, len(stations) - 2)
            points.append(np.column_stack([np.interp(at, stations, lane.centre[:, i]) for i in range(2)]))
            headings.append(lane.directions[segment])
        return cls(np.concatenate(points), np.concatenate(headings))

    def near(self, positions: Array, most: int = MOST, radius: float = RADIUS) -> tuple[Array, Array]:
        """The `most` nearest points within `radius` [m] of each of `positions` (N, 2).

        Returns:
            (N, most, 2) points, nearest first, and (N, most) headings, padded with NaN.
        """
        points, headings = np.full((len(positions), most, 2), np.nan), np.full((len(positions), most), np.nan)
        count = min(most, len(self.points))
        if not count or not len(positions):
            return points, headings
        distance = (self.points[:, 0] - positions[:, :1]) ** 2 + (self.points[:, 1] - positions[:, 1:]) ** 2
        nearest = np.sort(np.argpartition(distance, count - 1, axis=1)[:, :count], axis=1)  # sorting all costs most
        some = np.take_along_axis(distance, nearest, axis=1)
        order = np.argsort(some, axis=1, kind="stable")
        nearest = np.take_along_axis(nearest, order, axis=1)
        inside = (np.take_along_axis(some, order, axis=1) <= radius**2)[..., None]
        points[:, :count] = np.where(inside, self.points[nearest], np.nan)
        headings[:, :count] = np.where(inside[..., 0], self.headings[nearest], np.nan)
        return points, headings
