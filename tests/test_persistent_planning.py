"""Planning with errors that persist: the search's estimate, the exact judge, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import agent, overtake

import riskplan as rp
from riskplan.futures import make_evaluator
from riskplan.report import sample_risk

EXACT = rp.checker("exact")


def lasting(scene, ego=None):
    """The scene with errors that persist."""
    scene = scene.with_agents([rp.persistent(a) for a in scene.agents])
    return scene if ego is None else replace(scene, ego=ego)


def evaluator(scene, resolution=1e-4):
    return make_evaluator(scene.agents, scene.ego, EXACT, scene.times, "persistent", resolution)


def beside(shift):
    """Two seconds in the middle lane, shifted aside."""
    steps = 20
    return np.column_stack([12.0 * 0.1 * np.arange(steps), np.full(steps, 3.5 + shift), np.zeros(steps)])


SHAPES = {
    "discs": None,
    "box": rp.EgoBox(4.6, 1.9),
    "aligned": rp.EgoEllipsoid.aligned(4.6, 1.9),
    "ellipse": rp.EgoEllipsoid.around(4.6, 1.9, 4.6, 1.9),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_the_search_estimates_what_the_judge_states(shape):
    scene = lasting(overtake(gap=20.0), SHAPES[shape])
    ev = evaluator(scene)
    met = 0
    for shift in np.linspace(-2.5, 2.5, 21):
        poses = beside(shift)
        after = np.zeros(ev.groups)
        estimate = ev.charge(poses[1:], 1, np.zeros(ev.groups), np.inf, after)
        exact = float(ev.judge(poses)[0].total)
        if 1e-4 < exact < 0.5:
            met += 1
            assert 0.7 < estimate / exact < 1.4
        assert ev.confirmed(poses, 0.0) == pytest.approx(exact, rel=2e-3, abs=1.1e-5)
    assert met >= 5


def test_rank_and_rest_of_the_factors_do_not_matter():
    base = overtake(agents=1, modes=1, gap=13.0)
    (car,) = base.agents
    poses = beside(0.0)
    full = rp.persistent(car)
    parted = [0.6 * full.factors, 0.6 * full.factors, np.zeros_like(full.factors)]
    for factors in (full.factors[..., :1], np.concatenate(parted, axis=-1), 0.0 * full.factors):
        scene = base.with_agents([replace(full, factors=factors)])
        ev = evaluator(scene)
        estimate = ev.charge(poses[1:], 1, np.zeros(ev.groups), np.inf, np.zeros(ev.groups))
        sampled = sample_risk(poses, scene.times[: len(poses)], scene.agents, scene.ego, 40_000, 0)
        assert 0.01 < sampled.total < 0.99
        assert estimate == pytest.approx(sampled.total, rel=0.3)
        assert float(ev.judge(poses)[0].total) == pytest.approx(sampled.total, rel=0.05)


def test_motions_add_up_whatever_their_cuts():
    scene = lasting(overtake(gap=20.0), rp.EgoBox(4.6, 1.9))
    ev, poses = evaluator(scene), beside(0.8)
    whole = np.zeros(ev.groups)
    total = ev.charge(poses[1:], 1, np.zeros(ev.groups), np.inf, whole)
    assert total > 0
    for cut in (2, 7, 13):
        half, rest = np.zeros(ev.groups), np.zeros(ev.groups)
        first = ev.charge(poses[1:cut], 1, np.zeros(ev.groups), np.inf, half)
        kept = half.copy()
        assert ev.charge(poses[cut:], cut, half, np.inf, rest) == pytest.approx(total, rel=1e-12)
        assert (half == kept).all() or np.array_equal(half.view(np.uint64), kept.view(np.uint64))
        assert np.array_equal(rest[: len(ev.levels(rest))].round(12), whole[: len(ev.levels(whole))].round(12))
        assert first <= total
    again = np.zeros(ev.groups)
    assert ev.charge(poses[1:], 1, whole, np.inf, again) == pytest.approx(total, rel=1e-12)  # what is hit is hit
    assert ev.charge(poses[1:], 1, np.zeros(ev.groups), total / 2, again) > total / 2
    assert np.isnan(ev.charge(poses[1:] * np.nan, 1, np.zeros(ev.groups), np.inf, again))


@pytest.mark.parametrize("planner", ["rrt", "prm"])
@pytest.mark.parametrize("shape", ["discs", "box"])
def test_plans_stay_within_their_bound(planner, shape):
    scene = lasting(overtake(), SHAPES[shape])
    bound = 0.02
    plan = rp.plan(scene, planner, bound=bound, dependence="persistent", time_limit=20.0, seed=3)
    assert plan.solved, plan.message
    agents = [a.at(plan.times) for a in scene.agents]
    judged = rp.path_risk(plan.poses, agents, scene.ego, "persistent")
    assert plan.risk.dependence == "persistent"
    assert float(plan.risk.total) == pytest.approx(float(judged.total), rel=1e-5)
    assert plan.risk.total <= bound
    assert plan.risk.per_step.sum() == pytest.approx(float(plan.risk.total), rel=1e-6)
    assert plan.risk.max_step <= plan.risk.total * (1 + 1e-5) and plan.risk.total <= plan.risk.boole * (1 + 1e-5)
    sampled = sample_risk(plan.poses, plan.times, scene.agents, scene.ego, 100_000, 0, exact_shape=True)
    assert sampled.interval[0] <= float(plan.risk.total)
    again = rp.plan(scene, planner, bound=bound, dependence="persistent", time_limit=20.0, seed=3)
    assert np.array_equal(again.poses, plan.poses)


def test_no_search_can_talk_the_judge_into_a_plan(monkeypatch):
    scene = lasting(overtake(), rp.EgoBox(4.6, 1.9))
    monkeypatch.setattr("riskplan.futures.PersistentEvaluator.charge", lambda *_: 0.0)
    monkeypatch.setattr("riskplan.futures.PersistentEvaluator.confirmed", lambda *_: 0.0)
    for seed in range(5):
        plan = rp.plan(scene, bound=1e-9, dependence="persistent", time_limit=1.0, seed=seed)
        assert not plan.solved or plan.risk.total <= 1e-9


def test_an_arrival_that_is_too_risky_does_not_end_the_search(monkeypatch):
    scene = lasting(overtake(), rp.EgoBox(4.6, 1.9))
    told = []

    def doubting(self, poses, total):  # noqa: ARG001
        told.append(len(poses))
        return 1.0 if len(told) < 3 else 0.0

    monkeypatch.setattr("riskplan.futures.PersistentEvaluator.confirmed", doubting)
    for planner in ("rrt", "prm"):
        told.clear()
        rp.plan(scene, planner, bound=0.05, dependence="persistent", time_limit=10.0, seed=1)
        assert len(told) == 3
        assert min(told) > 40  # whole paths, from the start


def test_it_finds_a_way_where_independence_sees_none():
    car = agent("beside", 0.0, 7.0, 12.0, spread=0.9)
    scene = overtake(agents=1).with_agents([car])
    free = rp.plan(scene, bound=0.02, time_limit=3.0, seed=0)
    kept = rp.plan(lasting(scene), bound=0.02, dependence="persistent", time_limit=20.0, seed=0)
    assert kept.solved
    independent = make_evaluator(scene.agents, scene.ego, EXACT, scene.times)
    assert float(independent.judge(kept.poses)[0].total) > float(kept.risk.total)
    assert not free.solved or free.risk.total <= 0.02


def test_a_prediction_that_begins_with_the_first_step_counts_from_there():
    scene = overtake(agents=1, modes=1, gap=13.0)
    full = rp.persistent(scene.agents[0])
    late = full.at(full.times[1:])
    poses = beside(0.0)
    a, _ = evaluator(scene.with_agents([full])).judge(poses)
    b, marginals = evaluator(scene.with_agents([late])).judge(poses)
    assert float(b.total) == pytest.approx(float(a.total), rel=1e-5)
    assert np.isnan(marginals[0][0]).all() and not np.isnan(marginals[0][1:]).any()
    assert evaluator(scene.with_agents([late])).judge(poses[:1])[0].total == 0.0


def test_marginal_risk_at_any_time():
    scene = lasting(overtake(agents=1, modes=1, gap=13.0))
    ev = evaluator(scene)
    poses = beside(0.0)
    risk, marginals = ev.judge(poses)
    assert ev.at_time(poses[10], 1.0) == pytest.approx(float(marginals[0][10, 0]), rel=1e-5)
    assert np.isnan(ev.at_time(poses[10], 99.0)) and np.isnan(ev.at_time(poses[10] * np.nan, 1.0))
    assert [r.kind for r in ev.marginals(poses)] == [rp.Kind.EXACT]
    assert risk.kind is rp.Kind.EXACT


@pytest.mark.parametrize("shape", ["box", "aligned"])
def test_sampled_futures_meet_the_true_shape(shape):
    scene = lasting(overtake(gap=15.0), SHAPES[shape])
    poses = beside(0.9)
    times = scene.times[: len(poses)]
    exact = rp.path_risk(poses, [a.at(times) for a in scene.agents], scene.ego, "persistent")
    sampled = sample_risk(poses, times, scene.agents, scene.ego, 200_000, 0, confidence=0.9999, exact_shape=True)
    for i, (low, high) in enumerate(sampled.per_agent_interval):
        assert low <= float(exact.per_agent[i]) <= high
    assert 0.005 < sampled.total


def test_audit_says_what_other_backends_bound():
    scene = lasting(overtake(), rp.EgoBox(4.6, 1.9))
    plan = rp.plan(scene, bound=0.05, dependence="persistent", time_limit=20.0, seed=0)
    report = rp.audit(plan, scene, ("exact", "marshall-olkin"), monte_carlo=20_000)
    assert [v.risk.dependence for v in report.verdicts] == ["persistent", "boole"]
    assert report.consistent and report.within_bound
    assert report.verdicts[1].risk.total >= plan.risk.total


@pytest.mark.parametrize(
    ("change", "checker", "message"),
    [
        (lambda a: a, "exact", r"agents\[0\] \(slow\): dependence 'persistent' expects factors, got none"),
        (lambda a: rp.persistent(a).moments(4), "exact", r"agents\[0\] \(slow\): .* expects a Gaussian mixture"),
        (rp.persistent, "imhof", "expected the checker 'exact', got 'imhof'"),
    ],
)
def test_refusals(change, checker, message):
    scene = overtake()
    with pytest.raises(rp.InputError, match=message):
        rp.plan(scene.with_agents([change(a) for a in scene.agents]), checker=checker, dependence="persistent")


def test_without_agents_there_is_nothing_to_persist():
    plan = rp.plan(overtake(agents=1).with_agents(()), dependence="persistent", time_limit=10.0)
    assert plan.solved and plan.risk is None


def test_agents_too_far_away_are_judged_by_bounds_that_change_no_digit():
    times = np.linspace(0.0, 1.0, 5)
    spread = np.tile(np.eye(2), (5, 1, 1, 1))
    near, far = (
        rp.persistent(rp.GaussianMixturePrediction(times, [1.0], np.tile([[x, 0.5]], (5, 1, 1)), spread, name=name))
        for x, name in ((4.0, "near"), (14.0, "far"))
    )
    ego, poses = rp.EgoEllipsoid(np.eye(2)), np.zeros((5, 3))
    both = make_evaluator([near, far], ego, rp.checker("exact"), times, "persistent").judge(poses)
    exact = [rp.path_risk(poses, [a], ego, "persistent") for a in (near, far)]
    assert 0.0 < float(exact[1].total) < 1e-8 * float(exact[0].total)
    assert float(both[0].per_agent[0]) == pytest.approx(float(exact[0].total), rel=1e-5)
    assert float(exact[1].total) <= float(both[0].per_agent[1]) < 1e-7 * float(exact[0].total)
    assert (both[1][1] > 0.0).all()
