"""Families of distributions, each by its characteristic function and a quadrature rule."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from checkers.quadrature import Rule, jacobi, quarters_of, standard_gamma, standard_normal
from checkers.random_variables import RandomVariable, checked, wave_by_rule
from checkers.validate import Array, InputError


@dataclass(frozen=True)
class Normal(RandomVariable):
    """N(mean, sd²)."""

    mu: float
    sd: float

    def __post_init__(self) -> None:
        checked(self, "mu")
        checked(self, "sd", low=0.0)

    @property
    def mean(self) -> float:
        """`mu`."""
        return self.mu

    def characteristic(self, t: float) -> complex:
        """exp(i μ t − σ² t²/2)."""
        return complex(np.exp(1j * t * self.mu - 0.5 * (self.sd * t) ** 2))

    def rule(self, frequency: float = 0.0) -> Rule:
        """The trapezoid rule, whose error falls as exp(−(2π/h − frequency σ)²/2) (Trefethen & Weideman 2014)."""
        points, weights = standard_normal(quarters_of(frequency * self.sd))
        return Rule(self.sd * points, weights)

    def sample(self, n: int | tuple[int, ...], rng: np.random.Generator) -> Array:
        """Draws."""
        return rng.normal(self.mu, self.sd, n)


@dataclass(frozen=True)
class Uniform(RandomVariable):
    """Uniform on [low, high]."""

    low: float
    high: float

    def __post_init__(self) -> None:
        checked(self, "low", "high")
        _ordered(self, low=self.low, high=self.high)

    @property
    def mean(self) -> float:
        """Middle."""
        return 0.5 * (self.low + self.high)

    def characteristic(self, t: float) -> complex:
        """exp(i m t) sin(h t)/(h t), m the middle, h half the width."""
        half = 0.5 * (self.high - self.low)
        return complex(np.exp(1j * t * self.mean) * np.sinc(half * t / np.pi))

    def rule(self, frequency: float = 0.0) -> Rule:
        """Gauss–Legendre."""
        half = 0.5 * (self.high - self.low)
        points, weights = jacobi(0.0, 0.0, quarters_of(frequency * half))
        return Rule(half * points, weights)

    def sample(self, n: int | tuple[int, ...], rng: np.random.Generator) -> Array:
        """Draws."""
        return rng.uniform(self.low, self.high, n)


@dataclass(frozen=True)
class Beta(RandomVariable):
    """Beta(a, b), stretched from [0, 1] to [low, high]."""

    a: float
    b: float
    low: float = 0.0
    high: float = 1.0

    def __post_init__(self) -> None:
        checked(self, "a", "b", low=1e-2, high=500.0)
        checked(self, "low", "high")
        _ordered(self, low=self.low, high=self.high)

    @property
    def mean(self) -> float:
        """low + (high − low) a/(a + b)."""
        return self.low + (self.high - self.low) * self.a / (self.a + self.b)

    def characteristic(self, t: float) -> complex:
        """exp(i low t) ₁F₁(a; a + b; i t (high − low)): with the i (Johnson, Kotz & Balakrishnan 1995, ch. 25)."""
        return wave_by_rule(self, t)

    def rule(self, frequency: float = 0.0) -> Rule:
        """Gauss–Jacobi."""
        half = 0.5 * (self.high - self.low)
        points, weights = jacobi(self.b - 1.0, self.a - 1.0, quarters_of(frequency * half))
        centre = (self.a - self.b) / (self.a + self.b)
        return Rule(half * (points - centre), weights)

    def sample(self, n: int | tuple[int, ...], rng: np.random.Generator) -> Array:
        """Draws."""
        return self.low + (self.high - self.low) * rng.beta(self.a, self.b, n)


@dataclass(frozen=True)
class Gamma(RandomVariable):
    """Gamma(shape) times `scale`, plus `shift`."""

    shape: float
    scale: float
    shift: float = 0.0

    def __post_init__(self) -> None:
        checked(self, "shape", low=1e-2, high=1e4)
        checked(self, "scale", low=0.0, strict=True)
        checked(self, "shift")

    @property
    def mean(self) -> float:
        """shift + shape · scale."""
        return self.shift + self.shape * self.scale

    def characteristic(self, t: float) -> complex:
        """exp(i shift t) (1 − i scale t)^(−shape)."""
        return complex(np.exp(1j * t * self.shift) * (1.0 - 1j * self.scale * t) ** (-self.shape))

    def rule(self, frequency: float = 0.0) -> Rule:
        """The double-exponential rule on the half-line (Takahasi & Mori 1974)."""
        points, weights = standard_gamma(self.shape, quarters_of(frequency * self.scale))
        return Rule(self.scale * points, weights)

    def sample(self, n: int | tuple[int, ...], rng: np.random.Generator) -> Array:
        """Draws."""
        return self.shift + rng.gamma(self.shape, self.scale, n)


@dataclass(frozen=True)
class Exponential(RandomVariable):
    """Exponential of mean `scale`, plus `shift`."""

    scale: float
    shift: float = 0.0

    def __post_init__(self) -> None:
        checked(self, "scale", low=0.0, strict=True)
        checked(self, "shift")

    @property
    def _gamma(self) -> Gamma:
        return Gamma(1.0, self.scale, self.shift)

    @property
    def mean(self) -> float:
        """shift + scale."""
        return self.shift + self.scale

    def characteristic(self, t: float) -> complex:
        """exp(i shift t)/(1 − i scale t)."""
        return self._gamma.characteristic(t)

    def rule(self, frequency: float = 0.0) -> Rule:
        """That of the gamma distribution of shape 1."""
        return self._gamma.rule(frequency)

    def sample(self, n: int | tuple[int, ...], rng: np.random.Generator) -> Array:
        """Draws."""
        return self.shift + rng.exponential(self.scale, n)


@dataclass(frozen=True)
class Triangular(RandomVariable):
    """Triangular density on [low, high] with its peak at `mode`."""

    low: float
    mode: float
    high: float

    def __post_init__(self) -> None:
        checked(self, "low", "mode", "high")
        _ordered(self, low=self.low, high=self.high)
        if not self.low <= self.mode <= self.high:
            raise InputError(f"Triangular: mode: expected low <= mode <= high, got {self.mode!r}")

    @property
    def mean(self) -> float:
        """(low + mode + high)/3."""
        return (self.low + self.mode + self.high) / 3.0

    def characteristic(self, t: float) -> complex:
        """From the rule: the closed form cancels at small t."""
        return wave_by_rule(self, t)

    def rule(self, frequency: float = 0.0) -> Rule:
        """Gauss–Jacobi on either side of the peak."""
        width = self.high - self.low
        points, weights = jacobi(0.0, 1.0, quarters_of(frequency * width))  # density rising on [−1, 1]
        rise, fall = self.mode - self.low, self.high - self.mode
        left = self.low + 0.5 * rise * (1.0 + points)
        right = self.high - 0.5 * fall * (1.0 + points)
        share = np.concatenate([rise / width * weights, fall / width * weights])
        return Rule(np.concatenate([left, right]) - self.mean, share)

    def sample(self, n: int | tuple[int, ...], rng: np.random.Generator) -> Array:
        """Draws."""
        return rng.triangular(self.low, self.mode, self.high, n)


def _ordered(x: Any, low: float, high: float) -> None:
    """Refuse an interval that is none."""
    if not low < high:
        raise InputError(f"{type(x).__name__}: high: expected more than low = {low!r}, got {high!r}")
