"""`plan`: scenario in, judged plan out. Every returned plan is re-judged as a whole and never above the bound."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, replace
from importlib import import_module
from time import perf_counter
from typing import Any

import numpy as np

from checkers import DEPENDENCE, Checker, InputError, TrajectoryRisk, checker
from checkers.validate import as_option, as_scalar
from riskplan.evaluator import RiskEvaluator
from riskplan.result import Plan
from riskplan.rounding import by_kind
from riskplan.scene import Scenario
from riskplan.search import Budget, Planner, Problem, SearchResult
from riskplan.warm_up import warm_up
from riskplan.world import goal_too_far, reachable_regions, start_is_free


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
        "prm",
        "roadmap of Dubins edges, searched in time under the risk budget; reusable for new predictions",
        "Kavraki et al. 1996, OMPL og.PRM sampling",
        "prm:Prm",
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
    as_option("planner", name, tuple(planners()))
    module, cls = planners()[name].implementation.split(":")
    factory = getattr(import_module(f"riskplan.ompl.{module}"), cls)
    valid = [f.name for f in fields(factory)]
    for option in options:
        if option not in valid:
            raise InputError(f"{name}: unknown option {option!r}; expected one of {', '.join(valid)}")
    planner: Planner = factory(**options)
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
    **options: Any,
) -> Plan:
    """A trajectory from start to goal whose total collision risk is within `bound`; or the reason why there is none.

    Args:
        scenario: what is planned for.
        planner: name (see `planners`) or a planner value, e.g. a `Prm` that keeps its roadmap.
        checker: name of a backend (see `checkers`) or a `Checker` with its options.
        bound: on the total risk of the trajectory, start included; None: as low as the time limit allows.
        dependence: how steps combine, "independent" (given a persistent mode) or "boole" (any dependence).
        time_limit: of the search [s]; judging, and compilation at the first use ever, come on top.
        seed: of all randomness; the same seed and enough time give the same plan.
        stop: asked all through the search; True ends it as if its time were up.
        **options: of the planner.

    Returns:
        a `Plan`; `plan.status` says why when it is not "solved". Never a plan above the bound.

    Raises:
        InputError: on unknown names or bad values.
    """
    chosen = _checker(checker)
    method = make_planner(planner, **options) if isinstance(planner, str) else planner
    warm_up(type(method))
    began = perf_counter()
    if bound is not None:
        bound = as_scalar("bound", bound, low=0.0, high=1.0)
    as_option("dependence", dependence, DEPENDENCE)
    time_limit = as_scalar("time_limit", time_limit, low=0.0)
    if not isinstance(seed, int) or isinstance(seed, bool) or not 0 <= seed < 2**31:
        raise InputError(f"seed: expected an integer in [0, 2^31), got {seed!r}")
    # a search that overstates risk by a hundredth of the bound loses next to nothing and gains half of its time
    resolution = 1e-6 if bound is None else max(1e-2 * bound, 1e-30)
    evaluator = RiskEvaluator(scenario.agents, scenario.ego, chosen, scenario.times, dependence, resolution)
    problem = Problem(scenario, evaluator)
    name = planner if isinstance(planner, str) else type(planner).__name__.lower()
    settings = {
        "planner": name,
        "planner_options": _plain(method),
        "checker": chosen.info.name,
        "checker_options": _plain(chosen),
        "bound": bound,
        "dependence": dependence,
        "time_limit": time_limit,
        "seed": seed,
    }
    refusal = _refusal(problem, bound)
    if refusal:
        return _no_plan(*refusal, bound, settings, {"preparation": perf_counter() - began})
    budget = Budget(bound, time_limit, stop)
    prepared = perf_counter()
    found = method.search(problem, budget, seed)
    searched = perf_counter()
    stats = {
        **found.counters,
        "preparation": prepared - began,
        "search": searched - prepared,
        "lowest_risk_seen": min(found.lowest_seen, 1.0) if np.isfinite(found.lowest_seen) else None,
    }
    return _judged(problem, found, bound, settings, stats)


def _refusal(problem: Problem, bound: float | None) -> tuple[str, str] | None:
    """Status and message where no search is worth starting."""
    s = problem.scenario
    if not start_is_free(problem.world, s.start):
        return (
            "start_in_obstacle",
            f"the body at the start ({s.start.x:g}, {s.start.y:g}) is not free of the static world",
        )
    if not reachable_regions(s, problem.world):
        return (
            "goal_in_obstacle",
            "no goal region has a part that is within bounds and free of the static world",
        )
    at_start, _ = problem.evaluator.judge(np.array([problem.start_state[:3]]))
    if bound is not None and at_start is not None and not at_start.total <= bound:
        return "start_at_risk", f"the risk at the start is {_text(at_start)}, above the bound {bound:g}"
    if problem.goal.latest < problem.goal.earliest:
        return "goal_unreachable", "no time of the planning grid within the horizon lies in the goal's time window"
    if goal_too_far(s):
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
            f"no plan within {'reach' if bound is None else f'the bound {bound:g}'} in {stats['search']:.2f} s; {why}"
        )
        return replace(_no_plan("no_plan_found", message, bound, settings, stats), search=found.edges)
    began = perf_counter()
    poses = np.ascontiguousarray(found.states[:, :3])
    risk, marginals = problem.evaluator.judge(poses)
    stats["judging"] = perf_counter() - began
    total = 0.0 if risk is None else float(risk.total)
    if bound is not None and not total <= bound:
        message = f"a trajectory was found but judged at risk {total:.6g}, above the bound {bound:g}"
        stats["lowest_risk_seen"] = total
        return replace(_no_plan("no_plan_found", message, bound, settings, stats), search=found.edges)
    stated = "" if bound is None else f", within {bound:g}"
    return Plan(
        status="solved",
        times=s.times[: len(poses)],
        poses=poses,
        speeds=found.states[:, 3].copy(),
        risk=risk,
        marginals=marginals,
        bound=bound,
        message=f"reached the goal after {s.times[len(poses) - 1]:.1f} s at risk {_text(risk)}{stated}",
        settings=settings,
        stats=stats,
        search=found.edges,
    )


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
