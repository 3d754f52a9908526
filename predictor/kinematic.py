"""Physics without learning: what a learned predictor has to beat (Jasour et al. 2021, Table I, and least squares).

Each is a mean course; the spread about it is one Gaussian per step, with errors that persist (`fit_factors`), fitted in
the target's frame on the data the networks are trained on.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from checkers.dependence import fit_factors
from checkers.validate import Array, InputError
from predictor.forecasts import Forecasts
from predictor.frames import Frames

Course = Callable[[Array, int], Array]


def constant_velocity(past: Array, steps: int) -> Array:
    """(N, steps, 2): straight on by the last step of past (N, P, 2)."""
    ahead = np.arange(1, steps + 1)[:, None]
    out: Array = past[:, -1:] + ahead * (past[:, -1:] - past[:, -2:-1])
    return out


def least_squares(past: Array, steps: int) -> Array:
    """(N, steps, 2): straight on from the last position at the velocity by least squares over the last 5."""
    ahead, age = np.arange(1, steps + 1)[:, None], np.arange(-2.0, 3.0)
    out: Array = past[:, -1:] + ahead * np.einsum("p,npi->ni", age, past[:, -5:])[:, None] / 10.0
    return out


def constant_acceleration(past: Array, steps: int) -> Array:
    """(N, steps, 2): by the last two steps."""
    ahead = np.arange(1, steps + 1)[:, None]
    velocity = past[:, -1:] - past[:, -2:-1]
    acceleration = velocity - (past[:, -2:-1] - past[:, -3:-2])
    out: Array = past[:, -1:] + ahead * velocity + 0.5 * ahead * (ahead + 1) * acceleration
    return out


COURSES: dict[str, Course] = {
    "constant velocity, last step": constant_velocity,
    "constant velocity, least squares over 5": least_squares,
    "constant acceleration": constant_acceleration,
}


@dataclass(frozen=True, eq=False)
class Kinematic:
    """A course and the spread about it, in the target's frame.

    Attributes:
        course: the mean.
        factors: (T, 2, R) [m]; covariances: (T, 2, 2) [m²].
        dt: [s].
    """

    course: Course
    factors: Array
    covariances: Array
    dt: float

    @classmethod
    def fitted(cls, course: Course, past: Array, headings: Array, future: Array, dt: float, rank: int = 2) -> Kinematic:
        """The spread of future (N, T, 2) about the course.

        Raises:
            InputError: fewer than two windows.
        """
        if len(past) < 2:
            raise InputError(f"past: expected at least 2 windows to fit a spread on, got {len(past)}")
        rotations = Frames.of(past, headings).rotations
        residuals = np.einsum("ntj,njk->ntk", future - course(past, future.shape[1]), rotations)
        factors, covariances = fit_factors(residuals, rank)
        return cls(course, factors, covariances + 1e-4 * np.eye(2), dt)

    def predict(self, past: Array, headings: Array) -> Forecasts:
        """One persistent mode each."""
        steps = len(self.factors)
        frames, n = Frames.of(past, headings), len(past)
        factors = np.broadcast_to(self.factors[:, None], (n, steps, 1, *self.factors.shape[1:]))
        covariances = np.broadcast_to(self.covariances[:, None], (n, steps, 1, 2, 2))
        return Forecasts(
            self.dt * np.arange(1, steps + 1, dtype=np.float64),
            np.ones((n, steps, 1)),
            self.course(past, steps)[:, :, None],
            frames.covariances_to_world(covariances),
            frames.factors_to_world(factors),
        )
