"""Paths among agents whose error persists in part: the rim integral against slices, its cells against a grid."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from builders import spin
from oracles_path import box_set, ellipse_set, sampled_hits, union_mass
from test_path import AGENT, BOX, EGO, ELLIPSE, agent, scene

from checkers import EgoCover, EgoEllipsoid, Kind, checker, path_risk
from checkers.cubature import exposed_arcs
from checkers.kernels.given import fill_sets
from checkers.kernels.path import BOXES, sweep_steps
from checkers.kernels.rim import EDGE, FINE, PIECE, ROUGH, mass
from checkers.path import PATH_SAFETY, persistent_risk, shape_against, step_risk


@dataclass(frozen=True)
class Unlike:
    """Ellipses that differ in shape, overlap, hide and repeat each other."""

    def pieces(self, body):
        forms = [np.diag([0.2, 1.0]), np.array([[0.8, 0.3], [0.3, 0.4]]), np.diag([0.2, 1.0]), 4.0 * np.eye(2)]
        return np.array([[0.0, 0.0], [1.5, 0.4], [0.0, 0.0], [0.3, 0.0]]), np.array(forms)


COVER = EgoCover.discs(*EGO, 3, *AGENT)
SHAPES = {"ellipse": ELLIPSE, "aligned": EgoEllipsoid.aligned(*EGO), "box": BOX, "cover": COVER, "unlike": Unlike()}


def sets_of(ego, pose, mean, factor, pred, t):
    """The oracle's sets {ξ : mean + factor ξ collides} of one step."""
    if ego is BOX:
        return [box_set(pose, mean, factor, EGO, AGENT, pred.headings[t, 0])]
    if ego is SHAPES["aligned"]:  # the sum of two turned ellipses is contained in this one: both semi-axes at √2
        turn = spin(pred.headings[t, 0] - pose[2])
        axes = ego.forms(pred)
        form = np.linalg.inv(np.diag(np.square(axes[:2])) + turn @ np.diag(np.square(axes[2:])) @ turn.T)
        return [ellipse_set(pose, mean, factor, form)]
    return [ellipse_set(pose, mean, factor, q, o) for o, q in zip(*ego.pieces(pred), strict=True)]


def rim(ego, pose, mean, root, pred, t):
    """(octagon, rows, arcs) of one step."""
    kind, shape = shape_against(ego, pred)
    rows = np.empty((1, 8, EDGE) if kind == BOXES else (1, len(shape), PIECE))
    fill_sets(kind, shape, pose[None], mean[None], root[None], pred.headings[t], rows)
    whole = np.array([[0.0, 0.0, 2 * np.pi]])
    return kind == BOXES, rows[0], exposed_arcs(shape) if ego in (COVER, SHAPES["unlike"]) else whole


@pytest.mark.parametrize("name", SHAPES)
def test_mass_is_that_of_slices_and_of_the_sweep(name):
    """Slices leave up to 5e-10 where they miss a corner of the union; small P cancel to 1e-16."""
    rng = np.random.default_rng(7)
    poses, pred = scene(rng)
    for i in range(40):
        t, ego = i % 12, SHAPES[name]
        root = spin(rng.uniform(0, 7)) @ np.diag(np.exp(rng.uniform(-3, 1.5, 2)) * [1, 1 - 2 * (i % 2)]) @ spin(i)
        mean = poses[t, :2] + rng.uniform(0, 5) * spin(rng.uniform(0, 7))[0]
        z = rng.normal(size=2)
        expected = union_mass(sets_of(ego, poses[t], mean + root @ z, root, pred, t))
        octagon, rows, arcs = rim(ego, poses[t], mean, root, pred, t)
        kind, shape = shape_against(ego, pred)
        swept, error = np.empty((2, 1, 1))
        here = poses[None, t : t + 1], (mean + root @ z)[None], root[None], pred.headings[t]
        sweep_steps(kind, shape, *here, 1e-12, swept, error)
        found = mass(octagon, rows, arcs, *z, 38.0, FINE)
        assert found == pytest.approx(expected, rel=1e-9, abs=2e-15)
        assert found == pytest.approx(swept[0, 0], rel=1e-10, abs=2e-15)
        assert mass(octagon, rows, arcs, *z, 38.0, ROUGH) == pytest.approx(expected, rel=2e-6, abs=2e-15)
        assert mass(octagon, rows, arcs, *z, 6.0, FINE) == pytest.approx(expected, rel=1e-9, abs=np.exp(-18.0))


@pytest.mark.parametrize("name", SHAPES)
def test_nothing_jumps_at_the_rim(name):
    """Inside, outside and between a chord and its arc, the same mass to rounding."""
    poses, pred = scene(np.random.default_rng(3))
    ego, root = SHAPES[name], np.array([[0.11, 0.02], [-0.03, 0.2]])
    octagon, rows, arcs = rim(ego, poses[4], poses[4, :2], root, pred, 4)
    for angle in np.linspace(0, 2 * np.pi, 61):
        low, high = 0.0, 60.0
        ray = spin(angle)[0]
        for _ in range(80):  # to the rim, where half of the mass is left, and around it
            middle = 0.5 * (low + high)
            inside = mass(octagon, rows, arcs, *(middle * ray), 9.0, FINE) > 0.4
            low, high = (middle, high) if inside else (low, middle)
        around = high + np.array([-1e-3, -1e-6, -1e-9, -1e-12, 0.0, 1e-15, 1e-12, 1e-9, 1e-6, 1e-3])
        values = np.array([mass(octagon, rows, arcs, *(r * ray), 9.0, FINE) for r in around])
        assert (np.abs(values - values[4]) <= 0.5 * np.abs(around - high) + 1e-12).all()


def test_exposed_arcs_are_the_rim_of_the_union():
    for ego in (COVER, SHAPES["unlike"], ELLIPSE):
        _, shape = shape_against(ego, scene(np.random.default_rng(0))[1])
        arcs, forms = exposed_arcs(shape), [np.array([[a, b], [0.0, c]]) for _, _, a, b, c in shape]
        distinct = {tuple(row): i for i, row in reversed(list(enumerate(shape)))}
        for i in distinct.values():
            for angle in np.linspace(0, 2 * np.pi, 733)[:-1]:
                point = shape[i, :2] + np.linalg.solve(forms[i], [np.cos(angle), np.sin(angle)])
                levels = [np.linalg.norm(f @ (point - s[:2])) for f, s in zip(forms, shape, strict=True)]
                listed = any(p == i and low <= angle <= high for p, low, high in arcs)
                assert listed == (min(levels) > 1 - 1e-9)


@pytest.mark.parametrize(("ego", "rank"), [(BOX, 1), (BOX, 2), (COVER, 1), (ELLIPSE, 2)])
def test_cells_against_a_grid_of_slices(ego, rank):
    """By the trapezoid rule, which converges geometrically while the rest is not small (Trefethen & Weideman 2014)."""
    poses, plain = scene(np.random.default_rng(11), 3, 3.0)
    rest, step = 1.5, 0.7
    factors = 0.3 * plain.factors[:, 0][..., :rank]
    pred = agent(plain.times, plain.means[:, 0], factors, plain.headings[:, 0], rest**2)
    line = np.arange(-8, 8.1, step)
    nodes = np.stack(np.meshgrid(*[line] * rank), -1).reshape(-1, rank)
    nodes = nodes[(nodes**2).sum(axis=1) < 45]
    weights = np.exp(-0.5 * (nodes**2).sum(axis=1)) * (step / np.sqrt(2 * np.pi)) ** rank
    missed, first = np.ones(len(nodes)), []
    for t, pose in enumerate(poses):
        means = pred.means[t, 0] + nodes @ pred.factors[t, 0].T
        hit = np.array([union_mass(sets_of(ego, pose, m, rest * np.eye(2), pred, t)) for m in means])
        first.append(weights @ (missed * hit))
        missed *= 1 - hit
    for tolerance in (1e-4, 1e-8):
        risk = path_risk(poses, [pred], ego, tolerance=tolerance)
        assert risk.kind is Kind.EXACT
        assert abs(float(risk.total) - sum(first)) <= tolerance * sum(first)
        assert np.abs(risk.per_step - first).max() <= 2 * tolerance * sum(first)


@pytest.mark.parametrize("name", SHAPES)
def test_tolerances_agree_into_the_tail(name):
    for seed in range(6):
        poses, plain = scene(np.random.default_rng(40 + seed), 8, 25.0)
        parts = plain.times, plain.means[:, 0], plain.factors[:, 0], plain.headings[:, 0]
        pred = agent(*parts, 10.0 ** -(seed % 4))
        rough, fine = (path_risk(poses, [pred], SHAPES[name], tolerance=tol) for tol in (1e-4, 1e-9))
        assert rough.kind is fine.kind is Kind.EXACT
        assert abs(float(rough.total) - float(fine.total)) <= float(rough.error) <= 5e-4 * float(rough.total)
        assert float(fine.error) <= 5e-9 * float(fine.total)
        assert float(fine.max_step) * (1 - 1e-8) <= float(fine.total) <= float(fine.boole) * (1 + 1e-8)


@pytest.mark.parametrize("deviation", [0.05, 0.3])
def test_a_small_rest_against_sampling(deviation):
    for seed in range(3):
        rng = np.random.default_rng(seed)
        poses, plain = scene(rng, 10)
        parts = plain.times, plain.means[:, 0], plain.factors[:, 0], plain.headings[:, 0]
        pred, n = agent(*parts, deviation**2), 100_000
        for ego, sizes in ((BOX, (*EGO, *AGENT)), (ELLIPSE, None)):
            hits = sampled_hits(pred.sample(n, rng), poses, pred.headings[:, 0], sizes, None if sizes else ELLIPSE.Q)
            risk = path_risk(poses, [pred], ego, tolerance=1e-4)
            value = float(risk.total)
            assert abs(value - (hits >= 0).mean()) <= 4 * np.sqrt(max(value * (1 - value), 1 / n) / n)
            assert risk.kind is Kind.EXACT


def test_more_factors_than_two_are_an_estimate_that_holds():
    poses, plain = scene(np.random.default_rng(5), 6)
    third = np.concatenate([plain.factors[:, 0], np.full((6, 2, 1), 0.3)], axis=-1)
    pred = agent(plain.times, plain.means[:, 0], third, plain.headings[:, 0], 0.04)
    risk = path_risk(poses, [pred], BOX)
    hits = sampled_hits(
        pred.sample(400_000, np.random.default_rng(1)), poses, pred.headings[:, 0], (*EGO, *AGENT), None
    )
    assert risk.kind is Kind.ESTIMATE
    assert abs(float(risk.total) - (hits >= 0).mean()) <= float(risk.error) + 4 * np.sqrt(0.25 / 400_000)


def test_the_edge_itself_is_no_jump():
    """To the last bit: a corner and the middle of an edge of a box, as seen from them."""
    pred = agent([0.0], np.zeros((1, 2)), np.eye(2)[None], [0.0])
    octagon, rows, arcs = rim(BOX, np.zeros(3), np.zeros(2), np.eye(2), pred, 0)
    x, y = (EGO[0] + AGENT[0]) / 2, (EGO[1] + AGENT[1]) / 2
    for z in ((x, 0.0), (0.0, -y), (x, y), (-x, y)):
        inside = mass(octagon, rows, arcs, z[0] * (1 - 1e-13), z[1] * (1 - 1e-13), 38.0, FINE)
        assert mass(octagon, rows, arcs, *z, 38.0, FINE) == pytest.approx(inside, abs=1e-12)


@pytest.mark.parametrize("name", ["box", "cover", "ellipse"])
@pytest.mark.parametrize("rank", [1, 2, 3])
def test_a_rest_along_a_line_only(name, rank):
    """Made white its sets are 1e9 times as long as wide."""
    poses, plain = scene(np.random.default_rng(8), 6, 3.0)
    ego, n = SHAPES[name], 100_000
    factors = np.concatenate([plain.factors[:, 0], np.full((6, 2, 1), 0.3)], axis=-1)[..., :rank]
    line = spin(0.4)[:, :1]
    covariances = factors @ np.swapaxes(factors, -1, -2) + 0.5 * line @ line.T
    pred = replace(plain, covariances=covariances[:, None], factors=factors[:, None])
    risk = path_risk(poses, [pred], ego, tolerance=1e-4)
    xy = pred.sample(n, np.random.default_rng(2)) - poses[:, :2]
    hit = np.zeros(n, dtype=bool)
    for t, pose in enumerate(poses):
        if ego is BOX:
            hits = sampled_hits(xy[:, t : t + 1] + pose[:2], pose[None], pred.headings[t], (*EGO, *AGENT), None)
            hit |= hits >= 0
            continue
        seen = xy[:, t] @ spin(pose[2])
        for q, o in zip(*ego.pieces(pred)[::-1], strict=True):
            hit |= np.einsum("ni,ij,nj->n", seen - o, q, seen - o) <= 1.0
    value = float(risk.total)
    assert abs(value - hit.mean()) <= float(risk.error) + 4 * np.sqrt(max(value * (1 - value), 1 / n) / n)


@pytest.mark.parametrize("tolerance", [1e-4, 1e-8, 1e-11])
def test_one_step_is_its_marginal_into_the_far_tail(tolerance):
    """How far the rest has to go is far too: along a rim e^(−q/2) then falls fast, and the clearance is less."""
    for seed in range(12):
        rng = np.random.default_rng(seed)
        root, factor = (spin(rng.uniform(0, 7)) @ np.diag(rng.uniform(0.3, 3.0, 2)) for _ in range(2))
        rest, rank = root @ root.T, 1 + seed % 2
        mean = np.array([(5.0 + 3.0 * seed) * spin(rng.uniform(0, 7))[0]])
        covariances = factor[:, :rank] @ factor[:, :rank].T + rest
        pred = replace(
            agent([0.0], mean, factor[None], [rng.uniform(0, 7)]),
            covariances=covariances[None, None],
            factors=factor[None, None, :, :rank],
        )
        for ego in (ELLIPSE, BOX):
            pose = np.zeros((1, 3))
            total, error, _, kind = persistent_risk(pose[None], pred, ego, tolerance, 0)  # not yet held to the marginal
            risk = checker("exact")(pose, pred, ego) if ego is ELLIPSE else step_risk(pose, pred, ego, 1e-13)
            assert kind is Kind.EXACT
            assert abs(total[0] - risk.value[0, 0]) <= PATH_SAFETY * (error[0] + risk.error[0, 0]) + 1e-290
            assert error[0] <= tolerance * total[0] + 1e-290
