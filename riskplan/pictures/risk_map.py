"""The risk of being at each place at one time, as in planning on risk contours (Jasour & Williams 2019)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from checkers import Checker, InputError, checker
from checkers.validate import FARTHEST, Array, as_array, as_instance, as_scalar
from riskplan.scene import Scenario

_MOST_PLACES = 400_000


@dataclass(frozen=True, eq=False)
class RiskMap:
    """Risk over a grid of places.

    Attributes:
        x, y: (X,), (Y,) centres of the ego [m].
        risk: (Y, X) risk of colliding with any agent there at `time`; at most 1.
        time: [s].
        heading: of the ego at each place [rad].
        checker, kind: who said so, and what it claims.
    """

    x: Array
    y: Array
    risk: Array
    time: float
    heading: float
    checker: str
    kind: str


def risk_map(
    scenario: Scenario,
    time: float,
    *,
    backend: str | Checker = "exact",
    heading: float | None = None,
    spacing: float = 0.5,
    window: tuple[float, float, float, float] | None = None,
) -> RiskMap:
    """Risk of the ego standing at each place of a grid at `time`: one call of the backend per agent for all places.

    Args:
        scenario: agents, ego shape and bounds.
        time: within every prediction [s].
        backend: name of a checker, or one with options.
        heading: of the ego [rad]; None: as at the start.
        spacing: of the grid [m].
        window: x_min, y_min, x_max, y_max [m]; None: the bounds of the scenario.

    Raises:
        InputError: without agents, for an empty window, more than 400,000 places, or what the backend refuses.
    """
    as_instance("scenario", scenario, Scenario)
    time = as_scalar("time", time)
    if not scenario.agents:
        raise InputError("agents: expected at least one, got none")
    spacing = as_scalar("spacing", spacing, low=0.0, strict=True)
    x0, y0, x1, y1 = scenario.bounds if window is None else as_array("window", window, (4,), largest=FARTHEST).tolist()
    if not (x0 < x1 and y0 < y1):
        raise InputError(f"window: expected x_min < x_max and y_min < y_max, got {(x0, y0, x1, y1)}")
    if (x1 - x0) / spacing * ((y1 - y0) / spacing) > _MOST_PLACES:
        raise InputError(f"spacing: {spacing:g} m makes more than {_MOST_PLACES} places; expected a wider one")
    x, y = np.arange(x0, x1 + 1e-9, spacing), np.arange(y0, y1 + 1e-9, spacing)
    turn = scenario.start.heading if heading is None else as_scalar("heading", heading)
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 1, 2)
    poses = np.concatenate([places, np.full((len(places), 1, 1), turn)], axis=-1)  # (Y X, 1, 3)
    judge = backend if isinstance(backend, Checker) else checker(backend)
    total, kinds = np.zeros(len(poses)), set()
    for agent in scenario.agents:
        now = agent.at([time])
        risk = judge(poses, now, scenario.ego)  # (Y X, 1, K)
        total += (risk.value[:, 0] * now.step_weights[0]).sum(axis=-1)
        kinds.add(risk.kind.value)
    # adding up over agents overstates, so exact values of several are an upper bound together
    kind = next(iter(kinds)) if len(kinds) == 1 else "upper bound"
    if len(scenario.agents) > 1 and kind == "exact":
        kind = "upper bound"
    grid = np.minimum(total, 1.0).reshape(len(y), len(x))
    return RiskMap(x, y, grid, float(time), float(turn), judge.info.name, kind)
