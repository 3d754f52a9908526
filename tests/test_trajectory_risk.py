"""From marginals to a trajectory, against enumeration of every mode sequence and every history of hits."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from builders import mixture
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import trajectory

from checkers import EgoCover, EgoEllipsoid, InputError, Kind, Risk, checker, trajectory_risk

quiet = settings(derandomize=True, max_examples=40, deadline=None)


def agent(steps=3, modes=2, per_step=False, seed=0):
    return mixture(np.random.default_rng(seed), steps, modes, per_step)


def risk(value, kind=Kind.EXACT):
    return Risk(np.asarray(value, dtype=float), kind)


@quiet
@given(
    steps=st.integers(1, 4),
    modes=st.integers(1, 3),
    per_step=st.booleans(),
    seed=st.integers(0, 999),
    low=st.sampled_from([-18, -12, -6, -1]),
)
def test_one_agent_against_enumeration(steps, modes, per_step, seed, low):
    pred = agent(steps, modes, per_step, seed)
    values = 10 ** np.random.default_rng(seed).uniform(low, min(low + 4, 0), (steps, modes))
    result = trajectory_risk([risk(values)], [pred])
    expected = float(trajectory(pred.weights, values, pred.modes))
    assert float(result.total) == pytest.approx(expected, rel=1e-12, abs=0)
    assert float(result.per_agent[0]) == pytest.approx(expected, rel=1e-12, abs=0)
    assert float(result.max_step) <= expected * (1 + 1e-12)
    assert expected <= float(result.boole) * (1 + 1e-12)
    assert result.frechet == (result.max_step, result.boole)


@pytest.mark.parametrize("size", [1e-12, 1e-15, 1e-18, 1e-100, 1e-300])
@pytest.mark.parametrize("per_step", [False, True])
def test_tiny_risks_are_kept(size, per_step):
    pred = agent(5, 2, per_step)
    result = trajectory_risk([risk(np.full((5, 2), size))], [pred])
    assert float(result.total) == pytest.approx(5 * size, rel=1e-11, abs=0)
    assert float(result.boole) == pytest.approx(5 * size, rel=1e-12, abs=0)


def test_zero_and_certain_risks():
    for per_step in (False, True):
        pred = agent(3, 2, per_step)
        nothing = trajectory_risk([risk(np.zeros((3, 2)))], [pred])
        for value in (nothing.total, nothing.boole, nothing.max_step, *nothing.per_step, *nothing.per_agent):
            assert value == 0
            assert not np.signbit(value)  # a report must not say -0.0
        one = np.zeros((3, 2))
        one[1] = 1.0
        certain = trajectory_risk([risk(one)], [pred])
        assert certain.total == pytest.approx(1.0, abs=1e-15)
        assert certain.total <= 1
        np.testing.assert_allclose(certain.per_step, [0, 1, 0], atol=1e-15)


def test_persistent_and_per_step_differ_as_they_should():
    """One sure mode of two, at every step: persistent 1/2, redrawn at each step 1 − 1/2³."""
    values = np.array([[1.0, 0.0]] * 3)
    times, means, covs = [0, 1, 2], np.zeros((3, 2, 2)), np.zeros((3, 2, 2, 2))
    from checkers import GaussianMixturePrediction  # noqa: PLC0415

    for modes, expected in (("persistent", 0.5), ("per_step", 0.875)):
        pred = GaussianMixturePrediction(times, [0.5, 0.5], means, covs, modes)
        assert trajectory_risk([risk(values)], [pred]).total == pytest.approx(expected, rel=1e-15)


def test_agents_are_summed_and_capped():
    rng = np.random.default_rng(3)
    preds = [agent(3, 2, seed=1), agent(3, 4, True, seed=2), agent(3, 1, seed=3)]
    values = [rng.uniform(0, 0.1, p.means.shape[:2]) for p in preds]
    result = trajectory_risk([risk(v) for v in values], preds)
    each = [float(trajectory(p.weights, v, p.modes)) for p, v in zip(preds, values, strict=True)]
    marginals = np.array([(p.step_weights * v).sum(axis=1) for p, v in zip(preds, values, strict=True)])
    np.testing.assert_allclose(result.per_agent, each, rtol=1e-12)
    assert result.total == pytest.approx(sum(each), rel=1e-12)
    np.testing.assert_allclose(result.per_step, marginals.sum(axis=0), rtol=1e-12)
    assert result.boole == pytest.approx(marginals.sum(), rel=1e-12)
    assert result.max_step == pytest.approx(marginals.max(), rel=1e-12)
    crowd = trajectory_risk([risk(np.full((3, 1), 0.9))] * 4, [preds[2]] * 4)
    for value in (crowd.total, crowd.boole, *crowd.per_agent, *crowd.per_step):
        assert value <= 1.0
    assert crowd.total == 1.0
    assert crowd.max_step == pytest.approx(0.9)
    np.testing.assert_allclose(crowd.per_agent, 0.999, rtol=1e-12)


def test_boole():
    rng = np.random.default_rng(4)
    preds = [agent(3, 2, seed=1), agent(3, 2, True, seed=2)]
    risks = [risk(rng.uniform(0, 0.05, (3, 2))) for _ in preds]
    result = trajectory_risk(risks, preds, dependence="boole")
    free = trajectory_risk(risks, preds)
    assert result.dependence == "boole"
    assert free.dependence == "independent"
    expected = sum((p.step_weights * r.value).sum() for p, r in zip(preds, risks, strict=True))
    assert result.total == pytest.approx(expected, rel=1e-13)
    assert result.total == pytest.approx(float(result.boole), rel=1e-13)
    assert result.total >= free.total
    assert result.kind is Kind.UPPER_BOUND
    heavy = trajectory_risk([risk(np.full((3, 2), 0.6))], [preds[0]], dependence="boole")
    assert heavy.total == 1.0
    assert heavy.per_agent[0] == 1.0


def test_order_is_total_between_the_bounds_for_checked_risks():
    """max_t ≤ truth ≤ Boole, with real marginals."""
    rng = np.random.default_rng(5)
    for _ in range(20):
        pred = mixture(rng, 4, 3, rng.random() < 0.5)
        r = checker("exact")(rng.uniform(-4, 4, (4, 3)), pred, EgoEllipsoid(np.eye(2)))
        result = trajectory_risk([r], [pred])
        assert result.max_step * (1 - 1e-12) <= result.total <= result.boole * (1 + 1e-12)


def test_against_sampled_trajectories():
    """Nothing but samples of the prediction and the ellipse's inequality."""
    rng = np.random.default_rng(6)
    poses = rng.uniform(-1, 1, (4, 3))
    for per_step in (False, True):
        pred = mixture(rng, 4, 3, per_step)
        result = trajectory_risk([checker("exact")(poses, pred, EgoEllipsoid(np.diag([0.5, 1.0])))], [pred])
        x = pred.sample(100_000, np.random.default_rng(1)) - poses[:, :2]
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        along, beside = c * x[..., 0] + s * x[..., 1], -s * x[..., 0] + c * x[..., 1]
        hits = 0.5 * along**2 + beside**2 <= 1
        assert float(result.total) == pytest.approx(hits.any(axis=1).mean(), abs=0.007)
        np.testing.assert_allclose(result.per_step, hits.mean(axis=0), atol=0.007)


@pytest.mark.parametrize(("first", "second"), list(itertools.product(Kind, Kind)))
def test_the_kind_travels(first, second):
    preds = [agent(seed=1), agent(seed=2)]
    values = np.full((3, 2), 0.1)
    for dependence in ("independent", "boole"):
        result = trajectory_risk([risk(values, first), risk(values, second)], preds, dependence)
        if Kind.ESTIMATE in (first, second):
            assert result.kind is Kind.ESTIMATE
        else:
            # a sum over agents is a union bound: no longer exact, whatever its parts
            assert result.kind is Kind.UPPER_BOUND


@pytest.mark.parametrize("kind", list(Kind))
def test_the_kind_of_one_agent(kind):
    assert trajectory_risk([risk(np.full((3, 2), 0.1), kind)], [agent()]).kind is kind


def test_kind_weakest():
    assert Kind.weakest([]) is Kind.EXACT
    assert Kind.weakest([Kind.EXACT, Kind.UPPER_BOUND]) is Kind.UPPER_BOUND
    assert Kind.weakest([Kind.UPPER_BOUND, Kind.ESTIMATE, Kind.EXACT]) is Kind.ESTIMATE


def test_a_cover_makes_a_bound():
    pred = agent()
    r = checker("exact")(np.zeros((3, 3)), pred, EgoCover(4.0, 2.0, 3))
    assert trajectory_risk([r], [pred]).kind is Kind.UPPER_BOUND


@pytest.mark.parametrize("dependence", ["independent", "boole"])
def test_batches_equal_loops(dependence):
    rng = np.random.default_rng(8)
    preds = [agent(3, 2, seed=1), agent(3, 4, True, seed=2)]
    values = [rng.uniform(0, 0.3, (5, 3, k)) for k in (2, 4)]
    batch = trajectory_risk([risk(v) for v in values], preds, dependence)
    assert batch.total.shape == (5,)
    assert batch.per_agent.shape == (5, 2)
    assert batch.per_step.shape == (5, 3)
    assert batch.boole.shape == batch.max_step.shape == (5,)
    for b in range(5):
        one = trajectory_risk([risk(v[b]) for v in values], preds, dependence)
        for field in ("total", "per_agent", "per_step", "boole", "max_step"):
            np.testing.assert_array_equal(getattr(batch, field)[b], getattr(one, field))


def test_moment_agents_combine_too():
    pred = agent()
    r = risk(np.full((3, 2), 0.2))
    assert trajectory_risk([r], [pred.moments(4)]).total == trajectory_risk([r], [pred]).total


def test_nan_never_becomes_a_risk():
    """Unknown marginals are refused, or stay unknown in everything they enter."""
    for per_step, dependence in itertools.product((False, True), ("independent", "boole")):
        values = np.full((3, 2), 0.1)
        values[1, 0] = np.nan
        try:
            result = trajectory_risk([risk(values)], [agent(per_step=per_step)], dependence)
        except InputError:
            continue
        for value in (result.total, result.per_agent[0], result.per_step[1], result.boole, result.max_step):
            assert np.isnan(value)


@pytest.mark.parametrize("value", [-1e-7, -1.0, 1.5, np.inf])
def test_values_that_are_no_probabilities_are_refused(value):
    values = np.full((3, 2), 0.1)
    values[1, 0] = value
    with pytest.raises(InputError, match="value"):
        trajectory_risk([risk(values)], [agent()])


def test_refusals():
    a, b = agent(seed=1), agent(seed=2)
    r = risk(np.full((3, 2), 0.1))
    with pytest.raises(InputError, match="dependence: expected one of independent, boole; got 'copula'"):
        trajectory_risk([r], [a], dependence="copula")
    with pytest.raises(InputError, match="expected one per prediction and at least one, got 0 for 0"):
        trajectory_risk([], [])
    with pytest.raises(InputError, match="got 1 for 2"):
        trajectory_risk([r], [a, b])
    with pytest.raises(InputError, match=r"risks\[1\].value: expected .*\(3, 2\).*got \(2, 2\)"):
        trajectory_risk([r, risk(np.full((2, 2), 0.1))], [a, b])
    with pytest.raises(InputError, match="one time grid"):
        trajectory_risk([r, risk(np.full((4, 2), 0.1))], [a, agent(4)])
    with pytest.raises(InputError, match=r"risks.*\(5, 3"):
        trajectory_risk([r, risk(np.full((5, 3, 2), 0.1))], [a, b])


def test_agents_on_other_times_are_refused():
    """As many steps, but not the same instants: their per-step sums would mean nothing."""
    from checkers import GaussianMixturePrediction  # noqa: PLC0415

    a = agent()
    b = GaussianMixturePrediction(a.times * 2, a.weights, a.means, a.covariances)
    r = risk(np.full((3, 2), 0.1))
    with pytest.raises(InputError, match="time"):
        trajectory_risk([r, r], [a, b])


def test_results_are_frozen():
    import dataclasses  # noqa: PLC0415

    result = trajectory_risk([risk(np.full((3, 2), 0.1))], [agent()])
    for one in (result, risk(np.zeros((1, 1)))):
        for field in dataclasses.fields(one):
            with pytest.raises(dataclasses.FrozenInstanceError):
                setattr(one, field.name, None)
