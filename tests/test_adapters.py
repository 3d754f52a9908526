"""Other models' outputs: what they mean as mixtures, checked with densities written down here again."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import riskplan as rp
from checkers import InputError
from predictor.frames import Frames
from predictor.growth import directions

T, K = 12, 3
TIMES = np.arange(1, T + 1) * 0.1


def raw(seed=0, modes=K):
    rng = np.random.default_rng(seed)
    paths = np.cumsum(rng.normal(0.5, 0.2, (T, modes, 2)), axis=0)
    return (
        np.broadcast_to(rng.normal(size=modes), (T, modes)),
        paths,
        rng.normal(-0.5, 0.3, (T, modes, 2)),
        rng.uniform(-0.9, 0.9, (T, modes)),
    )


def density(x, log_pis, mus, log_sigmas, corrs):
    """Of one step's bivariate mixture in the textbook form of standard deviations and a correlation."""
    total, weights = 0.0, np.exp(log_pis) / np.exp(log_pis).sum()
    for w, mu, (sx, sy), rho in zip(weights, mus, np.exp(log_sigmas), corrs, strict=True):
        u, v = (x - mu) / (sx, sy)
        z = u**2 - 2 * rho * u * v + v**2
        total += w * np.exp(-z / (2 * (1 - rho**2))) / (2 * np.pi * sx * sy * np.sqrt(1 - rho**2))
    return total


def mixture_density(pred, t, x):
    d = x - pred.means[t]
    inverse = np.linalg.inv(pred.covariances[t])
    z = np.einsum("ki,kij,kj->k", d, inverse, d)
    return np.sum(pred.step_weights[t] * np.exp(-z / 2) / (2 * np.pi * np.sqrt(np.linalg.det(pred.covariances[t]))))


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 6))
def test_gmm2d_is_the_density_of_trajectron(seed, modes):
    values = raw(seed, modes)
    pred = rp.from_gmm2d(*values, TIMES, name="bus", length=12.0, width=2.5)
    assert (pred.name, pred.length, pred.width, pred.modes) == ("bus", 12.0, 2.5, "persistent")
    for t in (0, T - 1):
        x = values[1][t, 0] + [0.3, -0.2]
        assert mixture_density(pred, t, x) == pytest.approx(density(x, *(v[t] for v in values)), rel=1e-9)


def test_gmm2d_in_the_shapes_it_comes_in():
    log_pis, mus, log_sigmas, corrs = raw()
    expected = rp.from_gmm2d(log_pis, mus, log_sigmas, corrs, TIMES)
    flat = [v.reshape(1, 1, T, -1) for v in (log_pis, mus, log_sigmas, corrs)]
    batch = [v[None, None] for v in (log_pis, mus, log_sigmas, corrs)]
    once = [log_pis[0][None, None, None], mus, log_sigmas, corrs]
    lists = [v.tolist() for v in (log_pis[0], mus, log_sigmas, corrs)]
    shifted = [log_pis + 7.0, mus, log_sigmas, corrs]
    for given_ in (flat, batch, once, lists, shifted):
        got = rp.from_gmm2d(*given_, TIMES)
        np.testing.assert_allclose(got.weights, expected.weights, rtol=1e-12)
        np.testing.assert_array_equal(got.means, expected.means)
        np.testing.assert_array_equal(got.covariances, expected.covariances)


@pytest.mark.parametrize("shape", [(T, 2), (T, 1, 2), (1, 1, T, 2)])
def test_gmm2d_of_one_mode(shape):
    _, mus, log_sigmas, corrs = raw(modes=1)
    pred = rp.from_gmm2d([0.0], mus.reshape(shape), log_sigmas.reshape(shape), corrs, TIMES)
    np.testing.assert_array_equal(pred.means, mus)


def test_gmm2d_modes_of_each_step():
    log_pis, mus, log_sigmas, corrs = raw()
    moving = log_pis + np.linspace(0, 1, T)[:, None] * [1.0, 0.0, -1.0]
    with pytest.raises(InputError, match=r"^weights\[\d+\]: persistent modes have one weight each.*modes='per_step'"):
        rp.from_gmm2d(moving, mus, log_sigmas, corrs, TIMES)
    pred = rp.from_gmm2d(moving, mus, log_sigmas, corrs, TIMES, modes="per_step")
    np.testing.assert_allclose(pred.weights, np.exp(moving) / np.exp(moving).sum(axis=1, keepdims=True))


def test_torch_tensors_are_taken_as_they_are():
    torch = pytest.importorskip("torch", reason="needs the extra predictor")
    values = raw()
    tensors = [torch.tensor(np.array(v), dtype=torch.float32, requires_grad=True) for v in values]
    pred = rp.from_gmm2d(*tensors, TIMES)
    np.testing.assert_allclose(pred.means, values[1], rtol=1e-6)
    np.testing.assert_allclose(pred.covariances, rp.from_gmm2d(*values, TIMES).covariances, rtol=1e-5, atol=1e-7)


def test_what_is_no_gmm2d():
    log_pis, mus, log_sigmas, corrs = raw()
    full = corrs.copy()
    full[3, 1] = -1.0
    cases = [
        ((log_pis, mus[:-1], log_sigmas, corrs), r"^mus: expected shape \(12, 3, 2\), got \(11, 3, 2\)"),
        ((log_pis, mus, log_sigmas, full), r"^correlation\[3, 1\]: expected a number in \(-1, 1\), got -1"),
        ((log_pis, mus, log_sigmas + 99, corrs), r"^log_sigmas\[0, 0, 0\]: expected a size of at most 20"),
        ((log_pis[:, :2], mus, log_sigmas, corrs), r"^log_pis: expected shape \(12, 3\), got \(12, 2\)"),
        ((log_pis, mus * np.nan, log_sigmas, corrs), r"^mus\[0, 0, 0\]: expected a finite number"),
        ((log_pis, np.stack([mus] * 2), log_sigmas, corrs), r"^mus: expected shape \(12, 3, 2\), got \(2, 12, 3, 2\)"),
        ((log_pis, [["x"]], log_sigmas, corrs), r"^mus: expected an array of numbers, got list"),
        ((log_pis, mus, log_sigmas, corrs[:5]), r"^corrs: expected shape \(12, K\), got \(5, 3\)"),
    ]
    for values, message in cases:
        with pytest.raises(InputError, match=message):
            rp.from_gmm2d(*values, TIMES)
    with pytest.raises(InputError, match=r"^colour: expected one of name, length, width, headings"):
        rp.from_gmm2d(*raw(), TIMES, colour="red")


# a Gaussian a step and mode


def tensor(seed=0, log=True):
    _, mus, log_sigmas, corrs = raw(seed)
    spread = log_sigmas if log else np.exp(log_sigmas)
    values = np.concatenate([mus, spread, corrs[..., None], np.full((T, K, 2), 99.0)], axis=-1)
    return np.array([0.5, 0.3, 0.2]), np.swapaxes(values, 0, 1)


def test_both_spreads_are_the_mixture_of_gmm2d():
    log_pis = np.log([0.5, 0.3, 0.2])
    expected = rp.from_gmm2d(log_pis, *raw()[1:], TIMES)
    for log, spread in ((True, "log_sigma"), (False, "sigma")):
        pred = rp.from_mode_gaussians(*tensor(log=log), TIMES, spread=spread)
        np.testing.assert_allclose(pred.weights, expected.weights)
        np.testing.assert_array_equal(pred.means, expected.means)
        np.testing.assert_allclose(pred.covariances, expected.covariances, rtol=1e-12)
        batch = [v[None] for v in tensor(log=log)]
        np.testing.assert_array_equal(rp.from_mode_gaussians(*batch, TIMES, spread=spread).means, pred.means)


def test_limits_of_mtr():
    """As its loss reads raw outputs: the logarithm of sigma within (−1.609, 5), correlations within ±0.5."""
    _, values = tensor()
    values = values[:1, :, :5].copy()
    values[0, :, 2:] = (-4.0, 6.0, 0.8)
    pred = rp.from_mode_gaussians(
        [1.0], values, TIMES, spread="log_sigma", log_sigma_range=(-1.609, 5.0), largest_corr=0.5
    )
    sx, sy = np.exp(-1.609), np.exp(5.0)
    np.testing.assert_allclose(pred.covariances[0, 0], [[sx**2, 0.5 * sx * sy], [0.5 * sx * sy, sy**2]])


def test_few_modes_of_many():
    scores, values = tensor()
    with pytest.raises(InputError, match=r"^weights: expected weights that sum to 1, got a sum of 0.5"):
        rp.from_mode_gaussians(scores / 2, values, TIMES, spread="log_sigma")
    pred = rp.from_mode_gaussians(scores / 2, values, TIMES, spread="log_sigma", normalise=True)
    np.testing.assert_allclose(pred.weights, scores)
    with pytest.raises(InputError, match=r"^probabilities: expected numbers >= 0, not all 0"):
        rp.from_mode_gaussians([0, 0, 0], values, TIMES, spread="log_sigma", normalise=True)


def test_what_is_no_mode_tensor():
    scores, values = tensor(log=False)
    with pytest.raises(TypeError, match="spread"):
        rp.from_mode_gaussians(scores, values, TIMES)
    with pytest.raises(InputError, match=r"^spread: expected one of sigma, log_sigma; got 'variance'"):
        rp.from_mode_gaussians(scores, values, TIMES, spread="variance")
    values[1, 2, 3] = 0.0
    with pytest.raises(InputError, match=r"^trajectories\[1, 2, 3\]: expected sigma > 0, got 0"):
        rp.from_mode_gaussians(scores, values, TIMES, spread="sigma")
    with pytest.raises(InputError, match=r"^trajectories: expected shape \(K, 12, 5\), got \(3, 12, 4\)"):
        rp.from_mode_gaussians(scores, values[..., :4], TIMES, spread="sigma")
    with pytest.raises(InputError, match=r"^probabilities: expected shape \(3,\), got \(2,\)"):
        rp.from_mode_gaussians(scores[:2], np.abs(values) + 0.1, TIMES, spread="sigma", largest_corr=0.9)


# frames


def test_a_models_own_frame_is_undone():
    frame = Frames([[1500.0, -700.0]], [2.0], 5.0)
    values = raw()
    local = rp.from_gmm2d(*values, TIMES, headings=np.zeros((T, K)))
    world = rp.from_gmm2d(*values, TIMES, headings=np.zeros((T, K)), frame=frame)
    np.testing.assert_allclose(world.means, frame.to_world(local.means[None])[0])
    np.testing.assert_allclose(np.linalg.det(world.covariances), 5.0**4 * np.linalg.det(local.covariances))
    np.testing.assert_allclose(world.headings, 2.0)
    with pytest.raises(InputError, match=r"^frame: expected the frame of one target, got 2"):
        rp.from_gmm2d(*values, TIMES, frame=Frames(np.zeros((2, 2)), np.zeros(2)))


# trajectories without a spread

GROWTH = rp.PowerGrowth(along=(0.2, 0.8, 1.2), across=(0.1, 0.3, 0.9))


def fans(n, rng, times=TIMES, modes=K):
    """Predictions (n, K, T, 2) that fan out, their probabilities, and the first direction of each."""
    heading = rng.uniform(-np.pi, np.pi, (n, 1, 1)) + np.linspace(-0.5, 0.5, modes)[None, :, None] * times
    speed = rng.uniform(3, 12, (n, 1, 1))
    step = np.diff(times, prepend=0.0)
    way = speed * np.stack([np.cos(heading), np.sin(heading)]) * step
    return np.moveaxis(np.cumsum(way, axis=-1), 0, -1), rng.dirichlet(np.full(modes, 2.0), n)


def drawn(growth, paths, weights, rng, times=TIMES, steps=None):
    """Truth (n, T, 2): a mode by its probability, and an error about it as `growth` says, drawn anew `steps` times."""
    mode = np.array([rng.choice(len(w), p=w) for w in weights])
    chosen = paths[np.arange(len(paths)), mode]
    velocity = np.gradient(chosen, times, axis=1)
    ahead = velocity / np.hypot(*np.moveaxis(velocity, -1, 0))[..., None]
    left = np.stack([-ahead[..., 1], ahead[..., 0]], -1)
    along, across = (s + 0 * times for s in np.sqrt(growth.variances(times)).T)
    noise = rng.standard_normal((len(paths), steps or len(times), 2))
    return chosen + ahead * (noise[..., :1] * along[:, None]) + left * (noise[..., 1:] * across[:, None])


def test_trajectories_need_a_spread():
    paths, weights = fans(1, np.random.default_rng(0))
    with pytest.raises(TypeError, match="growth"):
        rp.from_trajectories(weights[0], paths[0], TIMES)
    with pytest.raises(InputError, match=r"^growth: expected a model of the spread such as PowerGrowth, got float"):
        rp.from_trajectories(weights[0], paths[0], TIMES, 1.0)


def test_the_spread_lies_along_each_trajectory():
    times = np.linspace(0.5, 6.0, 12)
    angle = 0.4 * times
    circle = 20 * np.column_stack([np.sin(angle), 1 - np.cos(angle)])
    pred = rp.from_trajectories([1.0], circle[None], times, GROWTH)
    for t in range(2, 10):
        direction = np.array([np.cos(angle[t]), np.sin(angle[t])])
        values, vectors = np.linalg.eigh(pred.covariances[t, 0])
        assert abs(vectors[:, 1] @ direction) > 0.999
        np.testing.assert_allclose(
            np.sqrt(values), [np.hypot(0.1, 0.3 * times[t] ** 0.9), np.hypot(0.2, 0.8 * times[t] ** 1.2)], rtol=1e-9
        )


def test_who_stands_is_uncertain_on_every_side():
    pred = rp.from_trajectories([1.0], np.zeros((1, T, 2)), TIMES, GROWTH)
    wide = np.hypot(0.2, 0.8 * TIMES**1.2) ** 2
    np.testing.assert_allclose(pred.covariances[:, 0], wide[:, None, None] * np.eye(2), atol=1e-12)
    only = rp.from_trajectories([1.0], np.ones((1, 1, 2)), [2.0], GROWTH)
    np.testing.assert_allclose(only.covariances[0, 0], np.hypot(0.2, 0.8 * 2**1.2) ** 2 * np.eye(2))


def test_a_fitted_spread_is_the_one_the_truth_was_drawn_with():
    rng = np.random.default_rng(1)
    times = np.linspace(0.5, 6.0, 12)
    paths, weights = fans(1000, rng, times)
    truth = drawn(GROWTH, paths, weights, rng, times)
    truth[::7, 8:] = np.nan
    fitted = rp.PowerGrowth.fit(times, paths, weights, truth)
    np.testing.assert_allclose(np.sqrt(fitted.variances(times)), np.sqrt(GROWTH.variances(times)), rtol=0.06)


def test_a_fitted_spread_is_calibrated():
    """A 90 % region of the mixture, by density, holds 90 % of futures not fitted on."""
    rng = np.random.default_rng(2)
    paths, weights = fans(1000, rng)
    truth = drawn(GROWTH, paths, weights, rng)
    fitted = rp.PowerGrowth.fit(TIMES, paths[:500], weights[:500], truth[:500])
    inside = []
    for path, w, real in zip(paths[500:], weights[500:], truth[500:], strict=True):
        pred = rp.from_trajectories(w, path, TIMES, fitted)
        t = T - 1
        own = [mixture_density(pred, t, x) for x in pred.sample(100, rng)[:, t]]
        inside.append(np.mean(np.array(own) < mixture_density(pred, t, real[t])) > 0.1)
    assert np.mean(inside) == pytest.approx(0.9, abs=3 * np.sqrt(0.09 / 500))


def test_judging_the_best_alone_would_promise_too_much():
    """What the fit does instead: the spread about the nearest of many trajectories is not that of the truth."""
    rng = np.random.default_rng(3)
    paths, weights = fans(1200, rng, modes=15)
    truth = drawn(GROWTH, paths, weights, rng, steps=1)
    best = np.linalg.norm(paths - truth[:, None], axis=-1).mean(axis=-1).argmin(axis=1)
    nearest = rp.PowerGrowth.fit(TIMES, paths[np.arange(1200), best][:, None], np.ones((1200, 1)), truth)
    honest = rp.PowerGrowth.fit(TIMES, paths, weights, truth)
    truly = GROWTH.variances(TIMES)[-1, 1]
    assert honest.variances(TIMES)[-1, 1] == pytest.approx(truly, rel=0.15)
    assert nearest.variances(TIMES)[-1, 1] < 0.7 * truly


def test_slopes_are_those_of_the_variances():
    x = np.log([0.2, 0.8, 1.2, 0.1, 0.3, 0.9])
    times = np.array([0.0, 0.1, 1.0, 3.0])

    def variances(x):
        return rp.PowerGrowth(tuple(np.exp(x[:3])), tuple(np.exp(x[3:]))).variances(times)

    slopes = rp.PowerGrowth(tuple(np.exp(x[:3])), tuple(np.exp(x[3:]))).slopes(times)
    for axis in range(2):
        for i in range(3):
            step = np.zeros(6)
            step[3 * axis + i] = 1e-6
            numeric = (variances(x + step) - variances(x - step))[:, axis] / 2e-6
            np.testing.assert_allclose(slopes[:, axis, i], numeric, atol=1e-8)


def test_growth_is_checked():
    with pytest.raises(InputError, match=r"^along: expected start, rate, power >= 0, not both first 0"):
        rp.PowerGrowth(along=(0.0, 0.0, 1.0), across=(0.1, 0.1, 1.0))
    with pytest.raises(InputError, match=r"^across: expected shape \(3,\)"):
        rp.PowerGrowth(along=(0.1, 0.1, 1.0), across=(0.1, 0.1))
    with pytest.raises(InputError, match=r"^times\[0\]: expected a time >= 0"):
        GROWTH.covariances([-1.0, 1.0], np.zeros((1, 2, 2)))
    paths, weights = fans(4, np.random.default_rng(0))
    with pytest.raises(InputError, match=r"^truth: expected recorded positions, got none"):
        rp.PowerGrowth.fit(TIMES, paths, weights, np.full((4, T, 2), np.nan))
    with pytest.raises(InputError, match=r"^probabilities: expected numbers >= 0 that sum to 1"):
        rp.PowerGrowth.fit(TIMES, paths, weights / 2, np.zeros((4, T, 2)))


def test_directions_are_rotations():
    paths, _ = fans(20, np.random.default_rng(5))
    frames, moving = directions(TIMES, paths.reshape(-1, T, 2))
    assert moving.all()
    np.testing.assert_allclose(np.linalg.det(frames), 1.0)
    np.testing.assert_allclose(
        frames @ np.swapaxes(frames, -1, -2), np.broadcast_to(np.eye(2), frames.shape), atol=1e-12
    )


def test_adapted_predictions_have_a_risk():
    pred = rp.from_gmm2d(*raw(), TIMES, length=4.5, width=1.8)
    ego = rp.EgoEllipsoid.around(4.5, 1.8, 4.5, 1.8)
    poses = np.column_stack([pred.means[:, 0], np.zeros(T)])
    risk = rp.checker("exact")(poses, pred, ego)
    assert np.all((risk.value > 0) & (risk.value <= 1))
