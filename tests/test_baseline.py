"""The constant-velocity baseline: what it computes, what it may see, how far it is calibrated."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from checkers import InputError
from predictor import ConstantVelocity, Track
from predictor.constant_velocity import Spread
from predictor.fit_constant_velocity import MOVING, fit, judge, linked, main, sample, split
from predictor.io_commonroad import load_tracks

GRID = np.arange(31) * 0.1


def track(speed=10.0, heading=0.3, start=(5.0, -2.0), duration=6.0, acceleration=0.0, name="a", offset=0.0):
    times = np.arange(round(duration / 0.1) + 1) * 0.1
    way = speed * times + acceleration * times**2 / 2
    positions = np.array(start) + way[:, None] * [np.cos(heading), np.sin(heading)]
    speeds = speed + acceleration * times
    return Track(name, times + offset, positions, np.full(len(times), heading), speeds, 4.5, 1.8)


def frame_variances(prediction, heading):
    c, s = np.cos(heading), np.sin(heading)
    frame = np.array([[c, -s], [s, c]])
    return np.einsum("ji,tjk,kl->til", frame, prediction.covariances[:, 0], frame)


def test_track_is_checked():
    good = track()
    assert not good.positions.flags.writeable
    with pytest.raises(InputError, match=r"^times\[1\]"):
        Track("a", [0, 0], [[0, 0], [1, 1]], [0, 0], [1, 1], 4, 2)
    with pytest.raises(InputError, match=r"^positions"):
        Track("a", [0, 1], [[0, 0]], [0, 0], [1, 1], 4, 2)
    with pytest.raises(InputError, match=r"^speeds\[1\]"):
        Track("a", [0, 1], [[0, 0], [1, 1]], [0, 0], [1, np.nan], 4, 2)
    with pytest.raises(InputError, match=r"^width"):
        Track("a", [0, 1], [[0, 0], [1, 1]], [0, 0], [1, 1], 4, 0)
    with pytest.raises(InputError, match=r"^times\[0\].*'a' covers"):
        good.at([-0.5])
    with pytest.raises(InputError, match="before"):
        good.until(-1.0)


def test_track_helpers():
    t = track(offset=100.0)
    assert t.until(101.0).times[-1] == pytest.approx(101.0)
    assert len(t.until(101.0).times) == 11
    window = t.window(102.0, 103.0)
    assert window.times[0] == pytest.approx(0.0)
    assert len(window.times) == 11
    np.testing.assert_array_equal(window.positions, t.positions[20:31])
    turning = Track("b", [0, 1], [[0, 0], [1, 0]], [3.1, -3.1], [1, 1], 4, 2)
    assert abs(np.cos(turning.at([0.5]).headings[0]) + 1) < 1e-9


@pytest.mark.parametrize("seconds", [0.0, 0.5, 4.0])
def test_mean_goes_straight_on(seconds):
    t = track(speed=12.0, offset=50.0)
    past = t.until(50.0 + seconds)
    prediction = ConstantVelocity.fitted().predict(past, np.arange(16) * 0.1)
    expected = past.positions[-1] + np.arange(16)[:, None] * 1.2 * [np.cos(0.3), np.sin(0.3)]
    np.testing.assert_allclose(prediction.means[:, 0], expected, atol=1e-9)
    assert (prediction.name, prediction.length, prediction.width) == ("a", 4.5, 1.8)
    np.testing.assert_allclose(prediction.headings, 0.3)
    assert prediction.weights.tolist() == [1.0]


@pytest.mark.parametrize("seconds", [0.5, 3.0])
@pytest.mark.parametrize("speed", [0.0, 0.3, 5.0, 35.0])
def test_spread_is_positive_monotone_and_in_the_heading_frame(speed, seconds):
    prediction = ConstantVelocity.fitted().predict(track(speed=speed, heading=2.0).until(seconds), GRID)
    local = frame_variances(prediction, 2.0)
    np.testing.assert_allclose(local[:, 0, 1], 0.0, atol=1e-9)
    assert np.all(np.diff(local[:, 0, 0]) > 0)
    assert np.all(np.diff(local[:, 1, 1]) > 0)
    assert np.linalg.eigvalsh(prediction.covariances[:, 0]).min() > 1e-4
    assert 0 < local[0, 0, 0] < 0.3**2


def test_standing_vehicles_spread_little():
    standing = ConstantVelocity.fitted().predict(track(speed=0.0).until(3.0), GRID)
    moving = ConstantVelocity.fitted().predict(track(speed=8.0).until(3.0), GRID)
    across = frame_variances(standing, 0.3)[-1, 1, 1] ** 0.5
    assert across < 0.1
    assert np.linalg.det(standing.covariances[-1, 0]) < 0.01 * np.linalg.det(moving.covariances[-1, 0])
    np.testing.assert_allclose(standing.means, standing.means[:1].repeat(31, axis=0))


def test_braking_widens_and_direction_does_not_matter():
    model = ConstantVelocity.fitted()
    steady = model.predict(track(speed=10.0).until(3.0), GRID)
    # 10.5 m/s on average over the window that the velocity is taken from, so faster by little
    braking = model.predict(track(speed=16.0, acceleration=-2.0).until(3.0), GRID)
    assert frame_variances(braking, 0.3)[-1, 0, 0] > 1.2 * frame_variances(steady, 0.3)[-1, 0, 0]
    turned = model.predict(track(heading=-2.5).until(3.0), GRID)
    np.testing.assert_allclose(frame_variances(turned, -2.5), frame_variances(steady, 0.3), rtol=1e-6, atol=1e-9)


def test_translation_changes_nothing():
    model = ConstantVelocity.fitted()
    near, far = (model.predict(track(start=s, acceleration=0.7).until(3.0), GRID) for s in ((0, 0), (1e5, -1e5)))
    np.testing.assert_allclose(far.means - [1e5, -1e5], near.means, atol=1e-8)
    np.testing.assert_allclose(far.covariances, near.covariances, rtol=1e-6)


def test_bad_input_names_the_field():
    model = ConstantVelocity.fitted()
    with pytest.raises(InputError, match=r"^times\[0\]"):
        model.predict(track(), [-0.1, 0.0])
    with pytest.raises(InputError, match=r"^growth"):
        Spread([0.0], [0.0], [1.0, 0.0], 0.1)
    with pytest.raises(InputError, match="window"):
        ConstantVelocity.from_dict({"past": model.to_dict()["past"], "initial": model.to_dict()["initial"]})
    with pytest.raises(InputError, match=r"^past: expected 6"):
        ConstantVelocity(model.initial, model.initial)


def test_shipped_parameters_survive_the_round_trip():
    model = ConstantVelocity.fitted()
    again = ConstantVelocity.from_dict(json.loads(json.dumps(model.to_dict())))
    np.testing.assert_array_equal(again.past.lateral, model.past.lateral)
    assert model is ConstantVelocity.fitted()
    assert model.summary["data"] == "commonroad-ngsim"
    assert model.summary["past"]["moving"]["predictions"] > 1000


def test_fit_recovers_known_parameters():
    rng = np.random.default_rng(3)
    samples = sample([track(speed=v, duration=30.0) for v in rng.uniform(1, 20, 40)], 0.5, past=False)
    truth = Spread([-0.5, 0.3, 0.0], [-1.5, 0.1, 0.0], [1.4, 0.8], 0.05)
    noise = rng.standard_normal(samples.errors.shape)
    times = np.arange(1, 7) * 0.5
    samples.errors[:] = np.where(
        np.isfinite(samples.errors), noise * np.sqrt(truth.variances(samples.features, times)), np.nan
    )
    found = fit(samples)
    np.testing.assert_allclose(found.growth, truth.growth, atol=0.06)
    ratio = found.variances(samples.features, times) / truth.variances(samples.features, times)
    assert 0.85 < ratio.min() < ratio.max() < 1.15
    for shares in judge(found, samples)["within_50_90_99"].values():
        np.testing.assert_allclose(shares, [0.5, 0.9, 0.99], atol=0.03)


def test_files_with_a_common_vehicle_stay_together():
    rng = np.random.default_rng(0)
    own = {n: track(name=n, acceleration=0.1 + 0.07 * i) for i, n in enumerate("abcdefgh")}
    files = {f"X-{n}": [t] for n, t in own.items()}
    files["X-z"] = [own["a"], own["c"].window(1.0, 4.0)]
    groups = linked(files)
    assert ["X-a", "X-c", "X-z"] in groups
    assert len(groups) == 7
    for seed in rng.integers(0, 100, 5):
        kept, held = split(files, int(seed))
        assert sorted(kept + held) == sorted(files)
        assert len({"X-a", "X-c", "X-z"} & set(held)) in (0, 3)


def test_command_line_names_an_empty_folder(tmp_path, capsys):
    assert main(["--data", str(tmp_path), "--out", str(tmp_path / "out.json")]) == 2
    assert "no XML files" in capsys.readouterr().err


def test_shipped_parameters_are_calibrated_as_stated():
    """Moving vehicles: a little wide in the middle (heavy tails), near nominal at 90 and 99 %."""
    root = os.environ.get("RISKPLAN_DATA")
    if not root or not (folder := Path(root) / "commonroad-ngsim").is_dir():
        pytest.skip("RISKPLAN_DATA does not point at the recorded scenes")
    pytest.importorskip("commonroad")
    names = (
        "USA_US101-8_1_T-1",
        "USA_US101-5_2_T-1",
        "USA_Lanker-1_12_T-1",
        "USA_Peach-4_5_T-1",
        "USA_US101-29_1_T-1",
    )
    tracks = [t for name in names for t in load_tracks(folder / f"{name}.xml")]
    model = ConstantVelocity.fitted()
    for past, spread in ((True, model.past), (False, model.initial)):
        samples = sample(tracks, model.window, past=past)
        moving = samples.of(samples.speeds >= MOVING)
        assert len(moving.speeds) > 150
        for middle, wide, widest in judge(spread, moving)["within_50_90_99"].values():
            assert 0.45 < middle < 0.9
            assert 0.82 < wide < 0.99
            assert 0.92 < widest
