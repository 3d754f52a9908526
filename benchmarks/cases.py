"""Inputs of the risk benchmarks: random modes over the whole range, and the predictions file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

import riskplan as rp
from checkers.validate import Array

FILE = "argoverse1-predictions.npz"


@dataclass(frozen=True)
class Modes:
    """N modes, each at a pose of its own, against one ellipse."""

    poses: Array
    means: Array
    covariances: Array
    ego: rp.EgoEllipsoid

    @property
    def prediction(self) -> rp.GaussianMixturePrediction:
        """One mode, one step per case."""
        return rp.GaussianMixturePrediction(
            np.arange(len(self.means), dtype=float), [1.0], self.means[:, None], self.covariances[:, None]
        )

    def part(self, which: np.ndarray | slice) -> Modes:
        """Some of them."""
        return Modes(self.poses[which], self.means[which], self.covariances[which], self.ego)


@dataclass(frozen=True)
class Scenarios:
    """The predictions file: 30 steps of 3 persistent modes each, and an ego path."""

    poses: Array
    predictions: tuple[rp.GaussianMixturePrediction, ...]
    ego: rp.EgoEllipsoid

    def modes(self, ego: rp.EgoEllipsoid | None = None) -> Modes:
        """All modes of all steps in one row."""
        count = self.predictions[0].means.shape[1]
        return Modes(
            np.repeat(self.poses.reshape(-1, 3), count, axis=0),
            np.concatenate([p.means.reshape(-1, 2) for p in self.predictions]),
            np.concatenate([p.covariances.reshape(-1, 2, 2) for p in self.predictions]),
            ego or self.ego,
        )


def load_scenarios(data: Path) -> Scenarios:
    """Read the file (see data/README.md): ego ellipsoid and ego path as in the paper's release."""
    with np.load(data / FILE) as d:
        weights = d["weights"] / d["weights"].sum(axis=1, keepdims=True)
        predictions = tuple(
            rp.GaussianMixturePrediction(d["times"], w, m, c)
            for w, m, c in zip(weights, d["means"], d["covariances"], strict=True)
        )
        return Scenarios(d["ego_poses"], predictions, rp.EgoEllipsoid(d["Q"]))


def random_modes(rng: np.random.Generator, count: int, furthest: float = 60.0) -> Modes:
    """σ from 1e-4 to 1e4 of an ellipse of 5.5 × 2.6 m, variance ratios to 1e8, means to `furthest` σ outside."""
    ego = rp.EgoEllipsoid(np.diag([1 / 5.5**2, 1 / 2.6**2]))
    small = 3.8 * 10 ** rng.uniform(-4, 4, count)
    large = np.minimum(small * 10 ** rng.uniform(0, 4, count), 3.8e4)
    angle, heading = rng.uniform(0, np.pi, count), rng.uniform(-np.pi, np.pi, count)
    c, s = np.cos(angle), np.sin(angle)
    covariances = np.empty((count, 2, 2))
    covariances[:, 0, 0] = c * c * large**2 + s * s * small**2
    covariances[:, 1, 1] = s * s * large**2 + c * c * small**2
    covariances[:, 0, 1] = covariances[:, 1, 0] = c * s * (large**2 - small**2)
    poses = np.column_stack([rng.uniform(-100, 100, (count, 2)), heading])
    # out of the ellipse's rim by a number of σ, in a random direction of the whitened plane; some modes inside
    turn = rng.uniform(0, 2 * np.pi, count)
    sigmas = rng.uniform(0, furthest, count) * (rng.random(count) < 0.8)
    w = np.column_stack([large * np.cos(turn), small * np.sin(turn)]) * sigmas[:, None]
    offset = np.column_stack([c * w[:, 0] - s * w[:, 1], s * w[:, 0] + c * w[:, 1]])
    rim = rng.uniform(0, 1.2, count)[:, None] * np.column_stack([5.5 * np.cos(turn), 2.6 * np.sin(turn)])
    ch, sh = np.cos(heading), np.sin(heading)
    rim = np.column_stack([ch * rim[:, 0] - sh * rim[:, 1], sh * rim[:, 0] + ch * rim[:, 1]])
    return Modes(poses, poses[:, :2] + rim + offset, covariances, ego)


def table(title: str, header: list[str], rows: list[list[object]]) -> None:
    """Print in markdown."""
    print(f"\n### {title}\n")
    print("| " + " | ".join(header) + " |")
    print("|" + "---|" * len(header))
    for row in rows:
        print("| " + " | ".join(f"{v:.3g}" if isinstance(v, float) else str(v) for v in row) + " |")
