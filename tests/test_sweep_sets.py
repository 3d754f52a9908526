"""The sweep where collision sets are thin, sheared, the same at several steps, or points."""

import math

import numpy as np
import pytest
from builders import row
from scipy.special import ndtr

from checkers import EgoEllipsoid, checker
from checkers.cubature import moving_sets
from checkers.kernels.given import first_hits
from checkers.kernels.path import ALIGNED, BOXES, FIXED, sweep_paths
from checkers.kernels.rim import FINE
from checkers.path import PATH_SAFETY

_SHAPES = {
    FIXED: np.array([[0.0, 0.0, 0.5, 0.1, 0.9]]),
    BOXES: np.array([[2.3, 1.0, 2.0, 0.9]]),
    ALIGNED: np.array([[2.3, 1.0, 2.0, 0.9]]),
}


def swept(kind, mean, factor, heading, steps=1, tolerance=1e-8):
    value, error, exposure = np.empty(1), np.empty(1), np.empty((1, steps))
    means, factors = np.tile(mean, (steps, 1)), np.tile(factor, (steps, 1, 1))
    headings, poses = np.full(steps, heading), np.zeros((1, steps, 3))
    sweep_paths(kind, _SHAPES[kind], poses, means, factors, headings, tolerance, value, error, exposure)
    return value[0], error[0]


def turn(angle):
    return np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])


@pytest.mark.parametrize("kind", [FIXED, BOXES, ALIGNED])
def test_sets_that_are_the_same_do_not_hide_each_other_however_thin(kind):
    rng, seen = np.random.default_rng(1), 0
    for _ in range(1000):
        size = 10 ** rng.uniform(-2, 3)
        factor = turn(rng.uniform(0, 7)) @ np.diag([size, size * 10 ** rng.uniform(-18, 0)]) @ turn(rng.uniform(0, 7))
        mean = factor @ rng.normal(size=2) * rng.uniform(0, 3) + rng.normal(size=2) * rng.uniform(0, 4)
        once, error = swept(kind, mean, factor, 0.3)
        for steps in (2, 5):
            again, more = swept(kind, mean, factor, 0.3, steps)
            assert abs(again - once) <= 4 * (error + more) + 1e-290
        seen += once > 1e-9
    assert seen > 300


def test_boxes_whose_factors_shear_are_seen():
    rng, seen, line = np.random.default_rng(2), 0, np.linspace(-8, 8, 8001)
    half, h = _SHAPES[BOXES][0], 0.7
    normals = np.array([[1, 0], [0, 1], [math.cos(h), math.sin(h)], [-math.sin(h), math.cos(h)]])
    corners = np.array([[a * half[2], b * half[3]] for a in (-1, 1) for b in (-1, 1)]) @ turn(h).T
    ego = np.array([[a * half[0], b * half[1]] for a in (-1, 1) for b in (-1, 1)])
    reach = (ego @ normals.T).max(axis=0) + (corners @ normals.T).max(axis=0)
    for _ in range(300):
        factor = rng.normal(size=(2, 2)) * 10 ** rng.uniform(-0.5, 1.0)
        mean = rng.normal(size=2) * 8
        q = normals @ factor
        middle = (-(normals @ mean)[:, None] - q[:, :1] * line) / q[:, 1:]
        wide = np.abs(reach / q[:, 1])[:, None]
        low, high = (middle - wide).max(axis=0), (middle + wide).min(axis=0)
        slices = np.where(high > low, ndtr(high) - ndtr(low), 0.0) * np.exp(-0.5 * line**2) / math.sqrt(2 * math.pi)
        value, _ = swept(BOXES, mean, factor, h)
        assert value == pytest.approx(slices.sum() * (line[1] - line[0]), rel=1e-3, abs=1e-6)
        seen += value > 1e-3
    assert seen > 100


def hit_at_zero(kind, shape, poses, inputs):
    """P(hit | ξ = 0) of one step."""
    out = np.empty((1, 1))
    first_hits(*moving_sets(kind, shape, poses, inputs), np.zeros((1, 1)), 9.0, FINE, out)
    return out[0, 0]


def test_strips_that_rounding_makes_thin_sets_are_told_from_those_that_miss():
    # the first piece is beside the line of the error; the second is on it
    rng = np.random.default_rng(3)
    for angle in rng.uniform(0, 7, 500):
        root = turn(angle) @ np.diag([2.0, 0.0]) @ turn(rng.uniform(0, 7))
        away = turn(angle) @ np.array([0.0, 8.0])
        pieces = np.array([[away[0], away[1], 1.0, 0.0, 1.0], [0.0, 0.0, 1.0, 0.0, 1.0]])
        pose, mean, factor = np.zeros((1, 3)), turn(angle) @ np.array([3.0, 0.0]), np.zeros((1, 2, 1))
        hit = hit_at_zero(FIXED, pieces, pose, (mean[None], factor, (root @ root.T)[None], np.zeros(1)))
        assert hit == pytest.approx(ndtr(-1.0) - ndtr(-2.0), rel=1e-6)


@pytest.mark.parametrize(("x", "expected"), [(0.0, 1.0), (9.0, 0.0)])
def test_a_box_without_rest_is_hit_or_missed(x, expected):
    zero = np.zeros((1, 2, 2))
    inputs = np.array([[x, 0.0]]), zero[..., :1], zero, np.zeros(1)
    assert hit_at_zero(BOXES, _SHAPES[BOXES], np.zeros((1, 3)), inputs) == expected


def test_both_far_ends_of_a_long_set_around_the_origin_are_seen():
    """Origin close to the rim of an ellipse 200 times as long as wide: the second spike is not opposite the first."""
    mean = np.array([2.0087518338902317, -0.07414546121528073])
    factor = np.array([[0.15718557128054697, 0.1126789410121471], [-0.10506256448178958, -0.0738929898994296]])
    value, error = swept(FIXED, mean, factor, 0.0)
    expected = checker("exact")(np.zeros((1, 3)), row(mean[None], (factor @ factor.T)[None]), _form()).value[0, 0]
    assert abs(value - expected) <= 4 * error + 1e-12


def test_a_rim_that_pokes_out_of_another_by_a_little_is_seen():
    """Two ellipses around the origin whose rims nearly touch: for 0.03 rad the one within is the outer one."""
    shape = np.array([[2.3, 0.6893992644997771, 4.612468144581274, 0.33736834979150115]])
    poses = np.array([[[0.0, 0.0, 3.7241861468357764], [0.0, 0.0, 3.539159040643614]]])
    means = np.array([[-0.1650472626300754, -0.010306187868529187], [0.3263366599989976, 1.0749430090160532]])
    factors = np.array(
        [
            [[-0.08713584614335428, -0.37299087521506225], [0.8873207068543538, -0.2628185575372375]],
            [[-0.10410106263758688, -1.652758565308847], [2.6734958689429855, -0.5867126010973125]],
        ]
    )
    headings = np.array([2.926860330262516, 3.7817751678712885])
    value, error = np.empty(1), np.empty(1)
    sweep_paths(ALIGNED, shape, poses, means, factors, headings, 1e-8, value, error, np.empty((1, 0)))
    angles = 2 * math.pi * (np.arange(200_000) + 0.5) / 200_000
    rays, leave = np.stack([np.cos(angles), np.sin(angles)]), np.zeros(200_000)
    for pose, mean, factor, heading in zip(poses[0], means, factors, headings, strict=True):
        own, other = turn(pose[2]) @ np.diag(shape[0, :2]), turn(heading) @ np.diag(shape[0, 2:])
        form = np.linalg.inv(own @ own.T + other @ other.T)
        step = factor @ rays
        a, b, c = (step * (form @ step)).sum(axis=0), mean @ form @ step, mean @ form @ mean - 1.0
        leave = np.maximum(leave, (-b + np.sqrt(b * b - a * c)) / a)  # both are around the origin: c < 0
    assert abs(value[0] - np.mean(-np.expm1(-0.5 * leave**2))) <= PATH_SAFETY * error[0]


def _form():
    a, b, c = _SHAPES[FIXED][0, 2:]
    whiten = np.array([[a, b], [0.0, c]])
    return EgoEllipsoid(whiten.T @ whiten)
