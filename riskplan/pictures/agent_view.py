"""What there is to see of one agent: its body's way, its modes over time, sampled futures."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeGuard

import numpy as np

from checkers import GaussianMixturePrediction, MomentPrediction, as_gaussian, persistent
from checkers.validate import Array
from riskplan.scene import Agent

_MOST_ELLIPSES, _FEWEST = 30, 5  # a mode: enough to see it move, few enough to see through
_ALL_ELLIPSES = 4_000  # of all modes together: hundreds of agents make no page of 50 MB


class Detail(NamedTuple):
    """What is drawn of the agents beyond means and covariances.

    Attributes:
        samples: futures drawn as lines, per agent.
        density: positions drawn as dots, per agent and shown step.
        seed: of both.
    """

    samples: int = 0
    density: int = 0
    seed: int = 0


class Frame(NamedTuple):
    """Where a picture's origin is in the world, and how many of its metres make one of the world's."""

    origin: Array
    zoom: float = 1.0

    def __call__(self, points: Array) -> Array:
        """World points (…, 2) in the picture."""
        return np.asarray((points - self.origin) * self.zoom)


@dataclass(frozen=True, eq=False)
class AgentView:
    """One agent.

    Attributes:
        name, colour, length, width: label, "#rrggbb", size [m].
        track: (T, 3) poses of the most likely mode at `Picture.times`.
        weights, means, covariances: (S, K), (S, K, 2), (S, K, 2, 2) of the shown steps of the prediction.
        now: weights (T, K), means (T, K, 2) and covariances (T, K, 2, 2) at `Picture.times`.
        futures: (n, S, 2) sampled trajectories; n = 0 unless asked for, or if only moments are known.
        dots: (N, 2) sampled positions of all shown steps; none unless asked for.
    """

    name: str
    colour: str
    length: float
    width: float
    track: Array
    weights: Array
    means: Array
    covariances: Array
    now: tuple[Array, Array, Array]
    futures: Array
    dots: Array

    @property
    def rims(self) -> slice:
        """Which of the shown steps have an outline: every fifth, more where there are few."""
        return slice(None, None, int(np.clip(len(self.means) // 3, 1, 5)))


def agent_view(
    agent: Agent, colour: str, times: Array, frame: Frame, end: float, detail: Detail, modes: int
) -> AgentView:
    """Of an agent, with its modes up to `end` [s]; it shares the ellipses with all `modes` of the scene."""
    likely = int(agent.step_weights.sum(axis=0).argmax())
    at = frame(agent.means[:, likely])
    heading = _course(at) if agent.headings is None else np.unwrap(agent.headings[:, likely])
    track = np.column_stack([np.interp(times, agent.times, column) for column in (*at.T, heading)])
    shown = np.flatnonzero(agent.times <= end + 1e-6)
    most = int(np.clip(_ALL_ELLIPSES // modes, _FEWEST, _MOST_ELLIPSES))
    shown = shown[:: max(1, -(-len(shown) // most))]
    means, covariances = frame(agent.means), agent.covariances * frame.zoom**2
    futures, dots = _sampled(agent, shown, detail)
    return AgentView(
        name=agent.name,
        colour=colour,
        length=(agent.length or 4.5) * frame.zoom,
        width=(agent.width or 1.8) * frame.zoom,
        track=track,
        weights=agent.step_weights[shown],
        means=means[shown],
        covariances=covariances[shown],
        now=tuple(_over(times, agent.times, a) for a in (agent.step_weights, means, covariances)),  # type: ignore[arg-type]
        futures=frame(futures),
        dots=frame(dots),
    )


def _over(times: Array, own: Array, values: Array) -> Array:
    """Values (T, …) at other times, held before the first."""
    columns = values.reshape(len(own), -1).T
    rows = np.column_stack([np.interp(times, own, column) for column in columns])
    return rows.reshape(len(times), *values.shape[1:])


def _sampled(agent: Agent, shown: np.ndarray, detail: Detail) -> tuple[Array, Array]:
    """Futures (n, S, 2) and positions (N, 2) at the shown steps.

    Positions are drawn from each step's own distribution; where only moments are known, from the Gaussian that has
    them. Futures of a Gaussian agent that does not say how its errors depend on each other over time are drawn as
    errors that persist: lines that jump from step to step show nothing. `assumed` says so in the legend.
    """
    rng = np.random.default_rng(detail.seed)
    futures, dots = np.zeros((0, len(shown), 2)), np.zeros((0, 2))
    bare = isinstance(agent, MomentPrediction)
    if isinstance(agent, MomentPrediction):
        agent = as_gaussian(agent)
    if detail.density:
        dots = agent.sample(detail.density, rng)[:, shown].reshape(-1, 2)
    if detail.samples and not bare:
        futures = (persistent(agent) if _silent(agent) else agent).sample(detail.samples, rng)[:, shown]
    return futures, dots


def _silent(agent: Agent) -> TypeGuard[GaussianMixturePrediction]:
    """Whether it does not say how its errors depend on each other over time."""
    return isinstance(agent, GaussianMixturePrediction) and agent.factors is None and agent.modes == "persistent"


def assumed(agents: Sequence[Agent], detail: Detail) -> tuple[str, ...]:
    """What dots and lines are, and what was taken for granted to draw them: lines of the legend."""
    bare = any(isinstance(agent, MomentPrediction) for agent in agents)
    lines = []
    if detail.density and agents:
        of_moments = "; of bare moments, of a Gaussian with the same mean and covariance" if bare else ""
        lines.append(f"dots: sampled positions{of_moments}")
    if detail.samples and not all(isinstance(agent, MomentPrediction) for agent in agents):
        lasting = "; errors taken to persist" if any(map(_silent, agents)) else ""
        lines.append(f"lines: sampled futures{lasting}{'; none of bare moments' if bare else ''}")
    elif detail.samples and agents:
        lines.append("no futures: nothing but moments is known")
    return tuple(lines)


def _course(points: Array) -> Array:
    """(T,) direction of motion; held while the point rests, 0 if it never moves."""
    if len(points) < 2:
        return np.zeros(len(points))
    step = np.gradient(points, axis=0)
    moving = np.flatnonzero(np.linalg.norm(step, axis=-1) > 1e-3)
    if not len(moving):
        return np.zeros(len(points))
    angle = np.unwrap(np.arctan2(step[moving, 1], step[moving, 0]))
    return np.asarray(np.interp(np.arange(len(points)), moving, angle))


def agent_node(index: int, name: str) -> str:
    """Path below `/riskplan` of an agent's body; a slash in its name would split the path."""
    return f"agents/{index}-{re.sub('[^A-Za-z0-9_.-]+', '-', name)}"
