"""Moment propagation against 60-digit arithmetic, the paper's first-order system, simulation, and symmetry."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles_propagation import DubinsOracle, simulated

import riskplan as rp
from checkers.dynamics import System

N = rp.Normal
SYSTEMS = {
    "dubins": (rp.dynamics.dubins(0.2), {"w_v": N(0.1, 0.3), "w_theta": rp.Uniform(-0.1, 0.2)}),
    "dubins_lateral": (
        rp.dynamics.dubins_lateral(0.2),
        {"w_v": rp.Gamma(2.0, 0.1), "w_theta": N(0.02, 0.08), "w_lateral": rp.Triangular(-0.2, 0.0, 0.4)},
    ),
    "unicycle": (
        rp.dynamics.unicycle(0.2),
        {
            "w_speed": rp.Mixture([0.4, 0.6], (N(4.0, 0.5), N(8.0, 1.0))),
            "w_turn": rp.Discrete([-0.5, 0.1, 0.9], [0.3, 0.4, 0.3]),
        },
    ),
    "dubins_3d": (
        rp.dynamics.dubins_3d(0.2),
        {"w_v": rp.Exponential(0.2, -0.2), "w_theta": N(0.0, 0.1), "w_gamma": rp.Beta(2.0, 3.0, -0.1, 0.2)},
    ),
    "constant_turn": (rp.dynamics.constant_turn(0.2, 0.6), {"w_v": rp.Beta(2.0, 2.0, -0.5, 0.5)}),
}
START = {"x": 0.0, "y": 0.0, "z": 0.0, "v": N(6.0, 0.5), "theta": N(0.4, 0.1), "gamma": rp.Uniform(-0.1, 0.3)}


def start_of(system):
    return {v: START[v] for v in system.variables}


def powers(order):
    return [(i, j) for i in range(order + 1) for j in range(order + 1 - i) if i + j > 0]


def assert_within_standard_errors(pred, paths, steps, order, limit=4.0):
    """Every moment to `order` at the steps, against samples (steps, n, 2)."""
    for t, points in zip(steps, paths, strict=True):
        d = points - pred.means[t, 0]
        for i, j in powers(order):
            z = d[:, 0] ** i * d[:, 1] ** j
            expected = pred.central_moments[t, 0, i, j]
            assert abs(z.mean() - expected) <= limit * z.std() / np.sqrt(len(z)) + 1e-14, (t, i, j)


def by_hand(name, system, controls, start, steps, n, rng):
    draws = {w: rp.as_random_variable(controls[w]).sample((steps, n), rng) for w in system.noises}
    values = {v: rp.as_random_variable(x).sample(n, rng) for v, x in start.items()}
    return simulated(name, system.dt, values, draws, turn_rate=0.6)


@pytest.mark.parametrize("name", SYSTEMS)
def test_every_moment_to_order_four_against_simulation(name):
    system, controls = SYSTEMS[name]
    pred = rp.propagate(system, start_of(system), controls, 12, order=4)
    paths = by_hand(name, system, controls, start_of(system), 12, 200_000, np.random.default_rng(8))
    assert_within_standard_errors(pred, paths[[1, 5, 12]], [1, 5, 12], 4)


@pytest.mark.slow
@pytest.mark.parametrize("name", SYSTEMS)
def test_every_moment_to_order_four_against_ten_million_simulations(name):
    system, controls = SYSTEMS[name]
    steps, rng = [1, 5, 12], np.random.default_rng(18)
    pred = rp.propagate(system, start_of(system), controls, 12, order=4)
    sums = np.zeros((2, len(steps), len(powers(4))))
    for _ in range(50):
        paths = by_hand(name, system, controls, start_of(system), 12, 200_000, rng)
        for s, t in enumerate(steps):
            d = paths[t] - pred.means[t, 0]
            for p, (i, j) in enumerate(powers(4)):
                z = d[:, 0] ** i * d[:, 1] ** j
                sums[:, s, p] += z.sum(), (z * z).sum()
    n = 10_000_000
    mean = sums[0] / n
    error = np.sqrt(np.maximum(sums[1] / n - mean**2, 0.0) / n)
    expected = np.array([[pred.central_moments[t, 0, i, j] for i, j in powers(4)] for t in steps])
    assert (np.abs(mean - expected) <= 4 * error + 1e-14).all()


def dubins_controls(steps, sd_v=0.05, sd_theta=0.01):
    v = [(0.03 * np.sin(t), sd_v) for t in range(steps)]
    theta = [(0.02 * np.cos(0.3 * t), sd_theta) for t in range(steps)]
    return v, theta


def assert_agrees_with_sixty_digits(order, steps, checked, controls, family="normal", limit=1e-8):
    v, theta = controls
    make = {"normal": rp.Normal, "uniform": rp.Uniform}[family]
    pred = rp.propagate(
        rp.dynamics.dubins(0.1),
        {"x": 1e5, "y": -1e5, "v": 10.0, "theta": 0.4},
        {"w_v": [make(*p) for p in v], "w_theta": [make(*p) for p in theta]},
        steps,
        order=order,
    )
    oracle = DubinsOracle(0.1, 10.0, 0.4, v, theta, order, family)
    for t in checked:
        mean, central = oracle.central(t)
        assert abs(complex(*pred.means[t, 0]) - complex(1e5 + mean.real, -1e5 + mean.imag)) < 2e-10
        for i, j in powers(order):
            if i + j > 1:
                assert pred.central_moments[t, 0, i, j] == pytest.approx(float(central[i, j]), rel=limit), (t, i, j)


def test_order_eight_agrees_with_sixty_digits_at_every_early_step():
    assert_agrees_with_sixty_digits(8, 8, [2, 3, 8], dubins_controls(8))


def test_order_four_agrees_with_sixty_digits_after_fifty_steps():
    assert_agrees_with_sixty_digits(4, 50, [2, 50], dubins_controls(50))


def test_tiny_and_one_sided_spreads_keep_their_digits():
    # without speed noise the car leaves its arc by 1e-4 of what it leaves sideways
    assert_agrees_with_sixty_digits(6, 6, [2, 6], dubins_controls(6, sd_v=0.0, sd_theta=1e-4))


def test_wide_spreads_keep_their_digits():
    assert_agrees_with_sixty_digits(6, 6, [2, 6], dubins_controls(6, sd_v=0.5, sd_theta=0.6))


def test_narrow_uniform_controls_keep_their_digits():
    v = [(-0.01, 0.03 + 0.01 * t) for t in range(6)]
    theta = [(0.01 * t - 1e-3, 0.01 * t + 2e-3) for t in range(6)]
    assert_agrees_with_sixty_digits(6, 6, [2, 3, 6], (v, theta), family="uniform")


def test_order_twelve_agrees_with_sixty_digits():
    assert_agrees_with_sixty_digits(12, 4, [2, 4], dubins_controls(4))


@pytest.mark.slow
def test_order_eight_agrees_with_sixty_digits_over_fifty_steps_far_from_the_origin():
    assert_agrees_with_sixty_digits(8, 50, [2, 10, 25, 50], dubins_controls(50))


def test_order_two_is_the_cut_of_order_eight():
    system, controls = SYSTEMS["dubins_lateral"]
    high = rp.propagate(system, start_of(system), controls, 10, order=8)
    low = rp.propagate(system, start_of(system), controls, 10, order=2)
    assert np.allclose(high.central_moments[:, :, :3, :3][..., 2, 0], low.central_moments[..., 2, 0], rtol=1e-12)
    assert np.allclose(high.covariances, low.covariances, rtol=1e-12, atol=1e-15)
    assert rp.propagate(system, start_of(system), controls, 10, order=12).order == 12


def paper_matrix(w_v, w_theta, second_row):
    """A_mom1 of Jasour et al. 2021, section V-C, for [x, y, v cos, v sin, cos, sin]."""
    c, s, m = rp.trigonometric_moment(w_theta, 1, 0), rp.trigonometric_moment(w_theta, 0, 1), w_v.mean
    return np.array(
        [
            [1, 0, 1, 0, 0, 0],
            second_row,
            [0, 0, c, -s, m * c, -m * s],
            [0, 0, s, c, m * s, m * c],
            [0, 0, 0, 0, c, -s],
            [0, 0, 0, 0, s, c],
        ]
    )


def paper_means(second_row, steps=6):
    w_v, w_theta = rp.Gamma(2.0, 0.1), rp.Beta(2.0, 5.0, -0.2, 0.4)
    state = np.array([0.0, 0.0, 5 * np.cos(0.3), 5 * np.sin(0.3), np.cos(0.3), np.sin(0.3)])
    out = [state[:2]]
    for _ in range(steps):
        state = paper_matrix(w_v, w_theta, second_row) @ state
        out.append(state[:2])
    pred = rp.propagate(rp.dynamics.dubins(1.0), [0.0, 0.0, 5.0, 0.3], {"w_v": w_v, "w_theta": w_theta}, steps, order=2)
    return np.array(out), pred.means[:, 0]


def test_means_follow_the_papers_first_order_system():
    by_matrix, ours = paper_means([0, 1, 0, 1, 0, 0])
    assert np.allclose(by_matrix, ours, rtol=1e-13, atol=1e-13)


def test_the_papers_second_row_is_a_misprint():
    # as printed, y would be fed by x: [1 0 0 1 0 0]
    by_matrix, ours = paper_means([1, 0, 0, 1, 0, 0])
    assert np.abs(by_matrix[2:, 1] - ours[2:, 1]).min() > 1.0
    assert np.allclose(by_matrix[:, 0], ours[:, 0], rtol=1e-13, atol=1e-13)


def test_declared_as_the_papers_augmented_linear_system_it_is_the_same():
    c, s = np.cos(0.3), np.sin(0.3)
    augmented = System(
        {
            "x": "x + dt*vc",
            "y": "y + dt*vs",
            "vc": "cos(w)*vc - sin(w)*vs + a*cos(w)*c - a*sin(w)*s",
            "vs": "sin(w)*vc + cos(w)*vs + a*sin(w)*c + a*cos(w)*s",
            "c": "cos(w)*c - sin(w)*s",
            "s": "sin(w)*c + cos(w)*s",
        },
        ("w", "a"),
        0.5,
    )
    one = rp.propagate(augmented, [0, 0, 5 * c, 5 * s, c, s], {"w": N(0.1, 0.2), "a": N(0.1, 0.5)}, 4, order=2)
    controls = {"w_v": N(0.1, 0.5), "w_theta": N(0.1, 0.2)}
    other = rp.propagate(rp.dynamics.dubins(0.5), [0, 0, 5.0, 0.3], controls, 4, order=2)
    assert np.allclose(one.means, other.means, rtol=1e-13)
    assert np.allclose(one.covariances, other.covariances, rtol=1e-10, atol=1e-13)


DECLARED = {
    "one noise that shifts and turns": (
        {"x": "x + dt*v*cos(th) + w", "y": "y + dt*v*sin(th) + w*cos(2*w)", "v": "0.9*v", "th": "th - w"},
        {"x": 0, "y": 0, "v": N(3, 1), "th": N(0, 0.2)},
        {"w": N(0.1, 0.3)},
    ),
    "two that read each other": (
        {"x": "x + dt*p", "y": "y + dt*q", "p": "0.9*p - 0.3*q + w", "q": "0.3*p + 0.9*q + u*p"},
        {"x": 0, "y": 0, "p": N(3, 1), "q": 0},
        {"w": N(0, 0.3), "u": rp.Uniform(-0.2, 0.4)},
    ),
    "quadrotor with drag": (
        {
            "x": "x + dt*a",
            "y": "y + dt*b",
            "a": "0.95*a - dt*f*sin(th)",
            "b": "0.95*b + dt*f*cos(th) - dt*9.81",
            "th": "th + w",
        },
        {"x": 0, "y": 0, "a": 1, "b": 0, "th": N(0, 0.1)},
        {"f": rp.Gamma(50, 0.2), "w": N(0, 0.1)},
    ),
    "one noise in speed and place": (
        {
            "x": "x + dt*(v + 0.5*dt*a)*cos(th + 0.5*w)",
            "y": "y + dt*(v + 0.5*dt*a)*sin(th + 0.5*w)",
            "v": "v + dt*a",
            "th": "th + w",
        },
        {"x": 0, "y": 0, "v": 5, "th": 0.4},
        {"a": rp.Exponential(0.8), "w": rp.Triangular(-0.4, 0, 0.2)},
    ),
    "angles that do not last": (
        {"x": "x + v*cos(th + be)", "y": "y + v*sin(th + be)", "v": "w", "th": "th + be", "be": "0.3*u + 0.1"},
        {"x": 0, "y": 0, "v": 1, "th": 0, "be": 0},
        {"w": rp.Beta(2, 3), "u": rp.Discrete([-1, 0, 2], [0.3, 0.4, 0.3])},
    ),
    "products and squares": (
        {"x": "x + p*p*q", "y": "y + q**2*cos(2*th)", "p": "0.8*p + w", "q": "q + u", "th": "th - 2*r"},
        {"x": 0, "y": 0, "p": 1, "q": 0.5, "th": 0.2},
        {"w": N(0, 0.3), "u": rp.Uniform(-0.1, 0.3), "r": N(0, 0.2)},
    ),
}


@pytest.mark.parametrize("name", DECLARED)
def test_declared_systems_against_their_own_simulation(name):
    updates, start, controls = DECLARED[name]
    agent = rp.ControlPrediction(System(updates, tuple(controls), 0.5), start, controls, 5)
    paths = np.swapaxes(agent.sample(200_000, np.random.default_rng(4)), 0, 1)
    assert_within_standard_errors(agent.moments(3), paths[1:], range(1, 6), 3)


def test_a_known_start_has_no_spread_not_even_a_negative_one():
    # E[x²] − E[x]² of a known start was −1e-13 in the code released with the paper
    pred = rp.propagate(*known_dubins(), 5, order=4)
    known = np.add.outer(range(5), range(5)) <= 4
    assert (pred.central_moments[:2, 0][:, known][:, 1:] == 0.0).all()
    assert (np.linalg.eigvalsh(pred.covariances[2:, 0]) > 0).all()


def known_dubins(x=1e3, y=2e3, heading=3.0, sd=0.1):
    return rp.dynamics.dubins(0.1), [x, y, 8.0, heading], {"w_v": N(0.1, 0.2), "w_theta": N(0.05, sd)}


def test_an_acceleration_enters_with_the_square_of_the_step():
    # v grows by a·dt and x by v·dt: the variance of x after two steps is (dt²)² var a
    dt, sd = 0.1, 0.7
    controls = {"w_v": N(0.0, sd * dt), "w_theta": 0.0}
    pred = rp.propagate(rp.dynamics.dubins(dt), [0, 0, 8.0, 0.0], controls, 2, order=2)
    assert pred.covariances[2, 0, 0, 0] == pytest.approx(dt**4 * sd**2, rel=1e-12)


@settings(max_examples=15, deadline=None)
@given(st.floats(-1e5, 1e5), st.floats(-1e5, 1e5))
def test_translation_moves_the_mean_and_nothing_else(x, y):
    here = rp.propagate(*known_dubins(0.0, 0.0), 10, order=6)
    there = rp.propagate(*known_dubins(x, y), 10, order=6)
    assert np.allclose(there.means, here.means + [x, y], rtol=0, atol=1e-9)
    assert np.array_equal(there.central_moments, here.central_moments, equal_nan=True)


@settings(max_examples=15, deadline=None)
@given(st.floats(-7, 7))
def test_rotation_turns_the_moments(angle):
    here = rp.propagate(*known_dubins(0.0, 0.0), 10, order=4)
    there = rp.propagate(*known_dubins(0.0, 0.0, heading=3.0 + angle), 10, order=4)
    c, s = np.cos(angle), np.sin(angle)
    r = np.array([[c, -s], [s, c]])
    assert np.allclose(there.means, here.means @ r.T, rtol=0, atol=1e-12)
    assert np.allclose(there.covariances, r @ here.covariances @ r.T, rtol=0, atol=1e-13)
    m = here.central_moments[-1, 0]
    fourth = sum(w * c ** (4 - k) * (-s) ** k * m[4 - k, k] for k, w in enumerate((1, 4, 6, 4, 1)))
    assert there.central_moments[-1, 0, 4, 0] == pytest.approx(fourth, rel=1e-11)


def test_a_full_turn_of_the_heading_changes_nothing():
    # headings are never unwrapped or compared, only waved
    here = rp.propagate(*known_dubins(heading=3.0), 10, order=4)
    there = rp.propagate(*known_dubins(heading=3.0 - 2 * np.pi), 10, order=4)
    assert np.allclose(there.means, here.means, rtol=0, atol=1e-10)
    assert np.allclose(there.central_moments, here.central_moments, rtol=1e-10, equal_nan=True)


def test_systems_without_noise_or_motion_are_systems():
    still = System({"x": "x", "y": "y"}, (), 1.0)
    pred = rp.propagate(still, {"x": N(1, 2), "y": 0}, {}, 3, order=4)
    assert pred.covariances[-1, 0].tolist() == [[4.0, 0.0], [0.0, 0.0]]
    moving = System({"x": "x + dt*v", "y": "2*y + 1", "v": "v"}, ("unused",), 1.0)
    pred = rp.propagate(moving, {"x": 0, "y": N(0, 1), "v": N(3, 1)}, {"unused": N(0, 1)}, 3, order=2)
    assert np.allclose(pred.means[-1, 0], [9.0, 7.0], rtol=1e-14)
    assert np.allclose(pred.covariances[-1, 0], [[9.0, 0.0], [0.0, 64.0]], rtol=1e-13)


def test_a_closed_circle_ends_in_certainty_or_says_what_rounding_took():
    # at any speed a full circle ends where it began: the spread of 2 m half-way leaves rounding noise at the end
    system = rp.dynamics.constant_turn(0.1, 2 * np.pi / 3)
    start = {"x": 1.0, "y": 2.0, "v": N(8.0, 1.0), "theta": 0.3}
    pred = rp.propagate(system, start, {"w_v": 0.0}, 30, order=2)
    assert np.allclose(pred.means[-1, 0], [1.0, 2.0], rtol=0, atol=1e-13)
    assert 0.0 < pred.covariances[-1].max() <= 1e-12  # known to the rounding of the spread half-way, no better
    assert pred.covariances[15, 0].max() > 0.5
    with pytest.raises(rp.InputError, match="moments: order 8 of the prediction is lost to rounding"):
        rp.propagate(system, start, {"w_v": 0.0}, 30, order=8)
    noisy = rp.propagate(system, start, {"w_v": N(0.0, 0.05)}, 30, order=8)
    assert noisy.order == 8


def test_a_heading_that_is_anywhere_leaves_no_direction():
    start = {"x": 0, "y": 0, "v": 8.0, "theta": rp.Uniform(-np.pi, np.pi)}
    pred = rp.propagate(rp.dynamics.dubins(0.1), start, {"w_v": 0.0, "w_theta": N(0, 0.3)}, 20, order=4)
    assert np.allclose(pred.means, 0.0, atol=1e-13)
    assert np.allclose(pred.covariances[-1, 0], pred.covariances[-1, 0, 0, 0] * np.eye(2), atol=1e-12)
    assert pred.central_moments[1, 0, 4, 0] == pytest.approx(0.8**4 * 3 / 8, rel=1e-12)


def test_a_joint_gaussian_start_is_carried():
    covariance = np.array([[0.5, 0.2, 0.1], [0.2, 0.4, -0.1], [0.1, -0.1, 0.3]])
    start = {("x", "y", "v"): rp.JointNormal([1.0, 2.0, 8.0], covariance), "theta": 0.0}
    pred = rp.propagate(rp.dynamics.dubins(0.5), start, {"w_v": 0.0, "w_theta": 0.0}, 4, order=4)
    flow = np.array([[1, 0, 2.0], [0, 1, 0]])
    expected = flow @ covariance @ flow.T
    assert np.allclose(pred.covariances[-1, 0], expected, rtol=1e-13)
    assert np.allclose(pred.means[-1, 0], [17.0, 2.0], rtol=1e-14)
    gaussian = rp.GaussianMixturePrediction([0.0], [1.0], pred.means[-1:], [[expected]]).moments(4)
    assert np.allclose(pred.central_moments[-1, 0], gaussian.central_moments[0, 0], rtol=1e-12, equal_nan=True)


def test_powers_stay_in_their_bits():
    """High harmonics raise powers beyond twice the order: they must not spill into another generator's bits."""
    system = System(
        {
            "th": "th",
            "ga": "th + 0.5*u",
            "y": "y + .9*sin(-.5*u) + .4*sin(th+ga-1.3)",
            "x": "x - 1.3*sin(2*th+2*ga-1.3) + .9*u - 1.3*cos(th-ga+.4)*w",
        },
        ("u", "w"),
        1.0,
    )
    noise = {"u": rp.Discrete([-0.6, 0.1, 0.8], [0.3, 0.4, 0.3]), "w": N(0.2, 0.3)}
    start = {"x": 0.0, "y": 0.0, "th": N(0.3, 0.2), "ga": -0.4}
    agent = rp.ControlPrediction(system, start, noise, 3)
    futures = agent.sample(200_000, np.random.default_rng(0))
    share = futures.var(axis=0) / agent.covariances[:, 0].diagonal(axis1=-2, axis2=-1).clip(1e-12)
    assert np.allclose(share[1:], 1.0, atol=0.03)
    wave = System({"x": "x + cos(4*th)", "y": "y", "th": "th + u"}, ("u",), 1.0)
    pred = rp.propagate(wave, {"x": 0, "y": 0, "th": N(0.1, 0.3)}, {"u": N(0, 0.1)}, 2, order=2)
    assert pred.means[1, 0, 0] == pytest.approx(np.cos(0.4) * np.exp(-0.5 * 16 * 0.09), rel=1e-12)


def test_a_small_spread_after_a_large_one_is_not_certainty():
    system = System({"x": "w", "y": "y"}, ("w",), 1.0)
    pred = rp.propagate(system, {"x": 0, "y": 0}, {"w": [N(0, 1e4), N(0, 1e-3)]}, 2, order=2)
    assert 1e-6 <= pred.covariances[-1, 0, 0, 0] <= 1e-4


def test_rules_do_not_grow_without_bound():
    for rule in ("x + ((((w+1)**8)**8)**8)**8", "x + " + "*".join(f"(a{i}+w)" for i in range(20))):
        names = [f"a{i}" for i in range(20)]
        rules = {"x": rule, "y": "y"} | {n: n for n in names}
        with pytest.raises(rp.InputError, match="expected at most 4096 terms in a product"):
            System(rules, ("w",), 1.0)


def test_scipy_scale_zero_and_shifted_values():
    from scipy import stats  # noqa: PLC0415

    assert rp.as_random_variable(stats.norm(0.3, 0.0)).mean == 0.3
    assert rp.as_random_variable(stats.norm(0.3, 0.0)).moment(2) == pytest.approx(0.09)
    shifted = stats.rv_discrete(values=([1, 2], [0.5, 0.5]))(loc=5)
    assert rp.as_random_variable(shifted).mean == pytest.approx(6.5)
