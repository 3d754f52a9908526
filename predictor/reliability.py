"""Whether stated collision risk is true: trajectories like an ego's are thrown at recorded agents.

For each window a disc drives straight on past where the agent may be; the risk stated for it, from the prediction
alone, is set against whether the recorded agent was hit. Where and how it drives is drawn blind to the future.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from checkers.backends.monte_carlo import clopper_pearson
from checkers.validate import Array
from predictor.forecasts import Forecasts, lower

EDGES = (0.0, 0.01, 0.03, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0)
RADIUS = 2.5  # two cars abreast, roughly [m]
_CHUNK = 64


@dataclass(frozen=True, eq=False)
class Reliability:
    """Bins of stated risk against what happened.

    Attributes:
        count: (B,) trajectories per bin; empty bins are left out.
        stated: (B,) mean stated risk.
        observed: (B,) share that hit the recorded agent.
        low, high: (B,) 95 % Clopper-Pearson interval of `observed`.
        expected, hits: totals over all trajectories.
    """

    count: Array
    stated: Array
    observed: Array
    low: Array
    high: Array
    expected: float
    hits: int

    @classmethod
    def of(cls, stated: Array, hit: Array) -> Reliability:
        """From stated risks (M,) and outcomes (M,)."""
        place = np.clip(np.searchsorted(EDGES, stated, side="right") - 1, 0, len(EDGES) - 2)
        used = [b for b in range(len(EDGES) - 1) if (place == b).any()]
        count = np.array([(place == b).sum() for b in used], dtype=float)
        hits = np.array([hit[place == b].sum() for b in used], dtype=float)
        bounds = [clopper_pearson(np.array([h]), int(n), 0.95) for h, n in zip(hits, count, strict=True)]
        low, high = (np.array([float(b[i][0]) for b in bounds]) for i in range(2))
        means = np.array([stated[place == b].mean() for b in used])
        return cls(count, means, hits / count, low, high, float(stated.sum()), int(hits.sum()))


def thrown(forecasts: Forecasts, rng: np.random.Generator, spread: float = 4.0) -> Array:
    """(N, T, 2) straight trajectories past each agent: at a random step, near where one of its modes then is.

    The distance from there is normal with `spread` [m] in each direction; the velocity is the mode's, with an error of
    a quarter of it and 1 m/s in each direction.
    """
    n, steps = forecasts.means.shape[:2]
    rows, at = np.arange(n), rng.integers(steps // 3, steps, n)
    mode = (rng.random((n, 1)) > np.cumsum(forecasts.weights[rows, at], axis=-1)[:, :-1]).sum(axis=-1)
    place = forecasts.means[rows, at, mode] + spread * rng.standard_normal((n, 2))
    way = forecasts.means[rows, -1, mode] - forecasts.means[rows, 0, mode]
    velocity = way / (forecasts.times[-1] - forecasts.times[0])
    size = 1.0 + 0.25 * np.hypot(velocity[:, :1], velocity[:, 1:])
    velocity = velocity + size * rng.standard_normal((n, 2))
    ahead = forecasts.times[None, :] - forecasts.times[at][:, None]
    out: Array = place[:, None] + ahead[..., None] * velocity[:, None]
    return out


def hits(points: Array, ego: Array, radius: float = RADIUS) -> Array:
    """Whether trajectories (..., T, 2) come within `radius` [m] of the ego's at some step."""
    close: Array = (np.square(points - ego).sum(axis=-1) <= radius**2).any(axis=-1)
    return close


def stated_risk(
    forecasts: Forecasts, ego: Array, rng: np.random.Generator, samples: int = 500, radius: float = RADIUS
) -> Array:
    """(N,) probability that the agent comes within `radius` of the ego at some step, by sampling whole trajectories.

    Errors persist as the forecasts' factors say; without factors they are independent from step to step.
    """
    parts = []
    for start in range(0, len(forecasts), _CHUNK):
        rows = slice(start, start + _CHUNK)
        drawn = _sampled(forecasts.of(rows), samples, rng)
        parts.append(hits(drawn, ego[rows][:, None], radius).mean(axis=1))
    return np.concatenate(parts)


def without_factors(forecasts: Forecasts) -> Forecasts:
    """The same positions at each step, errors independent over time."""
    return replace(forecasts, factors=None)


def _sampled(forecasts: Forecasts, samples: int, rng: np.random.Generator) -> Array:
    """(N, S, T, 2)."""
    n, steps, _ = forecasts.weights.shape
    own = forecasts.covariances
    if forecasts.factors is not None:
        own = own - forecasts.factors @ np.swapaxes(forecasts.factors, -1, -2)
    roots = lower(own)
    bounds = np.cumsum(forecasts.weights, axis=-1)[:, None, :, :-1]
    draws = (n, samples, 1 if forecasts.modes == "persistent" else steps, 1)
    mode = np.broadcast_to((rng.random(draws) > bounds).sum(axis=-1), (n, samples, steps))
    pick = np.arange(n)[:, None, None], np.arange(steps), mode
    noise = rng.standard_normal((n, samples, steps, 2))
    out: Array = forecasts.means[pick] + np.einsum("nstij,nstj->nsti", roots[pick], noise)
    if forecasts.factors is not None:
        xi = rng.standard_normal((n, samples, forecasts.factors.shape[-1]))
        out = out + np.einsum("nstir,nsr->nsti", forecasts.factors[pick], xi)
    return out
