"""Argoverse 1 (.csv) and 2 (.parquet) scenarios as planning problems: the recording vehicle goes on where it is going.

The traffic is predicted by the constant-velocity baseline from what was observed until then; no recorded future of it
enters a scenario.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from checkers import GaussianMixturePrediction, InputError, Prediction
from predictor import ConstantVelocity, Recording, Track, open_data
from predictor.datasets.motion import MOVING
from predictor.roads import Road
from predictor.tracks import SLACK
from riskplan.io.commonroad import LANE_TOLERANCE, LONGEST_PIECE, PROGRESS, TURN_OF_PIECE, CommonRoadScene, Problem
from riskplan.scene import GoalRegion, Scenario, State
from riskplan.vehicles.kinematic_car import KinematicCar

HORIZON = 3.0
# the observed part of an Argoverse 2 scenario is 5 s, of steps 0 to 49
PRESENT = 4.9
# a standing ego is asked to get going: least way to the goal, and half the goal's width [m]
LEAST_WAY, HALF_WIDTH = 10.0, 5.0
# a recorded way shorter than this does not tell which lanes it leads along [m]
LEAST_PROGRESS = 1.0
# vehicles at least as fast tell a direction [m/s]
GUIDING = 2.0


def load_argoverse(path: str | Path) -> Scenario:
    """The scene 3 s on from the last observed step.

    The ego starts as the AV was observed. Its goal at 3 s is at least 90 % of its way, and 10 m at least, within 15° of
    the direction. Where there is a map, that is the way it was recorded to make, and the goal is on lanes that lead on
    from it; else the way it would make at its speed, and the goal is a strip 10 m wide straight ahead.

    Argoverse 1 has no map here, so anywhere is drivable. It states no headings either, and in half of its scenarios the
    AV stands: such an ego is taken to be headed like the vehicle that passed nearest, which the scenario's name tells.

    Raises:
        InputError: one line that names the file: not readable, no AV at the present, or one that stands where nobody
            moves.
    """
    kind = "argoverse1" if Path(path).suffix.lower() == ".csv" else "argoverse2"
    (recording,) = open_data(path, kind).recordings()
    try:
        if kind == "argoverse1":
            return scenario_of(recording, present=0.0, headings_stated=False)
        return scenario_of(recording, present=PRESENT, headings_stated=True)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def scenario_of(recording: Recording, present: float, headings_stated: bool) -> Scenario:
    """A recording with an ego as a planning problem of `HORIZON` s that starts at `present` on its clock [s].

    Without `headings_stated` they come from motion, and who never moved has none: the spread is then the larger one on
    every side.

    Raises:
        InputError: no ego, or not observed then.
    """
    own = next((t for t in recording.tracks if t.name == recording.ego), None)
    if own is None or not own.covers(present, present):
        raise InputError(f"ego: expected a track of the recording vehicle at {present:g} s, got none")
    now = own.until(present)
    (x, y), heading = now.positions[-1], float(now.headings[-1])
    name = f"argoverse {recording.name}"
    if not headings_stated and _never_moved(own, present):
        guide = _nearest_moving(recording, now, present)
        heading, name = guide.direction, f"{name}, standing, headed as track {guide.name}"
    start = State(float(x), float(y), heading, max(float(now.speeds[-1]), 0.0))
    road = Road(recording.lanes)
    regions = _along_the_lanes(road, own, start, present) or [_ahead(start)]
    others = tuple(t for t in recording.tracks if t is not own)
    problem = Problem(start, present, tuple(regions), (HORIZON, HORIZON))
    scene = CommonRoadScene(name, recording.dt, road, (), others, (problem,)).scenario(
        0, predictor=ConstantVelocity.fitted()
    )
    unknown = set() if headings_stated else {t.name for t in others if _never_moved(t, present)}
    agents = tuple(_without_heading(a) if a.name in unknown else a for a in scene.agents)
    # in towns traffic crosses: the shape must hold at any heading
    return replace(scene, ego=scene.vehicle.shape(), agents=agents)


def _never_moved(track: Track, present: float) -> bool:
    return bool(np.all(np.abs(track.speeds[track.times <= present + SLACK]) < MOVING))


def _without_heading(agent: Prediction) -> Prediction:
    if not isinstance(agent, GaussianMixturePrediction):
        return agent
    widest = np.linalg.eigvalsh(agent.covariances)[..., -1]
    return replace(agent, headings=None, covariances=widest[..., None, None] * np.eye(2))


class _Guide(NamedTuple):
    name: str
    direction: float


def _nearest_moving(recording: Recording, own: Track, present: float) -> _Guide:
    """The vehicle whose observed way passed nearest to where `own` stands, and its direction there."""
    nearest, guide = np.inf, None
    for track in recording.tracks:
        seen = track.times <= present + SLACK
        moving = seen & (np.abs(track.speeds) >= GUIDING)
        if track.name != own.name and moving.any():
            apart = np.where(moving, np.hypot(*(track.positions - own.positions[-1]).T), np.inf)
            if apart.min() < nearest:
                nearest, guide = float(apart.min()), _Guide(track.name, float(track.headings[apart.argmin()]))
    if guide is None:
        raise InputError("ego: it stood still throughout and nobody moved, so its heading is not known")
    return guide


def _way(start: State) -> float:
    return max(PROGRESS * start.speed * HORIZON, LEAST_WAY)


def _reach(start: State) -> float:
    return start.speed * HORIZON + KinematicCar().max_acceleration * HORIZON**2 / 2


def _ahead(start: State) -> GoalRegion:
    """A strip straight ahead."""
    c, s = np.cos(start.heading), np.sin(start.heading)
    near, far = _way(start), max(_reach(start), _way(start) + 1.0)
    corners = np.array([[near, -HALF_WIDTH], [far, -HALF_WIDTH], [far, HALF_WIDTH], [near, HALF_WIDTH]])
    return GoalRegion(corners @ [[c, s], [-s, c]] + (start.x, start.y), start.heading, LANE_TOLERANCE)


def _along_the_lanes(road: Road, own: Track, start: State, present: float) -> Sequence[GoalRegion]:
    """Pieces of lanes along the recorded way of the ego; none without a map, a recorded way, or a lane at its end."""
    if not road.lanes or not own.covers(present, present + HORIZON):
        return ()
    driven = own.window(present, present + HORIZON)
    progress = float(np.hypot(*np.diff(driven.positions, axis=0).T).sum())
    if progress < LEAST_PROGRESS:
        return ()
    pieces = road.pieces_ahead(
        driven.positions,
        float(driven.headings[-1]),
        share=max(PROGRESS, LEAST_WAY / progress),
        reach=_reach(start),
        tolerance=LANE_TOLERANCE,
        longest=LONGEST_PIECE,
        turn=TURN_OF_PIECE,
    )
    return [GoalRegion(p, h, LANE_TOLERANCE) for p, h in pieces]
