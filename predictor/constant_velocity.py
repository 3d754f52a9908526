"""Straight on at constant velocity, with a Gaussian spread fitted to recorded traffic.

The spread is anisotropic in the agent's heading frame, grows with the prediction time and depends on the
situation:

    σ²(t) = start² + exp(2 c·f) t^(2 p)        for each of the longitudinal and the lateral axis,

with f the situation's features and c, p > 0 fitted by maximum likelihood (`predictor.fit_constant_velocity`).
A Gaussian of one mode cannot follow a turn or a stop; the fit's summary states how far it is calibrated.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from typing import Any

import numpy as np

from checkers.prediction import GaussianMixturePrediction
from checkers.validate import Array, InputError, as_array, as_instance, as_scalar, as_times
from predictor.tracks import SLACK, Track

# seconds of past from which the richer parameter set is used, and over which accelerations are estimated
PAST = 2.0
# accelerations [m/s²] along and across, lateral speed [m/s]: below these they say nothing
NOISE = np.array([0.05, 0.01, 0.02])


@dataclass(frozen=True, eq=False)
class Spread:
    """Parameters of the spread for one amount of knowledge.

    Attributes:
        longitudinal, lateral: (F,) coefficients c of `Situation.features`.
        growth: (2,) exponents p > 0 of the time, longitudinal and lateral.
        start: standard deviation of the observed position at time 0 [m].
    """

    longitudinal: Array
    lateral: Array
    growth: Array
    start: float

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "longitudinal", as_array("longitudinal", self.longitudinal, ("F",)))
        put(self, "lateral", as_array("lateral", self.lateral, (len(self.longitudinal),)))
        put(self, "growth", as_array("growth", self.growth, (2,)))
        if np.any(self.growth <= 0):
            raise InputError(f"growth: expected exponents > 0, got {self.growth.tolist()}")
        # t^p with p > 0 grows: the spread never shrinks with the prediction time
        put(self, "start", as_scalar("start", self.start, low=0.0, strict=True))

    def variances(self, features: Array, times: Array) -> Array:
        """(..., T, 2) longitudinal and lateral variances [m²] for features (..., F) at times (T,) [s]."""
        log_scale = np.stack([features @ self.longitudinal, features @ self.lateral], axis=-1)
        grown: Array = np.exp(2 * log_scale)[..., None, :] * times[:, None] ** (2 * self.growth)
        return self.start**2 + grown


@dataclass(frozen=True, eq=False)
class Situation:
    """What the past says: where the agent is and how it moves.

    Attributes:
        position, velocity: (2,) [m], [m/s].
        heading: recorded last; the frame in which the spread is stated [rad].
        features: (3,) 1, s, s² with s = log(0.1 + speed); with `PAST` seconds of past (6,), then also
            log(0.05 + |longitudinal acceleration|), log(0.01 + |lateral acceleration|) and
            log(0.02 + |lateral speed|), in m/s and m/s². The offsets are of the size of the noise.
        motion: (3,) with their signs: acceleration ahead and to the left [m/s²], speed to the left [m/s]; 0 if unknown.
    """

    position: Array
    velocity: Array
    heading: float
    features: Array
    motion: Array = field(default_factory=lambda: np.zeros(3))

    @property
    def known(self) -> bool:
        """Whether there were `PAST` seconds of past."""
        return len(self.features) > 3

    @classmethod
    def of(cls, past: Track, window: float) -> Situation:
        """Velocity by least squares over the last `window` s, accelerations over the last `PAST` s.

        The direction is the recorded heading: a slow agent's motion has none, and a velocity averaged over
        the past lags behind in a curve.
        """
        position, heading = past.positions[-1], float(past.headings[-1])
        ahead, left = (np.array([np.cos(a), np.sin(a)]) for a in (heading, heading + np.pi / 2))
        age = past.times - past.times[-1]
        if age[0] > SLACK - PAST:
            speed = float(past.speeds[-1])
            return cls(position, speed * ahead, heading, _features(speed))
        velocity = _least_squares(age, past.positions, window, 1)[1]
        acceleration = 2 * _least_squares(age, past.positions, PAST, 2)[2]
        speed = float(velocity @ ahead)
        motion = np.array([acceleration @ ahead, acceleration @ left, velocity @ left])
        features = np.append(_features(speed), np.log(NOISE + np.abs(motion)))
        return cls(position, speed * ahead, heading, features, motion)


@dataclass(frozen=True, eq=False)
class ConstantVelocity:
    """A constant-velocity Gaussian per agent.

    Attributes:
        past: spread where at least `PAST` seconds of past are known.
        initial: spread where only the last state is used.
        window: seconds over which the velocity is estimated.
        summary: how the parameters were fitted, and how well they are calibrated.
    """

    past: Spread
    initial: Spread
    window: float = 0.5
    summary: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "window", as_scalar("window", self.window, low=0.0, strict=True))
        for name, spread, count in (("past", self.past, 6), ("initial", self.initial, 3)):
            if len(spread.longitudinal) != count:
                got = len(spread.longitudinal)
                raise InputError(f"{name}: expected {count} coefficients per axis, got {got}")

    @classmethod
    def fitted(cls) -> ConstantVelocity:
        """The parameters shipped with the package."""
        return _shipped()

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> ConstantVelocity:
        """From what `to_dict` gave.

        Raises:
            InputError: naming the field.
        """
        try:
            past, initial = (Spread(**values[key]) for key in ("past", "initial"))
            return cls(past, initial, values["window"], values.get("summary", {}))
        except (KeyError, TypeError) as error:
            raise InputError(f"constant-velocity parameters: missing or unknown field: {error}") from None

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        spreads = {key: _plain(spread) for key, spread in (("past", self.past), ("initial", self.initial))}
        return {"window": self.window, **spreads, "summary": dict(self.summary)}

    def predict(self, past: Track, times: Any) -> GaussianMixturePrediction:
        """The agent at `times` (T,) ≥ 0 [s] after its last observed state, as one persistent Gaussian mode.

        Args:
            past: what was observed; with at least 2 s of it the velocity is estimated, else the last state's
                speed and heading hold.
            times: 0 is the last observation, uncertain by the spread's `start`.
        """
        as_instance("past", past, Track)
        times = as_times("times", times)
        if times[0] < 0:
            raise InputError(f"times[0]: expected a time >= 0 after the last observation, got {times[0]:g}")
        now = Situation.of(past, self.window)
        variances = (self.past if now.known else self.initial).variances(now.features, times)
        c, s = np.cos(now.heading), np.sin(now.heading)
        frame = np.array([[c, -s], [s, c]])
        covariances = np.einsum("ij,tj,kj->tik", frame, variances, frame)
        means = now.position + times[:, None] * now.velocity
        return GaussianMixturePrediction(
            times,
            np.ones(1),
            means[:, None],
            covariances[:, None],
            name=past.name,
            length=past.length,
            width=past.width,
            headings=np.full((len(times), 1), past.headings[-1]),
        )


def _features(speed: float) -> Array:
    s = np.log(0.1 + abs(speed))
    return np.array([1.0, s, s**2])


def _least_squares(age: Array, positions: Array, window: float, degree: int) -> Array:
    """(degree + 1, 2) coefficients of a polynomial in `age` (T,) ≤ 0 over the last `window` s."""
    recent = age >= -window - SLACK
    if np.count_nonzero(recent) <= degree:
        recent = np.arange(len(age)) >= len(age) - degree - 1
    # about the last position: city coordinates would cost digits
    origin = positions[-1]
    basis = np.vander(age[recent], degree + 1, increasing=True)
    coefficients: Array = np.linalg.lstsq(basis, positions[recent] - origin, rcond=None)[0]
    return coefficients


def _plain(spread: Spread) -> dict[str, Any]:
    return {
        "longitudinal": spread.longitudinal.tolist(),
        "lateral": spread.lateral.tolist(),
        "growth": spread.growth.tolist(),
        "start": spread.start,
    }


@cache
def _shipped() -> ConstantVelocity:
    text = resources.files("predictor").joinpath("data/constant_velocity.json").read_text(encoding="utf-8")
    return ConstantVelocity.from_dict(json.loads(text))
