"""`simulate`: the planner in a closed loop, deciding anew while the agents move and are predicted from their past."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from checkers import (
    PATH_DEPENDENCE,
    Checker,
    ControlPrediction,
    GaussianMixturePrediction,
    InputError,
    Prediction,
    checker,
    persistent,
)
from checkers.validate import Array, as_callable, as_count, as_option, as_scalar, as_seed, as_tuple
from predictor import ConstantVelocity, Track
from predictor.tracks import SLACK
from riskplan.between_steps import BETWEEN_STEPS, RESERVE, inflated
from riskplan.closed_loop_fallback import braking
from riskplan.closed_loop_result import Collision, Cycle, Simulation
from riskplan.closed_loop_traffic import Predictor, Traffic, sampled_traffic, shifted
from riskplan.futures import make_evaluator
from riskplan.planning import as_planner, make_planner
from riskplan.scene import Goal, Scenario, State
from riskplan.search import Budget, Planner, Problem
from riskplan.warm_up import warm_up
from riskplan.world import goal_too_far

if TYPE_CHECKING:
    from riskplan.io.commonroad import CommonRoadScene, HorizonTask

_BRAKING = 4.0  # seconds over which a fallback is judged
_VERTICES = 1000  # of a roadmap made for the loop
_RANGE = 100.0  # agents farther away are not predicted [m]


def simulate(
    scenario: Scenario | CommonRoadScene,
    traffic: Sequence[Track] | Traffic | None = None,
    *,
    planner: str | Planner = "rrt",
    checker: str | Checker = "exact",
    bound: float = 0.01,
    dependence: str = "independent",
    steps: int | None = None,
    replan: float = 0.1,
    time_limit: float = 0.08,
    seed: int = 0,
    predictor: Predictor | None = None,
    problem: int = 0,
    between_steps: str = "grid",
    stop: Callable[[], bool] | None = None,
) -> Simulation:
    """Drive to the goal, deciding every `replan` seconds what to drive.

    A decision knows of the agents what they did until now. It keeps what is left of the plan before if that, judged
    against the new predictions, is within the bound; else it looks for a new plan: from that rest too, as far as it is
    within the bound (`rrt`), or on the roadmap of before (`prm`). Where it finds none, it falls back until the next
    decision: to the gentlest of some ways to brake that is within the bound over 4 s, or else to the least risky of
    them and of the rest of the plan. Agents do not react to the ego.

    Args:
        scenario: a scenario, whose agents' predictions serve for sampling where `traffic` is not given; or a CommonRoad
            scene, of which `problem` is solved among its recorded traffic.
        traffic: true tracks on a clock that is 0 at the start.
        planner, checker, bound, dependence: as in `plan`; the bound is on every plan, from each decision to its end.
        steps: most decisions; None: until the scenario's horizon.
        replan: time from decision to decision [s], a whole number of the scenario's time steps.
        time_limit: of each search [s].
        seed: of all randomness, sampled traffic included.
        predictor: of the agents; None: constant velocity, as fitted.
        problem: of a CommonRoad scene.
        between_steps: as in `plan`: "inflated" bounds the risk at all times.
        stop: asked all along; True ends the loop as if its steps were up.

    Raises:
        InputError: on bad values, and a roadmap for a vehicle that cannot follow one.
    """
    seed = as_seed("seed", seed)
    if steps is not None:
        as_count("steps", steps, 1)
    as_callable("stop", stop)
    if predictor is not None and not callable(getattr(predictor, "predict", None)):
        raise InputError(f"predictor: expected one such as ConstantVelocity.fitted(), got {predictor!r}")
    scenario, road = _scene_and_traffic(scenario, traffic, problem, seed)
    dependence = as_option("dependence", dependence, PATH_DEPENDENCE)
    loop = _Loop(
        scenario=scenario,
        traffic=road,
        predictor=predictor or ConstantVelocity.fitted(),
        planner=_prepared(planner, scenario, seed, dependence),
        checker=_checker(checker),
        bound=as_scalar("bound", bound, low=0.0, high=1.0),
        dependence=dependence,
        stride=_whole("replan", as_scalar("replan", replan, low=0.0, strict=True) / scenario.time_step, scenario),
        time_limit=as_scalar("time_limit", time_limit, low=0.0),
        seed=seed,
        inflate=as_option("between_steps", between_steps, BETWEEN_STEPS) == "inflated",
        stop=stop or (lambda: False),
    )
    name = planner if isinstance(planner, str) else type(planner).__name__.lower()
    settings = {
        "planner": name,
        "checker": loop.checker.info.name,
        "bound": loop.bound,
        "dependence": dependence,
        "between_steps": between_steps,
        "replan": replan,
        "time_limit": time_limit,
        "seed": seed,
        "predictor": type(loop.predictor).__name__,
    }
    return loop.run(steps, settings)


def simulate_task(task: HorizonTask, scene: CommonRoadScene, **options: Any) -> Simulation:
    """`simulate` in the place of a recorded driver (see `CommonRoadScene.horizon_task`) among the other vehicles."""
    return simulate(task.scenario, shifted(scene.tracks, task.t0, besides=task.driver.name), **options)


@dataclass(frozen=True, eq=False)
class _Held:
    """What is being driven: states (T, 5) from now on, and whether they end in the goal."""

    states: Array
    arrives: bool

    def rest(self, stride: int) -> _Held:
        """After `stride` steps of it."""
        return _Held(self.states[stride:], self.arrives)


@dataclass(frozen=True, eq=False)
class _Loop:
    scenario: Scenario
    traffic: Traffic
    predictor: Predictor
    planner: Planner
    checker: Checker
    bound: float
    dependence: str
    stride: int
    time_limit: float
    seed: int
    inflate: bool
    stop: Callable[[], bool]

    @property
    def reserve(self) -> float:
        """What of the bound pays for motion between the steps."""
        return RESERVE * self.bound if self.inflate else 0.0

    def run(self, most: int | None, settings: dict[str, Any]) -> Simulation:
        s, dt = self.scenario, self.scenario.time_step
        start = s.start
        driven = [np.array([[start.x, start.y, start.heading, start.speed, start.steering]])]
        cycles: list[Cycle] = []
        held, step, status, collision = None, 0, "time_up", None
        while step < s.steps and (most is None or len(cycles) < most) and not self.stop():
            cycle, held = self.decide(step, driven[-1][-1], held)
            cycles.append(cycle)
            stretch = cycle.states[: self.stride + 1]
            if len(stretch) < 2:  # it stands at the end of what there is
                stretch = np.repeat(stretch, 2, axis=0)
            contact = self.traffic.first_contact(step * dt, dt, stretch, s.vehicle.body, s.vehicle.disc)
            driven.append(stretch[1:])
            step += len(stretch) - 1
            if contact is not None:
                status = "collided"
                collision = Collision(*contact, cycle.action, cycle.risk, cycle.risk <= self.bound)
                break
            if held.arrives and len(held.states) <= self.stride + 1:
                status = "arrived"
                break
            held = held.rest(self.stride)
        states: Array = np.concatenate(driven)
        return Simulation(
            name=s.name,
            status=status,
            bound=self.bound,
            times=s.times[: len(states)],
            states=states,
            body=s.vehicle.body,
            tracks=self.traffic.tracks,
            cycles=tuple(cycles),
            collision=collision,
            settings=settings,
        )

    def decide(self, step: int, state: Array, held: _Held | None) -> tuple[Cycle, _Held]:
        """What to drive from `state` at a step of the grid, given what was being driven."""
        began = perf_counter()
        problem = self.problem(step, state, held)
        action, status, risk = "kept", "", None
        if held is not None and held.arrives:
            risk = self.judged(problem, held.states)
        if risk is None or not risk[0] <= self.bound:
            action, found, status = "planned", *self.search(problem, step)
            risk = None if found is None else self.judged(problem, found)
            if risk is not None and risk[0] <= self.bound:
                assert found is not None  # noqa: S101  judged
                held = _Held(found, True)
            else:
                action = "fallback"
                held, risk = self.fallback(problem, held)
        assert held is not None and risk is not None  # noqa: S101  kept, planned or fallen back
        total, per_step = risk
        spent = float(per_step[1 : self.stride + 1].sum())
        latency = perf_counter() - began
        time = step * self.scenario.time_step
        cycle = Cycle(time, action, status, held.states, total, spent, len(problem.scenario.agents), latency)
        return cycle, held

    def predicted(self, past: Track, now: float, grid: Array) -> Prediction:
        """The agent at `grid` from now on; a predictor counts from the last observation, which may be older."""
        age = max(now - float(past.times[-1]), 0.0)
        if age <= SLACK:
            return self.predictor.predict(past, grid)
        found = self.predictor.predict(past, grid + age)
        return replace(found.moments(4) if isinstance(found, ControlPrediction) else found, times=grid)

    def problem(self, step: int, state: Array, held: _Held | None) -> Problem:
        """The rest of the task, the agents predicted from their past."""
        s = self.scenario
        now, left = step * s.time_step, s.steps - step
        grid = s.times[: left + 1]
        pasts = self.traffic.pasts(now, state[:2], _RANGE)
        agents = tuple(self.predicted(past, now, grid) for past in pasts)
        if self.dependence == "persistent":
            agents = tuple(
                persistent(a) if isinstance(a, GaussianMixturePrediction) and a.factors is None else a for a in agents
            )
        low, high = s.goal.time
        later = s.with_task(
            start=State(*map(float, state)),
            goal=Goal(s.goal.regions, (max(low - now, 0.0), max(high - now, 0.0))),
            agents=agents,
            horizon=left * s.time_step,
        )
        if self.inflate:
            later = inflated(later, self.bound).scenario
        resolution = max(1e-2 * self.bound, 1e-30)
        evaluator = make_evaluator(later.agents, later.ego, self.checker, later.times, self.dependence, resolution)
        begun = held.states[1:] if held is not None and held.arrives else np.zeros((0, 5))
        return Problem(later, evaluator, begun)

    def search(self, problem: Problem, step: int) -> tuple[Array | None, str]:
        """States (T, 5) to the goal, or the reason why there are none."""
        limit = self.bound - self.reserve
        if not problem.start_total <= limit:
            return None, "start_at_risk"
        if problem.goal.latest < max(problem.goal.earliest, 1) or goal_too_far(problem.scenario, problem.goal):
            return None, "goal_unreachable"
        found = self.planner.search(problem, Budget(limit, self.time_limit, self.stop), self.seed + step)
        if found.states is None:
            return None, "no_plan_found"
        states = found.states
        if states.shape[1] < 5:
            states = np.column_stack([states, np.zeros(len(states))])
        return states, "solved"

    def judged(self, problem: Problem, states: Array) -> tuple[float, Array]:
        """Total risk, and by step."""
        risk, _ = problem.evaluator.judge(np.ascontiguousarray(states[:, :3]))
        if risk is None:
            return 0.0, np.zeros(len(states))
        return min(float(risk.total) + self.reserve, 1.0), risk.per_step

    def fallback(self, problem: Problem, held: _Held | None) -> tuple[_Held, tuple[float, Array]]:
        """The gentlest of the ways to brake that is within the bound; if none is, the least risky choice there is.

        Ways to brake are judged over the first seconds, until they stand: the next decision knows more.
        """
        start = np.array([problem.start_node])
        s = problem.scenario
        steps = min(s.steps, int(np.ceil(_BRAKING / s.time_step)))
        choices = [_Held(np.concatenate([start, b]), False) for b in braking(problem, steps)]
        if held is not None and len(held.states) > 1:
            choices.insert(0, held)
        e, after = problem.evaluator, np.empty_like(problem.start_risk)
        totals: list[float] = []
        for choice in choices:
            poses = np.ascontiguousarray(choice.states[1:, :3])
            totals.append(e.charge(poses, 1, problem.start_risk, np.inf, after))
            if totals[-1] <= self.bound - self.reserve:
                judged = self.judged(problem, choice.states)
                if judged[0] <= self.bound:
                    return choice, judged
        best = choices[int(np.argmin(totals))]
        return best, self.judged(problem, best.states)


def _scene_and_traffic(
    scenario: Scenario | CommonRoadScene, traffic: Sequence[Track] | Traffic | None, problem: int, seed: int
) -> tuple[Scenario, Traffic]:
    if not isinstance(scenario, Scenario):
        if not hasattr(scenario, "scenario"):
            raise InputError(f"scenario: expected a Scenario or a CommonRoad scene, got {scenario!r}")
        chosen = scenario.scenario(problem)
        if traffic is None:
            return chosen, shifted(scenario.tracks, scenario.problems[problem].time)
        scenario = chosen
    if traffic is None:
        return scenario, sampled_traffic(scenario.agents, np.random.default_rng(seed))
    return scenario, traffic if isinstance(traffic, Traffic) else Traffic(as_tuple("traffic", traffic))


def _prepared(planner: str | Planner, scenario: Scenario, seed: int, dependence: str) -> Planner:
    """The planner, compiled; a `prm` with the roadmap that all of its searches use."""
    method = make_planner(planner) if isinstance(planner, str) else as_planner(planner)
    warm_up(type(method), dependence)
    if getattr(method, "roadmap", "none") is None:
        from riskplan.ompl.roadmap import Roadmap  # noqa: PLC0415  only where it is needed

        return replace(method, roadmap=Roadmap.build(scenario, max(method.size, _VERTICES), seed))  # type: ignore[type-var, attr-defined]
    return method


def _checker(value: str | Checker) -> Checker:
    return value if isinstance(value, Checker) else checker(value)


def _whole(name: str, steps: float, scenario: Scenario) -> int:
    if not steps <= scenario.steps or abs(steps - round(steps)) > 1e-6 or round(steps) < 1:
        raise InputError(
            f"{name}: expected a whole number of the scenario's steps of {scenario.time_step:g} s, "
            f"got {steps * scenario.time_step:g} s"
        )
    return round(steps)
