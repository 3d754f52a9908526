"""Windows: what is in them, what cannot be, and that no scene is in two parts of a split."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from traffic import lane, recording, straight

from checkers import InputError
from predictor.grid import observed_past
from predictor.recordings import Recording
from predictor.tracks import Track
from predictor.windows import Windows, split, windows


def wavy(name="w", steps=80, dt=0.1, first=0):
    """A track nobody could confuse steps of."""
    k = np.arange(first, first + steps)
    t = k * dt
    xy = np.column_stack([9 * t + 0.2 * t**2, 3 * np.sin(t)])
    return Track(name, t, xy, np.arctan2(3 * np.cos(t), 9 + 0.4 * t), 9 + 0.4 * t, 4.0, 1.7)


def test_a_window_holds_the_steps_it_should():
    track = wavy(first=7)
    acted = np.column_stack([np.arange(80.0), -np.arange(80.0)])
    w = windows([recording(tracks=[track], controls={"w": acted})], past=5, future=6, every=3, least=6)
    # present at the 5th step and every third from there, as long as six are left
    present = np.arange(4, 80 - 6, 3)
    assert len(w) == len(present)
    for row, k in enumerate(present):
        np.testing.assert_allclose(w.past[row], track.positions[k - 4 : k + 1], atol=1e-12)
        np.testing.assert_allclose(w.future[row], track.positions[k + 1 : k + 7], atol=1e-12)
        assert w.headings[row] == pytest.approx(track.headings[k])
        assert w.speeds[row] == pytest.approx(track.speeds[k])
        # what acts from the present on leads to the first future step
        np.testing.assert_allclose(w.controls[row], acted[k : k + 6])
    assert w.sizes.tolist() == [[4.0, 1.7]] * len(w)
    assert np.isnan(w.ego_future).all()
    assert np.isnan(w.lanes).all()


def test_futures_end_where_the_recording_does():
    w = windows([recording(tracks=[wavy(steps=30)])], past=5, future=10, every=1)
    assert len(w) == 30 - 5
    known = np.isfinite(w.future[..., 0]).sum(axis=1)
    assert known.tolist() == [10] * 15 + list(range(10, 0, -1))
    assert len(windows([recording(tracks=[wavy(steps=30)])], past=5, future=10, every=1, least=0)) == 26


def test_a_past_without_a_future_is_refused_or_wanted():
    only = recording(tracks=[straight(steps=20)])
    with pytest.raises(InputError, match=r"expected tracks with 20 steps of past and at least 1 of future.*1 tracks"):
        windows([only])
    assert np.isnan(windows([only], least=0).future).all()


def test_tracks_too_short_are_left_out():
    w = windows([recording(tracks=[straight("short", 19), straight("long", 60)])], every=100)
    assert len(w) == 1


def test_small_gaps_are_bridged_in_the_past_and_stay_unknown_in_the_future():
    track = straight(steps=60, missing=(10, 11, 40))
    w = windows([recording(tracks=[track])], every=100)
    np.testing.assert_allclose(w.past[0, 10:12, 0], [10.0, 11.0], atol=1e-9)
    # the present is step 19, so step 40 is future 20
    assert np.flatnonzero(np.isnan(w.future[0, :, 0])).tolist() == [20]


def test_large_gaps_break_a_past():
    track = straight(steps=90, missing=(30, 31, 32))
    w = windows([recording(tracks=[track])], past=20, every=1, future=5, least=5)
    starts = np.round(w.past[:, 0, 0] / 1.0).astype(int)
    assert set(starts) == set(range(30 - 20 - 5 + 1)) | set(range(33, 90 - 25 + 1))


def test_the_present_is_never_bridged():
    """A bridge needs the observation after the gap: with the present in the gap that would be the future."""
    track = straight(steps=60, missing=(25,))
    w = windows([recording(tracks=[track])], every=1)
    assert 25.0 not in np.round(w.past[:, -1, 0], 6)
    assert 25.0 in np.round(w.past[:, -2, 0], 6)


def test_the_past_does_not_see_the_future():
    """Whatever comes later, what is known at a time stays the same."""
    track = wavy(steps=60)
    changed = track.positions.copy()
    changed[20:] += 100.0
    other = Track("w", track.times, changed, track.headings, track.speeds, 4.0, 1.7)
    first, second = (windows([recording(tracks=[t])], every=100) for t in (track, other))
    np.testing.assert_array_equal(first.past, second.past)
    assert not np.allclose(first.future, second.future)


def test_a_finer_recording_is_interpolated():
    fine = Recording("fine", 0.05, (wavy(steps=200, dt=0.05),))
    coarse = Recording("coarse", 0.1, (wavy(steps=100, dt=0.1),))
    a, b = windows([fine]), windows([coarse])
    np.testing.assert_allclose(a.past, b.past, atol=1e-9)
    np.testing.assert_allclose(a.future, b.future, atol=1e-9)
    uneven = Recording("uneven", 0.04, (wavy(steps=250, dt=0.04),))
    np.testing.assert_allclose(windows([uneven]).past, b.past, atol=5e-3)


def test_a_coarser_recording_is_refused():
    slow = Recording("pedestrians", 0.4, (straight(steps=60, dt=0.4),))
    with pytest.raises(
        InputError, match=r"recording 'pedestrians': expected an observation at least every 0.1 s, got one every 0.4 s"
    ):
        windows([slow])
    w = windows([slow], past=8, future=12, dt=0.4)
    np.testing.assert_allclose(w.future[0, :, 0], (8 + np.arange(12)) * 4.0)
    # asked for in so many words, it is interpolated
    assert windows([slow.resampled(0.1)], every=100).past[0, 1, 0] == pytest.approx(1.0)


def test_the_ego_is_the_recordings_own_and_no_target():
    own, other = straight("own", start=(0.0, 5.0)), straight("other")
    w = windows([recording(tracks=[own, other], ego="own")], every=100)
    assert len(w) == 1
    np.testing.assert_allclose(w.past[0, :, 1], 0.0)
    np.testing.assert_allclose(w.ego_future[0, :, 1], 5.0)
    np.testing.assert_allclose(w.ego_future[0, :, 0], w.future[0, :, 0])


def test_another_vehicle_stands_for_the_ego():
    near = [straight(f"n{i}", start=(0.0, 4.0 * i)) for i in range(4)]
    far, leaving = straight("far", start=(0.0, 500.0)), straight("leaving", steps=40, start=(0.0, -4.0))
    drawn = set()
    for seed in range(20):
        w = windows([recording(tracks=[*near, far, leaving])], every=100, rng=seed)
        target = w.past[:, 0, 1]
        ego = w.ego_future[:, 0, 1]
        seen = (target != 500.0) & (target != -4.0)
        assert np.isfinite(ego[target != 500.0]).all()
        assert np.isnan(w.ego_future[target == 500.0]).all()
        assert not np.any(ego == target)
        assert not np.isin(ego, [500.0, -4.0]).any()
        drawn |= set(ego[seen])
        again = windows([recording(tracks=[*near, far, leaving])], every=100, rng=seed)
        np.testing.assert_array_equal(again.ego_future, w.ego_future)
    assert drawn == {0.0, 4.0, 8.0, 12.0}


def test_lanes_within_fifty_metres_nearest_first():
    w = windows([recording(lanes=(lane(y=0.0), lane("far", y=60.0)))], every=100, lane_points=40)
    points = w.lanes[0]
    present = w.past[0, -1]
    known = np.isfinite(points[:, 0])
    distance = np.hypot(*(points[known] - present).T)
    assert np.all(np.diff(distance) >= 0)
    assert distance.max() <= 50.0
    assert np.all(points[known, 1] == 0.0)
    # the target is at 19 m on a lane from 0 to 200 m, with a point every 5 m
    assert sorted(points[known, 0]) == [2.5 + 5 * i for i in range(14)]
    np.testing.assert_allclose(w.lane_headings[0, known], 0.0)
    few = windows([recording(lanes=(lane(),))], every=100, lane_points=3)
    assert sorted(few.lanes[0, :, 0]) == [12.5, 17.5, 22.5]


def test_focal_tracks_only():
    tracks = [straight("a"), straight("b", start=(0.0, 4.0))]
    r = recording(tracks=tracks, focal=("b",))
    assert len(windows([r], every=100)) == 2
    w = windows([r], every=100, focal=True)
    assert w.past[:, 0, 1].tolist() == [4.0]
    assert len(windows([recording(tracks=tracks)], every=100, focal=True)) == 2


def test_standing_targets_are_kept():
    w = windows([recording(tracks=[straight(speed=0.0, heading=1.0)])], every=100)
    assert np.ptp(w.past) == 0.0
    assert w.headings.tolist() == [1.0]
    assert w.speeds.tolist() == [0.0]


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.lists(st.integers(1, 6), min_size=12, max_size=30))
def test_no_scene_is_in_two_parts(seed, sizes):
    scenes = [
        recording(f"r{i}", [straight(f"t{k}", start=(0.0, 4.0 * k)) for k in range(n)]) for i, n in enumerate(sizes)
    ]
    whole = windows(scenes, every=100)
    parts = split(whole, (0.6, 0.2, 0.2), seed)
    groups = [set(part.scenes) for part in parts]
    assert sum(map(len, parts)) == len(whole) == sum(sizes)
    assert sum(map(len, groups)) == len(sizes) == len(set().union(*groups))
    for part, share in zip(parts[1:], (0.2, 0.2), strict=True):
        assert 0 < len(part) <= share * len(whole) + 1e-9
        assert len(part) > share * len(whole) - 6
    again = split(whole, (0.6, 0.2, 0.2), seed)
    assert all(np.array_equal(a.scenes, b.scenes) for a, b in zip(parts, again, strict=True))


def test_grouped_recordings_stay_together():
    scenes = [recording(f"r{i}", group="same" if i < 5 else "") for i in range(10)]
    whole = windows(scenes, every=100)
    assert whole.names == ("same", *(f"r{i}" for i in range(5, 10)))
    assert np.bincount(whole.scenes).tolist() == [5, 1, 1, 1, 1, 1]


def test_a_split_that_cannot_be():
    whole = windows([recording()], every=100)
    with pytest.raises(InputError, match=r"^fractions: expected numbers > 0 that sum to 1, got \[0.7, 0.1\]"):
        split(whole, (0.7, 0.1), 0)
    with pytest.raises(InputError, match=r"^fractions\[1\]: no scene is small enough"):
        split(whole, (0.5, 0.5), 0)


def test_saved_and_loaded(tmp_path):
    w = windows([recording(tracks=[straight(), wavy()], lanes=(lane(),))], every=5)
    w.save(tmp_path / "w.npz")
    back = Windows.load(tmp_path / "w.npz")
    for name in ("past", "future", "headings", "lanes", "lane_headings", "ego_future", "controls", "scenes", "sizes"):
        np.testing.assert_array_equal(getattr(back, name), getattr(w, name))
    assert (back.names, back.dt) == (w.names, w.dt)
    assert [f.name for f in tmp_path.iterdir()] == ["w.npz"]


def test_files_that_are_no_windows(tmp_path):
    with pytest.raises(InputError, match=r"none.npz: no such file"):
        Windows.load(tmp_path / "none.npz")
    (tmp_path / "text.npz").write_text("hello")
    with pytest.raises(InputError, match=r"text.npz: not a file of arrays"):
        Windows.load(tmp_path / "text.npz")
    np.savez(tmp_path / "pickled.npz", format=np.array([{"a": 1}], dtype=object))
    with pytest.raises(InputError, match=r"pickled.npz: not a file of arrays: \w+.npy: it holds pickled objects"):
        Windows.load(tmp_path / "pickled.npz")
    np.savez(tmp_path / "other.npz", format="something")
    with pytest.raises(InputError, match=r"other.npz: format: expected 'riskplan-windows-1', got 'something'"):
        Windows.load(tmp_path / "other.npz")
    np.savez(tmp_path / "empty.npz", format="riskplan-windows-1")
    with pytest.raises(InputError, match=r"empty.npz: controls: missing field"):
        Windows.load(tmp_path / "empty.npz")
    w = windows([recording()], every=5)
    w.save(tmp_path / "w.npz")
    content = (tmp_path / "w.npz").read_bytes()
    for end in (10, len(content) // 2, len(content) - 5):
        (tmp_path / "cut.npz").write_bytes(content[:end])
        with pytest.raises(InputError, match=r"cut.npz: not a file of arrays"):
            Windows.load(tmp_path / "cut.npz")


def test_fields_are_checked():
    w = windows([recording()], every=5)
    with pytest.raises(InputError, match=r"^scenes: expected \(\d+,\) indices below 0"):
        Windows(**{**vars(w), "names": ()})
    with pytest.raises(InputError, match=r"^future: expected shape"):
        Windows(**{**vars(w), "future": w.future[:-1]})
    with pytest.raises(InputError, match=r"^past\[0, 0, 0\]: expected a finite number"):
        Windows(**{**vars(w), "past": np.full(w.past.shape, np.nan)})
    with pytest.raises(InputError, match=r"^every: expected an integer >= 1"):
        windows([recording()], every=0)


def test_observed_past_is_the_window_without_a_future():
    track = wavy(steps=50)
    np.testing.assert_allclose(observed_past(track.until(2.0)), track.positions[1:21], atol=1e-12)
    fine = wavy(steps=200, dt=0.05)
    np.testing.assert_allclose(observed_past(fine.until(2.0)), wavy().positions[1:21], atol=1e-12)


def test_observed_past_says_what_is_missing():
    with pytest.raises(InputError, match=r"^track 'a': expected a past of 1.9 s, got 1.5 s"):
        observed_past(straight(steps=16))
    with pytest.raises(InputError, match=r"^track 'a': expected no gap of more than 2 observations.* at 1.2 s"):
        observed_past(straight(steps=20, missing=(10, 11, 12)))
    with pytest.raises(InputError, match=r"^track 'a': expected an observation at least every 0.1 s, got one every"):
        observed_past(straight(dt=0.4))
    assert np.allclose(observed_past(straight(steps=20, missing=(11, 12)))[:, 0], np.arange(20.0))
