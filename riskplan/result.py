"""What planning and auditing return: plans and reports, as frozen values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from checkers import TrajectoryRisk
from checkers.validate import Array
from riskplan.showing import shown

STATUSES = (
    "solved",
    "no_plan_found",
    "start_at_risk",
    "start_in_obstacle",
    "goal_in_obstacle",
    "goal_unreachable",
)


@dataclass(frozen=True, eq=False)
class Plan:
    """A trajectory on the planning grid with its judged risk; or the reason why there is none.

    Attributes:
        status: "solved", or why not (see `STATUSES`).
        times: (T,) from 0 [s]; empty without a plan.
        poses: (T, 3) x, y [m], heading [rad].
        speeds: (T,) [m/s].
        risk: judged over `times`, start included; None without a plan or without agents.
        marginals: per agent (T, K): the risk by step and mode, as judged; NaN where an agent's prediction starts later.
            Of an exact backend, those that change no digit of the total are stated by their bounds Φ(−d).
        bound: the stated bound on `risk.total`, None if the least risk was asked for.
        message: one line for a person.
        settings: planner, checker, dependence, time limit, seed.
        stats: counters and seconds: search, checks, judging, iterations, lowest_risk_seen.
        search: (E, 5) edges of the tree or roadmap, x0, y0, x1, y1, time, for pictures; may be empty.
        steering: (T,) angles of a vehicle that has one [rad], else 0; None: 0.
    """

    status: str
    times: Array
    poses: Array
    speeds: Array
    risk: TrajectoryRisk | None
    marginals: tuple[Array, ...] = ()
    bound: float | None = None
    message: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)
    stats: Mapping[str, Any] = field(default_factory=dict)
    search: Array = field(default_factory=lambda: np.zeros((0, 5)))
    steering: Array = None  # type: ignore[assignment]  # replaced on construction

    def __post_init__(self) -> None:
        if self.steering is None:
            object.__setattr__(self, "steering", np.zeros(len(self.times)))

    @property
    def solved(self) -> bool:
        """Whether there is a trajectory within the bound."""
        return self.status == "solved"

    def _repr_html_(self) -> str:
        return shown(self)


@dataclass(frozen=True, eq=False)
class CheckerVerdict:
    """One backend's view of a plan.

    Attributes:
        checker: name.
        kind: claim of `risk`, as text.
        risk: over the whole trajectory; None if the backend could not judge some agent.
        seconds: it took.
        problem: why it could not judge, else "".
    """

    checker: str
    kind: str
    risk: TrajectoryRisk | None
    seconds: float
    problem: str = ""


@dataclass(frozen=True, eq=False)
class SampledRisk:
    """Monte Carlo over whole trajectories of all agents, modes kept where they persist.

    Attributes:
        samples: drawn.
        total, interval: share of samples that collide with any agent, and its Clopper-Pearson interval; NaN if no
            agent could be sampled.
        per_agent, per_agent_interval: (A,), (A, 2); NaN for agents that cannot be sampled.
        confidence: of the intervals.
        complete: whether every agent could be sampled; if not, `total` is of the others only.
        seconds: it took.
    """

    samples: int
    total: float
    interval: tuple[float, float]
    per_agent: Array
    per_agent_interval: Array
    confidence: float
    complete: bool
    seconds: float


@dataclass(frozen=True, eq=False)
class Report:
    """An audit of a plan: what each requested backend and sampling say of the same trajectory.

    Attributes:
        agents: their names.
        times: (T,) of the plan.
        verdicts: one per backend.
        sampled: Monte Carlo, or None if not asked for.
        bound: stated for the plan.
        within_bound: whether the plan's own judged total is within it; None without a bound.
        consistent: no sampled interval lies above a total that claims to be exact or a bound.
        stats: the plan's counters and seconds, checks per second included.
        spending: (T, A) risk of each agent up to and with each step, by the plan's own checker; (T, 0) without agents.
    """

    agents: tuple[str, ...]
    times: Array
    verdicts: tuple[CheckerVerdict, ...]
    sampled: SampledRisk | None
    bound: float | None
    within_bound: bool | None
    consistent: bool
    stats: Mapping[str, Any] = field(default_factory=dict)
    spending: Array = field(default_factory=lambda: np.zeros((0, 0)))

    def _repr_html_(self) -> str:
        return shown(self)
