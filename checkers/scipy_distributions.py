"""Frozen scipy distributions as random variables of ours."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from checkers.distributions import Beta, Exponential, Gamma, Normal, Triangular, Uniform
from checkers.quadrature import HIGHEST_POWER, Rule
from checkers.random_variables import Constant, Discrete, RandomVariable, wave_by_rule
from checkers.validate import Array, InputError

_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(24)
_COARSE = np.polynomial.legendre.leggauss(16)
_LARGEST_RULE = 400_000


@dataclass(frozen=True, eq=False)
class Tabulated(RandomVariable):
    """A distribution known by its density and a sampler, such as one of scipy's without a family of ours.

    Attributes:
        edges: (P + 1,) of Gauss–Legendre panels.
        density: of X.
        draw: scipy's sampler.
        degree: powers up to this come out to 1e-9.
    """

    edges: Array
    density: Any
    draw: Any
    degree: int = 0

    @cached_property
    def mean(self) -> float:
        """E[X]."""
        x, w = _panels(self.edges, self.density)
        return float(w @ x / w.sum())

    def characteristic(self, t: float) -> complex:
        """From the rule."""
        return wave_by_rule(self, t)

    def rule(self, frequency: float = 0.0) -> Rule:
        """Gauss–Legendre on panels that a wave crosses at most twice; far in the tails it may do as it likes."""
        pieces = np.ones(len(self.edges) - 1)
        if frequency:
            _, share = _panels(self.edges, self.density)
            heavy = share.reshape(len(pieces), -1).sum(axis=1) > 1e-13
            pieces[heavy] = np.ceil(1.0 + np.diff(self.edges)[heavy] * abs(frequency) / 12.0)
        if pieces.sum() * len(_POINTS) > _LARGEST_RULE:
            raise InputError(f"random variable: waves of {frequency:g} rad cannot be integrated over its density")
        cut = [
            np.linspace(a, b, int(n), endpoint=False)
            for a, b, n in zip(self.edges, self.edges[1:], pieces, strict=False)
        ]
        x, w = _panels(np.append(np.concatenate(cut), self.edges[-1]), self.density)
        return Rule(x - self.mean, w / w.sum())

    def sample(self, n: int | tuple[int, ...], rng: np.random.Generator) -> Array:
        """Draws."""
        return np.asarray(self.draw(size=n, random_state=rng), dtype=np.float64)


def from_scipy(value: Any, name: str) -> RandomVariable:
    """The same distribution: by its family where we have it, else by a rule over its density.

    Raises:
        InputError: for an infinite discrete support, or a density whose integral or variance comes out wrong.
    """
    shapes, loc, scale = value.dist._parse_args(*value.args, **value.kwds)
    loc, scale = float(loc), 1.0 if scale is None else float(scale)
    if scale == 0.0:
        return Constant(loc)
    family = value.dist.name
    if family == "norm":
        return Normal(loc, scale)
    if family == "uniform":
        return Uniform(loc, loc + scale)
    if family == "beta":
        return Beta(float(shapes[0]), float(shapes[1]), loc, loc + scale)
    if family == "gamma":
        return Gamma(float(shapes[0]), scale, loc)
    if family == "expon":
        return Exponential(scale, loc)
    if family == "triang":
        return Triangular(loc, loc + float(shapes[0]) * scale, loc + scale)
    if hasattr(value, "pmf"):
        return _discrete(value, loc, name)
    return _by_density(value, name)


def _discrete(value: Any, loc: float, name: str) -> RandomVariable:
    if hasattr(value.dist, "xk"):
        points = np.asarray(value.dist.xk, dtype=float) + loc
        return Discrete(points, np.asarray(value.dist.pk, dtype=float))
    low, high = value.support()
    if not np.isfinite([low, high]).all() or high - low > 10_000:
        raise InputError(f"{name}: expected a discrete distribution of at most 10000 values, got {value.dist.name}")
    points = np.arange(low, high + 1.0)
    return Discrete(points, value.pmf(points))


def _by_density(value: Any, name: str) -> RandomVariable:
    """Panels between quantiles that crowd towards both ends, as far out as the highest moments look."""
    tail = 10.0 ** -np.concatenate([np.arange(0.5, 40.0, 0.5), np.arange(40.0, 305.0, 5.0)])
    middle = np.linspace(0.05, 0.95, 19)
    edges = np.unique(np.concatenate([value.ppf(tail), value.ppf(middle), value.isf(tail), value.support()]))
    edges = edges[np.isfinite(edges)]
    degree = _degree(edges, value.pdf, value.support()) if len(edges) > 1 else 0
    if degree < 2:
        raise InputError(f"{name}: expected a distribution with a mean and a variance, got {value.dist.name}")
    return Tabulated(edges, value.pdf, value.rvs, degree)


def _panels(edges: Array, density: Any, gauss: tuple[Array, Array] = (_POINTS, _WEIGHTS)) -> tuple[Array, Array]:
    """Points and weights of the density, panel after panel."""
    half = 0.5 * np.diff(edges)
    x = (0.5 * (edges[:-1] + edges[1:]))[:, None] + half[:, None] * gauss[0]
    return x.ravel(), (half[:, None] * gauss[1] * density(x)).ravel()


def _degree(edges: Array, density: Any, support: Any) -> int:
    """How many absolute moments there are: a coarser rule gives the same, and an endless tail ends by adding nothing.

    0 where the density does not integrate to 1.
    """
    (x, w), (y, v) = _panels(edges, density), _panels(edges, density, _COARSE)
    if not (np.isfinite(w).all() and np.isfinite(v).all() and abs(w.sum() - 1.0) < 1e-9):
        return 0
    centre = float(w @ x)
    fine, coarse = w.reshape(len(edges) - 1, -1), v.reshape(len(edges) - 1, -1)
    x, y = (x - centre).reshape(fine.shape), (y - centre).reshape(coarse.shape)
    alive = np.flatnonzero(fine.any(axis=1))  # farther out the density underflows: that nothing is added says nothing
    for n in range(1, HIGHEST_POWER + 1):
        with np.errstate(over="ignore", invalid="ignore", under="ignore"):
            fine, coarse = fine * x, coarse * y
            parts = np.abs(fine).sum(axis=1)
            ends, total = parts[alive[[0, -1]]][np.isinf(support)].sum(), parts.sum()
            good = abs(float(coarse.sum() - fine.sum())) <= 1e-9 * total < np.inf and ends <= 1e-10 * total
        if not good:
            return n - 1
    return HIGHEST_POWER
