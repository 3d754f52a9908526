"""`plan.json`: bit for bit there and back, strict JSON, one clear line for a malformed one."""

import copy
import dataclasses
import json

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import riskplan as rp
from riskplan.io.plan_file import json_text, parse_json, plan_of, plan_text, plan_to_dict, report_to_dict, versions
from riskplan.result import STATUSES

# any number of [0, 1], down to those that plain printing would lose
risks = st.floats(0, 1) | st.floats(0, 1e-300)


@st.composite
def plans(draw):
    solved = draw(st.booleans())
    agents = draw(st.integers(0, 2))
    steps = draw(st.integers(1, 4)) if solved else 0
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    risk, marginals = None, ()
    if solved and agents:
        risk = rp.TrajectoryRisk(
            total=np.float64(draw(risks)),
            per_agent=rng.random(agents),
            per_step=rng.random(steps),
            boole=np.float64(draw(risks)),
            max_step=np.float64(draw(risks)),
            kind=draw(st.sampled_from(list(rp.Kind))),
            dependence=draw(st.sampled_from(["independent", "boole"])),
        )
        marginals = tuple(np.where(rng.random((steps, 2)) < 0.2, np.nan, rng.random((steps, 2))) for _ in range(agents))
    return rp.Plan(
        status="solved" if solved else draw(st.sampled_from(STATUSES[1:])),
        times=np.arange(steps) * 0.1,
        poses=rng.normal(size=(steps, 3)) * 10.0 ** rng.integers(-9, 9),
        speeds=rng.random(steps),
        risk=risk,
        marginals=marginals,
        bound=draw(st.none() | st.floats(0, 1)),
        message=draw(st.text(max_size=20)),
        settings={"checker": "exact", "seed": 3, "dependence": "independent", "checker_options": {}},
        stats={"search": draw(st.floats(0, 9)), "nodes": 7, "lowest_risk_seen": None},
    )


def same(a, b):
    if dataclasses.is_dataclass(a):
        return all(same(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a))
    if isinstance(a, tuple):
        return len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, np.ndarray | np.generic):
        return a.shape == b.shape and a.dtype == b.dtype and np.array_equal(a, b, equal_nan=True)
    return a == b


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(plans())
def test_round_trip_is_bit_for_bit(tmp_path, plan):
    rp.save_plan(plan, tmp_path / "plan.json")
    again = rp.load_plan(tmp_path / "plan.json")
    assert same(plan, again)
    assert plan_text(again) == plan_text(plan)


def small():
    risk = rp.TrajectoryRisk(
        np.float64(0.03), np.array([0.03]), np.array([0.01, 0.02]), np.float64(0.03), np.float64(0.02), rp.Kind.EXACT
    )
    return rp.Plan(
        "solved",
        np.array([0.0, 0.1]),
        np.zeros((2, 3)),
        np.ones(2),
        risk,
        (np.array([[np.nan], [0.02]]),),
        0.05,
        "ok",
        {"seed": 1},
        {"search": np.inf, "nodes": np.int64(3), "pair": (1, np.float64(2.5))},
    )


def test_what_it_holds():
    def refuse(token):
        raise AssertionError(token)

    text = plan_text(small())
    d = json.loads(text, parse_constant=refuse)
    assert (d["format"], d["version"], d["seed"]) == ("riskplan-plan", 1, 1)
    assert d["marginals"] == [[[None], [0.02]]]
    assert d["stats"] == {"search": None, "nodes": 3, "pair": [1, 2.5]}
    assert set(d["risk"]) == {"total", "per_agent", "per_step", "boole", "max_step", "kind", "dependence"}
    assert set(d["versions"]) == {"python", "riskplan", "numpy", "scipy", "numba", "ompl"}
    assert all(versions().values())


def change(*path, to=None, drop=False):
    def apply(d):
        for key in path[:-1]:
            d = d[key]
        if drop:
            del d[path[-1]]
        else:
            d[path[-1]] = to

    return apply


MALFORMED = {
    "no format": (change("format", drop=True), "format: missing"),
    "another format": (change("format", to="gpx"), "format: expected riskplan-plan version 1, got 'gpx'"),
    "newer": (change("version", to=2), "format: expected riskplan-plan version 1, got 'riskplan-plan'"),
    "status": (change("status", to="done"), "status: expected one of solved, no_plan_found"),
    "no trajectory": (change("trajectory", drop=True), "trajectory: missing"),
    "list": (change("trajectory", to=[]), "trajectory: expected an object, got []"),
    "times": (change("trajectory", "times", to=[0.1, 0.0]), "trajectory.times[1]: expected times to increase"),
    "poses": (change("trajectory", "poses", to=[[0, 0, 0]]), "trajectory.poses: expected shape (2, 3), got (1, 3)"),
    "text pose": (change("trajectory", "poses", 0, 0, to="1"), "trajectory.poses: expected numbers, got"),
    "null pose": (change("trajectory", "poses", 0, 0, to=None), "trajectory.poses[0, 0]: expected a finite number"),
    "boolean pose": (change("trajectory", "poses", 0, 0, to=True), "trajectory.poses: expected numbers"),
    "speeds": (change("trajectory", "speeds", to=[1]), "trajectory.speeds: expected shape (2,), got (1,)"),
    "empty": (change("trajectory", "times", to=[]), "trajectory.times: expected at least one time in a solved plan"),
    "total": (change("risk", "total", to=1.5), "risk.total: expected a finite number in [0, 1], got 1.5"),
    "kind": (change("risk", "kind", to="sure"), "risk.kind: expected one of exact, upper bound, estimate; got 'sure'"),
    "per step": (change("risk", "per_step", to=[0.0]), "risk.per_step: expected shape (2,), got (1,)"),
    "dependence": (
        change("risk", "dependence", to="x"),
        "risk.dependence: expected one of independent, persistent, boole; got 'x'",
    ),
    "settings": (
        change("settings", to={"dependence": 3}),
        "settings.dependence: expected one of independent, persistent, boole",
    ),
    "options": (change("settings", to={"checker_options": 3}), "settings.checker_options: expected an object, got 3"),
    "checker": (change("settings", to={"checker": 3}), "settings.checker: expected text, got 3"),
    "marginals": (change("marginals", to=[]), "marginals: expected 1 agents, got 0"),
    "ragged": (change("marginals", to=[[[0.1], []]]), "marginals[0]: expected numbers in lists of equal length"),
    "bound": (change("bound", to="low"), "bound: expected a number or null, got 'low'"),
    "message": (change("message", to=None), "message: expected text, got None"),
}


@pytest.mark.parametrize("case", MALFORMED)
def test_malformed(tmp_path, case):
    apply, expected = MALFORMED[case]
    d = copy.deepcopy(plan_to_dict(small()))
    apply(d)
    path = tmp_path / "plan.json"
    path.write_text(json.dumps(d))
    with pytest.raises(rp.InputError) as caught:
        rp.load_plan(path)
    assert str(caught.value).startswith(f"{path}: {expected}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "null",
        "NaN",
        '{"format": NaN}',
        "[" * 100_000,
        "1" * 5000,
        '"\ud800"'.encode("utf-8", "surrogatepass"),
    ],
    ids=range(9),
)
def test_not_json(tmp_path, text):
    path = tmp_path / "plan.json"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(rp.InputError, match=r"plan.json: (not valid JSON|the document: expected an object)"):
        rp.load_plan(path)


def test_missing_file(tmp_path):
    with pytest.raises(rp.InputError, match=r"nope.json: no such file"):
        rp.load_plan(tmp_path / "nope.json")


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_any_value_anywhere_loads_or_is_refused(data):
    d = json.loads(plan_text(small()))
    anything = st.sampled_from([None, True, -1, 10**400, 1e308, "x", [], {}, [[]], [None], {"a": 1}, [[1, [2]]]])
    node, key = d, data.draw(st.sampled_from(list(d)))
    while isinstance(node[key], dict | list) and node[key] and data.draw(st.booleans()):
        node = node[key]
        key = data.draw(st.sampled_from(list(node) if isinstance(node, dict) else list(range(len(node)))))
    node[key] = data.draw(anything)
    message = ""
    try:
        plan_of(parse_json(json.dumps(d).encode()))
    except rp.InputError as error:
        message = str(error)
    assert "\n" not in message


def test_report():
    risk = small().risk
    sampled = rp.SampledRisk(10, 0.1, (0.0, 0.4), np.array([np.nan]), np.array([[np.nan, np.nan]]), 0.99, False, 0.1)
    verdicts = (
        rp.CheckerVerdict("exact", "exact", risk, 0.1),
        rp.CheckerVerdict("imhof", "exact", None, 0.0, "needs a Gaussian mixture"),
    )
    report = rp.Report(("a",), np.array([0.0, 0.1]), verdicts, sampled, 0.05, True, True, {"search": 1.0})
    d = json.loads(json_text(report_to_dict(report)))
    assert d["verdicts"][0]["risk"]["total"] == 0.03
    assert d["verdicts"][1]["risk"] is None
    assert d["verdicts"][1]["problem"] == "needs a Gaussian mixture"
    assert d["monte_carlo"]["per_agent"] == [None]
    assert d["monte_carlo"]["interval"] == [0.0, 0.4]
    assert (d["bound"], d["within_bound"], d["consistent"]) == (0.05, True, True)
