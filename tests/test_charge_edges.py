"""Charges and marginals where a covariance is singular, a mode has no weight, or there is nobody."""

import numpy as np
import pytest

from checkers import EgoCover, EgoEllipsoid, GaussianMixturePrediction, checker
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
