"""Moments over two times of agents by their controls: against simulation and closed forms; Hunter's bound."""

from __future__ import annotations

import numpy as np
import pytest

import riskplan as rp
from checkers import (
    InputError,
    as_gaussian,
    checker,
    covariance_over_time,
    hunter_bound,
    path_risk,
    trajectory_risk,
    with_factors,
)
from checkers.hunter import _least_quadratic

START = {"x": 0.0, "y": rp.Normal(6.0, 0.2), "v": rp.Normal(9.0, 0.3), "theta": rp.Normal(0.1, 0.05)}
CALM = {"w_v": rp.Normal(0.02, 0.05), "w_theta": rp.Normal(0.01, 0.02)}
BRAKE = {"w_v": rp.Uniform(-0.5, -0.2), "w_theta": rp.Normal(0.0, 0.005)}
EGO = rp.EgoEllipsoid(np.diag([1 / 4.5**2, 1 / 2.0**2]))


def car(steps=8, **changes):
    return rp.ControlPrediction(rp.dynamics.dubins(0.1), START, [CALM, BRAKE], steps, [0.7, 0.3], **changes)


def test_covariance_over_time_by_simulation():
    pred = car().at([0.0, 0.2, 0.3, 0.8])
    found = covariance_over_time(pred)
    assert found.shape == (2, 8, 8)
    n = 100_000
    for k in range(2):
        away = pred.sample_mode(k, n, np.random.default_rng(k)).reshape(n, -1)
        sampled = np.cov(away.T)
        error = np.sqrt((np.outer(np.diag(sampled), np.diag(sampled)) + sampled**2) / n)
        assert (np.abs(found[k] - sampled) <= 5 * error + 1e-12).all()
        np.testing.assert_allclose(found[k], found[k].T, atol=1e-14)


def test_covariance_over_time_of_a_random_walk():
    """x⁺ = x + w: Cov(x_s, x_t) = min(s, t) σ², nothing across axes."""
    walk = rp.dynamics.System({"x": "x + w", "y": "y + 2 * u"}, ("w", "u"), 0.5)
    pred = rp.ControlPrediction(
        walk, {"x": 3.0, "y": rp.Normal(1.0, 0.4)}, {"w": rp.Normal(0.1, 0.3), "u": rp.Uniform(-1, 1)}, 5
    )
    found = covariance_over_time(pred)[0].reshape(6, 2, 6, 2)
    least = np.minimum.outer(np.arange(6), np.arange(6))
    np.testing.assert_allclose(found[:, 0, :, 0], 0.09 * least, atol=1e-14)
    np.testing.assert_allclose(found[:, 1, :, 1], 0.16 + 4 / 3 * least, atol=1e-13)
    np.testing.assert_allclose(found[:, 0, :, 1], 0.0, atol=1e-14)


def test_a_step_mixture_is_propagated_over_two_times():
    walk = rp.dynamics.System({"x": "x + w", "y": "y + w"}, ("w",), 0.1)
    pred = rp.ControlPrediction(
        walk, {"x": 0.0, "y": 0.0}, [{"w": rp.Constant(-1.0)}, {"w": rp.Constant(1.0)}], 3, [0.5, 0.5], "per_step"
    )
    found = covariance_over_time(pred)[0].reshape(4, 2, 4, 2)
    least = np.minimum.outer(np.arange(4), np.arange(4))
    for i in range(2):
        for j in range(2):
            np.testing.assert_allclose(found[:, i, :, j], least, atol=1e-13)


def test_factors_of_controls_keep_the_moments_and_most_of_the_dependence():
    pred = car(6).at(np.arange(1, 7) * 0.1)
    carried = with_factors(pred, 2, order=4)
    known = pred.moments(4)
    np.testing.assert_array_equal(carried.central_moments, known.central_moments)
    assert carried.factors.shape == (6, 2, 2, 2)
    full = covariance_over_time(pred)
    for k in range(2):
        flat = carried.factors[:, k].reshape(12, 2)
        assert np.trace(flat @ flat.T) > 0.9 * np.trace(full[k])
    normal = as_gaussian(carried)
    assert normal.factors is not None
    np.testing.assert_allclose(normal.covariances, known.covariances)
    poses = np.column_stack([np.linspace(0, 5, 6), np.tile([3.4, 0.05], (6, 1))])
    risk = path_risk(poses, [normal], EGO, tolerance=1e-2)
    assert float(risk.max_step) <= float(risk.total) * 1.02 <= float(risk.boole) * 1.04


@pytest.mark.parametrize("lateral", [3.0, 6.0, 9.0])
def test_hunter_between_truth_and_boole(lateral):
    start = {**START, "y": lateral}
    pred = rp.ControlPrediction(rp.dynamics.dubins(0.1), start, CALM, 10).at(np.arange(1, 11) * 0.1)
    poses = np.column_stack([np.linspace(-1, 9, 10), np.zeros(10), np.full(10, 0.05)])
    bound = hunter_bound(poses, pred, EGO)
    marginal = checker("marshall-olkin")(poses, pred, EGO)
    boole = trajectory_risk([marginal], [pred.moments(2)], "boole")
    away = pred.sample(20_000, np.random.default_rng(0)) - poses[:, :2]
    c, s = np.cos(0.05), np.sin(0.05)
    body = away @ np.array([[c, -s], [s, c]])
    truth = (np.einsum("nti,ij,ntj->nt", body, EGO.Q, body) <= 1).any(axis=1).mean()
    raw = marginal.value.sum()
    assert truth - 0.01 <= float(bound.total) <= float(boole.total)
    assert float(bound.per_step.sum()) < 0.95 * raw
    assert bound.dependence == "hunter"
    assert bound.kind is rp.Kind.UPPER_BOUND
    assert float(bound.max_step) <= float(bound.total) + 1e-12


def test_the_quadratic_holds_for_any_distribution():
    """Discrete distributions with the moments given: none puts more on the event than the bound says."""
    rng = np.random.default_rng(0)
    worst = 0.0
    for _ in range(40):
        points = rng.normal(size=(6, 4)) * rng.uniform(0.3, 3, 4)
        share = rng.dirichlet(np.ones(6))
        moments = np.einsum("n,ni,nj->ij", share, *[np.column_stack([np.ones(6), points])] * 2)
        inside, outside = np.diag([-1.0, 0, 0, 1, 1]), np.diag([-1.0, 1, 1, 0, 0])
        event = ((points[:, 2:] ** 2).sum(1) <= 1) & ((points[:, :2] ** 2).sum(1) >= 1)
        bound = _least_quadratic(moments, inside, outside)
        assert share[event].sum() <= bound + 1e-12
        worst = max(worst, share[event].sum() / max(bound, 1e-9))
    assert worst > 0.3  # it is no idle bound


def test_bad_input():
    pred = car(2)
    with pytest.raises(InputError, match="two-time moments are known of a ControlPrediction, got MomentPrediction"):
        hunter_bound(np.zeros((3, 3)), pred.moments(2), EGO)
    with pytest.raises(InputError, match="expected a ControlPrediction"):
        covariance_over_time(pred.moments(2))
    with pytest.raises(InputError, match="poses"):
        hunter_bound(np.zeros((2, 3, 3)), pred, EGO)
    with pytest.raises(InputError, match="rank"):
        with_factors(pred, 99)
    with pytest.raises(InputError, match="expected a MomentPrediction"):
        as_gaussian(pred)
