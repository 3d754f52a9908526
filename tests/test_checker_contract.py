"""One contract for every registered backend: driven by what each declares, not by its name."""

from __future__ import annotations

import re

import numpy as np
import pytest
from builders import cases, covariance, discrete, mixture, row, single, spin, variants
from oracles import sampled, truth

from checkers import (
    EgoCover,
    EgoEllipsoid,
    GaussianMixturePrediction,
    InputError,
    Kind,
    MomentPrediction,
    checker,
    checkers,
)

VARIANTS = variants()
EGO = EgoEllipsoid(np.array([[1 / 2.5**2, 0.02], [0.02, 1.0]]))
DISC = EgoEllipsoid(np.eye(2))
LONG_EGO = EgoEllipsoid(np.diag([1 / 6.0**2, 1.0]))


@pytest.fixture(params=VARIANTS, ids=lambda v: "-".join([v[0], *map(str, v[1].values())]))
def backend(request):
    name, options = request.param
    return checker(name, **options)


def is_sampling(backend):
    return backend.info.kind is Kind.ESTIMATE


def exactness(backend):
    """How far a change of frame may show: in the last digits, or in those of an interior-point solver."""
    solver = backend.kernel == 0 and not is_sampling(backend)
    return {"rtol": 3e-4, "atol": 1e-6} if solver else {"rtol": 1e-9, "atol": 0}


def takes_moments(backend):
    return backend.moments_needed > 0


@pytest.fixture(scope="module")
def campaign():
    """300 random modes and their true risks."""
    poses, means, covs = cases(np.random.default_rng(11), 300)
    return poses, row(means, covs), truth(poses, means, covs, EGO.Q)


# ---- the claim


def test_declares_itself(backend):
    info = backend.info
    assert isinstance(info.kind, Kind)
    assert checkers()[info.name] is info
    for field in (info.needs, info.assumption, info.source, info.cost):
        assert isinstance(field, str)
        assert field
    assert backend.moments_needed >= 0
    assert ("Gaussian" in info.needs) == (backend.moments_needed == 0)


def test_claim_holds_on_random_modes(backend, campaign):
    poses, pred, true = campaign
    risk = backend(poses, pred, EGO)
    value = risk.value[:, 0]
    assert risk.checker == backend.info.name
    assert risk.kind is backend.info.kind
    assert value.shape == true.shape
    assert np.isfinite(value).all()
    assert ((value >= 0) & (value <= 1)).all()
    if risk.kind is Kind.EXACT:
        assert risk.error is not None
        assert (np.abs(value - true) <= risk.error[:, 0]).all()
        np.testing.assert_allclose(value, true, rtol=1e-9)
    elif risk.kind is Kind.UPPER_BOUND:
        assert (value >= true).all()
        assert (value < 1.0).any()
    else:
        assert risk.error is not None
        assert (np.abs(value - true) <= risk.error[:, 0]).mean() > 0.97
    if risk.error is not None:
        assert (risk.error >= 0).all()
    if risk.lower is not None:
        lower = risk.lower[:, 0]
        assert (lower >= 0).all()
        assert (lower <= true).all()
        assert (lower <= value).all()


def test_claim_holds_against_plain_sampling(backend):
    """No quadrature on either side: 2e5 samples of four modes."""
    rng = np.random.default_rng(5)
    for mean in ([0.4, 0.1], [1.5, -0.7], [0.0, 2.2], [-2.5, 1.0]):
        cov = covariance(*rng.uniform(0.3, 1.5, 2), rng.uniform(0, 3))
        risk = backend(np.zeros((1, 3)), single(mean, cov), DISC)
        share = sampled(mean, cov, 200_000, 3)
        sigma = np.sqrt(share * (1 - share) / 200_000)
        value = risk.value[0, 0]
        assert value >= share - 4 * sigma - (risk.error[0, 0] if is_sampling(backend) else 0)
        if risk.kind is Kind.EXACT:
            assert value <= share + 4 * sigma


# ---- geometry


@pytest.mark.parametrize("degrees", [0, 90, 37, -120])
def test_long_ego_is_long_along_its_heading(backend, degrees):
    heading = np.radians(degrees)
    ahead = np.array([np.cos(heading), np.sin(heading)])
    beside = np.array([-ahead[1], ahead[0]])
    pose = np.array([[3.0, -2.0, heading]])
    cov = covariance(0.1, 0.1)
    hit = backend(pose, single(pose[0, :2] + 4.0 * ahead, cov), LONG_EGO)
    miss = backend(pose, single(pose[0, :2] + 4.0 * beside, cov), LONG_EGO)
    assert hit.value[0, 0] > 0.99
    assert miss.value[0, 0] < 0.2


def test_asymmetric_ego_is_turned_the_right_way(backend):
    """A tilted ellipse tells left from right."""
    ego = EgoEllipsoid(spin(0.5) @ np.diag([1 / 25.0, 4.0]) @ spin(0.5).T)
    for heading in (0.0, 1.1, -2.0):
        for side, inside in ((0.5, True), (-0.5, False)):
            way = heading + side
            mean = 4.0 * np.array([np.cos(way), np.sin(way)])
            value = backend(np.array([[0, 0, heading]]), single(mean, covariance(0.05, 0.05)), ego).value[0, 0]
            assert value > 0.99 if inside else value < 0.2


def test_invariant_under_translation_and_rotation(backend):
    rng = np.random.default_rng(2)
    poses, means, covs = cases(rng, 20, sigma=(0.3, 3.0), ratio=3.0, reach=3.0)
    poses[:, :2] -= means  # coordinates of a few metres, so that moving them loses no digits before the call
    means = np.zeros_like(means)
    grid = 2.0**-20  # and multiples of a power of two, so that a translation by 1e5 is exact
    poses[:, :2] = np.round(poses[:, :2] / grid) * grid
    before = backend(poses, row(means, covs), EGO).value
    tolerance = exactness(backend)
    shift = np.array([1e5, -1e5])
    moved = backend(poses + [*shift, 0.0], row(means + shift, covs), EGO).value
    np.testing.assert_allclose(moved, before, **tolerance)
    r = spin(0.7)
    turned = np.column_stack([poses[:, :2] @ r.T, poses[:, 2] + 0.7])
    turned_covs = r @ covs @ r.T
    after = backend(turned, row(means @ r.T, 0.5 * (turned_covs + np.swapaxes(turned_covs, 1, 2))), EGO).value
    np.testing.assert_allclose(after, before, **tolerance)


def test_full_turns_of_the_heading_change_nothing(backend):
    rng = np.random.default_rng(8)
    poses, means, covs = cases(rng, 10, sigma=(0.3, 3.0))
    turned = poses + [0, 0, 2 * np.pi]
    a, b = backend(poses, row(means, covs), EGO), backend(turned, row(means, covs), EGO)
    np.testing.assert_allclose(a.value, b.value, **exactness(backend))


def test_mean_inside_is_no_error(backend):
    """A bound that does not apply is 1; one that applies left of the mean too may be smaller, not wrong."""
    poses, means, covs = np.zeros((3, 3)), [[0, 0], [0.5, 0.5], [-0.9, 0.1]], [np.eye(2) * 0.2] * 3
    value, true = backend(poses, row(means, covs), DISC).value[:, 0], truth(poses, means, covs, np.eye(2))
    if backend.info.kind is Kind.UPPER_BOUND:
        assert (value >= true).all()
        assert (value <= 1).all()
    else:
        np.testing.assert_allclose(value, true, atol=0.03)


# ---- degenerate covariances


def test_repeated_eigenvalues(backend):
    """Σ ∝ Q⁻¹, the disc with isotropic Σ, and directions an ulp away from both."""
    q = EGO.Q
    inverse = np.linalg.inv(q)
    inverse = 0.5 * (inverse + inverse.T)
    for factor in (0.01, 0.5, 1.0, 4.0):
        for heading in (0.0, 0.3, np.pi / 4):
            r = spin(heading)
            for mean in ([0.0, 0.0], [3.0, 0.0], [2.0, 2.0]):
                cov = r @ (factor * inverse) @ r.T
                cov = 0.5 * (cov + cov.T)
                self_check(backend, [0, 0, heading], r @ mean, cov, EGO)
    for nudge in (0.0, 1e-16, 1e-12):
        self_check(backend, [0, 0, 0], [1.2, 0.9], [[1.0, nudge], [nudge, 1.0]], DISC)


def self_check(backend, pose, mean, cov, ego):
    risk = backend(np.array([pose], dtype=float), single(mean, cov), ego)
    value, true = risk.value[0, 0], truth([pose], [mean], [cov], ego.Q)[0]
    if risk.kind is Kind.EXACT:
        assert value == pytest.approx(true, rel=1e-10, abs=1e-300)
    elif risk.kind is Kind.UPPER_BOUND:
        assert value >= true * (1 - 1e-12)
    else:
        assert abs(value - true) <= 1.5 * risk.error[0, 0]


@pytest.mark.parametrize(
    ("mean", "inside"), [([0.5, 0.2], True), ([-0.99, 0], True), ([1.2, 0], False), ([7, -9], False)]
)
@pytest.mark.parametrize("heading", [0.0, 0.4])
def test_point_mass(backend, mean, inside, heading, capfd):
    risk = backend(np.array([[0, 0, heading]]), single(mean, np.zeros((2, 2))), DISC)
    value = risk.value[0, 0]
    if inside:
        assert value == pytest.approx(1.0, abs=1e-9)
        if risk.kind is Kind.UPPER_BOUND:
            assert value == 1.0
    elif risk.kind is Kind.UPPER_BOUND:
        assert 0 <= value < 1
    else:
        assert value == 0.0
    if risk.kind is Kind.EXACT:
        assert np.isfinite(risk.error).all()
    assert capfd.readouterr().err == ""  # a compiled kernel that raises prints and returns 0


@pytest.mark.parametrize("angle", [0.0, np.pi / 2, np.pi / 6, 1.0])
@pytest.mark.parametrize("offset", [0.0, 0.6, 1.3])
def test_mass_on_a_line(backend, angle, offset, capfd):
    """One zero eigenvalue: a normal along a line that passes the centre at a distance."""
    along = np.array([np.cos(angle), np.sin(angle)])
    mean = 2.0 * along + offset * np.array([-along[1], along[0]])
    cov = np.outer(along, along)
    risk = backend(np.zeros((1, 3)), single(mean, cov), DISC)
    value = risk.value[0, 0]
    true = 0.0
    if offset < 1:
        from scipy.stats import norm  # noqa: PLC0415

        chord = np.sqrt(1 - offset**2)
        true = norm.cdf(2 + chord) - norm.cdf(2 - chord)
    assert 0 <= value <= 1
    if risk.kind is Kind.EXACT:
        assert value == pytest.approx(true, rel=1e-9, abs=1e-300)
        assert np.isfinite(risk.error).all()
    elif risk.kind is Kind.UPPER_BOUND:
        assert value >= true * (1 - 1e-12)
    else:
        assert abs(value - true) <= risk.error[0, 0]
    assert capfd.readouterr().err == ""


def test_never_negative_for_rank_one_covariances(backend):
    """The direction of no variance is that of a tangent: a variance of −1e-17 must not show."""
    rng = np.random.default_rng(4)
    angle = rng.integers(0, 12, 200) * np.pi / 6
    out = np.column_stack([np.cos(angle), np.sin(angle)])
    along = np.column_stack([-out[:, 1], out[:, 0]])
    covs = np.exp(rng.uniform(-4, 4, 200))[:, None, None] * along[:, :, None] * along[:, None, :]
    value = backend(np.zeros((200, 3)), row(rng.uniform(1.001, 3, 200)[:, None] * out, covs), DISC).value
    assert (value >= 0).all()


@pytest.mark.parametrize("sigma", [1e-150, 1e-40, 1e-12, 1e-6, 1e6, 1e8])
def test_extreme_sizes(backend, sigma, capfd):
    """No crash, no NaN, and still the claim."""
    for mean, near in (([0.5, 0.0], 1.0), ([1.5, 0.0], 0.0)):
        risk = backend(np.zeros((1, 3)), single(mean, covariance(sigma, sigma)), DISC)
        value = risk.value[0, 0]
        true = near if sigma < 1 else 0.5 / sigma**2
        assert 0 <= value <= 1
        if risk.kind is Kind.EXACT:
            assert value == pytest.approx(true, rel=1e-9)
        elif risk.kind is Kind.UPPER_BOUND:
            assert value >= true * (1 - 1e-9)
    assert capfd.readouterr().err == ""


def test_absurd_sizes_are_answered_or_refused(backend, capfd):
    for mean, sigma in (([1e200, 0.0], 1.0), ([0.5, 0.0], 1e100), ([1e100, 1e100], 1.0), ([1e308, 0.0], 1.0)):
        try:
            risk = backend(np.array([[-1e308, 0, 0]]), single(mean, np.eye(2) * sigma**2), DISC)
            assert 0 <= risk.value[0, 0] <= 1
            risk = backend(np.zeros((1, 3)), single(mean, np.eye(2) * sigma**2), DISC)
            assert 0 <= risk.value[0, 0] <= 1
        except InputError:
            continue
    assert capfd.readouterr().err == ""


# ---- batches and pieces


def test_batch_equals_loop_bit_for_bit(backend):
    rng = np.random.default_rng(6)
    pred = mixture(rng, steps=3, modes=2)
    poses = rng.uniform(-3, 3, (4, 3, 3))
    batch = backend(poses, pred, EGO)
    assert batch.value.shape == (4, 3, 2)
    for b in range(4):
        one = backend(poses[b], pred, EGO)
        for field in ("value", "error", "lower"):
            whole, part = getattr(batch, field), getattr(one, field)
            assert (whole is None) == (part is None)
            if part is not None:
                np.testing.assert_array_equal(whole[b], part)
        assert one.kind is batch.kind


def test_modes_and_steps_do_not_mix(backend):
    """Each entry of a (T, K) answer is what that mode alone gives at that pose."""
    rng = np.random.default_rng(9)
    pred = mixture(rng, steps=3, modes=2)
    poses = rng.uniform(-3, 3, (3, 3))
    whole = backend(poses, pred, EGO).value
    for t in range(3):
        for k in range(2):
            alone = backend(poses[t : t + 1], single(pred.means[t, k], pred.covariances[t, k]), EGO)
            assert alone.value[0, 0] == whole[t, k]


def test_empty_batch(backend):
    pred = mixture(np.random.default_rng(1), steps=2, modes=2)
    assert backend(np.zeros((0, 2, 3)), pred, EGO).value.shape == (0, 2, 2)


def test_pieces_are_summed_and_capped(backend):
    cover = EgoCover(4.0, 2.0, n=3)
    offsets, forms = cover.pieces(single([0, 0], np.eye(2)))
    rng = np.random.default_rng(3)
    poses, means, covs = cases(rng, 15, sigma=(0.3, 2.0))
    parts = []
    for offset, form in zip(offsets, forms, strict=True):
        shifted = poses.copy()
        for i, pose in enumerate(poses):
            shifted[i, :2] += spin(pose[2]) @ offset
        parts.append(backend(shifted, row(means, covs), EgoEllipsoid(form)).value)
    risk = backend(poses, row(means, covs), cover)
    np.testing.assert_allclose(risk.value, np.minimum(np.sum(parts, axis=0), 1.0), rtol=1e-4, atol=1e-6)
    middle = backend(np.zeros((1, 3)), single([0, 0], covariance(0.1, 0.1)), cover)
    assert middle.value[0, 0] == pytest.approx(1.0, abs=1e-3)
    assert middle.value[0, 0] <= 1.0
    expected = Kind.UPPER_BOUND if backend.info.kind is Kind.EXACT else backend.info.kind
    assert risk.kind is expected
    assert backend(poses, row(means, covs), EgoCover(4.0, 2.0, n=1)).kind is backend.info.kind


# ---- agents known by moments


def test_moments_of_a_gaussian_or_a_clear_refusal(backend):
    rng = np.random.default_rng(12)
    poses, means, covs = cases(rng, 30, sigma=(0.3, 2.0), ratio=3.0, reach=3.0)
    pred = row(means, covs, name="agent-7")
    if not takes_moments(backend):
        with pytest.raises(InputError, match=r"needs a Gaussian.*agent-7.*moments only"):
            backend(poses, pred.moments(4), EGO)
        return
    a = backend(poses, pred, EGO)
    for order in (backend.moments_needed, backend.moments_needed + 2):
        b = backend(poses, pred.moments(order), EGO)
        np.testing.assert_allclose(b.value, a.value, rtol=1e-6, atol=1e-6)
        assert b.kind is a.kind
    if backend.moments_needed > 2:
        short = backend.moments_needed - 1
        with pytest.raises(InputError, match=rf"order {backend.moments_needed}, but agent-7 carries {short}"):
            backend(poses, pred.moments(short), EGO)


def test_bounds_hold_for_point_masses(backend):
    """Two to five points: the moment matrices are singular and the bounds are sharp, so rounding shows."""
    if not takes_moments(backend):
        pytest.skip("needs a Gaussian")
    rng = np.random.default_rng(13)
    for _ in range(40):
        count = rng.integers(2, 6)
        points = rng.normal(size=(count, 2)) * np.exp(rng.uniform(-2, 2)) + rng.uniform(-2, 2, 2)
        weights = rng.dirichlet(np.ones(count))
        check_points(backend, points, weights)


def test_bounds_hold_for_point_masses_near_the_rim(backend):
    """All points within 0.1 of the rim: g is tiny against |y|², its moments are what cancellation leaves."""
    if not takes_moments(backend):
        pytest.skip("needs a Gaussian")
    rng = np.random.default_rng(14)
    for _ in range(60):
        count = rng.integers(2, 6)
        radius = 1 + rng.choice([-1, 1], count) * 10 ** rng.uniform(-8, -1, count)
        angle = rng.uniform(0, 2 * np.pi, count)
        points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
        check_points(backend, points, rng.dirichlet(np.ones(count)))


# found by search: rounding in the moments of g put the bound 0.1 below the truth, or the lower one above it
NEAR_RIM = [
    (
        [[-0.041471762678399096, 0.996330143477229], [0.937213474963438, -0.3487561909410021],
         [0.09118698582614451, -0.9959319904589182], [-0.6151599922529205, -0.7512917990124465]],
        [0.04904594509653261, 0.1852833787939699, 0.3632539269580452, 0.4024167491514522],
    ),
    (
        [[0.5886086346444774, 0.8018221934980383], [0.4718916418494485, -0.8816586032008668],
         [0.8304801264297086, -0.5570481634102314]],
        [0.41538848417104524, 0.37474394390841204, 0.20986757192054276],
    ),
    (
        [[0.9693012261134548, -0.24592767128884507], [-0.8306632577638687, 0.5566060861924753],
         [0.014656497143209752, 0.9996822777028088]],
        [0.2221979727806419, 0.3037685255580645, 0.47403350166129354],
    ),
    (
        [[-0.9443734310185199, -0.3288749529583453], [-0.8791777941740524, 0.47650013758016446],
         [-0.7846926129335682, 0.6190011253136105], [0.9651454995172599, 0.25995241123633117]],
        [0.3302753809289881, 0.3317712294273692, 0.22968686520611534, 0.10826652443752742],
    ),
]  # fmt: skip


@pytest.mark.parametrize("case", range(len(NEAR_RIM)))
def test_bounds_survive_cancelled_moments(backend, case):
    if not takes_moments(backend):
        pytest.skip("needs a Gaussian")
    points, weights = NEAR_RIM[case]
    check_points(backend, points, np.array(weights))


def check_points(backend, points, weights):
    pred = discrete(points, weights, max(backend.moments_needed, 2))
    risk = backend(np.zeros((1, 3)), pred, DISC)
    share = weights[(np.asarray(points) ** 2).sum(axis=1) <= 1].sum()
    assert 0 <= risk.value[0, 0] <= 1
    assert risk.value[0, 0] >= share - 1e-9
    if risk.lower is not None:
        assert 0 <= risk.lower[0, 0] <= share + 1e-9


def test_impossible_moments_never_give_a_small_risk(backend):
    """E[x⁴] < E[x²]² belongs to no distribution: refuse it, or answer 1."""
    if backend.moments_needed < 4:
        pytest.skip("reads no fourth moment")
    for fourth in (-3.0, 0.5):
        good = single([4.0, 0.0], np.eye(2)).moments(max(backend.moments_needed, 4))
        bad = np.array(good.central_moments)
        bad[..., 4, 0] = fourth
        try:
            pred = MomentPrediction(good.times, good.weights, good.means, bad)
            value = backend(np.zeros((1, 3)), pred, DISC).value[0, 0]
        except InputError:
            continue
        assert value == 1.0


# ---- refusals


def test_unknown_name_lists_the_valid_ones():
    with pytest.raises(InputError, match="exact") as error:
        checker("exakt")
    for name in checkers():
        assert name in str(error.value)


def test_unknown_option_lists_the_valid_ones(backend):
    from dataclasses import fields  # noqa: PLC0415

    with pytest.raises(InputError, match=f"{backend.info.name}: unknown option 'colour'") as error:
        checker(backend.info.name, colour="red")
    known = [f.name for f in fields(backend)]
    assert all(name in str(error.value) for name in known)
    if not known:
        assert "none" in str(error.value)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("sos", {"order": 3}),
        ("sos", {"order": 0}),
        ("sos", {"order": 14}),
        ("sos", {"order": 4.0}),
        ("sos", {"order": "4"}),
        ("sos", {"order": True}),
        ("sos", {"solver": "mosek"}),
        ("sos", {"solver": None}),
        ("halfspace", {"n_h": 2}),
        ("halfspace", {"n_h": 12.0}),
        ("halfspace", {"n_h": -1}),
        ("halfspace", {"n_h": True}),
        ("monte-carlo", {"samples": 0}),
        ("monte-carlo", {"samples": 1e4}),
        ("monte-carlo", {"seed": -1}),
        ("monte-carlo", {"confidence": 1.0}),
        ("monte-carlo", {"confidence": 0.0}),
        ("monte-carlo", {"confidence": float("nan")}),
    ],
)
def test_bad_option_values(name, options):
    (field,) = options
    with pytest.raises(InputError, match=rf"{name}: {field}: expected .* got"):
        checker(name, **options)


def test_options_are_frozen(backend):
    for field in backend.__dataclass_fields__:
        with pytest.raises(AttributeError):
            setattr(backend, field, None)


@pytest.mark.parametrize("shape", [(3,), (2, 2), (3, 3), (1, 1, 2, 3), (4, 3, 3), (2, 4)])
def test_poses_of_the_wrong_shape(backend, shape):
    pred = mixture(np.random.default_rng(0), steps=2, modes=1)
    with pytest.raises(InputError, match=r"poses: expected shape \(2, 3\).*got " + re.escape(str(shape))):
        backend(np.zeros(shape), pred, EGO)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_poses_that_are_not_finite(backend, bad):
    pred = mixture(np.random.default_rng(0), steps=2, modes=1)
    poses = np.zeros((2, 3))
    poses[1, 2] = bad
    with pytest.raises(InputError, match=r"poses\[1, 2\]"):
        backend(poses, pred, EGO)


def test_poses_that_are_not_numbers(backend):
    pred = mixture(np.random.default_rng(0), steps=2, modes=1)
    for poses in ([[0, 0, 0], [0, 0]], "here", [["a", "b", "c"]] * 2, None):
        with pytest.raises(InputError, match="poses"):
            backend(poses, pred, EGO)


def test_inputs_are_left_alone(backend):
    rng = np.random.default_rng(1)
    pred = mixture(rng, steps=2, modes=2)
    poses = rng.uniform(-1, 1, (2, 3))
    copy = poses.copy()
    backend(poses, pred, EGO)
    np.testing.assert_array_equal(poses, copy)


def test_same_answer_twice(backend):
    rng = np.random.default_rng(1)
    pred, poses = mixture(rng, steps=2, modes=2), rng.uniform(-1, 1, (2, 3))
    np.testing.assert_array_equal(backend(poses, pred, EGO).value, backend(poses, pred, EGO).value)


def test_weights_do_not_enter_a_mode_s_risk(backend):
    """The released code applied them twice."""
    rng = np.random.default_rng(1)
    pred, poses = mixture(rng, steps=2, modes=2), rng.uniform(-1, 1, (2, 3))
    other = GaussianMixturePrediction(pred.times, [0.01, 0.99], pred.means, pred.covariances)
    np.testing.assert_array_equal(backend(poses, pred, EGO).value, backend(poses, other, EGO).value)
