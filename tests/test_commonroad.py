"""CommonRoad files: both formats, bad files, and scenarios that never see the recorded future."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path

import numpy as np
import pytest
import shapely

pytest.importorskip("commonroad")

from checkers import InputError  # noqa: E402
from predictor import ConstantVelocity, Track  # noqa: E402
from riskplan.io.commonroad import CommonRoadScene, load_commonroad  # noqa: E402

GAP = 0.02


def exact(tag, value):
    return f"<{tag}><exact>{value}</exact></{tag}>"


def point(x, y):
    return f"<point><x>{x}</x><y>{y}</y></point>"


def state(tag, x, y, speed, step, heading=0.0):
    return (
        f"<{tag}><position>{point(x, y)}</position>{exact('orientation', heading)}{exact('time', step)}"
        f"{exact('velocity', speed)}{exact('acceleration', 0.0)}</{tag}>"
    )


def lanelet(name, low, high, links):
    def bound(tag, y):
        return f"<{tag}>{''.join(point(x, y) for x in (0, 40, 80, 120, 160, 200))}</{tag}>"

    return f'<lanelet id="{name}">{bound("leftBound", high)}{bound("rightBound", low)}{links}</lanelet>'


def dynamic(name, y, speed, version, steps=70, x=10.0, shape=None):
    shape = shape or "<rectangle><length>4.0</length><width>1.8</width></rectangle>"
    states = "".join(state("state", x + 0.1 * speed * k, y, speed, k) for k in range(1, steps))
    body = f"<type>car</type><shape>{shape}</shape>{state('initialState', x, y, speed, 0)}"
    body += f"<trajectory>{states}</trajectory>"
    if version == "2018b":
        return f'<obstacle id="{name}"><role>dynamic</role>{body}</obstacle>'
    return f'<dynamicObstacle id="{name}">{body}</dynamicObstacle>'


def static(name, version):
    body = (
        "<type>parkedVehicle</type><shape><rectangle><length>4</length><width>2</width></rectangle></shape>"
        f"<initialState><position>{point(150, 0)}</position>{exact('orientation', 0.0)}{exact('time', 0)}"
        "</initialState>"
    )
    if version == "2018b":
        return f'<obstacle id="{name}"><role>static</role>{body}</obstacle>'
    return f'<staticObstacle id="{name}">{body}</staticObstacle>'


RECTANGLE = (
    "<position><rectangle><length>20</length><width>3</width><orientation>0</orientation>"
    "<center><x>60</x><y>0</y></center></rectangle></position>"
    "<orientation><intervalStart>-0.2</intervalStart><intervalEnd>0.4</intervalEnd></orientation>"
    "<velocity><intervalStart>2</intervalStart><intervalEnd>15</intervalEnd></velocity>"
)


def problem(goals):
    window = "<time><intervalStart>30</intervalStart><intervalEnd>40</intervalEnd></time>"
    first = (
        f"<initialState><position>{point(20, 0)}</position>{exact('velocity', 10.0)}"
        f"{exact('orientation', 0.0)}{exact('yawRate', 0.0)}{exact('slipAngle', 0.0)}{exact('time', 0)}"
        "</initialState>"
    )
    states = "".join(f"<goalState>{g}{window}</goalState>" for g in goals)
    return f'<planningProblem id="900">{first}{states}</planningProblem>'


def document(version, *, obstacles=None, problems=None):
    head = 'author="a" affiliation="b" source="c" date="2020-01-01" timeStepSize="0.1"'
    if version == "2018b":
        head += ' benchmarkID="ZAM_Test-1_1_T-1" commonRoadVersion="2018b" tags="urban"'
        extra = ""
    else:
        head += ' benchmarkID="ZAM_Test-1_1_T-1" commonRoadVersion="2020a"'
        extra = (
            "<location><geoNameId>1</geoNameId><gpsLatitude>0</gpsLatitude><gpsLongitude>0</gpsLongitude></location>"
            "<scenarioTags><urban/></scenarioTags>"
        )
    right = lanelet(1, -1.75, 1.75, '<adjacentLeft ref="2" drivingDir="same"/>')
    left = lanelet(2, 1.75 + GAP, 5.25 + GAP, '<adjacentRight ref="1" drivingDir="same"/>')
    if obstacles is None:
        obstacles = [
            static(50, version),
            dynamic(51, 0.0, 8.0, version, x=40.0),
            dynamic(52, 3.5, 10.0, version),
        ]
    body = extra + right + left + "".join(obstacles) + (problem([RECTANGLE]) if problems is None else problems)
    return f'<?xml version="1.0" encoding="utf-8"?><commonRoad {head}>{body}</commonRoad>'


@pytest.fixture(params=["2018b", "2020a"])
def version(request):
    return request.param


@pytest.fixture
def write(tmp_path):
    def write(text, name="scene.xml"):
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write


def scrambled(scene: CommonRoadScene, time: float) -> CommonRoadScene:
    """The same scene with nonsense after `time`."""
    rng = np.random.default_rng(0)

    def scramble(track: Track) -> Track:
        later = track.times > time + 1e-9
        count = np.count_nonzero(later)
        positions, headings, speeds = (np.array(a) for a in (track.positions, track.headings, track.speeds))
        positions[later] += rng.normal(0, 50, (count, 2))
        headings[later] = rng.uniform(-3, 3, count)
        speeds[later] = rng.uniform(0, 40, count)
        return dataclasses.replace(track, positions=positions, headings=headings, speeds=speeds)

    return dataclasses.replace(scene, tracks=tuple(scramble(t) for t in scene.tracks))


def assert_same(a, b):
    assert a.start == b.start
    assert a.bounds == b.bounds
    assert len(a.agents) == len(b.agents) > 0
    for p, q in zip(a.agents, b.agents, strict=True):
        np.testing.assert_array_equal(p.means, q.means)
        np.testing.assert_array_equal(p.covariances, q.covariances)
        np.testing.assert_array_equal(p.headings, q.headings)
    for r, s in zip(a.goal.regions, b.goal.regions, strict=True):
        np.testing.assert_array_equal(r.polygon, s.polygon)


def satisfies(goal, position, heading):
    """Whether a state meets the goal's place and heading."""
    return any(
        shapely.Polygon(r.polygon).covers(shapely.Point(position))
        and (r.heading is None or abs(np.angle(np.exp(1j * (heading - r.heading)))) <= r.heading_tolerance)
        for r in goal.regions
    )


def test_reads_both_formats(write, version):
    scene = load_commonroad(write(document(version)))
    assert scene.name == "ZAM_Test-1_1_T-1"
    assert scene.dt == 0.1
    assert [lane.name for lane in scene.road.lanes] == ["1", "2"]
    np.testing.assert_allclose(scene.road.lanes[0].centre[:, 1], 0.0, atol=1e-12)
    assert scene.road.lanes[0].neighbours == ("2",)
    assert [t.name for t in scene.tracks] == ["51", "52"]
    assert scene.tracks[0].length == 4.0
    assert len(scene.tracks[0].times) == 70
    assert shapely.Polygon(scene.obstacles[0]).bounds == pytest.approx((148, -1, 152, 1))


def test_scenario_of_the_files_own_problem(write, version):
    scenario = load_commonroad(write(document(version))).scenario()
    assert (scenario.start.x, scenario.start.y, scenario.start.speed) == (20.0, 0.0, 10.0)
    assert scenario.horizon == pytest.approx(4.0)
    assert scenario.goal.time == pytest.approx((3.0, 4.0), abs=1e-5)
    (region,) = scenario.goal.regions
    assert shapely.Polygon(region.polygon).bounds == pytest.approx((50, -1.5, 70, 1.5))
    assert (region.heading, region.heading_tolerance) == (pytest.approx(0.1), pytest.approx(0.3))
    assert region.speed == (2.0, 15.0)
    assert [a.name for a in scenario.agents] == ["51", "52"]
    assert all(a.times[0] == 0.0 and a.length == 4.0 for a in scenario.agents)
    plain = load_commonroad(write(document(version))).scenario(predictor=ConstantVelocity.fitted())
    np.testing.assert_allclose(plain.agents[0].means[-1, 0], [40 + 32, 0], atol=1e-9)
    assert plain.agents[0].factors is None
    # the predictor of choice has several modes, whose errors persist
    assert all(a.factors is not None and len(a.weights) > 1 for a in scenario.agents)
    assert len(scenario.lanes) == 2


def test_no_slits_between_lanes(write):
    scene = load_commonroad(write(document("2018b")))
    union = shapely.unary_union([shapely.Polygon(p) for p in scene.scenario().drivable])
    assert union.geom_type == "Polygon"
    assert not union.interiors
    assert union.bounds == pytest.approx((0, -1.75, 200, 5.25 + GAP), abs=1e-6)
    assert union.contains(shapely.box(50, 1.0, 60, 2.5))


def test_goal_on_lanelets_anywhere_and_several(write):
    two = problem(['<position><lanelet ref="1"/><lanelet ref="2"/></position>', ""])
    scenario = load_commonroad(write(document("2020a", problems=two))).scenario()
    lane_1, lane_2, anywhere = (shapely.Polygon(r.polygon) for r in scenario.goal.regions)
    assert lane_1.bounds == pytest.approx((0, -1.75, 200, 1.75))
    assert lane_2.bounds == pytest.approx((0, 1.75 + GAP, 200, 5.25 + GAP))
    assert anywhere.bounds == pytest.approx(scenario.bounds)
    assert scenario.goal.regions[0].heading is None


def test_other_shapes_by_their_bounding_rectangle(write, version):
    round_one = "<circle><radius>0.5</radius></circle>"
    corners = "".join(point(*p) for p in ((-2, -1), (2, -1), (3, 0), (2, 1), (-2, 1)))
    obstacles = [
        dynamic(51, 0.0, 8.0, version, x=60.0, shape=round_one),
        dynamic(52, 3.5, 5.0, version, shape=f"<polygon>{corners}</polygon>"),
    ]
    circle, polygon = load_commonroad(write(document(version, obstacles=obstacles))).tracks
    assert (circle.length, circle.width) == (1.0, 1.0)
    assert (polygon.length, polygon.width) == (6.0, 2.0)


def test_scenario_never_sees_the_future(write, version):
    scene = load_commonroad(write(document(version)))
    assert_same(scene.scenario(), scrambled(scene, 0.0).scenario())


def test_horizon_task(write, version):
    scene = load_commonroad(write(document(version)))
    task = scene.horizon_task(np.random.default_rng(4))
    assert task is not None
    scenario, driver = task.scenario, task.driver
    assert scenario.steps == 30
    np.testing.assert_allclose(driver.times, scenario.times)
    np.testing.assert_allclose(driver.positions[0], [scenario.start.x, scenario.start.y])
    assert [a.name for a in scenario.agents] == [o.name for o in task.others]
    assert driver.name not in {a.name for a in scenario.agents}
    assert scenario.goal.time == pytest.approx((3.0, 3.0), abs=1e-5)
    x, y = driver.positions[-1]
    assert satisfies(scenario.goal, (x, y), 0.0)
    assert not satisfies(scenario.goal, (x, y), 0.3)
    moved = x - driver.positions[0, 0]
    other_lane = 3.5 if y == 0.0 else 0.0
    assert satisfies(scenario.goal, (x - 0.09 * moved, other_lane), 0.0)
    assert not satisfies(scenario.goal, (x - 0.11 * moved, y), 0.0)
    reach = scenario.start.speed * 3 + 18 + 4.0
    far = max(r.polygon[:, 0].min() for r in scenario.goal.regions) - scenario.start.x
    assert far <= reach


def test_horizon_task_predicts_from_the_past_only(write):
    scene = load_commonroad(write(document("2018b")))
    task = scene.horizon_task(np.random.default_rng(4))
    # the driver keeps its future, which its goal is made of; everyone else's is scrambled
    pairs = list(zip(scene.tracks, scrambled(scene, task.t0).tracks, strict=True))
    mixed = tuple(t if t.name == task.driver.name else s for t, s in pairs)
    (driver,) = (t for t in scene.tracks if t.name == task.driver.name)
    again = dataclasses.replace(scene, tracks=mixed)._task(driver, task.t0, 30)
    assert_same(task.scenario, again.scenario)
    assert any(np.abs(o.positions - p.positions).max() > 10 for o, p in zip(task.others, again.others, strict=True))


def test_no_eligible_vehicle(write):
    slow = [dynamic(51, 0.0, 1.0, "2018b")]
    assert load_commonroad(write(document("2018b", obstacles=slow))).horizon_task(np.random.default_rng(0)) is None
    short = [dynamic(51, 0.0, 8.0, "2018b", steps=40)]
    assert load_commonroad(write(document("2018b", obstacles=short))).horizon_task(np.random.default_rng(0)) is None
    off = [dynamic(51, 9.0, 8.0, "2018b")]
    assert load_commonroad(write(document("2018b", obstacles=off))).horizon_task(np.random.default_rng(0)) is None


BAD = {
    "malformed": ("<commonRoad><lanelet>", "malformed XML"),
    "empty": ("", "malformed XML"),
    "not-xml": (b"\x89PNG\r\n\x1a\n\x00\x00", "malformed XML"),
    "other-root": ("<OpenDRIVE/>", "expected the root commonRoad, got OpenDRIVE"),
    "doctype": ('<!DOCTYPE x [<!ENTITY a "aaaa">]><commonRoad>&a;</commonRoad>', "DOCTYPE"),
    "doctype-utf16": (
        '<?xml version="1.0" encoding="utf-16"?><!DOCTYPE x><commonRoad/>'.encode("utf-16"),
        "DOCTYPE",
    ),
    "version": (document("2018b").replace("2018b", "1999z"), "not a readable CommonRoad file"),
    "no-problem": (document("2018b", problems=""), "no planning problem"),
    "nan": (document("2018b").replace("<x>40</x>", "<x>nan</x>"), "lanelet 1: "),
    "no-number": (
        document("2020a").replace("<exact>8.0</exact>", "<exact>fast</exact>"),
        r"dynamicObstacle \d+: initialState velocity exact: expected a number",
    ),
    "speed": (
        document("2020a").replace(
            "<velocity><exact>10.0</exact></velocity><orientation>",
            "<velocity><exact>-3</exact></velocity><orientation>",
        ),
        "start.speed",
    ),
    "goal-lanelet": (
        document("2018b", problems=problem(['<position><lanelet ref="77"/></position>'])),
        "CommonRoad",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_files_are_named_in_one_line(write, case, capfd):
    text, message = BAD[case]
    path = write(text, f"{case}.xml")
    with pytest.raises(InputError, match=message) as caught:
        load_commonroad(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_missing_file_and_problem(write, tmp_path):
    with pytest.raises(InputError, match="no such file"):
        load_commonroad(tmp_path / "none.xml")
    with pytest.raises(InputError, match="cannot be read"):
        load_commonroad(tmp_path)
    scene = load_commonroad(write(document("2018b")))
    with pytest.raises(InputError, match=r"^problem"):
        scene.scenario(1)
    with pytest.raises(InputError, match=r"^horizon"):
        scene.horizon_task(np.random.default_rng(0), horizon=3.05)


def data(folder):
    root = os.environ.get("RISKPLAN_DATA")
    if not root or not (Path(root) / folder).is_dir():
        pytest.skip("RISKPLAN_DATA does not point at the recorded scenes")
    return Path(root) / folder


RECORDED = ["USA_US101-5_2_T-1", "USA_US101-8_4_T-1", "USA_Peach-4_5_T-1", "USA_Lanker-2_21_T-1"]


@pytest.mark.parametrize("name", RECORDED)
def test_recorded_drivers_meet_their_own_goal(name, capfd):
    scene = load_commonroad(data("commonroad-ngsim") / f"{name}.xml")
    assert capfd.readouterr() == ("", "")
    area = shapely.unary_union([shapely.Polygon(p) for p in scene.road.surface])
    for seed in range(4):
        task = scene.horizon_task(np.random.default_rng(seed))
        assert satisfies(task.scenario.goal, task.driver.positions[-1], task.driver.headings[-1])
        assert task.driver.speeds[0] >= 2.0
        assert area.contains(shapely.Point(task.driver.positions[0]))
        assert len(task.driver.times) == 31
        for agent, other in zip(task.scenario.agents, task.others, strict=True):
            assert agent.name == other.name
            np.testing.assert_allclose(agent.means[0, 0], other.positions[0], atol=1e-6)
            assert agent.length == other.length
        again = scene.horizon_task(np.random.default_rng(seed))
        assert_same(task.scenario, again.scenario)


@pytest.mark.parametrize("name", RECORDED[:2])
def test_recorded_scenarios_never_see_the_future(name):
    scene = load_commonroad(data("commonroad-ngsim") / f"{name}.xml")
    assert_same(scene.scenario(), scrambled(scene, scene.problems[0].time).scenario())


@pytest.mark.parametrize("name", ["C-DEU_B471-1_3_T-1", "DEU_IV21-1_3_T-1", "DEU_Moelln-7_1_T-1", "BEL_Putte-10_2_T-1"])
def test_towns_load(name):
    scene = load_commonroad(data("commonroad-planning") / f"{name}.xml")
    scenario = scene.scenario()
    assert scenario.drivable
    assert scenario.agents
    body = shapely.Point(scenario.start.x, scenario.start.y)
    assert shapely.unary_union([shapely.Polygon(p) for p in scenario.drivable]).contains(body)
