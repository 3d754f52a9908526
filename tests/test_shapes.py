"""Shapes contain what they claim: every placement of the two rectangles that touches is inside."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from builders import single, spin
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from checkers import EgoCover, EgoEllipsoid, InputError, checker

quiet = settings(derandomize=True, max_examples=50, deadline=None)
few = settings(derandomize=True, max_examples=6, deadline=None, phases=[Phase.generate])  # `around` is slow
sizes = st.floats(0.3, 12.0)
headings = st.one_of(st.none(), st.floats(-7, 7))
AGENT = single([0, 0], np.eye(2))


def rectangle(length, width, heading, n=25):
    """Boundary points, corners among them."""
    t = np.linspace(-1, 1, n)
    one = np.ones(n)
    p = np.concatenate([np.column_stack(c) for c in ((t, one), (t, -one), (one, t), (-one, t))])
    return p * [length / 2, width / 2] @ spin(heading).T


def touching(ego, agent, heading):
    """Agent centres at which the boundaries of both rectangles meet."""
    a, b = rectangle(*ego, 0.0), rectangle(*agent, heading)
    return (a[:, None] - b[None]).reshape(-1, 2)


def contained(shape, points, agent=AGENT):
    offsets, forms = shape.pieces(agent)
    away = points[:, None] - offsets[None]
    return (np.einsum("pni,nij,pnj->pn", away, forms, away).min(axis=1) <= 1 + 1e-9).all()


def area(shape):
    _, forms = shape.pieces(AGENT)
    return (np.pi / np.sqrt(np.linalg.det(forms))).sum()


def tried(relative, seed):
    return (
        [relative] if relative is not None else [0.0, np.pi / 2, *np.random.default_rng(seed).uniform(-np.pi, np.pi, 6)]
    )


@few
@given(length=sizes, width=sizes, agent=st.tuples(sizes, sizes), relative=headings, seed=st.integers(0, 99))
def test_ellipse_contains_the_minkowski_sum(length, width, agent, relative, seed):
    shape = EgoEllipsoid.around(length, width, *agent, relative)
    for heading in tried(relative, seed):
        assert contained(shape, touching((length, width), agent, heading))


@quiet
@given(
    length=sizes,
    width=sizes,
    agent=st.tuples(sizes, sizes),
    relative=headings,
    n=st.integers(1, 9),
    seed=st.integers(0, 99),
)
def test_cover_contains_the_minkowski_sum(length, width, agent, relative, n, seed):
    shape = EgoCover(length, width, n, *agent, relative)
    for heading in tried(relative, seed):
        assert contained(shape, touching((length, width), agent, heading))


@quiet
@given(length=sizes, width=sizes, n=st.integers(1, 9), seed=st.integers(0, 99))
def test_cover_contains_the_body_inside_too(length, width, n, seed):
    """No gaps between the discs: interior points, not only the rim."""
    inside = np.random.default_rng(seed).uniform(-0.5, 0.5, (500, 2)) * [length, width]
    assert contained(EgoCover(length, width, n), inside)


@few
@given(length=sizes, width=sizes, agent=st.tuples(sizes, sizes), relative=st.floats(-7, 7))
def test_ellipse_is_no_larger_than_the_box_ellipse(length, width, agent, relative):
    """The ellipse with semi-axes √2 × those of the sum's bounding box contains it as well."""
    corners = np.abs(touching((length, width), agent, relative)).max(axis=0)
    assert area(EgoEllipsoid.around(length, width, *agent, relative)) <= 2 * np.pi * np.prod(corners) * (1 + 1e-3)


def test_ellipse_around_one_rectangle_is_known():
    shape = EgoEllipsoid.around(4.0, 2.0)
    np.testing.assert_allclose(shape.Q, np.diag([1 / 8.0, 1 / 2.0]), rtol=1e-6, atol=1e-9)
    side_by_side = EgoEllipsoid.around(4.6, 1.9, 4.6, 1.9, 0.0)  # math.md: 6.5 × 2.7 m
    np.testing.assert_allclose(1 / np.sqrt(np.diag(side_by_side.Q)), [6.505, 2.687], atol=1e-3)
    any_heading = EgoEllipsoid.around(4.6, 1.9, 4.6, 1.9)  # 6.6 × 4.7 m
    reach = 1 / np.sqrt(np.diag(any_heading.Q))
    assert 4.79 <= reach[0] <= 6.7
    assert 3.4 <= reach[1] <= 4.8


@pytest.mark.parametrize(("ego", "agent"), [((1.0, 1.0), (1.0, 1.0)), ((4.5, 1.8), (4.2, 2.0))])
def test_ellipse_around_parallel_rectangles_is_the_smallest(ego, agent):
    """Their sum is a rectangle, whose smallest ellipse has semi-axes √2 × its own, and is not tilted."""
    half = np.add(ego, agent) / 2
    q = EgoEllipsoid.around(*ego, *agent, 0.0).Q
    np.testing.assert_allclose(q, np.diag(0.5 / half**2), rtol=1e-7, atol=1e-9)


def test_extreme_proportions_end_in_time():
    for length, width in ((1000.0, 0.01), (0.01, 1000.0), (1e-6, 1e-6), (1e6, 1e6)):
        assert contained(EgoEllipsoid.around(length, width), rectangle(length, width, 0.0))
        assert contained(EgoEllipsoid.around(length, width, 4.0, 2.0), touching((length, width), (4.0, 2.0), 0.7))


def test_more_discs_are_narrower():
    widths = [1 / math.sqrt(EgoCover(4.6, 1.9, n).pieces(AGENT)[1][0, 0, 0]) for n in (1, 2, 6, 20)]
    assert widths == sorted(widths, reverse=True)
    assert widths[-1] < 1.0
    assert widths[0] == pytest.approx(math.hypot(4.6, 1.9) / 2)


def test_cover_takes_the_size_the_agent_carries():
    cover, sized = EgoCover(4.0, 2.0, 3), EgoCover(4.0, 2.0, 3, 5.0, 1.0)
    agent = single([0, 0], np.eye(2), length=5.0, width=1.0)
    for a, b in zip(cover.pieces(agent), sized.pieces(AGENT), strict=True):
        np.testing.assert_array_equal(a, b)
    assert sized.pieces(AGENT)[1][0, 0, 0] < cover.pieces(AGENT)[1][0, 0, 0]  # a larger disc
    for a, b in zip(sized.pieces(agent), sized.pieces(AGENT), strict=True):
        np.testing.assert_array_equal(a, b)


def test_discs_is_the_constructor():
    assert EgoCover.discs(4.0, 2.0, n=4, relative_heading=0.3) == EgoCover(4.0, 2.0, 4, None, None, 0.3)


def test_cover_beside_the_car_is_tighter_than_the_ellipse():
    agent = single([0.0, 4.0], 0.09 * np.eye(2))
    exact, pose = checker("exact"), np.zeros((1, 3))
    cover = exact(pose, agent, EgoCover(4.6, 1.9, 6, 4.6, 1.9)).value[0, 0]
    ellipse = exact(pose, agent, EgoEllipsoid.around(4.6, 1.9, 4.6, 1.9)).value[0, 0]
    assert cover < ellipse


def test_frozen_and_read_only():
    q = np.eye(2)
    shape = EgoEllipsoid(q)
    q[0, 0] = 100
    assert shape.Q[0, 0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        shape.Q[0, 0] = 2
    with pytest.raises(dataclasses.FrozenInstanceError):
        shape.Q = np.eye(2)
    with pytest.raises(dataclasses.FrozenInstanceError):
        EgoCover(4.0, 2.0).n = 3


@pytest.mark.parametrize(
    ("q", "message"),
    [
        (np.eye(3), r"Q: expected shape \(2, 2\), got \(3, 3\)"),
        ([[1, 0], [0, np.nan]], r"Q\[1, 1\]: expected a finite number"),
        ([[1, 0.5], [0, 1]], "Q: expected a symmetric"),
        ([[1, 2], [2, 1]], "Q: expected a positive definite"),
        (np.zeros((2, 2)), "Q: expected a positive definite"),
        ([[1, 1], [1, 1]], "Q: expected a positive definite"),
        (-np.eye(2), "Q: expected a positive definite"),
        ("disc", "Q: expected numbers"),
        (None, "Q: "),
    ],
)
def test_bad_ellipsoids(q, message):
    with pytest.raises(InputError, match=message):
        EgoEllipsoid(q)


def test_any_accepted_ellipsoid_can_be_used():
    """Near the limit of definiteness it is refused on construction, not in the checker."""
    rng = np.random.default_rng(0)
    for _ in range(300):
        v = rng.normal(size=2)
        q = np.outer(v, v) + 10.0 ** rng.uniform(-18, -14) * np.eye(2)
        try:
            shape = EgoEllipsoid(0.5 * (q + q.T))
        except InputError:
            continue
        value = checker("exact")(np.zeros((1, 3)), AGENT, shape).value
        assert ((value >= 0) & (value <= 1)).all()


BAD_SIZES = [
    ({"length": 0.0}, "length"),
    ({"length": -1.0}, "length"),
    ({"length": np.nan}, "length"),
    ({"length": "long"}, "length"),
    ({"length": True}, "length"),
    ({"width": 0.0}, "width"),
    ({"width": np.inf}, "width"),
    ({"width": None}, "width"),
    ({"agent_length": -1.0}, "agent_length"),
    ({"agent_width": np.nan}, "agent_width"),
    ({"relative_heading": np.nan}, "relative_heading"),
    ({"relative_heading": "along"}, "relative_heading"),
]


@pytest.mark.parametrize("make", [EgoEllipsoid.around, EgoCover, EgoCover.discs])
@pytest.mark.parametrize(("changes", "field"), BAD_SIZES)
def test_bad_sizes(make, changes, field):
    with pytest.raises(InputError, match=f"^{field}: expected"):
        make(**{"length": 4.0, "width": 2.0, **changes})


@pytest.mark.parametrize("n", [0, -1, 2.0, "6", True, None])
def test_bad_counts(n):
    with pytest.raises(InputError, match="n: expected an integer from 1 to 1000"):
        EgoCover(4.0, 2.0, n)
