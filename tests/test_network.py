"""The network, its likelihoods and its training, on tiny data. The oracle is the dense multivariate normal of SciPy."""

from __future__ import annotations

import csv
import os
import signal
import subprocess
import sys
import textwrap
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

torch = pytest.importorskip("torch", reason="needs the extra predictor")

from checkers import InputError  # noqa: E402
from predictor.baselines import build  # noqa: E402
from predictor.loss import (  # noqa: E402
    best_mode_error,
    covariances,
    joint_log_likelihood,
    loss,
    marginal_log_likelihood,
    nll,
)
from predictor.network import Head, Inputs, Mixture, NetworkConfig, extrapolated, parameters, velocities  # noqa: E402
from predictor.train import Examples, TrainSettings, evaluate, mirrored, train  # noqa: E402


@pytest.fixture(autouse=True)
def _one_thread():
    """Small tensors: threads only wait for each other."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def log_of(folder: Path) -> list[dict[str, str]]:
    with (folder / "log.csv").open(newline="") as file:
        return [{**row, "seconds": ""} for row in csv.DictReader(file)]


SMALL = NetworkConfig(observed=6, predicted=5, hidden=8)
PERSISTENT = replace(SMALL, head="persistent", weights="persistent")
QUICK = TrainSettings(epochs=4, batch=16, rate=1e-2)


def random_mixture(seed: int, steps: int = 4, modes: int = 3, rank: int = 2, per_step: bool = False) -> Mixture:
    rng = torch.Generator().manual_seed(seed)
    draw = lambda *shape: torch.randn(*shape, generator=rng, dtype=torch.float64)  # noqa: E731
    n = 2
    weights = draw(n, steps if per_step else 1, modes).log_softmax(-1).expand(n, steps, modes)
    roots = torch.tril(draw(n, steps, modes, 2, 2))
    roots = torch.tril(roots, -1) + torch.diag_embed(roots.diagonal(dim1=-2, dim2=-1).abs() + 0.1)
    return Mixture(weights, draw(n, steps, modes, 2), roots, draw(n, steps, modes, 2, rank) if rank else None)


@pytest.fixture(autouse=True)
def _seeded() -> None:
    torch.manual_seed(0)


def random_examples(config: NetworkConfig, count: int, seed: int = 0) -> Examples:
    """Cars of random speed and turn in their own frame."""
    rng = np.random.default_rng(seed)
    speed, turn = rng.uniform(0.3, 1.5, count), rng.uniform(-0.1, 0.1, count)
    age = np.arange(1 - config.observed, config.predicted + 1) * config.dt
    angle = turn[:, None] * age
    points = np.stack([speed[:, None] * age * np.cos(angle), speed[:, None] * age * np.sin(angle)], axis=-1)
    tensor = torch.from_numpy(points).float()
    lanes = torch.full((count, 7, 2), float("nan"))
    lanes[:, :4] = torch.from_numpy(rng.normal(size=(count, 4, 2))).float()
    future = tensor[:, config.observed :]
    return Examples(Inputs(tensor[:, : config.observed], lanes, future.roll(1, 0)), future)


class TestLikelihood:
    @pytest.mark.parametrize("rank", [0, 1, 2, 3])
    def test_joint_is_the_dense_normal_s(self, rank: int) -> None:
        mixture = random_mixture(rank, rank=rank)
        truth = torch.randn(2, 4, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(9))
        got = joint_log_likelihood(mixture, truth)
        for n in range(2):
            terms = []
            for k in range(3):
                full = np.zeros((8, 8))
                for t in range(4):
                    root = mixture.roots[n, t, k].numpy()
                    full[2 * t : 2 * t + 2, 2 * t : 2 * t + 2] = root @ root.T
                if mixture.factors is not None:
                    stacked = mixture.factors[n, :, k].reshape(8, rank).numpy()
                    full += stacked @ stacked.T
                normal = multivariate_normal(mixture.means[n, :, k].reshape(8).numpy(), full)
                terms.append(float(mixture.log_weights[n, 0, k]) + normal.logpdf(truth[n].reshape(8).numpy()))
            assert float(got[n]) == pytest.approx(logsumexp(terms), rel=1e-11)

    @pytest.mark.parametrize("rank", [0, 2])
    def test_marginal_is_the_normal_s_of_each_step(self, rank: int) -> None:
        mixture = random_mixture(3, rank=rank, per_step=not rank)
        truth = torch.randn(2, 4, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(8))
        got = marginal_log_likelihood(mixture, truth)
        full = covariances(mixture).numpy()
        for n, t in np.ndindex(2, 4):
            terms = [
                float(mixture.log_weights[n, t, k])
                + multivariate_normal(mixture.means[n, t, k].numpy(), full[n, t, k]).logpdf(truth[n, t].numpy())
                for k in range(3)
            ]
            assert float(got[n, t]) == pytest.approx(logsumexp(terms), rel=1e-9)

    def test_of_one_step_joint_and_marginal_agree(self) -> None:
        mixture = random_mixture(5, steps=1)
        truth = torch.zeros(2, 1, 2, dtype=torch.float64)
        torch.testing.assert_close(nll(mixture, truth, True), nll(mixture, truth, False))

    def test_single_precision_holds_where_errors_persist_a_hundred_times_the_rest(self) -> None:
        """The textbook form of Woodbury's identity subtracts two numbers near 3e5 here."""
        mixture = random_mixture(6, steps=30)
        mixture = mixture._replace(roots=0.01 * torch.eye(2, dtype=torch.float64).expand_as(mixture.roots).clone())
        assert mixture.factors is not None
        truth = mixture.means[:, :, 0] + torch.einsum(
            "ntir,r->nti", mixture.factors[:, :, 0], torch.tensor([2.0, -1.0], dtype=torch.float64)
        )
        exact = joint_log_likelihood(mixture, truth)
        single = joint_log_likelihood(Mixture(*(x.float() for x in mixture)), truth.float())
        assert (single.double() - exact).abs().max() < 0.02  # nat, of about 180

    def test_gradients_are_those_of_finite_differences(self) -> None:
        mixture = random_mixture(7, steps=3)
        truth = torch.randn(2, 3, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(7))
        parts = [x.clone().requires_grad_() for x in mixture]
        for joint in (True, False):
            assert torch.autograd.gradcheck(lambda *p, j=joint: loss(Mixture(*p), truth, 0.1, j), parts, atol=1e-6)

    def test_l2_is_the_nearest_mode_s_mean_distance(self) -> None:
        means = torch.zeros(1, 2, 3, 2)
        means[0, :, 0, 0], means[0, :, 1, 0], means[0, :, 2, 0] = 5.0, 1.0, torch.tensor([0.0, 9.0])
        mixture = Mixture(torch.zeros(1, 2, 3), means, torch.eye(2).expand(1, 2, 3, 2, 2))
        assert float(best_mode_error(mixture, torch.zeros(1, 2, 2))) == 1.0


class TestNetwork:
    def test_is_the_paper_s_by_default(self) -> None:
        network = build(NetworkConfig())
        mlps, lstm = (2 * 32 + 32) + (32 * 32 + 32), 4 * (32 * 32 + 32 * 32 + 32 + 32)
        assert parameters(network) == mlps + 2 * lstm + 18 * 33

    @pytest.mark.parametrize("architecture", ["lstm", "mlp"])
    @pytest.mark.parametrize(
        "extra", [{}, {"lanes": True, "ego_future": True}, {"anchor": "velocity"}, {"anchor": "growing"}]
    )
    @pytest.mark.parametrize("base", [SMALL, PERSISTENT])
    def test_states_a_mixture_with_positive_definite_covariances(self, base, extra, architecture) -> None:
        config = replace(base, architecture=architecture, **extra)
        examples = random_examples(config, 9)
        with torch.no_grad():
            mixture = build(config)(Inputs(*(None if x is None else 100.0 * x for x in examples.inputs)))
        assert mixture.means.shape == (9, 5, 3, 2)
        roots = mixture.roots.double()
        assert torch.linalg.eigvalsh(roots @ roots.mT).min() > 0
        assert mixture.roots.diagonal(dim1=-2, dim2=-1).min() >= config.floor / config.scale
        torch.testing.assert_close(mixture.log_weights.exp().sum(-1), torch.ones(9, 5))
        constant = (mixture.log_weights == mixture.log_weights[:, :1]).all()
        assert bool(constant) == (config.weights == "persistent")

    def test_lanes_are_a_set_and_padding_says_nothing(self) -> None:
        config = replace(SMALL, lanes=True)
        network, examples = build(config), random_examples(config, 3)
        inputs = examples.inputs
        first = network(inputs).means
        shuffled = inputs._replace(lanes=inputs.lanes[:, torch.randperm(7)])
        torch.testing.assert_close(network(shuffled).means, first)
        torch.testing.assert_close(network(inputs._replace(lanes=inputs.lanes[:, :4])).means, first)
        assert not torch.allclose(network(inputs._replace(lanes=inputs.lanes + 1.0)).means, first)
        nothing = network(inputs._replace(lanes=torch.full_like(inputs.lanes, float("nan")))).means
        assert nothing.isfinite().all()

    def test_velocities_are_differences(self) -> None:
        past = torch.tensor([[[0.0, 0.0], [1.0, 0.0], [3.0, -1.0]]])
        torch.testing.assert_close(velocities(past, 0.5), torch.tensor([[[2.0, 0.0], [2.0, 0.0], [4.0, -2.0]]]))

    def test_an_anchor_is_constant_velocity_by_least_squares(self) -> None:
        past = torch.tensor([[[float(t), 2.0] for t in range(-5, 1)]])
        expected = torch.tensor([[[1.0, 2.0], [2.0, 2.0]]])
        torch.testing.assert_close(extrapolated(past, 2), expected)

    @pytest.mark.parametrize("base", [SMALL, PERSISTENT])
    def test_a_growing_anchor_states_the_same_in_units_that_grow(self, base: NetworkConfig) -> None:
        plain, growing = (Head(replace(base, anchor=a), 8) for a in ("velocity", "growing"))
        growing.load_state_dict(plain.state_dict())
        hidden, past = torch.rand(2, 5, 8), torch.rand(2, 6, 2)
        with torch.no_grad():
            one, other = plain(hidden, past), growing(hidden, past)
        course, units = extrapolated(past, 5).unsqueeze(2), (torch.arange(1.0, 6.0) / 5).view(5, 1, 1) ** 1.5
        torch.testing.assert_close(other.means - course, units * (one.means - course))
        floor = torch.eye(2) * base.floor / base.scale
        torch.testing.assert_close(other.roots - floor, units[..., None] * (one.roots - floor))
        if one.factors is not None and other.factors is not None:
            torch.testing.assert_close(other.factors, units[..., None] * one.factors)

    def test_missing_inputs_and_unknown_settings_are_named(self) -> None:
        network = build(replace(SMALL, ego_future=True))
        with pytest.raises(InputError, match="ego_future: the network was built to read it, got none"):
            network(Inputs(torch.zeros(1, 6, 2)))
        with pytest.raises(InputError, match="head: expected one of independent, persistent; got 'full'"):
            NetworkConfig(head="full")
        with pytest.raises(InputError, match="got 'per_step'"):
            NetworkConfig(head="persistent")
        with pytest.raises(InputError, match=r"expected fields architecture, .*; got 'depth'"):
            NetworkConfig.from_dict({"depth": 3})
        assert NetworkConfig.from_dict(PERSISTENT.to_dict()) == PERSISTENT


class TestTraining:
    @pytest.mark.parametrize("config", [SMALL, PERSISTENT, replace(SMALL, architecture="mlp")])
    def test_learns_one_batch_by_heart(self, config: NetworkConfig) -> None:
        examples = random_examples(config, 8)
        config = replace(config, hidden=32)
        settings = TrainSettings(epochs=400, patience=400, batch=8, rate=1e-2, mirror=False, decay=0.0)
        before = evaluate(build(config), examples, 0.1)
        trained = train(config, examples, examples, settings)
        after = evaluate(trained.network, examples, 0.1)
        assert after[0] < before[0] - 4.0  # nat per step
        if config.head == "independent":  # the other head may tell lasting errors by its factors as well as by the mean
            assert after[1] < before[1] / 2

    def test_goes_on_bit_for_bit_after_a_kill(self, tmp_path: Path) -> None:
        config = replace(PERSISTENT, lanes=True)
        examples, held = random_examples(config, 50), random_examples(config, 20, seed=1)
        whole = train(config, examples, held, QUICK, tmp_path / "whole")

        class Killed(Exception):
            pass

        def kill(progress: object) -> None:
            if progress.epoch == 3 and progress.share > 0.5:  # type: ignore[attr-defined]
                raise Killed

        with pytest.raises(Killed):
            train(config, examples, held, QUICK, tmp_path / "cut", listener=kill)
        again = train(config, examples, held, QUICK, tmp_path / "cut")
        assert (again.epoch, again.epochs, again.valid_loss) == (whole.epoch, whole.epochs, whole.valid_loss)
        for name, value in whole.network.state_dict().items():
            assert torch.equal(again.network.state_dict()[name], value), name
        assert log_of(tmp_path / "whole") == log_of(tmp_path / "cut")
        assert [row["epoch"] for row in log_of(tmp_path / "cut")] == ["1", "2", "3", "4"]

    def test_a_seed_fixes_everything_and_another_changes_it(self) -> None:
        examples = random_examples(SMALL, 30)
        first, second = (train(SMALL, examples, examples, replace(QUICK, epochs=2)) for _ in range(2))
        other = train(SMALL, examples, examples, replace(QUICK, epochs=2, seed=1))
        assert first.valid_loss == second.valid_loss != other.valid_loss

    def test_other_settings_do_not_go_on_from_a_checkpoint(self, tmp_path: Path) -> None:
        examples = random_examples(SMALL, 20)
        train(SMALL, examples, examples, replace(QUICK, epochs=1), tmp_path)
        with pytest.raises(InputError, match=r"of a training with rate = 0.01, got 0.02; choose another folder"):
            train(SMALL, examples, examples, replace(QUICK, epochs=1, rate=2e-2), tmp_path)
        (tmp_path / "checkpoint.safetensors").write_bytes(b"\x80\x04pickle")
        with pytest.raises(InputError, match="not a readable checkpoint"):
            train(SMALL, examples, examples, replace(QUICK, epochs=1), tmp_path)

    def test_stops_early(self) -> None:
        examples = random_examples(SMALL, 20)
        nowhere = replace(QUICK, rate=1e-12, epochs=50, patience=2)
        assert train(SMALL, examples, examples, nowhere).epochs < 20

    def test_mirroring_negates_what_is_lateral(self) -> None:
        examples = random_examples(SMALL, 4)
        flipped = mirrored(examples, torch.tensor([True, False, True, False]))
        assert torch.equal(flipped.truth[0, :, 1], -examples.truth[0, :, 1])
        assert torch.equal(flipped.truth[1], examples.truth[1])
        assert torch.equal(flipped.inputs.past[2, :, 0], examples.inputs.past[2, :, 0])

    def test_cuda_where_there_is_none_and_no_data_are_refused(self) -> None:
        examples = random_examples(SMALL, 4)
        if not torch.cuda.is_available():
            with pytest.raises(InputError, match="CUDA is not available"):
                train(SMALL, examples, examples, QUICK, device="cuda")
        with pytest.raises(InputError, match="got 4 and 0"):
            train(SMALL, examples, examples.take(torch.arange(0)), QUICK)


PROGRAM = """
import sys, torch, dataclasses
sys.path.insert(0, {tests!r})
torch.set_num_threads(1)
from pathlib import Path
from test_network import QUICK, SMALL, random_examples
from predictor.train import train
done = train(SMALL, random_examples(SMALL, 64), random_examples(SMALL, 16, 1), QUICK, Path({folder!r}))
"""


def test_two_processes_train_what_one_does(tmp_path: Path) -> None:
    """Gradients of equal shares are averaged, so up to rounding nothing changes."""
    folder = tmp_path / "two"
    script = tmp_path / "program.py"
    script.write_text(textwrap.dedent(PROGRAM.format(tests=str(Path(__file__).parent), folder=str(folder))))
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2", str(script)]
    root = str(Path(__file__).parent.parent)
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": root}
    process = subprocess.Popen(command, env=environment, start_new_session=True, stderr=subprocess.PIPE)
    try:
        _, said = process.communicate(timeout=120)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        raise
    assert process.returncode == 0, said.decode()[-2000:]
    alone = train(SMALL, random_examples(SMALL, 64), random_examples(SMALL, 16, 1), QUICK, tmp_path / "one")
    assert alone.epochs == 4
    for one, two in zip(log_of(tmp_path / "one"), log_of(tmp_path / "two"), strict=True):
        assert float(one["valid_loss"]) == pytest.approx(float(two["valid_loss"]), abs=2e-4)
