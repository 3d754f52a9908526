"""Edges of roadmaps, and the search along them: smooth, free, drivable, able to stop and to wait."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles_vehicles import assert_drivable, states_of
from scenes import agent, overtake
from shapely import LineString, Polygon

import riskplan as rp
from riskplan.kernels.dubins import along, biarc
from riskplan.kernels.roadmap import join
from riskplan.ompl import prm

FAR = np.arange(101) * 0.1


@settings(max_examples=200, deadline=None, derandomize=True)
@given(
    x=st.floats(1, 30), y=st.floats(-15, 15), heading=st.floats(-1.5, 1.5), turned=st.floats(-3, 3), at=st.floats(0, 1)
)
def test_a_biarc_joins_its_poses_smoothly(x, y, heading, turned, at):
    c, s = np.cos(turned), np.sin(turned)
    curve = np.zeros(6)
    end = (7 + c * x - s * y, -3 + s * x + c * y, turned + heading)
    length = biarc(7.0, -3.0, turned, *end, curve)
    if not np.isfinite(length):
        return
    assert length >= np.hypot(x, y) * (1 - 1e-12)
    reached = along(7.0, -3.0, turned, curve, length)
    np.testing.assert_allclose(reached[:2], end[:2], atol=1e-7 * (1 + length))
    assert abs(np.angle(np.exp(1j * (reached[2] - end[2])))) < 1e-7
    # the heading is that of the way, and the way as long as it says: by differences, at any place
    place, h = at * length, 1e-4
    here, there = (np.array(along(7.0, -3.0, turned, curve, place + d)) for d in (0.0, h))
    step = there[:2] - here[:2]
    assert np.hypot(*step) == pytest.approx(h, rel=1e-3)
    assert abs(np.angle(np.exp(1j * (np.arctan2(step[1], step[0]) - here[2])))) < 1e-3 + h * np.abs(curve[3:]).max()


def test_a_biarc_bends_no_more_than_a_dubins_curve_where_both_serve():
    a, b = np.array([0.0, 0.0, 0.0]), np.array([20.0, 3.5, 0.0])
    curve, bends = np.zeros(6), []
    for kind in range(3):
        assert join(a, b, np.array([15.0, 10.0]), kind, curve) < np.inf
        bends.append(np.abs(curve[3:]).max())
    assert bends[0] < min(bends[1:])
    assert join(a, np.array([5.0, 3.0, 0.0]), np.array([15.0, 10.0]), 0, curve) == np.inf  # tighter than the tightest


def street(width=3.4, **changed):
    """A street that winds, hardly wider than the car, at a speed that its bends allow for only in part."""
    s = np.linspace(-10, 90, 201)
    line = np.column_stack([s, 6.0 * np.sin(s / 9.0)])
    scene = rp.Scenario(
        start=rp.State(0.0, 0.0, float(np.arctan2(6.0, 9.0)), 8.0),
        goal=rp.Goal((rp.GoalRegion(np.array([[50, -9], [56, -9], [56, 9], [50, 9]])),), (8.0, 9.0)),
        bounds=(-10.0, -12.0, 90.0, 12.0),
        horizon=10.0,
        drivable=(np.array(LineString(line).buffer(width / 2, cap_style="flat").exterior.coords)[:-1],),
        lanes=(line,),
    )
    return replace(scene, **changed)


def test_edges_keep_to_the_street():
    scene = street()
    roadmap = rp.Roadmap.build(scene, 300, seed=1)
    assert len(roadmap.ends) > 200
    # looked at every half body length here, and finely when they are driven
    road = Polygon(scene.drivable[0]).buffer(0.25)
    half = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * [2.25, 0.9]
    for (source, target), curve, length in zip(
        roadmap.ends[::5], roadmap.curves[::5], roadmap.lengths[::5], strict=True
    ):
        begin, end = roadmap.vertices[source], roadmap.vertices[target]
        np.testing.assert_allclose(along(*begin, curve, length)[:2], end[:2], atol=1e-6)
        for place in np.linspace(0, length, 5):
            x, y, heading = along(*begin, curve, place)
            c, s = np.cos(heading), np.sin(heading)
            assert road.contains(Polygon(half @ np.array([[c, s], [-s, c]]) + [x, y]))


@pytest.mark.parametrize("seed", range(3))
def test_narrow_winding_streets(seed):
    scene = street()
    plan = rp.plan(scene, "prm", bound=0.1, time_limit=20.0, seed=seed)
    assert plan.solved, plan.message
    assert_drivable(scene.vehicle, states_of(plan), scene.time_step)
    for pose in plan.poses:
        assert scene.world.free(*pose)


def test_it_waits_for_one_who_crosses():
    """Who stands in the way for five seconds and then is gone: one has to stop before him, and go on."""
    lane = np.array([[-20.0, 0.0], [80.0, 0.0]])
    walker = agent("walker", 25.0, 0.0, 0.0, spread=0.3, times=FAR)
    means = walker.means.copy()
    means[:, 0, 1] = np.where(FAR < 5.0, 0.0, 20.0 * (FAR - 5.0))
    walker = rp.GaussianMixturePrediction(
        FAR, [1.0], means, 0.05 * np.tile(np.eye(2), (101, 1, 1, 1)), name="walker", length=0.5, width=0.5
    )
    scene = rp.Scenario(
        start=rp.State(0.0, 0.0, 0.0, 7.0),
        goal=rp.Goal.at(45.0, 0.0, radius=3.0),
        bounds=(-10.0, -1.5, 70.0, 1.5),
        agents=(walker,),
        lanes=(lane,),
        horizon=10.0,
    )
    for seed in range(2):  # counted in iterations, not by the clock: a busy machine finds the same
        plan = rp.plan(scene, "prm", bound=0.01, time_limit=120.0, iterations=400_000, seed=seed)
        assert plan.solved, plan.message
        assert_drivable(scene.vehicle, states_of(plan), scene.time_step)
        assert plan.times[-1] > 6.5 and plan.speeds.min() < 4.0
        assert float(plan.risk.total) <= 0.01
    still = rp.plan(replace(scene, start=rp.State(21.0, 0.0, 0.0, 0.0)), "prm", bound=0.01, time_limit=20.0)
    assert still.solved and (still.speeds[:20] == 0.0).all()  # at a standstill it stays until the way is free


def test_a_larger_roadmap_does_not_take_longer_than_is_left():
    scene = overtake()
    for limit in (0.3, 1.0):
        tries = [rp.plan(scene, "prm", bound=1e-12, time_limit=limit) for _ in range(3)]
        assert not any(plan.solved for plan in tries)
        # the clock runs on while another process has the processor: one try must be undisturbed
        assert min(plan.stats["search"] for plan in tries) < limit + 0.15


WRONG = {
    "far": ({"ends": [[0, 900]]}, "ends: expected numbers of the 200 vertices"),
    "order": ({"ends": [[5, 1], [0, 2]], "kinds": [0, 0]}, "in order of the first"),
    "shape": ({"ends": [0, 1]}, r"ends: expected \(E, 2\) int64"),
    "kind": ({"kinds": [9]}, r"kinds: expected \(1,\) int64 in 0..2"),
    "no way": ({"ends": [[0, 0]]}, "pairs of vertices that a curve joins"),
    "both ways": ({"ends": [[0, 201]]}, "ends: expected edges that are driven one way, forwards or backwards"),
}


@pytest.mark.parametrize("case", WRONG)
def test_files_whose_edges_are_none_are_refused(tmp_path, case):
    changed, message = WRONG[case]
    roadmap = rp.Roadmap.build(overtake(), 200)
    arrays = {"vertices": roadmap.vertices, "radii": np.array([20.0, 5.0]), "longest": 20.0, "kinds": [0]}
    arrays |= {"ends": [roadmap.ends[0]], **changed}
    np.savez(tmp_path / "map.npz", **arrays)
    with pytest.raises(rp.InputError, match=message):
        rp.Roadmap.load(tmp_path / "map.npz")


def test_a_lazy_search_takes_the_same_roadmap():
    scene = overtake()
    roadmap = rp.Roadmap.build(scene, 400, seed=3)
    for planner in (rp.Prm(roadmap=roadmap), rp.PrmLazy(roadmap=roadmap)):
        plan = rp.plan(scene, planner, bound=0.05, time_limit=20.0)
        assert plan.solved and plan.stats["roadmaps"] == 1
        assert_drivable(scene.vehicle, states_of(plan), scene.time_step)
    with pytest.raises(rp.InputError, match="^prm-lazy: size: expected an integer >= 2, got 1"):
        rp.PrmLazy(size=1)


def box(x0, y0, x1, y1):
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], dtype=float)


def behind(speed=0.0, speeds=(-3.0, 0.5)):
    """A street too narrow to turn in, and a goal behind."""
    return rp.Scenario(
        start=rp.State(0.0, 0.0, 0.0, speed),
        goal=rp.Goal((rp.GoalRegion(box(-14, -1.2, -10, 1.2), 0.0, 0.4, speeds),)),
        bounds=(-20.0, -1.3, 12.0, 1.3),
        horizon=10.0,
        vehicle=rp.ReedsSheppCar(),
    )


def parking(**changed):
    """Between two rows of parked cars, past a free place: to stand in it, its nose to the street."""
    scene = rp.Scenario(
        start=rp.State(0.0, 0.0, 0.0, 1.0),
        goal=rp.Goal((rp.GoalRegion(box(3.3, -6.5, 4.7, -5.2), np.pi / 2, 0.15, (-0.3, 0.3)),)),
        bounds=(-8.0, -9.0, 18.0, 3.5),
        obstacles=(box(-8, -8.9, 2.6, -3.2), box(5.4, -8.9, 18, -3.2)),
        horizon=20.0,
        vehicle=rp.ReedsSheppCar(max_reverse_speed=2.0),
    )
    return replace(scene, **changed)


def changes(plan):
    """How often the direction changes."""
    moving = plan.speeds[plan.speeds != 0.0]
    return int((np.sign(moving[1:]) != np.sign(moving[:-1])).sum())


BACKWARDS = {
    "behind": (behind(), 0),
    "behind, in motion": (behind(5.0), 1),
    "behind, in reverse": (behind(-4.0), 0),
    "ahead, in reverse": (replace(behind(-2.0), goal=rp.Goal.at(6.0, 0.0, radius=1.0, heading=0.0)), 1),
    "behind, entered forwards": (behind(-1.0, (0.5, 3.0)), 1),
    "parking": (parking(), 1),
}


@pytest.mark.parametrize("planner", ["prm", "prm-lazy"])
@pytest.mark.parametrize("case", BACKWARDS)
def test_a_car_that_reverses_is_driven_backwards(case, planner):
    scene, least = BACKWARDS[case]
    for seed in range(3 if planner == "prm" else 1):
        plan = rp.plan(scene, planner, bound=0.1, time_limit=60.0, iterations=30_000, seed=seed)
        assert plan.solved, plan.message
        assert changes(plan) >= least
        # standing where the direction changes, the heading kept, no faster than it reverses
        assert_drivable(scene.vehicle, states_of(plan), scene.time_step)
        assert all(scene.world.free(*pose) for pose in plan.poses)
    stiff = replace(scene, vehicle=rp.KinematicCar(), start=replace(scene.start, speed=max(scene.start.speed, 0.0)))
    if "ahead" not in case:
        assert not rp.plan(stiff, planner, bound=0.1, time_limit=60.0, iterations=3000).solved


def test_one_who_reverses_lets_pass_who_comes_from_behind():
    """He passes the place in the first four seconds: to back into his way is a collision."""
    passing = rp.GaussianMixturePrediction(
        FAR,
        [1.0],
        np.column_stack([-45.0 + 10.0 * FAR, -4.5 + 0.0 * FAR])[:, None],
        0.02 * np.tile(np.eye(2), (101, 1, 1, 1)),
        name="passing",
        length=4.5,
        width=1.8,
    )
    wide = parking(
        obstacles=(), agents=(passing,), horizon=10.0, vehicle=rp.ReedsSheppCar(), bounds=(-8.0, -9.0, 18.0, 1.3)
    )
    plan = rp.plan(wide, "prm", bound=0.01, time_limit=60.0, iterations=100_000)
    assert plan.solved and float(plan.risk.total) <= 0.01
    assert_drivable(wide.vehicle, states_of(plan), wide.time_step)
    assert plan.times[-1] > 4.5 and plan.speeds.min() < -0.5


def test_a_roadmap_both_ways_is_kept_and_serves_a_forward_car_too(tmp_path):
    scene = parking()
    roadmap = rp.Roadmap.build(scene, 300, seed=1)
    assert 0 < roadmap.forwards < len(roadmap.ends)
    for (source, target), curve, length in zip(roadmap.ends, roadmap.curves, roadmap.lengths, strict=True):
        turn = np.pi * (source >= 300)
        x, y, heading = roadmap.vertices[source % 300]
        reached = np.array(along(x, y, heading + turn, curve, length))
        np.testing.assert_allclose(reached[:2], roadmap.vertices[target % 300, :2], atol=1e-6)
        assert abs(np.angle(np.exp(1j * (reached[2] - turn - roadmap.vertices[target % 300, 2])))) < 1e-6
    roadmap.save(tmp_path / "map.npz")
    again = rp.Roadmap.load(tmp_path / "map.npz")
    np.testing.assert_array_equal(again.curves, roadmap.curves)
    forward = rp.Roadmap.build(replace(scene, vehicle=rp.KinematicCar()), 300, seed=1)
    assert len(forward.ends) == forward.forwards == roadmap.forwards
    plans = [
        rp.plan(scene, rp.Prm(roadmap=r), bound=0.1, time_limit=60.0, iterations=20_000)
        for r in (roadmap, again, forward)
    ]
    assert all(p.solved and p.stats["roadmaps"] == 1 for p in plans)
    assert plans[0].stats["edges"] == plans[2].stats["edges"] == len(roadmap.ends)  # made anew, of the same vertices
    ahead = replace(scene, vehicle=rp.KinematicCar(), goal=rp.Goal.at(12.0, 0.0, radius=1.0))
    plans += [
        rp.plan(ahead, rp.Prm(roadmap=r), bound=0.1, time_limit=60.0, iterations=20_000) for r in (roadmap, forward)
    ]
    np.testing.assert_array_equal(plans[0].poses, plans[1].poses)
    np.testing.assert_array_equal(plans[0].poses, plans[2].poses)
    np.testing.assert_array_equal(plans[3].poses, plans[4].poses)


def test_rounds_without_end_ask_for_no_more_labels_than_can_be_counted(monkeypatch):
    """A minute of rounds that run out of labels at once had made the share of a round larger than any count."""
    monkeypatch.setattr(prm, "_MORE", 10**15)
    plan = rp.plan(overtake(), rp.Prm(size=2), bound=1e-12, time_limit=60.0, iterations=1500)
    assert plan.status == "no_plan_found" and plan.stats["roadmaps"] >= 4
