"""Argoverse scenarios as planning problems: where the ego starts and is to go, and what is known of the others."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import shapely
from traffic import lane, recording, straight

import riskplan as rp
from checkers import InputError
from predictor.lanes import Lane
from predictor.recordings import Recording
from predictor.tracks import Track
from riskplan.io.argoverse import scenario_of

DATA = Path(os.environ.get("RISKPLAN_DATA", "/nonexistent"))
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="RISKPLAN_DATA names no folder of recorded traffic")


def write(path, speeds):
    """An Argoverse 1 scenario, northwards; the first is the AV."""
    rows = ["TIMESTAMP,TRACK_ID,OBJECT_TYPE,X,Y,CITY_NAME"]
    for i, speed in enumerate(speeds):
        kind = ("AV", "AGENT", "OTHERS")[min(i, 2)]
        rows += [f"{1000 + 0.1 * k},{i},{kind},{100 + 6 * i},{200 + 0.1 * k * speed},MIA" for k in range(20)]
    path.write_text("\n".join(rows) + "\n")
    return path


def region(scenario):
    (only,) = scenario.goal.regions
    return shapely.Polygon(only.polygon), only


def test_the_ego_goes_on_where_it_is_going(tmp_path):
    scenario = rp.load_scenario(write(tmp_path / "7.csv", [8.0, 5.0, 0.0]))
    start = scenario.start
    assert (start.x, start.y) == pytest.approx((100.0, 200.0 + 1.9 * 8.0))
    assert (start.heading, start.speed) == pytest.approx((np.pi / 2, 8.0))
    assert (scenario.horizon, scenario.time_step) == pytest.approx((3.0, 0.1))
    goal, only = region(scenario)
    assert goal.covers(shapely.Point(start.x, start.y + 8.0 * 3.0))
    assert goal.distance(shapely.Point(start.x, start.y)) == pytest.approx(0.9 * 8.0 * 3.0)
    assert only.heading == pytest.approx(np.pi / 2)
    assert scenario.name == "argoverse 7"
    assert [a.name for a in scenario.agents] == ["1", "2"]


def test_the_others_are_predicted_at_constant_velocity(tmp_path):
    scenario = rp.load_scenario(write(tmp_path / "7.csv", [8.0, 5.0]))
    (agent,) = scenario.agents
    expected = [106.0, 200 + 1.9 * 5.0] + np.arange(31)[:, None] * [0.0, 0.5]
    np.testing.assert_allclose(agent.means[:, 0], expected, atol=1e-3)
    assert agent.times[-1] == pytest.approx(3.0)


def test_who_never_moved_has_no_heading(tmp_path):
    moving, standing = rp.load_scenario(write(tmp_path / "7.csv", [8.0, 5.0, 0.0])).agents
    assert moving.headings is not None
    assert standing.headings is None
    own = standing.covariances[-1, 0]
    np.testing.assert_allclose(own, own[0, 0] * np.eye(2))
    # not less than the baseline says in any direction
    track = Track("2", [0.0], [[0.0, 0.0]], [0.0], [0.0], 4.5, 1.8)
    baseline = rp.ConstantVelocity.fitted().predict(track, standing.times).covariances[-1, 0]
    assert np.linalg.eigvalsh(own - baseline)[0] >= -1e-12


def test_a_standing_ego_is_headed_like_the_nearest_traffic(tmp_path):
    scenario = rp.load_scenario(write(tmp_path / "7.csv", [0.0, 0.1, 6.0, 9.0]))
    assert scenario.start.heading == pytest.approx(np.pi / 2)
    assert scenario.start.speed == pytest.approx(0.0, abs=1e-9)
    assert scenario.name == "argoverse 7, standing, headed as track 2"
    goal, _ = region(scenario)
    assert goal.distance(shapely.Point(scenario.start.x, scenario.start.y)) == pytest.approx(10.0)
    with pytest.raises(InputError, match=r"7.csv: ego: it stood still throughout and nobody moved"):
        rp.load_scenario(write(tmp_path / "7.csv", [0.0, 0.1]))


def test_an_ego_is_needed(tmp_path):
    path = write(tmp_path / "7.csv", [8.0, 5.0])
    path.write_text(path.read_text().replace(",AV,", ",OTHERS,"))
    with pytest.raises(InputError, match=r"7.csv: ego: expected a track of the recording vehicle at 0 s, got none"):
        rp.load_scenario(path)
    with pytest.raises(InputError, match=r"problem: expected 0, as .*7.csv has one planning problem; got 1"):
        rp.load_scenario(path, problem=1)


@pytest.mark.parametrize("spoilt", ["1\r2", "0" * 200_000, '"'])
def test_what_is_no_csv_is_refused(tmp_path, spoilt):
    path = write(tmp_path / "7.csv", [8.0, 5.0])
    path.write_text(path.read_text().replace("MIA", spoilt, 1), newline="")
    message = None
    try:
        rp.load_scenario(path)
    except InputError as error:
        message = str(error)
    assert message is None or message.startswith(f"{path}: ")


def test_a_lane_without_end_is_refused():
    far = np.array([[0.0, 0.0], [1e8, 0.0]])
    with pytest.raises(InputError, match=r"centre: expected a length of at most 100000 m, got 1e\+08"):
        Lane("a", far, far + [0.0, 2.0], far - [0.0, 2.0])


def test_nothing_after_the_present_enters(tmp_path):
    def scene(later):
        other = straight("other", 110, start=(0.0, 4.0), speed=8.0)
        positions = other.positions.copy()
        positions[50:] += later
        changed = Track("other", other.times, positions, other.headings, other.speeds, 4.5, 1.8)
        gone = straight("gone", 40, start=(0.0, -4.0))
        coming = straight("coming", 60, start=(0.0, -8.0), first=50)
        return Recording("r", 0.1, (straight("AV", 110), changed, gone, coming), ego="AV")

    first, second = (scenario_of(scene(later), 4.9, headings_stated=True) for later in (0.0, 99.0))
    assert [a.name for a in first.agents] == ["other"]
    for a, b in zip(first.agents, second.agents, strict=True):
        np.testing.assert_array_equal(a.means, b.means)


def test_with_a_map_the_goal_is_on_its_lanes():
    r = recording("r", [straight("AV", 110, speed=9.0)], lanes=(lane("l", length=300.0),), ego="AV")
    scenario = scenario_of(r, 4.9, headings_stated=True)
    goals = shapely.union_all([shapely.Polygon(g.polygon) for g in scenario.goal.regions])
    assert goals.covers(shapely.Point(scenario.start.x + 27.0, 0.0))
    assert shapely.Polygon(r.lanes[0].outline).buffer(1e-6).covers(goals)
    assert goals.distance(shapely.Point(scenario.start.x, 0.0)) == pytest.approx(0.9 * 27.0)
    slow = recording("r", [straight("AV", 110, speed=0.1)], lanes=(lane("l", length=300.0),), ego="AV")
    goal, _ = region(scenario_of(slow, 4.9, headings_stated=True))
    assert goal.distance(shapely.Point(0.49, 0.0)) == pytest.approx(10.0)
    assert len(scenario.lanes) == 1
    assert scenario.drivable


@needs_data
def test_recorded_scenarios_are_planning_problems():
    paths = sorted((DATA / "argoverse1").glob("*.csv"))[::40]
    scenarios = [rp.load_scenario(p) for p in paths]
    assert all(len(s.agents) > 0 and s.horizon == pytest.approx(3.0) for s in scenarios)
    assert np.mean(["standing" in s.name for s in scenarios]) == pytest.approx(0.5, abs=0.25)


@needs_data
def test_a_recorded_scenario_with_a_map():
    pytest.importorskip("pandas", reason="needs the extra data")
    (path,) = (DATA / "argoverse2").rglob("*.parquet")
    scenario = rp.load_scenario(path)
    assert scenario.drivable
    assert len(scenario.agents) >= 5
    road = shapely.union_all([shapely.Polygon(p) for p in scenario.drivable])
    assert road.contains(shapely.Point(scenario.start.x, scenario.start.y))
    assert all(road.buffer(0.5).covers(shapely.Polygon(g.polygon)) for g in scenario.goal.regions)
