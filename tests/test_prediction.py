"""Predictions: what is refused, what cannot be changed, and that nothing is lost on the way to a file."""

from __future__ import annotations

import dataclasses
import math

import mpmath as mp
import numpy as np
import pytest
from builders import covariance, discrete, mixture, single
from hypothesis import given, settings
from hypothesis import strategies as st

from checkers import GaussianMixturePrediction, InputError, MomentPrediction, load_prediction

quiet = settings(derandomize=True, max_examples=60, deadline=None)

T, K = 3, 2


def good(**changes):
    values = {
        "times": [0.1, 0.2, 0.4],
        "weights": [0.25, 0.75],
        "means": np.arange(T * K * 2, dtype=float).reshape(T, K, 2),
        "covariances": np.broadcast_to(np.diag([1.0, 2.0]), (T, K, 2, 2)).copy(),
    }
    values.update(changes)
    return values


def with_entry(field, index, value):
    array = np.array(good()[field], dtype=float)
    array[index] = value
    return {field: array}


# ---- refusals: the message names the field and the index

REFUSED = [
    (with_entry("times", 1, np.nan), r"times\[1\]: expected a finite number"),
    (with_entry("times", 2, 0.2), r"times\[2\]: expected times to increase"),
    (with_entry("times", 0, 0.3), r"times\[1\]: expected times to increase"),
    ({"times": []}, r"times: expected shape \(T,\)"),
    ({"times": 0.1}, r"times: expected shape"),
    ({"times": [0.1, 0.2]}, r"means: expected shape \(2, K, 2\), got \(3, 2, 2\)"),
    ({"times": ["a", "b", "c"]}, r"times: expected numbers"),
    ({"times": None}, r"times: "),
    (with_entry("weights", 0, np.nan), r"weights\[0\]: expected a finite number"),
    (with_entry("weights", 1, 0.5), r"weights: expected weights that sum to 1, got a sum of 0.75"),
    ({"weights": [0.25, 0.750002]}, r"weights: expected weights that sum to 1"),
    ({"weights": [-0.25, 1.25]}, r"weights\[0\]: expected a weight >= 0, got -0.25"),
    ({"weights": [1.0]}, r"weights: expected shape \(2,\), got \(1,\)"),
    ({"weights": []}, r"weights: expected shape"),
    ({"weights": 1.0}, r"weights: expected shape"),
    ({"weights": [[0.5, 0.5], [0.5]]}, r"weights: "),
    ({"weights": [[0.5, 0.5]] * 2}, r"weights: expected shape \(3, 2\), got \(2, 2\)"),
    ({"weights": [[0.5, 0.5], [0.5, 0.5], [0.5, 0.4]], "modes": "per_step"}, r"weights\[2\]: .* sum of 0.9"),
    (
        {"weights": [[0.5, 0.5], [0.4, 0.6], [0.5, 0.5]]},
        r"weights\[1\]: persistent modes have one weight each",
    ),
    (with_entry("means", (1, 0, 1), np.inf), r"means\[1, 0, 1\]: expected a finite number, got inf"),
    ({"means": np.zeros((T, K, 3))}, r"means: expected shape \(3, K, 2\), got \(3, 2, 3\)"),
    ({"means": np.zeros((T, 0, 2))}, r"means: expected shape"),
    ({"means": [[[0, 0], [1]], [[0, 0]], [[0, 0]]]}, r"means: expected numbers"),
    (
        with_entry("covariances", (2, 1, 0, 0), np.nan),
        r"covariances\[2, 1, 0, 0\]: expected a finite number, got nan",
    ),
    (
        with_entry("covariances", (2, 1, 0, 0), -1e-3),
        r"covariances\[2, 1\]: expected a positive semi-definite matrix",
    ),
    (
        with_entry("covariances", (1, 0), [[1, 2], [2, 1]]),
        r"covariances\[1, 0\]: expected a positive semi-definite",
    ),
    (with_entry("covariances", (0, 1, 0, 1), 0.5), r"covariances\[0, 1\]: expected a symmetric matrix"),
    ({"covariances": np.eye(2)}, r"covariances: expected shape \(3, 2, 2, 2\), got \(2, 2\)"),
    ({"modes": "both"}, r"modes: expected one of persistent, per_step; got 'both'"),
    ({"modes": None}, r"modes: expected one of"),
    ({"name": 7}, r"name: expected text"),
    ({"length": -4.0}, r"length: expected"),
    ({"length": 0.0}, r"length: expected"),
    ({"width": np.nan}, r"width: expected a finite number"),
    ({"width": "wide"}, r"width: expected a number"),
    ({"headings": [0.0, 0.1]}, r"headings: expected shape \(3, 2\)"),
    ({"headings": np.full((T, K), np.nan)}, r"headings\[0, 0\]: expected a finite number"),
]


@pytest.mark.parametrize(
    ("changes", "message"), REFUSED, ids=[f"{i}-{next(iter(c))}" for i, (c, _) in enumerate(REFUSED)]
)
def test_refused(changes, message):
    with pytest.raises(InputError, match=message) as error:
        GaussianMixturePrediction(**good(**changes))
    assert "\n" not in str(error.value)


def moments_of_good(order=4):
    return np.array(GaussianMixturePrediction(**good()).moments(order).central_moments)


@pytest.mark.parametrize(
    ("index", "value", "message"),
    [
        ((1, 0, 2, 1), np.nan, r"central_moments\[1, 0, 2, 1\]: expected a finite number, got nan"),
        ((1, 0, 0, 0), 0.9, r"central_moments\[1, 0, 0, 0\]: expected 1, got 0.9"),
        ((2, 1, 1, 0), 0.1, r"central_moments\[2, 1, 1, 0\]: expected 0, got 0.1"),
        ((2, 1, 0, 1), -0.1, r"central_moments\[2, 1, 0, 1\]: expected 0, got -0.1"),
        ((0, 1, 2, 0), -1.0, r"central_moments.*\[0, 1\]: expected a positive semi-definite"),
        ((0, 1, 4, 0), -1.0, r"central_moments.*\[0, 1"),  # no fourth power has a negative mean
        ((0, 1, 4, 0), 0.5, r"central_moments.*\[0, 1"),  # below the square of the variance
    ],
)
def test_moments_refused(index, value, message):
    moments = moments_of_good()
    moments[index] = value
    with pytest.raises(InputError, match=message):
        MomentPrediction(good()["times"], good()["weights"], good()["means"], moments)


@pytest.mark.parametrize(
    "moments",
    [
        np.ones((T, K, 2, 2)),
        np.ones((T, K, 3, 4)),
        np.ones((T, 1, 3, 3)),
        1.0,
        None,
        [[1.0], [1.0, 2.0]],
        "moments",
    ],
)
def test_moments_of_the_wrong_shape(moments):
    with pytest.raises(InputError, match="central_moments"):
        MomentPrediction(good()["times"], good()["weights"], good()["means"], moments)


def test_weights_within_1e_6_are_normalised():
    pred = GaussianMixturePrediction(**good(weights=np.array([0.1, 0.9], dtype=np.float32) * (1 + 5e-7)))
    assert abs(pred.weights.sum() - 1.0) < 1e-15
    per_step = GaussianMixturePrediction(**good(weights=[[0.3, 0.7000005]] * T, modes="per_step"))
    np.testing.assert_allclose(per_step.weights.sum(axis=1), 1.0, rtol=1e-15)


def test_singular_covariances_are_welcome():
    GaussianMixturePrediction(**good(covariances=np.zeros((T, K, 2, 2))))
    line = np.outer([1, 3.0], [1, 3.0])
    GaussianMixturePrediction(**good(covariances=np.broadcast_to(line, (T, K, 2, 2))))


def test_constant_weights_per_step_of_persistent_modes_are_one_row():
    pred = GaussianMixturePrediction(**good(weights=[[0.25, 0.75]] * T))
    assert pred.weights.shape == (K,)
    np.testing.assert_array_equal(pred.step_weights, [[0.25, 0.75]] * T)


# ---- frozen

FIELDS = ("times", "weights", "means", "covariances", "headings")


def labelled(**changes):
    return GaussianMixturePrediction(
        **good(name="a", length=4.5, width=1.8, headings=np.linspace(0, 1, T * K).reshape(T, K), **changes)
    )


def test_arrays_are_read_only_copies():
    values = good(headings=np.zeros((T, K)))
    pred = GaussianMixturePrediction(**values)
    for field in FIELDS:
        array = getattr(pred, field)
        assert array.dtype == np.float64
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 7
    values["means"][0, 0, 0] = 99.0
    assert pred.means[0, 0, 0] == 0.0
    moments = moments_of_good()
    other = MomentPrediction(pred.times, pred.weights, pred.means, moments)
    moments[...] = 5
    assert other.central_moments[0, 0, 0, 0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        other.central_moments[0, 0, 0, 0] = 2


@pytest.mark.parametrize("make", [labelled, lambda: labelled().moments(3)])
def test_frozen(make):
    pred = make()
    for field in dataclasses.fields(pred):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(pred, field.name, None)


# ---- files


@pytest.mark.parametrize("per_step", [False, True])
@pytest.mark.parametrize("order", [0, 4])
def test_round_trip(tmp_path, per_step, order):
    pred = mixture(np.random.default_rng(1), per_step=per_step, name="agent-7", length=4.5, headings=np.ones((4, 3)))
    pred = pred.moments(order) if order else pred
    path = tmp_path / "agent.npz"
    pred.save(path)
    back = load_prediction(path)
    assert type(back) is type(pred)
    for field in dataclasses.fields(pred):
        a, b = getattr(pred, field.name), getattr(back, field.name)
        if isinstance(a, np.ndarray):
            np.testing.assert_allclose(a, b, rtol=1e-15, atol=0)
        else:
            assert a == b


def test_pickles_are_refused(tmp_path):
    class Bomb:
        def __reduce__(self):
            return (pytest.fail, ("unpickled",))

    path = tmp_path / "bomb.npz"
    np.savez(path, type=np.asarray("gaussian"), times=np.array([Bomb()], dtype=object), allow_pickle=True)
    with pytest.raises(InputError, match="not a prediction file"):
        load_prediction(path)


def test_files_that_are_none(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        load_prediction(tmp_path / "none.npz")
    path = tmp_path / "text.npz"
    for content in (b"", b"hello", b"PK\x03\x04 cut short"):
        path.write_bytes(content)
        with pytest.raises(InputError, match="not a prediction file"):
            load_prediction(path)
    np.savez(path, type=np.asarray("gaussian"), times=np.zeros(1))
    with pytest.raises(InputError, match=r"text\.npz"):
        load_prediction(path)
    np.savez(path, type=np.asarray("unknown"))
    with pytest.raises(InputError, match="type: expected one of gaussian, moments"):
        load_prediction(path)
    np.save(path.with_suffix(".npy"), np.zeros(3))
    with pytest.raises(InputError, match="not a prediction file"):
        load_prediction(path.with_suffix(".npy"))


# ---- other times


@pytest.mark.parametrize("order", [0, 4])
def test_at_own_times_is_the_same(order):
    pred = mixture(np.random.default_rng(2), steps=4)
    pred = pred.moments(order) if order else pred
    back = pred.at(pred.times)
    np.testing.assert_array_equal(back.means, pred.means)
    np.testing.assert_array_equal(back.covariances, pred.covariances)
    np.testing.assert_array_equal(pred.at(pred.times[[1, 3]]).means, pred.means[[1, 3]])


@pytest.mark.parametrize("order", [0, 4])
@pytest.mark.parametrize("per_step", [False, True])
def test_at_some_own_times_is_a_cut(order, per_step):
    pred = mixture(np.random.default_rng(2), 5, 2, per_step, name="a", width=2.0, headings=np.eye(5)[:, :2])
    pred = pred.moments(order) if order else pred
    for steps in (slice(0, 1), slice(1, 4), slice(3, 5)):
        cut = pred.at(pred.times[steps])
        assert type(cut) is type(pred)
        for field in ("times", "means", "covariances", "headings", "step_weights"):
            np.testing.assert_array_equal(getattr(cut, field), getattr(pred, field)[steps])
        assert (cut.name, cut.width, cut.length, cut.modes) == ("a", 2.0, None, pred.modes)
        with pytest.raises(ValueError, match="read-only"):
            cut.means[...] = 0


@pytest.mark.parametrize("order", [0, 4])
def test_at_interpolates_linearly(order):
    pred = mixture(np.random.default_rng(2), steps=3, per_step=True)
    pred = pred.moments(order) if order else pred
    t = pred.times
    between = pred.at([t[0], 0.75 * t[0] + 0.25 * t[1], t[2]])
    for field in ("means", "covariances", "weights"):
        values = getattr(pred, field)
        np.testing.assert_allclose(
            getattr(between, field)[1], 0.75 * values[0] + 0.25 * values[1], rtol=1e-12, atol=1e-15
        )
    if order:
        a = pred.central_moments
        np.testing.assert_allclose(between.central_moments[1], 0.75 * a[0] + 0.25 * a[1], rtol=1e-12, atol=1e-15)


def test_at_turns_headings_the_short_way():
    headings = np.array([[3.0], [-3.0]])
    pred = GaussianMixturePrediction([0, 1], [1.0], np.zeros((2, 1, 2)), np.zeros((2, 1, 2, 2)), headings=headings)
    middle = pred.at([0.5]).headings[0, 0]
    assert math.cos(middle) == pytest.approx(-1.0)
    assert math.cos(pred.at([1.0]).headings[0, 0] + 3.0) == pytest.approx(1.0)


@pytest.mark.parametrize("times", [[0.0, 1.0], [1.0, 2.1], [-5.0], [1e9]])
def test_at_never_extrapolates(times):
    pred = mixture(np.random.default_rng(2), steps=4, name="agent-3")  # 0.5 … 2.0
    for one in (pred, pred.moments(2)):
        with pytest.raises(InputError, match=r"times\[\d\]: agent-3 covers 0.5 to 2 s, got"):
            one.at(times)


def test_at_refuses_bad_times():
    pred = mixture(np.random.default_rng(2))
    for times, message in (([1.0, 0.5], r"times\[1\]"), ([np.nan], r"times\[0\]"), ([], "times")):
        with pytest.raises(InputError, match=message):
            pred.at(times)


@quiet
@given(share=st.floats(0, 1), seed=st.integers(0, 50))
def test_interpolated_covariances_stay_positive(share, seed):
    pred = mixture(np.random.default_rng(seed), steps=2)
    t = pred.times
    between = pred.at([(1 - share) * t[0] + share * t[1]])
    assert (np.linalg.eigvalsh(between.covariances)[..., 0] > 0).all()


# ---- samples


def test_sample_statistics():
    pred = mixture(np.random.default_rng(3), steps=2, modes=3)
    n = 200_000
    x = pred.sample(n, np.random.default_rng(0))
    assert x.shape == (n, 2, 2)
    for t in range(2):
        mean = pred.weights @ pred.means[t]
        away = pred.means[t] - mean
        cov = np.einsum("k,kij->ij", pred.weights, pred.covariances[t] + away[:, :, None] * away[:, None, :])
        np.testing.assert_allclose(x[:, t].mean(axis=0), mean, atol=5 * np.sqrt(cov.max() / n))
        np.testing.assert_allclose(np.cov(x[:, t].T), cov, atol=0.02 * cov.max())


def apart(per_step):
    """Two modes a kilometre apart, so that a sample shows its mode."""
    means = np.zeros((5, 2, 2))
    means[:, 1, 0] = 1000.0
    weights = np.array([[0.3, 0.7]] * 5)
    if per_step:
        weights[2] = [0.9, 0.1]
    return GaussianMixturePrediction(
        np.arange(5.0),
        weights,
        means,
        np.broadcast_to(np.eye(2), (5, 2, 2, 2)),
        "per_step" if per_step else "persistent",
    )


def test_persistent_samples_keep_their_mode():
    mode = apart(per_step=False).sample(20_000, np.random.default_rng(1))[..., 0] > 500
    assert (mode == mode[:, :1]).all()
    assert mode[:, 0].mean() == pytest.approx(0.7, abs=0.015)


def test_per_step_samples_draw_a_mode_each_step():
    mode = apart(per_step=True).sample(20_000, np.random.default_rng(1))[..., 0] > 500
    np.testing.assert_allclose(mode.mean(axis=0), [0.7, 0.7, 0.1, 0.7, 0.7], atol=0.015)
    assert abs(np.corrcoef(mode[:, 0], mode[:, 1])[0, 1]) < 0.03


def test_samples_repeat_with_the_seed_and_a_point_mass_is_a_point():
    pred = mixture(np.random.default_rng(3))
    a, b = (pred.sample(10, np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(a, b)
    point = single([3.0, -2.0], np.zeros((2, 2))).sample(5, np.random.default_rng(0))
    np.testing.assert_array_equal(point, np.broadcast_to([3.0, -2.0], (5, 1, 2)))
    line = single([0.0, 0.0], np.outer([1, 2.0], [1, 2.0])).sample(50, np.random.default_rng(0))
    np.testing.assert_allclose(line[..., 1], 2 * line[..., 0], rtol=1e-7)


def test_moments_cannot_be_sampled():
    with pytest.raises(InputError, match="agent-1 is known by its moments only"):
        single([0, 0], np.eye(2), name="agent-1").moments(4).sample(3, np.random.default_rng(0))


# ---- moments


def central_moment(cov, i, j):
    """E[x^i y^j] by expanding x = a u, y = b u + c v over independent standard normals."""
    with mp.workdps(40):
        a = mp.sqrt(mp.mpf(cov[0][0]))
        b = mp.mpf(cov[0][1]) / a
        c = mp.sqrt(mp.mpf(cov[1][1]) - b * b)

        def normal(n):
            return mp.fac2(n - 1) if n % 2 == 0 else mp.mpf(0)

        return float(
            mp.fsum(
                mp.binomial(j, k) * a**i * b**k * c ** (j - k) * normal(i + k) * normal(j - k) for k in range(j + 1)
            )
        )


@quiet
@given(
    sigma=st.tuples(st.floats(0.01, 10), st.floats(0.01, 10)),
    angle=st.floats(0, math.pi),
    order=st.integers(2, 12),
)
def test_gaussian_moments_are_exact(sigma, angle, order):
    cov = covariance(*sigma, angle)
    moments = single([7.0, -3.0], cov).moments(order).central_moments[0, 0]
    scale = max(sigma)
    for i in range(order + 1):
        for j in range(order + 1):
            if i + j > order:
                assert np.isnan(moments[i, j])
            else:
                expected = central_moment(cov, i, j)
                size = math.sqrt(central_moment(cov, 2 * i, 0) * central_moment(cov, 0, 2 * j))
                assert moments[i, j] == pytest.approx(expected, rel=1e-9, abs=1e-9 * size + 1e-300 * scale)


def test_moments_of_a_sample():
    pred = single([1.0, 2.0], covariance(0.5, 2.0, 0.6))
    x = pred.sample(400_000, np.random.default_rng(2))[:, 0] - [1.0, 2.0]
    m = pred.moments(4).central_moments[0, 0]
    for i, j in ((2, 0), (1, 1), (0, 2), (4, 0), (2, 2), (1, 3)):
        power = x[:, 0] ** i * x[:, 1] ** j
        assert m[i, j] == pytest.approx(power.mean(), abs=5 * power.std() / 600)


def test_fewer_moments_are_a_cut_and_more_are_refused():
    pred = mixture(np.random.default_rng(4), name="agent-5", length=4.0, per_step=True).moments(6)
    cut = pred.moments(4)
    np.testing.assert_array_equal(
        cut.central_moments,
        np.where(np.isnan(cut.central_moments), np.nan, pred.central_moments[..., :5, :5]),
    )
    assert np.isnan(cut.central_moments[..., 4, 1]).all()
    assert (cut.order, cut.name, cut.length, cut.modes) == (4, "agent-5", 4.0, "per_step")
    np.testing.assert_array_equal(cut.covariances, pred.covariances)
    with pytest.raises(InputError, match="agent-5 carries moments up to order 6, asked for 8"):
        pred.moments(8)


@pytest.mark.parametrize("order", [-1, 0, 1, 2.5, "4", None])
def test_moments_of_a_senseless_order(order):
    pred = single([0, 0], np.eye(2))
    for one in (pred, pred.moments(6)):
        with pytest.raises(InputError):
            one.moments(order)


def test_moments_keep_the_labels():
    pred = labelled()
    m = pred.moments(4)
    assert (m.name, m.length, m.width, m.modes) == (pred.name, pred.length, pred.width, pred.modes)
    np.testing.assert_array_equal(m.headings, pred.headings)
    np.testing.assert_allclose(m.covariances, pred.covariances, rtol=1e-15)


def test_discrete_moments_are_accepted():
    """Singular moment matrices belong to real distributions."""
    for points, weights in (([[1, 0], [-1, 0]], [0.5, 0.5]), ([[0, 0], [1, 1], [5, -3]], [0.2, 0.3, 0.5])):
        assert discrete(points, weights, 8).order == 8
