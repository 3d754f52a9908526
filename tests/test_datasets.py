"""Readers of recorded traffic: what they make of good files, and what they say of others."""

from __future__ import annotations

import builtins
import json
import os
from pathlib import Path

import numpy as np
import pytest
from traffic import lane, recording, straight

from checkers import InputError
from predictor.datasets.motion import motion
from predictor.recordings import KINDS, Recording, open_data
from predictor.windows import split, windows

DATA = Path(os.environ.get("RISKPLAN_DATA", "/nonexistent"))
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="RISKPLAN_DATA names no folder of recorded traffic")

HEADER = "TIMESTAMP,TRACK_ID,OBJECT_TYPE,X,Y,CITY_NAME"


def argoverse1(path, stamps=None, speeds=(8.0, 3.0, 0.0), header=HEADER, extra=()):
    """A scenario of an AV, an AGENT and somebody else, eastwards side by side."""
    stamps = 315970000.0 + np.arange(20) * 0.1 if stamps is None else stamps
    who = ("0000", "AV"), ("1111", "AGENT"), ("2222", "OTHERS")
    rows = [
        f"{t!r},{name},{kind},{1500 + speed * (t - float(stamps[0]))!r},{800 + 4 * i},PIT"
        for t in map(float, stamps)
        for i, ((name, kind), speed) in enumerate(zip(who, speeds, strict=True))
    ]
    path.write_text("\n".join([header, *rows, *extra]) + "\n")
    return path


def only(path, kind=None) -> Recording:
    (found,) = open_data(path, kind).recordings()
    return found


# how to open


def test_every_kind_has_its_reader(tmp_path):
    for kind in KINDS:
        (tmp_path / kind).mkdir()
        with pytest.raises(InputError, match=r"no \.\w+ files, as data of kind"):
            open_data(tmp_path / kind, kind)
        (tmp_path / kind / f"x{KINDS[kind][1]}").write_text("nonsense")
        with pytest.raises(InputError, match=rf"x{KINDS[kind][1]}: "):
            list(open_data(tmp_path / kind).recordings())


def test_what_cannot_be_opened(tmp_path):
    with pytest.raises(InputError, match=r"^kind: expected one of argoverse1, argoverse2, commonroad, eth-ucy, simul"):
        open_data(tmp_path, "waymo")
    with pytest.raises(InputError, match=r"nowhere: no such file or folder"):
        open_data(tmp_path / "nowhere")
    with pytest.raises(InputError, match=r"expected data of one of the kinds argoverse1 \(\.csv\)"):
        open_data(tmp_path)
    argoverse1(tmp_path / "a.csv")
    (tmp_path / "b.txt").write_text("0 1 2 3\n")
    with pytest.raises(InputError, match=r"has data of several kinds, name one: argoverse1, eth-ucy"):
        open_data(tmp_path)
    assert len(list(open_data(tmp_path, "argoverse1").recordings())) == 1
    (tmp_path / "below").mkdir()
    argoverse1(tmp_path / "below" / "a.csv")
    with pytest.raises(InputError, match=r"several are called a\.csv"):
        open_data(tmp_path, "argoverse1")


def test_bad_files_are_left_out_if_wanted(tmp_path):
    for name in "abc":
        argoverse1(tmp_path / f"{name}.csv")
    (tmp_path / "b.csv").write_text("hello\n")
    with pytest.raises(InputError, match=r"b\.csv: not an Argoverse forecasting file"):
        list(open_data(tmp_path).recordings())
    reasons = []
    found = [r.name for r in open_data(tmp_path, on_bad=reasons.append).recordings()]
    assert found == ["a", "c"]
    assert len(reasons) == 1
    assert "b.csv" in str(reasons[0])


def test_recordings_are_checked():
    with pytest.raises(InputError, match=r"^tracks\[1\]: expected unique names, got 'a' again"):
        recording(tracks=[straight(), straight()])
    with pytest.raises(InputError, match=r"^focal: expected the name of a track, got 'x'"):
        recording(focal=("x",))
    with pytest.raises(InputError, match=r"^ego: expected the name of a track, got 'x'"):
        recording(ego="x")
    with pytest.raises(InputError, match=r"^controls\['a'\]: expected shape \(60, 2\), got \(3, 2\)"):
        recording(controls={"a": np.zeros((3, 2))})
    with pytest.raises(InputError, match=r"^lanes\[0\]: expected a Lane, got str"):
        recording(lanes=("x",))
    with pytest.raises(InputError, match=r"^dt: expected a finite number"):
        recording(dt=0.0)
    assert recording(lanes=(lane(),)).group == "r"


# speed and heading from positions


def test_motion_of_a_circle_lags_by_half_its_window():
    times = np.arange(50) * 0.1
    angle = 0.5 * times
    headings, speeds = motion(times, 20 * np.column_stack([np.sin(angle), -np.cos(angle)]))
    # a chord of one second: shorter than the arc, and its direction is that of half a second ago
    np.testing.assert_allclose(speeds[15:], 10.0, rtol=0.02)
    np.testing.assert_allclose(headings[15:], angle[15:] - 0.25, atol=0.01)


def test_motion_knows_only_the_past():
    rng = np.random.default_rng(0)
    times = np.cumsum(rng.uniform(0.05, 0.3, 60))
    positions = np.cumsum(rng.normal(0.3, 0.3, (60, 2)), axis=0)
    whole = motion(times, positions)
    for k in (1, 7, 30):
        part = motion(times[:k], positions[:k])
        for a, b in zip(part, whole, strict=True):
            np.testing.assert_allclose(a, b[:k], atol=1e-12)


def test_who_stands_keeps_the_heading_he_came_with():
    times = np.arange(60) * 0.1
    way = np.minimum(np.maximum(times - 1.0, 0.0), 2.0) * 5.0
    headings, speeds = motion(times, way[:, None] * [0.0, 1.0])
    assert headings[5] == 0.0  # nothing tells yet
    np.testing.assert_allclose(headings[15:], np.pi / 2)
    np.testing.assert_allclose(speeds[[5, 55]], 0.0, atol=1e-9)
    noisy = way[:, None] * [0.0, 1.0] + np.random.default_rng(0).normal(0, 0.05, (60, 2))
    assert abs(motion(times, noisy)[0][-1] - np.pi / 2) < 0.2
    assert motion(times[:1], noisy[:1])[1].tolist() == [0.0]


# Argoverse 1


def test_argoverse1(tmp_path):
    r = only(argoverse1(tmp_path / "7.csv"))
    assert (r.name, r.dt, r.focal, r.ego, r.lanes) == ("7", 0.1, ("1111",), "0000", ())
    assert [(t.name, t.kind) for t in r.tracks] == [("0000", "av"), ("1111", "agent"), ("2222", "others")]
    agent = r.tracks[1]
    np.testing.assert_allclose(agent.times, np.arange(-19, 1) * 0.1, atol=1e-9)
    np.testing.assert_allclose(agent.positions[:, 0], 1500 + 0.3 * np.arange(20), atol=1e-5)
    np.testing.assert_allclose(agent.speeds[1:], 3.0, atol=1e-4)
    np.testing.assert_allclose(agent.headings[1:], 0.0, atol=1e-6)
    w = windows([r], least=0)
    assert len(w) == 2
    assert np.isnan(w.future).all()


def test_jitter_is_not_a_change_of_rate(tmp_path):
    stamps = 1000.0 + np.arange(20) * 0.1 + np.random.default_rng(0).uniform(-0.01, 0.01, 20)
    r = only(argoverse1(tmp_path / "7.csv", stamps))
    np.testing.assert_allclose(r.tracks[0].times, np.arange(-19, 1) * 0.1, atol=1e-9)


def test_a_missing_step_is_a_gap(tmp_path):
    r = only(argoverse1(tmp_path / "7.csv", 1000.0 + np.delete(np.arange(25), [10, 11]) * 0.1))
    np.testing.assert_allclose(np.diff(r.tracks[0].times), [0.1] * 9 + [0.3] + [0.1] * 12, atol=1e-9)
    assert len(windows([r], least=0, every=1)) > 0


def test_a_slow_scenario_is_interpolated_by_its_stamps(tmp_path):
    """Recorded at 6 Hz: the speeds are those of the stamps, not those of steps taken for a tenth of a second."""
    r = only(argoverse1(tmp_path / "7.csv", 1000.0 + np.arange(20) * 0.17))
    av = r.tracks[0]
    np.testing.assert_allclose(np.diff(av.times), 0.1, atol=1e-9)
    assert av.times[-1] == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(av.speeds[5:], 8.0, atol=1e-3)
    np.testing.assert_allclose(av.positions[-1, 0], 1500 + 8 * 19 * 0.17, atol=1e-3)


def test_what_is_no_argoverse1(tmp_path):
    path = tmp_path / "7.csv"
    cases = [
        ({"header": "TIMESTAMP,TRACK_ID,X,Y"}, "no column OBJECT_TYPE"),
        ({"extra": ["1000.0,9,OTHERS,east,2,PIT"]}, "line 62: expected numbers in TIMESTAMP, X, Y"),
        ({"extra": ["1000.0,9"]}, "line 62: expected numbers"),
        ({"extra": ["1000.0,9,OTHERS,nan,2,PIT"]}, "line 62: expected finite numbers"),
        ({"extra": ["1000.0,9,OTHERS,1e300,2,PIT"]}, "line 62: expected finite numbers up to 1e"),
        ({"stamps": 1000.0 + np.arange(20) * 0.5}, "expected an observation about every 0.1 s, got one every 0.5 s"),
        ({"stamps": 1000.0 + np.arange(20) * 0.1, "extra": ["1000.1,1111,AGENT,1,2,PIT"]}, "expected one position at"),
    ]
    for changes, message in cases:
        with pytest.raises(InputError, match=f"^{path}: .*{message}"):
            only(argoverse1(path, **changes))
    path.write_text(HEADER + "\n")
    with pytest.raises(InputError, match="expected observations, got none"):
        only(path)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="expected UTF-8 text, got the byte 0xff"):
        only(path)


# ETH and UCY


def test_eth_ucy(tmp_path):
    path = tmp_path / "walk.txt"
    path.write_text("".join(f"{780 + 10 * k}\t{i}.0\t{0.5 * k}\t{i}\n" for k in range(25) for i in (1, 2) if k != 6))
    r = only(path)
    assert (r.name, r.dt, r.ego, [t.name for t in r.tracks]) == ("walk", 0.4, None, ["1", "2"])
    np.testing.assert_allclose(r.tracks[0].times, np.delete(np.arange(25), 6) * 0.4)
    np.testing.assert_allclose(r.tracks[0].speeds[2:], 1.25)
    assert (r.tracks[0].kind, r.tracks[0].length) == ("pedestrian", 0.5)
    w = windows([r], past=8, future=12, dt=0.4, every=1, least=12)
    assert len(w) > 0
    np.testing.assert_allclose(w.future[0, :, 0] - w.past[0, -1, 0], 0.5 * np.arange(1, 13))


def test_what_is_no_eth_ucy(tmp_path):
    path = tmp_path / "walk.txt"
    cases = [
        ("", "expected rows of frame, pedestrian, x, y"),
        ("0 1 2\n10 1 2\n", "got 3 columns"),
        ("0 1 2 3\n10 1 2 x\n", "expected rows of frame.* 'x'"),
        ("0 1 2 3\n10 1 2 nan\n", "line 2: expected finite numbers"),
        ("0 1 2 3\n10 1 2 1e300\n", "line 2: expected finite numbers up to 1e"),
        ("0 1 2 3\n", "expected at least 2 frames, got 1"),
        ("0 1 2 3\n10 1 2 3\n10 1 2 3\n", "pedestrian 1: expected one position in frame 10, got several"),
        ("0 1 2 3\n10 1 2 3\n20 1 2 3\n27 1 2 3\n", "expected frames 10 apart, got 20 and 27"),
    ]
    for text, message in cases:
        path.write_text(text)
        with pytest.raises(InputError, match=f"^{path}: .*{message}"):
            only(path)


# Argoverse 2


def argoverse2(folder, **changes):
    pd = pytest.importorskip("pandas", reason="needs the extra data")
    pytest.importorskip("pyarrow", reason="needs the extra data")
    rows = [
        {
            "track_id": name,
            "object_type": kind,
            "object_category": category,
            "timestep": k,
            "position_x": -400 + speed * 0.1 * k,
            "position_y": 1300.0 + 4 * i,
            "heading": 0.1,
            "velocity_x": speed * np.cos(0.1),
            "velocity_y": speed * np.sin(0.1),
        }
        for i, (name, kind, category, speed) in enumerate(
            [("AV", "vehicle", 1, 9.0), ("17", "pedestrian", 2, 1.0), ("18", "bus", 3, -2.0), ("19", "static", 0, 0.0)]
        )
        for k in range(110)
    ]
    frame = pd.DataFrame(rows)
    for column, value in changes.items():
        frame = frame.drop(columns=column) if value is None else frame.assign(**{column: value})
    path = folder / "scenario_xyz.parquet"
    frame.sample(frac=1.0, random_state=0).to_parquet(path)
    return path


def points(*xy):
    return [{"x": x, "y": y, "z": 1.0} for x, y in xy]


def segment(y=0.0, way=1, **more):
    ends = [(0.0, y), (30.0, y), (60.0, y)][::way]
    left, right = ([(x, y + d * way) for x, y in ends] for d in (2.0, -2.0))
    return {
        "centerline": points(*ends),
        "left_lane_boundary": points(*left[::2]),
        "right_lane_boundary": points(*right),
        "successors": [],
        "left_neighbor_id": None,
        "right_neighbor_id": None,
        **more,
    }


def write_map(folder, segments):
    path = folder / "log_map_archive_xyz.json"
    path.write_text(json.dumps({"lane_segments": segments, "drivable_areas": {}}))
    return path


def test_argoverse2(tmp_path):
    path = argoverse2(tmp_path)
    write_map(tmp_path, {"1": segment(), "2": segment(4.0)})
    r = only(path)
    assert (r.name, r.dt, r.focal, r.ego) == ("xyz", 0.1, ("18", "17"), "AV")
    by_name = {t.name: t for t in r.tracks}
    assert {n: (t.kind, t.length) for n, t in by_name.items()} == {
        "AV": ("vehicle", 4.5),
        "17": ("pedestrian", 0.6),
        "18": ("bus", 12.0),
        "19": ("static", 1.0),
    }
    np.testing.assert_allclose(by_name["AV"].positions[:, 0], -400 + 0.9 * np.arange(110))
    np.testing.assert_allclose(by_name["18"].speeds, -2.0)
    assert len(r.lanes) == 2
    assert len(windows([r], every=20, least=30)) == 3 * 4


def test_argoverse2_lanes(tmp_path):
    path = argoverse2(tmp_path)
    given = {
        "1": segment(0.0, successors=[4, 99], left_neighbor_id=2, right_neighbor_id=3),
        "2": segment(4.0, way=-1, centerline=None),
        "3": segment(-4.0),
        "4": segment(0.0),
    }
    write_map(tmp_path, given)
    lanes = {x.name: x for x in only(path).lanes}
    # of what the map names, only what it has, and of neighbours only those of the same direction
    assert (lanes["1"].successors, lanes["1"].neighbours) == (("4",), ("3",))
    for name, x in lanes.items():
        assert x.left.shape == x.right.shape == x.centre.shape
        np.testing.assert_allclose((x.left + x.right) / 2, x.centre, atol=1e-9, err_msg=name)
    assert lanes["2"].centre[0, 0] == 60.0


def test_what_is_no_argoverse2(tmp_path):
    with pytest.raises(InputError, match=r"scenario_xyz.parquet: not an Argoverse 2 scenario: .*heading"):
        only(argoverse2(tmp_path, heading=None))
    with pytest.raises(InputError, match=r"scenario_xyz.parquet: track '\w+': heading\[0\]: expected a finite number"):
        only(argoverse2(tmp_path, heading=np.nan))
    with pytest.raises(InputError, match=r"scenario_xyz.parquet: track '\w+': times\[1\]: expected times to increase"):
        only(argoverse2(tmp_path, timestep=3))
    with pytest.raises(InputError, match=r"scenario_xyz.parquet: could not convert string"):
        only(argoverse2(tmp_path, position_x="east"))
    path = argoverse2(tmp_path)
    for text, message in (
        ("{", "Expecting property name"),
        ("[]", "list indices"),
        ("{}", "no 'lane_segments'"),
        ('{"lane_segments": {"1": {}}}', "no 'left_lane_boundary'"),
        (json.dumps({"lane_segments": {"1": segment(left_lane_boundary=points((0, 0)))}}), None),
        (json.dumps({"lane_segments": {"1": segment(centerline=points((0, 0), (float("nan"), 1)))}}), "lane 1: points"),
        ('{"lane_segments": {"1": ' + "[" * 100_000 + "]" * 100_000 + "}}", ""),
    ):
        map_path = tmp_path / "log_map_archive_xyz.json"
        map_path.write_text(text)
        if message is None:
            assert len(only(path).lanes) == 1
        else:
            with pytest.raises(InputError, match=f"^{map_path}: not an Argoverse 2 map: .*{message}") as raised:
                only(path)
            assert "\n" not in str(raised.value)


def test_argoverse2_without_its_extra(tmp_path, monkeypatch):
    path = argoverse2(tmp_path)
    real = builtins.__import__

    def missing(name, *args, **kwargs):
        if name == "pandas":
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(InputError, match=r"reading parquet needs pandas and pyarrow: pip install '.\[data\]'"):
        only(path)


# on real data


@needs_data
def test_argoverse1_scenarios_give_each_agent_a_past():
    paths = sorted((DATA / "argoverse1").glob("*.csv"))[:60]
    found = [only(p) for p in paths]
    w = windows(found, least=0, every=100, focal=True)
    assert len(w) >= 58
    released = np.load(DATA / "argoverse1-predictions.npz")
    past = dict(zip(map(str, released["scenario_id"]), released["agent_past"], strict=True))
    apart = np.array([np.abs(w.past[i] - past[w.names[s]]).max() for i, s in enumerate(w.scenes)])
    # the others have gaps or another rate
    assert np.mean(apart < 1e-6) > 0.7


@needs_data
def test_argoverse1_speeds_by_stamps_agree_with_the_egos_own_constancy():
    """In slow scenarios an ego at steady speed stays so only if its stamps are believed."""
    r = only(DATA / "argoverse1" / "65731.csv")
    av = next(t for t in r.tracks if t.name == r.ego)
    assert av.speeds[5:].mean() == pytest.approx(5.9, abs=0.2)
    assert av.speeds[5:].std() < 0.3


@needs_data
def test_argoverse2_scenario():
    pytest.importorskip("pandas", reason="needs the extra data")
    r = only(DATA / "argoverse2")
    assert len(r.tracks) == 58
    assert (r.ego, r.focal[0], len(r.lanes)) == ("AV", "138951", 71)
    for track in r.tracks:
        if track.kind == "vehicle" and len(track.times) > 50 and track.speeds.mean() > 2:
            # stated velocities are those of the positions
            steps = np.hypot(*np.diff(track.positions, axis=0).T) / np.diff(track.times)
            assert steps.mean() == pytest.approx(np.abs(track.speeds).mean(), rel=0.1)


@needs_data
def test_eth_ucy_pedestrians_walk():
    found = list(open_data(DATA / "eth-ucy").recordings())
    assert sum(len(r.tracks) for r in found) == 2205
    w = windows(found, past=8, future=12, dt=0.4, every=4)
    assert 0.5 < np.median(w.speeds) < 1.8
    assert [len({*p.names}) for p in split(w, (0.6, 0.2, 0.2), 0)] == [8, 8, 8]


@needs_data
def test_commonroad_files_that_share_vehicles_are_one_group():
    pytest.importorskip("commonroad", reason="needs the extra commonroad")
    from predictor.datasets.commonroad import open_files  # noqa: PLC0415
    from predictor.fit_constant_velocity import linked  # noqa: PLC0415

    folder = DATA / "commonroad-ngsim"
    paths = tuple(sorted(folder.glob("*.xml"))[:10])
    found = list(open_files("ngsim", paths, None).recordings())
    assert [r.name for r in found] == [p.stem for p in paths]
    assert found[0].dt == 0.1
    assert found[0].lanes
    groups = linked({r.name: r.tracks for r in found})
    assert {frozenset(g) for g in groups} == {
        frozenset(r.name for r in found if r.group == group) for group in {r.group for r in found}
    }
    w = windows(found, every=5, least=30)
    assert np.isfinite(w.lanes[:, 0]).all()
    assert set(w.names) <= {r.group for r in found}
