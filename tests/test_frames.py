"""Target-centred frames: where the past lies in them, and that the way back is the way there."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from checkers import GaussianMixturePrediction, InputError
from predictor.frames import STILL, Frames

angles = st.floats(-np.pi, np.pi)
coordinates = st.floats(-1e5, 1e5)


def paths(seed, n=5, steps=20, place=(0.0, 0.0)):
    """Tracks that wander about, but get somewhere."""
    rng = np.random.default_rng(seed)
    drift = 3.0 * np.exp(1j * rng.uniform(-np.pi, np.pi, n))
    walk = np.cumsum(rng.normal(0, 0.3, (n, steps, 2)), axis=1)
    return np.array(place) + walk + np.arange(steps)[None, :, None] * np.stack([drift.real, drift.imag], -1)[:, None]


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 1000), coordinates, coordinates, st.floats(0.1, 100))
def test_last_at_the_origin_first_on_the_negative_x_axis(seed, x, y, scale):
    past = paths(seed, place=(x, y))
    local = Frames.of(past, np.zeros(5), scale).to_local(past)
    np.testing.assert_allclose(local[:, -1], 0.0, atol=1e-12)
    np.testing.assert_allclose(local[:, 0, 1], 0.0, atol=1e-8 / scale)
    distance = np.hypot(*(past[:, -1] - past[:, 0]).T)
    np.testing.assert_allclose(local[:, 0, 0], -distance / scale, rtol=1e-9)


def test_standing_targets_take_the_recorded_heading():
    past = np.zeros((3, 20, 2))
    past[1, :, 0] = np.linspace(0, 0.9 * STILL, 20)
    past[2, :, 1] = np.linspace(0, 1.1 * STILL, 20)
    frames = Frames.of(past, [0.3, 2.0, -1.0])
    np.testing.assert_allclose(frames.angles, [0.3, 2.0, np.pi / 2])
    # the recorded heading is the x-axis: one metre ahead is (1, 0)
    ahead = past[:, -1] + np.stack([np.cos(frames.angles), np.sin(frames.angles)], -1)
    np.testing.assert_allclose(frames.to_local(ahead), [[1, 0]] * 3, atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 1000), coordinates, coordinates, st.floats(0.1, 100))
def test_there_and_back(seed, x, y, scale):
    past = paths(seed, place=(x, y))
    frames = Frames.of(past, np.zeros(5), scale)
    rng = np.random.default_rng(seed)
    points = rng.normal(0, 50, (5, 4, 7, 2)) + np.array([x, y])
    points[0, 0, 0] = np.nan
    np.testing.assert_allclose(frames.to_world(frames.to_local(points)), points, atol=1e-9)
    root = rng.normal(size=(5, 30, 3, 2, 2))
    covariances = root @ np.swapaxes(root, -1, -2)
    np.testing.assert_allclose(
        frames.covariances_to_world(frames.covariances_to_local(covariances)), covariances, atol=1e-9
    )


@pytest.mark.parametrize("scale", [0.5, 1.0, 10.0])
def test_covariances_are_those_of_transformed_points(scale):
    """By another road: the sample covariance of points taken to the world one by one."""
    past = paths(3)
    frames = Frames.of(past, np.zeros(5), scale)
    rng = np.random.default_rng(1)
    local = np.array([[2.0, 0.3], [0.0, 0.7]])
    points = rng.standard_normal((5, 4000, 2)) @ local.T
    expected = np.stack([np.cov(p.T) for p in frames.to_world(points)])
    of_local = np.stack([np.cov(p.T) for p in points])
    np.testing.assert_allclose(frames.covariances_to_world(of_local), expected, rtol=1e-9)


def test_factors_are_roots_of_the_covariances_they_make():
    frames = Frames.of(paths(4), np.zeros(5), 7.0)
    factors = np.random.default_rng(0).normal(size=(5, 30, 3, 2, 4))
    world = frames.factors_to_world(factors)
    np.testing.assert_allclose(
        world @ np.swapaxes(world, -1, -2),
        frames.covariances_to_world(factors @ np.swapaxes(factors, -1, -2)),
        rtol=1e-9,
    )


def test_a_prediction_made_in_the_frame_is_one_in_the_world():
    """Density at a point is that at its local image over scale²: what a wrong power of the scale would break."""
    scale = 10.0
    frames = Frames.of(paths(5, n=1, place=(1500.0, -800.0)), [0.0], scale)
    means, covariances = np.array([[[0.5, 0.1]]]), np.array([[[[0.04, 0.01], [0.01, 0.02]]]])
    world = GaussianMixturePrediction(
        [0.1], [1.0], frames.to_world(means), frames.covariances_to_world(covariances)[0][:, None]
    )
    point = frames.to_world(np.array([[[0.7, 0.0]]]))[0, 0]

    def log_density(x, mean, covariance):
        d = x - mean
        return -0.5 * d @ np.linalg.solve(covariance, d) - 0.5 * np.log(np.linalg.det(covariance))

    inside = log_density(np.array([0.7, 0.0]), means[0, 0], covariances[0, 0])
    outside = log_density(point, world.means[0, 0], world.covariances[0, 0])
    assert outside == pytest.approx(inside - 2 * np.log(scale), abs=1e-9)


@given(angles, angles)
def test_headings(heading, angle):
    frames = Frames([[0.0, 0.0]], [angle])
    local = frames.headings_to_local([[heading]])
    assert np.exp(1j * (local[0, 0] + angle)) == pytest.approx(np.exp(1j * heading), abs=1e-9)
    assert -np.pi <= local[0, 0] <= np.pi


def test_bad_input():
    with pytest.raises(InputError, match=r"^past\[0, 1, 0\]: expected a finite number"):
        Frames.of([[[0.0, 0.0], [np.nan, 0.0]]], [0.0])
    with pytest.raises(InputError, match=r"^scale"):
        Frames([[0.0, 0.0]], [0.0], 0.0)
    with pytest.raises(InputError, match=r"^headings: expected shape \(1,\)"):
        Frames.of(np.zeros((1, 2, 2)), [0.0, 1.0])
