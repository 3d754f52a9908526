"""What surrounds an agent, as seen from it: who drives ahead and beside, and how its lane runs on."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import shapely

from checkers.validate import Array
from predictor.lanes import Lane
from predictor.tracks import SLACK, Track

FARTHEST = 100.0
# a lane's direction may differ from the agent's heading by this [rad], another agent's heading by twice as much
ALONG = np.pi / 8
BESIDE = 3.5
# a body beside blocks the way aside from this far behind to this far ahead of the agent's own ends [m]
MARGIN = 5.0
LOOK_AHEAD = 4.0
SHORTEST = 0.01


class Surroundings(NamedTuple):
    """Seen from one agent; what is not known is as if nothing were there.

    Attributes:
        path: (N, 2) where it gets by keeping to its lane, from its own position on [m]: the centre line shifted to it,
            and straight on where the map ends.
        drift: its heading less its lane's direction [rad].
        offset: to the left of its lane's centre line [m].
        gap: between bodies, to whom the agent would hit first going straight on [m]; infinite if nobody.
        closing: that one's speed less the agent's [m/s].
        taken: (2,) 1 where a body moves beside it, left and right.
        open: (2,) 1 where there is a lane in its direction, left and right.
    """

    path: Array
    drift: float
    offset: float
    gap: float
    closing: float
    taken: tuple[float, float]
    open: tuple[float, float]

    def course(self, distances: Array) -> tuple[Array, Array]:
        """Positions (T, 2) and directions (T,) [rad] after `distances` (T,) [m] along the path; before it, straight."""
        steps = np.diff(self.path, axis=0)
        lengths = np.hypot(steps[:, 0], steps[:, 1])
        stations = np.concatenate([[0.0], np.cumsum(lengths)])
        segment = np.clip(np.searchsorted(stations, distances, side="right") - 1, 0, len(steps) - 1)
        unit = steps / lengths[:, None]
        points = self.path[segment] + (distances - stations[segment])[:, None] * unit[segment]
        middle = 0.5 * (stations[1:] + stations[:-1])
        angles = np.unwrap(np.arctan2(unit[:, 1], unit[:, 0]))
        return points, np.interp(distances, middle, angles)


def look_around(past: Track, speed: float, lanes: Sequence[Lane] = (), others: Sequence[Track] = ()) -> Surroundings:
    """The surroundings at the end of `past`.

    Args:
        past: of the agent.
        speed: along its heading [m/s].
        lanes: of the map.
        others: what is known of other agents at that time, on the same clock; those not observed then are not there.
    """
    position, heading = past.positions[-1], float(past.headings[-1])
    now = past.times[-1]
    there = [o for o in others if o is not past and abs(o.times[-1] - now) <= SLACK]
    c, s = np.cos(heading), np.sin(heading)
    frame = np.array([[c, -s], [s, c]])
    gap, closing, taken = np.inf, 0.0, (0.0, 0.0)
    if there:
        away = (np.array([o.positions[-1] for o in there]) - position) @ frame
        turned = np.array([o.headings[-1] for o in there]) - heading
        room = (np.array([o.length for o in there]) + past.length) / 2
        wide = (np.array([o.width for o in there]) + past.width) / 2
        same = np.cos(turned) > np.cos(2 * ALONG)
        ahead = same & (away[:, 0] > 0) & (np.abs(away[:, 1]) < wide) & (away[:, 0] < FARTHEST)
        if ahead.any():
            first = int(np.where(ahead, away[:, 0] - room, np.inf).argmin())
            gap, closing = max(float(away[first, 0] - room[first]), 0.0), float(there[first].speeds[-1]) - speed
        alongside = (np.abs(away[:, 0]) < room + MARGIN) & (np.abs(away[:, 1]) >= wide)
        near = alongside & (np.abs(away[:, 1]) < wide + BESIDE)
        taken = (float((near & (away[:, 1] > 0)).any()), float((near & (away[:, 1] < 0)).any()))
    areas = np.array([lane.area for lane in lanes])
    lane = _at(position, heading, lanes, areas)
    if lane is None:
        path = position + np.array([[0.0, 0.0], [1.0, 0.0]]) @ frame.T
        return Surroundings(path, 0.0, 0.0, gap, closing, taken, (0.0, 0.0))
    aside = [_at(position + side * BESIDE * frame[:, 1], heading, lanes, areas) for side in (1, -1)]
    left, right = (float(other is not None and other is not lane) for other in aside)
    station = lane.line.project(shapely.Point(position))
    foot = np.asarray(lane.line.interpolate(station).coords[0])
    direction = lane.direction_at(position)
    drift = float(np.angle(np.exp(1j * (heading - direction))))
    offset = float((position - foot) @ [-np.sin(direction), np.cos(direction)])
    path = _onward(lane, station, max(speed, 0.0) * LOOK_AHEAD, lanes) + (position - foot)
    return Surroundings(path, drift, offset, gap, closing, taken, (left, right))


def _onward(lane: Lane, station: float, reach: float, lanes: Sequence[Lane]) -> Array:
    """(N, 2) the centre line from `station` on for `reach` [m] or to the end of the map, the straightest way."""
    by_name = {other.name: other for other in lanes}
    later = lane.stations > station + SHORTEST
    points = [np.array([lane.line.interpolate(station).coords[0]]), lane.centre[later]]
    left, seen = reach - (lane.line.length - station), {lane.name}
    while left > 0:
        after = [by_name[name] for name in lane.successors if name in by_name and name not in seen]
        if not after:
            break
        onward = lane.directions[-1]
        lane = min(after, key=lambda other: abs(float(np.sin((other.directions[-1] - onward) / 2))))
        seen.add(lane.name)
        points.append(lane.centre)
        left -= lane.line.length
    path = np.concatenate(points)
    step = np.hypot(*np.diff(path, axis=0).T)
    path = path[np.concatenate([[True], step > SHORTEST])]
    if len(path) < 2:
        direction = lane.directions[-1]
        path = np.concatenate([path, path + [np.cos(direction), np.sin(direction)]])
    return path


def _at(position: Array, heading: float, lanes: Sequence[Lane], areas: Any) -> Lane | None:
    """The lane whose direction is closest to the heading among those that contain the position."""
    if not lanes:
        return None
    inside = shapely.intersects_xy(areas, *position).nonzero()[0].tolist()
    turns = {i: np.cos(lanes[i].direction_at(position) - heading) for i in inside}
    best = max(turns, key=turns.__getitem__, default=None)
    return lanes[best] if best is not None and turns[best] > np.cos(ALONG) else None
