"""Making stated spreads true: one factor on the variance per horizon, fitted on data not trained on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from checkers.validate import Array, InputError, as_array, as_times
from predictor.forecasts import Forecasts
from predictor.metrics import region_mass

LEVEL = 0.9
KNOTS = 8
TOLERANCE = 0.01
_RANGE = (1e-3, 1e3)
_HALVINGS = 12  # to 0.3 % of a factor


@dataclass(frozen=True, eq=False)
class Recalibration:
    """Factors on the variance at some times; in between their logarithms are interpolated, outside the nearest holds.

    Attributes:
        times: (H,) [s].
        variances: (H,) factors > 0.
    """

    times: Array
    variances: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "times", as_times("times", self.times))
        object.__setattr__(self, "variances", as_array("variances", self.variances, (len(self.times),)))
        if np.any(self.variances <= 0):
            raise InputError(f"variances: expected factors > 0, got {self.variances.tolist()}")

    @classmethod
    def fitted(cls, forecasts: Forecasts, truth: Array, level: float = LEVEL) -> Recalibration:
        """So that at `KNOTS` times the highest-density region of mass `level` holds that share of truth (N, T, 2).

        Where many factors do so up to `TOLERANCE`, the one nearest to 1: a share often hardly depends on the factor, as
        most agents keep to a narrow course and the others are far from it, and then the data say nothing of it.
        """
        steps = len(forecasts.times)
        rows = (
            np.unique(np.geomspace(1, steps, KNOTS).round().astype(int)) - 1
        )  # factors change most at the first steps
        times = forecasts.times[rows]

        def least(wanted: float) -> Array:
            """(H,) logarithms of the least factors with that share inside, by bisection."""
            low, high = (np.full(len(rows), np.log(v)) for v in _RANGE)
            for _ in range(_HALVINGS):
                centre = 0.5 * (low + high)
                tried = cls(times, np.exp(centre)).apply(forecasts)
                inside = (region_mass(tried, truth, rows, samples=128) <= level).mean(axis=0)
                low, high = np.where(inside < wanted, centre, low), np.where(inside < wanted, high, centre)
            middle: Array = 0.5 * (low + high)
            return middle

        return cls(times, np.exp(np.clip(0.0, least(level - TOLERANCE), least(level + TOLERANCE))))

    def at(self, times: Array) -> Array:
        """(T,) factors at times [s]."""
        out: Array = np.exp(np.interp(times, self.times, np.log(self.variances)))
        return out

    def apply(self, forecasts: Forecasts) -> Forecasts:
        """The forecasts with scaled variances; means, weights and correlations over time stay."""
        return forecasts.scaled(self.at(forecasts.times))

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {"times": self.times.tolist(), "variances": self.variances.tolist()}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Recalibration:
        """From what `to_dict` gave."""
        try:
            return cls(**values)
        except TypeError as error:
            raise InputError(f"recalibration: missing or unknown field: {error}") from None
