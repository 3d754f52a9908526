"""Gradients with the pose, against differences of other mathematics in mpmath and of the values themselves."""

from __future__ import annotations

import itertools

import mpmath as mp
import numpy as np
import pytest
from builders import covariance, mixture, row, single, spin
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import cone, gaussian_form_moments, strip

import checkers
from checkers import GaussianMixturePrediction, InputError, MomentPrediction, checker, trajectory_risk
from checkers.shapes import EgoCover, EgoEllipsoid

NAMES = [name for name, info in checkers.checkers().items() if info.gradient]
Q = np.array([[0.3, 0.1], [0.1, 0.9]])
DIGITS = 40


class Pieces:
    """Two tilted ellipses off the centre."""

    def pieces(self, agent):
        return np.array([[1.5, -0.7], [-1.0, 0.2]]), np.array([Q, [[0.5, -0.1], [-0.1, 0.2]]])


def whitened(pose, mean, cov):
    """(m, S) in mpmath of poses in mpmath, by the square root of the turned form (no triangular factor)."""
    c, s = mp.cos(pose[2]), mp.sin(pose[2])
    turn = mp.matrix([[c, -s], [s, c]])
    form = turn * mp.matrix(Q.tolist()) * turn.T
    # √F = (F + √det I) / √(tr + 2 √det) of a 2 × 2 matrix
    det = mp.sqrt(mp.det(form))
    root = (form + det * mp.eye(2)) / mp.sqrt(form[0, 0] + form[1, 1] + 2 * det)
    d = mp.matrix([mp.mpf(float(mean[i])) - pose[i] for i in range(2)])
    return root * d, root * mp.matrix(np.asarray(cov).tolist()) * root


def exact_value(m, s):
    return cone(m, s, nodes=20)


def cantelli_value(m, s):
    raw = gaussian_form_moments(m, s, 2)
    variance = raw[2] - raw[1] ** 2
    return variance / raw[2] if raw[1] > 0 else mp.mpf(1)


def mahalanobis_value(m, s):
    """1 / (1 + d²) by the nearest point of the rim, found along the circle."""
    if m[0] ** 2 + m[1] ** 2 <= 1:
        return mp.mpf(1)
    inverse = s**-1

    def square(t):
        r = mp.matrix([mp.cos(t) - m[0], mp.sin(t) - m[1]])
        return (r.T * inverse * r)[0]

    angles = np.linspace(0.0, 2 * np.pi, 5000)
    r = np.stack([np.cos(angles) - float(m[0]), np.sin(angles) - float(m[1])])
    t = mp.mpf(angles[np.argmin((r * (np.array(inverse.tolist(), dtype=float) @ r)).sum(0))])
    for _ in range(40):
        step = mp.diff(square, t) / mp.diff(square, t, 2)
        t -= step
        if abs(step) < mp.mpf(10) ** -25:
            break
    return 1 / (1 + square(t))


VALUES = {"exact": exact_value, "chebyshev": cantelli_value, "marshall-olkin": mahalanobis_value}


def differences(value, pose, mean, cov, step):
    """Fourth-order central differences in mpmath."""
    with mp.workdps(DIGITS):
        start = [mp.mpf(float(v)) for v in pose]
        out = []
        for i in range(3):
            parts = []
            for k in (-2, -1, 1, 2):
                moved = list(start)
                moved[i] += k * mp.mpf(step)
                parts.append(value(*whitened(moved, mean, cov)))
            out.append((parts[0] - 8 * parts[1] + 8 * parts[2] - parts[3]) / (12 * mp.mpf(step)))
        return np.array([float(v) for v in out])


CASES = [  # σ1, σ2, angle of Σ, mean relative to the ego, heading
    (0.5, 0.5, 0.0, (3.0, 0.0), 0.0),
    (1.0, 0.3, 0.4, (2.0, 1.5), 0.7),
    (0.8, 0.2, 1.1, (5.5, -2.0), -2.0),  # P = 1e-131
    (0.5, 0.25, 2.0, (-9.0, 2.0), 1.0),  # P = 1e-190
    (0.02, 0.01, 0.3, (1.9, 0.3), 0.2),
    (0.05, 0.0005, 0.3, (2.1, 0.1), 0.2),  # a needle across the rim
    (3.0, 0.001, 0.9, (0.4, 0.2), -0.5),  # a needle through the inside
    (30.0, 20.0, 0.5, (0.1, 0.05), 0.3),  # flat: the rim's parts nearly cancel
    (2000.0, 1500.0, 0.5, (0.1, -0.3), 0.3),
    (0.3, 0.2, 0.5, (0.01, 0.02), 0.3),  # inside
    (0.1, 0.1, 0.0, (0.3, 0.2), 0.3),  # deep inside: both rims far away
]

# d P / d (x, y, heading) of the cases, by `slow_truth`
TRUTH = [
    (0.03168329585391308, 0.0031362261247124355, 0.009408678374137306),
    (0.14939165728794718, 0.3344217387030829, 0.20706652326957778),
    (1.3206795447704597e-123, -6.62892290077054e-124, -4.13322792465999e-124),
    (-2.338279326266628e-140, -4.115117412348386e-141, -1.7232064482741015e-140),
    (0.025315303075042407, 0.010248906704814742, 0.011752336912596353),
    (0.00014004861289459896, -4.802169695964476e-06, -1.3305206683602027e-05),
    (0.01810282740671942, 0.0004249505980459879, 0.003262247527583262),
    (1.8562746082348432e-07, 8.263989678515421e-08, 4.552020127676674e-07),
    (1.7654427684679482e-14, -4.187289017869847e-14, 1.2768156974339943e-14),
    (2.3906784220628046e-06, 3.306982957214947e-05, 3.6947368220731355e-05),
    (-1.1028769014340545e-18, 2.2568823611900955e-16, 6.792704621704894e-17),
]


def slow_truth(case, value=exact_value):
    s1, s2, angle, mean, heading = case
    return differences(value, [0.0, 0.0, heading], mean, covariance(s1, s2, angle), min(min(s1, s2) * 1e-5, 1e-3))


@pytest.mark.parametrize(("case", "want"), list(zip(CASES, TRUTH, strict=True)))
def test_exact_in_the_tails_and_where_the_rim_cancels(case, want):
    s1, s2, angle, mean, heading = case
    pred, pose = single(mean, covariance(s1, s2, angle)), np.array([[0.0, 0.0, heading]])
    got = checker("exact").gradient(pose, pred, EgoEllipsoid(Q))[0, 0]
    # digits that rounding of the inputs may take: the exponent changes by ε |m| / σ per deviation
    allowed = 1e-11 + 1e-13 / min(s1, s2)
    np.testing.assert_allclose(got, want, rtol=0, atol=allowed * np.abs(want).max())


@pytest.mark.slow
@pytest.mark.parametrize(("case", "want"), list(zip(CASES, TRUTH, strict=True)))
def test_stored_truth(case, want):
    np.testing.assert_allclose(slow_truth(case), want, rtol=1e-13)


@pytest.mark.slow
def test_the_two_oracles_agree_on_a_gradient():
    a, b = (slow_truth(CASES[2], f) for f in (exact_value, lambda m, s: strip(m, s, 24)))
    np.testing.assert_allclose(a, b, rtol=1e-11)


@pytest.mark.parametrize("name", ["marshall-olkin", "chebyshev"])
@pytest.mark.parametrize("case", CASES[:9])
def test_bounds_against_mpmath(name, case):
    s1, s2, angle, mean, heading = case
    cov, pose = covariance(s1, s2, angle), np.array([0.0, 0.0, heading])
    got = checker(name).gradient(pose[None], single(mean, cov), EgoEllipsoid(Q))[0, 0]
    want = differences(VALUES[name], pose, mean, cov, 1e-7 * min(s1, s2))
    np.testing.assert_allclose(got, want, rtol=0, atol=1e-9 * np.linalg.norm(want) + 1e-15)


def by_values(c, poses, pred, ego, h=1e-5):
    """Sixth-order differences of the backend's own values."""
    out = np.zeros((*c(poses, pred, ego).value.shape, 3))
    for i in range(3):
        for k, weight in ((1, 45), (2, -9), (3, 1)):
            e = h * k * np.eye(3)[i]
            out[..., i] += weight * (c(poses + e, pred, ego).value - c(poses - e, pred, ego).value) / (60 * h)
    return out


def skewed(rng, steps):
    """A moment agent with third and fourth moments of its own: of a few weighted points."""
    points, weights = rng.normal(size=(steps, 5, 2)) * [1.5, 0.7], rng.dirichlet(np.ones(5), steps)
    means = (weights[..., None] * points).sum(1)
    d = points - means[:, None]
    moments = np.full((steps, 1, 5, 5), np.nan)
    for i in range(5):
        for j in range(5 - i):
            moments[:, 0, i, j] = (weights * d[..., 0] ** i * d[..., 1] ** j).sum(1)
    moments[:, 0, 0, 1] = moments[:, 0, 1, 0] = 0.0
    return MomentPrediction(np.arange(steps, dtype=float), [1.0], (means + [4.0, 1.0])[:, None], moments)


@pytest.mark.parametrize("name", ["marshall-olkin", "chebyshev"])
@pytest.mark.parametrize("ego", [EgoEllipsoid(Q), Pieces()], ids=["ellipse", "pieces"])
def test_moment_agents(name, ego):
    rng = np.random.default_rng(3)
    pred, c = skewed(rng, 40), checker(name)
    poses = rng.uniform(-1, 1, (40, 3)) * [2.0, 2.0, 3.0]
    got, want = c.gradient(poses, pred, ego), by_values(c, poses, pred, ego)
    inside = np.abs(want).max(axis=-1) == 0.0
    free = c(poses, pred, ego).value < 0.9  # the sum of pieces is capped at 1, its gradient is not
    assert free.sum() > 20
    np.testing.assert_allclose(got[free & ~inside], want[free & ~inside], rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("ego", [Pieces(), EgoCover(4.5, 1.8, 4)], ids=["pieces", "cover"])
@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_differences_of_the_values(name, ego, seed):
    rng = np.random.default_rng(seed)
    pred, c = mixture(rng, steps=3, modes=2, per_step=bool(seed % 2)), checker(name)
    poses = rng.uniform(-1, 1, (3, 3)) * [8.0, 8.0, 4.0]
    value, got = c(poses, pred, ego).value, c.gradient(poses, pred, ego)
    want = by_values(c, poses, pred, ego, 1e-4)
    smooth = (value < 0.98) & (by_values(c, poses, pred, ego, 5e-5) - want < 1e-8).all(axis=-1)  # no kink near
    np.testing.assert_allclose(got[smooth], want[smooth], rtol=1e-6, atol=3e-9)


def test_exact_over_ten_decades_of_spread_and_into_the_tails():
    """d log P against differences of log P, which tails leave smooth."""
    rng, n = np.random.default_rng(0), 3000
    large = np.exp(rng.uniform(np.log(1e-3), np.log(1e2), n))
    small = large * np.exp(-rng.uniform(0, np.log(1e3), n))
    covs = [covariance(a, b, t) for a, b, t in zip(large, small, rng.uniform(0, np.pi, n), strict=True)]
    way = rng.uniform(0, 2 * np.pi, n)
    way = np.column_stack([np.cos(way), np.sin(way)])
    reach = np.sqrt(np.einsum("ni,nij,nj->n", way, covs, way)) * rng.uniform(0, 12, n) * (rng.random(n) < 0.7)
    pred = row((rng.uniform(0, 2, n) + reach)[:, None] * way, covs)
    poses = np.column_stack([np.zeros((n, 2)), rng.uniform(-3, 3, n)])
    c, ego = checker("exact"), EgoEllipsoid(Q)
    risk, h = c(poses, pred, ego), 2e-3 * np.minimum(small, 1.0)
    use = (risk.value[:, 0] > 1e-280) & (np.abs(c.gradient(poses, pred, ego)[:, 0]).max(1) > 1e-280)
    got = c.gradient(poses, pred, ego)[use, 0] / risk.value[use]
    want = np.zeros((n, 3))
    for i, (k, weight) in itertools.product(range(3), ((1, 45), (2, -9), (3, 1))):
        step = np.outer(h * k, np.eye(3)[i])
        up, down = (c(p, pred, ego).value[:, 0] for p in (poses + step, poses - step))
        want[use, i] += weight * (np.log(up[use]) - np.log(down[use])) / (60 * h[use])
    size = np.abs(got).max(axis=1)
    noise = (risk.error[use, 0] / risk.value[use, 0] + 1e-15) / (h[use] * size)
    assert use.sum() > 1500
    assert (np.abs(got - want[use]).max(axis=1) <= (1e-8 + 30 * noise) * size).all()


@pytest.mark.parametrize("name", NAMES)
def test_turning_and_moving_the_scene_turns_the_gradient(name):
    rng = np.random.default_rng(5)
    pred, c = mixture(rng), checker(name)
    poses = rng.uniform(-3, 3, (4, 3))
    r, shift = spin(0.8), np.array([1e5, -1e5])
    moved = GaussianMixturePrediction(
        pred.times, pred.weights, pred.means @ r.T + shift, r @ pred.covariances @ r.T, pred.modes
    )
    there = np.column_stack([poses[:, :2] @ r.T + shift, poses[:, 2] + 0.8])
    here = c.gradient(poses, pred, Pieces())
    want = np.concatenate([here[..., :2] @ r.T, here[..., 2:]], axis=-1)
    np.testing.assert_allclose(c.gradient(there, moved, Pieces()), want, rtol=1e-7, atol=1e-12)


def test_mass_on_a_line():
    line = covariance(1.5, 0.0, 0.6)
    c, ego = checker("exact"), EgoEllipsoid(np.diag([0.25, 1.0]))
    poses = np.array([[0.3, 0.2, 0.4]])
    pred = single((0.5, 0.4), line)
    np.testing.assert_allclose(c.gradient(poses, pred, ego), by_values(c, poses, pred, ego), rtol=1e-7)
    thin = single((0.5, 0.4), covariance(1.5, 1e-7, 0.6))
    np.testing.assert_allclose(c.gradient(poses, pred, ego), c.gradient(poses, thin, ego), rtol=1e-6)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("mean", [(0.1, 0.0), (50.0, 3.0)])
def test_a_point_has_none(name, mean):
    got = checker(name).gradient(np.zeros((1, 3)), single(mean, np.zeros((2, 2))), EgoEllipsoid(Q))
    np.testing.assert_array_equal(got, np.zeros((1, 1, 3)))


@pytest.mark.parametrize("name", NAMES)
def test_a_disc_does_not_mind_its_heading(name):
    pred = row(np.random.default_rng(0).normal(size=(20, 2)) * 3, [covariance(0.7, 0.3, 0.2)] * 20)
    got = checker(name).gradient(np.full((20, 3), 0.4), pred, EgoEllipsoid(np.eye(2) / 4))
    assert np.abs(got[..., :2]).max() > 1e-3
    assert np.abs(got[..., 2]).max() < 1e-15


@pytest.mark.parametrize("name", NAMES)
def test_batches_shared_among_threads_change_nothing(name):
    rng = np.random.default_rng(1)
    pred, c = mixture(rng, steps=10), checker(name)
    poses = rng.uniform(-5, 5, (2500, 10, 3))
    got = c.gradient(poses, pred, EgoEllipsoid(Q))
    assert got.shape == (2500, 10, 3, 3)
    for b in (0, 1249, 2499):
        np.testing.assert_array_equal(got[b], c.gradient(poses[b], pred, EgoEllipsoid(Q)))
    assert c.gradient(poses[:0], pred, EgoEllipsoid(Q)).shape == (0, 10, 3, 3)


def test_the_mixture_taken_whole():
    rng = np.random.default_rng(2)
    pred, c = mixture(rng), checker("chebyshev", per="mixture")
    poses = rng.uniform(-6, 6, (4, 3))
    got = c.gradient(poses, pred, EgoEllipsoid(Q))
    assert got.shape == (4, 1, 3)
    np.testing.assert_allclose(got, by_values(c, poses, pred, EgoEllipsoid(Q)), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("name", list(checkers.checkers()))
def test_declared_or_refused(name):
    c = checker(name)
    assert bool(c.gradient_kernel) == c.info.gradient
    pred = single((4.0, 0.0), np.eye(2))
    if c.info.gradient:
        with pytest.raises(InputError, match=r"poses\[0, 1\]: expected a finite number, got nan"):
            c.gradient([[0.0, np.nan, 0.0]], pred, EgoEllipsoid(Q))
        with pytest.raises(InputError, match=r"poses: expected shape \(1, 3\) or \(B, 1, 3\), got \(2, 3\)"):
            c.gradient(np.zeros((2, 3)), pred, EgoEllipsoid(Q))
    else:
        with pytest.raises(InputError, match=f"^{name}: has no gradient; exact, chebyshev, marshall-olkin have one$"):
            c.gradient(np.zeros((1, 3)), pred, EgoEllipsoid(Q))


# ----------------------------------------------------------------------------------------------------
# the trajectory


def total_differences(c, poses, preds, ego, dependence, h):
    out = np.zeros_like(poses)
    for t, i in np.ndindex(poses.shape):
        for k, weight in ((1, 45), (2, -9), (3, 1)):
            e = np.zeros_like(poses)
            e[t, i] = k * h
            up, down = (
                float(trajectory_risk([c(p, a, ego) for a in preds], preds, dependence).total)
                for p in (poses + e, poses - e)
            )
            out[t, i] += weight * (up - down) / (60 * h)
    return out


@pytest.mark.parametrize("dependence", ["independent", "boole"])
@pytest.mark.parametrize("per_step", [False, True])
def test_trajectory_against_differences(dependence, per_step):
    rng = np.random.default_rng(8)
    preds = [_agent(rng, k, per_step) for k in (1, 3)]
    c, ego = checker("exact"), EgoEllipsoid(Q)
    poses = np.column_stack([rng.uniform(-2, 2, (4, 2)) + [6.0, 0.0], rng.uniform(-3, 3, 4)])
    risks, gradients = [c(poses, a, ego) for a in preds], [c.gradient(poses, a, ego) for a in preds]
    got = checkers.trajectory_risk_gradient(risks, gradients, preds, dependence)
    want = total_differences(c, poses, preds, ego, dependence, 2e-4)
    assert float(trajectory_risk(risks, preds).total) > 1e-3
    np.testing.assert_allclose(got, want, rtol=1e-7, atol=1e-9 * np.abs(want).max())


def _agent(rng, modes, per_step):
    base = mixture(rng, modes=modes, per_step=per_step)
    kind = "per_step" if per_step else "persistent"
    return GaussianMixturePrediction(base.times, base.weights, base.means, base.covariances, modes=kind)


def test_trajectory_survives_certain_and_tiny_risks():
    pred = row([(0.0, 0.0), (9.0, 0.0), (30.0, 0.0)], [covariance(0.01, 0.01), covariance(1, 1), covariance(1, 1)])
    c, ego, poses = checker("exact"), EgoEllipsoid(Q), np.zeros((3, 3))
    risk, gradient = c(poses, pred, ego), c.gradient(poses, pred, ego)
    assert risk.value[0, 0] == 1.0 and risk.value[2, 0] < 1e-100
    got = checkers.trajectory_risk_gradient([risk], [gradient], [pred])
    np.testing.assert_array_equal(got[1:], 0.0)  # the first step collides for sure
    assert np.isfinite(got).all()
    tail = row([(9.0, 0.0), (30.0, 0.0)], [covariance(1, 1)] * 2)
    risk, gradient = c(poses[:2], tail, ego), c.gradient(poses[:2], tail, ego)
    got = checkers.trajectory_risk_gradient([risk], [gradient], [tail])
    np.testing.assert_allclose(got[1], gradient[1, 0] * (1.0 - risk.value[0, 0]), rtol=1e-14)
    assert 0 < abs(got[1, 0]) < 1e-100


def test_trajectory_of_batches():
    rng = np.random.default_rng(4)
    preds = [_agent(rng, 2, False), _agent(rng, 3, True)]
    c, poses = checker("marshall-olkin"), rng.uniform(-6, 6, (5, 4, 3))
    risks, gradients = ([f(poses, a, Pieces()) for a in preds] for f in (c, c.gradient))
    got = checkers.trajectory_risk_gradient(risks, gradients, preds)
    assert got.shape == (5, 4, 3)
    one = checkers.trajectory_risk_gradient(
        [c(poses[2], a, Pieces()) for a in preds], [c.gradient(poses[2], a, Pieces()) for a in preds], preds
    )
    np.testing.assert_allclose(got[2], one, rtol=1e-14)


def test_trajectory_refuses_what_does_not_fit():
    pred = single((4.0, 0.0), np.eye(2))
    risk = checker("exact")(np.zeros((1, 3)), pred, EgoEllipsoid(Q))
    with pytest.raises(InputError, match=r"gradients\[0\]: expected shape \(1, 1, 3\), got \(1, 3\)"):
        checkers.trajectory_risk_gradient([risk], [np.zeros((1, 3))], [pred])
    with pytest.raises(InputError, match="gradients: expected as many as risks"):
        checkers.trajectory_risk_gradient([risk], [], [pred])
    with pytest.raises(InputError, match="dependence: expected one of independent, boole"):
        checkers.trajectory_risk_gradient([risk], [np.zeros((1, 1, 3))], [pred], "persistent")
