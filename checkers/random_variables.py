"""Random variables of the controls: characteristic function, moments, samples, and a quadrature rule for all else.

Moment propagation needs expectations of small quantities, such as E[(1 − cos w)⁴] of a steering increment of 0.01 rad.
From the characteristic function they are differences of numbers near 1 and lose every digit; a rule with positive
weights on deviations from the mean keeps them all.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import comb
from typing import Any

import numpy as np

from checkers.quadrature import HIGHEST_POWER, Rule
from checkers.validate import (
    FARTHEST,
    Array,
    InputError,
    as_array,
    as_count,
    as_instance,
    as_scalar,
    as_text,
    as_tuple,
    as_weights,
)


class RandomVariable(ABC):
    """A real random variable."""

    @property
    def degree(self) -> int:
        """The highest power whose expectation exists and the rule gives."""
        return HIGHEST_POWER

    @property
    @abstractmethod
    def mean(self) -> float:
        """E[X]."""

    @abstractmethod
    def characteristic(self, t: float) -> complex:
        """Φ(t) = E[exp(i t X)]."""

    @abstractmethod
    def rule(self, frequency: float = 0.0) -> Rule:
        """A quadrature rule, exact to rounding for functions no faster than exp(i · frequency · X)."""

    @abstractmethod
    def sample(self, n: int | tuple[int, ...], rng: np.random.Generator) -> Array:
        """Independent draws of shape `n`."""

    def moment(self, n: int) -> float:
        """E[Xⁿ], 0 ≤ n ≤ `degree`.

        Raises:
            InputError: for another n.
        """
        if not isinstance(n, int | np.integer) or isinstance(n, bool) or not 0 <= n <= self.degree:
            raise InputError(f"moment: expected an integer from 0 to {self.degree}, got {n!r}")
        deviations, weights = self.rule()
        return float(weights @ (self.mean + deviations) ** n)


def wave_by_rule(x: RandomVariable, t: float) -> complex:
    """Φ(t) from the quadrature rule."""
    deviations, weights = x.rule(abs(float(t)))
    return complex(np.exp(1j * t * x.mean) * (weights @ np.exp(1j * t * deviations)))


def checked(x: Any, *names: str, low: float = -FARTHEST, high: float = FARTHEST, strict: bool = False) -> None:
    """Turn the fields of those names into floats in [low, high], or refuse them."""
    for name in names:
        value = as_scalar(f"{type(x).__name__}: {name}", getattr(x, name), low=low, high=high, strict=strict)
        object.__setattr__(x, name, value)


@dataclass(frozen=True)
class Constant(RandomVariable):
    """A number that is certain."""

    value: float

    def __post_init__(self) -> None:
        checked(self, "value")

    @property
    def mean(self) -> float:
        """The value."""
        return self.value

    def characteristic(self, t: float) -> complex:
        """exp(i t value)."""
        return complex(np.exp(1j * t * self.value))

    def rule(self, frequency: float = 0.0) -> Rule:
        """One point."""
        return Rule(np.zeros(1), np.ones(1))

    def sample(self, n: int | tuple[int, ...], rng: np.random.Generator) -> Array:
        """Copies of the value."""
        return np.full(n, self.value)


@dataclass(frozen=True, eq=False)
class Discrete(RandomVariable):
    """Finitely many values with their probabilities."""

    values: Array
    weights: Array

    def __post_init__(self) -> None:
        values = as_array("Discrete: values", self.values, ("N",), largest=FARTHEST)
        object.__setattr__(self, "values", values)
        weights = as_weights("Discrete: weights", _listed(self.weights), 1, len(values))
        object.__setattr__(self, "weights", weights)

    @property
    def mean(self) -> float:
        """Σ weight · value."""
        return float(self.weights @ self.values)

    def characteristic(self, t: float) -> complex:
        """Σ weight · exp(i t value)."""
        return complex(self.weights @ np.exp(1j * t * self.values))

    def rule(self, frequency: float = 0.0) -> Rule:
        """The values themselves."""
        return Rule(self.values - self.mean, self.weights)

    def sample(self, n: int | tuple[int, ...], rng: np.random.Generator) -> Array:
        """Draws."""
        return rng.choice(self.values, n, p=self.weights)


@dataclass(frozen=True, eq=False)
class Mixture(RandomVariable):
    """One of several random variables, drawn by `weights` (Jasour et al. 2021, appendix A)."""

    weights: Array
    components: tuple[RandomVariable, ...]

    def __post_init__(self) -> None:
        given = as_tuple("Mixture: components", self.components)
        components = tuple(as_random_variable(c, f"Mixture: components[{i}]") for i, c in enumerate(given))
        if not components:
            raise InputError("Mixture: components: expected at least one, got none")
        weights = as_weights("Mixture: weights", _listed(self.weights), 1, len(components))
        object.__setattr__(self, "weights", weights)
        object.__setattr__(self, "components", components)

    @property
    def degree(self) -> int:
        """The lowest of the components'."""
        return min(c.degree for c in self.components)

    @property
    def mean(self) -> float:
        """Σ weight · mean."""
        return float(sum(w * c.mean for w, c in zip(self.weights, self.components, strict=True)))

    def characteristic(self, t: float) -> complex:
        """Σ weight · Φ."""
        return complex(sum(w * c.characteristic(t) for w, c in zip(self.weights, self.components, strict=True)))

    def rule(self, frequency: float = 0.0) -> Rule:
        """The components' rules, side by side."""
        parts = [c.rule(frequency) for c in self.components]
        mean = self.mean
        points = [p.deviations + (c.mean - mean) for p, c in zip(parts, self.components, strict=True)]
        return Rule(
            np.concatenate(points),
            np.concatenate([w * p.weights for w, p in zip(self.weights, parts, strict=True)]),
        )

    def sample(self, n: int | tuple[int, ...], rng: np.random.Generator) -> Array:
        """Draws: the component first."""
        which = rng.choice(len(self.components), n, p=self.weights)
        out = np.empty(np.shape(which))
        for k, component in enumerate(self.components):
            mine = which == k
            out[mine] = component.sample(int(np.count_nonzero(mine)), rng)
        return out


def trigonometric_moment(x: RandomVariable, m: int, n: int) -> float:
    """E[cosᵐ X sinⁿ X] from the characteristic function (Jasour et al. 2021, appendix B, last equation)."""
    as_instance("trigonometric_moment: x", x, RandomVariable)
    for name, value in (("m", m), ("n", n)):
        as_count(f"trigonometric_moment: {name}", value, 0, 1000)
    total = sum(
        comb(m, j) * comb(n, k) * (-1) ** (n - k) * x.characteristic(2 * (j + k) - m - n)
        for j in range(m + 1)
        for k in range(n + 1)
    )
    return float(((-1j) ** n * total / 2 ** (m + n)).real)


def as_random_variable(value: Any, name: str = "random variable") -> RandomVariable:
    """One of ours as it is, a number as a `Constant`, a frozen scipy distribution as its family or as a rule.

    scipy's norm, uniform, beta, gamma, expon, triang and finite discrete distributions become ours; any other
    continuous one is integrated over its density; its `degree` says which moments come out to 1e-9.

    Raises:
        InputError: for anything else, and for a distribution without a variance.
    """
    as_text("name", name)
    if isinstance(value, RandomVariable):
        return value
    if isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool):
        return Constant(as_scalar(name, value, low=-FARTHEST, high=FARTHEST))
    if not (hasattr(value, "dist") and hasattr(value, "kwds")):
        raise InputError(f"{name}: expected a random variable or a number, got {type(value).__name__}")
    from checkers.scipy_distributions import from_scipy  # noqa: PLC0415  only those who use it pay for it

    return from_scipy(value, name)


def _listed(weights: Any) -> Any:
    """A single weight may be given as a number."""
    return [weights] if isinstance(weights, int | float | np.number) else weights
