"""`PointRobot`: a round robot that can push in any direction."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from checkers import EgoCover, EgoShape
from checkers.validate import Array
from riskplan.vehicles.base import CurveLimits, Metric, Vehicle, check_positive, packed

if TYPE_CHECKING:
    from checkers.kernels.abi import Kernel


@dataclass(frozen=True)
class PointRobot(Vehicle):
    """A disc that accelerates in any direction; its heading is that of its motion, and stays when it stands.

    Attributes:
        radius: of the body [m].
        max_acceleration: in any direction [m/s²].
        max_speed: [m/s].
    """

    type: ClassVar[str] = "point"
    metric: ClassVar[Metric] = Metric(heading=0.3, speed=0.5, time=1.0)
    disc: ClassVar[bool] = True

    radius: float = 0.3
    max_acceleration: float = 2.0
    max_speed: float = 2.0

    def __post_init__(self) -> None:
        check_positive(self)

    @property
    def body(self) -> tuple[float, float]:
        """Sides of the square around the disc [m]."""
        return 2 * self.radius, 2 * self.radius

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
        """It turns as it likes."""
        return math.inf

    @property
    def curves(self) -> CurveLimits:
        """Half of the squared acceleration along the curve, half across: together within the limit."""
        share = self.max_acceleration / math.sqrt(2.0)
        return CurveLimits(share, share, 2.0 / self.radius, self.max_speed, share)

    @property
    def limits(self) -> Array:
        """(16,) what the kernel reads."""
        return packed(self.max_acceleration, self.max_speed)

    def sweep(self, speed: float, duration: float) -> tuple[float, float, float]:
        """As of `Vehicle`: any way; the turn of a disc is none."""
        return speed * duration, speed * duration, 0.0

    @property
    def kernel(self) -> Kernel:
        """Two halves of constant acceleration: exact parabolas."""
        from riskplan.kernels.point import steer  # noqa: PLC0415  numba costs import time

        return steer

    def shape(self) -> EgoShape:
        """The disc itself: one disc around the square inscribed in it."""
        side = math.sqrt(2.0) * self.radius
        return EgoCover.discs(side, side, 1)
