"""Random variables against mpmath and scipy, and their refusals."""

import mpmath as mp
import numpy as np
import pytest
from scipy import stats

import riskplan as rp
from checkers.quadrature import Rule

MIXTURE = rp.Mixture([0.3, 0.7], (rp.Normal(-1.0, 0.2), rp.Uniform(0.5, 0.9)))
# ours, and the density with its support
FAMILIES = {
    "normal": (rp.Normal(0.3, 0.7), stats.norm(0.3, 0.7)),
    "narrow": (rp.Normal(0.3, 1e-6), stats.norm(0.3, 1e-6)),
    "uniform": (rp.Uniform(-1.0, 2.0), stats.uniform(-1.0, 3.0)),
    "beta": (rp.Beta(0.5, 0.7, -1.0, 2.0), stats.beta(0.5, 0.7, -1.0, 3.0)),
    "peaked beta": (rp.Beta(20.0, 70.0), stats.beta(20.0, 70.0)),
    "gamma": (rp.Gamma(0.4, 0.3, 0.1), stats.gamma(0.4, 0.1, 0.3)),
    "counted gamma": (rp.Gamma(900.0, 0.02), stats.gamma(900.0, 0.0, 0.02)),
    "steep gamma": (rp.Gamma(0.02, 0.3), stats.gamma(0.02, 0.0, 0.3)),
    "wide gamma": (rp.Gamma(300.0, 0.01), stats.gamma(300.0, 0.0, 0.01)),
    "exponential": (rp.Exponential(0.5, 0.2), stats.expon(0.2, 0.5)),
    "triangular": (rp.Triangular(-1.0, 0.0, 0.5), stats.triang(1 / 1.5, -1.0, 1.5)),
    "one-sided": (rp.Triangular(0.0, 0.0, 0.5), stats.triang(0.0, 0.0, 0.5)),
}
ALL = {**{k: v[0] for k, v in FAMILIES.items()}, "mixture": MIXTURE, "discrete": rp.Discrete([-1, 2], [0.25, 0.75])}


def exact_moment(x, n):
    """E[Xⁿ] by closed forms in many digits."""
    with mp.workdps(40):
        if isinstance(x, rp.Normal):
            return mp.fsum(
                mp.binomial(n, 2 * k) * mp.mpf(x.mu) ** (n - 2 * k) * mp.mpf(x.sd) ** (2 * k) * mp.fac2(2 * k - 1)
                for k in range(n // 2 + 1)
            )
        if isinstance(x, rp.Uniform):
            low, high = mp.mpf(x.low), mp.mpf(x.high)
            return (high ** (n + 1) - low ** (n + 1)) / (n + 1) / (high - low)
        if isinstance(x, rp.Triangular):
            a, c, b = mp.mpf(x.low), mp.mpf(x.mode), mp.mpf(x.high)
            # divided difference of xⁿ⁺²
            terms = [mp.fsum(a**i * b**j * c ** (n - i - j) for j in range(n + 1 - i)) for i in range(n + 1)]
            return 2 * mp.fsum(terms) / (n + 1) / (n + 2)
        if isinstance(x, rp.Exponential):
            x = rp.Gamma(1.0, x.scale, x.shift)
        if isinstance(x, rp.Gamma):
            shift, scale, raw = mp.mpf(x.shift), mp.mpf(x.scale), lambda k: mp.rf(mp.mpf(x.shape), k)
        else:
            shift, scale = mp.mpf(x.low), mp.mpf(x.high) - mp.mpf(x.low)
            raw = lambda k: mp.rf(mp.mpf(x.a), k) / mp.rf(mp.mpf(x.a) + mp.mpf(x.b), k)  # noqa: E731
        return mp.fsum(mp.binomial(n, k) * shift ** (n - k) * scale**k * raw(k) for k in range(n + 1))


@pytest.mark.parametrize("name", FAMILIES)
def test_moments_match_closed_forms(name):
    x = FAMILIES[name][0]
    for n in range(13):
        size = float(sum(x.rule().weights * np.abs(x.mean + x.rule().deviations) ** n))
        assert x.moment(n) == pytest.approx(float(exact_moment(x, n)), rel=1e-12, abs=1e-12 * size)
    assert x.mean == pytest.approx(float(exact_moment(x, 1)), rel=1e-14)


def wave(x, t):
    """Φ(t) by closed forms in many digits."""
    with mp.workdps(40):
        t = mp.mpf(t)
        if isinstance(x, rp.Normal):
            return mp.expj(t * mp.mpf(x.mu)) * mp.exp(-((mp.mpf(x.sd) * t) ** 2) / 2)
        if isinstance(x, rp.Uniform):
            low, high = mp.mpf(x.low), mp.mpf(x.high)
            return (mp.expj(t * high) - mp.expj(t * low)) / (1j * t * (high - low))
        if isinstance(x, rp.Beta):  # with the i: the code released with the paper left it out
            width = mp.mpf(x.high) - mp.mpf(x.low)
            return mp.expj(t * mp.mpf(x.low)) * mp.hyp1f1(mp.mpf(x.a), mp.mpf(x.a) + mp.mpf(x.b), 1j * t * width)
        if isinstance(x, rp.Gamma):
            return mp.expj(t * mp.mpf(x.shift)) * (1 - 1j * mp.mpf(x.scale) * t) ** (-mp.mpf(x.shape))
        if isinstance(x, rp.Exponential):
            return mp.expj(t * mp.mpf(x.shift)) / (1 - 1j * mp.mpf(x.scale) * t)
        a, c, b = mp.mpf(x.low), mp.mpf(x.mode), mp.mpf(x.high)
        rising = (mp.quad(lambda u: u * mp.expj(t * (a + u)), [0, c - a]) / (c - a)) if c > a else 0
        falling = mp.quad(lambda u: u * mp.expj(t * (b - u)), [0, b - c]) / (b - c)
        return 2 * (rising + falling) / (b - a)


@pytest.mark.parametrize("t", [-3.0, 0.5, 8.0])
@pytest.mark.parametrize("name", FAMILIES)
def test_characteristic_functions_match_closed_forms(name, t):
    x = FAMILIES[name][0]
    assert abs(x.characteristic(t) - complex(wave(x, t))) < 3e-13


@pytest.mark.parametrize("name", ALL)
def test_the_rule_carries_waves_of_its_frequency(name):
    x = ALL[name]
    for t in (1.0, 8.0, 24.0):
        deviations, weights = x.rule(t)
        assert (weights >= 0).all()
        assert weights.sum() == pytest.approx(1.0, abs=1e-14)
        summed = np.exp(1j * t * x.mean) * (weights @ np.exp(1j * t * deviations))
        assert abs(summed - x.characteristic(t)) < 1e-13


@pytest.mark.parametrize("name", ALL)
def test_samples_follow_the_moments(name):
    x, n = ALL[name], 200_000
    draws = x.sample(n, np.random.default_rng(5))
    for k in (1, 2, 3):
        powers = (draws - x.mean) ** k
        expected = float(x.rule().weights @ x.rule().deviations ** k)
        assert abs(powers.mean() - expected) <= 4 * powers.std() / np.sqrt(n)


@pytest.mark.parametrize("m", range(4))
@pytest.mark.parametrize("n", range(4))
def test_trigonometric_moments_match_the_definition(m, n):
    for x in (rp.Normal(0.4, 0.5), rp.Beta(2.0, 3.0, -1.0, 2.0), MIXTURE, rp.Constant(0.7)):
        deviations, weights = x.rule(float(m + n))
        angle = x.mean + deviations
        expected = weights @ (np.cos(angle) ** m * np.sin(angle) ** n)
        assert rp.trigonometric_moment(x, m, n) == pytest.approx(expected, abs=1e-13)


def test_trigonometric_moments_of_a_uniform_turn():
    x = rp.Uniform(0.0, 2 * np.pi)
    assert rp.trigonometric_moment(x, 2, 0) == pytest.approx(1 / 2, abs=1e-14)
    assert rp.trigonometric_moment(x, 2, 2) == pytest.approx(1 / 8, abs=1e-14)
    assert rp.trigonometric_moment(x, 0, 4) == pytest.approx(3 / 8, abs=1e-14)


def test_mixture_weighs_moments_and_waves():
    a, b = rp.Normal(0.1, 0.2), rp.Gamma(2.0, 0.3)
    x = rp.Mixture([0.25, 0.75], (a, b))
    assert x.moment(5) == pytest.approx(0.25 * a.moment(5) + 0.75 * b.moment(5), rel=1e-13)
    assert abs(x.characteristic(2.0) - 0.25 * a.characteristic(2.0) - 0.75 * b.characteristic(2.0)) < 1e-15


@pytest.mark.parametrize("name", FAMILIES)
def test_scipy_families_become_ours(name):
    ours, theirs = FAMILIES[name]
    x = rp.as_random_variable(theirs)
    assert type(x) is type(ours)
    assert x.mean == pytest.approx(ours.mean, rel=1e-12)
    assert x.moment(4) == pytest.approx(ours.moment(4), rel=1e-10)


def test_other_scipy_distributions_are_integrated():
    x = rp.as_random_variable(stats.lognorm(0.1))
    for n in range(1, 9):
        assert x.moment(n) == pytest.approx(np.exp(0.5 * (0.1 * n) ** 2), rel=1e-9)
    logistic = rp.as_random_variable(stats.logistic(0.2, 0.1))
    expected = np.exp(0.2j * 2) * np.pi * 0.2 / np.sinh(np.pi * 0.2)
    assert abs(logistic.characteristic(2.0) - expected) < 1e-10
    poisson = rp.as_random_variable(stats.binom(10, 0.3))
    assert poisson.moment(2) == pytest.approx(9.0 + 2.1)
    assert len(logistic.sample(7, np.random.default_rng(0))) == 7


@pytest.mark.parametrize(
    ("x", "degree"),
    [(stats.t(3), 2), (stats.t(5.5), 5), (stats.pareto(5), 4), (stats.laplace(), 24), (stats.truncnorm(-1, 2), 24)],
)
def test_a_distribution_knows_which_moments_it_has(x, degree):
    ours = rp.as_random_variable(x)
    assert ours.degree == degree
    assert ours.moment(2) == pytest.approx(x.var() + x.mean() ** 2, rel=1e-9)
    with pytest.raises(rp.InputError, match=f"moment: expected an integer from 0 to {degree}, got {degree + 1}"):
        ours.moment(degree + 1)


def test_heavy_tails_keep_their_high_moments():
    wide = rp.as_random_variable(stats.lognorm(1.0))
    assert wide.moment(12) == pytest.approx(np.exp(72.0), rel=1e-9)
    assert rp.Mixture([0.5, 0.5], (stats.t(5), rp.Normal(0, 1))).degree == 4


def test_a_missing_moment_is_refused_where_it_is_asked_for():
    start = {"x": 0, "y": 0, "v": 5, "theta": 0}
    car = rp.ControlPrediction(rp.dynamics.dubins(0.1), start, {"w_v": stats.t(3), "w_theta": 0}, 3)
    assert car.moments(2).covariances[-1, 0, 0, 0] == pytest.approx(0.01 * 3.0 * (4 + 1), rel=1e-9)
    with pytest.raises(rp.InputError, match="'w_v': expected a distribution with a moment of order 4"):
        car.moments(4)
    unsure = rp.ControlPrediction(rp.dynamics.dubins(0.1), {**start, "v": stats.t(3)}, {"w_v": 0, "w_theta": 0}, 3)
    with pytest.raises(rp.InputError, match=r"initial\['v'\]: expected a distribution with a moment of order 4"):
        unsure.moments(4)


def test_numbers_are_constants():
    assert rp.as_random_variable(2) == rp.Constant(2.0)
    assert rp.Constant(2.0).rule() == Rule(np.zeros(1), np.ones(1))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: rp.Normal(0.0, -1.0), "Normal: sd: expected a finite number in [0, 1e+09], got -1.0"),
        (lambda: rp.Normal("a", 1.0), "Normal: mu: expected a number, got 'a'"),
        (lambda: rp.Uniform(1.0, 1.0), "Uniform: high: expected more than low = 1.0, got 1.0"),
        (lambda: rp.Beta(0.0, 1.0), "Beta: a: expected a finite number in [0.01, 500], got 0.0"),
        (lambda: rp.Gamma(1.0, 0.0), "Gamma: scale: expected a finite number in (0, 1e+09], got 0.0"),
        (lambda: rp.Exponential(-1.0), "Exponential: scale: expected a finite number in (0, 1e+09], got -1.0"),
        (lambda: rp.Triangular(0.0, 2.0, 1.0), "Triangular: mode: expected low <= mode <= high, got 2.0"),
        (
            lambda: rp.Discrete([1, 2], [0.5, 0.6]),
            "Discrete: weights: expected weights that sum to 1, got a sum of 1.1",
        ),
        (lambda: rp.Mixture([1.0], ()), "Mixture: components: expected at least one, got none"),
        (
            lambda: rp.Mixture([1.0], ("x",)),
            "Mixture: components[0]: expected a random variable or a number, got str",
        ),
        (lambda: rp.Normal(0, 1).moment(-1), "moment: expected an integer from 0 to 24, got -1"),
        (
            lambda: rp.trigonometric_moment(rp.Normal(0, 1), 1, -1),
            "trigonometric_moment: n: expected an integer >= 0, got -1",
        ),
        (
            lambda: rp.as_random_variable(stats.cauchy()),
            "random variable: expected a distribution with a mean and a variance, got cauchy",
        ),
        (
            lambda: rp.as_random_variable(stats.poisson(2.0)),
            "random variable: expected a discrete distribution of at most 10000 values, got poisson",
        ),
        (
            lambda: rp.JointNormal([0, 0], [[1, 2], [2, 1]]),
            "JointNormal: covariance: expected a positive semi-definite matrix, got [[1.0, 2.0], [2.0, 1.0]]",
        ),
        (
            lambda: rp.JointNormal([0, 0], [[1, 2], [0, 1]]),
            "JointNormal: covariance: expected a symmetric matrix, got [[1.0, 2.0], [0.0, 1.0]]",
        ),
    ],
)
def test_refusals(make, message):
    with pytest.raises(rp.InputError) as error:
        make()
    assert str(error.value) == message
