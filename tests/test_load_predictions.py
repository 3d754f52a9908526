"""Predictions of other programs: small files written by hand, and what is wrong with bad ones."""

from __future__ import annotations

import json
import struct

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import riskplan as rp
from predictor import PowerGrowth
from riskplan.io.predictions import load_predictions

GROWTH = PowerGrowth(along=(0.3, 0.8, 1.2), across=(0.3, 0.3, 1.0))


def write(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content) if isinstance(content, bytes) else path.write_text(
        content if isinstance(content, str) else json.dumps(content)
    )
    return path


def refused(path, message, **options):
    options.setdefault("growth", GROWTH)
    with pytest.raises(rp.InputError) as caught:
        load_predictions(path, **options)
    assert str(caught.value) == f"{path}: {message}"


def read_or_refused(path):
    """Whatever is in the file: no other error than one line that names it."""
    message = None
    try:
        load_predictions(path, growth=GROWTH)
    except rp.InputError as error:
        message = str(error)
    assert message is None or (message.startswith(f"{path}: ") and "\n" not in message)


# ----------------------------------------------------------------------------------------------------
# nuScenes


def nuscenes(**changes):
    paths = [[[2.0 * t, 0.0] for t in range(1, 13)], [[2.0 * t, 0.1 * t] for t in range(1, 13)]]
    item = {"instance": "car-a", "sample": "s1", "prediction": paths, "probabilities": [0.7, 0.3]}
    return {**item, **changes}


def test_nuscenes(tmp_path):
    path = write(tmp_path, "n.json", [nuscenes(), nuscenes(instance="car-b", probabilities=[0.2, 0.8])])
    a, b = rp.load_predictions(path, growth=GROWTH)
    assert (a.name, b.name) == ("car-a", "car-b")
    np.testing.assert_array_equal(a.times, 0.5 * np.arange(1, 13))
    np.testing.assert_array_equal(a.means[:, 1], [[2.0 * t, 0.1 * t] for t in range(1, 13)])
    np.testing.assert_array_equal(b.weights, [0.2, 0.8])
    # along x at 1 s: 0.3² + 0.8²
    np.testing.assert_allclose(a.covariances[1, 0], np.diag([0.3**2 + 0.8**2, 0.3**2 + 0.3**2]), atol=1e-12)


def test_agents_for_a_scenario_on_the_file_s_own_grid(tmp_path):
    """The first prediction is half a second ahead: it serves a planning grid of half seconds."""
    agents = load_predictions(write(tmp_path, "n.json", [nuscenes()]), growth=GROWTH)
    scene = {"start": rp.State(0.0, 8.0, 0.0, 5.0), "goal": rp.Goal.at(20.0, 8.0), "bounds": (-50.0, -50.0, 50.0, 50.0)}
    scenario = rp.Scenario(**scene, agents=agents, time_step=0.5)
    assert scenario.horizon == 6.0
    poses = np.column_stack([5.0 * agents[0].times, 0.0 * agents[0].times + 8.0, 0.0 * agents[0].times])
    assert 0.0 < rp.path_risk(poses, agents, scenario.ego, "independent").total < 1.0


def test_a_spread_is_never_guessed(tmp_path):
    path = write(tmp_path, "n.json", [nuscenes()])
    refused(
        path,
        "growth: the format states no spread; pass a model of it, such as "
        "predictor.PowerGrowth(along=(0.3, 0.8, 1.2), across=(0.3, 0.3, 1.0))",
        growth=None,
    )


def test_one_of_several_samples(tmp_path):
    path = write(tmp_path, "n.json", [nuscenes(), nuscenes(sample="s2", instance="car-z")])
    refused(path, "scene: expected the sample token of one of 's1', 's2'; got None")
    assert [p.name for p in load_predictions(path, growth=GROWTH, scene="s2")] == ["car-z"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"probabilities": [0.7, 0.4]},
            "[0]: weights: expected weights that sum to 1, got a sum of 1.1; normalise=True divides them by it",
        ),
        ({"probabilities": [1.0]}, "[0]: probabilities: expected shape (2,), got (1,)"),
        (
            {"prediction": [[[1.0, 2.0, 3.0]]]},
            "[0].prediction: expected shape (modes, 1 to 12 steps at 2 Hz, 2), got (1, 1, 3)",
        ),
        (
            {"prediction": [[[1.0, True]]]},
            "[0].prediction: expected numbers in lists of equal length, got [[[1.0, True]]]",
        ),
        ({"instance": 7}, "[0].instance: expected text, got 7"),
        ({"prediction": []}, "[0].prediction: expected 1 to 1000 items, got 0"),
    ],
)
def test_bad_nuscenes(tmp_path, changes, message):
    refused(write(tmp_path, "n.json", [nuscenes(**changes)]), message)


def test_normalised_when_asked(tmp_path):
    path = write(tmp_path, "n.json", [nuscenes(probabilities=[2.0, 6.0])])
    np.testing.assert_allclose(load_predictions(path, growth=GROWTH, normalise=True)[0].weights, [0.25, 0.75])


# ----------------------------------------------------------------------------------------------------
# Waymo


def straight(speed, y=0.0):
    return {"centerX": [speed * 0.5 * t for t in range(1, 17)], "centerY": [y] * 16}


def waymo():
    modes = [{"trajectory": straight(8.0), "confidence": 0.75}, {"trajectory": straight(4.0, 1.0), "confidence": 0.25}]
    return {
        "submissionType": "MOTION_PREDICTION",
        "scenarioPredictions": [
            {"scenarioId": "abc", "singlePredictions": {"predictions": [{"objectId": 12, "trajectories": modes}]}}
        ],
    }


def snake(value):
    """The same with the names of the .proto, as MessageToJson(preserving_proto_field_name=True) writes them."""
    if isinstance(value, dict):
        return {"".join("_" + c.lower() if c.isupper() else c for c in k): snake(v) for k, v in value.items()}
    return [snake(v) for v in value] if isinstance(value, list) else value


@pytest.mark.parametrize("names", [lambda v: v, snake], ids=["camel", "snake"])
def test_waymo(tmp_path, names):
    (agent,) = load_predictions(write(tmp_path, "w.json", names(waymo())), growth=GROWTH)
    assert agent.name == "12"
    np.testing.assert_array_equal(agent.times, 0.5 * np.arange(1, 17))
    np.testing.assert_array_equal(agent.means[3], [[16.0, 0.0], [8.0, 1.0]])
    np.testing.assert_array_equal(agent.weights, [0.75, 0.25])


def test_waymo_joint(tmp_path):
    pair = [{"objectId": 1, "trajectory": straight(8.0)}, {"objectId": 2, "trajectory": straight(5.0)}]
    swapped = [{"objectId": 2, "trajectory": straight(6.0)}, {"objectId": 1, "trajectory": straight(9.0)}]
    joint = [{"trajectories": pair, "confidence": 0.6}, {"trajectories": swapped, "confidence": 0.4}]
    scene = {"scenarioId": "abc", "jointPrediction": {"jointTrajectories": joint}}
    first, second = load_predictions(write(tmp_path, "w.json", {"scenarioPredictions": [scene]}), growth=GROWTH)
    assert (first.name, second.name) == ("1", "2")
    np.testing.assert_array_equal(first.means[1, :, 0], [8.0, 9.0])
    np.testing.assert_array_equal(second.means[1, :, 0], [5.0, 6.0])
    joint[1]["trajectories"][0]["objectId"] = 3
    path = write(tmp_path, "w.json", {"scenarioPredictions": [scene]})
    at = "scenarioPredictions[0].jointPrediction.jointTrajectories[1].trajectories"
    refused(path, f"{at}: expected each object of the first joint trajectory once")


def test_bad_waymo(tmp_path):
    bad = waymo()
    bad["scenarioPredictions"][0]["singlePredictions"]["predictions"][0]["trajectories"][1]["trajectory"][
        "centerX"
    ].pop()
    where = "scenarioPredictions[0].singlePredictions.predictions[0].trajectories[1].trajectory.centerX"
    refused(write(tmp_path, "w.json", bad), f"{where}: expected 16 numbers, 8 s at 2 Hz, got (15,)")


def field(number, wire, body):
    return bytes([number << 3 | wire]) + body


def counted(number, body):
    return field(number, 2, varint(len(body)) + body)


def varint(value):
    out = b""
    while value > 127:
        out, value = out + bytes([value & 127 | 128]), value >> 7
    return out + bytes([value])


def wire(packed=True):
    """The submission of `waymo`, encoded by hand after the .proto."""
    modes = b""
    for mode in waymo()["scenarioPredictions"][0]["singlePredictions"]["predictions"][0]["trajectories"]:
        path = b""
        for number, key in ((2, "centerX"), (3, "centerY")):
            values = mode["trajectory"][key]
            if packed:
                path += counted(number, struct.pack("<16f", *values))
            else:
                path += b"".join(field(number, 5, struct.pack("<f", v)) for v in values)
        modes += counted(2, counted(1, path) + field(2, 5, struct.pack("<f", mode["confidence"])))
    scene = counted(1, b"abc") + counted(2, counted(1, field(1, 0, varint(12)) + modes))
    return counted(3, b"me@example.org") + field(2, 0, varint(1)) + counted(1, scene)


@pytest.mark.parametrize("packed", [True, False])
def test_waymo_bytes_say_what_the_json_says(tmp_path, packed):
    (a,) = load_predictions(write(tmp_path, "w.binproto", wire(packed)), growth=GROWTH)
    (b,) = load_predictions(write(tmp_path, "w.json", waymo()), growth=GROWTH)
    np.testing.assert_array_equal(a.means, b.means)
    assert a.name == b.name


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_waymo_bytes_cut_or_changed_are_refused_or_read(tmp_path, data):
    content = bytearray(wire())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path = write(tmp_path, "w.binproto", bytes(content[: data.draw(st.integers(0, len(content)))]))
    read_or_refused(path)


# ----------------------------------------------------------------------------------------------------
# Autoware


def pose(x, y, yaw):
    turn = f"{{x: 0.0, y: 0.0, z: {np.sin(yaw / 2)}, w: {np.cos(yaw / 2)}}}"
    return f"      - position: {{x: {x}, y: {y}, z: 0.0}}\n        orientation: {turn}\n"


def autoware(shape="type: 0\n    dimensions: {x: 4.2, y: 1.7, z: 1.5}", steps=(11, 9), second=100000000):
    paths = ""
    for k, (count, speed) in enumerate(zip(steps, (10.0, 5.0), strict=True)):
        poses = "".join(pose(round(speed * 0.1 * t, 6), 2.0, 0.25) for t in range(count))
        step = second if k else 100000000
        paths += (
            f"    - path:\n{poses}      time_step: {{sec: 0, nanosec: {step}}}\n      confidence: {(0.6, 0.4)[k]}\n"
        )
    return f"""header: {{stamp: {{sec: 5, nanosec: 0}}, frame_id: map}}
objects:
- object_id:
    uuid: [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15]
  existence_probability: 0.9
  kinematics:
    predicted_paths:
{paths}  shape:
    {shape}
---
"""


def test_autoware(tmp_path):
    (agent,) = load_predictions(write(tmp_path, "a.yaml", autoware()), growth=GROWTH)
    assert agent.name == "000102030405060708090a0b0c0d0e0f"
    assert (agent.length, agent.width) == (4.2, 1.7)
    np.testing.assert_allclose(agent.times, 0.1 * np.arange(9))  # of the shorter path
    np.testing.assert_allclose(agent.means[8], [[8.0, 2.0], [4.0, 2.0]])
    np.testing.assert_allclose(agent.headings, 0.25)
    np.testing.assert_array_equal(agent.weights, [0.6, 0.4])


@pytest.mark.parametrize(
    ("shape", "size"),
    [
        ("type: 1\n    dimensions: {x: 0.6, y: 0.5, z: 1.5}", (0.6, 0.6)),
        (
            "type: 2\n    footprint: {points: [{x: 1.5, y: 0.5}, {x: -2, y: -0.75}, {x: -1, y: 0.5}]}",
            (4.0, 1.5),
        ),
    ],
)
def test_autoware_shapes(tmp_path, shape, size):
    (agent,) = load_predictions(write(tmp_path, "a.yaml", autoware(shape)), growth=GROWTH)
    assert (agent.length, agent.width) == size


def test_bad_autoware(tmp_path):
    at = "objects[0].kinematics.predicted_paths"
    path = write(tmp_path, "a.yaml", autoware(second=200000000))
    refused(path, f"{at}: expected one time_step for all paths, got 0.1 and 0.2")
    path = write(tmp_path, "a.yaml", autoware("type: 7"))
    refused(path, "objects[0].shape.type: expected 0 (box), 1 (cylinder) or 2 (polygon), got 7")
    path = write(tmp_path, "a.yaml", autoware().replace("w: 0.99", "w: 1.99", 1))
    refused(path, f"{at}[0].path[0].orientation: expected a unit quaternion, got one of squared size 3.9844")
    path = write(tmp_path, "a.yaml", autoware().replace("15]", "15, 16]"))
    refused(path, "objects[0].object_id.uuid: expected 16 bytes, got 17 values")


# ----------------------------------------------------------------------------------------------------
# arrays and tables


def arrays(**changes):
    times = np.arange(1, 6) * 0.5
    means = np.zeros((2, 5, 3, 2))
    means[..., 0] = 6.0 * times[:, None] + np.arange(3)
    values = {
        "times": times,
        "weights": np.full((2, 3), 1 / 3),
        "means": means,
        "covariances": np.broadcast_to(np.diag([0.5, 0.25]), (2, 5, 3, 2, 2)),
        "names": np.array(["a", "b"]),
        "lengths": np.array([4.0, 5.0]),
        "widths": np.array([1.5, 1.75]),
        "headings": np.zeros((2, 5, 3)),
    }
    return {k: v for k, v in {**values, **changes}.items() if v is not None}


def save_npz(tmp_path, **changes):
    np.savez(tmp_path / "p.npz", **arrays(**changes))
    return tmp_path / "p.npz"


def test_npz(tmp_path):
    a, b = load_predictions(save_npz(tmp_path))
    assert (a.name, b.length, b.width) == ("a", 5.0, 1.75)
    np.testing.assert_array_equal(b.means, arrays()["means"][1])
    np.testing.assert_array_equal(b.covariances[2, 1], np.diag([0.5, 0.25]))


def test_npz_without_covariances_needs_a_growth(tmp_path):
    path = save_npz(tmp_path, covariances=None)
    a, _ = load_predictions(path, growth=GROWTH)
    np.testing.assert_allclose(a.covariances[1, 0], np.diag([0.3**2 + 0.8**2, 2 * 0.3**2]))
    with pytest.raises(rp.InputError, match="growth: the format states no spread"):
        load_predictions(path)


def test_npz_of_one_saved_prediction(tmp_path):
    (a, _) = load_predictions(save_npz(tmp_path))
    a.save(tmp_path / "one.npz")
    (back,) = load_predictions(tmp_path / "one.npz")
    np.testing.assert_array_equal(back.means, a.means)


def test_bad_npz(tmp_path):
    refused(save_npz(tmp_path), "growth: expected None, as the file states covariances of its own")
    refused(save_npz(tmp_path, weights=None), "weights: missing; the file has covariances, headings, lengths, means, "
            "names, times, widths", growth=None)  # fmt: skip
    known = "covariances, headings, lengths, means, modes, names, times, weights, widths"
    refused(save_npz(tmp_path, speeds=np.zeros(2)), f"speeds: expected one of {known}", growth=None)
    refused(save_npz(tmp_path, names=np.zeros(2)), "names: expected 2 texts, got float64 of shape (2,)", growth=None)
    path = save_npz(tmp_path, names=np.array([object(), object()]))
    refused(path, "not a file of predictions: names.npy: it holds pickled objects", growth=None)
    path = write(tmp_path, "q.npz", b"PK\x03\x04 nothing")
    refused(path, "not a file of predictions: it is no archive of arrays", growth=None)
    refused(tmp_path / "none.npz", "no such file", growth=None)


def table(covariance=True):
    values = arrays()
    rows = {key: [] for key in ("agent", "mode", "weight", "time", "x", "y", "length", "width", "heading")}
    for a, t, k in np.ndindex(2, 5, 3):
        x, y = values["means"][a, t, k]
        row = ("ab"[a], k, 1 / 3, values["times"][t], x, y, values["lengths"][a], values["widths"][a], 0.0)
        for key, value in zip(rows, row, strict=True):
            rows[key].append(value)
    if covariance:
        rows |= {"cov_xx": [0.5] * 30, "cov_xy": [0.0] * 30, "cov_yy": [0.25] * 30}
    return rows


@pytest.fixture
def save_parquet(tmp_path):
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")

    def save(rows, order=None):
        whole = pa.table(rows)
        pq.write_table(whole if order is None else whole.take(order), tmp_path / "p.parquet")
        return tmp_path / "p.parquet"

    return save


def test_parquet_says_what_npz_says(tmp_path, save_parquet):
    shuffled = np.random.default_rng(0).permutation(30)
    got, want = load_predictions(save_parquet(table(), shuffled)), load_predictions(save_npz(tmp_path))
    for a, b in zip(got, want, strict=True):
        assert (a.name, a.length, a.width) == (b.name, b.length, b.width)
        for key in ("times", "weights", "means", "covariances", "headings"):
            np.testing.assert_allclose(getattr(a, key), getattr(b, key), rtol=1e-15)


def test_bad_parquet(tmp_path, save_parquet):
    with pytest.raises(rp.InputError, match="growth: the format states no spread"):
        load_predictions(save_parquet(table(covariance=False)))
    columns = table()
    del columns["weight"]
    with pytest.raises(rp.InputError, match="weight: missing; the columns are agent, mode, time"):
        load_predictions(save_parquet(columns))
    with pytest.raises(rp.InputError, match="agent 'b': expected each of 3 modes at each of 5 times, once"):
        load_predictions(save_parquet({k: v[:-1] for k, v in table().items()}))
    columns = table()
    columns["weight"][4] = 0.5
    with pytest.raises(rp.InputError, match="agent 'a': weight of mode 1: expected one value, got 0.333333 to 0.5"):
        load_predictions(save_parquet(columns))
    columns = table()
    columns["x"][3] = None
    with pytest.raises(rp.InputError, match=r"x\[3\]: expected a finite number, got nan"):
        load_predictions(save_parquet(columns))
    with pytest.raises(rp.InputError, match="not a parquet file"):
        load_predictions(write(tmp_path, "q.parquet", b"PAR1 nothing PAR1"))


def test_agents_of_a_scenario():
    path = "riskplan/data/overtake.yaml"
    assert [a.name for a in load_predictions(path)] == [a.name for a in rp.load_scenario(path).agents]


# ----------------------------------------------------------------------------------------------------
# everything else


def test_formats_and_suffixes(tmp_path):
    path = write(tmp_path, "n.json", [nuscenes()])
    refused(write(tmp_path, "list.json", [1]), "the document: expected a mapping, got [1]", format="waymo")
    with pytest.raises(
        rp.InputError, match="^format: expected one of scenario, nuscenes, waymo, autoware, npz, parquet"
    ):
        load_predictions(path, format="argoverse")
    refused(
        write(tmp_path, "x.json", {"a": 1}),
        "expected nuScenes, Waymo or Autoware predictions; the content is of none of them",
    )
    path = write(tmp_path, "x.txt", "1 2 3")
    refused(path, "expected predictions in one of .json, .yaml, .yml, .xml, .npz, .parquet, .binproto, .pb; got .txt")


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"[",
        b"[" * 100_000,
        b"[1e999]",
        b'[{"instance": "a", "sample": "s", "prediction": [[[NaN, 0]]], "probabilities": [1]}]',
        b'[{"instance": "a", "sample": "s", "prediction": [[[1e400, 0]]], "probabilities": [1]}]',
        b'[{"instance": "a", "sample": "s", "prediction": [[[' + b"9" * 5000 + b', 0]]], "probabilities": [1]}]',
        b'{"objects": [{"kinematics": 3}]}',
        b'{"scenarioPredictions": {}}',
        b"\xff\xfe",
    ],
)
def test_hostile_json(tmp_path, content):
    path = write(tmp_path, "h.json", content)
    with pytest.raises(rp.InputError) as caught:
        load_predictions(path, growth=GROWTH)
    assert str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)


def test_hostile_yaml(tmp_path):
    bomb = "a: &a [1, 2]\nb: &b [*a, *a]\nobjects: [*b, *b]\n"
    path = write(tmp_path, "h.yaml", bomb)
    with pytest.raises(rp.InputError, match="anchors and aliases are not supported"):
        load_predictions(path, growth=GROWTH)
    path = write(tmp_path, "h.yaml", "objects: !!python/object/apply:os.system [echo]\n")
    with pytest.raises(rp.InputError, match="tags are not supported"):
        load_predictions(path, growth=GROWTH)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_documents_with_a_part_replaced(tmp_path, data):
    """Any value anywhere in a valid document, by another type: read, or refused in one line."""
    document = data.draw(st.sampled_from([[nuscenes()], waymo()]))
    document = json.loads(json.dumps(document))
    place, key = [document], 0
    for _ in range(data.draw(st.integers(1, 9))):
        inner = place[key]
        if not isinstance(inner, dict | list) or not inner:
            break
        place, key = inner, data.draw(st.sampled_from(list(inner) if isinstance(inner, dict) else range(len(inner))))
    junk = [None, True, -1, 10**30, 1e308, "text", [], {}, [[]], {"a": 1}]
    if place != [document]:
        place[key] = data.draw(st.sampled_from(junk))
    path = write(tmp_path, "r.json", document)
    read_or_refused(path)
