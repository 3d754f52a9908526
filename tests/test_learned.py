"""Metrics, recalibration, model files, and trained networks as predictors. No data, no long training."""

# ruff: noqa: E402  imports wait for the question whether torch is there

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import multivariate_normal

torch = pytest.importorskip("torch", reason="needs the extra predictor")

import riskplan as rp
from checkers import GaussianMixturePrediction, InputError
from checkers.prediction_batch import gaussian_mixtures
from predictor.baselines import build
from predictor.calibration import Recalibration
from predictor.fit import Parts, fit
from predictor.forecasts import Forecasts, examples_of
from predictor.kinematic import COURSES, Kinematic
from predictor.learned import LearnedPredictor
from predictor.metrics import coverage, joint_nll, marginal_nll, min_ade, min_fde, region_mass
from predictor.model_files import Model, load_model, save_model
from predictor.network import NetworkConfig
from predictor.reliability import Reliability, hits, stated_risk, thrown, without_factors
from predictor.train import TrainSettings
from predictor.windows import Windows

POSITIONS = NetworkConfig(head="persistent", weights="persistent", anchor="velocity", lanes=True, ego_future=True)
CONTROLS = NetworkConfig(target="controls", weights="persistent")
TIMES = POSITIONS.times


def model_of(config: NetworkConfig, seed: int = 0, recalibration: Recalibration | None = None) -> Model:
    torch.manual_seed(seed)
    return Model(build(config).eval(), config, recalibration, {"data": {"name": "none"}})


def car(x: float = 0.0, y: float = 0.0, angle: float = 0.0, speed: float = 10.0, name: str = "car") -> rp.Track:
    times = np.arange(25) * 0.1
    way = speed * (times - times[-1])
    positions = np.column_stack([x + way * np.cos(angle), y + way * np.sin(angle)])
    return rp.Track(name, times, positions, np.full(25, angle), np.full(25, speed), 4.5, 1.8)


def forecasts_of(means: np.ndarray, covariances: np.ndarray, weights: np.ndarray, **more: object) -> Forecasts:
    return Forecasts(0.1 * np.arange(1, means.shape[1] + 1), weights, means, covariances, **more)  # type: ignore[arg-type]


def gaussians(rng: np.random.Generator, count: int, spread: float = 1.0) -> tuple[Forecasts, np.ndarray]:
    """Two modes per step, and truths drawn from them with `spread` times the standard deviation."""
    means = rng.normal(0.0, 3.0, (count, 4, 2, 2))
    roots = np.tril(rng.normal(size=(count, 4, 2, 2, 2)), -1) + rng.uniform(0.5, 2.0, (count, 4, 2, 1, 2)) * np.eye(2)
    weights = np.broadcast_to(np.array([0.3, 0.7]), (count, 4, 2))
    mode = (rng.random((count, 4)) > 0.3).astype(int)
    pick = np.arange(count)[:, None], np.arange(4), mode
    truth = means[pick] + spread * np.einsum("ntij,ntj->nti", roots[pick], rng.normal(size=(count, 4, 2)))
    return forecasts_of(means, roots @ np.swapaxes(roots, -1, -2), weights, modes="per_step"), truth


class TestMetrics:
    def test_distances_are_the_nearest_mode_s(self) -> None:
        means = np.zeros((1, 2, 2, 2))
        means[0, :, 0, 0], means[0, :, 1, 1] = [3.0, 3.0], [0.0, 4.0]
        stated = forecasts_of(means, np.tile(np.eye(2), (1, 2, 2, 1, 1)), np.full((1, 2, 2), 0.5))
        assert min_ade(stated, np.zeros((1, 2, 2))) == [2.0]
        assert min_fde(stated, np.zeros((1, 2, 2))) == [3.0]

    def test_likelihoods_are_scipy_s_in_metres(self) -> None:
        rng = np.random.default_rng(0)
        stated, truth = gaussians(rng, 3)
        stated = replace(stated, modes="persistent")
        for n in range(3):
            step = [
                [
                    multivariate_normal(stated.means[n, t, k], stated.covariances[n, t, k]).logpdf(truth[n, t])
                    for k in (0, 1)
                ]
                for t in range(4)
            ]
            each = np.log(np.exp(step) @ [0.3, 0.7])
            whole = np.log(np.exp(np.sum(step, axis=0)) @ [0.3, 0.7])
            assert marginal_nll(stated, truth)[n] == pytest.approx(-each.mean(), rel=1e-9)
            assert joint_nll(stated, truth)[n] == pytest.approx(-whole / 4, rel=1e-9)

    def test_of_one_gaussian_the_region_s_mass_is_chi_squared(self) -> None:
        rng = np.random.default_rng(1)
        stated, truth = gaussians(rng, 50)
        one = replace(stated, means=stated.means[:, :, :1], covariances=stated.covariances[:, :, :1])
        one = replace(one, weights=np.ones((50, 4, 1)))
        gap = truth - one.means[:, :, 0]
        squared = np.einsum("nti,ntij,ntj->nt", gap, np.linalg.inv(one.covariances[:, :, 0]), gap)
        assert np.abs(region_mass(one, truth, np.arange(4)) - (1 - np.exp(-squared / 2))).max() < 0.003

    def test_truth_drawn_from_the_prediction_lies_within_as_often_as_stated(self) -> None:
        rng = np.random.default_rng(2)
        stated, truth = gaussians(rng, 3000)
        shares = coverage(region_mass(stated, truth, [0, 3]))
        assert np.abs(shares - np.array([[0.5], [0.9], [0.99]])).max() < 0.03


class TestRecalibration:
    def test_finds_the_factor_that_was_missing(self) -> None:
        rng = np.random.default_rng(3)
        stated, truth = gaussians(rng, 3000, spread=1.5)
        one = replace(stated, means=stated.means[:, :, :1], covariances=stated.covariances[:, :, :1])
        one = replace(one, weights=np.ones((3000, 4, 1)))
        truth = one.means[:, :, 0] + 1.5 * np.einsum(
            "ntij,ntj->nti", np.linalg.cholesky(one.covariances[:, :, 0]), rng.normal(size=(3000, 4, 2))
        )
        found = Recalibration.fitted(one, truth)
        assert found.variances == pytest.approx(np.full(4, 2.25), rel=0.1)
        inside = coverage(region_mass(found.apply(one), truth, np.arange(4)))
        assert np.abs(inside - np.array([[0.5], [0.9], [0.99]])).max() < 0.03

    def test_holds_between_its_knots_too(self) -> None:
        """A floor that is too wide at the first steps only, where the factors change most."""
        rng = np.random.default_rng(6)
        true = np.broadcast_to(0.02 * np.arange(1, 31)[None, :, None], (4000, 30, 1)) * np.ones(2)
        stated = (true**2 + 0.1**2)[:, :, None, :, None] * np.eye(2)
        one = forecasts_of(np.zeros((4000, 30, 1, 2)), stated, np.ones((4000, 30, 1)))
        found = Recalibration.fitted(one, true * rng.normal(size=(4000, 30, 2)))
        inside = coverage(region_mass(found.apply(one), true * rng.normal(size=(4000, 30, 2)), np.arange(30)))[1]
        assert np.abs(inside - 0.9).max() < 0.03

    def test_keeps_correlations_over_time(self) -> None:
        factors = np.random.default_rng(4).normal(size=(1, 4, 1, 2, 2))
        own = factors @ np.swapaxes(factors, -1, -2) + np.eye(2)
        stated = forecasts_of(np.zeros((1, 4, 1, 2)), own, np.ones((1, 4, 1)), factors=factors)
        scaled = Recalibration(np.array([0.1, 0.4]), np.array([1.0, 4.0])).apply(stated)
        across = [np.einsum("tkir,skjr->tksij", f.factors[0], f.factors[0]) for f in (stated, scaled)]
        sizes = [np.sqrt(np.einsum("tkii->tki", f.covariances[0])) for f in (stated, scaled)]
        correlations = [
            a / (s[:, :, None, :, None] * s[:, 0][None, None, :, None, :]) for a, s in zip(across, sizes, strict=True)
        ]
        np.testing.assert_allclose(correlations[1], correlations[0])
        np.testing.assert_allclose(scaled.covariances[0, 3], 4 * own[0, 3])

    def test_bad_factors_are_named(self) -> None:
        with pytest.raises(InputError, match="variances: expected factors > 0"):
            Recalibration(np.array([1.0]), np.array([0.0]))
        assert Recalibration.from_dict({"times": [1.0, 2.0], "variances": [1.0, 4.0]}).at(np.array([1.5])) == [2.0]


class TestModelFiles:
    def test_come_back_as_they_were(self, tmp_path: Path) -> None:
        model = model_of(POSITIONS, recalibration=Recalibration(np.array([0.1, 3.0]), np.array([1.0, 2.0])))
        save_model(tmp_path / "m.safetensors", model)
        again = load_model(tmp_path / "m.safetensors")
        assert again.config == POSITIONS
        assert again.recalibration is not None and again.recalibration.variances.tolist() == [1.0, 2.0]
        assert again.card["data"] == {"name": "none"}
        for name, value in model.network.state_dict().items():
            assert torch.equal(again.network.state_dict()[name], value)

    def test_what_is_wrong_is_said_on_one_line(self, tmp_path: Path) -> None:
        path, card = tmp_path / "m.safetensors", tmp_path / "m.json"
        with pytest.raises(InputError, match=r"m\.json: no such file"):
            load_model(path)
        save_model(path, model_of(CONTROLS))
        written = json.loads(card.read_text())
        card.write_text(json.dumps({**written, "network": {**written["network"], "hidden": 16}}))
        with pytest.raises(InputError, match=r"decoder\.bias_hh_l0: expected \(64,\) float32, got \(128,\) float32"):
            load_model(path)
        card.write_text(json.dumps({**written, "network": {**written["network"], "lanes": True}}))
        with pytest.raises(InputError, match=r"expected the weights 'lanes\.0\.weight', which are missing"):
            load_model(path)
        card.write_text(json.dumps({**written, "network": {"depth": 1}}))
        with pytest.raises(InputError, match="got 'depth'"):
            load_model(path)
        card.write_text(json.dumps(written))
        path.write_bytes(path.read_bytes()[:-4] + b"\0\0\0\1")
        with pytest.raises(InputError, match="is not the file its card m.json describes"):
            load_model(path)
        card.write_text("[1]")
        with pytest.raises(InputError, match=r"expected a model card of format 'riskplan-network-1', got 'list'"):
            load_model(path)

    def test_infinite_weights_and_pickles_are_refused(self, tmp_path: Path) -> None:
        path, card = tmp_path / "m.safetensors", tmp_path / "m.json"
        model = model_of(CONTROLS)
        with torch.no_grad():
            model.network.head.out.bias[0] = float("nan")
        save_model(path, model)
        with pytest.raises(InputError, match=r"head\.out\.bias: expected finite numbers"):
            load_model(path)
        torch.save({"a": torch.zeros(1)}, path)
        import hashlib

        written = json.loads(card.read_text())
        card.write_text(json.dumps({**written, "weights_sha256": hashlib.sha256(path.read_bytes()).hexdigest()}))
        with pytest.raises(InputError, match="not a safetensors file"):
            load_model(path)


class TestPredictor:
    def test_predictions_carry_everything_and_follow_the_world(self) -> None:
        """Rotating and moving the world rotates and moves what is predicted, lanes and ego included."""
        predictor = LearnedPredictor(model_of(POSITIONS, 1, Recalibration(np.array([1.0]), np.array([2.0]))))
        rng = np.random.default_rng(5)
        tracks = [car(3.0 * i, i, 0.3 * i, 4.0 + 3 * i, name=str(i)) for i in range(4)]
        lanes, ego = rng.normal(0, 20, (30, 2)), rng.normal(0, 20, (30, 2))
        first = predictor.predict(tracks, lanes=lanes, ego_future=ego)
        angle, shift = 2.0, np.array([1e5, -1e5])
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        moved = [
            replace(t, positions=t.positions @ turn.T + shift, headings=t.headings + angle)  # type: ignore[type-var]
            for t in tracks
        ]
        second = predictor.predict(moved, lanes=lanes @ turn.T + shift, ego_future=ego @ turn.T + shift)
        for a, b in zip(first, second, strict=True):
            np.testing.assert_allclose(b.means, a.means @ turn.T + shift, atol=1e-3)
            np.testing.assert_allclose(b.covariances, turn @ a.covariances @ turn.T, rtol=1e-3, atol=1e-4)
            np.testing.assert_allclose(b.factors, turn @ a.factors, rtol=1e-3, atol=1e-3)
            np.testing.assert_allclose(np.cos(b.headings - a.headings - angle), 1.0, atol=1e-4)
            assert (a.name, a.length, a.width, a.modes) == (b.name, 4.5, 1.8, "persistent")
        assert not np.allclose(first[0].means, predictor.predict(tracks)[0].means)

    def test_order_and_company_do_not_matter(self) -> None:
        predictor = LearnedPredictor(model_of(POSITIONS))
        tracks = [car(speed=s, name=str(s)) for s in (2.0, 8.0, 20.0)]
        together, alone = predictor.predict(tracks), predictor.predict(tracks[2:])
        np.testing.assert_allclose(together[2].means, alone[0].means, atol=1e-4)
        assert predictor.predict([]) == ()

    def test_recalibration_scales_variances_only(self) -> None:
        model = model_of(POSITIONS, 0, Recalibration(np.array([1.0]), np.array([4.0])))
        scaled, raw = (LearnedPredictor(model, r).predict([car()])[0] for r in (True, False))
        np.testing.assert_allclose(scaled.covariances, 4.0 * raw.covariances)
        np.testing.assert_allclose(scaled.factors, 2.0 * raw.factors)
        np.testing.assert_array_equal(scaled.means, raw.means)

    def test_other_times_start_at_the_present(self) -> None:
        predictor = LearnedPredictor(model_of(POSITIONS))
        own = predictor.predict([car()])[0]
        other = predictor.predict([car()], times=[0.0, 0.1, 0.25, 3.0])[0]
        np.testing.assert_allclose(other.means[0], np.zeros((3, 2)), atol=1e-12)
        np.testing.assert_allclose(other.means[[1, 3]], own.means[[0, -1]])
        np.testing.assert_allclose(other.means[2], own.at([0.25]).means[0])
        np.testing.assert_allclose(other.covariances[2], own.at([0.25]).covariances[0])
        with pytest.raises(InputError, match=r"times\[1\]: the network covers 0 to 3 s, got 3.5"):
            predictor.predict([car()], times=[1.0, 3.5])

    def test_a_standing_car_is_seen_as_it_points(self) -> None:
        predictor = LearnedPredictor(model_of(POSITIONS))
        east, north = (predictor.predict([car(speed=0.0, angle=a)])[0] for a in (0.0, np.pi / 2))
        turn = np.array([[0.0, -1.0], [1.0, 0.0]])
        np.testing.assert_allclose(north.means, east.means @ turn.T, atol=1e-4)
        assert np.isfinite(east.headings).all()

    def test_controls_drive_a_dubins_car_from_the_last_state(self) -> None:
        predictor = LearnedPredictor(model_of(CONTROLS, 2))
        agent = predictor.predict([car(5.0, 6.0, 0.5, 7.0)])[0]
        assert isinstance(agent, rp.ControlPrediction)
        moments = agent.moments(4)
        np.testing.assert_allclose(moments.means[0], np.tile([5.0, 6.0], (3, 1)), atol=1e-9)
        np.testing.assert_allclose(moments.means[1], np.tile([5 + 0.7 * np.cos(0.5), 6 + 0.7 * np.sin(0.5)], (3, 1)))
        drawn = agent.sample(4000, np.random.default_rng(0))[:, -1]
        mean = agent.weights @ moments.means[-1]
        assert np.abs(drawn.mean(axis=0) - mean).max() < 4 * drawn.std() / np.sqrt(4000)
        assert len(predictor.predict([car()], times=[0.0, 1.0])[0].times) == 2

    @pytest.mark.parametrize(
        ("track", "message"),
        [
            (car().window(0.0, 1.0), "track 'car': expected a past of 1.9 s, got 1 s"),
            ("car", r"tracks\[0\]: expected a Track, got str"),
        ],
    )
    def test_tracks_that_cannot_be_read_are_named(self, track: object, message: str) -> None:
        with pytest.raises(InputError, match=message):
            LearnedPredictor(model_of(POSITIONS)).predict([track])  # type: ignore[list-item]

    def test_gaps_and_wrong_rates_are_named(self) -> None:
        predictor, whole = LearnedPredictor(model_of(POSITIONS)), car()
        kept = np.r_[:8, 14:25]
        gap = rp.Track(
            "g", whole.times[kept], whole.positions[kept], whole.headings[kept], whole.speeds[kept], 4.5, 1.8
        )
        with pytest.raises(InputError, match="track 'g': expected no gap"):
            predictor.predict([gap])
        slow = whole.at(np.arange(5) * 0.5)
        with pytest.raises(InputError, match=r"at least every 0\.1 s, got one every 0\.5 s"):
            predictor.predict([slow])

    def test_a_batch_is_what_single_constructions_are(self) -> None:
        agents = LearnedPredictor(model_of(POSITIONS)).predict([car(), car(speed=3.0, name="slow")])
        for agent in agents:
            single = GaussianMixturePrediction(
                agent.times,
                agent.weights,
                agent.means,
                agent.covariances,
                name=agent.name,
                length=agent.length,
                width=agent.width,
                headings=agent.headings,
                factors=agent.factors,
            )
            for field in ("times", "weights", "means", "covariances", "headings", "factors"):
                np.testing.assert_array_equal(getattr(agent, field), getattr(single, field))
                assert not getattr(agent, field).flags.writeable
            assert agent.moments(4).means.shape == (30, 3, 2)

    def test_a_bad_batch_is_refused_as_single_ones_are(self) -> None:
        good = {
            "times": [1.0],
            "weights": np.ones((2, 1)),
            "means": np.zeros((2, 1, 1, 2)),
            "covariances": np.tile(np.eye(2), (2, 1, 1, 1, 1)),
            "names": ["a", "b"],
            "sizes": np.ones((2, 2)),
            "headings": np.zeros((2, 1, 1)),
        }
        assert len(gaussian_mixtures(**good)) == 2
        bad = good["covariances"].copy()  # type: ignore[attr-defined]
        bad[1, 0, 0] = [[1.0, 2.0], [2.0, 1.0]]
        for change, message in (
            ({"covariances": bad}, r"covariances\[1, 0, 0\]: expected a positive semi-definite"),
            ({"weights": np.array([[1.0], [0.5]])}, r"weights\[1\]: expected weights >= 0 that sum to 1"),
            ({"factors": np.full((2, 1, 1, 2, 1), 2.0)}, r"factors\[0, 0, 0\]"),
            ({"names": ["a"]}, "names: expected 2 texts"),
            ({"sizes": np.zeros((2, 2))}, r"sizes\[0\]: expected lengths"),
            ({"modes": "both"}, "modes: expected one of"),
        ):
            with pytest.raises(InputError, match=message):
                gaussian_mixtures(**{**good, **change})  # type: ignore[arg-type]


def traffic(count: int = 80, scenes: int = 16) -> Windows:
    """Cars that go straight at random speeds, and one in three that brakes."""
    rng = np.random.default_rng(7)
    speed, angle = rng.uniform(5, 15, count), rng.uniform(-np.pi, np.pi, count)
    brake = np.where(np.arange(count) % 3 == 0, -2.0, 0.0)[:, None]
    past, ahead = 0.1 * np.arange(-19, 1), 0.1 * np.arange(1, 31)
    way = [speed[:, None] * past, speed[:, None] * ahead + 0.5 * brake * ahead**2]
    heading = np.stack([np.cos(angle), np.sin(angle)], axis=-1)[:, None]
    nothing = np.full((count, 1, 2), np.nan)
    return Windows(
        past=way[0][..., None] * heading,
        headings=angle,
        speeds=speed,
        future=way[1][..., None] * heading,
        lanes=nothing,
        lane_headings=nothing[..., 0],
        ego_future=np.full((count, 30, 2), np.nan),
        controls=np.stack([np.broadcast_to(brake, (count, 30)), np.zeros((count, 30))], axis=-1),
        scenes=np.arange(count) % scenes,
        names=tuple(f"place {i % 2}-{i}" for i in range(scenes)),
        sizes=np.tile([4.5, 1.8], (count, 1)),
    )


class TestFit:
    @pytest.mark.parametrize("config", [NetworkConfig(), NetworkConfig(normalised=False), POSITIONS, CONTROLS])
    def test_trains_judges_and_writes_a_card(self, config: NetworkConfig, tmp_path: Path) -> None:
        parts = Parts.of(traffic(), 0, config.target == "controls")
        scenes = [set(p.scenes.tolist()) for p in (parts.training, parts.validation, parts.test)]
        assert not scenes[0] & scenes[1] and not scenes[0] & scenes[2] and not scenes[1] & scenes[2]
        assert all({i % 2 for i in part} == {0, 1} for part in scenes)  # every place is in every part
        model = fit(config, parts, TrainSettings(epochs=2, batch=16), {"name": "made up"})
        save_model(tmp_path / "m.safetensors", model)
        card = load_model(tmp_path / "m.safetensors").card
        assert card["data"]["name"] == "made up" and card["data"]["training"] == len(parts.training)
        assert card["training"]["epochs"] == 2
        before, after = (card["metrics"][key] for key in ("test", "test_recalibrated"))
        assert before["min_ade"] == pytest.approx(after["min_ade"], abs=0.5 if config.target == "controls" else 1e-9)
        agents = LearnedPredictor(model).predict([car(), car(20.0, name="other")])
        assert np.isfinite(agents[1].means).all()

    def test_truth_in_a_network_s_units_is_the_world_s(self) -> None:
        samples = traffic(9)
        examples, frames = examples_of(samples, NetworkConfig())
        np.testing.assert_allclose(frames.to_world(examples.truth.double().numpy()), samples.future, atol=1e-4)
        assert examples.truth[..., 1].abs().max() < 1e-6  # straight on is along x
        controls, _ = examples_of(samples, CONTROLS)
        assert controls.truth[0, 0].tolist() == pytest.approx([-2.0, 0.0])  # −2 m/s² · 0.1 s in units of 0.1 m/s

    def test_physics_is_exact_on_its_own_motion(self) -> None:
        samples = traffic()
        steady = samples.of(np.arange(80) % 3 != 0)
        for course in COURSES.values():
            model = Kinematic.fitted(course, steady.past, steady.headings, steady.future, 0.1)
            assert min_ade(model.predict(steady.past, steady.headings), steady.future).max() < 1e-9

    def test_other_windows_are_refused(self) -> None:
        with pytest.raises(InputError, match="past: the network is of 15 steps, the windows of 20"):
            examples_of(traffic(9), NetworkConfig(observed=15))
        with pytest.raises(InputError, match="none of 9 windows has complete controls"):
            Parts.of(replace(traffic(9), controls=np.full((9, 30, 2), np.nan)), 0, controls=True)


class TestWithoutTorch:
    def test_the_package_says_what_to_install(self) -> None:
        program = (
            "import sys; sys.modules['torch'] = None\n"
            "import riskplan as rp\n"
            "from checkers import InputError\n"
            "try:\n    rp.LearnedPredictor\nexcept InputError as error:\n    print(error)\n"
        )
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)
        assert done.stdout == "LearnedPredictor needs torch: pip install '.[predictor]' in the checkout\n", done.stderr

    def test_importing_riskplan_does_not_import_torch(self) -> None:
        program = "import riskplan, predictor, sys; print('torch' in sys.modules)"
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)
        assert done.stdout == "False\n", done.stderr


class TestReliability:
    def test_stated_risk_of_persistent_errors_is_path_risk_s(self) -> None:
        """Against the library's own trajectory risk, which is computed by other means."""
        agent = LearnedPredictor(model_of(POSITIONS, 3)).predict([car()], times=np.arange(1, 31) * 0.1)[0]
        stated = Forecasts(
            agent.times, agent.step_weights[None], agent.means[None], agent.covariances[None], agent.factors[None]
        )
        ego = thrown(stated, np.random.default_rng(1), spread=2.0)
        poses = np.concatenate([ego[0], np.zeros((30, 1))], axis=1)
        disc = rp.EgoEllipsoid(np.eye(2) / 2.5**2)
        for forecasts, dependence in ((stated, "persistent"), (without_factors(stated), "independent")):
            pred = agent if dependence == "persistent" else replace(agent, factors=None)
            exact = float(rp.path_risk(poses, [pred], disc, dependence, tolerance=1e-3).total)
            drawn = float(stated_risk(forecasts, ego, np.random.default_rng(2), samples=20_000)[0])
            assert 0.01 < exact < 0.99
            assert drawn == pytest.approx(exact, abs=0.02)

    def test_bins_count_and_bound(self) -> None:
        found = Reliability.of(np.array([0.005, 0.5, 0.5, 1.0]), np.array([False, True, False, True]))
        assert found.count.tolist() == [1, 2, 1]
        assert found.observed.tolist() == [0.0, 0.5, 1.0]
        assert found.low[0] == 0.0 and found.high[2] == 1.0 and found.low[1] < 0.5 < found.high[1]
        assert (found.expected, found.hits) == (pytest.approx(2.005), 2)

    def test_a_true_prediction_is_reliable(self) -> None:
        rng = np.random.default_rng(5)
        stated, truth = gaussians(rng, 2000)
        ego = thrown(stated, rng, spread=3.0)
        found = Reliability.of(stated_risk(stated, ego, rng, samples=200), hits(truth, ego))
        assert abs(found.expected - found.hits) < 4 * np.sqrt(found.expected)
