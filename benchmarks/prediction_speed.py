"""How long a network takes for many agents: `python -m benchmarks.prediction_speed [--weights FILE]`.

From tracks to checked predictions in the world frame, on one core, lanes included; the network alone beside it.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np
import torch

import riskplan as rp
from benchmarks.cases import table
from predictor.baselines import build
from predictor.learned import SHIPPED, LearnedPredictor, one_thread
from predictor.model_files import Model
from predictor.network import Inputs, NetworkConfig


def main(arguments: list[str] | None = None) -> int:
    """Parse, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--weights", default="positions", help="a .safetensors, or shipped: positions, controls")
    parser.add_argument("--agents", type=int, default=100)
    parser.add_argument("--repeats", type=int, default=50)
    args = parser.parse_args(arguments)
    shipped = args.weights in SHIPPED
    given = LearnedPredictor.shipped(args.weights) if shipped else LearnedPredictor.load(args.weights)
    paper = NetworkConfig()
    models = {args.weights: given, "the paper's LSTM, untrained": LearnedPredictor(Model(build(paper).eval(), paper))}
    tracks = [_car(i) for i in range(args.agents)]
    lanes = np.random.default_rng(0).uniform(-100, 100, (1000, 2))
    rows: list[list[object]] = []
    for name, model in models.items():
        whole = _median(lambda m=model: m.predict(tracks, lanes=lanes), args.repeats)  # type: ignore[misc]
        rows.append([name, 1e3 * whole, 1e3 * _network_alone(model, args.agents, args.repeats)])
    table(f"{args.agents} agents, median of {args.repeats}", ["weights", "predict [ms]", "network alone [ms]"], rows)
    return 0


def _car(i: int) -> rp.Track:
    times = 0.1 * np.arange(30)
    positions = np.column_stack([5.0 * i + 10.0 * times, 3.5 * (i % 4) + 0.0 * times])
    return rp.Track(str(i), times, positions, 0.0 * times, 10.0 + 0.0 * times, 4.5, 1.8)


def _median(call: object, repeats: int) -> float:
    taken = []
    for _ in range(repeats + 3):
        begin = time.perf_counter()
        call()  # type: ignore[operator]
        taken.append(time.perf_counter() - begin)
    return float(np.median(taken[3:]))


def _network_alone(model: LearnedPredictor, agents: int, repeats: int) -> float:
    config = model.model.config
    lanes = torch.randn(agents, config.lane_points, 2) if config.lanes else None
    ego = torch.randn(agents, config.predicted, 2) if config.ego_future else None
    inputs = Inputs(torch.randn(agents, config.observed, 2), lanes, ego)
    with one_thread(), torch.inference_mode():
        return _median(lambda: model.model.network(inputs), repeats)


if __name__ == "__main__":
    sys.exit(main())
