"""Risk of a whole path: the polar sweep against Cartesian slices, mpmath, the marginal checker and sampling."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from builders import cases, mixture, row, single, spin
from oracles import trajectory, truth
from oracles_path import box_set, ellipse_set, hits_of_factors, sampled_hits, slices_mp, union_mass

from checkers import EgoBox, EgoCover, EgoEllipsoid, GaussianMixturePrediction, InputError, Kind, checker, path_risk
from checkers.path import step_risk, within_any_dependence

EGO, AGENT = (4.6, 1.9), (4.4, 1.8)
ELLIPSE = EgoEllipsoid.around(*EGO, *AGENT)
BOX = EgoBox(*EGO)


def scene(rng, steps=12, reach=6.0):
    """A path and one agent that crosses, meets or follows it, both turning; the error grows and persists."""
    t = np.linspace(0, 3, steps)
    turn = rng.uniform(-3, 3) + rng.uniform(-0.6, 0.6) * t
    here = np.cumsum(np.stack([np.cos(turn), np.sin(turn)], 1) * rng.uniform(3, 15) * 3 / steps, 0)
    heading = (rng.uniform(-3, 3) if rng.random() < 0.5 else turn[0] + 0.1 * rng.normal()) + rng.uniform(-0.4, 0.4) * t
    there = np.cumsum(np.stack([np.cos(heading), np.sin(heading)], 1) * rng.uniform(3, 15) * 3 / steps, 0)
    k = rng.integers(steps)
    there = there - there[k] + here[k] + rng.uniform(0, reach) * spin(rng.uniform(0, 7))[0]
    s = rng.uniform(0.3, 2.0, 2)
    factors = np.stack(
        [spin(a) @ np.diag([0.2 + s[0] * u, 0.1 + 0.3 * s[1] * u]) for a, u in zip(heading, t, strict=True)]
    )
    return np.column_stack([here, turn]), agent(t, there, factors, heading)


def agent(times, means, factors, headings=None, extra=0.0, keep=True, **labels):
    """One mode; `extra` is the variance of what is independent."""
    factors = np.asarray(factors, dtype=float)
    covariances = factors @ np.swapaxes(factors, -1, -2) + extra * np.eye(2)
    return GaussianMixturePrediction(
        times,
        [1.0],
        np.asarray(means, dtype=float)[:, None],
        covariances[:, None],
        length=AGENT[0],
        width=AGENT[1],
        headings=None if headings is None else np.asarray(headings, dtype=float)[:, None],
        factors=factors[:, None] if keep else None,
        **labels,
    )


def collision_sets(poses, pred, ego):
    out = []
    for t, pose in enumerate(poses):
        mean, factor = pred.means[t, 0], pred.factors[t, 0]
        if isinstance(ego, EgoBox):
            out.append([box_set(pose, mean, factor, EGO, AGENT, pred.headings[t, 0])])
        else:
            out.append([ellipse_set(pose, mean, factor, q, o) for o, q in zip(*ego.pieces(pred), strict=True)])
    return out


def check_against_slices(poses, pred, ego, tolerance):
    expected = union_mass(list(itertools.chain(*collision_sets(poses, pred, ego))))
    result = path_risk(poses, [pred], ego, tolerance=tolerance)
    assert result.kind is Kind.EXACT
    if expected >= 1e-30:
        assert float(result.total) == pytest.approx(expected, rel=tolerance)
        assert abs(float(result.total) - expected) <= float(result.error) + 1e-10 * expected
    assert result.per_step.sum() == pytest.approx(float(result.total), rel=1e-12)
    assert float(result.max_step) <= float(result.total) * (1 + 2 * tolerance)
    assert float(result.total) <= float(result.boole) * (1 + 2 * tolerance)
    return expected


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("ego", [ELLIPSE, BOX, EgoCover.discs(*EGO, 2, *AGENT)], ids=["ellipse", "box", "cover"])
def test_sweep_against_slices(ego, seed):
    poses, pred = scene(np.random.default_rng(seed), 5)
    check_against_slices(poses, pred, ego, 1e-8)


@pytest.mark.parametrize("ego", [ELLIPSE, BOX], ids=["ellipse", "box"])
def test_fast_mode_keeps_its_word(ego):
    for seed in range(20, 30):
        poses, pred = scene(np.random.default_rng(seed), 4)
        check_against_slices(poses, pred, ego, 1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("ego", [ELLIPSE, BOX], ids=["ellipse", "box"])
def test_sweep_against_slices_in_many_scenes(ego):
    for seed in range(100, 130):
        poses, pred = scene(np.random.default_rng(seed), 30)
        check_against_slices(poses, pred, ego, 1e-8)


@pytest.mark.parametrize("ego", [ELLIPSE, BOX], ids=["ellipse", "box"])
@pytest.mark.parametrize("away", [0.0, 4.0, 12.0])
def test_sweep_against_mpmath_into_the_far_tail(ego, away):
    """Two steps of a crossing agent, from a plain case down to 1e-30."""
    poses = np.array([[0.0, 0.0, 0.1], [2.0, 0.3, 0.2]])
    factors = [[[0.5, 0.1], [-0.2, 0.6]], [[0.7, 0.1], [-0.1, 0.8]]]
    pred = agent([0.0, 0.2], [[4.0, 3.0 + away], [4.5, 2.5 + away]], factors, [1.2, 1.3])
    expected = slices_mp(list(itertools.chain(*collision_sets(poses, pred, ego))))
    result = path_risk(poses, [pred], ego)
    assert abs(float(result.total) / expected - 1) <= 1e-8
    assert expected < [1.0, 1e-2, 1e-25][[0.0, 4.0, 12.0].index(away)]


def test_one_step_is_the_exact_marginal():
    rng = np.random.default_rng(3)
    poses, means, covariances = cases(rng, 40, sigma=(0.2, 3.0), ratio=4.0)
    factors = np.linalg.cholesky(covariances)
    expected = checker("exact")(poses, row(means, covariances), ELLIPSE).value[:, 0]
    other = truth(poses, means, covariances, ELLIPSE.Q)
    for k in range(len(poses)):
        one = path_risk(poses[k : k + 1], [agent([0.0], [means[k]], [factors[k]])], ELLIPSE)
        assert float(one.total) == pytest.approx(expected[k], rel=1e-8, abs=1e-100)
        assert float(one.total) == pytest.approx(other[k], rel=1e-8, abs=1e-100)


def test_singular_factors():
    """B of rank one, or zero: strips, everything, nothing; the same as a tiny second axis."""
    poses = np.zeros((2, 3))
    means = [[3.0, 0.5], [3.5, 0.5]]
    line = np.zeros((2, 2, 2))
    line[:, 0, 0], line[:, 1, 0] = 1.5, 0.3
    for ego in (ELLIPSE, BOX):
        flat = path_risk(poses, [agent([0.0, 1.0], means, line, [0.3, 0.3])], ego)
        near = line.copy()
        near[:, 1, 1] = 1e-9
        full = path_risk(poses, [agent([0.0, 1.0], means, near, [0.3, 0.3])], ego)
        one = path_risk(poses, [agent([0.0, 1.0], means, line[..., :1], [0.3, 0.3])], ego)
        assert float(flat.total) == pytest.approx(float(full.total), rel=1e-6)
        assert float(flat.total) == pytest.approx(float(one.total), rel=1e-12)
        still = np.zeros((2, 2, 2))
        assert float(path_risk(poses, [agent([0.0, 1.0], means, still, [0.3, 0.3])], ego).total) == pytest.approx(
            1.0, abs=1e-15
        )
        gone = agent([0.0, 1.0], np.add(means, 40.0), still, [0.3, 0.3])
        assert float(path_risk(poses, [gone], ego).total) == 0.0


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("extra", [0.0, 0.4])
def test_against_sampling(seed, extra):
    rng = np.random.default_rng(seed)
    poses, plain = scene(rng, 8)
    pred = agent(plain.times, plain.means[:, 0], plain.factors[:, 0], plain.headings[:, 0], extra)
    n = 40_000
    for ego, sizes in ((BOX, (*EGO, *AGENT)), (ELLIPSE, None)):
        hits = sampled_hits(pred.sample(n, rng), poses, pred.headings[:, 0], sizes, None if sizes else ELLIPSE.Q)
        result = path_risk(poses, [pred], ego, tolerance=1e-2 if extra else 1e-4)
        first = np.bincount(hits[hits >= 0], minlength=8) / n
        for value, share in [(float(result.total), first.sum()), *zip(result.per_step, first, strict=True)]:
            assert abs(value - share) <= 4 * np.sqrt(max(value * (1 - value), 1 / n) / n) + float(result.error)


@pytest.mark.slow
def test_against_sampling_in_two_hundred_scenes():
    """The same 1e7 samples of ξ for all, in chunks; 4 standard errors."""
    scenes, n, rng = [], 10_000_000, np.random.default_rng(999)
    for seed in range(200):
        poses, pred = scene(np.random.default_rng(1000 + seed), 10)
        ego, *oracle = (BOX, (*EGO, *AGENT), None) if seed % 2 else (ELLIPSE, None, ELLIPSE.Q)
        path = poses, pred.means[:, 0], pred.factors[:, 0], pred.headings[:, 0]
        scenes.append((float(path_risk(poses, [pred], ego).total), *path, *oracle))
    hits = np.zeros(len(scenes))
    for _ in range(50):
        xi = rng.standard_normal((2, n // 50), np.float32)
        hits += [hits_of_factors(xi, *arguments) for _, *arguments in scenes]
    values = np.array([value for value, *_ in scenes])
    scores = (values - hits / n) / np.sqrt(np.maximum(values * (1 - values), 1 / n) / n)
    worst = int(np.argmax(np.abs(scores)))
    print(f"worst of {len(scenes)} scenes: {scores[worst]:.2f} standard errors, scene {worst}")
    assert abs(scores[worst]) <= 4.0, worst


def test_quadrature_meets_the_sweep():
    """A little independent noise changes the risk a little; a third factor that adds nothing makes an estimate."""
    poses, pred = scene(np.random.default_rng(2), 6)
    args = (pred.times, pred.means[:, 0], pred.factors[:, 0], pred.headings[:, 0])
    exact = path_risk(poses, [pred], BOX)
    noisy = path_risk(poses, [agent(*args, 0.01)], BOX, tolerance=1e-2)
    assert float(noisy.total) == pytest.approx(float(exact.total), abs=0.05)
    padded = np.concatenate([pred.factors[:, 0], np.zeros((6, 2, 1))], axis=-1)
    third = path_risk(poses, [agent(args[0], args[1], padded, args[3])], BOX)
    assert third.kind is Kind.ESTIMATE
    assert abs(float(third.total) - float(exact.total)) <= float(third.error)
    assert float(third.total) == float(path_risk(poses, [agent(args[0], args[1], padded, args[3])], BOX).total)


@pytest.mark.parametrize("times_as_far", [4.0, 6.5, 7.0, 8.0, 8.4])
def test_the_sweep_is_right_to_the_end_of_the_exponents(times_as_far):
    """From 5e-26 to 1e-290: the square of a risk that small is 0, and so was the error of panels."""
    form = np.array([[0.264280273, -2.94992202e-05], [-2.94992202e-05, 0.201363293]])
    spread = np.array([[0.018404767190698185, 0.013472263204839583], [0.013472263204839583, 0.031595388728673644]])
    pred = GaussianMixturePrediction([0.0], [1.0], np.zeros((1, 1, 2)), spread[None, None])
    poses = np.array([[0.8373397425 * times_as_far, 0.4779062375 * times_as_far, -2.2285692]])
    want = float(checker("exact")(poses, pred, EgoEllipsoid(form)).value[0, 0])
    assert 0.0 < want < 1e-25
    for tolerance in (1e-2, 1e-6, 1e-10):
        found = step_risk(poses, pred, EgoEllipsoid(form), tolerance)
        assert float(found.value[0, 0]) == pytest.approx(want, rel=tolerance + 1e-11, abs=0.0)


def test_no_factors_and_zero_factors_are_independence():
    poses, pred = scene(np.random.default_rng(1), 6)
    args = (pred.times, pred.means[:, 0])
    free = agent(*args, pred.factors[:, 0], pred.headings[:, 0], keep=False)
    zero = GaussianMixturePrediction(
        pred.times, [1.0], pred.means, pred.covariances, length=AGENT[0], width=AGENT[1], headings=pred.headings,
        factors=np.zeros((6, 1, 2, 1)),
    )  # fmt: skip
    for ego in (ELLIPSE, BOX):
        independent = path_risk(poses, [pred], ego, "independent")
        assert float(path_risk(poses, [free], ego).total) == float(independent.total)
        assert float(path_risk(poses, [zero], ego).total) == pytest.approx(float(independent.total), rel=1e-6)
        marginals = [float(path_risk(poses[t : t + 1], [free.at(free.times[t : t + 1])], ego).total) for t in range(6)]
        expected = float(trajectory([1.0], np.array(marginals)[:, None], "persistent"))
        assert float(independent.total) == pytest.approx(expected, rel=1e-8)
        boole = path_risk(poses, [pred], ego, "boole")
        assert float(boole.total) == pytest.approx(min(sum(marginals), 1.0), rel=1e-8)
        assert boole.kind is Kind.UPPER_BOUND


def test_independence_agrees_with_the_checkers():
    pred = mixture(np.random.default_rng(5), per_step=True)
    poses = np.array([[0.3 * t, 0.1, 0.2] for t in range(4)])
    for modes in ("per_step", "persistent"):
        weights = pred.weights if modes == "per_step" else pred.weights[0]
        one = dataclasses.replace(pred, modes=modes, weights=weights)
        result = path_risk(poses, [one, one], ELLIPSE, "independent")
        risk = checker("exact")(poses, one, ELLIPSE)
        from checkers import trajectory_risk  # noqa: PLC0415

        other = trajectory_risk([risk, risk], [one, one])
        for field in ("total", "per_agent", "boole", "max_step"):
            np.testing.assert_allclose(getattr(result, field), getattr(other, field), rtol=1e-8)
        assert result.per_step.sum() == pytest.approx(float(result.total), rel=1e-12)
        assert result.kind is Kind.UPPER_BOUND  # two agents are summed


def test_modes_are_weighed_and_batches_are_paths():
    first, second = (scene(np.random.default_rng(s), 5) for s in (0, 4))
    both = GaussianMixturePrediction(
        first[1].times, [0.3, 0.7],
        *(np.concatenate([getattr(p[1], f) for p in (first, second)], axis=1) for f in ("means", "covariances")),
        length=AGENT[0], width=AGENT[1],
        **{f: np.concatenate([getattr(p[1], f) for p in (first, second)], axis=1) for f in ("headings", "factors")},
    )  # fmt: skip
    batch = np.stack([first[0], second[0]])
    result = path_risk(batch, [both], BOX)
    assert result.total.shape == (2,)
    assert result.per_step.shape == (2, 5)
    assert result.per_agent.shape == (2, 1)
    for b in range(2):
        parts = [float(path_risk(batch[b], [p[1]], BOX).total) for p in (first, second)]
        assert float(result.total[b]) == pytest.approx(0.3 * parts[0] + 0.7 * parts[1], rel=1e-12)


def test_moving_the_world_changes_nothing():
    poses, pred = scene(np.random.default_rng(6), 5)
    moved = dataclasses.replace(pred, means=pred.means + [1e5, -1e5])
    for ego in (ELLIPSE, BOX):
        here = float(path_risk(poses, [pred], ego).total)
        assert float(path_risk(poses + [1e5, -1e5, 0], [moved], ego).total) == pytest.approx(here, rel=1e-8)


def test_moment_agents_have_booles_bound_only():
    poses, pred = scene(np.random.default_rng(0), 5)
    known = pred.moments(2)
    bound = path_risk(poses, [known], ELLIPSE, "boole")
    assert bound.kind is Kind.UPPER_BOUND
    assert float(bound.total) >= float(path_risk(poses, [pred], ELLIPSE).total)
    with pytest.raises(InputError, match="dependence: .*moments only.*'boole'"):
        path_risk(poses, [known], ELLIPSE)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"dependence": "comonotone"}, "dependence: expected one of independent, persistent, boole"),
        ({"tolerance": 0.0}, "tolerance: "),
        ({"predictions": []}, "predictions: expected at least one"),
        (
            {"predictions": [3]},
            r"predictions\[0\]: expected a GaussianMixturePrediction or MomentPrediction or ControlPrediction, got int",
        ),
        ({"poses": np.zeros((2, 3))}, r"poses: expected shape \(1, 3\)"),
        ({"ego": 3}, "ego: expected a shape"),
        ({"predictions": [single([0, 0], np.eye(2), length=4.0, width=2.0)]}, "headings: EgoBox needs"),
        ({"predictions": [single([0, 0], np.eye(2), width=2.0, headings=[[0.0]])]}, "length: EgoBox needs"),
        ({"predictions": [single([0, 0], np.eye(2), length=2.0, headings=[[0.0]])]}, "width: EgoBox needs"),
        (
            {
                "predictions": [single([0, 0], np.eye(2), factors=np.ones((1, 1, 2, 1)) / 9, modes="per_step")],
                "ego": ELLIPSE,
            },
            "modes: factors .* persist",
        ),
        (
            {"predictions": [single([0, 0], np.eye(2), length=4.0, width=2.0)], "ego": EgoEllipsoid.aligned(4.0, 2.0)},
            "headings: the mean of an agent has one step or stands still at another",
        ),
        (
            {
                "predictions": [row([[0, 0], [0, 0]], [np.eye(2)] * 2, length=4.0, width=2.0)],
                "ego": EgoEllipsoid.aligned(4.0, 2.0),
                "poses": np.zeros((2, 3)),
            },
            "headings: the mean of an agent has one step or stands still at another",
        ),
    ],
)
def test_bad_input(change, message):
    arguments = {"poses": np.zeros((1, 3)), "predictions": [single([0, 0], np.eye(2))], "ego": BOX, **change}
    with pytest.raises(InputError, match=message):
        path_risk(**arguments)


@pytest.mark.parametrize("rank", [1, 2])
def test_a_rest_too_small_for_a_grid_is_never_no_risk(rank):
    """Two sums over nodes that all miss the set agree on 0: that once passed for exact."""
    for spread, rest, mean, radius in ((3.0, 0.01, (0.75, 0.75), 0.6), (5.0, 0.005, (1.25, 0.0), 1.0)):
        factor = spread * np.eye(2)[None, None][..., :rank]
        covariances = factor @ np.swapaxes(factor, -1, -2) + rest**2 * np.eye(2)
        means, twice = np.array([[mean]] * 2), [np.repeat(v, 2, axis=0) for v in (factor, covariances)]
        pred = GaussianMixturePrediction([0.1, 0.2], [1.0], means, twice[1], factors=twice[0])
        risk = path_risk(np.zeros((2, 3)), [pred], EgoEllipsoid(np.eye(2) / radius**2), "persistent")
        xi, noise = np.random.default_rng(5).standard_normal((2, 400_000, 2))
        moved = np.array(mean) + xi[:, :rank] @ factor[0, 0].T
        hit = np.hypot(*(moved + rest * noise).T) <= radius  # one step; the second moves by the rest only
        assert risk.max_step <= risk.total <= risk.boole
        assert abs(float(risk.total) - hit.mean()) < 3 * float(risk.error) + 0.05 * hit.mean() + 3 / len(hit)


def test_totals_are_held_between_the_largest_step_and_the_sum():
    """Of steps that are themselves in doubt a total beyond their sum is no less exact: at 1e-2 they are rougher."""
    steps = np.array([[0.1, 0.2, 0.05]])
    for total, doubt, held, kind in (
        (0.0, 0.0, 0.2, Kind.ESTIMATE),
        (0.9, 0.0, 0.35, Kind.ESTIMATE),
        (0.3, 0.0, 0.3, Kind.EXACT),
        (0.351, 1e-3, 0.35, Kind.EXACT),
        (0.36, 1e-4, 0.35, Kind.ESTIMATE),
    ):
        doubts = np.full_like(steps, doubt / 3)
        value, error, claim = within_any_dependence(np.array([total]), np.array([1e-9]), Kind.EXACT, steps, doubts)
        assert value[0] == pytest.approx(held) and claim is kind and error[0] >= abs(held - total)
