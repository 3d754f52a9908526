"""`rrt-star`: cheaper over time, within every bound all along, the same again by iterations."""

import numpy as np
import pytest

import riskplan as rp
from riskplan.search import Budget
from riskplan.warm_up import warm_up
from tests.scenes import overtake

ASKED = {"planner": "rrt-star", "time_limit": 60.0}


def cost(plan, comfort=0.02, risk_weight=10.0):
    """In other words: by loops over the poses."""
    dt, total, before = plan.times[1], plan.times[-1], None
    for k in range(len(plan.poses) - 1):
        total += comfort * dt * ((plan.speeds[k + 1] - plan.speeds[k]) / dt) ** 2
        way = np.linalg.norm(plan.poses[k + 1, :2] - plan.poses[k, :2])
        turn = np.angle(np.exp(1j * (plan.poses[k + 1, 2] - plan.poses[k, 2])))
        curvature = turn / way if way > 1e-3 else 0.0
        if before is not None:
            total += comfort * dt * (100.0 * (curvature - before) / dt) ** 2
        before = curvature
    return total + risk_weight * (0.0 if plan.risk is None else float(plan.risk.total))


@pytest.mark.parametrize("bound", [0.05, None])
def test_cost_falls_and_is_that_of_the_plan(bound):
    scene = overtake()
    plan = rp.plan(scene, bound=bound, iterations=2000, seed=1, **ASKED)
    assert plan.solved and plan.stats["ended_by"] == "iterations"
    assert bound is None or plan.risk.total <= bound
    seconds, costs = np.array(plan.stats["improvement"]).T
    assert len(costs) > 3 and (np.diff(costs) < 0).all() and (np.diff(seconds) >= 0).all()
    assert costs[-1] == plan.stats["cost"] < 0.8 * costs[0]
    # the search overstates risk by at most a hundredth of the bound
    assert cost(plan) == pytest.approx(plan.stats["cost"], abs=10 * 1e-2 * (bound or 1e-4) + 1e-9)
    again = rp.plan(scene, bound=bound, iterations=2000, seed=1, **ASKED)
    np.testing.assert_array_equal(plan.poses, again.poses)


def test_it_obeys_the_car_after_every_change():
    scene = overtake()
    plan = rp.plan(scene, bound=0.05, iterations=1500, seed=3, **ASKED)
    car, dt = scene.vehicle, scene.time_step
    acceleration = np.diff(plan.speeds) / dt
    assert (acceleration <= car.max_acceleration + 1e-6).all() and (acceleration >= -car.max_deceleration - 1e-6).all()
    travelled = 0.5 * (plan.speeds[1:] + plan.speeds[:-1]) * dt
    moved = np.linalg.norm(np.diff(plan.poses[:, :2], axis=0), axis=1)
    assert (moved <= travelled + 1e-6).all() and (moved >= 0.98 * travelled - 1e-6).all()
    for x, y, heading in plan.poses:
        assert scene.world.free(x, y, heading)
    assert scene.goal.time[0] - 1e-9 <= plan.times[-1] <= scene.goal.time[1] + 1e-9


def test_weights_trade_time_for_risk():
    scene = overtake()
    hasty, careful = (
        rp.plan(scene, bound=0.2, iterations=3000, seed=0, comfort=0.0, risk_weight=weight, **ASKED)
        for weight in (0.0, 1000.0)
    )
    assert hasty.times[-1] <= careful.times[-1]
    assert careful.risk.total < hasty.risk.total


def test_bounds_on_steps_hold_and_bad_options_are_named():
    scene = overtake()
    plan = rp.plan(scene, bound=0.3, step_bound=2e-3, iterations=1500, seed=2, **ASKED)
    assert plan.solved and plan.risk.per_step.max() <= 2e-3
    with pytest.raises(rp.InputError, match="rrt-star: motion_steps"):
        rp.plan(scene, planner="rrt-star", motion_steps=0)
    with pytest.raises(rp.InputError, match="rrt-star: comfort: expected"):
        rp.plan(scene, planner="rrt-star", comfort=-1.0)


def test_loading_the_kernels_does_not_use_up_a_time_limit():
    """An anytime planner that warms up as others do would go on until its limit."""
    warm_up.cache_clear()
    with pytest.MonkeyPatch.context() as patch:
        limits = []
        made = Budget.__init__

        def noted(self, bound, time_limit, stop=None, iterations=None):
            made(self, bound, time_limit, stop, iterations)
            limits.append(iterations)

        patch.setattr(Budget, "__init__", noted)
        warm_up(rp.RrtStar)
    assert limits[0] is not None and limits[0] < 100
