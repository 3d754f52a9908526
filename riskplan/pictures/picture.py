"""What there is to see of a scenario and a plan: the one model that the 3-D page and the top view draw.

Coordinates are local: the start of the ego is the origin, so that map coordinates of 1e5 m survive float32. Worlds for
an ego below 20 cm are enlarged, so that lines and bodies made for cars and people fit into them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from checkers import EgoShape, Kind
from checkers.validate import Array, as_instance
from riskplan.pictures import geometry, palette
from riskplan.pictures.agent_view import AgentView, Detail, Frame, agent_view, assumed
from riskplan.result import Plan
from riskplan.rounding import by_kind
from riskplan.scene import Scenario

SIGMAS = 2.0
_MOST_EDGES = 20_000
_SMALLEST = 0.2  # length of the ego [m] from which on nothing is enlarged
_WIDE = 200.0  # extent of a world [m] from which on lines and bodies grow with it, to be seen at all
_CLAIM = {Kind.EXACT: "", Kind.UPPER_BOUND: "≤ ", Kind.ESTIMATE: "≈ "}


@dataclass(frozen=True, eq=False)
class Picture:
    """Everything to draw, in local metres (enlarged ones for an ego below 20 cm).

    Attributes:
        title, facts, notes: heading, (label, value) rows and lines of small print of the legend.
        times: (T,) of the animation [s].
        ego: (T, 3) poses; at rest without a plan.
        ego_size: length, width [m].
        ego_round: whether its body is a disc.
        ego_rings: outlines (N, 2) in the ego frame of what agents' centres must stay out of.
        path: (P, 3) poses of the plan; empty without one.
        path_risk, per_step: (P,) risk of each step, and what it is called: under dependence "persistent" a step's share
            is the probability that it is the first to be hit.
        so_far: (T,) risk up to each time, or None if the plan does not tell.
        claim: what `total risk` claims: "", "≤ " or "≈ ".
        tree: (E, 5) edges of the search x0, y0, x1, y1, time; at most 20,000, evenly picked.
        road, edges, dividers: polygons (N, 2), closed lines, lines to be dashed.
        obstacles, goals: polygons (N, 2).
        agents: one view each.
        limits: ends of the legend's scales: risk of a step, weight of a mode, time of the search [s].
        window: x_min, y_min, x_max, y_max of what matters.
        zoom: how many of its metres make one of the world's.
    """

    title: str
    facts: tuple[tuple[str, str], ...]
    notes: tuple[str, ...]
    times: Array
    ego: Array
    ego_size: tuple[float, float]
    ego_round: bool
    ego_rings: tuple[Array, ...]
    path: Array
    path_risk: Array
    per_step: str
    so_far: Array | None
    claim: str
    tree: Array
    road: tuple[Array, ...]
    edges: tuple[Array, ...]
    dividers: tuple[Array, ...]
    obstacles: tuple[Array, ...]
    goals: tuple[Array, ...]
    agents: tuple[AgentView, ...]
    limits: tuple[float, float, float]
    window: tuple[float, float, float, float]
    zoom: float

    @property
    def stroke(self) -> float:
        """How broad lines on the ground are, 1 for a car: a robot of half a metre drives in a smaller world."""
        return float(np.clip(self.ego_size[1] / 1.8, 0.3, 1.0)) * self.grown

    @property
    def grown(self) -> float:
        """How many times as large as they are bodies are drawn: more than once where they would be mere specks."""
        return _grown(self.window)


def picture(
    scenario: Scenario, plan: Plan | None = None, title: str | None = None, detail: Detail | None = None
) -> Picture:
    """Collect what there is to see; `plan` may be None or unsolved."""
    as_instance("scenario", scenario, Scenario)
    if plan is not None:
        as_instance("plan", plan, Plan)
    start = scenario.start
    length, width = scenario.vehicle.body
    frame = Frame(np.array([start.x, start.y]), max(1.0, _SMALLEST / length))
    planned = plan is not None and len(plan.poses) > 0
    path = np.zeros((0, 3))
    if plan is not None and planned:
        path = np.column_stack([frame(plan.poses[:, :2]), np.unwrap(plan.poses[:, 2])])
    times = plan.times if plan is not None and len(path) > 1 else scenario.times
    ego = path if len(path) > 1 else np.tile([0.0, 0.0, start.heading], (len(times), 1))
    risk = plan.risk if plan is not None else None
    path_risk = np.nan_to_num(risk.per_step) if risk is not None else np.zeros(len(path))
    end = float(scenario.times[-1])
    modes = sum(agent.means.shape[1] for agent in scenario.agents)
    agents = tuple(
        agent_view(agent, palette.AGENTS[i % len(palette.AGENTS)], times, frame, end, detail or Detail(), modes)
        for i, agent in enumerate(scenario.agents)
    )
    goals = tuple(frame(region.polygon) for region in scenario.goal.regions)
    lanes = [frame(lane) for lane in scenario.lanes]
    road = _road(scenario, lanes, frame)
    tree = _tree(plan, frame)
    rings = _ego_rings(scenario, frame.zoom)
    size = (length * frame.zoom, width * frame.zoom)
    window = _window(ego, size[0], rings, goals, agents)
    return Picture(
        title=title if title is not None else scenario.name or "riskplan",
        facts=_facts(plan),
        notes=assumed(scenario.agents, detail or Detail()) + _enlarged(window),
        times=times,
        ego=ego,
        ego_size=size,
        ego_round=scenario.vehicle.disc,
        ego_rings=rings,
        path=path,
        path_risk=path_risk,
        per_step="first hit per step" if risk is not None and risk.dependence == "persistent" else "risk per step",
        so_far=_so_far(scenario, plan),
        claim=_CLAIM[risk.kind] if risk is not None else "",
        tree=tree,
        road=road,
        edges=tuple(geometry.union_rings(road, inset=0.5)),
        dividers=tuple(geometry.dividers(lanes)),
        obstacles=tuple(frame(polygon) for polygon in scenario.obstacles),
        goals=goals,
        agents=agents,
        limits=(
            _risk_limit(plan, path_risk),
            palette.round_up(max([float(a.weights.max()) for a in agents], default=1.0)),
            float(tree[:, 4].max()) if len(tree) else float(times[-1]),
        ),
        window=window,
        zoom=frame.zoom,
    )


def _grown(window: tuple[float, float, float, float]) -> float:
    x0, y0, x1, y1 = window
    return max(1.0, float(np.hypot(x1 - x0, y1 - y0)) / _WIDE)


def _enlarged(window: tuple[float, float, float, float]) -> tuple[str, ...]:
    grown = _grown(window)
    return (f"bodies drawn {grown:.2g} times as large",) if grown > 1.0 else ()


class _Point(NamedTuple):
    """An agent of unknown size, where there is none to draw the ego's risk shape for."""

    length: float | None = None
    width: float | None = None


def _ego_rings(scenario: Scenario, zoom: float) -> tuple[Array, ...]:
    shape: EgoShape | None = scenario.ego
    if shape is None:
        return ()
    rings = []
    for body in scenario.agents or (_Point(),):
        centres, forms = shape.pieces(body)
        rings += list(geometry.ellipses(centres * zoom, np.asarray(np.linalg.inv(forms)) * zoom**2, 1.0, n=48))
    return tuple(geometry.union_rings(rings))


def _road(scenario: Scenario, lanes: list[Array], frame: Frame) -> tuple[Array, ...]:
    if scenario.drivable:
        return tuple(frame(polygon) for polygon in scenario.drivable)
    if lanes:
        return tuple(geometry.buffered(lane, 2.3) for lane in lanes)
    x0, y0, x1, y1 = scenario.bounds
    return (frame(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])),)


def _tree(plan: Plan | None, frame: Frame) -> Array:
    if plan is None or not len(plan.search):
        return np.zeros((0, 5))
    edges = plan.search[:: -(-len(plan.search) // _MOST_EDGES)]
    return np.column_stack([frame(edges[:, :2]), frame(edges[:, 2:4]), edges[:, 4]])


def _risk_limit(plan: Plan | None, per_step: Array) -> float:
    """Red is the riskiest step, but no less than an even share of the bound: a harmless plan stays green."""
    share = (plan.bound or 0.0) / max(len(per_step), 1) if plan is not None else 0.0
    return palette.round_up(max(float(per_step.max(initial=0.0)), share, 1e-6))


def _facts(plan: Plan | None) -> tuple[tuple[str, str], ...]:
    if plan is None:
        return ()
    facts = [("status", plan.status.replace("_", " "))]
    if plan.bound is not None:
        facts.append(("risk bound", palette.number(plan.bound)))
    if plan.risk is not None:
        total = float(plan.risk.total)
        text = by_kind(total, plan.risk.kind.value) if total >= palette.NOTHING else palette.number(total)
        facts.append(("total risk", text if text.startswith("<") else _CLAIM[plan.risk.kind] + text))
    facts += [(key, str(plan.settings[key])) for key in ("planner", "checker") if key in plan.settings]
    return tuple(facts)


def legend(pic: Picture) -> list[tuple[str, palette.Ramp, str, str]]:
    """(label, ramp, low end, high end) of the colour scales that the picture uses."""
    risk, weight, time = pic.limits
    bars = []
    if pic.path_risk.any():
        bars.append((pic.per_step, palette.RISK, "0", palette.number(risk)))
    if any((agent.weights < 1.0).any() or agent.covariances.max() > geometry.SPECK**2 for agent in pic.agents):
        bars.append((f"mode weight ({SIGMAS:g}σ)", palette.WEIGHT, "0", f"{weight:g}"))
    if len(pic.tree) and time > 0:
        bars.append(("search", palette.TIME, "0 s", f"{time:.3g} s"))
    return bars


def spent(scenario: Scenario, plan: Plan) -> Array:
    """(T, A) risk of each agent up to each step of the plan; no columns if it does not tell.

    Under dependence "independent" and "boole" from the plan's own marginals; "persistent" needs the sweep once more.

    Raises:
        InputError: for dependence "persistent" if the agents lack factors.
    """
    if plan.risk is None or len(plan.marginals) != len(scenario.agents):
        return np.zeros((len(plan.times), 0))
    if plan.risk.dependence == "persistent":
        from checkers import checker  # noqa: PLC0415
        from riskplan.futures import make_evaluator  # noqa: PLC0415  compiles kernels

        judge = make_evaluator(scenario.agents, scenario.ego, checker("exact"), scenario.times, "persistent")
        return judge.spending(plan.poses)
    columns = []
    for agent, marginal in zip(scenario.agents, plan.marginals, strict=True):
        by_mode = np.clip(np.nan_to_num(marginal), 0.0, 1.0 - 1e-16)
        if agent.weights.ndim == 2:
            weights = np.stack([np.interp(plan.times, agent.times, w) for w in agent.weights.T], axis=-1)
        else:
            weights = agent.weights
        if plan.risk.dependence == "boole":
            columns.append(np.cumsum((weights * by_mode).sum(axis=-1)))
        elif agent.modes == "persistent":
            columns.append(-np.expm1(np.cumsum(np.log1p(-by_mode), axis=0)) @ weights)
        else:
            columns.append(-np.expm1(np.cumsum(np.log1p(-(weights * by_mode).sum(axis=-1)))))
    return np.stack(columns, axis=-1) if columns else np.zeros((len(plan.times), 0))


def _so_far(scenario: Scenario, plan: Plan | None) -> Array | None:
    """(T,) risk up to each step; None unless it ends at the plan's own total."""
    if plan is None or plan.risk is None:
        return None
    if plan.risk.dependence == "independent":
        total = np.minimum(spent(scenario, plan).sum(axis=-1), 1.0)
    else:  # first hits, or what is added up anyway
        total = np.minimum(np.cumsum(plan.risk.per_step), 1.0)
    return total if len(total) and np.isclose(total[-1], float(plan.risk.total), rtol=1e-6, atol=1e-15) else None


def _window(
    ego: Array, length: float, rings: tuple[Array, ...], goals: tuple[Array, ...], agents: tuple[AgentView, ...]
) -> tuple[float, float, float, float]:
    """Box around the ego's way with its risk shape, the goal, and those agents that come near them."""
    ends = [geometry.place(ring, pose) for ring in rings for pose in (ego[0], ego[-1])]
    core = np.concatenate([ego[:, :2], *ends, *(goal.mean(axis=0, keepdims=True) for goal in goals)])
    low, high = core.min(axis=0) - 10.0, core.max(axis=0) + 10.0
    others = [agent.track[:, :2] for agent in agents]
    near = [points[((points >= low) & (points <= high)).all(axis=-1)] for points in others]
    points, around = np.concatenate([core, *near]), 3.0 * float(np.clip(length / 4.5, 0.3, 1.0))
    (x0, y0), (x1, y1) = points.min(axis=0) - around, points.max(axis=0) + around
    return float(x0), float(y0), float(x1), float(y1)
