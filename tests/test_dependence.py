"""Factors: validated, kept by every way a prediction goes, sampled once, fitted from residuals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from builders import mixture

from checkers import (
    GaussianMixturePrediction,
    InputError,
    MomentPrediction,
    fit_factors,
    leading_factors,
    load_prediction,
    persistent,
)
from riskplan.packing import on_grid


def carried(steps=4, modes=3, rank=2, seed=0, share=0.6):
    """A mixture of which `share` of the covariance persists."""
    pred = mixture(np.random.default_rng(seed), steps, modes)
    factors = np.sqrt(share) * np.linalg.cholesky(pred.covariances)[..., :rank]
    return GaussianMixturePrediction(pred.times, pred.weights, pred.means, pred.covariances, factors=factors)


def test_factors_come_back_from_a_file(tmp_path):
    for pred in (carried(), carried().moments(4)):
        pred.save(tmp_path / "a.npz")
        back = load_prediction(tmp_path / "a.npz")
        assert type(back) is type(pred)
        np.testing.assert_array_equal(back.factors, pred.factors)
        assert not back.factors.flags.writeable
    assert carried().moments(4).moments(2).factors is not None


def test_resampling_keeps_factors_and_what_ξ_says_alone():  # noqa: PLC2401
    pred = carried(share=1.0)
    np.testing.assert_array_equal(pred.at(pred.times[1:3]).factors, pred.factors[1:3])
    middle = 0.25 * pred.times[:-1] + 0.75 * pred.times[1:]
    part = pred.at(middle)
    np.testing.assert_allclose(part.factors, 0.25 * pred.factors[:-1] + 0.75 * pred.factors[1:], rtol=1e-14)
    shared = part.factors @ np.swapaxes(part.factors, -1, -2)
    np.testing.assert_allclose(part.covariances, shared, rtol=1e-12, atol=1e-14)
    moments = pred.moments(2).at(middle)  # linear in the moments: some spread beside ξ, never less than none
    rest = moments.covariances - moments.factors @ np.swapaxes(moments.factors, -1, -2)
    assert np.linalg.eigvalsh(rest).min() >= -1e-12


def test_the_grid_of_a_plan_keeps_factors():
    """It begins at 0; a prediction that begins later is kept from there on, and one that lasts longer is cut."""
    pred = carried()
    assert on_grid(pred, np.concatenate([[0.0], pred.times])) is pred
    np.testing.assert_array_equal(on_grid(pred, pred.times[:3]).factors, pred.factors[:3])
    middle = 0.5 * (pred.times[:-1] + pred.times[1:])
    np.testing.assert_allclose(on_grid(pred, middle).means, 0.5 * (pred.means[:-1] + pred.means[1:]), rtol=1e-14)


@pytest.mark.parametrize("modes", [1, 3])
def test_samples_have_the_covariance_over_time(modes):
    pred = carried(3, modes, seed=4)
    if modes > 1:  # one mode of weight 1 among others
        pred = GaussianMixturePrediction(
            pred.times, [0.0, 1.0, 0.0], pred.means, pred.covariances, factors=pred.factors
        )
    k = 0 if modes == 1 else 1
    n = 200_000
    away = (pred.sample(n, np.random.default_rng(1)) - pred.means[:, k]).reshape(n, -1)
    flat = pred.factors[:, k].reshape(6, -1)
    expected = flat @ flat.T
    for t in range(3):
        expected[2 * t : 2 * t + 2, 2 * t : 2 * t + 2] = pred.covariances[t, k]
    error = np.sqrt((np.outer(np.diag(expected), np.diag(expected)) + expected**2) / n)
    assert (np.abs(away.T @ away / n - expected) <= 5 * error).all()


def test_leading_factors_of_a_trajectory_covariance():
    root = np.random.default_rng(2).normal(size=(10, 10))
    full = root @ root.T
    for rank in (1, 2, 5, 10):
        factors, covariances = leading_factors(full, rank)
        assert factors.shape == (5, 2, rank)
        for t in range(5):
            np.testing.assert_allclose(covariances[t], full[2 * t : 2 * t + 2, 2 * t : 2 * t + 2], rtol=1e-9)
        flat = factors.reshape(10, rank)
        rest = np.linalg.eigvalsh(full - flat @ flat.T)
        assert rest.min() >= -1e-9 * rest.max() - 1e-9
        assert np.linalg.norm(full - flat @ flat.T, 2) == pytest.approx(
            np.sort(np.linalg.eigvalsh(full))[::-1][rank] if rank < 10 else 0.0, abs=1e-9
        )
        GaussianMixturePrediction(
            np.arange(5.0), [1.0], np.zeros((5, 1, 2)), covariances[:, None], factors=factors[:, None]
        )


def test_fit_finds_what_persists():
    rng = np.random.default_rng(3)
    factors = rng.normal(size=(6, 2, 2))
    residuals = np.einsum("tir,nr->nti", factors, rng.standard_normal((50_000, 2)))
    found, covariances = fit_factors(residuals, 2)
    expected = factors.reshape(12, 2) @ factors.reshape(12, 2).T
    np.testing.assert_allclose(
        found.reshape(12, 2) @ found.reshape(12, 2).T, expected, atol=0.05 * np.abs(expected).max()
    )
    np.testing.assert_allclose(covariances, found @ np.swapaxes(found, -1, -2), atol=1e-9)


@pytest.mark.parametrize(
    ("factors", "message"),
    [
        (np.ones((4, 3, 2)), r"factors: expected shape \(4, 3, 2, R\)"),
        (np.full((4, 3, 2, 2), np.nan), r"factors\[0, 0, 0, 0\]: expected a finite number"),
        (np.full((4, 3, 2, 1), 9.0), r"factors\[0, 0\]: expected factors @ factors.T of at most the covariance"),
    ],
)
def test_bad_factors(factors, message):
    pred = mixture(np.random.default_rng(0))
    with pytest.raises(InputError, match=message):
        GaussianMixturePrediction(pred.times, pred.weights, pred.means, pred.covariances, factors=factors)
    moments = pred.moments(2)
    with pytest.raises(InputError, match=message):
        MomentPrediction(pred.times, pred.weights, pred.means, moments.central_moments, factors=factors)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: leading_factors(np.eye(3), 1), r"covariance: expected shape \(2T, 2T\)"),
        (lambda: leading_factors(-np.eye(4), 1), "covariance: expected a symmetric positive"),
        (lambda: leading_factors(np.eye(4), 5), "rank: expected an integer from 1 to 4, got 5"),
        (lambda: leading_factors(np.eye(4), True), "rank: expected an integer"),
        (lambda: fit_factors(np.zeros((1, 3, 2)), 1), "residuals: expected at least 2"),
        (lambda: fit_factors(np.zeros((5, 3)), 1), "residuals: expected shape"),
    ],
)
def test_bad_fit(call, message):
    with pytest.raises(InputError, match=message):
        call()


def test_persistent_keeps_the_marginals_and_leaves_no_rest():
    rng = np.random.default_rng(0)
    roots = rng.normal(size=(4, 2, 2, 2))
    roots[0, 0] = 0.0  # known at the start
    roots[1, 1, :, 0] = 0.0  # and a line
    covariances = roots @ np.swapaxes(roots, -1, -2)
    headings = rng.uniform(-3, 3, (4, 2))
    pred = GaussianMixturePrediction(
        [0.0, 1.0, 2.0, 3.0], [0.4, 0.6], rng.normal(size=(4, 2, 2)), covariances, headings=headings
    )
    lasting = persistent(pred)
    np.testing.assert_allclose(lasting.covariances, covariances, atol=1e-12)
    np.testing.assert_allclose(lasting.factors @ np.swapaxes(lasting.factors, -1, -2), lasting.covariances, atol=1e-15)
    ahead = np.stack([np.cos(headings), np.sin(headings)], axis=-1)
    assert np.abs((lasting.factors[..., 1] * ahead).sum(axis=-1)).max() < 1e-12  # the second moves aside only
    still = persistent(GaussianMixturePrediction([0.0, 1.0], [1.0], np.zeros((2, 1, 2)), [[np.diag([4.0, 1.0])]] * 2))
    assert still.headings is None
    np.testing.assert_allclose(still.factors[0, 0], np.diag([2.0, 1.0]))
    moving = persistent(replace(pred, headings=None))
    assert moving.headings is not None
    np.testing.assert_allclose(moving.covariances, covariances, atol=1e-12)
