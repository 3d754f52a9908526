"""Box ≤ cover ≤ ellipse: the tighter shape never states more risk, and every shape contains the rectangles."""

from __future__ import annotations

import numpy as np
import pytest
from builders import single
from test_path import AGENT, EGO, scene
from test_shapes import touching

from checkers import EgoBox, EgoCover, EgoEllipsoid, InputError, checker, path_risk


def shapes(relative=None):
    return EgoBox(*EGO), EgoCover.discs(*EGO, 6, *AGENT, relative), EgoEllipsoid.around(*EGO, *AGENT)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("dependence", ["persistent", "independent"])
def test_box_is_within_every_other_shape(seed, dependence):
    poses, pred = scene(np.random.default_rng(seed), 6)
    aligned = EgoEllipsoid.aligned(*EGO)
    box, cover, ellipse, turning = (float(path_risk(poses, [pred], s, dependence).total) for s in (*shapes(), aligned))
    assert box <= cover * (1 + 1e-7)
    assert box <= turning * (1 + 1e-7)
    assert box <= ellipse * (1 + 1e-7)


@pytest.mark.parametrize("seed", range(6))
def test_true_boxes_by_sampling_their_sum(seed):
    """A point agent (no spread) is hit exactly if the rectangles meet: centres just within and beyond touching."""
    rng = np.random.default_rng(seed)
    heading, turn = rng.uniform(-3, 3, 2)
    # the boundaries' sums include inner points; the hull is what counts, so scale away from it along rays
    points = touching(EGO, AGENT, heading - turn)
    c, s = np.cos(turn), np.sin(turn)
    pose = np.array([[3.0, -2.0, turn]])
    for direction in rng.uniform(0, 2 * np.pi, 20):
        u = np.array([np.cos(direction), np.sin(direction)])
        for scale, hit in ((1 - 1e-6, 1.0), (1 + 1e-3, 0.0)):
            centre = points[np.argmax(points @ u)] * scale  # extreme points only: supports in direction u
            world = pose[0, :2] + np.array([[c, -s], [s, c]]) @ centre
            agent = single(world, np.zeros((2, 2)), length=AGENT[0], width=AGENT[1], headings=[[heading]])
            assert float(path_risk(pose, [agent], EgoBox(*EGO)).total) == pytest.approx(hit, abs=1e-15)


@pytest.mark.parametrize("seed", range(6))
def test_aligned_ellipse_contains_the_rectangles(seed):
    rng = np.random.default_rng(seed)
    shape = EgoEllipsoid.aligned(*EGO)
    relative = rng.uniform(-3, 3)
    long, w, al, aw = shape.forms(single([0, 0], np.eye(2), length=AGENT[0], width=AGENT[1]))
    r = np.array([[np.cos(relative), -np.sin(relative)], [np.sin(relative), np.cos(relative)]])
    p = np.diag([long**2, w**2]) + r @ np.diag([al**2, aw**2]) @ r.T
    points = touching(EGO, AGENT, relative)
    assert (np.einsum("ni,ij,nj->n", points, np.linalg.inv(p), points) <= 1 + 1e-12).all()


def test_aligned_ellipse_by_the_kernel_is_that_ellipse():
    rng = np.random.default_rng(0)
    long, w, al, aw = EgoEllipsoid.aligned(*EGO).forms(single([0, 0], np.eye(2), length=AGENT[0], width=AGENT[1]))
    for _ in range(5):
        heading, turn = rng.uniform(-3, 3, 2)
        c, s = np.cos(heading - turn), np.sin(heading - turn)
        r = np.array([[c, -s], [s, c]])
        fixed = EgoEllipsoid(np.linalg.inv(np.diag([long**2, w**2]) + r @ np.diag([al**2, aw**2]) @ r.T))
        agent = single(
            rng.uniform(-6, 6, 2), np.diag([1.0, 0.5]), length=AGENT[0], width=AGENT[1], headings=[[heading]]
        )
        pose = np.array([[0.0, 0.0, turn]])
        turning = path_risk(pose, [agent], EgoEllipsoid.aligned(*EGO))
        assert float(turning.total) == pytest.approx(float(path_risk(pose, [agent], fixed).total), rel=1e-9)


def test_motion_gives_the_heading_where_none_is_carried():
    poses, pred = scene(np.random.default_rng(3), 6)
    speed = np.gradient(pred.means[:, 0], pred.times, axis=0)
    course = np.arctan2(speed[:, 1], speed[:, 0])[:, None]
    import dataclasses  # noqa: PLC0415

    shape = EgoEllipsoid.aligned(*EGO)
    said = path_risk(poses, [dataclasses.replace(pred, headings=course)], shape)
    found = path_risk(poses, [dataclasses.replace(pred, headings=None)], shape)
    assert float(said.total) == float(found.total)


def test_backends_get_a_shape_that_contains_the_boxes():
    """`exact` knows ellipsoids only: of the turning shapes it judges fixed ones around them."""
    poses, pred = scene(np.random.default_rng(4), 6)
    truth = path_risk(poses, [pred], EgoBox(*EGO), "boole").max_step
    for shape in (EgoBox(*EGO), EgoEllipsoid.aligned(*EGO)):
        assert float(checker("exact")(poses, pred, shape).value.max()) >= float(truth)
        with pytest.raises(InputError, match="length: .* needs agents"):
            checker("exact")(np.zeros((1, 3)), single([0, 0], np.eye(2)), shape)


def test_a_cover_is_united():
    """Discs overlap: their union is less than their sum, and the union of one disc twice is that disc."""
    poses, pred = scene(np.random.default_rng(0), 6)
    cover = EgoCover.discs(*EGO, 6, *AGENT)
    united = path_risk(poses, [pred], cover, "boole").max_step
    assert float(united) <= float(checker("exact")(poses, pred, cover).value.max())


@pytest.mark.parametrize("sizes", [(0.0, 2.0), (2.0, -1.0), (np.nan, 1.0), ("a", 1.0)])
@pytest.mark.parametrize("make", [EgoBox, EgoEllipsoid.aligned])
def test_bad_sizes(make, sizes):
    with pytest.raises(InputError, match="length: |width: "):
        make(*sizes)
