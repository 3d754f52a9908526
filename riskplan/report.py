"""`audit`: judge a plan again, by any backend and by sampling the agents."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from time import perf_counter

import numpy as np
from scipy.special import ndtri

from checkers import Checker, EgoShape, GaussianMixturePrediction, InputError, Kind, TrajectoryRisk, checker
from checkers import checkers as registered
from checkers.backends.monte_carlo import clopper_pearson
from checkers.kernels.path import FIXED
from checkers.packing import pack_pieces
from checkers.path import headings_for, shape_against
from checkers.resample import single_mode
from checkers.validate import Array, as_count, as_instance, as_seed, as_tuple
from riskplan.between_steps import for_all_times
from riskplan.futures import make_evaluator
from riskplan.kernels.sampled import hits_any, hits_turning
from riskplan.packing import circumradius
from riskplan.result import CheckerVerdict, Plan, Report, SampledRisk
from riskplan.scene import Agent, Scenario

_CHUNK = 20_000  # sampled trajectories held at once
_CONFIDENCE = 0.99
_MISSED = 1e-6  # hits that leaving out what is far away may cost, of all samples of an agent


def audit(
    plan: Plan,
    scenario: Scenario,
    checkers: Sequence[str | Checker] = ("exact",),
    monte_carlo: int = 100_000,
    seed: int = 0,
) -> Report:
    """What each backend, and `monte_carlo` sampled futures of the agents, say of the plan.

    The sampled futures are judged on the shape's union of pieces at every grid step, so for a cover the sampled risk is
    at or below the union bound that the backends state.

    Args:
        plan: solved.
        scenario: the one it was made for.
        checkers: names or backends with options.
        monte_carlo: number of samples; 0 for none.
        seed: of the samples.

    Raises:
        InputError: for a plan without a trajectory, one that does not fit the scenario, unknown names.
    """
    as_instance("plan", plan, Plan)
    as_instance("scenario", scenario, Scenario)
    as_seed("seed", seed)
    as_count("monte_carlo", monte_carlo, 0, 2**31 - 1)
    if not plan.solved:
        raise InputError(f"plan: expected a solved plan, got status {plan.status!r}")
    if len(plan.times) > scenario.steps + 1 or not np.allclose(plan.times, scenario.times[: len(plan.times)]):
        raise InputError("plan.times: expected the scenario's grid from 0 on")
    dependence = str(plan.settings.get("dependence", "independent"))
    backends = [c if isinstance(c, Checker) else checker(c) for c in as_tuple("checkers", checkers)]
    wide = for_all_times(scenario, plan.settings) if plan.settings.get("between_steps") == "inflated" else None
    scenario = scenario if wide is None else wide.scenario
    verdicts = tuple(_verdict(b, plan, scenario, dependence) for b in backends)
    if wide is not None:  # sampling, on the grid too, has nothing to add
        verdicts = tuple(replace(v, risk=wide.stated(v.risk)) for v in verdicts)
    sampled = None
    if monte_carlo and scenario.agents:
        exact_shape = dependence == "persistent"
        sampled = sample_risk(
            plan.poses, plan.times, scenario.agents, scenario.ego, monte_carlo, seed, exact_shape=exact_shape
        )
    stated = [v.risk for v in verdicts if v.risk is not None and v.kind != Kind.ESTIMATE.value]
    stated += [plan.risk] if plan.risk is not None and plan.risk.kind is not Kind.ESTIMATE else []
    within = None
    if plan.bound is not None:
        within = plan.risk is None or bool(plan.risk.total <= plan.bound)
    return Report(
        agents=tuple(a.name or f"agent {i}" for i, a in enumerate(scenario.agents)),
        times=plan.times,
        verdicts=verdicts,
        sampled=sampled,
        bound=plan.bound,
        within_bound=within,
        consistent=sampled is None or not any(sampled.interval[0] > float(r.total) for r in stated),
        stats=plan.stats,
        spending=_spending(plan, scenario, dependence, backends),
    )


def _spending(plan: Plan, scenario: Scenario, dependence: str, backends: Sequence[Checker]) -> Array:
    """(T, A) how the budget is spent along the plan, by the checker that planned; (T, 0) if that is not at hand."""
    name, options = str(plan.settings.get("checker", "exact")), dict(plan.settings.get("checker_options", {}))
    own = [b for b in backends if b.info.name == name]
    if not own and name in registered():
        own = [checker(name, **options)]
    if not scenario.agents or not own:
        return np.zeros((len(plan.times), 0))
    try:
        return make_evaluator(scenario.agents, scenario.ego, own[0], scenario.times, dependence).spending(plan.poses)
    except InputError:  # agents that this checker cannot read; its verdict tells
        return np.zeros((len(plan.times), 0))


def sample_risk(
    poses: Array,
    times: Array,
    agents: Sequence[Agent],
    ego: EgoShape,
    samples: int,
    seed: int,
    confidence: float = _CONFIDENCE,
    *,
    exact_shape: bool = False,
) -> SampledRisk:
    """Share of sampled futures in which some agent is inside the shape at some step of the trajectory (S, 3).

    With `exact_shape` a box is a box and an ellipse turns with the agent; else the pieces that backends see are judged.
    """
    began = perf_counter()
    rng = np.random.default_rng(seed)
    counts, any_count = np.zeros(len(agents)), 0
    known = np.array([hasattr(a, "covariances") and a.order is None for a in agents])
    near = [_near(a, times, poses, ego, samples) if k else None for a, k in zip(agents, known, strict=True)]
    for first in range(0, samples, _CHUNK):
        n = min(_CHUNK, samples - first)
        some = np.zeros(n, dtype=np.bool_)
        for i, met in enumerate(near):
            if met is None:
                continue
            hit = _hits(*met[:2], ego if exact_shape else None, met[2], n, rng)
            counts[i] += np.count_nonzero(hit)
            some |= hit
        any_count += int(np.count_nonzero(some))
    low, high = clopper_pearson(np.append(counts, any_count), samples, confidence)
    share = np.where(known, counts / samples, np.nan)
    interval = np.where(known[:, None], np.column_stack([low, high])[:-1], np.nan)
    nothing = not known.any()  # nothing sampled is nothing known, not no risk
    return SampledRisk(
        samples,
        np.nan if nothing else any_count / samples,
        (np.nan, np.nan) if nothing else (float(low[-1]), float(high[-1])),
        share,
        interval,
        confidence,
        bool(known.all()),
        perf_counter() - began,
    )


def _hits(
    agent: Agent, poses: Array, ego: EgoShape | None, pieces: Array, n: int, rng: np.random.Generator
) -> np.ndarray:
    """Which of n futures enter the pieces, or the ego's true shape if it is given."""
    hit = np.zeros(n, dtype=np.bool_)
    kind, shape = (FIXED, pieces) if ego is None else shape_against(ego, agent)  # type: ignore[arg-type]
    if kind == FIXED:
        hits_any(np.ascontiguousarray(agent.sample(n, rng)), poses, shape, hit)
        return hit
    assert isinstance(agent, GaussianMixturePrediction)  # noqa: S101  others have no shape that turns
    headings = headings_for(agent, kind)
    first = 0
    # a shape that turns with the agent turns with its mode: modes one by one
    for k, count in enumerate(rng.multinomial(n, agent.weights)):
        paths = np.ascontiguousarray(single_mode(agent, k).sample(int(count), rng))
        hits_turning(kind, shape[0], np.ascontiguousarray(headings[:, k]), paths, poses, hit[first : first + count])
        first += count
    return rng.permutation(hit)


def _near(agent: Agent, times: Array, poses: Array, ego: EgoShape, samples: int) -> tuple[Agent, Array, Array] | None:
    """The agent at those steps at which it may be met, the poses there, and the shape's pieces; None if there are none.

    The others are left out where all samples together would see less than a millionth of a hit at them.
    """
    pieces = pack_pieces(*ego.pieces(agent))
    covered = np.flatnonzero(times >= agent.times[0] - 1e-6)
    if not len(covered):
        return None
    there = agent.at(times[covered])
    spread = np.sqrt(np.linalg.eigvalsh(there.covariances)[..., 1])
    gap = np.linalg.norm(there.means - poses[covered, None, :2], axis=-1)
    least = -ndtri(_MISSED / (samples * gap.size))
    met = covered[(gap <= circumradius(pieces) + least * spread).any(axis=1)]
    return (agent.at(times[met]), np.ascontiguousarray(poses[met]), pieces) if len(met) else None


def _verdict(backend: Checker, plan: Plan, scenario: Scenario, dependence: str) -> CheckerVerdict:
    began = perf_counter()
    name, kind = backend.info.name, backend.info.kind.value
    if not scenario.agents:
        return CheckerVerdict(name, kind, None, 0.0, "no agents")
    if dependence == "persistent" and name != "exact":
        dependence = "boole"  # what backends for one step can say where steps depend on each other
    try:
        evaluator = make_evaluator(scenario.agents, scenario.ego, backend, scenario.times, dependence)
        risk, _ = evaluator.judge(plan.poses)
    except InputError as refusal:
        return CheckerVerdict(name, kind, None, perf_counter() - began, str(refusal))
    return CheckerVerdict(name, _kind_of(risk, kind), risk, perf_counter() - began)


def _kind_of(risk: TrajectoryRisk | None, otherwise: str) -> str:
    return otherwise if risk is None else risk.kind.value
