"""The mixture taken whole: its moments, and bounds from them."""

from __future__ import annotations

import numpy as np
import pytest
from builders import mixture
from numpy.testing import assert_allclose

from checkers import (
    EgoEllipsoid,
    GaussianMixturePrediction,
    InputError,
    MomentPrediction,
    checker,
    checkers,
    merged,
    trajectory_risk,
)

EGO = EgoEllipsoid(np.diag([1 / 2.5**2, 1 / 1.2**2]))
PER_MIXTURE = [name for name in checkers() if hasattr(checker(name), "per")]


def points(rng, steps, modes, count):
    """Discrete modes as moments to order 4, and all their points with their probabilities."""
    places = rng.normal(size=(steps, modes, count, 2)) + 3 * rng.normal(size=(steps, modes, 1, 2))
    shares, weights = rng.dirichlet(np.ones(count), (steps, modes)), rng.dirichlet(np.ones(modes))
    means = (shares[..., None] * places).sum(axis=2)
    moments = np.full((steps, modes, 5, 5), np.nan)
    off = places - means[:, :, None]
    for i in range(5):
        for j in range(5 - i):
            moments[..., i, j] = (shares * off[..., 0] ** i * off[..., 1] ** j).sum(axis=2)
    pred = MomentPrediction(np.arange(steps) * 0.1, weights, means, moments, name="points", length=4.0)
    return pred, places.reshape(steps, -1, 2), (weights[:, None] * shares).reshape(steps, -1)


def test_moments_of_a_mixture_are_those_of_its_points():
    pred, places, shares = points(np.random.default_rng(0), 3, 3, 5)
    whole = merged(pred, 4)
    mean = (shares[..., None] * places).sum(axis=1)
    assert_allclose(whole.means[:, 0], mean, rtol=1e-13)
    off = places - mean[:, None]
    for i in range(5):
        for j in range(5 - i):
            expected = (shares * off[..., 0] ** i * off[..., 1] ** j).sum(axis=1)
            assert_allclose(whole.central_moments[:, 0, i, j], expected, atol=1e-10)
    assert (whole.name, whole.length, whole.weights.tolist()) == ("points", 4.0, [1.0])


def test_far_from_the_origin_nothing_is_lost():
    pred, *_ = points(np.random.default_rng(1), 2, 2, 4)
    moved = MomentPrediction(pred.times, pred.weights, pred.means + [2**17, -(2**17)], pred.central_moments)
    assert_allclose(merged(moved, 4).central_moments, merged(pred, 4).central_moments, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("name", PER_MIXTURE)
def test_bounds_the_share_of_the_whole_mixture(name):
    """Against the exact risk of each mode, weighted."""
    rng = np.random.default_rng(2)
    c = checker(name, per="mixture")
    for _ in range(5):
        pred = mixture(rng, 4, 3)
        poses = np.column_stack([rng.normal(0, 6, (4, 2)), rng.uniform(-3, 3, 4)])
        true = (pred.weights * checker("exact")(poses, pred, EGO).value).sum(axis=1)
        risk = c(poses, pred, EGO)
        assert risk.value.shape == (4, 1)
        assert (risk.value[:, 0] >= true).all()
        total = trajectory_risk([risk], [pred])
        assert_allclose(total.total, 1 - np.prod(1 - risk.value[:, 0]), rtol=1e-12)
        assert_allclose(total.per_step, risk.value[:, 0])
        assert total.total <= total.boole


@pytest.mark.parametrize("name", PER_MIXTURE)
def test_one_mode_is_its_own_mixture(name):
    rng = np.random.default_rng(3)
    pred = mixture(rng, 5, 1)
    poses = np.column_stack([rng.normal(0, 3, (5, 2)), rng.uniform(-3, 3, 5)])
    gaussian, whole = checker(name)(poses, pred, EGO).value, checker(name, per="mixture")(poses, pred, EGO).value
    assert_allclose(whole, gaussian, rtol=3e-4, atol=1e-6)


def test_backends_that_need_modes_do_not_offer_it():
    assert set(PER_MIXTURE) == {
        "chebyshev", "halfspace", "marshall-olkin", "sos", "projected-sos", "offline-sos", "bivariate-sos"
    }  # fmt: skip
    with pytest.raises(InputError, match="unimodal-halfspace: unknown option 'per'"):
        checker("unimodal-halfspace", per="mixture")
    with pytest.raises(InputError, match=r"sos: per: expected one of mode, mixture; got 'step'"):
        checker("sos", per="step")


def test_needs_the_moments_it_merges():
    pred, *_ = points(np.random.default_rng(4), 2, 2, 4)
    with pytest.raises(InputError, match="points carries moments up to order 4, asked for 8"):
        checker("sos", per="mixture")(np.zeros((2, 3)), pred, EGO)


def test_planning_reads_the_mixture_whole():
    import riskplan as rp  # noqa: PLC0415

    times = np.arange(0.0, 3.01, 0.1)
    means = np.stack([np.stack([20 + 4 * times, np.full_like(times, y)], -1) for y in (6.0, 8.0)], axis=1)
    car = GaussianMixturePrediction(times, [0.5, 0.5], means, np.broadcast_to(0.02 * np.eye(2), (len(times), 2, 2, 2)))
    scenario = rp.Scenario(
        start=rp.State(0.0, 0.0, 0.0, 10.0),
        goal=rp.Goal.at(28.0, 0.0, radius=4.0, time=(2.0, 3.0)),
        bounds=(-5.0, -4.0, 60.0, 12.0),
        agents=[car],
        ego=rp.EgoEllipsoid.around(4.0, 1.8),
    )
    c = rp.checker("projected-sos", per="mixture")
    plan = rp.plan(scenario, checker=c, bound=0.3, time_limit=5.0, seed=1)
    assert plan.status == "solved"
    part = car.at(plan.times)
    again = trajectory_risk([c(plan.poses, part, scenario.ego)], [part])
    assert_allclose(plan.risk.total, again.total, rtol=1e-9)
    assert plan.risk.total <= 0.3


def test_near_certain_modes_far_from_the_origin():
    """The mixture's own mean is not a double there; its moments must still be some distribution's."""
    rng = np.random.default_rng(5)
    base, pose = np.array([5e5, 5e6]), np.array([[5e5, 5e6, 0.3]])
    for sigma in (0.0, 1e-6):
        for separation in (0.3, 0.03):
            for _ in range(10):
                means = base + 20.0 + separation * rng.normal(size=(1, 3, 2))
                covariances = np.broadcast_to(sigma**2 * np.eye(2), (1, 3, 2, 2))
                pred = GaussianMixturePrediction([0.0], rng.dirichlet(np.ones(3)), means, covariances)
                for name in ("chebyshev", "sos", "projected-sos"):
                    assert checker(name, per="mixture")(pose, pred, EGO).value[0, 0] < 1e-2
