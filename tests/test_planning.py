"""Plans: within the bound, reproducible, dynamically feasible, and honest about why there is none."""

import dataclasses

import numpy as np
import pytest

import riskplan as rp
from riskplan.evaluator import RiskEvaluator
from tests.scenes import agent, overtake

PLANNERS = ("rrt", "prm", "prm-lazy")


@pytest.fixture(scope="module")
def scene():
    return overtake()


@pytest.mark.parametrize("planner", PLANNERS)
@pytest.mark.parametrize("bound", [0.1, 0.02])
def test_plan_is_within_its_bound_by_an_independent_judge(scene, planner, bound):
    plan = rp.plan(scene, planner=planner, bound=bound, time_limit=20.0, seed=1)
    assert plan.status == "solved", plan.message
    assert plan.risk.total <= bound
    # the judge again, through the public primitives alone
    risks = [rp.checker("exact")(plan.poses, a.at(plan.times), scene.ego) for a in scene.agents]
    again = rp.trajectory_risk(risks, [a.at(plan.times) for a in scene.agents])
    assert again.total == pytest.approx(float(plan.risk.total), rel=1e-12)
    assert again.boole == pytest.approx(float(plan.risk.boole), rel=1e-12)
    # a marginal that changes no digit of the total may be stated by its bound, never below the truth
    idle = 1e-14 * float(plan.risk.total)
    for stated, exact in zip(plan.marginals, risks, strict=True):
        np.testing.assert_allclose(stated, exact.value, rtol=1e-12, atol=idle)
        assert (stated >= exact.value * (1 - 1e-12)).all()
    # and by sampling the agents, which knows of no formula: the union bound over discs is never below the sampled union
    report = rp.audit(plan, scene, checkers=["imhof"], monte_carlo=50_000, seed=3)
    assert report.sampled.interval[0] <= bound
    assert report.consistent
    assert report.verdicts[0].risk.total == pytest.approx(float(plan.risk.total), rel=1e-9)


@pytest.mark.parametrize("planner", PLANNERS)
def test_trajectory_obeys_the_vehicle_and_the_goal(scene, planner):
    plan = rp.plan(scene, planner=planner, bound=0.1, time_limit=20.0, seed=2)
    assert plan.solved, plan.message
    car, dt = scene.vehicle, scene.time_step
    np.testing.assert_allclose(np.diff(plan.times), dt, rtol=1e-9)
    start = scene.start
    np.testing.assert_allclose(plan.poses[0], [start.x, start.y, start.heading])
    assert plan.speeds[0] == start.speed
    assert (plan.speeds >= 0).all() and (plan.speeds <= car.max_speed + 1e-9).all()
    acceleration = np.diff(plan.speeds) / dt
    assert (acceleration <= car.max_acceleration + 1e-6).all() and (acceleration >= -car.max_deceleration - 1e-6).all()
    travelled = 0.5 * (plan.speeds[1:] + plan.speeds[:-1]) * dt
    moved = np.linalg.norm(np.diff(plan.poses[:, :2], axis=0), axis=1)
    # arcs: the chord is never longer than the way, and hardly shorter
    assert (moved <= travelled + 1e-6).all() and (moved >= 0.98 * travelled - 1e-6).all()
    turn = np.abs(np.angle(np.exp(1j * np.diff(plan.poses[:, 2]))))
    assert (turn <= car.max_curvature * travelled + 1e-6).all()
    fastest = np.maximum(plan.speeds[1:], plan.speeds[:-1])
    assert (turn * fastest**2 <= car.max_lateral_acceleration * 1.001 * travelled + 1e-6).all()
    region = scene.goal.regions[0]
    from shapely import Point, Polygon, union_all

    assert Polygon(region.polygon).buffer(1e-9).contains(Point(plan.poses[-1, :2]))
    assert abs(plan.poses[-1, 2] - region.heading) <= region.heading_tolerance
    assert scene.goal.time[0] - 1e-9 <= plan.times[-1] <= scene.goal.time[1] + 1e-9
    road = union_all([Polygon(p) for p in scene.drivable])
    for x, y, h in plan.poses:
        c, s = np.cos(h), np.sin(h)
        box = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * [car.length / 2, car.width / 2]
        assert road.buffer(1e-6).contains(Polygon(box @ np.array([[c, s], [-s, c]]) + [x, y]))


@pytest.mark.parametrize("planner", PLANNERS)
def test_same_seed_same_plan(scene, planner):
    first, second, other = (
        rp.plan(scene, planner=planner, bound=0.1, time_limit=20.0, seed=seed) for seed in (5, 5, 6)
    )
    assert first.solved and second.solved and other.solved
    np.testing.assert_array_equal(first.poses, second.poses)
    assert first.risk.total == second.risk.total
    assert first.poses.shape != other.poses.shape or not np.array_equal(first.poses, other.poses)


@pytest.mark.parametrize("planner", PLANNERS)
def test_no_bound_minimises(scene, planner):
    quick = rp.plan(scene, planner=planner, bound=0.5, time_limit=20.0, seed=1)
    least = rp.plan(scene, planner=planner, bound=None, time_limit=1.5, seed=1)
    assert quick.solved and least.solved
    assert least.bound is None
    assert least.risk.total < quick.risk.total


@pytest.mark.parametrize("planner", PLANNERS)
@pytest.mark.parametrize(
    ("checker", "bound"),
    [("imhof", 0.1), ("halfspace", 0.9), ("chebyshev", 0.9), ("sos", 0.6), ("monte-carlo", 0.1)],
)
def test_any_checker_by_name(planner, checker, bound):
    scene = overtake(agents=1, modes=1, gap=40.0)
    backend = rp.checker("monte-carlo", samples=500) if checker == "monte-carlo" else checker
    plan = rp.plan(scene, planner=planner, checker=backend, bound=bound, time_limit=30.0, seed=0)
    assert plan.solved, plan.message
    assert plan.risk.total <= bound
    assert plan.settings["checker"] == checker
    if checker != "monte-carlo":
        exact = rp.audit(plan, scene, checkers=["exact"], monte_carlo=0).verdicts[0].risk
        assert exact.total <= plan.risk.total * (1 + 1e-9)


@pytest.mark.parametrize("planner", PLANNERS)
def test_sos_by_clarabel_plans_too(planner):
    # one ellipse instead of six discs: every solve is a millisecond
    ego = rp.EgoEllipsoid.around(4.6, 1.9, 4.6, 1.9, relative_heading=0.0)
    scene = dataclasses.replace(overtake(agents=1, modes=1, gap=80.0), ego=ego)
    backend = rp.checker("sos", order=4, solver="clarabel")
    plan = rp.plan(scene, planner=planner, checker=backend, bound=0.95, time_limit=60.0, seed=0)
    assert plan.solved, plan.message


@pytest.mark.parametrize("planner", PLANNERS)
def test_moment_only_agents(planner):
    gaussian = overtake(agents=1, modes=1, gap=40.0)
    scene = gaussian.with_agents([a.moments(8) for a in gaussian.agents])
    plan = rp.plan(scene, planner=planner, checker="sos", bound=0.6, time_limit=30.0, seed=0)
    assert plan.solved, plan.message
    with pytest.raises(rp.InputError, match="needs a Gaussian mixture"):
        rp.plan(scene, planner=planner, checker="exact")
    mixed = gaussian.with_agents([*scene.agents, *gaussian.agents])
    risk, _ = RiskEvaluator(mixed.agents, mixed.ego, rp.checker("sos"), mixed.times).judge(plan.poses)
    assert risk.per_agent[0] == pytest.approx(risk.per_agent[1], rel=1e-6)


@pytest.mark.parametrize("dependence", ["independent", "boole"])
def test_dependence_is_what_is_bounded(scene, dependence):
    plan = rp.plan(scene, bound=0.05, dependence=dependence, time_limit=20.0, seed=4)
    assert plan.solved
    assert plan.risk.dependence == dependence
    if dependence == "boole":
        assert plan.risk.boole <= 0.05


class TestNoPlan:
    def test_bound_out_of_reach(self, scene):
        wall = agent("wall", 40, 3.5, 0.0, spread=4.0)
        blocked = scene.with_agents(
            [dataclasses.replace(wall, name=f"w{i}", means=wall.means + [0, 3.5 * (i - 1)]) for i in range(3)]
        )
        for planner in PLANNERS:
            plan = rp.plan(blocked, planner=planner, bound=1e-6, time_limit=0.5)
            assert plan.status == "no_plan_found"
            assert plan.poses.shape == (0, 3) and plan.risk is None
            assert plan.stats["lowest_risk_seen"] is None or plan.stats["lowest_risk_seen"] > 1e-6
            assert "1e-06" in plan.message

    def test_start_at_risk(self, scene):
        on_top = agent("there", 0.5, 3.5, 12.0)
        plan = rp.plan(scene.with_agents([on_top]), bound=0.01)
        assert plan.status == "start_at_risk" and "above the bound 0.01" in plan.message

    def test_start_in_obstacle(self, scene):
        s = scene.start
        block = np.array([[s.x + 1, s.y - 1], [s.x + 3, s.y - 1], [s.x + 3, s.y + 1]])
        for planner in PLANNERS:
            assert (
                rp.plan(dataclasses.replace(scene, obstacles=(block,)), planner=planner).status == "start_in_obstacle"
            )

    def test_goal_in_obstacle(self, scene):
        low, high = (
            scene.goal.regions[0].polygon.min(axis=0) - 1,
            scene.goal.regions[0].polygon.max(axis=0) + 1,
        )
        block = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
        assert rp.plan(dataclasses.replace(scene, obstacles=(block,))).status == "goal_in_obstacle"

    def test_goal_too_far(self, scene):
        far = rp.Goal.at(119, 3.5, radius=0.5, time=(0, 1.0))
        assert rp.plan(dataclasses.replace(scene, goal=far)).status == "goal_unreachable"

    def test_time_limit_holds(self, scene):
        for planner in PLANNERS:
            plan = rp.plan(scene, planner=planner, bound=1e-12, time_limit=0.3)
            assert not plan.solved
            assert plan.stats["search"] < 2.0


class TestRefusals:
    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"planner": "rrtt"}, r"planner: expected one of rrt, rrt-star, prm, .*; got 'rrtt'"),
            ({"checker": "exac"}, r"checker: expected one of exact, imhof"),
            ({"bound": 1.5}, r"bound: expected a finite number in \[0, 1\], got 1.5"),
            ({"bound": float("nan")}, r"bound: expected a finite number"),
            ({"time_limit": -1}, r"time_limit: expected"),
            ({"seed": -1}, r"seed: expected an integer"),
            ({"seed": 1.5}, r"seed: expected an integer"),
            ({"dependence": "maybe"}, r"dependence: expected one of independent, persistent, boole"),
            (
                {"motion_stepps": 3},
                r"rrt: unknown option 'motion_stepps'; expected one of motion_steps, goal_bias",
            ),
        ],
    )
    def test_names_and_values(self, scene, options, message):
        with pytest.raises(rp.InputError, match=message):
            rp.plan(scene, **options)

    def test_agent_that_ends_early(self, scene):
        short = scene.agents[0].at(scene.times[:20])
        with pytest.raises(rp.InputError, match=r"agents\[0\].times: expected to cover"):
            dataclasses.replace(scene, agents=(short,), horizon=6.0)

    def test_start_outside_bounds(self, scene):
        with pytest.raises(rp.InputError, match=r"start: \(500, 3.5\) lies outside the bounds"):
            dataclasses.replace(scene, start=rp.State(500, 3.5, 0))


@pytest.mark.parametrize("checker", ["exact", "cascade", "unimodal-halfspace"])
def test_charge_is_never_below_the_judge_and_close_to_it(scene, checker):
    """The search's accumulated total, with culling, bounds and coarse quadrature, against the full evaluation."""
    backend = rp.checker("cascade", resolution=1e-7) if checker == "cascade" else rp.checker(checker)
    evaluator = RiskEvaluator(scene.agents, scene.ego, backend, scene.times, resolution=1e-4)
    rng = np.random.default_rng(0)
    for _ in range(30):
        x = np.cumsum(np.full(61, rng.uniform(0.8, 1.6)))
        y = 3.5 + np.linspace(0, rng.uniform(-3.5, 3.5), 61)
        poses = np.column_stack([x, y, rng.uniform(-0.05, 0.05, 61)])
        acc, total = evaluator.start(poses[0])
        for first in range(1, 61, 7):
            after = np.empty_like(acc)
            total = evaluator.charge(poses[first : first + 7], first, acc, np.inf, after)
            acc = after
        judged, _ = evaluator.judge(poses)
        uncapped = float(judged.per_agent.sum())
        assert total >= uncapped * (1 - 1e-12)
        assert total <= uncapped * 1.02 + 2e-4


def test_scenes_that_differ_in_their_agents_share_the_static_world(scene):
    unused = dataclasses.replace(scene)
    assert unused.with_agents(()).world is unused.with_agents(scene.agents).world is unused.world


def test_cascade_plans_as_exact_does(scene):
    exact, cascade = (rp.plan(scene, checker=c, bound=0.02, time_limit=20.0, seed=3) for c in ("exact", "cascade"))
    np.testing.assert_array_equal(exact.poses, cascade.poses)
    assert exact.risk.total <= cascade.risk.total <= exact.risk.total * (1 + 1e-6)


def test_translation_changes_nothing(scene):
    shift = np.array([1e5, -1e5])
    s = scene.start
    moved = dataclasses.replace(
        scene,
        start=rp.State(s.x + shift[0], s.y + shift[1], s.heading, s.speed),
        goal=rp.Goal(
            tuple(dataclasses.replace(r, polygon=r.polygon + shift) for r in scene.goal.regions),
            scene.goal.time,
        ),
        bounds=tuple(np.array(scene.bounds) + [*shift, *shift]),
        agents=tuple(dataclasses.replace(a, means=a.means + shift) for a in scene.agents),
        drivable=tuple(p + shift for p in scene.drivable),
        lanes=tuple(p + shift for p in scene.lanes),
    )
    plan = rp.plan(scene, bound=0.1, time_limit=20.0, seed=1)
    judged, _ = RiskEvaluator(moved.agents, moved.ego, rp.checker("exact"), moved.times).judge(
        plan.poses + [*shift, 0.0]
    )
    assert judged.total == pytest.approx(float(plan.risk.total), rel=1e-7)
    assert rp.plan(moved, bound=0.1, time_limit=20.0, seed=1).solved


def test_roadmap_is_kept_saved_and_queried_again(scene, tmp_path):
    roadmap = rp.Roadmap.build(scene, size=400, seed=3)
    assert len(roadmap.vertices) == 400
    roadmap.save(tmp_path / "map.npz")
    again = rp.Roadmap.load(tmp_path / "map.npz")
    np.testing.assert_array_equal(roadmap.ends, again.ends)
    np.testing.assert_array_equal(roadmap.lengths, again.lengths)
    first = rp.plan(scene, planner=rp.Prm(roadmap=roadmap), bound=0.1, time_limit=20.0, seed=0)
    same = rp.plan(scene, planner=rp.Prm(roadmap=again), bound=0.1, time_limit=20.0, seed=0)
    assert first.solved and first.stats["roadmaps"] == 1
    np.testing.assert_array_equal(first.poses, same.poses)
    update = scene.with_agents([agent("new", 15, 3.5, 6.0)])
    assert update.world is scene.world
    other = rp.plan(update, planner=rp.Prm(roadmap=roadmap), bound=0.1, time_limit=20.0, seed=0)
    assert other.solved and not np.array_equal(other.poses, first.poses)
    (tmp_path / "bad.npz").write_bytes(b"no")
    with pytest.raises(rp.InputError, match="not a roadmap"):
        rp.Roadmap.load(tmp_path / "bad.npz")


def test_unknown_risk_is_never_no_risk(scene):
    """Agents that cannot be sampled give no sampled total; with some of them, one that is marked incomplete."""
    plan = rp.plan(scene, bound=0.1, time_limit=20.0, seed=1)
    moments = [a.moments(4) for a in scene.agents]
    nothing = rp.audit(plan, scene.with_agents(moments), checkers=["halfspace"], monte_carlo=1000).sampled
    assert np.isnan(nothing.total) and np.isnan(nothing.interval).all() and not nothing.complete
    some = rp.audit(plan, scene.with_agents([scene.agents[0], *moments[1:]]), checkers=[], monte_carlo=1000).sampled
    assert not np.isnan(some.total) and not some.complete and np.isnan(some.per_agent[1])


class TestBounds:
    """A bound per step and per agent beside the one on the total, held by the search and judged at the end."""

    @pytest.mark.parametrize("planner", PLANNERS)
    @pytest.mark.parametrize("dependence", ["independent", "boole", "persistent"])
    def test_all_are_held(self, scene, planner, dependence):
        agents = [rp.persistent(a) for a in scene.agents] if dependence == "persistent" else scene.agents
        asked = {"dependence": dependence, "time_limit": 20.0, "seed": 2, "planner": planner}
        free = rp.plan(scene.with_agents(agents), bound=0.3, **asked)
        assert free.solved
        step, agent_ = 0.3 * float(free.risk.per_step.max()), 0.5 * float(free.risk.per_agent.max())
        for bounds in ({"step_bound": step}, {"agent_bound": agent_}, {"step_bound": step, "agent_bound": agent_}):
            plan = rp.plan(scene.with_agents(agents), bound=0.3, **bounds, **asked)
            assert plan.solved, plan.message
            assert plan.risk.total <= 0.3
            assert plan.risk.per_step.max() <= bounds.get("step_bound", 1.0)
            assert plan.risk.per_agent.max() <= bounds.get("agent_bound", 1.0)
            assert plan.settings["step_bound"] == bounds.get("step_bound")

    def test_without_a_total(self, scene):
        plan = rp.plan(scene, bound=1.0, step_bound=5e-3, time_limit=20.0, seed=1)
        assert plan.solved and plan.risk.per_step.max() <= 5e-3

    def test_start(self, scene):
        near = scene.with_agents([agent("near", 6.0, 3.5, 12.0)])
        free = rp.plan(near, bound=1.0, time_limit=5.0)
        first = float(free.risk.per_step[0])
        assert free.solved and first > 1e-6
        assert rp.plan(near, bound=1.0, step_bound=0.9 * first).status == "start_at_risk"
        assert "on agents" in rp.plan(near, bound=1.0, agent_bound=0.9 * first).message

    def test_out_of_reach_is_told(self, scene):
        plan = rp.plan(scene, bound=0.5, step_bound=1e-30, time_limit=0.2)
        assert plan.status == "no_plan_found" and "0.5, 1e-30 per step" in plan.message


@pytest.mark.parametrize("planner", PLANNERS)
def test_iterations_end_a_search_and_make_it_repeatable(scene, planner):
    few = rp.plan(scene, planner=planner, bound=1e-12, time_limit=60.0, iterations=40)
    assert few.status == "no_plan_found" and few.stats["ended_by"] == "iterations"
    late = rp.plan(scene, planner=planner, bound=1e-12, time_limit=0.05, iterations=10**9)
    assert late.stats["ended_by"] == "time"
    assert rp.plan(scene, planner=planner, bound=0.3, time_limit=60.0).stats["ended_by"] == "plan"
    one, two = (rp.plan(scene, planner=planner, bound=None, time_limit=60.0, iterations=900, seed=7) for _ in range(2))
    assert one.stats["ended_by"] == two.stats["ended_by"] == "iterations"
    assert one.status == two.status
    np.testing.assert_array_equal(one.poses, two.poses)
    assert one.stats["iterations"] == two.stats["iterations"]


def test_what_cannot_hold_the_bound_is_refused_with_the_reason(scene):
    with pytest.raises(rp.InputError, match="^bit-star: .*backward in time.*; expected one of rrt, "):
        rp.plan(scene, planner="bit-star")


@pytest.mark.parametrize("planner", list(rp.planners()))
def test_a_start_may_be_turned_more_than_once(planner):
    """Recorded headings go beyond π, where OMPL's spaces end: `rrt` gave up before its first motion."""
    scene = overtake().with_agents(())
    turned = scene.with_task(start=dataclasses.replace(scene.start, heading=scene.start.heading + 2.0 * np.pi))
    plans = [rp.plan(s, planner, time_limit=20.0, iterations=3000, seed=3) for s in (scene, turned)]
    assert all(plan.solved for plan in plans), [plan.message for plan in plans]
    assert np.abs(plans[1].poses[:, 2]).max() < np.pi


def test_judging_late_judges_less():
    """`prm-lazy` charges only the poses of ways that lead to the goal."""
    scene = overtake()
    steps = {}
    for planner in ("prm", "prm-lazy"):
        plans = [rp.plan(scene, planner, bound=0.05, time_limit=20.0, seed=seed) for seed in range(10)]
        assert all(plan.solved and float(plan.risk.total) <= 0.05 for plan in plans)
        steps[planner] = sum(plan.stats["checked_steps"] for plan in plans)
        assert min(plan.stats["checked_steps"] for plan in plans) >= 44  # the plan itself, at least
    assert steps["prm-lazy"] < 0.9 * steps["prm"], steps


@pytest.mark.parametrize("planner", ["rrt", "prm"])
def test_the_lowest_risk_seen_does_not_depend_on_when_it_is_worked_out(planner, monkeypatch):
    """Arrivals above the bound are charged up to it, and their whole risk later; at once, it is the same."""
    seen = []
    for wait in (0, 3, 64, 10**9):
        monkeypatch.setattr("riskplan.search._WAIT", wait)
        plan = rp.plan(overtake(), planner, bound=1e-12, time_limit=60.0, iterations=1500)
        assert plan.status == "no_plan_found"
        seen.append(plan.stats["lowest_risk_seen"])
    assert seen[0] is not None and seen[0] > 1e-12 and seen == [seen[0]] * 4
