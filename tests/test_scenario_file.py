"""The own scenario format: bit for bit there and back, and one clear line for everything that is wrong."""

# ruff: noqa: E501  one case, one line

import dataclasses
import json
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import riskplan as rp
from riskplan.io import yaml_text
from riskplan.io.scenario_text import scenario_text
from riskplan.io.yaml_text import number_text, parse_yaml, quoted

DATA = Path(rp.__file__).parent / "data"
SMALL = """
version: 1
name: small
time_step: 0.5
bounds: [-10, -5, 60, 5]
start: {x: 0, y: 0, heading: 0, speed: 1e1}
goal: {time: [1, .inf], regions: [{circle: {x: 25, y: 0, radius: 4}, speed: [0, .inf]}]}
agents:
  - name: car
    length: 4.5
    gaussian:
      times: {step: 5e-1, count: 3}
      weights: [0.4, 0.6]
      means: [[[20, 3.5], [22, 1e-3]], [[21, 3.5], [23, 0]], [[22, 3.5], [24, 0]]]
      covariances:
        - [[[0.3, 0], [0, 0.2]], [[0.1, 0.05], [0.05, 0.2]]]
        - [[[0.3, 0], [0, 0.2]], [[0.1, 0.05], [0.05, 0.2]]]
        - [[[0.3, 0], [0, 0.2]], [[0.1, 0.05], [0.05, 0.2]]]
"""


def load(tmp_path, text, name="scene.yaml"):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return rp.load_scenario(path)


def refusal(tmp_path, text):
    with pytest.raises(rp.InputError) as caught:
        load(tmp_path, text)
    message = str(caught.value)
    assert message.startswith(str(tmp_path / "scene.yaml"))
    assert "\n" not in message
    return message.removeprefix(f"{tmp_path / 'scene.yaml'}: ")


def same(a, b):
    """Bit for bit, NaN included, through dataclasses and tuples."""
    if dataclasses.is_dataclass(a):
        return type(a) is type(b) and all(same(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a))
    if isinstance(a, tuple):
        return len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, np.ndarray):
        return a.shape == b.shape and a.dtype == b.dtype and a.tobytes() == b.tobytes()
    return a == b


def test_reads_a_hand_written_file(tmp_path):
    s = load(tmp_path, SMALL)
    assert s.name == "small"
    assert s.start == rp.State(0.0, 0.0, 0.0, 10.0)
    assert s.goal.time == (1.0, np.inf)
    assert s.horizon == 1.0
    car = s.agents[0]
    assert (car.name, car.length, car.modes) == ("car", 4.5, "persistent")
    assert car.times.tolist() == [0.0, 0.5, 1.0]
    assert car.means[0, 1].tolist() == [22.0, 0.001]


@pytest.mark.parametrize(
    ("ego", "expected"),
    [
        ("{ellipsoid: {Q: [[0.1, 0], [0, 0.5]]}}", rp.EgoEllipsoid([[0.1, 0], [0, 0.5]])),
        ("{ellipsoid: {length: 4, width: 2}}", rp.EgoEllipsoid.around(4, 2)),
        ("{ellipsoid: {length: 4, width: 2, relative_heading: 0}}", rp.EgoEllipsoid.around(4, 2, relative_heading=0)),
        ("{discs: {length: 4, width: 2}}", rp.EgoCover.discs(4, 2)),
        ("{discs: {length: 4, width: 2, n: 3, agent_length: 1}}", rp.EgoCover.discs(4, 2, 3, 1)),
        ("{box: {length: 4, width: 2}}", rp.EgoBox(4, 2)),
        ("{aligned: {length: 4, width: 2}}", rp.EgoEllipsoid.aligned(4, 2)),
    ],
)
def test_ego_shapes(tmp_path, ego, expected):
    s = load(tmp_path, SMALL.replace("length: 4.5", "length: 4.5\n    width: 1.8") + f"ego: {ego}\n")
    assert type(s.ego) is type(expected)
    rp.save_scenario(s, tmp_path / "again.yaml")
    assert s.ego == rp.load_scenario(tmp_path / "again.yaml").ego or isinstance(s.ego, rp.EgoEllipsoid)
    for mine, wanted in zip(s.ego.pieces(s.agents[0]), expected.pieces(s.agents[0]), strict=True):
        assert np.array_equal(mine, wanted)


def test_regions_polygon_circle_box(tmp_path):
    text = SMALL.replace(
        "{circle: {x: 25, y: 0, radius: 4}, speed: [0, .inf]}",
        "{box: [1, 2, 3, 4], heading: 1}, {polygon: [[0, 0], [1, 0], [0, 1]]}",
    )
    box, triangle = load(tmp_path, text).goal.regions
    assert box.polygon.tolist() == [[1, 2], [3, 2], [3, 4], [1, 4]]
    assert box.heading == 1.0
    assert triangle.polygon.tolist() == [[0, 0], [1, 0], [0, 1]]


def test_agents_beside_the_file(tmp_path):
    rp.load_scenario(DATA / "overtake.yaml").agents[0].save(tmp_path / "car.npz")
    head = SMALL[: SMALL.index("agents:")].replace("0.5", "0.1")
    s = load(tmp_path, head + "agents:\n  - {file: car.npz, name: renamed}\n")
    assert s.agents[0].name == "renamed"
    assert np.array_equal(s.agents[0].means, rp.load_scenario(DATA / "overtake.yaml").agents[0].means)


@pytest.mark.parametrize("name", ["../car.npz", "/car.npz", "C:/car.npz", "car.txt", "a/../../car.npz"])
def test_agents_from_elsewhere_are_refused(tmp_path, name):
    head = SMALL[: SMALL.index("agents:")]
    message = refusal(tmp_path, head + f"agents:\n  - {{file: {name}}}\n")
    assert message == f"agents[0]: file: expected an .npz in the scenario's directory or below, got {name!r}"


@pytest.mark.parametrize("content", [b"PK\x03\x04 no zip", b"junk", b""])
def test_broken_agent_file(tmp_path, content):
    (tmp_path / "car.npz").write_bytes(content)
    message = refusal(tmp_path, SMALL[: SMALL.index("agents:")] + "agents:\n  - {file: car.npz}\n")
    assert message.startswith(f"agents[0]: {tmp_path / 'car.npz'}: not a prediction file")


WRONG = {
    "unknown key": ("heading: 0", "hedaing: 0", "start.hedaing: unknown key; expected one of x, y, heading, speed, steering"),
    "missing key": ("heading: 0, ", "", "start.heading: missing; expected keys x, y, heading"),
    "text": ("x: 0", "x: abc", "start.x: expected a number, got 'abc'"),
    "boolean": ("x: 0", "x: true", "start.x: expected a number, got True"),
    "nothing": ("x: 0", "x: null", "start.x: expected a number, got nothing"),
    "nan": ("x: 0", "x: .nan", "start.x: expected a finite number, got nan"),
    "infinite": ("x: 0", "x: 1e999", "start.x: expected a finite number, got inf"),
    "huge": ("x: 0", "x: 1" + 5000 * "0", "start.x: expected a finite number, got inf"),
    "nan window": ("[1, .inf]", "[1, .nan]", "goal.time[1]: expected a finite number, got nan"),
    "infinite start of the window": ("[1, .inf]", "[-.inf, 1]", "goal.time[0]: expected a finite number, got -inf"),
    "empty window": ("[1, .inf]", "[2, 1]", "goal.time: expected lowest <= highest, got (2, 1)"),
    "negative radius": ("radius: 4", "radius: -4", "goal.regions[0].circle.radius: expected a number > 0, got -4"),
    "no region": ("{circle: {x: 25, y: 0, radius: 4}, speed: [0, .inf]}", "", "goal.regions: expected at least 1 items, got 0"),
    "two shapes": ("{circle:", "{box: [0, 0, 1, 1], circle:", "goal.regions[0]: expected exactly one of polygon, circle, box; got box, circle, speed"),
    "version": ("version: 1", "version: 2", "version: expected 1, got 2"),
    "bounds": ("[-10, -5, 60, 5]", "[-10, -5, 60]", "bounds: expected at least 4 items, got 3"),
    "outside": ("x: 0", "x: 99", "start: (99, 0) lies outside the bounds [-10.0, -5.0, 60.0, 5.0]"),
    "horizon": ("time_step: 0.5", "time_step: 0.5\nhorizon: 0.7", "horizon: expected a whole number of steps of 0.5 s, got 0.7 s"),
    "weights": ("0.6", "0.5", "agents[0] (car): weights: expected weights that sum to 1, got a sum of 0.9"),
    "times": ("{step: 5e-1, count: 3}", "[0, 0.5, 0.4]", "agents[0] (car): times[2]: expected times to increase, got 0.4 after 0.5"),
    "count": ("count: 3", "count: 4", "agents[0] (car): means: expected shape (4, K, 2), got (3, 2, 2)"),
    "covariance": ("[0.1, 0.05], [0.05,", "[0.1, 0.9], [0.9,", "agents[0] (car): covariances[0, 1]: expected a positive semi-definite matrix, got [[0.1, 0.9], [0.9, 0.2]]"),
    "nan mean": ("1e-3", ".nan", "agents[0] (car): means[0, 1, 1]: expected a finite number, got nan"),
    "quoted mean": ("1e-3", "'1e-3'", "agents[0] (car): means: expected numbers, got [[[20, 3.5], [22, '1e-3']], [[21, 3.5], [23, 0]], [[22, 3..."),
    "modes": ("weights:", "modes: sometimes\n      weights:", "agents[0].gaussian.modes: expected one of persistent, per_step; got 'sometimes'"),
    "no prediction": ("gaussian:", "gauss:", "agents[0].gauss: unknown key; expected one of name, length, width, headings, factors, file, gaussian, moments, controls"),
    "ego": ("version: 1", "version: 1\nego: {}", "ego: expected exactly one of discs, ellipsoid, box, aligned; got none"),
    "Q": ("version: 1", "version: 1\nego: {ellipsoid: {Q: [[1, 2], [2, 1]]}}", "ego.ellipsoid.Q: expected a positive definite matrix, got [[1.0, 2.0], [2.0, 1.0]]"),
    "twice": ("name: small", "name: a\nname: b", "line 4, column 1: name: key appears twice"),
    "anchor": ("name: small", "name: &a small", "line 3, column 7: anchors and aliases are not supported: repeat the value, or keep it in an .npz"),
    "alias": ("name: small", "name: *a", "line 3, column 7: anchors and aliases are not supported: repeat the value, or keep it in an .npz"),
    "tag": ("x: 0", "x: !!python/name:os.system 0", "line 6, column 12: tags are not supported, got tag:yaml.org,2002:python/name:os.system"),
    "merge": ("start: {", "start: {<<: {x: 1}, ", "start.'<<': unknown key; expected one of x, y, heading, speed, steering"),
    "deep": ("x: 0", "x: " + 500 * "[" + 500 * "]", "line 6, column 42: expected at most 32 levels of lists and mappings"),
    "two documents": ("version: 1", "version: 1\n---\na: 1", "line 3, column 1: expected one YAML document, got a second one"),
    "malformed": ("bounds: [", "bounds: [[", "line 6, column 1: not valid YAML: did not find expected ',' or ']'"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_one_line_says_what_is_wrong(tmp_path, case):
    old, new, expected = WRONG[case]
    assert old in SMALL
    assert refusal(tmp_path, SMALL.replace(old, new, 1)) == expected


@pytest.mark.parametrize("text", ["", "# nothing\n", "[]", "text", "1"])
def test_documents_that_are_no_scenario(tmp_path, text):
    assert refusal(tmp_path, text).startswith("the document: expected a mapping, got ")


@pytest.mark.parametrize("content", [b"\x00", b"a: \xff\xfe", b"\xff\xfea", b"\x80", b"%YAML 9\n---", b"a: \x07"])
def test_bytes_that_are_no_text(tmp_path, content):
    path = tmp_path / "scene.yaml"
    path.write_bytes(content)
    with pytest.raises(rp.InputError, match="not valid YAML|expected a mapping"):
        rp.load_scenario(path)


@settings(max_examples=300, deadline=None)
@given(st.one_of(st.binary(max_size=60), st.text(alphabet="ab:-[]{},'\"&*!|>%@ \n#?<1.e", max_size=40).map(str.encode)))
def test_any_bytes_parse_or_are_refused(content):
    message = ""
    try:
        parse_yaml(content, "fuzz.yaml")
    except rp.InputError as error:
        message = str(error)
    assert "\n" not in message


def test_suffixes_and_places(tmp_path):
    with pytest.raises(
        rp.InputError, match=r"expected a scenario in one of .yaml, .yml, .xml, .csv, .parquet; got .txt$"
    ):
        rp.load_scenario(tmp_path / "a.txt")
    with pytest.raises(rp.InputError, match="a.parquet: no such file"):
        rp.load_scenario(tmp_path / "a.parquet")
    with pytest.raises(rp.InputError, match="no such file"):
        rp.load_scenario(tmp_path / "a.yaml")
    (tmp_path / "dir.yaml").mkdir()
    with pytest.raises(rp.InputError, match="cannot be read"):
        rp.load_scenario(tmp_path / "dir.yaml")
    with pytest.raises(rp.InputError, match="problem: expected 0"):
        rp.load_scenario(DATA / "overtake.yaml", problem=1)
    with pytest.raises(rp.InputError, match="expected the suffix .yaml"):
        rp.save_scenario(rp.load_scenario(DATA / "overtake.yaml"), tmp_path / "a.json")
    with pytest.raises(rp.InputError, match="cannot be written"):
        rp.save_scenario(rp.load_scenario(DATA / "overtake.yaml"), tmp_path / "no" / "a.yaml")


def test_too_large(tmp_path, monkeypatch):
    monkeypatch.setattr("riskplan.io.text.LARGEST", 100)
    assert refusal(tmp_path, SMALL) == "expected at most 0.0001 MB of text, got more"


finite = st.floats(-1e6, 1e6)
positive = st.floats(1e-3, 1e3)


@st.composite
def predictions(draw):
    steps, modes = draw(st.integers(3, 5)), draw(st.integers(1, 3))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    persistent = draw(st.booleans())
    root = rng.normal(size=(steps, modes, 2, 2))
    times = draw(st.sampled_from([np.arange(steps) * 0.1, np.cumsum(rng.uniform(0.06, 0.1, steps))]))
    mixture = rp.GaussianMixturePrediction(
        times - times[0] + draw(st.sampled_from([0.0, 0.1])),
        rng.dirichlet(np.ones(modes), () if persistent else (steps,)),
        rng.normal(size=(steps, modes, 2)) * 10.0 ** rng.integers(-8, 8),
        root @ np.swapaxes(root, -1, -2),
        modes="persistent" if persistent else "per_step",
        name=draw(st.text(max_size=8)),
        length=draw(st.none() | positive),
        width=draw(st.none() | positive),
        headings=draw(st.sampled_from([None, rng.normal(size=(steps, modes))])),
        factors=draw(st.sampled_from([None, 0.5 * root[..., :1]])),
    )
    return mixture if draw(st.booleans()) else mixture.moments(draw(st.integers(2, 5)))


@st.composite
def scenarios(draw):
    x, y = draw(finite), draw(finite)
    low = draw(st.floats(0, 5))
    points = np.random.default_rng(draw(st.integers(0, 99))).normal(size=(draw(st.integers(3, 6)), 2))
    around = points - points.mean(axis=0)
    region = rp.GoalRegion(
        points[np.argsort(np.arctan2(around[:, 1], around[:, 0]))],  # by angle: edges do not cross
        heading=draw(st.none() | finite),
        heading_tolerance=draw(positive),
        speed=(low, draw(st.sampled_from([np.inf, low + 0.1]))),
    )
    ego = st.sampled_from(
        [None, rp.EgoEllipsoid.around(4.5, 1.8, 4.6, 1.9, 0.3), rp.EgoCover.discs(4, 2, 3, None, 0.1, 0.2)]
    )
    lines = st.lists(st.just([[0.1, 1 / 3], [1e-9, -0.0], [2, 1e8]]), max_size=2)
    return rp.Scenario(
        start=rp.State(x, y, draw(finite), draw(positive)),
        goal=rp.Goal((region, region), (low, draw(st.sampled_from([np.inf, low])))),
        bounds=(x - 1.1, y - 0.3, x + 7, y + 1 / 3),
        agents=draw(st.lists(predictions(), max_size=2)),
        ego=draw(ego),
        vehicle=rp.KinematicCar(*draw(st.tuples(*[positive] * 7))),
        time_step=0.1,
        horizon=0.1,
        obstacles=draw(st.lists(st.just([[0.1, 1 / 3], [1e-9, -0.0], [2, 1.7]]), max_size=2)),
        drivable=draw(lines),
        lanes=draw(lines),
        name=draw(st.text(max_size=12)),
    )


@settings(max_examples=60, deadline=None)
@given(scenarios())
def test_round_trip_is_bit_for_bit(tmp_path_factory, scenario):
    path = tmp_path_factory.mktemp("round") / "scene.yaml"
    rp.save_scenario(scenario, path)
    again = rp.load_scenario(path)
    assert same(again, scenario)
    assert scenario_text(again) == path.read_text(encoding="utf-8")


@given(st.floats(allow_nan=False))
def test_numbers_read_back_here_and_by_yaml_1_1(value):
    import yaml

    text = number_text(value)
    assert parse_yaml(text.encode(), "n") == value
    assert yaml.safe_load(text) == value


@given(st.text())
def test_text_reads_back(text):
    import yaml

    assert parse_yaml(quoted(text).encode(), "t") == text
    assert yaml.safe_load(quoted(text)) == text


def test_words_that_yaml_1_1_would_turn_into_something_else():
    found = parse_yaml(b"[no, on, 12:30, 2001-01-01, 010, 0x10, 1_0, y, .inf, 1e3, +.5, -7]", "w")
    assert found == ["no", "on", "12:30", "2001-01-01", 10, "0x10", "1_0", "y", np.inf, 1000.0, 0.5, -7]


def test_pure_python_parser_agrees(monkeypatch):
    content = SMALL.encode()
    expected = parse_yaml(content, "a")
    monkeypatch.delattr(yaml_text.yaml, "CSafeLoader")
    assert parse_yaml(content, "a") == expected


def test_an_interrupted_save_leaves_what_was_there(tmp_path, monkeypatch):
    path = tmp_path / "scene.yaml"
    path.write_text("before")

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("os.replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        rp.save_scenario(rp.load_scenario(DATA / "overtake.yaml"), path)
    assert path.read_text() == "before"
    assert list(tmp_path.iterdir()) == [path]


def test_unknown_ego_shape_cannot_be_saved(tmp_path):
    class Blob:
        def pieces(self, agent):
            return np.zeros((1, 2)), np.eye(2)[None]

    scenario = dataclasses.replace(rp.load_scenario(DATA / "overtake.yaml"), ego=Blob())
    with pytest.raises(rp.InputError, match="ego: expected an EgoEllipsoid, EgoCover or EgoBox to write, got Blob"):
        rp.save_scenario(scenario, tmp_path / "a.yaml")


def test_schema_is_valid_and_documents_every_leaf():
    schema = json.loads((Path(rp.__file__).parent / "io" / "scenario.schema.json").read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator.check_schema(schema)

    def walk(node, where):
        if isinstance(node, dict):
            if "properties" in node:
                assert node["additionalProperties"] is False, where
            for key, child in node.get("properties", {}).items():
                target = schema["$defs"][child["$ref"].split("/")[-1]] if "$ref" in child else child
                assert {"description", "properties", "items"} & {*child, *target}, f"{where}.{key}"
            for key, child in node.items():
                walk(child, f"{where}.{key}")
        elif isinstance(node, list):
            for child in node:
                walk(child, where)

    walk(schema, "schema")


def test_demo_scene_is_what_its_script_makes():
    import runpy

    script = Path(__file__).parent.parent / "demos" / "make_overtake.py"
    made = runpy.run_path(str(script))["overtake"]()
    assert scenario_text(made) == (DATA / "overtake.yaml").read_text(encoding="utf-8")
    assert [a.means.shape for a in made.agents] == [(61, 3, 2)] * 3
    assert all(a.length and a.width for a in made.agents)
