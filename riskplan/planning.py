"""`plan`: scenario in, judged plan out. Every returned plan is re-judged as a whole and never above the bound."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, replace
from importlib import import_module
from time import perf_counter
from typing import Any

import numpy as np

from checkers import PATH_DEPENDENCE, Checker, InputError, TrajectoryRisk, checker
from checkers.validate import as_callable, as_instance, as_option, as_scalar
from riskplan.between_steps import BETWEEN_STEPS, Inflated, for_all_times
from riskplan.futures import make_evaluator
from riskplan.refused import REFUSED
from riskplan.result import Plan
from riskplan.rounding import by_kind
from riskplan.scene import Scenario
from riskplan.search import Budget, Planner, Problem, SearchResult
from riskplan.warm_up import warm_up
from riskplan.world import goal_reachable, goal_too_far, start_is_free


@dataclass(frozen=True)
class PlannerInfo:
    """What a planner declares of itself.

    Attributes:
        name: what `rp.plan(planner=name)` takes.
        summary: one line.
        source: author, year.
        implementation: "module:Class".
    """

    name: str
    summary: str
    source: str
    implementation: str


# adding a planner: one file, one entry
_PLANNERS = (
    PlannerInfo(
        "rrt",
        "tree over controls; every node carries its total risk; first plan, or the least risk in the time limit",
        "LaValle & Kuffner 2001, OMPL oc.RRT",
        "rrt:Rrt",
    ),
    PlannerInfo(
        "rrt-star",
        "anytime: the first plan of rrt, made cheaper in time, comfort and risk until the time limit",
        "Hauser & Zhou 2016 (AO-RRT), on OMPL oc.RRT",
        "rrt_star:RrtStar",
    ),
    PlannerInfo(
        "prm",
        "roadmap of smooth edges, searched in time under the risk budget; reusable for new predictions",
        "Kavraki et al. 1996, OMPL og.PRM sampling",
        "prm:Prm",
    ),
    PlannerInfo(
        "prm-lazy",
        "prm that judges a way only once it leads to the goal; for costly checkers",
        "Bohlin & Kavraki 2000, OMPL og.PRM sampling",
        "prm_lazy:PrmLazy",
    ),
    PlannerInfo(
        "rrt-capped",
        "baseline without memory: rrt with a cap on every step in place of the total it carries",
        "LaValle & Kuffner 2001, OMPL oc.RRT",
        "capped:RrtCapped",
    ),
    PlannerInfo(
        "rrt-connect-capped",
        "baseline without memory: guides through place and time under a cap on every step, followed by the vehicle",
        "Kuffner & LaValle 2000, OMPL og.RRTConnect",
        "capped:RrtConnectCapped",
    ),
    PlannerInfo(
        "rrt-star-capped",
        "the same baseline, guides by RRT*",
        "Karaman & Frazzoli 2011, OMPL og.RRTstar",
        "capped:RrtStarCapped",
    ),
    PlannerInfo(
        "fmt-capped",
        "the same baseline, guides by FMT*",
        "Janson et al. 2015, OMPL og.FMT",
        "capped:FmtCapped",
    ),
)


def planners() -> dict[str, PlannerInfo]:
    """The planners by name."""
    return {info.name: info for info in _PLANNERS}


def make_planner(name: str, **options: Any) -> Planner:
    """The planner of that name with its options as keywords.

    Raises:
        InputError: for an unknown name or option, listing the valid ones.
    """
    if isinstance(name, str) and name in REFUSED:
        raise InputError(f"{name}: {REFUSED[name]}; expected one of {', '.join(planners())}")
    as_option("planner", name, tuple(planners()))
    module, cls = planners()[name].implementation.split(":")
    factory = getattr(import_module(f"riskplan.ompl.{module}"), cls)
    valid = [f.name for f in fields(factory)]
    for option in options:
        if option not in valid:
            raise InputError(f"{name}: unknown option {option!r}; expected one of {', '.join(valid)}")
    planner: Planner = factory(**options)
    return planner


def as_planner(value: Any) -> Planner:
    """A planner value.

    Raises:
        InputError: for anything that cannot search.
    """
    if isinstance(value, type) or not callable(getattr(value, "search", None)):
        raise InputError(f"planner: expected one of {', '.join(planners())}, or a planner such as Prm(); got {value!r}")
    planner: Planner = value
    return planner


def plan(
    scenario: Scenario,
    planner: str | Planner = "rrt",
    checker: str | Checker = "exact",
    bound: float | None = 0.01,
    dependence: str = "independent",
    time_limit: float = 1.0,
    seed: int = 0,
    stop: Callable[[], bool] | None = None,
    *,
    between_steps: str = "grid",
    step_bound: float | None = None,
    agent_bound: float | None = None,
    iterations: int | None = None,
    workers: int = 1,
    **options: Any,
) -> Plan:
    """A trajectory from start to goal whose total collision risk is within `bound`; or the reason why there is none.

    Args:
        scenario: what is planned for.
        planner: name (see `planners`) or a planner value, e.g. a `Prm` that keeps its roadmap.
        checker: name of a backend (see `checkers`) or a `Checker` with its options.
        bound: on the total risk of the trajectory, start included; None: as low as the time limit allows.
        dependence: how steps combine, "independent" (given a persistent mode), "persistent" (errors last as the agents'
            `factors` say; see `rp.persistent`; checker "exact" only) or "boole" (any dependence).
        time_limit: of the search [s]; judging, and compilation at the first use ever, come on top.
        seed: of all randomness; the same seed, versions and iterations give the same plan, if time does not end first
            (`plan.stats["ended_by"]` tells).
        stop: asked all through the search; True ends it as if its time were up.
        between_steps: "grid", the risk at the times of the grid; or "inflated", a bound of the risk at all times, by
            bodies as large as they may move within half a step (see `riskplan.between_steps`).
        step_bound: on the risk of every step, over all agents, as in `plan.risk.per_step`; held beside `bound`.
        agent_bound: on the risk of every agent, as in `plan.risk.per_agent`; held beside `bound`.
        iterations: most motions of a tree, or labels and vertices of a roadmap; None: as many as time allows.
        workers: processes that search with seeds `seed`, `seed + 1`, …; see `riskplan.workers`.
        **options: of the planner.

    Returns:
        a `Plan`; `plan.status` says why when it is not "solved". Never a plan above the bound.

    Raises:
        InputError: on unknown names or bad values.
    """
    chosen = _checker(checker)
    as_instance("scenario", scenario, Scenario)
    as_callable("stop", stop)
    method = make_planner(planner, **options) if isinstance(planner, str) else as_planner(planner)
    asked = {"bound": bound, "step_bound": step_bound, "agent_bound": agent_bound, "dependence": dependence}
    asked |= {"time_limit": time_limit, "seed": seed, "iterations": iterations, "workers": workers}
    settings = _settings(planner, method, chosen, asked)
    if as_option("between_steps", between_steps, BETWEEN_STEPS) == "inflated":
        wide = for_all_times(scenario, settings)
        left = {**options, **wide.left(settings), "iterations": iterations, "workers": workers}
        on_grid = plan(
            wide.scenario, planner, checker, dependence=dependence, time_limit=time_limit, seed=seed, stop=stop, **left
        )
        return _in_continuous_time(on_grid, wide, settings)
    if workers > 1:
        from riskplan.workers import plan_with_workers  # noqa: PLC0415  multiprocessing costs import time

        return plan_with_workers(scenario, method, chosen, settings, stop)
    return search_once(scenario, method, chosen, settings, stop)


def search_once(
    scenario: Scenario,
    method: Planner,
    backend: Checker,
    settings: dict[str, Any],
    stop: Callable[[], bool] | None = None,
) -> Plan:
    """One search in this process, with settings that were checked."""
    warm_up(type(method), settings["dependence"])
    began = perf_counter()
    bound, dependence = settings["bound"], settings["dependence"]
    limits = [math.inf if settings[name] is None else settings[name] for name in ("step_bound", "agent_bound")]
    # a search that overstates risk by a hundredth of the bound loses next to nothing and gains half of its time
    least = min(math.inf if bound is None else bound, *limits)
    resolution = max(1e-2 * least, 1e-30) if least < math.inf else 1e-6
    fixed = (scenario.agents, scenario.ego, backend, scenario.times, dependence, resolution)
    problem = Problem(scenario, make_evaluator(*fixed, *limits))
    refusal = _refusal(problem, bound)
    if refusal:
        return _no_plan(*refusal, bound, settings, {"preparation": perf_counter() - began})
    budget = Budget(bound, settings["time_limit"], stop, settings["iterations"])
    prepared = perf_counter()
    found = method.search(problem, budget, settings["seed"])
    searched = perf_counter()
    stats = {
        **found.counters,
        "iterations": budget.iterations,
        "ended_by": budget.ended_by,
        "preparation": prepared - began,
        "search": searched - prepared,
        "lowest_risk_seen": min(found.lowest_seen, 1.0) if np.isfinite(found.lowest_seen) else None,
    }
    return _judged(problem, found, bound, settings, stats)


def _in_continuous_time(found: Plan, wide: Inflated, asked: dict[str, Any]) -> Plan:
    """The plan made for larger bodies, stating the risk at all times."""
    bound = asked["bound"]
    stats = {**found.stats, "inflation_ego": list(wide.ego), "inflation_agents": wide.agents.tolist()}
    settings = {**asked, "between_steps": "inflated"}
    told = replace(found, bound=bound, settings=settings, stats=stats, risk=wide.stated(found.risk))
    if not told.solved:
        return told
    within = "" if bound is None else f", within {bound:g}"
    reached = f"reached the goal after {found.times[-1]:.1f} s at risk {_text(told.risk)} at all times{within}"
    return replace(told, message=reached)


def _settings(planner: str | Planner, method: Planner, backend: Checker, given: dict[str, Any]) -> dict[str, Any]:
    """All that was asked for, checked, as a plan carries it."""
    out: dict[str, Any] = {
        "planner": planner if isinstance(planner, str) else type(planner).__name__.lower(),
        "planner_options": _plain(method),
        "checker": backend.info.name,
        "checker_options": _plain(backend),
    }
    for name in ("bound", "step_bound", "agent_bound"):
        out[name] = None if given[name] is None else as_scalar(name, given[name], low=0.0, high=1.0)
    out["dependence"] = as_option("dependence", given["dependence"], PATH_DEPENDENCE)
    out["time_limit"] = as_scalar("time_limit", given["time_limit"], low=0.0)
    for name, least, most in (("seed", 0, 2**31), ("iterations", 1, 2**63), ("workers", 1, 257)):
        value = given[name]
        if value is None and name == "iterations":
            pass
        elif not isinstance(value, int) or isinstance(value, bool) or not least <= value < most:
            ends = (
                f"in [{least}, 2^31)"
                if name == "seed"
                else f">= {least}" + (" and <= 256" if name == "workers" else "")
            )
            raise InputError(f"{name}: expected an integer {ends}, got {value!r}")
        out[name] = value
    return out


def _refusal(problem: Problem, bound: float | None) -> tuple[str, str] | None:
    """Status and message where no search is worth starting."""
    s = problem.scenario
    if not start_is_free(problem.world, s.start):
        return (
            "start_in_obstacle",
            f"the body at the start ({s.start.x:g}, {s.start.y:g}) is not free of the static world",
        )
    if not goal_reachable(s, problem.world, problem.goal):
        return (
            "goal_in_obstacle",
            "no goal region has a part that is within bounds and free of the static world",
        )
    # a charge is never below the judged value
    if not problem.start_total <= (np.inf if bound is None else bound):
        at_start, _ = problem.evaluator.judge(np.array([problem.start_state[:3]]))
        broken = problem.evaluator.broken(at_start, bound)
        if broken:
            return "start_at_risk", f"the risk at the start is {_text(at_start)} {broken}"
    if problem.goal.latest < problem.goal.earliest:
        return "goal_unreachable", "no time of the planning grid within the horizon lies in the goal's time window"
    if goal_too_far(s, problem.goal):
        return (
            "goal_unreachable",
            "no goal region is within reach of the vehicle inside the time window and horizon",
        )
    return None


def _judged(
    problem: Problem,
    found: SearchResult,
    bound: float | None,
    settings: dict[str, Any],
    stats: dict[str, Any],
) -> Plan:
    s = problem.scenario
    if found.states is None:
        seen = stats["lowest_risk_seen"]
        why = (
            f"of the ways to the goal that were seen the least risk was {seen:.3g}"
            if seen is not None
            else "no way to the goal was seen"
        )
        message = (
            f"no plan within {_bounds(settings)} in {stats['search']:.2f} s, {stats['iterations']} iterations; {why}"
        )
        return replace(_no_plan("no_plan_found", message, bound, settings, stats), search=found.edges)
    began = perf_counter()
    poses = np.ascontiguousarray(found.states[:, :3])
    risk, marginals = problem.evaluator.judge(poses)
    stats["judging"] = perf_counter() - began
    total = 0.0 if risk is None else float(risk.total)
    broken = problem.evaluator.broken(risk, bound)
    if broken:
        message = f"a trajectory was found but judged at risk {total:.6g} {broken}"
        stats["lowest_risk_seen"] = total
        return replace(_no_plan("no_plan_found", message, bound, settings, stats), search=found.edges)
    stated = "" if bound is None else f", within {bound:g}"
    return Plan(
        status="solved",
        times=s.times[: len(poses)],
        poses=poses,
        speeds=found.states[:, 3].copy(),
        steering=found.states[:, 4].copy() if found.states.shape[1] > 4 else np.zeros(len(poses)),
        risk=risk,
        marginals=marginals,
        bound=bound,
        message=f"reached the goal after {s.times[len(poses) - 1]:.1f} s at risk {_text(risk)}{stated}",
        settings=settings,
        stats=stats,
        search=found.edges,
    )


def _bounds(settings: dict[str, Any]) -> str:
    """The bounds that are set, in words."""
    named = (("bound", ""), ("step_bound", " per step"), ("agent_bound", " per agent"))
    parts = [f"{settings[name]:g}{of}" for name, of in named if settings[name] is not None]
    return f"the bound {', '.join(parts)}" if parts else "reach"


def _text(risk: TrajectoryRisk | None) -> str:
    return "0, without agents" if risk is None else by_kind(float(risk.total), risk.kind.value)


def _no_plan(status: str, message: str, bound: float | None, settings: dict[str, Any], stats: dict[str, Any]) -> Plan:
    nothing = np.zeros(0)
    return Plan(status, nothing, np.zeros((0, 3)), nothing, None, (), bound, message, settings, stats)


def _checker(value: str | Checker) -> Checker:
    if isinstance(value, Checker):
        return value
    return checker(value)


def _plain(value: Any) -> dict[str, Any]:
    """Options of a frozen dataclass that a file can hold."""
    options = asdict(value) if hasattr(value, "__dataclass_fields__") else {}
    return {k: v for k, v in options.items() if isinstance(v, bool | int | float | str | None)}
