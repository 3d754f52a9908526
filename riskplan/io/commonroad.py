"""CommonRoad scenes (2018b, 2020a): roads, recorded traffic and planning problems, as `Scenario`s.

The recorded future of the traffic never enters a scenario: agents are predicted from `Track.until(now)` only.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from checkers import EgoCover, GaussianMixturePrediction, InputError
from checkers.validate import Array, as_scalar
from predictor import ConstantVelocity, Manoeuvres, Track
from predictor.io_commonroad import lanes_of, number, one_line, open_commonroad, point, tracks_of
from predictor.roads import Road, polygons, turned
from riskplan.scene import Goal, GoalRegion, Scenario, State
from riskplan.vehicles import Vehicle
from riskplan.vehicles.kinematic_car import KinematicCar

# grid times are floats: a window given in whole steps is widened by this [s]
SLACK = 1e-6
PAST = 2.0
MIN_SPEED = 2.0
AGENT_RANGE = 100.0
LANE_TOLERANCE = float(np.radians(15))
PROGRESS = 0.9
LONGEST_PIECE = 10.0
MOST_STATES = 2_000_000
TURN_OF_PIECE = float(np.radians(5))


Predictor = ConstantVelocity | Manoeuvres


@dataclass(frozen=True, eq=False)
class Problem:
    """A planning problem of the file.

    Attributes:
        start: of the ego's centre.
        time: of the start, on the recording's clock [s].
        regions: goal regions; None stands for anywhere.
        window: (earliest, latest) arrival [s] from the start.
    """

    start: State
    time: float
    regions: tuple[GoalRegion | None, ...]
    window: tuple[float, float]


@dataclass(frozen=True, eq=False)
class HorizonTask:
    """A recorded vehicle replaced by the planner for a few seconds.

    Attributes:
        scenario: what is planned for.
        driver: the replaced vehicle's recorded states from time 0 to the horizon, for judging only.
        others: the same of each agent, in the agents' order; shorter where one leaves the recording.
        t0: the start on the recording's clock [s].
    """

    scenario: Scenario
    driver: Track
    others: tuple[Track, ...]
    t0: float


@dataclass(frozen=True, eq=False)
class CommonRoadScene:
    """A CommonRoad file.

    Attributes:
        name: benchmark id.
        dt: time step [s].
        road: the lanelets; `road.lanes` have centre lines, bounds and outlines, `road.surface` is drivable.
        obstacles: static obstacles as polygons (N, 2) [m].
        tracks: recorded dynamic obstacles.
        problems: planning problems, in the file's order.
    """

    name: str
    dt: float
    road: Road
    obstacles: tuple[Array, ...]
    tracks: tuple[Track, ...]
    problems: tuple[Problem, ...]

    def scenario(
        self, problem: int = 0, vehicle: Vehicle | None = None, predictor: Predictor | None = None
    ) -> Scenario:
        """The file's planning problem over its own horizon, the traffic predicted from what its start knows.

        A goal without a position is anywhere; several goal states share one time window, from the earliest to
        the latest. The file names no ego vehicle: `vehicle` defaults to `KinematicCar()`. `predictor` is
        `Manoeuvres.fitted()` if not given.
        """
        if not 0 <= problem < len(self.problems):
            raise InputError(f"problem: expected 0 to {len(self.problems) - 1}, got {problem!r}")
        chosen = self.problems[problem]
        if not chosen.regions:
            raise InputError(f"problem: {self.name} states no goal for problem {problem}")
        vehicle = vehicle or KinematicCar()
        start, latest = chosen.start, chosen.window[1]
        reach = _reach(start.speed, latest, vehicle)
        present = self._present(chosen.time)
        near = [p for p in present if _distance(p, start) <= reach + abs(float(p.speeds[-1])) * latest]
        steps = round(latest / self.dt)
        if steps * max(len(near), 1) > MOST_STATES:
            raise InputError(
                f"time: expected at most {MOST_STATES} steps of all agents, got {steps} of {len(near)} each"
            )
        agents = self._predict(near, present, steps, predictor, start, vehicle, chosen.time)
        return self._scenario(start, vehicle, steps, agents, chosen.regions, chosen.window, self.name)

    def horizon_task(
        self, rng: np.random.Generator, horizon: float = 3.0, predictor: Predictor | None = None
    ) -> HorizonTask | None:
        """A recorded vehicle, drawn by `rng`, to be driven better than its driver for `horizon` s.

        Goal: at exactly `horizon` a state on a lane, within 15 degrees of its direction, at least 90 % as far
        along as the recorded driver then was. Vehicles need 2 s of past, `horizon` s of future, 2 m/s, a body
        on the road at the start, and an end that meets their own goal. None if the file has none. `predictor` as in
        `scenario`.
        """
        steps = round(horizon / self.dt)
        if steps < 1 or abs(steps * self.dt - horizon) > SLACK:
            raise InputError(f"horizon: expected a whole number of steps of {self.dt:g} s, got {horizon:g} s")
        for track, time in self._candidates(rng, horizon):
            task = self._task(track, time, steps, predictor)
            if task is not None:
                return task
        return None

    def _present(self, time: float, besides: Track | None = None) -> list[Track]:
        """The pasts, up to `time`, of those observed at `time`: nothing later leaves this function."""
        seen = [t for t in self.tracks if t is not besides and t.covers(time, time)]
        return [past for past in (t.until(time) for t in seen) if past.times[-1] >= time - SLACK]

    def _scenario(
        self,
        start: State,
        vehicle: Vehicle,
        steps: int,
        agents: Sequence[GaussianMixturePrediction],
        regions: Sequence[GoalRegion | None],
        window: tuple[float, float],
        name: str,
    ) -> Scenario:
        reach = _reach(start.speed, steps * self.dt, vehicle)
        box = shapely.box(start.x - reach, start.y - reach, start.x + reach, start.y + reach)
        near = [p for p in self.road.surface if box.intersects(shapely.Polygon(p))]
        lanes = [lane.centre for lane in self.road.lanes if box.intersects(shapely.LineString(lane.centre))]
        if self.road.surface and not near:
            raise InputError(f"{name}: start ({start.x:g}, {start.y:g}) has no lanelet within reach")
        road = shapely.MultiPoint(np.concatenate([*near, [[start.x, start.y]]])) if near else box
        field = box.intersection(shapely.box(*road.bounds).buffer(1.0, join_style="mitre"))
        if not field.area > 0:
            raise InputError(f"{name}: start ({start.x:g}, {start.y:g}) leaves no room to move in")
        bounds = field.bounds
        anywhere = GoalRegion(np.asarray(shapely.box(*bounds).exterior.coords)[:-1])
        arrival = (max(window[0] - SLACK, 0.0), window[1] + SLACK)
        return Scenario(
            start=start,
            goal=Goal(tuple(r or anywhere for r in regions), arrival),
            bounds=bounds,
            obstacles=tuple(p for p in self.obstacles if box.intersects(shapely.Polygon(p))),
            agents=tuple(agents),
            ego=EgoCover.discs(*vehicle.body, 6, relative_heading=0.0),
            vehicle=vehicle,
            time_step=self.dt,
            horizon=steps * self.dt,
            drivable=tuple(near),
            lanes=tuple(lanes),
            name=name,
        )

    def _predict(
        self,
        pasts: Sequence[Track],
        present: Sequence[Track],
        steps: int,
        predictor: Predictor | None,
        start: State,
        vehicle: Vehicle,
        time: float,
    ) -> list[GaussianMixturePrediction]:
        """`pasts` predicted, who see all that are `present` and the ego where they were last observed."""
        times = np.arange(steps + 1) * self.dt
        chosen = predictor or Manoeuvres.fitted()
        if isinstance(chosen, ConstantVelocity):
            return [chosen.predict(past, times) for past in pasts]
        ego = Track(
            "ego",
            np.array([time]),
            np.array([[start.x, start.y]]),
            np.array([start.heading]),
            np.array([start.speed]),
            *vehicle.body,
        )
        return [chosen.predict(past, times, self.road.lanes, [ego, *present]) for past in pasts]

    def _candidates(self, rng: np.random.Generator, horizon: float) -> Iterator[tuple[Track, float]]:
        pairs = []
        for track in self.tracks:
            left = track.times[-1] - track.times
            enough = (track.times - track.times[0] >= PAST - SLACK) & (left >= horizon - SLACK)
            times = track.times[enough & (track.speeds >= MIN_SPEED)]
            pairs += [(track, float(t)) for t in times]
        for i in rng.permutation(len(pairs)):
            yield pairs[i]

    def _task(self, track: Track, time: float, steps: int, predictor: Predictor | None = None) -> HorizonTask | None:
        grid = np.arange(steps + 1) * self.dt
        driver = track.window(time, time + grid[-1]).at(grid)
        body = _rectangle(driver.positions[0], driver.headings[0], track.length, track.width)
        if not self.road.area.contains(body):
            return None
        vehicle = KinematicCar(length=track.length, width=track.width)
        pieces = self.road.pieces_ahead(
            driver.positions,
            float(driver.headings[-1]),
            share=PROGRESS,
            reach=_reach(float(driver.speeds[0]), float(grid[-1]), vehicle),
            tolerance=LANE_TOLERANCE,
            longest=LONGEST_PIECE,
            turn=TURN_OF_PIECE,
        )
        regions = [GoalRegion(polygon, heading, LANE_TOLERANCE) for polygon, heading in pieces]
        if not any(_satisfied(r, driver.positions[-1], driver.headings[-1]) for r in regions):
            return None
        x, y = map(float, driver.positions[0])
        start = State(x, y, float(driver.headings[0]), float(driver.speeds[0]))
        present = self._present(time, besides=track)
        pasts = [p for p in present if _distance(p, start) < AGENT_RANGE]
        window = (float(grid[-1]), float(grid[-1]))
        name = f"{self.name} vehicle {track.name} at {time:g} s"
        agents = self._predict(pasts, present, steps, predictor, start, vehicle, time)
        scenario = self._scenario(start, vehicle, steps, agents, regions, window, name)
        recorded = {t.name: t for t in self.tracks}
        others = tuple(recorded[p.name].window(time, time + grid[-1]) for p in pasts)
        return HorizonTask(scenario, driver, others, time)


def load_commonroad(path: str | Path) -> CommonRoadScene:
    """Read a CommonRoad XML file.

    Raises:
        InputError: one line that names the file: missing, malformed, no CommonRoad, no planning problem, or a
            value that makes no sense.
    """
    recorded, problem_set = open_commonroad(path)
    problems = list(problem_set.planning_problem_dict.values())
    if not problems:
        raise InputError(f"{path}: no planning problem")
    road = Road(lanes_of(recorded, path))
    try:
        static = [o.occupancy_at_time(o.initial_state.time_step) for o in recorded.static_obstacles]
        obstacles = [r.polygon for o in static for r in _regions(o, None, np.pi, (0.0, np.inf))]
        dt = float(recorded.dt)
        return CommonRoadScene(
            name=str(recorded.scenario_id),
            dt=dt,
            road=road,
            obstacles=tuple(obstacles),
            tracks=tracks_of(recorded, path),
            problems=tuple(_problem(p, dt) for p in problems),
        )
    except InputError as error:
        text = str(error)
        raise InputError(text if text.startswith(str(path)) else f"{path}: {text}") from None
    except Exception as error:  # shapes the reader lets through but nobody can use
        raise InputError(f"{path}: not a usable CommonRoad file: {one_line(error)}") from None


def _problem(problem: Any, dt: float) -> Problem:
    first = problem.initial_state
    begin = number(first.time_step)
    position = point(first.position)
    pace = as_scalar("start.speed", number(first.velocity), low=0.0)
    start = State(float(position[0]), float(position[1]), number(first.orientation), pace)
    regions: list[GoalRegion | None] = []
    windows = []
    for state in problem.goal.state_list:
        low, high = _interval(state.time_step)
        windows.append((low - begin, high - begin))
        heading, tolerance = None, np.pi
        if getattr(state, "orientation", None) is not None:
            low, high = _interval(state.orientation)
            half = ((high - low) % (2 * np.pi)) / 2
            heading, tolerance = low + half, half
        speed = (0.0, np.inf)
        if getattr(state, "velocity", None) is not None:
            low, high = _interval(state.velocity)
            speed = (max(low, 0.0), high)
        place = getattr(state, "position", None)
        regions += _regions(place, heading, tolerance, speed) if place is not None else [None]
    earliest = min((w[0] for w in windows), default=0.0)
    latest = max((w[1] for w in windows), default=0.0)
    return Problem(start, begin * dt, tuple(regions), (earliest * dt, latest * dt))


def _regions(place: Any, heading: float | None, tolerance: float, speed: tuple[float, float]) -> list[GoalRegion]:
    """An occupancy, of one shape or several, as regions."""
    if hasattr(place, "shape"):
        place = place.shape
    parts = getattr(place, "occupancies", None) or getattr(place, "shapes", None) or [place]
    shapes = [p for part in parts for p in polygons(shapely.make_valid(part.shapely_object))]
    rings = [np.asarray(p.exterior.coords)[:-1] for p in shapes]
    return [GoalRegion(ring, heading, tolerance, speed) for ring in rings]


def _interval(value: Any) -> tuple[float, float]:
    return (float(value.start), float(value.end)) if hasattr(value, "start") else (float(value), float(value))


def _reach(speed: float, duration: float, vehicle: Vehicle) -> float:
    """An upper bound of the distance covered, and room for the body [m]."""
    accelerating = abs(speed) * duration + vehicle.top_acceleration * duration**2 / 2
    return min(accelerating, max(vehicle.top_speed, abs(speed)) * duration) + vehicle.body[0]


def _distance(past: Track, start: State) -> float:
    return float(np.hypot(*(past.positions[-1] - (start.x, start.y))))


def _rectangle(position: Array, heading: float, length: float, width: float) -> Any:
    c, s = np.cos(heading), np.sin(heading)
    corners = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * [length / 2, width / 2]
    return shapely.Polygon(corners @ [[c, s], [-s, c]] + position)


def _satisfied(region: GoalRegion, position: Array, heading: float) -> bool:
    right_way = region.heading is None or abs(turned(heading - region.heading)) <= region.heading_tolerance
    return right_way and bool(shapely.Polygon(region.polygon).covers(shapely.Point(position)))
