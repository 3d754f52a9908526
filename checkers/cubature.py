"""E_ξ[1 − Π_t (1 − r_t(ξ))] over the factors ξ that persist, for steps that are independent given ξ."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np

from checkers.kernels.given import first_hits
from checkers.kind import Kind
from checkers.validate import Array

_REACH = 9.0  # of the grid: |ξ_i| beyond has probability 2.3e-19 per factor
_MOST_NODES = 40_000
_REPLICATES, _POINTS = 16, 256


def over_factors(
    shape_kind: int, shape: Array, poses: Array, inputs: tuple[Array, ...], tolerance: float, seed: int
) -> tuple[Array, float, Kind]:
    """First-hit probabilities (T,), absolute error of their sum, and kind.

    Up to two factors: the trapezoid rule on a grid, which converges geometrically for an integrand as smooth as
    N(0, I) times a Gaussian marginal (Trefethen & Weideman 2014); the step is halved until it is below what the rest ε
    smooths the integrand by and sums agree to `tolerance`, and the difference is the error. More factors, or a rest
    too small for any grid: Sobol' points (Owen 1995 scrambling) through the normal quantile, and three standard errors
    between replicates, an estimate. Neither sees risks much below 1e-18; the error says so.
    """
    means, factors, roots, headings = inputs
    rank = factors.shape[-1]

    def hits(nodes: Array) -> Array:
        out = np.empty((len(nodes), len(poses)))
        args = (means, factors, roots, headings, nodes, min(0.1 * tolerance, 1e-5), out)
        first_hits(shape_kind, shape, poses, *args)
        return out

    found = _grid(hits, rank, tolerance, _smoothed(factors, roots)) if rank <= 2 else None
    return found or _sobol(hits, rank, seed)


def _smoothed(factors: Array, roots: Array) -> float:
    """Least standard deviation, in ξ, of the Gaussian by which the rest smooths what a factor moves; 0 without rest.

    N(x; Bξ, E) has the precision Bᵀ E⁻¹ B as a function of ξ.
    """
    least = np.inf
    for factor, root in zip(factors, roots, strict=True):
        if np.linalg.matrix_rank(root) < len(root):
            return 0.0
        largest = float(np.linalg.norm(np.linalg.solve(root, factor), 2))
        least = min(least, 1.0 / largest if largest > 0.0 else np.inf)
    return least


def _grid(hits: Any, rank: int, tolerance: float, smoothed: float) -> tuple[Array, float, Kind] | None:
    """By the trapezoid rule; None if the grid cannot be made fine enough to be believed.

    A rule coarser than the integrand's detail agrees with itself by accident: two sums of zeros do.
    """
    if not smoothed > 0.0 or (2.0 * _REACH / min(smoothed, 0.5)) ** rank > 2 * _MOST_NODES:
        return None
    step, tail = 1.0, rank * 2.3e-19
    line = np.arange(-_REACH, _REACH + 0.5, step)
    nodes = np.array(list(product(line, repeat=rank)))
    total = _weigh(hits, nodes, step)
    while True:
        fine = 0.5 * step * np.arange(-round(2 * _REACH / step), round(2 * _REACH / step) + 1)
        odd = np.arange(len(fine)) % 2 == 1
        mesh = np.array(list(product(range(len(fine)), repeat=rank)))
        new = fine[mesh[odd[mesh].any(axis=1)]]
        if len(new) > _MOST_NODES:
            return None
        step *= 0.5
        before, total = total, total * 0.5**rank + _weigh(hits, new, step)
        error = abs(float(before.sum() - total.sum()))
        if step <= smoothed and error <= tolerance * total.sum():
            return total, error + tail, Kind.EXACT


def _weigh(hits: Any, nodes: Array, step: float) -> Array:
    """Σ φ(ξ) f(ξ) stepᴿ; nodes without weight are left out."""
    weight = np.exp(-0.5 * (nodes**2).sum(axis=1)) * (step / np.sqrt(2 * np.pi)) ** nodes.shape[1]
    some = (nodes**2).sum(axis=1) <= _REACH**2
    total: Array = weight[some] @ hits(np.ascontiguousarray(nodes[some]))
    return total


def _sobol(hits: Any, rank: int, seed: int) -> tuple[Array, float, Kind]:
    from scipy.special import ndtri  # noqa: PLC0415  slow to import, seldom needed
    from scipy.stats.qmc import Sobol  # noqa: PLC0415

    rng = np.random.default_rng(seed)
    means = []
    for _ in range(_REPLICATES):
        uniform = Sobol(rank, scramble=True, seed=rng).random(_POINTS)
        means.append(hits(ndtri(np.clip(uniform, 1e-16, 1 - 1e-16))).mean(axis=0))
    spread = 3.0 * float(np.std(np.sum(means, axis=1), ddof=1)) / np.sqrt(_REPLICATES)
    # where no point hit, the risk is not known to be below one hit in all points
    floor = 3.0 / (_REPLICATES * _POINTS)
    total: Array = np.mean(means, axis=0)
    return total, max(spread, floor if total.sum() < floor else 0.0), Kind.ESTIMATE
