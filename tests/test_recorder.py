"""Simulated traffic: true controls, no collisions, the same by seed; and the file it is kept in."""

from __future__ import annotations

import json
import zipfile

import numpy as np
import pytest
import shapely
from traffic import lane, recording, straight

from checkers import InputError
from predictor.datasets.simulator import FORMAT, read, save_recordings
from predictor.recorder import MAPS, record, windows_in
from predictor.recordings import open_data
from predictor.windows import windows
from riskplan.cli import main

simulator = pytest.importorskip("predictor.simulator.traffic", reason="needs the extra simulator (highway-env)")

DT = 0.1


def scene(kind, steps=80, seed=0):
    return simulator.simulated(kind, kind, steps, np.random.default_rng(seed))


@pytest.fixture(scope="module", params=MAPS)
def simulated(request):
    return scene(request.param)


def test_controls_explain_the_motion_exactly(simulated):
    """A Dubins car driven by the recorded controls goes where the vehicle went."""
    for track in simulated.tracks:
        controls = simulated.controls[track.name]
        x, heading, speed = track.positions[0], track.headings[0], track.speeds[0]
        for k, (acceleration, yaw_rate) in enumerate(controls):
            np.testing.assert_allclose(track.positions[k], x, atol=1e-9)
            assert (track.headings[k], track.speeds[k]) == pytest.approx((heading, speed), abs=1e-9)
            x = x + speed * DT * np.array([np.cos(heading), np.sin(heading)])
            heading, speed = heading + yaw_rate * DT, max(speed + acceleration * DT, 0.0)


def test_traffic_is_traffic(simulated):
    assert len(simulated.tracks) >= 4
    assert simulated.dt == DT
    speeds, controls = (
        np.concatenate(list(values)) for values in ((t.speeds for t in simulated.tracks), simulated.controls.values())
    )
    assert speeds.min() >= 0.0
    assert 1.0 < speeds.mean() < 40.0
    assert np.abs(controls[:, 0]).max() < 12.0
    assert np.abs(controls[:, 1]).max() < 1.2
    # lateral acceleration of a car, not of a missile
    assert np.quantile(np.abs(controls[:, 1] * speeds), 0.99) < 7.0
    # nobody drives by the book
    assert controls[:, 0].std() > 0.1


def test_vehicles_do_not_pass_through_each_other(simulated):
    grid = {}
    for track in simulated.tracks:
        for k, t in enumerate(np.round(track.times / DT).astype(int)):
            grid.setdefault(t, []).append((track, k))
    for present in grid.values():
        bodies = [body(track, k) for track, k in present]
        tree = shapely.STRtree(bodies)
        first, second = tree.query(bodies, predicate="overlaps")
        assert np.all(first == second)


def body(track, k):
    c, s = np.cos(track.headings[k]), np.sin(track.headings[k])
    corners = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * [track.length / 2, track.width / 2]
    return shapely.Polygon(corners @ [[c, s], [-s, c]] + track.positions[k])


def test_vehicles_drive_along_the_lanes(simulated):
    """In their direction, and on their surface: positions, headings and map are mirrored alike."""
    surface = shapely.union_all([shapely.Polygon(x.outline).buffer(1.0) for x in simulated.lanes])
    lines = shapely.STRtree([shapely.LineString(x.centre) for x in simulated.lanes])
    turned = []
    for track in simulated.tracks:
        assert np.mean(shapely.contains_xy(surface, *track.positions.T)) > 0.98
        for k in range(0, len(track.times), 10):
            near = [simulated.lanes[i] for i in lines.query(shapely.Point(track.positions[k]).buffer(2.5))]
            angles = [x.direction_at(track.positions[k]) - track.headings[k] for x in near]
            turned.append(min((abs(np.angle(np.exp(1j * a))) for a in angles), default=0.0))
    assert np.quantile(turned, 0.95) < 0.5


def test_left_is_left(simulated):
    for x in simulated.lanes:
        along, across = x.centre[1] - x.centre[0], x.left[0] - x.right[0]
        assert along[0] * across[1] - along[1] * across[0] > 0


def test_lanes_are_linked(simulated):
    names = {x.name for x in simulated.lanes}
    for x in simulated.lanes:
        assert set(x.successors) <= names
        assert set(x.neighbours) <= names
        for name in x.successors:
            after = next(y for y in simulated.lanes if y.name == name)
            assert np.hypot(*(after.centre[0] - x.centre[-1])) < 2.5


def test_traffic_keeps_to_the_right():
    """At the intersection's southern arm who goes north is east of who comes south."""
    lanes = {x.name: x for x in scene("intersection", steps=1).lanes}
    ahead = lanes["o0-ir0-0"].centre
    assert ahead[-1, 1] > ahead[0, 1]
    assert ahead[0, 0] > lanes["il0-o0-0"].centre[-1, 0]


def test_drivers_differ():
    tracks = scene("merge", steps=10).tracks
    assert len({t.length for t in tracks}) == len(tracks)
    assert np.ptp([t.speeds.mean() for t in tracks]) > 2.0


def test_the_same_by_seed():
    first, second, other = (scene("merge", 20, seed) for seed in (1, 1, 2))
    assert len(first.tracks) == len(second.tracks)
    for a, b in zip(first.tracks, second.tracks, strict=True):
        np.testing.assert_array_equal(a.positions, b.positions)
    assert not np.array_equal(first.tracks[0].positions, other.tracks[0].positions)


def test_global_randomness_does_not_matter():
    np.random.seed(0)  # noqa: NPY002  what a library might do
    first = scene("intersection", 20)
    np.random.seed(1)  # noqa: NPY002
    np.testing.assert_array_equal(first.tracks[0].positions, scene("intersection", 20).tracks[0].positions)


def test_as_many_samples_as_asked_for(monkeypatch):
    monkeypatch.setattr("predictor.recorder.STEPS", 60)
    places = ("intersection", "roundabout")
    few, more = list(record(5, 3, places)), list(record(20, 3, places))
    assert sum(map(windows_in, few)) >= 5
    assert sum(map(windows_in, few[:-1])) < 5
    assert [r.name for r in few] == [r.name for r in more[: len(few)]]
    np.testing.assert_array_equal(few[0].tracks[0].positions, more[0].tracks[0].positions)
    assert len(windows(more, least=30)) == sum(map(windows_in, more))
    assert {r.name.split("-")[0] for r in more} == set(places)
    assert [r.name for r in record(1, maps=["merge"])] == ["merge-0-0"]


def test_bad_requests():
    with pytest.raises(InputError, match=r"^maps\[1\]: expected one of highway, merge.*got 'moon'"):
        next(record(10, maps=["merge", "moon"]))
    with pytest.raises(InputError, match=r"^samples: expected an integer >= 1, got 0"):
        next(record(0))


def test_the_command(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("predictor.recorder.STEPS", 60)
    out = tmp_path / "traffic.npz"
    assert main(["record", "--out", str(out), "--samples", "10", "--seed", "4", "--map", "merge", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["samples"] >= 10
    recordings = list(open_data(out).recordings())
    assert (len(recordings), sum(len(r.tracks) for r in recordings)) == (told["scenes"], told["vehicles"])
    assert main(["record", "--out", str(tmp_path / "again.npz"), "--samples", "10", "--seed", "4", "--map=merge"]) == 0
    assert out.read_bytes() == (tmp_path / "again.npz").read_bytes()
    assert main(["record", "--out", str(tmp_path / "x.csv")]) == 2
    assert "expected the suffix .npz" in capsys.readouterr().err
    assert main(["record", "--out", str(tmp_path / "x.npz"), "--map", "moon"]) == 2
    assert not (tmp_path / "x.npz").exists()
    assert main(["record", "--out", str(tmp_path / "no" / "x.npz")]) == 2
    assert "no such folder" in capsys.readouterr().err


def test_recordings_are_kept_bit_for_bit(tmp_path):
    acted = np.random.default_rng(0).normal(size=(60, 2))
    acted[-1] = np.nan
    first = recording(
        "one",
        [straight("a"), straight("b", 30, first=4)],
        lanes=(lane("l", successors=("m",)), lane("m", y=4.0)),
        controls={"a": acted},
        focal=("b",),
        ego="a",
        group="place",
    )
    assert save_recordings([first, recording("two")], tmp_path / "r.npz") == 2
    back = list(read(tmp_path / "r.npz"))
    assert [r.name for r in back] == ["one", "two"]
    assert (back[0].focal, back[0].ego, back[0].group, back[1].group) == (("b",), "a", "place", "two")
    for a, b in zip(first.tracks, back[0].tracks, strict=True):
        assert (a.name, a.kind, a.length, a.width) == (b.name, b.kind, b.length, b.width)
        for field in ("times", "positions", "headings", "speeds"):
            np.testing.assert_array_equal(getattr(a, field), getattr(b, field))
    for a, b in zip(first.lanes, back[0].lanes, strict=True):
        assert (a.name, a.successors, a.neighbours) == (b.name, b.successors, b.neighbours)
        for field in ("centre", "left", "right"):
            np.testing.assert_array_equal(getattr(a, field), getattr(b, field))
    assert list(back[0].controls) == ["a"]
    np.testing.assert_array_equal(back[0].controls["a"], acted)


def broken(path, **changes):
    """A recordings file with other members."""
    save_recordings([recording()], path)
    with np.load(path) as data:
        values = {key: data[key] for key in data.files} | changes
    np.savez(path, **{key: value for key, value in values.items() if value is not None})
    return path


def test_broken_files_are_named(tmp_path):
    path = tmp_path / "r.npz"
    states = np.zeros((60, 7))
    meta = {"name": "r", "dt": 0.1, "group": "", "ego": None, "focal": [], "tracks": [], "controls": [], "lanes": []}
    cases = [
        ({"format": np.asarray("other")}, f"format: expected '{FORMAT}', got 'other'"),
        ({"count": None}, "count: expected a whole number, got None"),
        ({"count": np.asarray(2)}, "recording 1: not as written: KeyError"),
        ({"0.meta": np.asarray("{")}, "recording 0: not as written: JSONDecodeError"),
        ({"0.meta": np.asarray("[]")}, "recording 0: not as written: TypeError"),
        ({"0.meta": np.asarray(json.dumps(meta))}, r"recording 0: rows: expected shape \(0, 7\), got \(60, 7\)"),
        ({"0.states": states}, r"recording 0: times\[1\]: expected times to increase"),
        ({"0.states": states[:5]}, r"recording 0: rows: expected shape \(60, 7\), got \(5, 7\)"),
        ({"0.meta": np.array([{}], dtype=object)}, "pickled objects|not as written"),
    ]
    for changes, message in cases:
        with pytest.raises(InputError, match=f"^{path}: .*{message}") as raised:
            list(read(broken(path, **changes)))
        assert "\n" not in str(raised.value)


def test_a_file_that_claims_too_much(tmp_path, monkeypatch):
    path = tmp_path / "r.npz"
    save_recordings([recording()], path)
    monkeypatch.setattr("predictor.npz.LARGEST", 1000)
    with pytest.raises(InputError, match=r"expected at most 1000000 arrays of 0.001 MB together"):
        list(read(path))
    with zipfile.ZipFile(path) as archive:
        assert {i.date_time for i in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
