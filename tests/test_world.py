"""The compiled static world against shapely, and goals and limits that must not be overlooked."""

import dataclasses

import numpy as np
import pytest
import shapely

import riskplan as rp
from riskplan.evaluator import RiskEvaluator
from riskplan.search import SearchResult
from riskplan.world import pack_goal
from tests.scenes import agent, overtake

PLANNERS = ("rrt", "prm")


def box(a, b, c, d):
    return np.array([[a, b], [c, b], [c, d], [a, d]], dtype=float)


def body(x, y, heading, car):
    c, s = np.cos(heading), np.sin(heading)
    corners = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * [car.length / 2, car.width / 2]
    return shapely.Polygon(corners @ np.array([[c, s], [-s, c]]) + [x, y])


def empty(**options):
    base = {
        "start": rp.State(0, 0, 0, 8),
        "goal": rp.Goal.at(30, 0, radius=3),
        "bounds": (-10, -10, 40, 10),
        "horizon": 6.0,
    }
    return rp.Scenario(**{**base, **options})


@pytest.mark.parametrize("size", [(0.5, 0.3), (4.5, 1.8)])
@pytest.mark.parametrize("seed", range(8))
def test_body_free_is_what_shapely_says(size, seed):
    """Round coordinates put edges through the middles of cells, vertices onto each other, obstacles side by side."""
    rng = np.random.default_rng(seed)
    car = rp.KinematicCar(length=size[0], width=size[1])
    obstacles = []
    for _ in range(4):
        x, y = rng.integers(-8, 34), rng.integers(-8, 8)
        obstacles.append(box(x, y, x + rng.integers(1, 8), y + rng.integers(1, 5)).astype(float))
    drivable = (box(-20, -6, 20, 6), box(20, -8, 50, 3), box(5, 6, 9, 12)) if seed % 2 else ()
    scene = empty(start=rp.State(0, 0, 0, 1), obstacles=tuple(obstacles), drivable=drivable, vehicle=car)
    allowed = shapely.box(-60, -60, 60, 60)
    if drivable:
        allowed = shapely.union_all([shapely.Polygon(p) for p in drivable])
    allowed = allowed.difference(shapely.union_all([shapely.Polygon(p) for p in obstacles]))
    wrong = close = 0
    for _ in range(1500):
        x, y, h = rng.uniform(-10, 40), rng.uniform(-10, 10), rng.uniform(-4, 4)
        if rng.random() < 0.3:
            x, y = float(round(x)), float(round(y))
        shape = body(x, y, h, car)
        if shape.exterior.distance(allowed.boundary) < 0.05:
            close += 1
            continue
        wrong += scene.world.free(x, y, h) != allowed.contains(shape)
    assert wrong == 0
    assert close < 1200


def test_found_wrong_before():
    small = rp.KinematicCar(length=0.8, width=0.6)
    clear = empty(start=rp.State(0, 0, 0, 2), bounds=(-10, -10, 10, 10), goal=rp.Goal.at(-2, 5), vehicle=small)
    assert dataclasses.replace(clear, obstacles=(box(1, -2, 6, 2),)).world.free(0, 0, 0)
    tiny = rp.KinematicCar(length=0.5, width=0.3)
    inside = empty(start=rp.State(1.25, -2.5, 0, 1), goal=rp.Goal.at(1.75, -2.5, radius=0.3), vehicle=tiny)
    inside = dataclasses.replace(inside, bounds=(-10, -10, 10, 10), obstacles=(box(-3, -3, 2, -1),), horizon=3.0)
    assert rp.plan(inside).status == "start_in_obstacle"
    # a drivable piece that only touches the box around the bounds must not make the world vanish
    touching = empty(
        goal=rp.Goal((rp.GoalRegion(box(7, 2, 9, 12)),)),
        bounds=(-5, -15, 10, 15),
        drivable=(box(-20, -3, 12, 3), box(15, -10, 25, 10)),
        vehicle=rp.KinematicCar(length=3, width=4),
    )
    assert not touching.world.free(0, 12, 0)


@pytest.mark.parametrize("planner", PLANNERS)
def test_no_driving_through_a_thin_wall_between_steps(planner):
    wall = box(20.0, -10.0, 20.1, 10.0)
    scene = empty(
        start=rp.State(0, 0, 0, 30),
        goal=rp.Goal.at(45, 0, radius=4),
        bounds=(-5, -5, 60, 5),
        time_step=0.25,
        obstacles=(wall,),
    )
    assert rp.plan(dataclasses.replace(scene, obstacles=()), planner=planner, time_limit=5.0).solved
    assert rp.plan(scene, planner=planner, time_limit=0.5).status == "no_plan_found"


@pytest.mark.parametrize("planner", PLANNERS)
def test_plans_go_around_obstacles(planner):
    obstacles = (box(12, -3, 16, 1), box(22, -1, 25, 6))
    scene = empty(goal=rp.Goal.at(33, 0, radius=4), obstacles=obstacles, horizon=8.0)
    plan = rp.plan(scene, planner=planner, time_limit=20.0, seed=1)
    assert plan.solved, plan.message
    blocked = shapely.union_all([shapely.Polygon(p) for p in obstacles])
    assert not any(blocked.intersects(body(*pose, scene.vehicle)) for pose in plan.poses)


@pytest.mark.parametrize("planner", PLANNERS)
def test_goal_heading_speed_and_window_count(planner):
    heading = np.pi  # driving west: the wrap-around is in the middle of the tolerance
    goal = rp.Goal.at(-25, 0, radius=4, heading=heading, heading_tolerance=0.1, speed=(3.0, 5.0), time=(4.0, 6.0))
    scene = empty(start=rp.State(0, 0, np.pi - 0.05, 8), goal=goal, bounds=(-50, -10, 10, 10))
    plan = rp.plan(scene, planner=planner, time_limit=20.0, seed=0)
    assert plan.solved, plan.message
    assert abs(np.angle(np.exp(1j * (plan.poses[-1, 2] - heading)))) <= 0.1 + 1e-9
    assert 3.0 - 1e-9 <= plan.speeds[-1] <= 5.0 + 1e-9
    assert 4.0 - 1e-9 <= plan.times[-1] <= 6.0 + 1e-9


@pytest.mark.parametrize(
    ("polygon", "name"),
    [([[10, -12], [20, 12], [20, -12], [10, 12]], "crossing"), ([[20, -10], [20, 10], [20, -10]], "no area")],
)
def test_polygons_without_a_clear_inside_are_refused(polygon, name):
    with pytest.raises(rp.InputError, match=r"obstacles\[0\]: expected a simple polygon with an area"):
        empty(obstacles=(np.array(polygon, dtype=float),))
    with pytest.raises(rp.InputError, match=r"goal.polygon: expected a simple polygon with an area"):
        rp.GoalRegion(np.array(polygon, dtype=float))


def test_a_roadmap_of_a_nimbler_car_is_made_anew():
    nimble = empty(start=rp.State(0, 0, 0, 3), goal=rp.Goal.at(22, 9, radius=2), bounds=(-5, -15, 40, 15), horizon=8.0)
    roadmap = rp.Roadmap.build(nimble, size=600, seed=0)
    stiff = dataclasses.replace(nimble, vehicle=rp.KinematicCar(max_curvature=0.03))
    plan = rp.plan(stiff, planner=rp.Prm(roadmap=roadmap), time_limit=3.0)
    if plan.solved:
        moved = np.linalg.norm(np.diff(plan.poses[:, :2], axis=0), axis=1)
        turn = np.abs(np.angle(np.exp(1j * np.diff(plan.poses[:, 2]))))
        assert (turn <= 0.03 * moved * 1.01 + 1e-6).all()


class Reckless:
    """A planner that returns the straight way whatever the budget."""

    def search(self, problem, budget, seed):
        steps = problem.scenario.steps
        x = np.linspace(0, 72, steps + 1)
        states = np.column_stack([x, np.full_like(x, 3.5), np.zeros_like(x), np.full_like(x, 12.0)])
        return SearchResult(states, 0.0, {}, np.zeros((0, 5)))


def test_the_final_judge_does_not_trust_the_planner():
    scene = overtake()
    plan = rp.plan(scene, planner=Reckless(), bound=0.01)
    assert plan.status == "no_plan_found" and "judged at risk" in plan.message
    assert plan.poses.shape == (0, 3)
    assert rp.plan(scene, planner=Reckless(), bound=1.0).solved


def test_start_at_risk_is_judged_not_charged():
    scene = overtake().with_agents([agent("there", 3.0, 3.5, 12.0), agent("here", 1.0, 3.5, 12.0)])
    assert rp.plan(scene, bound=1.0, time_limit=5.0).status == "solved"
    assert rp.plan(scene, bound=0.5).status == "start_at_risk"


def charges(scene, poses, dependence="independent", chunk=7):
    evaluator = RiskEvaluator(scene.agents, scene.ego, rp.checker("exact"), scene.times, dependence, resolution=1e-12)
    acc, total = evaluator.start(poses[0])
    for first in range(1, len(poses), chunk):
        after = np.empty_like(acc)
        total = evaluator.charge(poses[first : first + chunk], first, acc, np.inf, after)
        acc = after
    if dependence == "boole":  # uncapped, as the search adds it up
        marginals = evaluator.marginals(poses)
        return total, float(sum((a.step_weights * r.value).sum() for a, r in zip(scene.agents, marginals, strict=True)))
    return total, float(evaluator.judge(poses)[0].per_agent.sum())


@pytest.mark.parametrize("dependence", ["independent", "boole"])
@pytest.mark.parametrize("kind", ["persistent", "per_step", "moving weights"])
@pytest.mark.parametrize("offset", [2.0, 5.0, 9.0])
def test_charging_step_by_step_is_judging(dependence, kind, offset):
    """Start with real risk, weights that matter, agents from beside to many σ away: the search adds up to the judge."""
    base = overtake()
    cars = [agent("near", -4.0, 3.5 + offset, 12.0, ((0.7, 0.3, 0), (0.2, -0.5, -1.0), (0.1, 0, -3.5)))]
    cars.append(agent("ahead", 7.0, 3.5, 13.0, ((0.6, 0, 0), (0.4, 1.0, 0))))
    if kind != "persistent":
        cars = [dataclasses.replace(a, modes="per_step") for a in cars]
    if kind == "moving weights":
        drift = np.linspace(0.1, 0.8, 61)
        weights = np.column_stack([drift, 0.9 - drift, np.full(61, 0.1)])
        cars[0] = dataclasses.replace(cars[0], weights=weights)
    scene = base.with_agents(cars)
    x = 12.0 * scene.times
    poses = np.column_stack([x, np.full_like(x, 3.5), 0.02 * np.sin(x)])
    total, judged = charges(scene, poses, dependence)
    assert judged > 1e-6
    assert judged * (1 - 1e-9) <= total <= judged * 1.02 + 1e-9


def test_between_grid_times_agents_are_where_they_are():
    scene = overtake()
    evaluator = RiskEvaluator(scene.agents, scene.ego, rp.checker("exact"), scene.times)
    for time in (0.03, 1.27, 3.999):
        pose = np.array([14 * time + 5, 4.0, 0.1])
        agents = [a.at([time]) for a in scene.agents]
        risks = [rp.checker("exact")(pose[None], a, scene.ego) for a in agents]
        expected = float(rp.trajectory_risk(risks, agents).per_step[0])
        assert evaluator.at_time(pose, time) == pytest.approx(expected, rel=2e-2)


def test_what_is_not_known_is_not_valid():
    scene = overtake()
    late = scene.agents[0].at(scene.times[20:])
    evaluator = RiskEvaluator((scene.agents[1], late), scene.ego, rp.checker("exact"), scene.times)
    for time in (0.0, 0.5, 1.95):
        assert np.isnan(evaluator.at_time(np.array([30.0, 3.5, 0.0]), time))
    assert evaluator.at_time(np.array([41.0, 3.5, 0.0]), 2.0) > 0.1
    full = RiskEvaluator(scene.agents, scene.ego, rp.checker("exact"), scene.times)
    for pose in ([np.nan, 3.5, 0], [0, np.nan, 0], [0, 3.5, np.nan], [np.inf, 3.5, 0]):
        assert np.isnan(full.at_time(np.array(pose), 2.0))
        after = np.empty(full.groups)
        assert not full.charge(np.array([pose], dtype=float), 1, np.zeros(full.groups), np.inf, after) <= 1.0


def test_distance_to_the_goal_is_that_of_its_polygons():
    rng = np.random.default_rng(4)
    regions = [np.array([[0, 0], [4, 0], [1, 1], [0, 4]]) + shift for shift in ([0, 0], [7.0, -3.0], [-6.0, 5.0])]
    scene = dataclasses.replace(overtake(), goal=rp.Goal(tuple(rp.GoalRegion(r) for r in regions)))
    points = rng.uniform(-15, 15, (500, 2))
    found = pack_goal(scene).distances(points)
    union = shapely.union_all([shapely.Polygon(r) for r in regions])
    np.testing.assert_allclose(found, shapely.distance(union, shapely.points(points)), atol=1e-12)
    assert (found == 0).any()
