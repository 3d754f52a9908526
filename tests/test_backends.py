"""What single backends add to the contract: reference values, limits, threads."""

from __future__ import annotations

import math

import mpmath as mp
import numpy as np
import pytest
from builders import cases, covariance, discrete, row, single
from oracles import as_mp, cone, cone_bulk, whiten
from scipy.stats import ncx2

from checkers import ControlPrediction, EgoEllipsoid, Normal, Uniform, checker, checkers, dynamics, registry
from checkers.kernels import series
from checkers.kernels.matched import chi_square_cdf
from checkers.kernels.whiten import determinant
from checkers.sdp import DiscProgram

DISC = EgoEllipsoid(np.eye(2))
LONG = EgoEllipsoid(np.diag([1 / 5.5**2, 1 / 2.6**2]))


# ---- exact: the series


def test_series_against_the_polar_integral():
    """Wherever it serves, terms from a handful to the limit."""
    rng = np.random.default_rng(0)
    tried = 0
    while tried < 150:
        small = 10 ** rng.uniform(-2.2, 3)
        big = small * 10 ** rng.uniform(0, 4)
        along, across = rng.normal(0, 3, 2) * np.sqrt([big, small]) + rng.normal(0, 1, 2)
        if not series.serves(along, across, big, small):
            continue
        tried += 1
        value = series.disc(along, across, big, small, 1e-16)
        if math.isnan(value):
            continue
        true = cone_bulk(np.array([[along, across]]), np.array([[big, 0.0, small]]))[0]
        assert value == pytest.approx(true, rel=3e-12, abs=0)


@pytest.mark.parametrize("distance", [25.0, 33.0, 36.9])
def test_series_reaches_probabilities_of_1e_300(distance):
    """Beyond the exponents a double holds, in sums scaled to stay within."""
    along, across, big, small = 1.0 + 0.9 * distance, 0.3, 0.81, 0.4
    assert series.serves(along, across, big, small)
    true = cone(*as_mp((along, across), (big, 0.0, small)))
    assert abs(series.disc(along, across, big, small, 1e-16) / true - 1) < 1e-11


def test_elongated_covariances_keep_their_small_axis():
    """Variance ratio 1e8 at an angle: the determinant is what s11 s22 − s12² loses."""
    cov = covariance(20.0, 2e-3, 0.7)
    with mp.workdps(50):
        exact = mp.mpf(float(cov[0, 0])) * mp.mpf(float(cov[1, 1])) - mp.mpf(float(cov[0, 1])) ** 2
        assert abs(determinant(cov[0, 0], cov[0, 1], cov[1, 1]) / exact - 1) < 1e-15
    way, beside = np.array([np.cos(0.7), np.sin(0.7)]), np.array([-np.sin(0.7), np.cos(0.7)])
    for mean in (0.3 * way, 1.5 * beside, 30 * way + 0.004 * beside, 300 * way):
        pose = np.array([0.1, -0.2, 0.5])
        true = cone(*whiten(pose, mean, cov, LONG.Q))
        for name in ("exact", "imhof"):
            risk = checker(name)(pose[None], single(mean, cov), LONG)
            assert abs(risk.value[0, 0] / true - 1) < 1e-10
            assert abs(risk.value[0, 0] - true) <= risk.error[0, 0]


# ---- liu


def test_matched_law_is_scipys():
    rng = np.random.default_rng(1)
    for _ in range(300):
        freedom, delta = 10 ** rng.uniform(-0.5, 3), 10 ** rng.uniform(-2, 2.5)
        x = (freedom + delta) * 10 ** rng.uniform(-1, 0.5)
        true = ncx2.cdf(x, freedom, delta)
        if true > 1e-12 and x + freedom + delta < 2000:
            assert chi_square_cdf(x, freedom, delta) == pytest.approx(true, rel=1e-11)


def test_liu_is_exact_for_round_modes():
    """One repeated variance: the form is the matched law itself."""
    for distance in (0.0, 1.0, 2.0, 4.0):
        mode = single([distance, 0.0], 0.49 * np.eye(2))
        value = checker("liu")(np.zeros((1, 3)), mode, DISC).value[0, 0]
        assert value == pytest.approx(ncx2.cdf(1 / 0.49, 2, distance**2 / 0.49), rel=1e-9)


def test_liu_is_off_in_the_tail_and_says_so():
    """The release's table: median relative error 0.6 to 2.8 below 1e-6. Its error must admit that."""
    poses, means, covs = cases(np.random.default_rng(2), 400, sigma=(0.3, 1.5), ratio=4.0)
    pred = row(means, covs)
    true = checker("exact")(poses, pred, LONG).value
    risk = checker("liu")(poses, pred, LONG)
    off = np.abs(risk.value - true)
    assert (off <= risk.error).all()
    assert off.max() < 0.15
    tail = (true < 1e-6) & (true > 1e-200)
    assert np.median((off / true)[tail]) > 0.5


# ---- bounds from moments


def test_offline_is_above_the_program_it_tabulates():
    poses, means, covs = cases(np.random.default_rng(3), 300, sigma=(0.2, 2.0), reach=20.0)
    pred = row(means, covs)
    for order in (2, 4, 6, 8):
        table = checker("offline-sos", order=order)(poses, pred, LONG).value
        sharp = checker("sos", order=order)(poses, pred, LONG).value
        assert (table >= sharp * (1 - 1e-9)).all()
        far = sharp < 1e-2
        assert np.median(table[far] / sharp[far]) < 1.5


def test_bivariate_program_meets_its_closed_forms():
    """Degree 2 is Marshall & Olkin's; higher degrees never lose, and beat every univariate bound of their order."""
    poses, means, covs = cases(np.random.default_rng(4), 12, sigma=(0.5, 1.5), ratio=3.0, reach=3.0)
    pred = row(means, covs)
    before = checker("marshall-olkin")(poses, pred, LONG).value
    assert np.array_equal(checker("bivariate-sos", order=2)(poses, pred, LONG).value, before)
    for order in (4, 6):
        value = checker("bivariate-sos", order=order)(poses, pred, LONG).value
        assert (value <= before).all()
        assert (value <= checker("projected-sos", order=order)(poses, pred, LONG).value * (1 + 1e-3) + 1e-6).all()
        before = value


@pytest.mark.parametrize("spoil", [0.9, 1.1])
def test_bivariate_certificate_does_not_trust_the_solver(spoil, monkeypatch):
    """Gram matrices that are 10 % off still give a bound."""
    solve = DiscProgram.solve
    monkeypatch.setattr(
        DiscProgram, "solve", lambda self, *a: [g * f for g, f in zip(solve(self, *a), (1, 1, spoil), strict=True)]
    )
    poses, means, covs = cases(np.random.default_rng(5), 10, sigma=(0.5, 1.5), ratio=3.0, reach=3.0)
    true = checker("exact")(poses, row(means, covs), LONG)
    assert (checker("bivariate-sos")(poses, row(means, covs), LONG).value >= true.value - true.error).all()


def test_bivariate_program_knows_what_thin_covariances_cancel():
    """A rare point inside, a far cluster in line with it: standardising the moments loses most of their digits."""
    rng = np.random.default_rng(11)
    for spread in (1e-1, 1e-3, 1e-4, 1e-6):
        for order in (4, 6):
            far = 14.0 * np.array([-0.857, -0.515])
            points = np.vstack([[-0.771, -0.464], far + spread * rng.normal(size=(3, 2))])
            rare = 10 ** rng.uniform(-6, -2)
            weights = np.append(rare, (1 - rare) * rng.dirichlet(np.ones(3)))
            pred = discrete(points, weights, order)
            value = checker("bivariate-sos", order=order)(np.zeros((1, 3)), pred, DISC).value[0, 0]
            assert value >= rare * (1 - 1e-6)
            assert value <= checker("marshall-olkin")(np.zeros((1, 3)), pred, DISC).value[0, 0] * (1 + 1e-9)


# ---- monte-carlo


def test_monte_carlo_simulates_agents_known_by_their_controls():
    """Shares of plain samples of the nonlinear system, mode by mode; every bound from its moments is above."""
    modes = [{"w_v": Normal(0.0, 0.05), "w_theta": Normal(0.0, 0.03)}, {"w_v": -0.3, "w_theta": Uniform(0.0, 0.02)}]
    start = {"x": 4.0, "y": 0.0, "v": 9.0, "theta": 0.0}
    car = ControlPrediction(dynamics.dubins(0.1), start, modes, steps=20, weights=[0.7, 0.3])
    poses = np.column_stack([8.6 * car.times, 0 * car.times + 1.5, 0 * car.times])
    risk = checker("monte-carlo", samples=20_000, seed=3)(np.stack([poses, poses + 0.5]), car, LONG)
    assert risk.value.shape == (2, 21, 2)
    bound = checker("projected-sos", order=6)(poses, car, LONG).value
    assert (bound >= risk.value[0] - risk.error[0]).all()
    futures = car.sample(40_000, np.random.default_rng(9))
    offset = futures - poses[:, :2]
    share = (np.einsum("nti,ij,ntj->nt", offset, LONG.Q, offset) <= 1.0).mean(axis=0)
    mixed = (car.weights * risk.value[0]).sum(axis=-1)
    assert share.min() < 0.7 < share.max()
    np.testing.assert_allclose(mixed, share, atol=4 * np.sqrt(0.25 / 20_000) + 1e-9)


# ---- all


def test_threads_change_nothing():
    """A batch large enough to be shared among threads is, bit for bit, its parts."""
    poses, means, covs = cases(np.random.default_rng(6), 30, sigma=(0.3, 2.0))
    batch = poses + np.random.default_rng(7).normal(size=(1600, 30, 3))
    for name in ("exact", "chebyshev", "sos"):
        backend = checker(name)
        whole = backend(batch, row(means, covs), LONG).value
        for b in (0, 799, 800, 1599):
            assert np.array_equal(whole[b], backend(batch[b], row(means, covs), LONG).value)


def test_errors_and_lower_bounds_are_declared():
    poses, means, covs = cases(np.random.default_rng(8), 3)
    for name in checkers():
        backend = checker(name)
        risk = backend(poses, row(means, covs), LONG)
        assert (risk.error is not None) == backend.gives_error
        assert (risk.lower is not None) == backend.gives_lower
        for known in (risk.error, risk.lower):
            assert known is None or np.isfinite(known).all()


def test_the_registry_is_the_contract():
    named = "exact imhof liu chebyshev halfspace marshall-olkin sos projected-sos offline-sos bivariate-sos monte-carlo"
    assert set(named.split()) <= set(registry.BACKENDS)
