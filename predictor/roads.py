"""The lanes of a map together: the surface they cover, and which of them lead on from a path driven."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import shapely

from checkers.validate import Array
from predictor.lanes import Lane

# maps leave slits up to this width [m] between lanes of one road; islands and verges are wider
HAIRLINE = 0.3
# a piece of lane that turns away more than this from the corridor [rad] leads elsewhere
SAME_WAY = np.pi / 4


@dataclass(frozen=True, eq=False)
class Road:
    """A map of lanes."""

    lanes: tuple[Lane, ...]

    @cached_property
    def surface(self) -> tuple[Array, ...]:
        """Polygons (N, 2), at least one per lane, whose union has no hairline gaps between lanes."""
        grown = [shapely.make_valid(shapely.Polygon(lane.outline)) for lane in self.lanes]
        grown = [part.buffer(HAIRLINE / 2, join_style="mitre") for part in grown]
        closed = shapely.unary_union(grown).buffer(-HAIRLINE / 2, join_style="mitre")
        # pieces overlap by the hairline, so rounding cannot open a slit between them again
        clipped = (part.intersection(closed) for part in grown)
        return tuple(np.asarray(p.exterior.coords)[:-1] for part in clipped for p in polygons(part))

    @cached_property
    def area(self) -> Any:
        """The surface as one prepared shapely geometry."""
        area = shapely.unary_union([shapely.Polygon(p) for p in self.surface])
        shapely.prepare(area)
        return area

    def pieces_ahead(
        self,
        path: Array,
        heading: float,
        *,
        share: float,
        reach: float,
        tolerance: float,
        longest: float,
        turn: float,
    ) -> list[tuple[Array, float]]:
        """Lane pieces (polygon, heading) at least `share` as far along as `path` (T, 2) went.

        Progress is the arclength along the corridor of lanes the path ended on; pieces of other lanes, to
        which one can get along lanes and by changing them, count by their projection onto it.

        Args:
            path: positions driven [m]; its end must lie on a lane.
            heading: at its end [rad], within `tolerance` [rad] of that lane's direction.
            share: of the path's own progress.
            reach: pieces farther than this from the path's first position are left out [m].
            tolerance: [rad].
            longest, turn: limits of a piece, as in `Lane.cut`.
        """
        chain = self._corridor(path, heading, tolerance, reach)
        if not chain:
            return []
        line = _extended(np.concatenate([lane.centre for lane in chain]), reach)
        begin, end = shapely.line_locate_point(line, shapely.points(path[[0, -1]]))
        least = float(begin + share * max(end - begin, 0.0))
        cuts = [lane.cut(lane.station(line, least), longest, turn) for lane in self._connected(chain, path[0], reach)]
        pieces = [piece for cut in cuts for piece in cut]
        start = shapely.Point(path[0])
        return [(p, h) for p, h in pieces if _same_way(line, p, h) and shapely.Polygon(p).distance(start) <= reach]

    @cached_property
    def _outlines(self) -> Any:
        return shapely.make_valid(np.array([shapely.Polygon(lane.outline) for lane in self.lanes], dtype=object))

    @cached_property
    def _by_name(self) -> dict[str, Lane]:
        return {lane.name: lane for lane in self.lanes}

    def _lane_at(self, position: Array, heading: float, tolerance: float) -> Lane | None:
        inside = np.flatnonzero(shapely.intersects(self._outlines, shapely.Point(position)))
        turns = {i: abs(turned(self.lanes[i].direction_at(position) - heading)) for i in inside}
        best = min(turns, key=turns.__getitem__, default=None)
        return None if best is None or turns[best] > tolerance else self.lanes[best]

    def _corridor(self, path: Array, heading: float, tolerance: float, reach: float) -> list[Lane]:
        """Lanes one after the other through the path's end, from behind its start to `reach` beyond."""
        last = self._lane_at(path[-1], heading, tolerance)
        if last is None:
            return []
        chain, driven = [last], shapely.LineString(path)
        while sum(lane.stations[-1] for lane in chain[:-1]) < driven.length:
            before = [lane for lane in self.lanes if chain[0].name in lane.successors and lane not in chain]
            if not before:
                break
            chain.insert(0, min(before, key=lambda lane: driven.distance(_middle(lane))))
        ahead = 0.0
        while ahead < reach:
            after = [self._by_name[n] for n in chain[-1].successors if n in self._by_name]
            after = [lane for lane in after if lane not in chain]
            if not after:
                break
            onward = chain[-1].directions[-1]
            chain.append(min(after, key=lambda lane: abs(turned(lane.directions[-1] - onward))))
            ahead += float(chain[-1].stations[-1])
        return chain

    def _connected(self, chain: Sequence[Lane], position: Array, reach: float) -> list[Lane]:
        """The chain and every lane one can get to from it along lanes and by changing them, within reach."""
        start = shapely.Point(position)
        found: dict[str, Lane] = {}
        todo = list(chain)
        while todo:
            lane = todo.pop()
            if lane.name in found or shapely.LineString(lane.centre).distance(start) > reach:
                continue
            found[lane.name] = lane
            todo += [self._by_name[n] for n in (*lane.successors, *lane.neighbours) if n in self._by_name]
        return list(found.values())


def polygons(shape: Any) -> list[Any]:
    """The polygons, of more than a speck, that a shapely geometry is made of."""
    parts = shapely.get_parts(shapely.get_parts(shape))
    return [p for p in parts if p.geom_type == "Polygon" and p.area > 1e-6]


def turned(angle: float) -> float:
    """An angle in (−π, π]."""
    return float(np.angle(np.exp(1j * angle)))


def _same_way(line: Any, polygon: Array, heading: float) -> bool:
    middle = line.project(shapely.Point(polygon.mean(axis=0)))
    a, b = (np.asarray(line.interpolate(middle + d).coords[0]) for d in (-0.5, 0.5))
    along = np.arctan2(*(b - a)[::-1])
    return abs(turned(heading - along)) < SAME_WAY


def _middle(lane: Lane) -> Any:
    return shapely.Point(lane.centre[len(lane.centre) // 2])


def _extended(points: Array, by: float) -> Any:
    """A line with its ends drawn out straight [m], so that nothing beside it projects onto an end point."""
    points = points[np.concatenate([[True], np.hypot(*np.diff(points, axis=0).T) > 1e-6])]
    first, last = points[0] - points[1], points[-1] - points[-2]
    ends = points[0] + by * first / np.hypot(*first), points[-1] + by * last / np.hypot(*last)
    return shapely.LineString(np.concatenate([[ends[0]], points, [ends[1]]]))
