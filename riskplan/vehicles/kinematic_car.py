"""`KinematicCar`: a Dubins-like car whose curvature may jump."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from checkers.validate import Array
from riskplan.vehicles.base import CurveLimits, Metric, Vehicle, check_positive, packed

if TYPE_CHECKING:
    from checkers.kernels.abi import Kernel


@dataclass(frozen=True)
class KinematicCar(Vehicle):
    """Size and limits of the ego: a point moving along its heading with bounded acceleration and curvature.

    Attributes:
        length, width: of the body, for static obstacles and pictures [m].
        max_acceleration, max_deceleration: [m/s²], both positive.
        max_curvature: [1/m].
        max_speed: [m/s].
        max_lateral_acceleration: limit of speed² × curvature [m/s²].
    """

    type: ClassVar[str] = "car"
    metric: ClassVar[Metric] = Metric(heading=3.0, speed=0.5, time=4.0)

    length: float = 4.5
    width: float = 1.8
    max_acceleration: float = 4.0
    max_deceleration: float = 8.0
    max_curvature: float = 0.2
    max_speed: float = 40.0
    max_lateral_acceleration: float = 5.0

    def __post_init__(self) -> None:
        check_positive(self)

    @property
    def body(self) -> tuple[float, float]:
        """Length and width [m]."""
        return self.length, self.width

    @property
    def top_speed(self) -> float:
        """Largest speed [m/s]."""
        return self.max_speed

    @property
    def top_acceleration(self) -> float:
        """Largest acceleration [m/s²]."""
        return self.max_acceleration

    @property
    def top_turn(self) -> float:
        """Largest turn per distance [1/m]."""
        return self.max_curvature

    @property
    def curves(self) -> CurveLimits:
        """All of its limits: it follows any arcs and straights."""
        return CurveLimits(
            self.max_acceleration,
            self.max_deceleration,
            self.max_curvature,
            self.max_speed,
            self.max_lateral_acceleration,
        )

    @property
    def limits(self) -> Array:
        """(16,) what the kernel reads."""
        return packed(*self.curves)

    def sweep(self, speed: float, duration: float) -> tuple[float, float, float]:
        """As of `Vehicle`: it turns at κ v with κ v² ≤ the lateral limit, so at most √(κ × that limit)."""
        rate = self.max_curvature * min(speed, math.sqrt(self.max_lateral_acceleration / self.max_curvature))
        lateral = min(self.max_lateral_acceleration, self.max_curvature * speed**2)
        return speed * duration, 0.5 * lateral * duration**2, rate * duration

    @property
    def kernel(self) -> Kernel:
        """Constant acceleration, two halves of constant curvature."""
        from riskplan.kernels.car import steer  # noqa: PLC0415  numba costs import time

        return steer
