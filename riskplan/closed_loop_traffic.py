"""Who else is on the road in a closed loop: tracks that are shown up to the present, and true collisions with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from checkers import ControlPrediction, GaussianMixturePrediction, InputError, Prediction, persistent
from checkers.validate import Array, as_tuple
from predictor import Track
from riskplan.scene import Agent

_FINE = 10  # instants at which bodies are compared, per step of the grid
_PAST = 2.0  # seconds of past of sampled agents
_STANDING = 0.2  # [m/s]: a slower agent keeps its heading


class Predictor(Protocol):
    """Anything that predicts an agent from what was seen of it."""

    def predict(self, past: Track, times: Array) -> Prediction:
        """The agent at `times` (T,) ≥ 0 [s] after the last state of `past`."""


@dataclass(frozen=True, eq=False)
class Traffic:
    """True tracks on the simulation's clock, 0 at its start; what lies before 0 is past from the beginning.

    Attributes:
        tracks: one an agent, each while it is there.
    """

    tracks: tuple[Track, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "tracks", as_tuple("traffic", self.tracks, Track))

    def pasts(self, now: float, place: Array, distance: float) -> list[Track]:
        """The pasts, up to and including `now`, of those there now within `distance` of `place` (2,)."""
        there = [t for t in self.tracks if t.covers(now, now)]
        seen = [t.until(now) for t in there]
        return [p for p in seen if float(np.hypot(*(p.positions[-1] - place))) <= distance]

    def first_contact(
        self, start: float, dt: float, states: Array, body: tuple[float, float], disc: bool
    ) -> tuple[float, str] | None:
        """Time and name of the first agent whose rectangle meets the ego's over a stretch of states (S, 5) at `dt`.

        Between the steps of the grid ego and agents are interpolated and compared at ten instants a step.
        """
        grid = start + dt * np.arange(len(states))
        fine = start + dt * np.arange((len(states) - 1) * _FINE + 1) / _FINE
        ego = np.column_stack(
            [np.interp(fine, grid, column) for column in (states[:, 0], states[:, 1], np.unwrap(states[:, 2]))]
        )
        first: tuple[float, str] | None = None
        for track in self.tracks:
            there = (fine >= track.times[0]) & (fine <= track.times[-1])
            if not there.any():
                continue
            at = track.at(fine[there])
            other = np.column_stack([at.positions, at.headings])
            meets = rectangles_meet(ego[there], body, other, (track.length, track.width), disc)
            if meets.any():
                when = float(fine[there][np.argmax(meets)])
                if first is None or when < first[0]:
                    first = when, track.name
        return first


def rectangles_meet(
    poses: Array, size: tuple[float, float], others: Array, other: tuple[float, float], disc: bool = False
) -> np.ndarray:
    """(N,) whether rectangles at poses (N, 3) meet; the first one a disc as wide as it is long if `disc`.

    The sides of either rectangle are the axes that could separate them (Gottschalk, Lin & Manocha 1996).
    """
    offset = others[:, :2] - poses[:, :2]
    turn = others[:, 2] - poses[:, 2]
    c, s = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    (a, b), (d, e) = 0.5 * np.array(size), 0.5 * np.array(other)
    x, y = _in_frame(offset, poses[:, 2])
    u, v = _in_frame(offset, others[:, 2])
    if disc:
        near: np.ndarray = np.hypot(np.maximum(np.abs(u) - d, 0.0), np.maximum(np.abs(v) - e, 0.0)) <= a
        return near
    meet: np.ndarray = (
        (np.abs(x) <= a + d * c + e * s)
        & (np.abs(y) <= b + d * s + e * c)
        & (np.abs(u) <= d + a * c + b * s)
        & (np.abs(v) <= e + a * s + b * c)
    )
    return meet


def _in_frame(offset: Array, heading: Array) -> tuple[Array, Array]:
    c, s = np.cos(heading), np.sin(heading)
    return c * offset[:, 0] + s * offset[:, 1], c * offset[:, 1] - s * offset[:, 0]


def sampled_traffic(agents: Sequence[Agent], rng: np.random.Generator) -> Traffic:
    """One future of every predicted agent, its error persisting over time as far as the prediction leaves that open.

    Each has two seconds of past straight into it, as predictors want one. Agents without a size are 4.5 × 1.8 m.

    Raises:
        InputError: for an agent that cannot be sampled.
    """
    tracks = []
    for i, agent in enumerate(agents):
        if isinstance(agent, GaussianMixturePrediction):
            source = persistent(agent) if agent.factors is None else agent
            path = source.sample(1, rng)[0]
        elif isinstance(agent, ControlPrediction):
            path = agent.sample(1, rng)[0]
        else:
            raise InputError(f"agents[{i}]: expected one that can be sampled, got a {type(agent).__name__}")
        length, width = agent.length or 4.5, agent.width or 1.8
        times, path = _with_past(agent, path)
        heading = 0.0 if agent.headings is None else float(agent.headings[0, 0])
        tracks.append(track_of(agent.name or f"agent {i}", times, path, length, width, heading))
    return Traffic(tuple(tracks))


def _with_past(agent: Agent, path: Array) -> tuple[Array, Array]:
    """The future with a past as the prediction's mean moves at first: of the future itself nothing is known yet."""
    times = agent.times
    if len(times) < 2:
        return times, path
    step = times[1] - times[0]
    back = np.arange(-int(np.ceil(_PAST / step)), 0)[:, None] * step
    mean = (agent.step_weights[0, :, None] * (agent.means[1] - agent.means[0])).sum(axis=0)
    return np.concatenate([times[0] + back[:, 0], times]), np.concatenate([path[0] + back * mean / step, path])


def track_of(name: str, times: Array, path: Array, length: float, width: float, heading: float = 0.0) -> Track:
    """A track along positions (T, 2), headed where it has moved; `heading` before it first does.

    Speeds and headings at a time come from positions up to it: they are what may be known then.
    """
    if len(times) == 1:
        return Track(name, times, path, np.full(1, heading), np.zeros(1), length, width)
    velocity = np.diff(path, axis=0) / np.diff(times)[:, None]
    velocity = np.concatenate([velocity[:1], velocity])
    speeds = np.hypot(velocity[:, 0], velocity[:, 1])
    moving = np.maximum.accumulate(np.where(speeds > _STANDING, np.arange(len(times)), -1))
    courses = np.arctan2(velocity[moving, 1], velocity[moving, 0])
    headings = np.unwrap(np.where(moving >= 0, courses, heading))
    return Track(name, times, path, headings, speeds, length, width)


def shifted(tracks: Sequence[Track], zero: float, besides: str | None = None) -> Traffic:
    """Recorded tracks on a clock that is 0 at `zero`, without the one of that name."""
    return Traffic(tuple(replace(t, times=t.times - zero) for t in tracks if t.name != besides))
