"""Two pictures of propagation: what Gaussian filters make of a steering car, and risk over time by every backend."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

import riskplan as rp
from benchmarks.filters import GaussianTrack, extended, unscented
from benchmarks.propagation import BACKENDS, DT, EGO, STEPS, sampled_risk
from checkers.validate import Array

COLOURS = ("#3d8bfd", "#e07b1f", "#1c9c86", "#c9487e", "#7b4fcf", "#5f7486")


def draw(path: Path, agent: rp.ControlPrediction, poses: Array, samples: int) -> None:
    """Write both, side by side."""
    mpl.use("Agg")
    import matplotlib.pyplot as plt  # noqa: PLC0415  after the backend is chosen

    mpl.rcParams.update({"axes.spines.top": False, "axes.spines.right": False, "svg.fonttype": "none"})
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.4), constrained_layout=True, width_ratios=(1, 1.5))
    _filters(left)
    _risk(right, agent, poses, samples)
    figure.savefig(path, dpi=160)
    plt.close(figure)


def _filters(axes: Any, sd: float = 0.1) -> None:
    controls = {"w_v": rp.Normal(0.0, 0.1), "w_theta": rp.Normal(0.0, sd)}
    agent = rp.ControlPrediction(rp.dynamics.dubins(DT), [0, 0, 10, 0], controls, STEPS)
    points = agent.sample(4000, np.random.default_rng(0))[:, -1]
    axes.scatter(*points.T, s=2, color="#b9c2cb", linewidths=0, label="simulated, after 3 s", rasterized=True)
    start = (np.array([0.0, 0.0, 10.0, 0.0]), np.zeros((4, 4)), np.zeros(2), np.array([0.1**2, sd**2]), DT, STEPS)
    exact = GaussianTrack(agent.means[:, 0], agent.covariances[:, 0])
    shown = {"exact moments": exact, "EKF": extended(*start), "unscented": unscented(*start)}
    for (name, track), colour in zip(shown.items(), COLOURS, strict=False):
        outline = _ellipse(track.means[-1], track.covariances[-1])
        axes.plot(*outline.T, color=colour, lw=1.8, label=f"{name}, 2 σ")
        axes.plot(*track.means[-1], "+", color=colour, ms=9, mew=1.8)
    axes.set(
        aspect="equal", xlabel="x [m]", ylabel="y [m]", title=f"steering noise {sd} rad a step, 10 m/s", xlim=(-22, 36)
    )
    axes.legend(frameon=False, fontsize=8, loc="center left")  # behind the start


def _ellipse(mean: Array, covariance: Array, sigmas: float = 2.0) -> Array:
    angle = np.linspace(0, 2 * np.pi, 100)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    outline: Array = mean + sigmas * (np.linalg.cholesky(covariance) @ circle).T
    return outline


def _risk(axes: Any, agent: rp.ControlPrediction, poses: Array, samples: int) -> None:
    share = sampled_risk(agent, poses, samples, np.random.default_rng(1))
    for name, colour in zip(BACKENDS, COLOURS, strict=False):
        bound = rp.checker(name)(poses, agent, EGO).value @ agent.weights
        axes.semilogy(agent.times, np.where(bound >= 1e-6, bound, np.nan), color=colour, lw=1.6, label=name)
    seen = share > 0
    axes.semilogy(agent.times[seen], share[seen], "k.", ms=5, label=f"Monte Carlo {samples:.0e}".replace("e+0", "e"))
    axes.set(xlabel="time [s]", ylabel="risk of the step", title="a control-predicted agent", ylim=(1e-6, 1.5))
    axes.legend(frameon=False, fontsize=8, loc="lower right")
