"""The roads: highway-env's networks, with sizes drawn anew for each scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from highway_env.envs.intersection_env import IntersectionEnv
from highway_env.envs.merge_env import MergeGenericEnv
from highway_env.envs.roundabout_env import RoundaboutGenericEnv
from highway_env.road.lane import CircularLane, StraightLane
from highway_env.road.road import LaneIndex, Road, RoadNetwork

from checkers.validate import Array
from predictor.lanes import Lane

SPACING = 2.0


@dataclass(frozen=True, eq=False)
class Place:
    """Where a scene happens.

    Attributes:
        road: without vehicles.
        entries: lanes vehicles start on.
        exits: nodes they may want to reach; empty: they follow the road.
        reach: how far along the entries they start [m].
        gaps: (least, most) between them at the start [m].
        arrivals: vehicles per second and entry that come later.
        limit: speed limit [m/s].
    """

    road: Road
    entries: tuple[LaneIndex, ...]
    exits: tuple[str, ...]
    reach: float
    gaps: tuple[float, float]
    arrivals: float
    limit: float


def highway(rng: np.random.Generator) -> Place:
    """Two to five lanes, straight."""
    lanes = int(rng.integers(2, 6))
    road = _road(RoadNetwork.straight_road_network(lanes, length=1400.0), rng)
    entries = tuple(("0", "1", i) for i in range(lanes))
    return Place(road, entries, (), 200.0, _gaps(rng), 0.0, float(rng.uniform(15.0, 33.0)))


def merge(rng: np.random.Generator) -> Place:
    """A ramp that joins one to three lanes and ends."""
    lanes = int(rng.integers(1, 4))
    config = {"lanes_count": lanes, "vehicles_count": 0, "after_merge_length": 300}
    found = MergeGenericEnv(config).road
    road = _road(found.network, rng)
    for thing in found.objects:
        thing.road = road
        road.objects.append(thing)
    entries = (*(("a", "b", i) for i in range(lanes)), ("j", "k", 0))
    return Place(road, entries, (), 140.0, _gaps(rng), float(rng.uniform(0.1, 0.4)), float(rng.uniform(15.0, 28.0)))


def intersection(rng: np.random.Generator) -> Place:
    """Four arms, two of them with the right of way."""
    road = _road(IntersectionEnv({"initial_vehicle_count": 1}).road.network, rng)
    entries = tuple((f"o{i}", f"ir{i}", 0) for i in range(4))
    exits = tuple(f"o{i}" for i in range(4))
    return Place(
        road, entries, exits, 90.0, (15.0, 60.0), float(rng.uniform(0.05, 0.25)), float(rng.uniform(8.0, 14.0))
    )


def roundabout(rng: np.random.Generator) -> Place:
    """Four arms, one or two lanes around; those inside have the right of way."""
    config = {
        "roundabout_radius": float(rng.uniform(15.0, 30.0)),
        "roundabout_lanes": int(rng.integers(1, 3)),
        "vehicles_count": 0,
    }
    road = _road(RoundaboutGenericEnv(config).road.network, rng)
    for lane in road.network.lanes_list():
        lane.priority = 1 if isinstance(lane, CircularLane) else 0
    sides = "senw"
    entries = tuple((f"{side}er", f"{side}es", 0) for side in sides)
    exits = tuple(f"{side}xr" for side in sides)
    return Place(road, entries, exits, 80.0, (15.0, 60.0), float(rng.uniform(0.05, 0.3)), float(rng.uniform(8.0, 14.0)))


MAPS: dict[str, Callable[[np.random.Generator], Place]] = {
    "highway": highway,
    "merge": merge,
    "intersection": intersection,
    "roundabout": roundabout,
}


def lanes_of(network: RoadNetwork) -> tuple[Lane, ...]:
    """The network's lanes, y upwards."""
    by_index = network.lanes_dict()
    ends = {index: (lane.position(0.0, 0.0), lane.position(lane.length, 0.0)) for index, lane in by_index.items()}
    lanes = []
    for index, lane in by_index.items():
        following = [i for i in by_index if i[0] == index[1] and np.hypot(*(ends[i][0] - ends[index][1])) < 2.5]
        centre, left, right = (_line(lane, side) for side in (0.0, -0.5, 0.5))
        beside = network.side_lanes(index)
        lanes.append(Lane(_name(index), centre, left, right, tuple(map(_name, following)), tuple(map(_name, beside))))
    return tuple(lanes)


def _line(lane: Any, side: float) -> Array:
    """Points along the lane at `side` widths from its middle."""
    count = 1 if type(lane) is StraightLane else max(1, round(lane.length / SPACING))
    stations = np.linspace(0.0, lane.length, count + 1)
    points: Array = np.array([lane.position(s, side * lane.width_at(s)) for s in stations]) * [1.0, -1.0]
    return points


def _name(index: LaneIndex) -> str:
    return f"{index[0]}-{index[1]}-{index[2]}"


def _gaps(rng: np.random.Generator) -> tuple[float, float]:
    least = float(rng.uniform(12.0, 30.0))
    return least, least + float(rng.uniform(10.0, 60.0))


def _road(network: RoadNetwork, rng: np.random.Generator) -> Road:
    for lane in network.lanes_list():
        lane.speed_limit = None  # drivers know it, and differ about it
    return Road(network, np_random=rng, neighbour_vehicles_connected_lanes=True)
