"""Every motion and every plan can be driven by its vehicle; bodies, files and refusals."""

from dataclasses import dataclass, fields, replace
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles_vehicles import assert_drivable, states_of
from scenes import agent, overtake

import riskplan as rp
from riskplan.kernels.steer import NODE, STATE, arrays, steer, steer_kernel
from riskplan.vehicles import VEHICLES, Metric, vehicle_class

LANES = np.array([[-50.0, 0.0, 1.0, 0.0, 250.0, 0.0], [-50.0, 3.5, 1.0, 0.0, 250.0, 0.0]])
unit = st.floats(-1, 1)


def moved(vehicle, start, u, steps=15, dt=0.1, lanes=LANES):
    out = np.full((steps, STATE), np.nan)
    node = np.array([*start, 0.0])
    assert len(node) == NODE
    driven = steer(vehicle.kernel.address, node, *u, steps, dt, vehicle.limits, lanes, out)
    return np.vstack([start, out[:driven]])


@pytest.mark.parametrize("name", VEHICLES)
@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    u=st.tuples(unit, unit, unit),
    speed=st.floats(0, 1),
    heading=st.floats(-3, 3),
    turned=unit,
    lanes=st.booleans(),
)
def test_motions_obey_the_equations_and_the_limits(name, u, speed, heading, turned, lanes):
    vehicle = vehicle_class(name)()
    low = -getattr(vehicle, "max_reverse_speed", 0.0)
    # steering as far as the speed allows: what a plan can have led to
    v = low + speed**2 * (min(vehicle.top_speed, 30.0) - low)
    angle = turned * vehicle.top_steering / (1 + 0.1 * v * v)
    states = moved(vehicle, (3.0, 1.0, heading, v, angle), u, lanes=LANES if lanes else LANES[:0])
    assert_drivable(vehicle, states, 0.1)


@pytest.mark.parametrize("name", VEHICLES)
def test_most_motions_are_possible_and_reach_both_ends_of_the_speed(name):
    vehicle, rng = vehicle_class(name)(), np.random.default_rng(3)
    speed = 0.3 * min(vehicle.top_speed, 30.0)
    ends = [moved(vehicle, (0, 0, 0, speed, 0), rng.uniform(-1, 1, 3)) for _ in range(300)]
    whole = [e[-1] for e in ends if len(e) == 16]
    assert len(whole) > 240
    low, high = np.min(whole, axis=0), np.max(whole, axis=0)
    assert low[3] < 0.4 * speed and high[3] > 1.25 * speed
    assert low[1] < -1e-2 * speed and high[1] > 1e-2 * speed


def test_a_reeds_shepp_car_turns_round_where_a_forward_car_cannot():
    back = moved(rp.ReedsSheppCar(), (0, 0, 0, 1.0, 0), (-0.7, 0.4, 0.1))
    assert back[-1, 3] < -1 and back[-1, 0] < 0
    assert (back[:, 3] == 0).any()  # it stands for an instant, on the grid
    forward = moved(rp.KinematicCar(), (0, 0, 0, 1.0, 0), (-0.7, 0.4, 0.1))
    assert forward[-1, 3] == 0 and forward[-1, 0] > 0


def test_the_bicycle_steers_no_faster_than_its_rate_and_slides_not():
    car = rp.KinematicBicycle(max_steering_rate=0.1, friction=0.3)
    states = moved(car, (0, 0, 0, 12.0, 0), (0.1, 1.0, 1.0), lanes=LANES[:0])
    assert np.abs(np.diff(states[:, 4])).max() <= 0.1 * 0.1 + 1e-12
    assert_drivable(car, states, 0.1)


ROAD = {"car": rp.KinematicCar, "reeds-shepp": rp.ReedsSheppCar, "bicycle": rp.KinematicBicycle}


@pytest.mark.parametrize("planner", ["rrt", "prm"])
@pytest.mark.parametrize("name", VEHICLES)
def test_plans_are_drivable_and_within_the_bound(name, planner):
    scene = plaza() if name == "point" else replace(overtake(), vehicle=ROAD[name](length=4.6, width=1.9))
    if planner == "prm" and name == "bicycle":
        with pytest.raises(rp.InputError, match="a KinematicBicycle cannot follow a roadmap's arcs"):
            rp.plan(scene, planner=planner)
        return
    for seed in (0,) if planner == "prm" else (0, 1):
        plan = rp.plan(scene, planner=planner, bound=0.05, time_limit=20.0, seed=seed)
        assert plan.solved, plan.message
        assert float(plan.risk.total) <= 0.05
        assert_drivable(scene.vehicle, states_of(plan), scene.time_step)


def plaza():
    """A round robot among two walkers and a pillar."""
    walkers = tuple(agent(n, x, y, 1.0, spread=0.4) for n, x, y in (("a", -2, 1.0), ("b", -4, -1.2)))
    return rp.Scenario(
        start=rp.State(0, 0, 0, 0.5),
        goal=rp.Goal.at(6, 0, radius=0.6, time=(3, 6)),
        bounds=(-2, -4, 8, 4),
        obstacles=(np.array([[2.5, -0.7], [3.5, -0.7], [3.5, 0.7], [2.5, 0.7]]),),
        agents=tuple(replace(w, length=0.4, width=0.4) for w in walkers),
        vehicle=rp.PointRobot(),
    )


def test_a_goal_behind_is_reached_in_reverse():
    box = np.array([[-9, -1], [-5, -1], [-5, 1], [-9, 1]])
    scene = rp.Scenario(
        start=rp.State(0, 0, 0, 0.0),
        goal=rp.Goal((rp.GoalRegion(box, 0.0, 0.4, (-3.0, 0.5)),)),
        bounds=(-12, -3, 4, 3),
        horizon=6.0,
        vehicle=rp.ReedsSheppCar(),
    )
    plan = rp.plan(scene, bound=None, time_limit=10.0)
    assert plan.solved, plan.message
    assert plan.speeds.min() < -0.5
    assert_drivable(scene.vehicle, states_of(plan), scene.time_step)
    stiff = rp.plan(replace(scene, vehicle=rp.KinematicCar()), bound=0.1, time_limit=0.5)
    assert not stiff.solved


def test_a_disc_passes_where_its_square_would_not():
    wall = np.array([[1, 0.4], [2, 0.4], [2, 2], [1, 2]])
    at = {"x": 0.72, "y": 0.12, "heading": 0.0}  # 0.396 m from the corner, which the square's own corner reaches
    scene = rp.Scenario(
        start=rp.State(0, 0, 0),
        goal=rp.Goal.at(0, 0),
        bounds=(-3, -3, 3, 3),
        horizon=1.0,
        obstacles=(wall,),
        vehicle=rp.PointRobot(radius=0.38),
    )
    assert scene.world.free(**at)
    assert not scene.world.free(0.74, 0.14, 0.0)
    assert not replace(scene, vehicle=rp.KinematicCar(length=0.76, width=0.76)).world.free(**at)
    assert scene.world.free(0.619, 1.0, 0.0) and not scene.world.free(0.621, 1.0, 0.0)


def test_a_point_robots_own_shape_is_its_disc():
    centres, forms = rp.PointRobot(radius=0.3).shape().pieces(rp.persistent(agent("a", 0, 0, 1)))
    assert centres.shape == (1, 2)
    np.testing.assert_allclose(forms[0], np.eye(2) / (0.3 + 0.5 * np.hypot(4.6, 1.9)) ** 2)


@pytest.mark.parametrize("name", VEHICLES)
def test_scenario_files_keep_the_vehicle(tmp_path, name):
    cls = vehicle_class(name)
    scene = replace(overtake(), vehicle=cls(**{fields(cls)[0].name: 1.25}))
    rp.save_scenario(scene, tmp_path / "s.yaml")
    assert rp.load_scenario(tmp_path / "s.yaml").vehicle == scene.vehicle


def test_files_without_a_type_have_a_car(tmp_path):
    rp.save_scenario(overtake(), tmp_path / "s.yaml")
    text = (tmp_path / "s.yaml").read_text()
    assert "vehicle: {length: 4.5, " in text
    (tmp_path / "s.yaml").write_text(text.replace("vehicle: {", "vehicle: {type: car, "))
    assert rp.load_scenario(tmp_path / "s.yaml").vehicle == rp.KinematicCar()


WRONG = {
    "another's key": (
        "{type: car, wheelbase: 3}",
        "vehicle.wheelbase: unknown key of a car; expected one of type, length",
    ),
    "unknown type": ("{type: boat}", "vehicle.type: expected one of car, reeds-shepp, bicycle, point; got 'boat'"),
    "sign": ("{type: point, radius: -1}", "vehicle.radius: expected a number > 0, got -1"),
    "long rear": ("{type: bicycle, rear: 3}", "vehicle.rear: expected at most the wheelbase 2.7 m, got 3"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_vehicles_in_files_are_named(tmp_path, case):
    text, message = WRONG[case]
    rp.save_scenario(overtake(), tmp_path / "s.yaml")
    lines = (tmp_path / "s.yaml").read_text().splitlines()
    lines = [f"vehicle: {text}" if line.startswith("vehicle:") else line for line in lines]
    (tmp_path / "s.yaml").write_text("\n".join(lines))
    with pytest.raises(rp.InputError) as error:
        rp.load_scenario(tmp_path / "s.yaml")
    assert message in str(error.value)


def test_starts_that_the_vehicle_cannot_be_in_are_refused():
    scene = overtake()
    with pytest.raises(rp.InputError, match=r"start.speed: expected a number >= 0 for a KinematicCar, got -1"):
        replace(scene, start=rp.State(0, 3.5, 0, -1))
    with pytest.raises(rp.InputError, match=r"start.steering: expected at most 0.6 rad either way"):
        replace(scene, vehicle=rp.KinematicBicycle(), start=rp.State(0, 3.5, 0, 1, 0.7))
    with pytest.raises(rp.InputError, match=r"vehicle: expected a Vehicle"):
        replace(scene, vehicle="car")
    assert replace(scene, vehicle=rp.ReedsSheppCar(), start=rp.State(0, 3.5, 0, -1)).start.speed == -1


@dataclass(frozen=True)
class Sled(rp.Vehicle):
    """A vehicle in one file: it slides along x, pushed by u1."""

    type: ClassVar[str] = "sled"
    metric: ClassVar[Metric] = Metric(3.0, 0.5, 4.0)
    body = (2.0, 1.0)
    top_speed, top_acceleration, top_turn = 20.0, 3.0, 0.0
    limits = np.zeros(16)

    @property
    def kernel(self):
        return slide


@steer_kernel
def slide(node_, u1, u2, u3, steps, dt, limits_, lanes_, count, out_):
    node, _, _, out = arrays(node_, limits_, lanes_, count, out_, steps)
    x, v = node[0], node[3]
    for i in range(steps):
        after = min(max(v + 3.0 * u1 * dt, 0.0), 20.0)
        x, v = x + 0.5 * (v + after) * dt, after
        out[i, 0], out[i, 1], out[i, 2], out[i, 3], out[i, 4] = x, node[1], node[2], v, 0.0
    return steps


def test_adding_a_vehicle_is_one_file():
    plan = rp.plan(replace(overtake(agents=1), vehicle=Sled()), bound=0.5, time_limit=10.0)
    assert plan.solved, plan.message
    assert (plan.poses[:, 1] == 3.5).all() and np.abs(np.diff(plan.speeds)).max() <= 0.3 + 1e-9


def test_every_vehicle_declares_itself():
    for name in VEHICLES:
        cls = vehicle_class(name)
        assert cls.type == name and isinstance(cls.metric, Metric)
        vehicle = cls()
        assert vehicle.limits.shape == (16,) and vehicle.top_speed > 0 and vehicle.top_turn > 0


def test_the_steering_angle_is_part_of_the_plan_and_of_its_file(tmp_path):
    scene = replace(overtake(), vehicle=rp.KinematicBicycle(), start=rp.State(0, 3.5, 0, 12, 0.02))
    plan = rp.plan(scene, bound=0.05, time_limit=20.0)
    assert plan.solved and plan.steering[0] == 0.02 and np.abs(plan.steering).max() > 0
    rp.save_plan(plan, tmp_path / "plan.json")
    np.testing.assert_array_equal(rp.load_plan(tmp_path / "plan.json").steering, plan.steering)
