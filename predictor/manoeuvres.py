"""A few things that a driver may do, each a Gaussian whose error persists, fitted to recorded traffic.

An agent drives at speed v; in the frame of its heading it is at time t

    ahead:  v t + m t^p + e^σ t^p ξ₁
    left:   λ (b(t) + u r (1 − e^{−t/r})) + m t^p + e^σ t^p ξ₂        ξ ~ N(0, I), drawn once

with b(t) how far to the left its lane leads and u its speed across the lane, which it sheds within r seconds. Each
axis is a mixture of a few such manoeuvres with m, p, σ, λ, r of its own; the modes are all pairs of one ahead and one
to the left. m, σ and the logits of the weights are linear in features of the situation (`situation_features`): speed,
accelerations, lateral speed, gap and closing speed to the leader, offset from the lane's centre, whether there are
lanes and bodies beside. All is fitted by maximum likelihood of whole trajectories (`predictor.fit_manoeuvres`). Left
and right are alike: only what is odd under mirroring moves an agent aside.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cache
from importlib import resources
from typing import Any

import numpy as np

from checkers.prediction import GaussianMixturePrediction
from checkers.validate import Array, InputError, as_array, as_instance, as_scalar, as_times, as_tuple
from predictor.constant_velocity import Situation
from predictor.lanes import Lane
from predictor.surroundings import Surroundings, look_around
from predictor.tracks import Track

EVEN = ("one", "speed", "speed²", "near", "closing", "taken", "open")
EVEN_OF_PAST = ("ahead", "left", "drift", "acceleration")
ODD = ("offset", "lane", "taken", "open")
ODD_OF_PAST = ("acceleration", "speed")
# gap at which a leader's influence has fallen to 1/e [m]
GAP = 30.0
# slower than this [m/s], a body does not turn to where its mean goes
TURNING = 2.0
_INSTANT = 0.05


@dataclass(frozen=True, eq=False)
class Axis:
    """Parameters of the K manoeuvres along one axis, of E features even under mirroring and M that move the mean.

    Attributes:
        choice: (K, E) coefficients of the logits.
        mean: (K, M) of m; the even features ahead, the odd ones to the left.
        spread: (K, E) of σ.
        growth: (K,) p.
        lane: (K,) λ, 0 ahead.
        relaxation: (K,) r [s].
        rest: (K,) size, relative to e^σ t^p, of errors that came out independent at steps of 0.5 s.
    """

    choice: Array
    mean: Array
    spread: Array
    growth: Array
    lane: Array
    relaxation: Array
    rest: Array

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "choice", as_array("choice", self.choice, ("K", "E")))
        count = len(self.choice)
        put(self, "mean", as_array("mean", self.mean, (count, "M")))
        put(self, "spread", as_array("spread", self.spread, self.choice.shape))
        for name in ("growth", "lane", "relaxation", "rest"):
            put(self, name, as_array(name, getattr(self, name), (count,)))
            if name in ("growth", "relaxation") and (getattr(self, name) <= 0).any():
                raise InputError(f"{name}: expected numbers > 0, got {getattr(self, name).tolist()}")

    def weights(self, even: Array) -> Array:
        """(N, K) of features (N, E)."""
        logits = even @ self.choice.T
        odds = np.exp(logits - logits.max(axis=1, keepdims=True))
        found: Array = odds / odds.sum(axis=1, keepdims=True)
        return found

    def courses(self, even: Array, moving: Array, lead: tuple[Array, Array], times: Array) -> tuple[Array, Array]:
        """Means beside constant velocity, and standard deviations without that of the observation, (N, K, T)."""
        means, spreads = courses_of(self.__dict__, even, moving, lead, times)
        return means, np.sqrt(1 + self.rest[:, None] ** 2) * spreads

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return _plain(self)


def courses_of(values: Mapping[str, Any], even: Any, moving: Any, lead: tuple[Any, Any], times: Any) -> tuple[Any, Any]:
    """Means beside constant velocity and e^σ t^p, (N, K, T), for arrays of numpy or torch.

    Args:
        values: of an `Axis`, by name.
        even: (N, E) features.
        moving: (N, M) features that move the mean.
        lead: (N, T) b, (N,) u.
        times: (T,) [s].
    """
    power = times ** values["growth"][:, None]
    relaxation = values["relaxation"][:, None]
    shed = relaxation * (1 - math.e ** (-times / relaxation))
    way = values["lane"][:, None] * (lead[0][:, None] + lead[1][:, None, None] * shed)
    means = way + (moving @ values["mean"].T)[..., None] * power
    return means, (math.e ** (even @ values["spread"].T))[..., None] * power


@dataclass(frozen=True, eq=False)
class Mixture:
    """Parameters for one amount of knowledge.

    Attributes:
        ahead, left: the axes.
        start: standard deviation of the observed position [m].
        even_range: (2, E) lowest and highest value of each feature; beyond, it counts as that.
        odd_range: (O,) largest absolute value.
    """

    ahead: Axis
    left: Axis
    start: float
    even_range: Array
    odd_range: Array

    def __post_init__(self) -> None:
        put = object.__setattr__
        for name in ("ahead", "left"):
            if not isinstance(getattr(self, name), Axis):
                put(self, name, Axis(**getattr(self, name)))
        even = self.ahead.choice.shape[1]
        put(self, "even_range", as_array("even_range", self.even_range, (2, even)))
        put(self, "odd_range", as_array("odd_range", self.odd_range, (self.left.mean.shape[1],)))
        put(self, "start", as_scalar("start", self.start, low=0.0, strict=True))
        if self.left.choice.shape[1] != even or self.ahead.mean.shape[1] != even:
            raise InputError(
                f"left: expected {even} even features on both axes, got {self.left.choice.shape[1]} "
                f"and {self.ahead.mean.shape[1]}"
            )

    def clipped(self, even: Array, odd: Array) -> tuple[Array, Array]:
        """Features within the ranges."""
        return np.clip(even, *self.even_range), np.clip(odd, -self.odd_range, self.odd_range)

    def stated(self, even: Array, odd: Array, bends: Array, drift: Array, times: Array) -> tuple[Array, Array, Array]:
        """Weights (N, K), means beside constant velocity and standard deviations (N, K, T, 2), ahead and to the left.

        Args:
            even, odd: (N, E), (N, O) features.
            bends: (N, T) of the lane, to the left [m].
            drift: (N,) speed across the lane, to the left [m/s].
            times: (T,) [s].
        """
        even, odd = self.clipped(even, odd)
        nothing = np.zeros_like(bends), np.zeros_like(drift)
        weights = self.ahead.weights(even)[:, :, None] * self.left.weights(even)[:, None]
        first, second = weights.shape[1:]
        parts = self.ahead.courses(even, even, nothing, times), self.left.courses(even, odd, (bends, drift), times)
        pairs = [
            np.stack([np.repeat(a, second, axis=1), np.tile(b, (1, first, 1))], axis=-1)
            for a, b in zip(*parts, strict=True)
        ]
        return weights.reshape(len(weights), -1), pairs[0], np.sqrt(self.start**2 + pairs[1] ** 2)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return _plain(self)


def _plain(value: Any) -> dict[str, Any]:
    plain: dict[str, Any] = {}
    for f in fields(value):
        v = getattr(value, f.name)
        plain[f.name] = v.round(6).tolist() if isinstance(v, np.ndarray) else v.to_dict() if isinstance(v, Axis) else v
    return plain


def situation_features(situation: Situation, around: Surroundings) -> tuple[Array, Array]:
    """Features even (E,) and odd (O,) under mirroring: `EVEN` and `ODD`, and with known past `…_OF_PAST` too.

    Even: 1, s, s² with s = log(0.1 + speed); e^(−gap/30 m) and the leader's relative speed times it; how many sides are
    taken by a body, and open to a lane; the logarithms of `Situation.features`; the acceleration ahead. Odd, to the
    left: offset from the lane's centre, speed across it, sides taken, sides open; acceleration and speed aside.
    """
    near = math.exp(-around.gap / GAP)
    speed = float(situation.velocity @ [math.cos(situation.heading), math.sin(situation.heading)])
    even = [*situation.features[:3], near, near * around.closing, sum(around.taken), sum(around.open)]
    sides = [around.taken[0] - around.taken[1], around.open[0] - around.open[1]]
    odd = [around.offset, speed * around.drift, *sides]
    if situation.known:
        even += [*situation.features[3:], situation.motion[0]]
        odd += [*situation.motion[1:]]
    return np.array(even), np.array(odd)


@dataclass(frozen=True, eq=False)
class Manoeuvres:
    """Several modes per agent, in which errors persist.

    Attributes:
        past: parameters where at least 2 s of past are known.
        initial: parameters where only the last state is used.
        window: seconds over which the velocity is estimated.
        summary: how the parameters were fitted, and how well they are calibrated.
    """

    past: Mixture
    initial: Mixture
    window: float = 0.5
    summary: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "window", as_scalar("window", self.window, low=0.0, strict=True))
        sizes = {
            "past": (len(EVEN + EVEN_OF_PAST), len(ODD + ODD_OF_PAST)),
            "initial": (len(EVEN), len(ODD)),
        }
        for name, (even, odd) in sizes.items():
            got = getattr(self, name)
            counts = got.ahead.mean.shape[1], got.left.mean.shape[1]
            if counts != (even, odd):
                raise InputError(
                    f"{name}: expected {even} even and {odd} odd features, got {counts[0]} and {counts[1]}"
                )

    @classmethod
    def fitted(cls) -> Manoeuvres:
        """The parameters shipped with the package."""
        return _shipped()

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Manoeuvres:
        """From what `to_dict` gave.

        Raises:
            InputError: naming the field.
        """
        try:
            past, initial = (Mixture(**values[key]) for key in ("past", "initial"))
            return cls(past, initial, values["window"], values.get("summary", {}))
        except (KeyError, TypeError) as error:
            raise InputError(f"manoeuvre parameters: missing or unknown field: {error}") from None

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        parts = {"past": self.past.to_dict(), "initial": self.initial.to_dict()}
        return {"window": self.window, **parts, "summary": dict(self.summary)}

    def predict(
        self, past: Track, times: Any, lanes: Sequence[Lane] = (), others: Sequence[Track] = ()
    ) -> GaussianMixturePrediction:
        """The agent at `times` (T,) ≥ 0 [s] after its last observed state, as K persistent modes with factors.

        Args:
            past: what was observed; with at least 2 s of it velocity and accelerations are estimated.
            times: 0 is the last observation, uncertain by `start`.
            lanes: of the map; without them it goes straight on.
            others: what is known of other agents, on the same clock; who was not observed last when `past` was, is not
                there. The ego belongs to them.
        """
        as_instance("past", past, Track)
        as_tuple("lanes", lanes, Lane)
        as_tuple("others", others, Track)
        times = as_times("times", times)
        if times[0] < 0:
            raise InputError(f"times[0]: expected a time >= 0 after the last observation, got {times[0]:g}")
        now = Situation.of(past, self.window)
        c, s = np.cos(now.heading), np.sin(now.heading)
        frame = np.array([[c, -s], [s, c]])
        speed = float(now.velocity @ frame[:, 0])
        around = look_around(past, speed, lanes, others)
        known = self.past if now.known else self.initial
        even, odd = situation_features(now, around)

        def local(at: Array) -> tuple[Array, Array, Array]:
            """Weights (K,), means and deviations (T, K, 2) in the frame of the heading."""
            bends = (around.course(speed * at)[0] - now.position) @ frame[:, 1]
            weights, *courses = known.stated(even[None], odd[None], bends[None], odd[None, 1], at)
            means, deviations = (np.swapaxes(v[0], 0, 1) for v in courses)
            means[..., 0] += speed * at[:, None]
            return weights[0], means, deviations

        weights, means, deviations = local(times)
        before = np.maximum(times - _INSTANT, 0.0)
        step = (local(times + _INSTANT)[1] - local(before)[1]) / (times + _INSTANT - before)[:, None, None]
        turned = np.arctan2(step[..., 1], np.maximum(step[..., 0], TURNING))
        factors = frame * deviations[..., None, :]
        return GaussianMixturePrediction(
            times,
            weights,
            now.position + means @ frame.T,
            factors @ np.swapaxes(factors, -1, -2),
            name=past.name,
            length=past.length,
            width=past.width,
            headings=now.heading + turned,
            factors=factors,
        )


@cache
def _shipped() -> Manoeuvres:
    text = resources.files("predictor").joinpath("data/manoeuvres.json").read_text(encoding="utf-8")
    return Manoeuvres.from_dict(json.loads(text))
