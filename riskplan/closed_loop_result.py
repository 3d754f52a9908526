"""What a closed loop leaves: every plan, what was driven, what it met."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from checkers.validate import Array
from predictor import Track

FORMAT, VERSION = "riskplan-simulation", 1
ACTIONS = ("kept", "planned", "fallback")


@dataclass(frozen=True, eq=False)
class Cycle:
    """One decision.

    Attributes:
        time: of it [s].
        action: "kept" the rest of the plan before, which is still within the bound; "planned" anew; or "fallback", as
            no plan to the goal was within the bound: `risk` says whether what is driven instead is.
        status: of the search, see `riskplan.result.STATUSES`; "" where none was needed.
        states: (T, 5) x, y, heading, speed, steering from now on, on the grid: what is driven unless decided anew.
        risk: stated for `states` against the predictions of now.
        spent: the part of it that falls on what is driven until the next decision.
        agents: how many were predicted.
        latency: from the observation to the decision [s].
    """

    time: float
    action: str
    status: str
    states: Array
    risk: float
    spent: float
    agents: int
    latency: float


@dataclass(frozen=True)
class Collision:
    """True bodies that met.

    Attributes:
        time: [s].
        agent: its name.
        action: of the decision that was being driven.
        risk: stated then for what was being driven.
        within_bound: whether that was within the bound.
    """

    time: float
    agent: str
    action: str
    risk: float
    within_bound: bool


@dataclass(frozen=True, eq=False)
class Simulation:
    """A closed loop, to its end.

    Attributes:
        name: of the scenario.
        status: "arrived", "time_up" or "collided", which ends it.
        bound: on the total risk of every plan.
        times: (N,) [s].
        states: (N, 5) the ego as driven: x, y, heading, speed, steering.
        body: length and width of the ego [m].
        tracks: the agents' true tracks, on the same clock.
        cycles: the decisions.
        collision: the first one; None if there was none.
        settings: of the loop.
    """

    name: str
    status: str
    bound: float
    times: Array
    states: Array
    body: tuple[float, float]
    tracks: tuple[Track, ...]
    cycles: tuple[Cycle, ...]
    collision: Collision | None
    settings: Mapping[str, Any] = field(default_factory=dict)

    @property
    def progress(self) -> float:
        """Way driven [m]."""
        return float(np.hypot(*np.diff(self.states[:, :2], axis=0).T).sum())

    @property
    def spent(self) -> float:
        """Risk taken: over the decisions, what each stated of the stretch that was driven; a sum, so an upper bound."""
        return min(float(sum(c.spent for c in self.cycles)), 1.0)

    def share(self, action: str) -> float:
        """Share of the decisions of that kind."""
        return sum(c.action == action for c in self.cycles) / max(len(self.cycles), 1)

    def latency(self, quantile: float) -> float:
        """Of the decisions' latencies [s]; 1 for the worst."""
        return float(np.quantile([c.latency for c in self.cycles], quantile)) if self.cycles else 0.0

    def summary(self) -> dict[str, Any]:
        """The figures, without the trajectories."""
        return {
            "name": self.name,
            "status": self.status,
            "bound": self.bound,
            "duration": float(self.times[-1]),
            "progress": self.progress,
            "decisions": len(self.cycles),
            **{action: self.share(action) for action in ACTIONS},
            "spent": self.spent,
            "latency": {"median": self.latency(0.5), "p95": self.latency(0.95), "worst": self.latency(1.0)},
            "collision": None if self.collision is None else dict(vars(self.collision)),
        }

    def to_dict(self) -> dict[str, Any]:
        """All of it, for JSON."""
        from riskplan.io.plan_file import versions  # noqa: PLC0415  a file's business
        from riskplan.io.text import plain  # noqa: PLC0415

        names = ("name", "times", "positions", "headings", "speeds", "length", "width", "kind")
        whole: dict[str, Any] = plain(
            {
                "format": FORMAT,
                "version": VERSION,
                **self.summary(),
                "settings": dict(self.settings),
                "body": list(self.body),
                "times": self.times,
                "states": self.states,
                "tracks": [{n: getattr(t, n) for n in names} for t in self.tracks],
                "cycles": [dict(vars(c)) for c in self.cycles],
            }
        )
        return {**whole, "versions": versions()}

    def save(self, path: str | Path) -> None:
        """Write as strict JSON, complete or not at all."""
        from riskplan.io.plan_file import json_text  # noqa: PLC0415
        from riskplan.io.text import write_text  # noqa: PLC0415

        write_text(path, json_text(self.to_dict()))
