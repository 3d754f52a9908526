"""`cascade`: the verdicts of `exact`, for less."""

from __future__ import annotations

import numpy as np
import pytest
from builders import mixture, single
from hypothesis import given, settings
from hypothesis import strategies as st

from checkers import EgoCover, EgoEllipsoid, InputError, checker, trajectory_risk

SHAPES = (EgoEllipsoid(np.diag([1 / 2.5**2, 1 / 1.2**2])), EgoCover.discs(4.5, 1.8, n=4))
EXACT, CASCADE = checker("exact"), checker("cascade")


def scene(seed, modes="persistent"):
    rng = np.random.default_rng(seed)
    pred = mixture(rng, 12, 3, modes == "per_step")
    poses = np.column_stack([rng.normal(0, 8, (12, 2)), rng.uniform(-3, 3, 12)])
    return poses, pred


@settings(derandomize=True, max_examples=150, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(-320, 0), st.sampled_from(SHAPES))
def test_within_is_the_verdict_of_exact(seed, log_limit, shape):
    poses, pred = scene(seed)
    limit = 10.0**log_limit
    verdict = CASCADE.within(poses, pred, shape, limit)
    assert (verdict.within == (EXACT(poses, pred, shape).value <= limit)).all()
    pieces = len(shape.pieces(pred)[0])
    assert sum(verdict.stages.values()) >= 36 * pieces


@settings(derandomize=True, max_examples=150, deadline=None)
@given(
    st.integers(0, 2**32 - 1), st.sampled_from(SHAPES), st.sampled_from(["persistent", "per_step"]), st.floats(-9, 0)
)
def test_spending_is_the_verdict_of_exact(seed, shape, modes, log_budget):
    poses, pred = scene(seed, modes)
    risk = EXACT(poses, pred, shape)
    totals = []
    for steps in range(1, 13):
        part = type(risk)(risk.value[:steps], risk.kind)
        totals.append(float(trajectory_risk([part], [pred.at(pred.times[:steps])]).total))
    # budgets at random, and as close as can be to what is spent
    for budget in (10.0**log_budget, totals[5] * (1 - 1e-9), totals[5] * (1 + 1e-9)):
        budget = min(budget, 1.0)
        spending = CASCADE.spend(poses, pred, shape, budget)
        above = [t for t, total in enumerate(totals) if total > budget]
        assert spending.step == (above[0] if above else None)
        assert spending.total == pytest.approx(totals[spending.step if above else -1], rel=1e-5, abs=1e-300)


def test_limits_at_the_risk_itself():
    poses, pred = scene(3)
    value = EXACT(poses, pred, SHAPES[0]).value
    for limit in value.ravel()[value.ravel() > 0][:12]:
        assert (CASCADE.within(poses, pred, SHAPES[0], limit).within == (value <= limit)).all()


def test_far_agents_cost_the_first_stage_only():
    pred = single([500.0, 0.0], np.eye(2))
    verdict = CASCADE.within(np.zeros((1, 3)), pred, SHAPES[0], 1e-6)
    assert verdict.stages == {"far field": 1, "direction": 0, "tangent": 0, "exact": 0}
    assert verdict.within.all()
    assert CASCADE.within(np.zeros((1, 3)), single([0.0, 0.0], np.eye(2)), SHAPES[0], 1e-6).stages["exact"] >= 1


def test_every_stage_has_its_cases():
    stages = dict.fromkeys(CASCADE.within(*scene(0), SHAPES[0], 1e-4).stages, 0)
    for seed in range(40):
        for name, count in CASCADE.within(*scene(seed), SHAPES[0], 1e-4).stages.items():
            stages[name] += count
    assert all(stages.values())


@pytest.mark.parametrize("limit", [-0.1, 1.1, np.nan, "small", None])
def test_limits_are_probabilities(limit):
    poses, pred = scene(0)
    with pytest.raises(InputError, match="limit: expected"):
        CASCADE.within(poses, pred, SHAPES[0], limit)
    with pytest.raises(InputError, match="budget: expected"):
        CASCADE.spend(poses, pred, SHAPES[0], limit)


def test_bad_poses_and_agents():
    poses, pred = scene(0)
    with pytest.raises(InputError, match=r"poses: expected shape \(12, 3\), got \(11, 3\)"):
        CASCADE.within(poses[1:], pred, SHAPES[0], 0.1)
    poses[2, 1] = np.nan
    with pytest.raises(InputError, match=r"poses\[2, 1\]: expected a finite number"):
        CASCADE.spend(poses, pred, SHAPES[0], 0.1)
    with pytest.raises(InputError, match="known by its moments only"):
        CASCADE.within(np.zeros((12, 3)), pred.moments(4), SHAPES[0], 0.1)
