"""Malformed files: what campaigns found once, and a small campaign over every importer (`python -m tests.fuzz`)."""

import io
import json
import os
import time
import zipfile
from xml.etree import ElementTree

import numpy as np
import pytest
from fuzz import corpus, foreign
from fuzz.__main__ import IMPORTERS
from fuzz.campaign import SHARES, made, maker, seeds
from fuzz.targets import Finding, Targets, finite
from fuzz.trial import limits, tried
from hypothesis import given, settings
from hypothesis import strategies as st

import riskplan as rp
from checkers.archive import LARGEST
from predictor.check_commonroad import checked_content

NEEDS = {"xml": "commonroad", "argoverse2": "pandas", "agents-parquet": "pyarrow"}


@pytest.fixture(scope="module")
def targets(tmp_path_factory):
    return Targets(tmp_path_factory.mktemp("fuzz")).all()


@pytest.fixture
def refusal(tmp_path):
    """The line that refuses a file."""

    def read(content, name, load=None):
        path = tmp_path / name
        path.write_bytes(content)
        with limits(400), pytest.raises(rp.InputError) as error:
            (load or rp.load_scenario)(path)
        assert str(error.value).startswith(str(path))
        return str(error.value).removeprefix(str(path))

    return read


@pytest.mark.parametrize("target", SHARES)
def test_seeds_are_accepted(targets, target):
    if target in NEEDS:
        pytest.importorskip(NEEDS[target])
    given = [words for words in seeds(target) if target != "cli" or words[0] in ("checkers", "planners", "assess")]
    assert given and all(targets[target](seed) for seed in given)


def test_every_target_can_be_asked_for():
    assert set(IMPORTERS) == set(SHARES)
    assert sum(SHARES.values()) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("target", "count"),
    [("yaml", 60), ("plan", 80), ("npz", 150), ("xml", 60), ("roadmap", 60), *((name, 40) for name in foreign.FILES)],
)
def test_a_small_campaign_finds_nothing(targets, target, count):
    if target in NEEDS:
        pytest.importorskip(NEEDS[target])
    make, found = maker(target), []
    with limits(1500):
        for i in range(count):
            data = made(make, f"test:{target}:{i}")
            _, finding, _ = tried(targets[target], data, 20.0)
            found += [finding] if finding else []
    assert found == []


@settings(max_examples=25, deadline=None)
@given(st.binary(max_size=300), st.sampled_from(["yaml", "plan", "npz", "xml", "roadmap", *foreign.FILES]))
def test_any_bytes_are_refused_by_one_line(targets, data, target):
    targets[target](data)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=12,
)


@settings(max_examples=40, deadline=None)
@given(JSON, st.sampled_from(sorted(corpus.plan())), st.sampled_from(["yaml", "plan"]))
def test_any_value_in_any_place(targets, value, key, target):
    seed = corpus.plan() if target == "plan" else corpus.scenarios()[1]
    place = key if target == "plan" else sorted(seed)[len(key) % len(seed)]
    targets[target](corpus.yaml_bytes({**seed, place: value}))


@settings(max_examples=25, deadline=None)
@given(st.lists(st.text(max_size=12) | st.sampled_from(["plan", "assess", "{scene}", "--json", "--bound"]), max_size=6))
def test_any_command_line(targets, words):
    if not {"demo", "render", "train", "batch"} & set(words):  # these write what they are told to
        targets["cli"](words)


def broken(_):
    return {}["a"]


def slow(_):
    while True:
        pass


def waiting(_):
    time.sleep(60)


class Compiled:
    """Slow where it is called first, as kernels are."""

    ready = False

    def __call__(self, _):
        end = time.process_time() + 0.3
        while not self.ready and time.process_time() < end:
            pass
        self.ready = True
        return True


def greedy(_):
    return np.ones(10**8)


def test_the_campaign_sees_what_is_wrong(targets, monkeypatch):
    monkeypatch.setattr("fuzz.targets.rp.load_plan", broken)
    assert tried(targets["plan"], b"{}", 5.0)[1].startswith("KeyError")
    with pytest.raises(Finding, match="not finite"):
        finite("a", np.array([np.inf]))
    with limits(200):
        assert "took more than 0.1 s" in tried(slow, b"", 0.1)[1]
        assert "took more than 0.02 s" in tried(waiting, b"", 0.02)[1]
        assert tried(Compiled(), b"", 0.1)[:2] == (True, "")
        assert tried(greedy, b"", 5.0)[1].startswith("MemoryError")


# archives


def member(header, data=b""):
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        text = repr(header).encode() + b"\n"
        archive.writestr("times.npy", b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + data)
    return out.getvalue()


@pytest.mark.parametrize("shape", [(10**12,), (10**30,), (-1,), (3, 10**8)])
def test_a_header_that_lies_is_not_believed(refusal, shape):
    header = {"descr": "<f8", "fortran_order": False, "shape": shape}
    assert "its data is of another size" in refusal(member(header, bytes(24)), "a.npz", rp.load_prediction)


def test_a_bomb_is_not_unpacked(refusal):
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("times.npy", "w") as file:
        for _ in range(LARGEST // 10_000_000 + 1):
            file.write(bytes(10_000_000))
    assert len(out.getvalue()) < 1e6
    assert "expected at most 64 arrays of 500 MB" in refusal(out.getvalue(), "a.npz", rp.load_prediction)


@pytest.mark.parametrize("load", [rp.load_prediction, rp.Roadmap.load])
def test_damaged_archives(refusal, load):
    whole = corpus.npz(corpus.predictions()[0])
    for cut in (0, 10, len(whole) // 2, len(whole) - 5):
        assert "not a" in refusal(whole[:cut], "a.npz", load)
    assert "pickled" in refusal(member({"descr": "|O", "fortran_order": False, "shape": (1,)}), "a.npz", load)
    dates = {**corpus.predictions()[0], **corpus.roadmap(), "times": np.array(["2026-01-01"], dtype="M8[s]")}
    assert "expected numbers or text, got datetime64[s]" in refusal(corpus.npz(dates), "a.npz", load)


def test_what_is_no_file_is_not_waited_for(tmp_path):
    pipe = tmp_path / "pipe.yaml"
    os.mkfifo(pipe)
    for load in (rp.load_scenario, rp.load_plan, rp.load_prediction, rp.Roadmap.load, checked_content):
        for path, why in ((pipe, "no plain file"), (tmp_path, "directory"), ("/dev/zero", "no plain file")):
            if load is rp.load_scenario and path is not pipe:
                continue
            with pytest.raises(rp.InputError, match=why):
                load(path)


# text


def test_values_are_counted_before_they_fill_the_memory(refusal):
    many = b"[" + b"[]," * 2_000_001 + b"0]"
    assert "expected at most 1000000 values" in refusal(many, "a.yaml")
    assert "expected at most 1000000 values" in refusal(many, "a.json", rp.load_plan)


def test_deep_nesting_and_long_values_stay_one_short_line(refusal):
    d = {**corpus.plan(), "stats": json.loads("[" * 400 + "]" * 400)}
    assert "32 levels" in refusal(corpus.yaml_bytes(d), "a.json", rp.load_plan)
    line = refusal(corpus.yaml_bytes({**corpus.plan(), "bound": "x\n" * 100_000}), "a.json", rp.load_plan)
    assert len(line) < 1000 and "\n" not in line
    many = corpus.scenarios()[0] | {"obstacles": [1] * 900_000}
    assert "obstacles[0]: expected a list, got 1" in refusal(corpus.yaml_bytes(many), "a.yaml")


def test_grids_and_shapes_of_any_size_are_refused(refusal):
    base = corpus.scenarios()[7]
    endless = {**base, "horizon": 1e9, "time_step": 0.001}
    assert "expected at most 100000 steps" in refusal(corpus.yaml_bytes(endless), "a.yaml")
    many = {**base, "ego": {"discs": {"length": 4, "width": 2, "n": 10**9}}}
    assert "n: expected an integer from 1 to 1000" in refusal(corpus.yaml_bytes(many), "a.yaml")
    teeth = [[0.001 * i, float(i % 2)] for i in range(4000)]
    comb = [[0.0, -1.0], *teeth, [4.0, -1.0], [2.0, -1.0], [2.0, 0.0], [1.9, -1.0]]  # its back touches a tooth
    assert "touches itself" in refusal(corpus.yaml_bytes({**base, "obstacles": [comb]}), "a.yaml")
    rp.GoalRegion(comb[:-3])
    far = {**base, "lanes": [[[0, 0], [1e308, 0]]]}
    assert "lanes[0][1, 0]: expected a size of at most 1e+09" in refusal(corpus.yaml_bytes(far), "a.yaml")


def test_crossings_of_long_polygons_are_still_found():
    angles = np.linspace(0, 2 * np.pi, 1000, endpoint=False)
    ring = np.column_stack([np.cos(angles), np.sin(angles)])
    rp.GoalRegion(ring)
    ring[[600, 700]] = ring[[700, 600]]
    with pytest.raises(rp.InputError, match="edges 599 and [67].. that cross"):
        rp.GoalRegion(ring)


def test_plans_state_probabilities(refusal):
    for key in ("per_agent", "per_step"):
        d = corpus.plan()
        d["risk"][key][0] = 1.5
        assert f"risk.{key}[0]: expected a number in [0, 1]" in refusal(corpus.yaml_bytes(d), "a.json", rp.load_plan)
    d = corpus.plan()
    d["marginals"][0][1][0] = -1e-3
    assert "marginals[0][1, 0]" in refusal(corpus.yaml_bytes(d), "a.json", rp.load_plan)


def test_ragged_weights_of_random_variables():
    for make in (lambda w: rp.Discrete([0, 1], w), lambda w: rp.Mixture(w, (rp.Normal(0, 1), rp.Normal(1, 1)))):
        with pytest.raises(rp.InputError, match="weights"):
            make([[1], 0.0])


# CommonRoad


def spoilt(find, change):
    root = ElementTree.fromstring(corpus.commonroad())
    for node in root.findall(find):
        change(node)
    return ElementTree.tostring(root)


def text(value):
    return lambda node: setattr(node, "text", value)


@pytest.mark.parametrize(
    ("find", "value", "message"),
    [
        (".//initialState/orientation/exact", "1e300", "orientation exact: expected a number in [-10000, 10000]"),
        (".//goalState//orientation", "1e300", "orientation: expected a number in [-10000, 10000]"),
        (".//goalState/time/intervalEnd", "1e8", "time intervalEnd: expected a number in [-100000, 100000]"),
        (".//leftBound/point/x", "1e308", "lanelet 1: leftBound point x: expected a number"),
    ],
)
def test_numbers_that_the_reader_never_comes_back_from(refusal, find, value, message):
    assert message in refusal(spoilt(find, text(value)), "a.xml")


def test_neighbours_that_lead_in_a_circle(refusal):
    circle = spoilt(".//adjacentRight", lambda node: setattr(node, "tag", "adjacentLeft"))
    assert "its neighbours by adjacentLeft lead back to" in refusal(circle, "a.xml")
    many = b"".join(
        b'<lanelet id="%d"><adjacentLeft ref="%d" drivingDir="same"/></lanelet>' % (i, (i + 1) % 5000)
        for i in range(5000)
    )
    assert "lead back to" in refusal(b"<commonRoad>" + many + b"</commonRoad>", "a.xml")


def test_xml_that_is_no_xml(refusal):
    assert "malformed XML" in refusal(b'<?xml version="1.0" encoding="nothing-8"?><commonRoad/>', "a.xml")
    assert "64 deep" in refusal(b"<commonRoad>" * 1000, "a.xml")
    step = spoilt(".", lambda node: node.set("timeStepSize", "0"))
    assert "timeStepSize: expected a number in [0.001, 1000]" in refusal(step, "a.xml")
