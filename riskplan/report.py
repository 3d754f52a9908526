"""`audit`: judge a plan again, by any backend and by sampling the agents."""

from __future__ import annotations

from collections.abc import Sequence
from time import perf_counter

import numpy as np

from checkers import Checker, EgoShape, InputError, Kind, TrajectoryRisk, checker
from checkers.backends.monte_carlo import clopper_pearson
from checkers.kernels.whiten import pack_pieces
from checkers.validate import Array
from riskplan.evaluator import RiskEvaluator, circumradius
from riskplan.kernels.sampled import hits_any
from riskplan.result import CheckerVerdict, Plan, Report, SampledRisk
from riskplan.scene import Agent, Scenario

_CHUNK = 20_000  # sampled trajectories held at once
_CONFIDENCE = 0.99


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
    if not plan.solved:
        raise InputError(f"plan: expected a solved plan, got status {plan.status!r}")
    if len(plan.times) > scenario.steps + 1 or not np.allclose(plan.times, scenario.times[: len(plan.times)]):
        raise InputError("plan.times: expected the scenario's grid from 0 on")
    if not isinstance(monte_carlo, int) or isinstance(monte_carlo, bool) or monte_carlo < 0:
        raise InputError(f"monte_carlo: expected an integer >= 0, got {monte_carlo!r}")
    dependence = str(plan.settings.get("dependence", "independent"))
    backends = [c if isinstance(c, Checker) else checker(c) for c in checkers]
    verdicts = tuple(_verdict(b, plan, scenario, dependence) for b in backends)
    sampled = None
    if monte_carlo and scenario.agents:
        sampled = sample_risk(plan.poses, plan.times, scenario.agents, scenario.ego, monte_carlo, seed)
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
    )


def sample_risk(
    poses: Array,
    times: Array,
    agents: Sequence[Agent],
    ego: EgoShape,
    samples: int,
    seed: int,
    confidence: float = _CONFIDENCE,
) -> SampledRisk:
    """Share of sampled futures in which some agent is inside the shape at some step of the trajectory (S, 3)."""
    began = perf_counter()
    rng = np.random.default_rng(seed)
    counts, any_count = np.zeros(len(agents)), 0
    known = np.array([hasattr(a, "covariances") and a.order is None for a in agents])
    for first in range(0, samples, _CHUNK):
        n = min(_CHUNK, samples - first)
        some = np.zeros(n, dtype=np.bool_)
        for i, agent in enumerate(agents):
            if not known[i]:
                continue
            covered = times >= agent.times[0] - 1e-6
            pieces = pack_pieces(*ego.pieces(agent))
            if not covered.any() or _never_near(agent.at(times[covered]), poses[covered], circumradius(pieces)):
                continue
            paths = np.ascontiguousarray(agent.at(times[covered]).sample(n, rng))
            hit = np.zeros(n, dtype=np.bool_)
            hits_any(paths, np.ascontiguousarray(poses[covered]), pieces, hit)
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


def _never_near(agent: Agent, poses: Array, reach: float) -> bool:
    """Whether every mode keeps 13 standard deviations off at every step: 1e-38 a step is not worth sampling."""
    spread = np.sqrt(np.linalg.eigvalsh(agent.covariances)[..., 1])
    gap = np.linalg.norm(agent.means - poses[:, None, :2], axis=-1)
    return bool((gap > reach + 13.0 * spread).all())


def _verdict(backend: Checker, plan: Plan, scenario: Scenario, dependence: str) -> CheckerVerdict:
    began = perf_counter()
    name, kind = backend.info.name, backend.info.kind.value
    if not scenario.agents:
        return CheckerVerdict(name, kind, None, 0.0, "no agents")
    evaluator = RiskEvaluator(scenario.agents, scenario.ego, backend, scenario.times, dependence)
    try:
        risk, _ = evaluator.judge(plan.poses)
    except InputError as refusal:
        return CheckerVerdict(name, kind, None, perf_counter() - began, str(refusal))
    return CheckerVerdict(name, _kind_of(risk, kind), risk, perf_counter() - began)


def _kind_of(risk: TrajectoryRisk | None, otherwise: str) -> str:
    return otherwise if risk is None else risk.kind.value
