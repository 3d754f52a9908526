"""Manoeuvres: what they compute, what they may see, symmetry, likelihood by other mathematics, calibration."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from test_baseline import track

from checkers import InputError
from predictor import Manoeuvres, Track
from predictor.constant_velocity import Situation
from predictor.lanes import Lane
from predictor.manoeuvres import EVEN, EVEN_OF_PAST, ODD, ODD_OF_PAST, Mixture, situation_features
from predictor.surroundings import look_around

GRID = np.arange(31) * 0.1


def lane(name, y, successors=(), bend=0.0, x=(-50.0, 300.0)):
    """Along x at lateral position y, from x = 0 on with curvature `bend` (small angles)."""
    xs = np.linspace(*x, 141)
    ys = y + 0.5 * bend * np.maximum(xs, 0.0) ** 2
    line = np.column_stack([xs, ys])
    return Lane(name, line, line + [0, 1.75], line - [0, 1.75], successors)


def car(x, y, speed=10.0, heading=0.0, name="other", times=(0.0,), length=4.5):
    times = np.asarray(times, dtype=float)
    positions = np.column_stack([x + speed * (times - times[-1]) * np.cos(heading), np.full(len(times), float(y))])
    return Track(name, times, positions, np.full(len(times), heading), np.full(len(times), speed), length, 1.8)


def mean_and_spread(pred, past):
    c, s = np.cos(past.headings[-1]), np.sin(past.headings[-1])
    frame = np.array([[c, -s], [s, c]])
    means = (pred.means - past.positions[-1]) @ frame
    mean = np.einsum("k,tki->ti", pred.weights, means)
    local = np.einsum("ji,tkjl,lm->tkim", frame, pred.covariances, frame)
    inner = np.einsum("k,tkij->tij", pred.weights, local)
    away = means - mean[:, None]
    return mean, inner + np.einsum("k,tki,tkj->tij", pred.weights, away, away)


PAST = np.arange(31) * 0.1


def test_what_a_leader_does_to_the_one_behind():
    model, past = Manoeuvres.fitted(), car(0.0, 0.0, 12.0, times=PAST)
    now = [3.0]
    alone, _ = mean_and_spread(model.predict(past, GRID), past)
    braking, _ = mean_and_spread(model.predict(past, GRID, others=[car(14.0, 0.0, 6.0, times=now)]), past)
    aside, _ = mean_and_spread(model.predict(past, GRID, others=[car(14.0, 30.0, 6.0, times=now)]), past)
    assert braking[-1, 0] < alone[-1, 0] - 2.0
    np.testing.assert_array_equal(aside, alone)
    # one that was last seen at another time is not there
    gone, _ = mean_and_spread(model.predict(past, GRID, others=[car(14.0, 0.0, 6.0, times=[2.9])]), past)
    np.testing.assert_array_equal(gone, alone)


def test_it_follows_its_lane_and_comes_back_to_its_centre():
    model = Manoeuvres.fitted()
    past = car(0.0, 0.0, 12.0, times=PAST)
    straight, _ = mean_and_spread(model.predict(past, GRID, [lane("a", 0.0)]), past)
    bent, _ = mean_and_spread(model.predict(past, GRID, [lane("a", 0.0, bend=0.004)]), past)
    assert bent[-1, 1] > straight[-1, 1] + 0.5
    beside, _ = mean_and_spread(model.predict(past, GRID, [lane("a", 0.8)]), past)
    assert beside[-1, 1] > 0.01


def test_left_and_right_are_alike():
    model = Manoeuvres.fitted()
    past = car(0.0, 0.4, 12.0, times=PAST)
    others = [car(12.0, 0.3, 8.0, times=[3.0]), car(2.0, 3.6, 12.0, times=[3.0], name="beside")]
    lanes = [lane("a", 0.0, bend=0.002), lane("b", 3.5, bend=0.002)]
    mirrored_lanes = [
        replace(a, centre=a.centre * [1, -1], left=a.right * [1, -1], right=a.left * [1, -1]) for a in lanes
    ]

    def mirror(t):
        return replace(t, positions=t.positions * [1, -1], headings=-t.headings)

    here = model.predict(past, GRID, lanes, others)
    there = model.predict(mirror(past), GRID, mirrored_lanes, [mirror(o) for o in others])
    np.testing.assert_allclose(there.weights, here.weights, rtol=1e-9)
    np.testing.assert_allclose(there.means * [1, -1], here.means, atol=1e-7)
    np.testing.assert_allclose(there.headings, -here.headings, atol=1e-9)
    np.testing.assert_allclose(there.covariances * [[1, -1], [-1, 1]], here.covariances, atol=1e-7)


@pytest.mark.parametrize("seconds", [0.0, 3.0])
@pytest.mark.parametrize("speed", [0.0, 0.4, 6.0, 40.0])
def test_errors_persist_and_grow(speed, seconds):
    past = track(speed=speed, heading=2.0).until(seconds)
    pred = Manoeuvres.fitted().predict(past, GRID)
    assert pred.modes == "persistent"
    assert pred.weights.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(pred.factors @ np.swapaxes(pred.factors, -1, -2), pred.covariances, atol=1e-12)
    _, spread = mean_and_spread(pred, past)
    assert (np.diff(np.linalg.eigvalsh(spread)[:, 0]) > -1e-9).all()
    assert np.linalg.eigvalsh(pred.covariances).min() > 1e-4
    np.testing.assert_allclose(pred.means[0], past.positions[-1] + 0.0 * pred.means[0], atol=1e-9)
    assert (pred.name, pred.length, pred.width) == ("a", 4.5, 1.8)


def test_translation_and_rotation_change_nothing():
    model = Manoeuvres.fitted()
    near = track(heading=0.3).until(3.0)
    far = replace(near, positions=near.positions + [1e5, -1e5])
    a, b = model.predict(near, GRID), model.predict(far, GRID)
    np.testing.assert_allclose(b.means - [1e5, -1e5], a.means, atol=1e-6)
    np.testing.assert_allclose(b.covariances, a.covariances, rtol=1e-5)
    _, s0 = mean_and_spread(model.predict(track(heading=-2.5).until(3.0), GRID), track(heading=-2.5).until(3.0))
    _, s1 = mean_and_spread(a, near)
    np.testing.assert_allclose(s0, s1, rtol=1e-5, atol=1e-9)


def test_what_is_seen_of_the_surroundings():
    past = car(0.0, 0.5, 10.0, times=[3.0], name="me")
    lanes = [lane("a", 0.0, ("c",), x=(-50.0, 20.0)), lane("b", 3.5), lane("c", 0.0, bend=0.002, x=(20.0, 300.0))]
    others = [
        car(20.0, 0.0, 7.0, times=[3.0]),
        car(12.0, -9.0, 7.0, times=[3.0]),
        car(-3.0, 3.8, 9.0, times=[3.0]),
        car(15.0, 0.0, 9.0, np.pi, times=[3.0]),
    ]
    seen = look_around(past, 10.0, lanes, [past, *others])
    assert seen.gap == pytest.approx(20.0 - 4.5)
    assert seen.closing == pytest.approx(-3.0)
    assert seen.offset == pytest.approx(0.5)
    assert seen.drift == pytest.approx(0.0, abs=1e-9)
    assert (seen.taken, seen.open) == ((1.0, 0.0), (1.0, 0.0))
    points, directions = seen.course(np.array([0.0, 10.0, 40.0]))
    np.testing.assert_allclose(points[:2], [[0.0, 0.5], [10.0, 0.5]], atol=1e-6)
    assert points[2, 1] == pytest.approx(0.5 + 0.001 * points[2, 0] ** 2, abs=0.01)
    assert directions[2] == pytest.approx(0.08, abs=0.01)
    nothing = look_around(past, 10.0)
    assert (nothing.gap, nothing.offset, nothing.open) == (np.inf, 0.0, (0.0, 0.0))
    np.testing.assert_allclose(nothing.course(np.array([7.0]))[0], [[7.0, 0.5]])


def test_features_have_their_names():
    past = track().until(3.0)
    even, odd = situation_features(Situation.of(past, 0.5), look_around(past, 10.0))
    assert (len(even), len(odd)) == (len(EVEN + EVEN_OF_PAST), len(ODD + ODD_OF_PAST))
    start = track().until(0.0)
    even, odd = situation_features(Situation.of(start, 0.5), look_around(start, 10.0))
    assert (len(even), len(odd)) == (len(EVEN), len(ODD))


def test_shipped_parameters_survive_the_round_trip():
    model = Manoeuvres.fitted()
    again = Manoeuvres.from_dict(json.loads(json.dumps(model.to_dict())))
    a, b = (m.predict(track().until(3.0), GRID) for m in (model, again))
    np.testing.assert_allclose(a.means, b.means, atol=1e-9)
    assert model is Manoeuvres.fitted()


def test_shipped_parameters_are_better_where_they_were_not_fitted():
    """As the fit states it of files whose vehicles it had not seen."""
    summary = Manoeuvres.fitted().summary
    assert not set(summary["fitted_on"]) & set(summary["held_out"])
    for key in ("past", "initial"):
        for who in ("all", "moving"):
            ours, plain = (summary[key][who][name] for name in ("manoeuvres", "constant_velocity"))
            assert ours["predictions"] > 1000
            for score in ("joint_nll", "marginal_nll"):
                assert ours[score] < plain[score]


def test_bad_input_names_the_field():
    model = Manoeuvres.fitted()
    with pytest.raises(InputError, match=r"^times\[0\]"):
        model.predict(track(), [-0.1, 0.0])
    with pytest.raises(InputError, match="^past: expected"):
        Manoeuvres(model.initial, model.initial)
    with pytest.raises(InputError, match="window"):
        Manoeuvres.from_dict({"past": model.past.to_dict(), "initial": model.initial.to_dict()})
    values = model.past.to_dict()
    values["left"] = {**values["left"], "growth": [-1.0] * len(values["left"]["growth"])}
    with pytest.raises(InputError, match="^growth"):
        Mixture(**values)


def test_likelihood_of_a_whole_trajectory_is_the_one_of_its_covariance():
    pytest.importorskip("torch")
    from predictor.fit_manoeuvres import log_likelihood  # noqa: PLC0415

    rng = np.random.default_rng(0)
    errors, means, spreads = rng.normal(size=(3, 4)), rng.normal(size=(3, 4)), rng.uniform(0.1, 2, (3, 4))
    errors[1, 2:] = np.nan
    found = log_likelihood(errors, means, spreads, 0.3, 0.05, np)
    for n in range(3):
        seen = np.isfinite(errors[n])
        s = spreads[n, seen]
        covariance = np.outer(s, s) + np.diag(0.05**2 + (0.3 * s) ** 2)
        expected = multivariate_normal(means[n, seen], covariance).logpdf(errors[n, seen])
        assert found[n] == pytest.approx(expected, rel=1e-9)


def test_fit_finds_the_manoeuvres_that_made_the_data():
    pytest.importorskip("torch")
    from predictor.fit_constant_velocity import TIMES  # noqa: PLC0415
    from predictor.fit_manoeuvres import Samples, _stated, fit, joint, judge  # noqa: PLC0415

    rng = np.random.default_rng(1)
    n, model = 3000, Manoeuvres.fitted().initial
    even = np.column_stack([np.ones(n), *rng.uniform(*model.even_range[:, 1:], (n, len(EVEN) - 1)).T])
    odd = rng.uniform(-model.odd_range, model.odd_range, (n, len(ODD)))
    wide = rng.random((n, 2)) < 0.3
    xi = rng.standard_normal((n, 2)) * np.where(wide, [2.0, 1.0], [0.5, 0.1])
    errors = xi[:, None] * TIMES[:, None] ** 1.5 + 0.05 * rng.standard_normal((n, len(TIMES), 2))
    samples = Samples(even, odd, np.zeros((n, len(TIMES))), errors, np.ones((n, len(TIMES), 2)), even[:, 1])
    found = fit(samples, 2, 2, iterations=60)
    weights, _, deviations = found.stated(even, odd, samples.bends, 0.0 * samples.drift, TIMES)
    assert np.sort(found.ahead.weights(even).mean(axis=0))[0] == pytest.approx(0.3, abs=0.06)
    at_one = np.sort(np.unique(deviations[:, :, 1, 0].mean(axis=0).round(6)))
    np.testing.assert_allclose(at_one, [0.5, 2.0], rtol=0.15)
    verdict = judge(samples, joint(found, samples), _stated(found, samples))
    for shares in verdict["within_50_90_99"].values():
        np.testing.assert_allclose(shares, [0.5, 0.9, 0.99], atol=0.04)
    assert weights.shape == (n, 4)
