"""Closed loop: what is known when, what is driven, what it meets."""

import json
from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles_vehicles import assert_drivable
from scenes import agent, overtake

import riskplan as rp
from predictor import Track
from riskplan.cli import main
from riskplan.closed_loop_traffic import Traffic, rectangles_meet, sampled_traffic, track_of
from riskplan.evaluator import RiskEvaluator
from riskplan.ompl.rrt import Tree
from riskplan.search import Budget, Problem

CLOCK = np.arange(-20, 61) * 0.1
ROAD = np.array([[-50, -1.75], [200, -1.75], [200, 5.25], [-50, 5.25]])
LANES = tuple(np.array([[-50.0, y], [200.0, y]]) for y in (0.0, 3.5))


def track(name, x, y, speed, times=CLOCK):
    """Along +x; `speed` is a number, or a function of time."""
    speeds = np.array([speed(t) for t in times]) if callable(speed) else np.full(len(times), float(speed))
    ways = np.concatenate([[0], np.cumsum(0.5 * (speeds[1:] + speeds[:-1]) * np.diff(times))])
    ways -= np.interp(0.0, times, ways)
    return Track(name, times, np.column_stack([x + ways, np.full(len(times), y)]), 0 * times, speeds, 4.5, 1.8)


def two_lanes(**changed):
    scene = rp.Scenario(
        start=rp.State(0, 0, 0, 12),
        goal=rp.Goal.at(45, 0, radius=5, heading=0, heading_tolerance=0.2, time=(3, 6)),
        bounds=(-10, -1.75, 120, 5.25),
        drivable=(ROAD,),
        lanes=LANES,
        ego=rp.EgoCover.discs(4.5, 1.8, relative_heading=0.0),
        horizon=6.0,
    )
    return replace(scene, **changed)


FREE = [track("ahead", 40, 0, 12), track("beside", -15, 3.5, 12)]


@pytest.mark.parametrize("planner", ["rrt", "prm"])
def test_arrives_among_steady_traffic_and_every_plan_is_within_its_bound(planner):
    done = rp.simulate(two_lanes(), FREE, planner=planner, bound=0.02, time_limit=5.0)
    assert done.status == "arrived" and done.collision is None
    assert done.share("fallback") == 0 and done.share("kept") > 0.8
    assert all(c.risk <= 0.02 for c in done.cycles)
    assert_drivable(rp.KinematicCar(), done.states, 0.1)
    region = shapely.Polygon(two_lanes().goal.regions[0].polygon)
    assert region.contains(shapely.Point(done.states[-1, :2])) and done.times[-1] >= 3 - 1e-9
    # each decision starts where the one before led
    for c in done.cycles:
        np.testing.assert_array_equal(c.states[0], done.states[round(c.time / 0.1)])


def test_stated_risk_is_that_of_the_predictions_made_from_the_past():
    done = rp.simulate(two_lanes(), FREE, bound=0.02, time_limit=5.0)
    for c in done.cycles[:: len(done.cycles) // 3]:
        grid = 0.1 * np.arange(len(c.states))
        agents = [rp.ConstantVelocity.fitted().predict(t.until(c.time), grid) for t in FREE]
        ego = two_lanes().ego
        risks = [rp.checker("exact")(c.states[:, :3], a, ego) for a in agents]
        assert c.risk == pytest.approx(float(rp.trajectory_risk(risks, agents).total), rel=1e-6, abs=1e-300)


def test_nothing_is_known_before_it_happens():
    goes_on = track("beside", 0, 3.5, 12)
    brakes_late = track("beside", 0, 3.5, lambda t: 12 if t <= 1.5 else max(12 - 8 * (t - 1.5), 0))
    traffic = [FREE[0], goes_on], [FREE[0], brakes_late]
    a, b = (rp.simulate(two_lanes(), t, bound=0.02, time_limit=5.0) for t in traffic)
    before = [(c, d) for c, d in zip(a.cycles, b.cycles, strict=False) if c.time <= 1.5 + 1e-9]
    assert len(before) == 16
    for c, d in before:
        assert c.risk == d.risk and np.array_equal(c.states, d.states)
    assert any(c.risk != d.risk for c, d in zip(a.cycles[17:], b.cycles[17:], strict=False))


VEHICLES = [rp.KinematicCar(), rp.ReedsSheppCar(), rp.KinematicBicycle()]


@pytest.mark.parametrize("vehicle", VEHICLES, ids=lambda v: v.type)
def test_brakes_where_no_plan_is_within_the_bound(vehicle):
    # a queue across both lanes: the goal lies in it
    queue = [track("left", 30, 3.5, 0), track("right", 30, 0, 0)]
    done = rp.simulate(two_lanes(vehicle=vehicle), queue, bound=0.01, time_limit=0.05)
    assert done.status == "time_up" and done.collision is None
    assert done.share("fallback") == 1.0
    assert done.states[-1, 3] == pytest.approx(0, abs=0.5) and 5 < done.progress < 25.5
    assert_drivable(vehicle, done.states, 0.1)


def test_a_collision_ends_the_loop_and_is_told_with_what_was_driven():
    # it stands where nobody brakes in time for it
    done = rp.simulate(two_lanes(), [track("wall", 8, 0, 0), track("wall 2", 8, 3.5, 0)], bound=0.01, time_limit=0.02)
    assert done.status == "collided" and done.collision.agent == "wall"
    assert done.collision.action == "fallback" and not done.collision.within_bound
    # front bumper on rear bumper
    x = np.interp(done.collision.time, done.times, done.states[:, 0])
    assert x + 2.25 == pytest.approx(8 - 2.25, abs=0.13)


angle = st.floats(-4, 4)
place = st.floats(-5, 5)


@settings(max_examples=300, deadline=None, derandomize=True)
@given(st.tuples(place, place, angle), st.tuples(place, place, angle), st.booleans())
def test_bodies_meet_as_shapely_says(first, second, disc):
    def box(pose, length, width):
        b = shapely.affinity.rotate(
            shapely.box(-length / 2, -width / 2, length / 2, width / 2), pose[2], use_radians=True
        )
        return shapely.affinity.translate(b, pose[0], pose[1])

    one = shapely.Point(first[:2]).buffer(1.5, quad_segs=256) if disc else box(first, 3.0, 1.5)
    gap = one.distance(box(second, 4.0, 2.0))
    found = rectangles_meet(np.array([first]), (3.0, 3.0 if disc else 1.5), np.array([second]), (4.0, 2.0), disc)[0]
    if gap > 1e-4 or one.buffer(-1e-4).intersects(box(second, 4.0, 2.0)):
        assert found == (gap == 0)


def test_contact_between_the_steps_of_the_grid_is_seen():
    # two cars cross within one step of 0.5 s and are apart at both of its ends
    times = np.array([0.0, 0.5])
    crossing = Track("x", times, np.array([[0.0, -8], [0, 8]]), np.full(2, np.pi / 2), np.full(2, 32.0), 4.5, 1.8)
    states = np.array([[-8.0, 0, 0, 32, 0], [8, 0, 0, 32, 0]])
    assert Traffic((crossing,)).first_contact(0.0, 0.5, states, (4.5, 1.8), False) == (
        pytest.approx(0.15, abs=0.051),
        "x",
    )


def test_sampled_traffic_follows_the_prediction():
    scene = overtake()
    drawn = [sampled_traffic(scene.agents, np.random.default_rng(k)).tracks for k in range(200)]
    ends = np.array([[t.positions[-1] for t in d] for d in drawn])
    for i, a in enumerate(scene.agents):
        m = a.moments(2)
        mean = m.weights @ m.means[-1]
        assert np.abs(ends[:, i].mean(axis=0) - mean).max() < 1.0
    past = drawn[0][0].until(0.0)
    assert past.times[0] <= -2 + 1e-9 and past.name == "slow"
    free = two_lanes().with_agents([agent("ahead", 45, 0, 12), agent("beside", -15, 3.5, 12)])
    one, again = (rp.simulate(free, seed=3, time_limit=5.0, bound=0.05) for _ in range(2))
    np.testing.assert_array_equal(one.states, again.states)


def test_moments_alone_cannot_be_sampled():
    scene = overtake()
    with pytest.raises(rp.InputError, match=r"agents\[0\]: expected one that can be sampled, got a MomentPrediction"):
        rp.simulate(scene.with_agents([scene.agents[0].moments(4)]))


def test_errors_that_persist_are_judged_so():
    done = rp.simulate(two_lanes(), FREE, bound=0.02, dependence="persistent", time_limit=5.0, steps=3)
    assert len(done.cycles) == 3 and all(c.risk <= 0.02 for c in done.cycles)


def test_risk_at_all_times_is_bounded_in_the_loop_too():
    scene = two_lanes(vehicle=rp.KinematicCar(max_speed=18.0))
    done = rp.simulate(scene, FREE, bound=0.1, between_steps="inflated", time_limit=5.0, steps=12)
    assert done.share("fallback") == 0 and all(c.risk <= 0.1 for c in done.cycles)
    for c in done.cycles[::5]:
        grid = 0.1 * np.arange(round((6.0 - c.time) / 0.1) + 1)
        agents = [rp.ConstantVelocity.fitted().predict(t.until(c.time), grid) for t in FREE]
        here = scene.with_task(start=rp.State(*c.states[0]), agents=agents, horizon=float(grid[-1]))
        wide = rp.inflated(here, 0.1)
        seen = [a.at(grid[: len(c.states)]) for a in wide.scenario.agents]
        risks = [rp.checker("exact")(c.states[:, :3], a, wide.scenario.ego) for a in seen]
        assert c.risk == pytest.approx(float(wide.stated(rp.trajectory_risk(risks, seen)).total), rel=1e-6)


def test_a_point_robot_among_walkers():
    walkers = [replace(track(n, x, y, 1.0), length=0.5, width=0.5) for n, x, y in (("a", -4, 3.5), ("b", -5, -3.5))]
    scene = rp.Scenario(
        start=rp.State(0, 0, 0, 0.5),
        goal=rp.Goal.at(6, 0, radius=0.6, time=(3, 6)),
        bounds=(-2, -4, 8, 4),
        horizon=6.0,
        vehicle=rp.PointRobot(),
    )
    done = rp.simulate(scene, walkers, bound=0.2, time_limit=5.0)
    assert done.status == "arrived" and done.collision is None
    assert_drivable(scene.vehicle, done.states, 0.1)


def test_a_tree_grows_from_what_is_left_of_a_plan():
    scene = overtake()
    plan = rp.plan(scene, bound=0.05, time_limit=20.0)
    states = np.column_stack([plan.poses, plan.speeds, plan.steering])
    evaluator = RiskEvaluator(scene.agents, scene.ego, rp.checker("exact"), scene.times)
    problem = Problem(scene, evaluator, states[1:])
    tree = Tree(problem, Budget(0.05, 1.0), 15, evaluator)
    count = tree.plant(problem.begun)
    assert count == len(states) - 1  # all but the arrival
    np.testing.assert_array_equal(tree.nodes[:count, :5], states[:-1])
    judged = evaluator.judge(np.ascontiguousarray(states[:-1, :3]))[0]
    assert tree.total[count - 1] == pytest.approx(float(judged.total), rel=1e-2)
    # what is above the limit is left out
    strict = Tree(problem, Budget(float(tree.total[count - 1]) / 2, 1.0), 15, evaluator)
    assert 1 <= strict.plant(problem.begun) < count
    found = rp.Rrt().search(problem, Budget(0.05, 20.0), 0)
    assert found.states is not None and found.counters["nodes"] >= count


BAD = {
    "replan": ({"replan": 0.15}, "replan: expected a whole number of the scenario's steps of 0.1 s, got 0.15 s"),
    "bound": ({"bound": 2}, "bound: expected a finite number in [0, 1], got 2"),
    "planner": ({"planner": "best"}, "planner: expected one of rrt, "),
    "dependence": ({"dependence": "none"}, "dependence: expected one of"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_settings_are_named(case):
    options, message = BAD[case]
    with pytest.raises(rp.InputError) as error:
        rp.simulate(two_lanes(), FREE, **options)
    assert message in str(error.value)


def test_command(tmp_path, capsys):
    scene = two_lanes().with_agents([agent("ahead", 45, 0, 12), agent("beside", -15, 3.5, 12)])
    rp.save_scenario(scene, tmp_path / "s.yaml")
    options = ["--bound", "0.05", "--time-limit", "5", "--json", "--out", str(tmp_path / "o")]
    assert main(["simulate", str(tmp_path / "s.yaml"), *options]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["status"] == "arrived" and told["collision"] is None and told["spent"] <= 0.05
    stored = json.loads((tmp_path / "o" / "simulation.json").read_text())
    assert stored["format"] == "riskplan-simulation" and len(stored["cycles"]) == told["decisions"]
    assert len(stored["tracks"]) == 2 and len(stored["states"]) == len(stored["times"])
    assert main(["simulate", str(tmp_path / "s.yaml"), "--steps", "2", "--time-limit", "5"]) == 1
    assert "time_up after 0.2 s" in capsys.readouterr().out


def test_stops_when_told():
    done = rp.simulate(two_lanes(), FREE, bound=0.02, time_limit=5.0, stop=lambda: True)
    assert done.status == "time_up" and not done.cycles and done.progress == 0


def test_what_is_known_of_a_track_does_not_depend_on_what_follows():
    times = 0.1 * np.arange(11)
    straight = np.column_stack([10.0 * times, 0.0 * times])
    veering = straight.copy()
    veering[6:, 1] = 3.0 * (times[6:] - times[5])
    known = [track_of("a", times, path, 4.5, 1.8).until(0.5) for path in (straight, veering)]
    np.testing.assert_array_equal(known[0].headings, known[1].headings)
    np.testing.assert_array_equal(known[0].speeds, known[1].speeds)
    parked = np.zeros((11, 2))
    parked[8:, 1] = [1.0, 2.0, 3.0]
    late = track_of("b", times, parked, 4.5, 1.8, heading=0.3)
    assert (late.headings[:8] == 0.3).all() and late.headings[-1] == pytest.approx(np.pi / 2)


def test_an_agent_seen_last_a_while_ago_is_predicted_from_there():
    """Recordings every half second, decisions every tenth: the last observation is not now."""
    times = np.array([-2.0, -1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0])
    track = Track(
        "slow", times, np.column_stack([30.0 + 10.0 * times, 0.0 * times]), 0 * times, 0 * times + 10.0, 4.5, 1.8
    )
    seen = []

    class Spy:
        def predict(self, past, at):
            seen.append((past.times[-1], at[0]))
            return rp.ConstantVelocity.fitted().predict(past, at)

    rp.simulate(overtake().with_agents(()), [track], predictor=Spy(), bound=0.3, steps=4, time_limit=5.0)
    assert len(seen) >= 4
    for i, (last, first) in enumerate(seen[:4]):
        assert last + first == pytest.approx(0.1 * i, abs=1e-9)
