"""Plans in other programs' formats: read back by their own readers where they are installed."""

from __future__ import annotations

import csv
import json
import os
import venv
from collections import Counter
from dataclasses import replace
from xml.etree import ElementTree as et

import numpy as np
import pytest

import riskplan as rp
from benchmarks.drivability import judged, report
from benchmarks.drivability import main as drivability
from benchmarks.drivability_judge import CHECKS
from checkers import Kind, TrajectoryRisk
from riskplan.cli import main
from riskplan.io.solution import AXLES
from riskplan.result import Plan

T = 21


@pytest.fixture(scope="module")
def plan():
    """A car that turns left and slows down, on exact arcs."""
    times = 0.1 * np.arange(T)
    speeds = 10.0 - 0.5 * times
    turn = 0.02 * 0.1 * 0.5 * (speeds[:-1] + speeds[1:])
    heading = 3.1 + np.append(0.0, np.cumsum(turn))  # passes ±π
    chord = turn / 0.02 * np.sinc(0.5 * turn / np.pi)
    middle = heading[:-1] + 0.5 * turn
    xy = np.cumsum(np.vstack([[5.0, -2.0], np.column_stack([chord * np.cos(middle), chord * np.sin(middle)])]), axis=0)
    wrapped = (heading + np.pi) % (2 * np.pi) - np.pi
    per_step = np.linspace(0.0, 0.002, T)
    total = np.float64(per_step.sum())
    risk = TrajectoryRisk(total, np.array([total]), per_step, total, per_step.max(), Kind.EXACT)
    marginals = (per_step[:, None],)
    return Plan("solved", times, np.column_stack([xy, wrapped]), speeds, risk, marginals, 0.1, "", {"checker": "exact"})


def test_csv(plan, tmp_path):
    rp.save_trajectory(plan, tmp_path / "t.csv")
    rows = list(csv.DictReader((tmp_path / "t.csv").read_text().splitlines()))
    assert list(rows[0]) == ["time", "x", "y", "heading", "speed", "acceleration", "curvature", "risk"]
    back = {key: np.array([float(r[key]) for r in rows]) for key in rows[0]}
    np.testing.assert_array_equal(np.column_stack([back["x"], back["y"], back["heading"]]), plan.poses)
    np.testing.assert_array_equal(back["risk"], plan.risk.per_step)
    np.testing.assert_allclose(back["acceleration"][:-1], -0.5)
    np.testing.assert_allclose(back["curvature"][:-1], 0.02)
    assert back["acceleration"][-1] == back["curvature"][-1] == 0.0


def test_parquet(plan, tmp_path):
    pq = pytest.importorskip("pyarrow.parquet", reason="needs the extra data")
    rp.save_trajectory(plan, tmp_path / "t.parquet")
    back = pq.read_table(tmp_path / "t.parquet")
    np.testing.assert_array_equal(back["speed"].to_numpy(), plan.speeds)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["t.parquet"]


def test_no_agents_no_risk(plan, tmp_path):
    alone = Plan("solved", plan.times, plan.poses, plan.speeds, None)
    rp.save_trajectory(alone, tmp_path / "t.csv")
    assert all(row["risk"] == "" for row in csv.DictReader((tmp_path / "t.csv").read_text().splitlines()))


def yaw(q):
    return np.arctan2(2 * (q["w"] * q["z"] + q["x"] * q["y"]), 1 - 2 * (q["y"] ** 2 + q["z"] ** 2))


def test_ros_path(plan, tmp_path):
    rp.save_trajectory(plan, tmp_path / "p.json", "ros-path", frame="odom")
    message = json.loads((tmp_path / "p.json").read_text())
    assert message["header"] == {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "odom"}
    assert len(message["poses"]) == T
    last = message["poses"][-3]
    assert last["header"]["stamp"] == {"sec": 1, "nanosec": 800_000_000}
    assert [last["pose"]["position"][k] for k in "xyz"] == [*plan.poses[-3, :2], 0.0]
    np.testing.assert_allclose(yaw(last["pose"]["orientation"]), plan.poses[-3, 2])


def test_autoware(plan, tmp_path):
    rp.save_trajectory(plan, tmp_path / "p.json", "autoware")
    points = json.loads((tmp_path / "p.json").read_text())["points"]
    assert points[20]["time_from_start"] == {"sec": 2, "nanosec": 0}
    assert points[3]["longitudinal_velocity_mps"] == plan.speeds[3]
    np.testing.assert_allclose(points[3]["acceleration_mps2"], -0.5)
    np.testing.assert_allclose(points[3]["heading_rate_rps"], 0.02 * plan.speeds[3])
    np.testing.assert_allclose(yaw(points[7]["pose"]["orientation"]), plan.poses[7, 2])


def test_refused(plan, tmp_path):
    with pytest.raises(
        rp.InputError, match=r"expected the suffix .csv or .parquet, or a format: csv, parquet, ros-path"
    ):
        rp.save_trajectory(plan, tmp_path / "p.json")
    with pytest.raises(rp.InputError, match="format: expected one of csv, parquet, ros-path, autoware; got 'xml'"):
        rp.save_trajectory(plan, tmp_path / "p.json", "xml")
    none = Plan("no_plan_found", np.zeros(0), np.zeros((0, 3)), np.zeros(0), None)
    for kind in ("csv", "ros-path", "autoware"):
        with pytest.raises(rp.InputError, match="plan: expected a trajectory, got status 'no_plan_found'"):
            rp.save_trajectory(none, tmp_path / "p.json", kind)
    with pytest.raises(rp.InputError, match="cannot be written: No such file or directory"):
        rp.save_trajectory(plan, tmp_path / "none" / "p.csv")


# ----------------------------------------------------------------------------------------------------
# CommonRoad


SCENARIO = """<?xml version="1.0" ?>
<commonRoad timeStepSize="0.1" commonRoadVersion="2020a" author="" affiliation="" source="" benchmarkID="USA_Test-1_1_T-1" date="2026-01-01">
  <location><geoNameId>-999</geoNameId><gpsLatitude>999</gpsLatitude><gpsLongitude>999</gpsLongitude></location>
  <scenarioTags/>
  <lanelet id="1">
    <leftBound><point><x>-60</x><y>30</y></point><point><x>60</x><y>30</y></point></leftBound>
    <rightBound><point><x>-60</x><y>-30</y></point><point><x>60</x><y>-30</y></point></rightBound>
  </lanelet>
  <planningProblem id="77">
    <initialState>
      <position><point><x>5.0</x><y>-2.0</y></point></position>
      <orientation><exact>3.1</exact></orientation><time><exact>4</exact></time><velocity><exact>10.0</exact></velocity>
      <yawRate><exact>0.0</exact></yawRate><slipAngle><exact>0.0</exact></slipAngle>
    </initialState>
    <goalState><time><intervalStart>10</intervalStart><intervalEnd>40</intervalEnd></time></goalState>
  </planningProblem>
</commonRoad>
"""  # noqa: E501


@pytest.fixture
def scenario_file(tmp_path):
    path = tmp_path / "scenario.xml"
    path.write_text(SCENARIO)
    return path


@pytest.mark.parametrize(("model", "cost"), [("KS", "SM1"), ("PM", "JB1")])
def test_commonroad_s_own_reader_accepts_it(plan, scenario_file, tmp_path, model, cost):
    solution = pytest.importorskip("commonroad.common.solution", reason="needs the extra commonroad")
    out = tmp_path / "solution.xml"
    rp.save_solution(plan, out, scenario_file, vehicle_model=model, vehicle_type=2, cost_function=cost)
    read = solution.CommonRoadSolutionReader.open(str(out))
    assert read.benchmark_id == f"{model}2:{cost}:USA_Test-1_1_T-1:2020a"
    (one,) = read.planning_problem_solutions
    assert one.planning_problem_id == 77
    assert one.vehicle_type is solution.VehicleType.BMW_320i
    states = one.trajectory.state_list
    assert [s.time_step for s in states] == list(range(4, 4 + T))  # from the problem's initial time step on
    np.testing.assert_array_equal([s.position for s in states], plan.poses[:, :2])
    if model == "KS":
        np.testing.assert_array_equal([s.orientation for s in states], plan.poses[:, 2])
        np.testing.assert_allclose([np.tan(s.steering_angle) for s in states], 0.02 * sum(AXLES[2]))
    else:
        np.testing.assert_allclose([np.hypot(s.velocity, s.velocity_y) for s in states], plan.speeds)


def test_a_point_mass_that_stands_keeps_its_heading(scenario_file, tmp_path):
    pytest.importorskip("commonroad", reason="needs the extra commonroad")
    times = 0.1 * np.arange(4)
    poses = np.tile([5.0, -2.0, 3.1], (4, 1))
    rp.save_solution(Plan("solved", times, poses, np.zeros(4), None), tmp_path / "s.xml", scenario_file)
    for state in et.parse(tmp_path / "s.xml").iter("pmState"):
        along, across = (float(state.findtext(key, "")) for key in ("xVelocity", "yVelocity"))
        assert np.arctan2(across, along) == pytest.approx(3.1)
        assert np.hypot(along, across) < 1e-6


# commonroad-drivability-checker lives in an environment of its own (see benchmarks/drivability.py)
needs_checker = pytest.mark.skipif(
    "RISKPLAN_DRIVABILITY" not in os.environ, reason="RISKPLAN_DRIVABILITY: no interpreter that has the checker"
)


def checks(pairs):
    """The names of the checks that each (scenario, solution) fails, and why."""
    verdicts = judged(os.environ["RISKPLAN_DRIVABILITY"], [(str(a), str(b)) for a, b in pairs])["verdicts"]
    return [{name: why for name, why in v.items() if why is not None} for v in verdicts]


@needs_checker
def test_the_drivability_checker_accepts_it_and_sees_every_fault(plan, scenario_file, tmp_path):
    def saved(name, made):
        rp.save_solution(made, tmp_path / name, scenario_file)
        return tmp_path / name

    def other(name, old, new):
        assert old in SCENARIO
        (tmp_path / name).write_text(SCENARIO.replace(old, new))
        return tmp_path / name

    good = saved("good.xml", plan)
    late = other("late.xml", "<intervalStart>10<", "<intervalStart>35<")
    narrow = other("narrow.xml", "<y>-30</y>", "<y>-2</y>")
    car = """<staticObstacle id="5"><type>parkedVehicle</type>
      <shape><rectangle><length>4.0</length><width>2.0</width></rectangle></shape>
      <initialState><position><point><x>-5.0</x><y>-2.0</y></point></position><orientation><exact>0</exact></orientation>
      <time><exact>0</exact></time></initialState></staticObstacle>"""
    parked = other("parked.xml", "<planningProblem", f"{car}<planningProblem")
    heading = "<orientation><intervalStart>-3.2</intervalStart><intervalEnd>-2.0</intervalEnd></orientation>"
    west = other("west.xml", "<goalState>", f"<goalState>{heading}")
    moved = saved("moved.xml", replace(plan, poses=plan.poses + [0.0, 1.0, 0.0]))
    slow = saved("slow.xml", replace(plan, speeds=0.9 * plan.speeds))
    (tmp_path / "broken.xml").write_text("<CommonRoadSolution/>")
    found = checks(
        [
            (scenario_file, good),
            (late, good),
            (narrow, good),
            (parked, good),
            (west, good),
            (scenario_file, moved),
            (scenario_file, slow),
            (scenario_file, tmp_path / "broken.xml"),
        ]
    )
    names = [list(one) for one in found]
    assert names[:4] == [[], ["goal"], ["within road"], ["clear of traffic"]]
    assert names[4:] == [["goal"], ["start"], ["feasible"], list(CHECKS)]
    # commonroad-io 2024.3 lets no point mass head west
    assert "Reached, if the heading is atan2(yVelocity, xVelocity)." in found[4]["goal"]
    assert "Reached," not in found[1]["goal"]


@needs_checker
@pytest.mark.parametrize("model", ["PM", "KS"])
def test_the_benchmark_plans_and_judges(scenario_file, model, capsys):
    python = os.environ["RISKPLAN_DRIVABILITY"]
    (scenario_file.parent / "other.xml").write_text("<html/>")
    assert drivability(["--data", str(scenario_file.parent), "--python", python, "--model", model]) == 0
    assert f"### {model} solutions" in (said := capsys.readouterr().out)
    assert "| 2 | 1 | 1 | 1 | 1 | 1 | 1 | 1 | 1 |\n\nNo plan: unreadable file 1." in said and "Failures" not in said


def test_the_benchmark_counts_what_fails(capsys):
    passed = dict.fromkeys(CHECKS)
    verdicts = [passed, passed | {"goal": "late"}, passed | {"goal": "far", "start": "moved"}]
    report("PM", ["a", "b", "c"], verdicts, Counter({"no_plan_found": 2}))
    said = capsys.readouterr().out
    assert "| 5 | 3 | 3 | 2 | 3 | 3 | 1 | 3 | 1 |\n\nNo plan: no_plan_found 2." in said
    assert said.endswith("| b | goal | late |\n| c | start | moved |\n| c | goal | far |\n")


def test_the_benchmark_says_in_one_line_that_there_is_no_checker(tmp_path, capsys):
    venv.create(tmp_path / "bare", with_pip=False)
    python = str(tmp_path / "bare" / "bin" / "python")
    assert drivability(["--data", str(tmp_path), "--python", python]) == 2
    said = capsys.readouterr()
    assert said.out == "" and said.err.count("\n") == 1
    assert f"--python {python} has no commonroad-drivability-checker: No module named" in said.err
    assert drivability(["--data", str(tmp_path), "--python", "/nowhere/python"]) == 2
    assert capsys.readouterr().err == "benchmarks.drivability: --python /nowhere/python: No such file or directory\n"


def test_axles_are_commonroad_s():
    solution = pytest.importorskip("commonroad.common.solution", reason="needs the extra commonroad")
    for kind, axles in AXLES.items():
        parameters = solution.vehicle_parameters[solution.VehicleType(kind)]
        np.testing.assert_allclose(axles, (parameters.a, parameters.b), rtol=1e-9)


def test_solution_refused(plan, scenario_file, tmp_path):
    pytest.importorskip("commonroad", reason="needs the extra commonroad")
    out = tmp_path / "s.xml"
    for options, message in (
        ({"vehicle_model": "MB"}, "vehicle_model: expected one of KS, PM; got 'MB'"),
        ({"vehicle_model": "PM", "cost_function": "SM1"}, "cost_function: expected one of JB1, WX1, MW1; got 'SM1'"),
        ({"vehicle_type": 4}, "vehicle_type: expected one of 1, 2, 3; got 4"),
        ({"problem": 1}, "problem: expected 0 to 0, got 1"),
    ):
        with pytest.raises(rp.InputError) as caught:
            rp.save_solution(plan, out, scenario_file, **options)
        assert str(caught.value) == message
    sparse = Plan("solved", plan.times[::2], plan.poses[::2], plan.speeds[::2], None)
    with pytest.raises(rp.InputError, match=r"plan.times\[1\]: expected every step of 0.1 s, got 0.2 s"):
        rp.save_solution(sparse, out, scenario_file)
    assert not out.exists()


# ----------------------------------------------------------------------------------------------------
# the command


def test_command(plan, scenario_file, tmp_path, capsys):
    pytest.importorskip("commonroad", reason="needs the extra commonroad")
    stored, out = tmp_path / "plan.json", tmp_path / "solution.xml"
    rp.save_plan(plan, stored)
    command = ["export", str(stored), "--out", str(out), "--to"]
    assert main([*command, "commonroad", "--scenario", str(scenario_file), "--vehicle-model", "PM", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"files": {"commonroad": str(out)}}
    assert et.parse(out).getroot().attrib["benchmark_id"].startswith("PM2:JB1:")
    assert main([*command, "csv"]) == 0
    assert capsys.readouterr().out == f"wrote {out}\n"
    assert out.read_text().startswith("time,x,y")
    assert main([*command, "yaml"]) == 2
    assert "--to: expected one of csv, parquet, ros-path, autoware, commonroad; got 'yaml'" in capsys.readouterr().err
    assert main([*command, "commonroad"]) == 2
    assert "--scenario: expected the CommonRoad file" in capsys.readouterr().err
