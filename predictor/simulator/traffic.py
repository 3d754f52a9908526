"""A scene in motion: vehicles enter, drive, give way, and leave."""

from __future__ import annotations

from collections import defaultdict
from typing import Any

import numpy as np
import shapely

from checkers.validate import Array
from predictor.recordings import Recording
from predictor.simulator.drivers import Driver
from predictor.simulator.maps import MAPS, Place, lanes_of
from predictor.tracks import Track

DT = 0.1
# unrecorded steps at the start, until nobody remembers where it was put
WARM_UP = 30
# steps between looks at who gives way, for how many seconds, and how far ahead
LOOK, GIVE_WAY = 2, 0.5
AHEAD: Array = np.arange(0.25, 3.1, 0.25)
# predicted centres closer than this are in conflict [m], oncoming lanes are 4 m apart; vehicles of about one direction
# follow each other instead
CONFLICT, SAME_WAY = 3.5, float(np.radians(30))
# who is closer than this to the conflict goes through; who gives way stops half of it before [m]
COMMITTED = 7.0


def simulated(name: str, kind: str, steps: int, rng: np.random.Generator) -> Recording:
    """A recording of `steps` observations at 10 Hz on a map of a `kind`, with the vehicles' true controls."""
    place = MAPS[kind](rng)
    _populate(place, rng)
    states: dict[str, list[Array]] = defaultdict(list)
    controls: dict[str, list[Array]] = defaultdict(list)
    begin: dict[str, int] = {}
    drivers: dict[str, Driver] = {}
    names: dict[int, str] = {}
    for step in range(WARM_UP + steps):
        if step % LOOK == 0:
            _give_way(place.road.vehicles)
        present = list(place.road.vehicles)
        if step >= WARM_UP:
            for driver in present:
                label = names.setdefault(id(driver), f"v{len(names)}")
                drivers[label] = driver
                begin.setdefault(label, step - WARM_UP)
                states[label].append(np.array([*driver.position, driver.heading, driver.speed]))
        place.road.act()
        for driver in present:
            driver.step(DT)
            if step >= WARM_UP:
                controls[names[id(driver)]].append(driver.control)
        _leave(place)
        _arrive(place, rng)
    tracks = tuple(_track(label, begin[label], np.array(rows), drivers[label]) for label, rows in states.items())
    # mirrored like the positions
    acted = {label: np.array(rows) * [1.0, -1.0] for label, rows in controls.items()}
    return Recording(name, DT, tracks, lanes_of(place.road.network), acted)


def _track(label: str, begin: int, rows: Array, driver: Driver) -> Track:
    times: Array = np.arange(begin, begin + len(rows)) * np.float64(DT)
    return Track(
        label, times, rows[:, :2] * [1.0, -1.0], -rows[:, 2], rows[:, 3], driver.LENGTH, driver.WIDTH, driver.body
    )


def _populate(place: Place, rng: np.random.Generator) -> None:
    for entry in place.entries:
        length = place.road.network.get_lane(entry).length
        station = float(rng.uniform(5.0, 30.0))
        while station < min(place.reach, length - 5.0):
            place.road.vehicles.append(_driver(place, entry, station, rng))
            station += float(rng.uniform(*place.gaps)) + place.road.vehicles[-1].LENGTH


def _arrive(place: Place, rng: np.random.Generator) -> None:
    for entry in place.entries:
        if rng.random() < place.arrivals * DT:
            lane = place.road.network.get_lane(entry)
            ahead = [lane.local_coordinates(v.position)[0] for v in place.road.vehicles if v.lane_index == entry]
            if min(ahead, default=np.inf) > 15.0 + 0.8 * place.limit:
                place.road.vehicles.append(_driver(place, entry, 3.0, rng))


def _driver(place: Place, entry: tuple[str, str, int], station: float, rng: np.random.Generator) -> Driver:
    # a generator of its own: what one driver draws does not depend on how many others there are
    driver = Driver(place.road, entry, station, place.limit, np.random.default_rng(rng.integers(2**63)))
    if place.exits:
        others = [e for e in place.exits if e[0:1] != entry[0][0:1] or (e[1:2].isdigit() and e != entry[0])]
        driver.plan_route_to(others[int(rng.integers(len(others)))])
    return driver


def _leave(place: Place) -> None:
    """Take away who has arrived, is off the road or has run into somebody."""
    vehicles = place.road.vehicles
    gone = {id(v) for v in vehicles if v.arrived or v.astray}
    positions = np.array([v.position for v in vehicles]).reshape(-1, 2)
    reach = np.array([v.diagonal for v in vehicles]) / 2
    apart = np.hypot(*np.moveaxis(positions[:, None] - positions, -1, 0))
    for i, j in np.argwhere(np.triu(apart < reach[:, None] + reach, 1)):
        # highway-env's own test looks at corners only and misses boxes that cross
        if _box(vehicles[i]).intersects(_box(vehicles[j])):
            gone |= {id(vehicles[i]), id(vehicles[j])}
    place.road.vehicles = [v for v in vehicles if id(v) not in gone]


def _box(driver: Driver) -> Any:
    c, s = np.cos(driver.heading), np.sin(driver.heading)
    corners = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * [driver.LENGTH / 2, driver.WIDTH / 2]
    return shapely.Polygon(corners @ [[c, s], [-s, c]] + driver.position)


def _give_way(drivers: list[Driver]) -> None:
    """Of two whose ways are about to cross at one time, the one of lower priority brakes, or who is farther away."""
    if len(drivers) < 2:
        return
    at = np.array([d.position for d in drivers])
    heading, speed = (np.array([getattr(d, name) for d in drivers])[:, None] for name in ("heading", "speed"))
    turn = heading + np.array([d.control[1] for d in drivers])[:, None] * AHEAD / 2
    coming = at[:, None] + (speed * AHEAD)[..., None] * np.stack([np.cos(turn), np.sin(turn)], -1)
    apart = np.hypot(*np.moveaxis(coming[:, None] - coming, -1, 0))
    crossing = np.abs(np.angle(np.exp(1j * (heading - heading.T)))) > SAME_WAY
    for i, j in np.argwhere(np.triu((apart.min(axis=-1) < CONFLICT) & crossing, 1)):
        step = int(apart[i, j].argmin())
        meeting = (coming[i, step] + coming[j, step]) / 2
        way = {k: float(np.hypot(*(at[k] - meeting))) for k in (i, j)}
        order = sorted((i, j), key=lambda k: (drivers[k].lane.priority, -way[k]))
        if way[order[0]] <= COMMITTED:  # too late to give way, unless the other is even closer
            order.sort(key=lambda k: -way[k])
        drivers[order[0]].give_way(GIVE_WAY, way[order[0]] - COMMITTED / 2)
