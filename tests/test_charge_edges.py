"""Charges and marginals where a covariance is singular, a mode has no weight, or there is nobody."""

import numpy as np
import pytest

from checkers import EgoCover, EgoEllipsoid, GaussianMixturePrediction, checker, trajectory_risk
from riskplan.evaluator import RiskEvaluator

_TIMES = np.linspace(0.0, 0.3, 4)
_POSES = np.zeros((4, 3))


def evaluator(means, covariances, weights, ego, modes="persistent", **options):
    means, covariances = np.array(means, dtype=float), np.array(covariances, dtype=float)
    agent = GaussianMixturePrediction(
        _TIMES, np.array(weights), np.tile(means, (4, 1, 1)), np.tile(covariances, (4, 1, 1, 1)), modes=modes
    )
    return RiskEvaluator((agent,), ego, checker("exact"), _TIMES, **options)


def charged(known):
    return known.charge(_POSES, 0, np.zeros(known.groups), np.inf, np.empty(known.groups))


def test_errors_along_a_line_that_passes_are_charged_nothing_rather_than_unknown():
    for angle in np.linspace(0.01, 6.28, 100):
        along, side = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        known = evaluator([9.0 * side], [np.outer(along, along)], [1.0], EgoCover(4.0, 2.0), resolution=1e-6)
        assert 0.0 <= charged(known) <= 1e-6
        assert known.judge(_POSES)[0].total == 0.0


@pytest.mark.parametrize("weight", [0.0, 1e-30])
def test_marginals_of_modes_without_weight_are_probabilities(weight):
    means, spread = [[0.3, 0.0], [8.0, 0.0]], [np.eye(2), np.eye(2)]
    known = evaluator(means, spread, [weight, 1.0 - weight], EgoCover(4.0, 2.0))
    same = evaluator(means, spread, [0.5, 0.5], EgoCover(4.0, 2.0))
    value, expected = known.marginals(_POSES)[0].value, same.marginals(_POSES)[0].value
    np.testing.assert_allclose(value[:, 1], expected[:, 1], rtol=1e-9, atol=1e-14)
    assert (value[:, 0] >= expected[:, 0]).all()


def test_a_mode_within_reach_is_charged_in_full_however_unlikely():
    ego = EgoEllipsoid(np.eye(2))
    means, spread = [[0.0, 0.0], [400.0, 0.0]], [0.01 * np.eye(2)] * 2
    known = evaluator(means, spread, [1e-10, 1.0 - 1e-10], ego, "per_step", resolution=1e-6)
    assert charged(known) >= known.judge(_POSES)[0].total > 3.9e-10


def test_nobody_has_no_marginals_and_spends_nothing():
    known = RiskEvaluator((), EgoEllipsoid(np.eye(2)), checker("exact"), _TIMES)
    assert known.marginals(_POSES) == ()
    assert known.spending(_POSES).shape == (4, 0)


def test_traffic_beside_is_never_charged_nor_judged_below_its_risk():
    """Beside a long body, elongated as predictions are, where bounds by the shape's sides take the place of risks."""
    rng, ego = np.random.default_rng(1), EgoCover(5.0, 1.8)
    for _ in range(200):
        turn, poses = rng.uniform(-np.pi, np.pi), np.column_stack([np.zeros((4, 2)), rng.uniform(-0.3, 0.3, 4)])
        axes = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        spread = axes @ np.diag(10.0 ** rng.uniform(-2.0, [1.5, 0.0])) @ axes.T
        known = evaluator([rng.uniform([-9.0, 1.5], [9.0, 5.0])], [spread], [1.0], ego, resolution=1e-6)
        exact = checker("exact")(poses, known.agents[0], ego)
        direct = trajectory_risk([exact], known.agents).total
        total = known.charge(poses, 0, np.zeros(known.groups), np.inf, np.empty(known.groups))
        assert direct * (1 - 1e-12) - 1e-37 <= total <= 1.02 * direct + 1e-6
        stated = known.marginals(poses)[0].value
        np.testing.assert_allclose(stated, exact.value, rtol=1e-11, atol=1e-14 * exact.value.max())
        assert (stated >= exact.value * (1 - 1e-11)).all()


def test_agents_that_begin_later_or_choose_anew_are_packed_beside_the_others():
    rng, ego, agents = np.random.default_rng(2), EgoCover(4.0, 2.0, 3), []
    for modes, begins, length, k in (("persistent", 1, 4.0, 2), ("per_step", 0, 5.0, 3), ("persistent", 0, 4.0, 1)):
        times = _TIMES[begins:]
        means, spread = rng.normal(0.0, 5.0, (len(times), k, 2)), np.tile(np.eye(2), (len(times), k, 1, 1))
        weights = rng.dirichlet(np.ones(k), len(times)) if modes == "per_step" else rng.dirichlet(np.ones(k))
        agents.append(GaussianMixturePrediction(times, weights, means, spread, modes, length=length, width=2.0))
    known = RiskEvaluator(tuple(agents), ego, checker("exact"), _TIMES)
    risks = [checker("exact")(_POSES[-len(agent.times) :], agent, ego) for agent in agents]
    for stated, risk in zip(known.marginals(_POSES), risks, strict=True):
        np.testing.assert_allclose(stated.value[-len(risk.value) :], risk.value, rtol=1e-12, atol=1e-13)
    alone = [trajectory_risk([r], [a]).total for r, a in zip(risks, agents, strict=True)]
    np.testing.assert_allclose(known.judge(_POSES)[0].per_agent, alone, rtol=1e-12)
