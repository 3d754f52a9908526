"""Numbers against other mathematics: the oracles against each other, then the backends against them."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest
from builders import cases, covariance, discrete, row, single
from oracles import (
    as_mp,
    cone,
    cone_bulk,
    gaussian_form_moments,
    point_form_moments,
    sampled,
    strip,
    tail_bound,
    truth,
    whiten,
)

from benchmarks.cases import random_modes
from checkers import EgoEllipsoid, checker, checkers, refine
from checkers.kernels import gaussian
from checkers.kernels.whiten import determinant
from checkers.sdp import IntervalProgram, certified_value

DISC = EgoEllipsoid(np.eye(2))


def _grid():
    """σ from 1e-4 to 1e4 of the ellipse, σ ratios to 1e4, means from inside to 37 σ outside."""
    rng = np.random.default_rng(21)
    out = []
    for sigma in (1e-4, 1e-2, 1.0, 1e2, 1e4):
        for ratio in (1.0, 10.0, 1e4):
            for where in (0.0, 0.4, 0.999, 1.001, 5.0, 37.0):
                way = rng.uniform(0, 2 * np.pi)
                u = np.array([np.cos(way), np.sin(way)])
                if where < 2:
                    mean = where * u
                else:  # that many σ beyond the rim
                    mean = where * sigma * u * [1.0, ratio]
                    mean = mean * (1 + 1 / np.hypot(*mean))
                out.append((mean, (sigma**2, 0.0, (sigma * ratio) ** 2)))
    return out


GRID = _grid()
ANCHORS = GRID[::4]


@pytest.fixture(scope="module")
def anchors():
    return [float(cone(*as_mp(m, s))) for m, s in ANCHORS]


@pytest.fixture(scope="module")
def grid_truth():
    return cone_bulk(*zip(*GRID, strict=True))


def at_grid(name, grid=GRID):
    """A backend on the grid's modes: unit disc at heading 0, so that nothing is rounded on the way."""
    covs = [[[s[0], s[1]], [s[1], s[2]]] for _, s in grid]
    return checker(name)(np.zeros((len(grid), 3)), row([m for m, _ in grid], covs), DISC)


# ---- the oracles


def test_two_formulas_agree():
    for mean, s in GRID[1::11]:
        a, b = cone(*as_mp(mean, s)), strip(*as_mp(mean, s))
        assert abs(a / b - 1) < 1e-12


def test_formulas_know_closed_forms():
    # isotropic about the centre: 1 − exp(−1/2σ²)
    for sigma in (0.1, 1.0, 30.0):
        s = (sigma**2, 0.0, sigma**2)
        with mp.workdps(30):
            exact = -mp.expm1(-1 / (2 * mp.mpf(sigma) ** 2))
            assert abs(cone(*as_mp((0, 0), s)) / exact - 1) < 1e-12
            assert abs(strip(*as_mp((0, 0), s)) / exact - 1) < 1e-12


def test_bulk_oracle_agrees_with_mpmath(anchors):
    np.testing.assert_allclose(cone_bulk(*zip(*ANCHORS, strict=True)), anchors, rtol=1e-10, atol=1e-320)


def test_bulk_oracle_agrees_with_sampling():
    cov = covariance(0.5, 2.0, 0.4)
    share = sampled([1.0, -0.8], cov, 400_000, 1)
    assert truth([[0, 0, 0]], [[1.0, -0.8]], [cov], np.eye(2))[0] == pytest.approx(share, abs=4e-3)


def test_sharp_bound_oracle_agrees_with_cantelli():
    # mean 2, variance 3: P(X ≤ 0) ≤ 3/(3 + 4)
    assert float(tail_bound([1, 2, 7])) == pytest.approx(3 / 7, rel=1e-14)


# ---- exact values


def test_exact_to_1e_10(anchors, grid_truth):
    risk = at_grid("exact", ANCHORS)
    np.testing.assert_allclose(risk.value[:, 0], anchors, rtol=1e-10, atol=1e-320)
    risk = at_grid("exact")
    np.testing.assert_allclose(risk.value[:, 0], grid_truth, rtol=1e-10, atol=1e-320)
    assert (grid_truth > 0).any()
    assert grid_truth.min() < 1e-250


@pytest.fixture(scope="module")
def tight():
    """Of 20,000 modes those that whitening in doubles hurts most, their values by it, and P."""
    modes = random_modes(np.random.default_rng(3), 20_000)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(refine, "WANTED", 1e9)
        plain = checker("exact")(modes.poses, modes.prediction, modes.ego).value[:, 0]
    value = checker("exact")(modes.poses, modes.prediction, modes.ego).value[:, 0]
    worst = np.argsort(np.where(value > 1e-300, np.abs(plain - value) / np.maximum(value, 1e-300), 0.0))[-5:]
    few = modes.part(worst)
    true = [
        float(cone(*whiten(pose, mean, cov, few.ego.Q), nodes=18))
        for pose, mean, cov in zip(few.poses, few.means, few.covariances, strict=True)
    ]
    return few, plain[worst], true


@pytest.mark.parametrize("name", ["exact", "imhof"])
def test_tight_modes_keep_the_digits_that_whitening_drops(name, tight):
    few, plain, true = tight
    assert (np.abs(plain / true - 1) > 1e-10).all()
    np.testing.assert_allclose(checker(name)(few.poses, few.prediction, few.ego).value[:, 0], true, rtol=5e-11)


def test_imhof_to_1e_8(anchors, grid_truth):
    risk = at_grid("imhof", ANCHORS)
    np.testing.assert_allclose(risk.value[:, 0], anchors, rtol=1e-8, atol=1e-320)
    np.testing.assert_allclose(at_grid("imhof").value[:, 0], grid_truth, rtol=1e-8, atol=1e-320)


@pytest.mark.parametrize("name", ["exact", "imhof"])
def test_returned_error_holds(name, anchors):
    """On the exact doubles the backend is given, against mpmath; and the error is of use."""
    risk = at_grid(name, ANCHORS)
    value, error = risk.value[:, 0], risk.error[:, 0]
    assert (np.abs(value - anchors) <= error + 1e-15 * np.array(anchors)).all()
    assert (error <= 1e-6 * value + 1e-300).all()


@pytest.mark.parametrize("name", ["exact", "imhof"])
def test_returned_error_holds_for_tilted_narrow_modes(name):
    """σ 1e-3 by 10 at an angle: the small eigenvalue is a difference of large numbers."""
    rng = np.random.default_rng(3)
    for _ in range(5):
        angle = rng.uniform(0.2, 1.3)
        cov = covariance(1e-3, 10.0, angle)
        mean = 1.02 * np.array([np.cos(angle), np.sin(angle)])
        risk = checker(name)(np.zeros((1, 3)), single(mean, cov), DISC)
        true = float(cone(*as_mp(mean, (cov[0, 0], cov[0, 1], cov[1, 1]))))
        assert abs(risk.value[0, 0] - true) <= risk.error[0, 0]


# found by the campaign: means inside, risks near 1; `imhof` was off by 1.5e-2 and 1, `exact` by 7e-12
INSIDE = [
    (
        [0.4738048988370309, -0.5924748162955922],
        [0.00012348138171008237, 0.00029435699535916023, 0.0016491798815800318],
    ),
    (
        [0.02967261562845991, -0.8297488016620562],
        [0.0012207838668864958, -0.0011121141615046638, 0.0010380935437680964],
    ),
    (
        [0.7978359025238575, 0.12438169942253019],
        [0.0007772163109194449, -0.001913417507013129, 0.006219212951317077],
    ),
    ([0.6858811785199652, -0.45980043762657535], [2.532226241355642e-06, 0.0, 0.0011748244752563019]),
]


@pytest.mark.parametrize("name", ["exact", "imhof"])
@pytest.mark.parametrize("case", range(len(INSIDE)))
def test_returned_error_holds_inside(name, case):
    mean, s = INSIDE[case]
    risk = at_grid(name, [(mean, s)])
    true = float(strip(*as_mp(mean, s)))
    assert risk.value[0, 0] == pytest.approx(true, rel=1e-10)
    assert abs(risk.value[0, 0] - true) <= risk.error[0, 0]


def test_exact_and_imhof_agree_inside():
    """Two methods, 4000 modes with their means inside: each within both stated errors."""
    rng = np.random.default_rng(0)
    sigma = 10 ** rng.uniform(-3, -0.5, 4000)
    covs = np.zeros((4000, 2, 2))
    covs[:, 0, 0], covs[:, 1, 1] = sigma**2, (sigma * 10 ** rng.uniform(0, 1.5, 4000)) ** 2
    radius, way = rng.uniform(0, 1, 4000), rng.uniform(0, 2 * np.pi, 4000)
    pred = row(np.column_stack([radius * np.cos(way), radius * np.sin(way)]), covs)
    a, b = (checker(name)(np.zeros((4000, 3)), pred, DISC) for name in ("exact", "imhof"))
    assert (np.abs(a.value - b.value) <= a.error + b.error).all()


@pytest.mark.parametrize("distance", [5.0, 20.0, 37.0])
def test_returned_error_holds_for_tiny_modes(distance):
    """σ = 1e-8 of the ellipse: positions near the rim have only 1e-8 σ of resolution."""
    sigma = 1e-8
    mean = (1 + distance * sigma) * np.array([0.6, 0.8])
    s = (sigma**2, 0.0, sigma**2)
    true = float(strip(*as_mp(mean, s)))
    for name in ("exact", "imhof"):
        risk = at_grid(name, [(mean, s)])
        assert abs(risk.value[0, 0] - true) <= risk.error[0, 0]


def test_tail_to_1e_300():
    for distance in (10.0, 20.0, 30.0, 36.5):
        mean, s = (1 + 0.3 * distance, 0.0), (0.09, 0.0, 0.25)
        true = float(cone(*as_mp(mean, s)))
        for name in ("exact", "imhof"):
            assert at_grid(name, [(mean, s)]).value[0, 0] == pytest.approx(true, rel=1e-9, abs=0)
    assert true < 1e-285


# ---- bounds


def half_space(m, s):
    return gaussian.half_space(*m, *s, determinant(*s))


def test_half_space_kernel_bounds_from_close(grid_truth):
    ratios = []
    for (mean, s), true in zip(GRID, grid_truth, strict=True):
        bound = half_space(mean, s)
        assert 1 >= bound >= true
        if max(s) <= 4 and np.hypot(*mean) > 1 and true > 0:
            ratios.append(bound / true)
    assert np.median(ratios) < 3


def test_half_space_kernel_bounds_random_modes():
    poses, means, covs = cases(np.random.default_rng(5), 300, sigma=(1e-3, 3.0))
    true = truth(poses * [1, 1, 0], means, covs, np.eye(2))
    for pose, mean, cov, p in zip(poses, means, covs, true, strict=True):
        assert half_space(mean - pose[:2], cov.ravel()[[0, 1, 3]]) >= p


@pytest.mark.parametrize("sigma", [1e-3, 1e-6, 1e-9])
def test_half_space_kernel_bounds_tiny_modes(sigma):
    """The rim is flat at this scale: the bound is the truth up to a factor near 1, and rounding shows."""
    rng = np.random.default_rng(8)
    for _ in range(8):
        way = rng.uniform(0, 2 * np.pi)
        mean = (1 + rng.uniform(0.1, 30) * sigma) * np.array([np.cos(way), np.sin(way)])
        s = (sigma**2, 0.0, sigma**2)
        assert half_space(mean, s) >= float(strip(*as_mp(mean, s)))


@pytest.mark.parametrize("order", [2, 4, 6, 8, 10, 12])
def test_sos_closed_form_is_the_sharp_bound(order):
    """Against orthogonal polynomials in 60 digits, on moments expanded in 60 digits."""
    rng = np.random.default_rng(order)
    _, _, covs = cases(rng, 12, sigma=(0.1, 2.0))
    for cov in covs:
        mean = rng.uniform(-4, 4, 2)
        m, s = as_mp(mean, (cov[0, 0], cov[0, 1], cov[1, 1]))
        best = float(tail_bound(gaussian_form_moments(m, s, order)))
        value = checker("sos", order=order)(np.zeros((1, 3)), single(mean, cov), DISC).value[0, 0]
        assert value == pytest.approx(best, rel=1e-7)


def test_sos_closed_form_from_moments_of_a_few_points():
    rng = np.random.default_rng(77)
    for _ in range(20):
        points, weights = rng.normal(size=(6, 2)) * 1.5 + [1.5, 0], rng.dirichlet(np.ones(6))
        pred = discrete(points, weights, 8)
        best = float(tail_bound(point_form_moments(points, weights, 4)))
        value = checker("sos", order=4)(np.zeros((1, 3)), pred, DISC).value[0, 0]
        assert value == pytest.approx(best, rel=1e-6)


@pytest.mark.parametrize("order", [2, 4, 6, 8, 10, 12])
def test_sos_closed_form_agrees_with_clarabel(order):
    rng = np.random.default_rng(30 + order)
    n = 150
    means, covs = rng.uniform(-2.5, 2.5, (n, 2)), cases(rng, n, sigma=(0.3, 1.5), ratio=3.0)[2]
    pred, poses = row(means, covs), np.zeros((n, 3))
    closed = checker("sos", order=order)(poses, pred, DISC).value
    solved = checker("sos", order=order, solver="clarabel")(poses, pred, DISC).value
    np.testing.assert_allclose(solved, closed, rtol=1e-6)
    assert (solved >= closed - 1e-9).all()  # certified: above the optimum


@pytest.mark.parametrize(
    ("order", "mean", "s"),
    [
        (10, [-0.299017, -0.0795166], [1.486888, 0.155507, 1.877029]),
        (12, [-0.208629, 0.467889], [2.862057, 0.236642, 0.430695]),
    ],
)
def test_clarabel_where_the_polynomial_touches_far_left(order, mean, s):
    """The worst of 3,000 modes each: the last digit of the solver's polynomial is 1 or 3 % of the answer there."""
    cov = [[s[0], s[1]], [s[1], s[2]]]
    closed, solved = (
        checker("sos", order=order, solver=solver)(np.zeros((1, 3)), single(mean, cov), DISC).value[0, 0]
        for solver in ("closed-form", "clarabel")
    )
    assert closed <= solved <= closed * (1 + 1e-6)


def test_clarabel_far_out():
    """Where a solver's tolerance, taken as an absolute one, would drown the risk."""
    spread = np.geomspace(1e-8, 0.3, 40)
    covs = spread[:, None, None] ** 2 * np.diag([1.0, 4.0])
    pred, poses = row(np.tile([3.0, 1.0], (40, 1)), covs), np.zeros((40, 3))
    for order in (2, 4, 8, 12):
        closed = checker("sos", order=order)(poses, pred, DISC).value
        solved = checker("sos", order=order, solver="clarabel")(poses, pred, DISC).value
        assert (solved >= closed).all()
        assert (solved <= 1.001 * closed + 1e-10).all()


def test_certificate_does_not_trust_the_solver():
    """Any sum of squares, divided by its minimum left of the threshold, dominates the indicator: a fine grid."""
    rng = np.random.default_rng(1)
    moments, noise = np.array([1, 0, 1, 0.3, 3.2]), np.zeros(5)
    x = np.linspace(-30, 30, 200_001)
    for _ in range(200):
        factor, x0 = rng.normal(size=(rng.integers(1, 4), 3)), rng.uniform(-2, 2)
        value = certified_value(factor, moments, noise, x0)
        squares = [np.polynomial.polynomial.polymul(f, f) for f in factor]
        p = np.polynomial.polynomial.polyval(x, np.sum(squares, axis=0))
        least = min(p[x <= x0].min(), np.polynomial.polynomial.polyval(x0, np.sum(squares, axis=0)))
        sharp = np.sum(squares, axis=0) @ moments / least
        assert value >= min(1.0, sharp) - 1e-12
        assert value <= sharp * (1.0 + 1e-4) + 1e-12  # the grid does not meet the minimum
        noisy = certified_value(factor, moments, np.array([0, 0, 0, 0, 0.1]), x0)
        assert noisy >= min(1.0, sharp + 0.1 * np.sum(squares, axis=0)[4] / least) - 1e-12
    for f in ([1.0, 0.0], [0.0, 0.0], [np.nan, 1.0], [1.0, np.nan], [0.0, np.inf], [1.0, 1e-200]):
        assert certified_value(np.array([f]), moments[:3], noise[:3], -1.0) == 1.0
    assert certified_value(np.array([[1.0, 1.0]]), moments[:3], noise[:3], -0.5) == 1.0  # a zero left of the threshold


def test_solver_is_never_below_zero():
    """Moments that no distribution has, as rounding leaves them: the program is unbounded below."""
    for fourth in (0.9, 0.999999, 0.0):
        assert 0 <= IntervalProgram(4).bound(np.array([1.0, 0.0, 1.0, 0.0, fourth]), np.zeros(5), -1.5) <= 1


def test_clarabel_at_any_threshold():
    """Spreads of 1e-60 put it 1e60 of them away, to either side."""
    moments = np.array([1.0, 0.0, 1.0, 0.0, 3.0, 0.0, 15.0])
    for x0, most in ((-1e60, 1e-20), (-1e3, 1e-11), (-1.0, 0.51), (1e3, 1.0), (1e60, 1.0)):
        assert 0 <= IntervalProgram(6).bound(moments, np.zeros(7), x0) <= most


def test_higher_orders_are_never_looser():
    poses, means, covs = cases(np.random.default_rng(6), 100, sigma=(0.1, 3.0))
    pred, before = row(means, covs), 1.0
    for order in (2, 4, 6, 8, 10, 12):
        value = checker("sos", order=order)(poses, pred, DISC).value
        assert (value <= before + 1e-9).all()
        before = value


def test_more_half_spaces_are_never_looser():
    poses, means, covs = cases(np.random.default_rng(7), 100, sigma=(0.1, 3.0))
    few, many = (checker("halfspace", n_h=n)(poses, row(means, covs), DISC).value for n in (6, 24))
    assert (many <= few * (1 + 1e-9)).all()  # 6 divides 24


# ---- the long run


@pytest.mark.slow
def test_campaign():
    """20,000 modes: every claim of every backend."""
    rng = np.random.default_rng(99)
    poses, means, covs = cases(rng, 20_000, sigma=(1e-3, 1e3), ratio=30.0, reach=30.0)
    poses[:, 2] = 0
    true, pred = truth(poses, means, covs, np.eye(2)), row(means, covs)
    for name in checkers():
        risk = checker(name)(poses, pred, DISC)
        value = risk.value[:, 0]
        kept = true > 1e-300
        if risk.kind.value == "exact":
            np.testing.assert_allclose(value[kept], true[kept], rtol=1e-8)
        elif risk.kind.value == "upper bound":
            assert (value >= true * (1 - 1e-10)).all()
        else:
            assert (np.abs(value - true) <= risk.error[:, 0]).mean() > 0.97
