"""`riskplan train`, `riskplan predict` and the demo's learned agents, on made-up traffic in the recorder's format."""

# ruff: noqa: E402  imports wait for the question whether torch is there

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the extra predictor")

import riskplan as rp
from predictor.datasets.simulator import save_recordings
from predictor.learned import LearnedPredictor
from predictor.recordings import Recording
from riskplan.cli import main
from riskplan.demo_scene import demo_scene


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Sixteen scenes of three cars that go straight, with their controls."""
    path = tmp_path_factory.mktemp("data") / "traffic.npz"
    rng = np.random.default_rng(0)
    times = np.arange(60) * 0.1

    def scene(i: int) -> Recording:
        tracks = []
        for k in range(3):
            speed = rng.uniform(5.0, 15.0)
            line = np.column_stack([speed * times, np.full(60, 4.0 * k)])
            tracks.append(rp.Track(f"car {k}", times, line, np.zeros(60), np.full(60, speed), 4.5, 1.8))
        return Recording(f"road-{i}", 0.1, tuple(tracks), controls={t.name: np.zeros((60, 2)) for t in tracks})

    save_recordings([scene(i) for i in range(16)], path)
    return path


def test_train_then_predict(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "model"
    assert main(["train", "--data", str(data), "--out", str(out), "--epochs", "2", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["training"]["epochs"] == 2
    assert sorted(p.name for p in out.iterdir()) == [
        "checkpoint.safetensors",
        "log.csv",
        "model.json",
        "model.safetensors",
    ]
    weights = str(out / "model.safetensors")
    assert main(["predict", str(data), "--weights", weights, "--out", str(tmp_path / "predicted"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert len(told["predictions"]) == 48 and told["left_out"] == 0
    agent = rp.load_prediction(tmp_path / "predicted" / "road-3" / "car_1.npz")
    assert (agent.name, agent.length) == ("car 1", 4.5)
    assert np.abs(agent.means[..., 1] - 4.0).max() < 5.0  # world frame, from where it was seen last
    np.testing.assert_array_equal(agent.times, LearnedPredictor.load(weights).model.config.times)


@pytest.mark.slow
def test_train_goes_on_where_it_was_killed(data: Path, tmp_path: Path) -> None:
    """kill -9 after the first epoch; the same command finishes as if nothing had been."""
    root = str(Path(__file__).parent.parent)
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": root}
    command = [sys.executable, "-m", "riskplan", "train", "--data", str(data), "--epochs", "3", "--out"]
    running = subprocess.Popen([*command, str(tmp_path / "cut")], env=environment, stderr=subprocess.PIPE, text=True)
    assert running.stderr is not None
    for line in running.stderr:
        if line.startswith("epoch 2"):
            running.kill()
    running.wait(timeout=60)
    running.stderr.close()
    for name in ("cut", "whole"):
        subprocess.run([*command, str(tmp_path / name)], env=environment, check=True, timeout=120, capture_output=True)
    cut, whole = (LearnedPredictor.load(tmp_path / name / "model.safetensors") for name in ("cut", "whole"))
    for name, value in whole.model.network.state_dict().items():
        assert torch.equal(cut.model.network.state_dict()[name], value), name


@pytest.mark.slow
def test_two_processes_train_as_one(data: Path, tmp_path: Path) -> None:
    """`torchrun`: the mean of both shares of a batch is the batch's; one process writes, once."""
    root = str(Path(__file__).parent.parent)
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": root}
    launch = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", "-m"]
    for name, by in (("two", launch), ("one", ["-m"])):
        command = [sys.executable, *by, "riskplan", "train", "--data", str(data), "--epochs", "2", "--out"]
        subprocess.run([*command, str(tmp_path / name)], env=environment, check=True, timeout=240, capture_output=True)
    logs = [(tmp_path / name / "log.csv").read_text(encoding="utf-8").splitlines() for name in ("two", "one")]
    assert len(logs[0]) == len(logs[1]) == 3
    two, one = (LearnedPredictor.load(tmp_path / name / "model.safetensors") for name in ("two", "one"))
    for name, value in one.model.network.state_dict().items():
        torch.testing.assert_close(two.model.network.state_dict()[name], value, rtol=0.0, atol=2e-3, msg=name)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--head", "full"], "head: expected one of independent, persistent; got 'full'"),
        (["--epochs", "0"], "threads, epochs and every: expected whole numbers >= 1"),
        (["--device", "abacus"], "device: expected one of cpu, cuda; got 'abacus'"),
    ],
)
def test_bad_settings(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments, message) -> None:
    assert main(["train", "--data", str(data), "--out", str(tmp_path / "x"), *arguments]) == 2
    assert capsys.readouterr().err.endswith(f"riskplan: error: {message}\n")


def test_bad_weights(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["predict", str(data), "--weights", "none.safetensors", "--out", str(tmp_path / "x")]) == 2
    assert capsys.readouterr().err == "riskplan: error: none.json: no such file\n"


@pytest.mark.parametrize("name", ["positions", "controls"])
def test_shipped_weights_predict_and_say_where_they_come_from(name: str) -> None:
    predictor = LearnedPredictor.shipped(name)
    assert predictor.model.card["data"]["name"].startswith("highway-env")
    times = np.arange(20) * 0.1
    line = np.column_stack([12.0 * times, np.zeros(20)])
    car = rp.Track("car", times, line, np.zeros(20), np.full(20, 12.0), 4.5, 1.8)
    agent = predictor.predict([car])[0]
    mean = agent.weights @ agent.means[-1]
    assert abs(mean[0] - (line[-1, 0] + 36.0)) < 5.0 and abs(mean[1]) < 1.0  # steady driving goes on


def test_the_demo_s_agents_are_the_network_s() -> None:
    scenario = demo_scene("traffic")
    assert len(scenario.agents) >= 4
    for agent in scenario.agents:
        assert agent.factors is not None and agent.means.shape == (31, 3, 2) and agent.times[0] == 0.0


def test_the_demo_without_torch_plans_the_other_scene() -> None:
    program = (
        "import sys; sys.modules['torch'] = None\nfrom riskplan.commands.demo import _scene\nprint(_scene(None).name)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)
    assert done.stdout == "overtake on a three-lane road\n"
    assert "LearnedPredictor needs torch: pip install '.[predictor]'" in done.stderr
