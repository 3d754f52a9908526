"""The risk stated for all times is never below that of futures sampled 100 times as finely."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import agent, overtake
from scipy.stats import binomtest

import riskplan as rp
from riskplan.closed_loop_traffic import rectangles_meet
from riskplan.kernels.steer import steer

FINE = 100


def fine_ego(vehicle, scene, plan):
    """(S, 3) the ego between the steps of the grid, by its own equations, in hundredths of a step."""
    out = []
    for i in range(len(plan.times) - 1):
        p, q = plan.poses[i], plan.poses[i + 1]
        share = np.arange(FINE)[:, None] / FINE
        turn = np.angle(np.exp(1j * (q[2] - p[2])))
        v0, v1 = plan.speeds[i], plan.speeds[i + 1]
        # constant acceleration along an arc between the two
        way = (v0 * share + 0.5 * (v1 - v0) * share**2) / max(0.5 * (v0 + v1), 1e-9)
        half = 0.5 * turn
        chord = q[:2] - p[:2]
        radius_turn = turn * way
        if abs(turn) > 1e-9:
            scale = np.sin(0.5 * radius_turn) / np.sin(half)
            angle = 0.5 * radius_turn - half
            c, s = np.cos(angle), np.sin(angle)
            xy = p[:2] + scale * np.hstack([c * chord[0] - s * chord[1], s * chord[0] + c * chord[1]])
        else:
            xy = p[:2] + way * chord
        out.append(np.hstack([xy, p[2] + radius_turn]))
    return np.vstack([*out, plan.poses[-1:]])


def fine_hits(poses, futures, headings, size, other, every=1):
    """(n,) futures whose rectangle meets the ego's at any fine time; (n, S, 2)."""
    hit = np.zeros(len(futures), dtype=bool)
    for s in range(0, len(poses), every):
        near = np.flatnonzero(~hit & (np.hypot(*(futures[:, s] - poses[s, :2]).T) < 8))
        if len(near):
            others = np.column_stack([futures[near, s], np.full(len(near), headings[s])])
            hit[near] = rectangles_meet(np.broadcast_to(poses[s], (len(near), 3)), size, others, other)
    return hit


def fine_futures(pred, times, n, rng):
    """(n, S, 2) with errors that persist, moving linearly between the times of the grid."""
    known = rp.persistent(pred).at(times)
    coarse = known.sample(n, rng)
    share = (np.arange((len(times) - 1) * FINE) % FINE / FINE)[:, None]
    left = np.repeat(np.arange(len(times) - 1), FINE)
    fine = (1 - share) * coarse[:, left] + share * coarse[:, left + 1]
    return np.concatenate([fine, coarse[:, -1:]], axis=1)


def crossing(step):
    """A car crosses the ego's way so fast that both are apart at the times of a coarse grid."""
    times = np.arange(round(3 / step) + 1) * step
    t = times[:, None]
    means = np.hstack([np.full_like(t, 22.0), -30.0 + 20.0 * t])[:, None]
    spread = np.stack([np.diag([(0.3 + 0.2 * x) ** 2, (0.4 + 0.5 * x) ** 2]) for x in times])[:, None]
    headings = np.full((len(times), 1), np.pi / 2)
    pred = rp.GaussianMixturePrediction(times, [1.0], means, spread, name="x", length=4.5, width=1.8, headings=headings)
    return rp.Scenario(
        start=rp.State(0, 0, 0, 14),
        goal=rp.Goal.at(42, 0, radius=6),
        bounds=(-5, -6, 60, 6),
        agents=(rp.persistent(pred),),
        ego=rp.EgoBox(4.5, 1.8),
        vehicle=rp.KinematicCar(max_speed=16.0),
        time_step=step,
    )


@pytest.mark.parametrize("step", [0.1, 0.5])
def test_larger_bodies_bound_the_finely_sampled_risk_where_the_grid_does_not(step):
    scene = crossing(step)
    poses = np.column_stack([14.0 * scene.times, 0 * scene.times, 0 * scene.times])
    wide = rp.inflated(scene, 0.1)
    grid = float(rp.path_risk(poses, scene.agents, scene.ego, "persistent").total)
    stated = float(wide.stated(rp.path_risk(poses, wide.scenario.agents, wide.scenario.ego, "persistent")).total)
    times = np.arange((len(scene.times) - 1) * FINE + 1) * step / FINE
    ego = np.column_stack([14.0 * times, 0 * times, 0 * times])
    n = 4000
    futures = fine_futures(scene.agents[0], scene.times, n, np.random.default_rng(1))
    hits = int(
        fine_hits(ego, futures, np.full(len(times), np.pi / 2), (4.5, 1.8), (4.5, 1.8), 2 if step < 0.2 else 1).sum()
    )
    interval = binomtest(hits, n).proportion_ci(0.999)
    assert stated >= interval.low
    assert stated >= hits / n
    if step == 0.5:
        assert grid < interval.low  # what the mode is for
    else:
        assert stated < 3 * hits / n  # and a short step costs little


SHAPES = [rp.EgoBox(4.5, 1.8), rp.EgoCover.discs(4.5, 1.8), rp.EgoEllipsoid.around(4.5, 1.8, 4.5, 1.8)]


@pytest.mark.parametrize("ego", SHAPES, ids=lambda e: type(e).__name__)
def test_a_car_that_passes_a_standing_one_within_a_step_is_seen(ego):
    scene = crossing(0.5)
    means = scene.agents[0].means + [0.0, 5.0]  # 5 m short of the ego at one time, 5 m beyond it at the next
    scene = replace(
        scene,
        start=rp.State(22, 0, 0, 0),
        goal=rp.Goal.at(22, 0),
        agents=(replace(scene.agents[0], means=means),),
        vehicle=rp.KinematicCar(max_speed=0.1),
        ego=ego,
    )
    poses = np.tile([22.0, 0.0, 0.0], (len(scene.times), 1))
    wide = rp.inflated(scene, 0.1)
    stated = float(wide.stated(rp.path_risk(poses, wide.scenario.agents, wide.scenario.ego, "persistent")).total)
    times = np.arange((len(scene.times) - 1) * FINE + 1) * 0.5 / FINE
    fine = np.tile([22.0, 0.0, 0.0], (len(times), 1))
    futures = fine_futures(scene.agents[0], scene.times, 2000, np.random.default_rng(1))
    hits = int(fine_hits(fine, futures, np.full(len(times), np.pi / 2), (4.5, 1.8), (4.5, 1.8)).sum())
    assert stated >= hits / 2000 > 0.9
    if isinstance(ego, rp.EgoBox):
        assert float(rp.path_risk(poses, scene.agents, ego, "persistent").total) < 0.9 * hits / 2000


@pytest.mark.parametrize("ego", ["box", "aligned", "discs", "ellipse"])
def test_plans_made_for_all_times_hold_when_sampled_finely(ego):
    shape = {
        "box": rp.EgoBox(4.6, 1.9),
        "aligned": rp.EgoEllipsoid.aligned(4.6, 1.9),
        "discs": rp.EgoCover.discs(4.6, 1.9, 6),
        "ellipse": rp.EgoEllipsoid.around(4.6, 1.9, 4.6, 1.9),
    }[ego]
    scene = overtake(agents=2)
    scene = replace(scene, ego=shape, agents=tuple(rp.persistent(a) for a in scene.agents))
    scene = replace(scene, vehicle=rp.KinematicCar(length=4.6, width=1.9, max_speed=20.0))
    bound = 0.8 if ego == "ellipse" else 0.3
    plan = rp.plan(scene, bound=bound, dependence="persistent", between_steps="inflated", time_limit=30.0)
    assert plan.solved, plan.message
    assert f"at all times, within {bound}" in plan.message and plan.bound == bound and float(plan.risk.total) <= bound
    poses, n, rng = fine_ego(scene.vehicle, scene, plan), 1000, np.random.default_rng(2)
    hit = np.zeros(n, dtype=bool)
    for a in scene.agents:
        known = rp.persistent(a).at(plan.times)
        for k, weight in enumerate(known.weights):  # every mode with its share of the futures
            part = replace(
                known,
                weights=[1.0],
                means=known.means[:, k : k + 1],
                covariances=known.covariances[:, k : k + 1],
                factors=known.factors[:, k : k + 1],
                headings=known.headings[:, k : k + 1],
            )
            some = slice(round(n * known.weights[:k].sum()), round(n * (known.weights[:k].sum() + weight)))
            futures = fine_futures(part, plan.times, some.stop - some.start, rng)
            headings = np.interp(
                np.arange(len(poses)) / FINE, np.arange(len(plan.times)), np.unwrap(part.headings[:, 0])
            )
            hit[some] |= fine_hits(poses, futures, headings, (4.6, 1.9), (4.6, 1.9), 5)
    assert float(plan.risk.total) >= binomtest(int(hit.sum()), n).proportion_ci(0.999).low
    # the audit sees the same larger bodies, and states the same risk
    report = rp.audit(plan, scene, ["exact"], monte_carlo=2000)
    assert report.consistent and float(report.verdicts[0].risk.total) == pytest.approx(float(plan.risk.total), rel=1e-6)


@pytest.mark.parametrize("name", ["car", "reeds-shepp", "bicycle", "point"])
def test_a_vehicle_moves_no_farther_within_a_step_than_it_says(name):
    from riskplan.vehicles import vehicle_class

    vehicle, rng = vehicle_class(name)(), np.random.default_rng(5)
    lanes, dt = np.zeros((0, 6)), 0.05
    for _ in range(400):
        speed = rng.uniform(0, 1) ** 2 * min(vehicle.top_speed, 30.0)
        angle = rng.uniform(-1, 1) * vehicle.top_steering / (1 + 0.1 * speed**2)
        out = np.empty((6, 5))
        node = np.array([0, 0, 0, speed, angle, 0.0])
        driven = steer(vehicle.kernel.address, node, *rng.uniform(-1, 1, 3), 6, dt, vehicle.limits, lanes, out)
        states = np.vstack([node[:5], out[:driven]])
        for i in range(len(states) - 1):
            p, q = states[i], states[i + 1]
            c, s = np.cos(p[2]), np.sin(p[2])
            dx, dy = q[0] - p[0], q[1] - p[1]
            along, across, turn = vehicle.sweep(max(abs(p[3]), abs(q[3])), dt)
            assert abs(c * dx + s * dy) <= along + 1e-9
            assert abs(c * dy - s * dx) <= across + 1e-9
            assert vehicle.disc or abs(np.angle(np.exp(1j * (q[2] - p[2])))) <= turn + 1e-9


def test_margins_by_hand():
    times = np.arange(31) * 0.1
    t = times[:, None]
    means = np.hstack([10.0 * t, 0 * t])[:, None]
    spread = np.stack([np.diag([(0.5 + x) ** 2, 0.04]) for x in times])[:, None]
    headings = np.zeros((31, 1))
    pred = rp.GaussianMixturePrediction(times, [1.0], means, spread, length=4.0, width=2.0, headings=headings)
    scene = replace(crossing(0.1), agents=(pred,), ego=rp.EgoBox(4.5, 1.8), horizon=3.0)
    wide = rp.inflated(scene, 0.01)
    # P(|ξ| > q) = exp(−q²/2) = 1e-4: half a step of 1 m in the mean, 0.1 m in σ
    q = np.sqrt(-2 * np.log(1e-4))
    np.testing.assert_allclose(wide.agents, [[0.5 * (1.0 + 0.1 * q), 0.0]], atol=1e-12)
    assert wide.scenario.agents[0].length == pytest.approx(4.0 + 1.0 + 0.1 * q)
    assert wide.reserve == pytest.approx(1e-4) and wide.left({"bound": 0.01})["bound"] == pytest.approx(0.0099)
    # 16 m/s within 0.05 s; turning at √(0.2 × 5) = 1 rad/s
    reach = 0.05 * 0.5 * np.hypot(4.5, 1.8)
    np.testing.assert_allclose(wide.ego, [0.8 + reach, 0.5 * 5 * 0.05**2 + reach])


def test_what_it_does_not_know_it_refuses():
    scene = crossing(0.1)
    late = agent("late", 0, 0, 5, times=np.arange(1, 31) * 0.1)
    cases = [
        ([scene.agents[0].moments(4)], "expects a Gaussian mixture with persistent modes, got MomentPrediction"),
        ([replace(scene.agents[0], modes="per_step")], "with modes per step"),
        ([late], "expects a prediction from time 0, got 0.1 s"),
    ]
    for agents, message in cases:
        with pytest.raises(rp.InputError, match=message):
            rp.plan(scene.with_agents(agents), between_steps="inflated")
    with pytest.raises(rp.InputError, match="between_steps: expected one of grid, inflated"):
        rp.plan(scene, between_steps="often")


def test_the_reserve_is_in_every_figure_that_a_bound_is_held_against():
    wide = rp.inflated(overtake(), 0.01)
    poses = np.column_stack([15.0 * wide.scenario.times, 3.5 + 0 * wide.scenario.times, 0 * wide.scenario.times])
    on_grid = rp.path_risk(poses, wide.scenario.agents, wide.scenario.ego, "independent")
    stated = wide.stated(on_grid)
    assert wide.reserve > 0
    left = wide.left({"bound": 0.5, "step_bound": 0.5, "agent_bound": 0.5})
    for name, values in (("bound", "total"), ("step_bound", "per_step"), ("agent_bound", "per_agent")):
        spent = np.minimum(getattr(on_grid, values) + (0.5 - left[name]), 1.0)
        np.testing.assert_allclose(getattr(stated, values), spent, rtol=1e-12)


def test_no_agents_no_reserve():
    scene = crossing(0.1).with_task(agents=())
    wide = rp.inflated(scene, 0.01)
    assert wide.reserve == 0 and wide.stated(None) is None
    assert rp.plan(scene, between_steps="inflated", bound=0.01).solved
