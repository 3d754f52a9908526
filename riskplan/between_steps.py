"""What happens between the times of the grid, bounded on it: `inflated` scenes.

Risk is stated at grid times t_n = n Δ. In between, at |t − t_n| ≤ h = Δ/2, ego and agent are elsewhere than at the
nearest t_n, but not far: if every point of either body at time t lies within a larger body at t_n, then bodies that
meet at any time imply larger bodies that meet at a time of the grid, and

    P(bodies meet at some t in [0, T])  ≤  P(larger bodies meet at some t_n).

**Ego.** Within h the vehicle's centre moves by at most (along, across) in the frame of its pose at t_n, and its body
turns by at most `turn` (`Vehicle.sweep`, from its limits and the highest speed it can reach within the horizon), which
moves no point of a body with half diagonal d by more than d · turn. The larger body is the rectangle grown by
along + d · turn at either end and by across + d · turn at either side.

**Agents.** A future moves linearly between grid times, and its error persists within a step: x_n = μ_n + F_n ξ with one
ξ ~ N(0, I) of dimension R (an agent's `factors`, what they leave open through `rp.persistent`). So within h of t_n it
is displaced by a part of at most one half of x_{n±1} − x_n = Δμ + ΔF ξ, which along a unit vector u is at most

    ½ (|u·Δμ| + ‖ΔFᵀ u‖ q)    unless |ξ| > q,   and   P(|ξ| > q) = η for the χ quantile q of R.

With u along and across the agent's heading at t_n, the largest over steps and modes grows its rectangle; headings that
turn by δ in a step add ½ δ times the half diagonal. Where an agent carries no headings the bound on the length of the
displacement is taken in both directions, which holds for any. An agent without a size gets one.

**Risk.** |ξ| > q happens with probability η once per agent, not per step, and is added to the stated risk: a share
(`RESERVE`) of the bound is reserved for all agents together, and what is left is the bound on the larger bodies.

The bound is uniform over the horizon, so it is loose for fast scenes and long steps; halving the step halves it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import chdtri

from checkers import EgoBox, EgoCover, EgoEllipsoid, EgoShape, GaussianMixturePrediction, InputError, TrajectoryRisk
from checkers import persistent as persisting
from checkers.dependence import idiosyncratic
from checkers.shapes import AlignedEllipsoid
from checkers.validate import Array, as_instance, as_scalar
from riskplan.scene import Agent, Scenario

BETWEEN_STEPS = ("grid", "inflated")
RESERVE = 0.01  # share of the bound that pays for the agents' quantiles
_WITHOUT_BOUND = 1e-6  # and what pays where there is no bound


@dataclass(frozen=True, eq=False)
class Inflated:
    """A scene with larger bodies.

    Attributes:
        scenario: to be planned and judged on the grid.
        reserve: probability that some agent moves farther within a step than the larger bodies allow for.
        ego: by how much the ego grows at either end and at either side [m].
        agents: (A, 2) the same of the agents.
    """

    scenario: Scenario
    reserve: float
    ego: tuple[float, float]
    agents: Array

    def left(self, bounds: Mapping[str, Any]) -> dict[str, float | None]:
        """What bounds, as `for_all_times` reads them, leave for the larger bodies' risk."""
        share = self.reserve / max(len(self.agents), 1)
        # an agent can break its quantile at any step
        spent = {"bound": self.reserve, "step_bound": self.reserve, "agent_bound": share}
        given = {name: bounds.get(name) for name in spent}
        return {name: None if value is None else max(value - spent[name], 0.0) for name, value in given.items()}

    def stated(self, risk: TrajectoryRisk | None) -> TrajectoryRisk | None:
        """The risk in continuous time, from that of the larger bodies on the grid."""
        if risk is None:
            return None
        share = self.reserve / max(len(self.agents), 1)
        return replace(
            risk,
            total=np.minimum(risk.total + self.reserve, 1.0),
            per_agent=np.minimum(risk.per_agent + share, 1.0),
            per_step=np.minimum(risk.per_step + self.reserve, 1.0),
            boole=np.minimum(risk.boole + self.reserve, 1.0),
        )


def inflated(scenario: Scenario, bound: float | None) -> Inflated:
    """The scene with bodies so large that the risk on the grid bounds that at all times; see the module.

    Raises:
        InputError: for agents that are no Gaussian mixtures with persistent modes from time 0 on, and unknown shapes.
    """
    as_instance("scenario", scenario, Scenario)
    bound = None if bound is None else as_scalar("bound", bound, low=0.0, high=1.0)
    s, half = scenario, 0.5 * scenario.time_step
    start = abs(s.start.speed)
    speed = min(max(s.vehicle.top_speed, start), start + s.vehicle.top_acceleration * float(s.horizon or 0.0))
    along, across, turn = s.vehicle.sweep(speed, half)
    each = (RESERVE * bound if bound is not None else _WITHOUT_BOUND) / max(len(s.agents), 1)
    grown = [_agent_margins(i, agent, s.times, each) for i, agent in enumerate(s.agents)]
    margins = np.array(grown).reshape(-1, 2)
    agents = tuple(_larger(agent, m) for agent, m in zip(s.agents, margins, strict=True))
    most = margins.max(axis=0) if len(margins) else np.zeros(2)
    ego, margin = _larger_ego(s.ego, (along, across, turn), most)
    wide = object.__new__(Scenario)
    wide.__dict__.update({**s.__dict__, "agents": agents, "ego": ego})
    return Inflated(wide, each * len(s.agents), margin, margins)


def for_all_times(scenario: Scenario, bounds: Mapping[str, Any]) -> Inflated:
    """`inflated` for the tightest of "bound", "step_bound" and "agent_bound" among the settings of a plan."""
    given = [bounds.get(name) for name in ("bound", "step_bound", "agent_bound")]
    return inflated(scenario, min((b for b in given if b is not None), default=None))


def _agent_margins(index: int, agent: Agent, times: Array, share: float) -> tuple[float, float]:
    where = f"agents[{index}] ({agent.name})" if agent.name else f"agents[{index}]"
    if not isinstance(agent, GaussianMixturePrediction) or agent.modes != "persistent":
        raise InputError(
            f"{where}: between_steps 'inflated' expects a Gaussian mixture with persistent modes, "
            f"got {type(agent).__name__}{' with modes per step' if hasattr(agent, 'covariances') else ''}"
        )
    if agent.times[0] > 1e-6:
        raise InputError(
            f"{where}: between_steps 'inflated' expects a prediction from time 0, got {agent.times[0]:g} s"
        )
    if len(times) < 2 or share <= 0.0:
        raise InputError("between_steps: 'inflated' expects a bound > 0 and at least one step")
    known = agent.at(times)
    factors = _factors(known)
    # χ² quantile: P(|ξ|² > q²) = share
    quantile = float(np.sqrt(chdtri(factors.shape[-1], share)))
    mean_step, factor_step = np.diff(known.means, axis=0), np.diff(factors, axis=0)
    if agent.headings is None or known.headings is None:
        # a vector's length in any direction: ‖ΔF‖ ≤ its Frobenius norm
        length = np.hypot(mean_step[..., 0], mean_step[..., 1])
        reach = 0.5 * float((length + quantile * np.sqrt((factor_step**2).sum(axis=(-1, -2)))).max())
        return reach, reach
    headings = np.unwrap(known.headings, axis=0)
    found = []
    # the frame of either end of a step: its middle may be nearest to both
    for frame in (headings[:-1], headings[1:]):
        c, s = np.cos(frame), np.sin(frame)
        for u in (np.stack([c, s], axis=-1), np.stack([-s, c], axis=-1)):
            way = np.abs((u * mean_step).sum(axis=-1))
            spread = np.sqrt((((u[..., None] * factor_step).sum(axis=-2)) ** 2).sum(axis=-1))
            found.append(0.5 * float((way + quantile * spread).max()))
    diagonal = 0.5 * float(np.hypot(agent.length or 0.0, agent.width or 0.0))
    turned = 0.5 * float(np.abs(np.diff(headings, axis=0)).max()) * diagonal
    return max(found[0], found[2]) + turned, max(found[1], found[3]) + turned


def _factors(agent: GaussianMixturePrediction) -> Array:
    """(T, K, 2, R) factors that carry the whole covariance."""
    given = agent.factors
    if given is not None:
        rest = idiosyncratic(agent.covariances, given)
        if not rest.any():
            return given
        agent = replace(agent, factors=None, covariances=rest)
    own = persisting(agent).factors
    assert own is not None  # noqa: S101  made so
    return own if given is None else np.concatenate([given, own], axis=-1)


def _larger(agent: Agent, margin: Array) -> Agent:
    length, width = (
        (size or 0.0) + 2.0 * float(m) for size, m in zip((agent.length, agent.width), margin, strict=True)
    )
    return replace(agent, length=length if length > 0 else None, width=width if width > 0 else None)


def _larger_ego(ego: EgoShape, sweep: tuple[float, float, float], most: Array) -> tuple[EgoShape, tuple[float, float]]:
    """The shape grown; `most` is the largest margin of any agent, for shapes that do not read the agents' sizes."""
    along, across, turn = sweep
    if isinstance(ego, EgoEllipsoid):
        inverse = np.linalg.inv(ego.Q)
        reach = float(np.sqrt(np.linalg.eigvalsh(inverse)[-1])) * turn + float(np.hypot(*most))
        margin = along + reach, across + reach
        # √2 times a box's half-axes are those of the smallest ellipse around it; the sum as in `AlignedEllipsoid`
        box = 2.0 * np.diag(np.square(margin))
        ratio = np.sqrt(np.trace(inverse) / np.trace(box))
        return EgoEllipsoid(np.linalg.inv((1 + 1 / ratio) * inverse + (1 + ratio) * box)), margin
    if not isinstance(ego, EgoBox | EgoCover | AlignedEllipsoid):
        raise InputError(f"ego: between_steps 'inflated' knows boxes, ellipses and discs; got {type(ego).__name__}")
    reach = 0.5 * float(np.hypot(ego.length, ego.width)) * turn
    margin = along + reach, across + reach
    length, width = ego.length + 2 * margin[0], ego.width + 2 * margin[1]
    if not isinstance(ego, EgoCover):
        return replace(ego, length=length, width=width), margin
    agent_length, agent_width = (
        None if size is None else size + 2 * float(m)
        for size, m in zip((ego.agent_length, ego.agent_width), most, strict=True)
    )
    return replace(ego, length=length, width=width, agent_length=agent_length, agent_width=agent_width), margin
