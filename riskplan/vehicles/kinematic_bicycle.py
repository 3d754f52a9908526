"""`KinematicBicycle`: a car whose wheels take time to turn and whose tyres hold only so much."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from checkers import InputError
from checkers.validate import Array
from riskplan.vehicles.base import Metric, Vehicle, check_positive, packed

if TYPE_CHECKING:
    from checkers.kernels.abi import Kernel

GRAVITY = 9.80665


@dataclass(frozen=True)
class KinematicBicycle(Vehicle):
    """The kinematic bicycle about the body's centre (Kong, Pfeiffer, Schildbach & Borrelli 2015, eq. 1).

        ẋ = v cos(ψ + β), ẏ = v sin(ψ + β), ψ̇ = v cos β tan δ / wheelbase, β = atan(rear tan δ / wheelbase)

    with acceleration v̇ and steering rate δ̇ constant over a step of the grid. The centre's acceleration along and across
    its course, v̇ and v (ψ̇ + β̇), stays within the friction circle: v̇² + (v (ψ̇ + β̇))² ≤ (friction · g)².

    Attributes:
        length, width: of the body [m].
        wheelbase: [m].
        rear: from the rear axle to the centre, at most the wheelbase [m].
        max_acceleration, max_deceleration: [m/s²], both positive.
        max_steering: angle of the front wheel, below π/2 [rad].
        max_steering_rate: [rad/s].
        max_speed: [m/s].
        friction: coefficient of tyre and road.
    """

    type: ClassVar[str] = "bicycle"
    metric: ClassVar[Metric] = Metric(heading=3.0, speed=0.5, time=4.0)

    length: float = 4.5
    width: float = 1.8
    wheelbase: float = 2.7
    rear: float = 1.35
    max_acceleration: float = 4.0
    max_deceleration: float = 8.0
    max_steering: float = 0.6
    max_steering_rate: float = 0.5
    max_speed: float = 40.0
    friction: float = 0.9

    def __post_init__(self) -> None:
        check_positive(self)
        if self.max_steering > 1.5:
            raise InputError(f"vehicle.max_steering: expected a number in (0, 1.5] rad, got {self.max_steering:g}")
        if self.rear > self.wheelbase:
            raise InputError(f"vehicle.rear: expected at most the wheelbase {self.wheelbase:g} m, got {self.rear:g}")

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
        return min(self.max_acceleration, self.friction * GRAVITY)

    @property
    def top_turn(self) -> float:
        """Largest turn of the body per distance of its centre [1/m]."""
        tangent = math.tan(self.max_steering)
        return math.cos(math.atan(self.rear * tangent / self.wheelbase)) * tangent / self.wheelbase

    @property
    def top_steering(self) -> float:
        """Largest steering angle [rad]."""
        return self.max_steering

    @property
    def limits(self) -> Array:
        """(16,) what the kernel reads."""
        return packed(
            self.max_acceleration,
            self.max_deceleration,
            self.wheelbase,
            self.rear,
            self.max_steering,
            self.max_steering_rate,
            self.max_speed,
            self.friction * GRAVITY,
        )

    def sweep(self, speed: float, duration: float) -> tuple[float, float, float]:
        """As of `Vehicle`.

        With t = `top_turn`: ψ̇ ≤ t v, and v |ψ̇ + β̇| ≤ friction g =: G. The slip turns at most at b, so ψ̇ ≤ G / v + b,
        and the two meet at v = (b + √(b² + 4 t G)) / 2t. Across, the centre drifts by v sin β = rear ψ̇ and by the turn.
        """
        share = self.rear / self.wheelbase
        slip_rate = share / math.cos(self.max_steering) ** 2 * self.max_steering_rate
        grip, turn = self.friction * GRAVITY, self.top_turn
        worst = (slip_rate + math.sqrt(slip_rate**2 + 4 * turn * grip)) / (2 * turn)
        rate = turn * min(speed, worst)
        return speed * duration, self.rear * rate * duration + 0.5 * speed * rate * duration**2, rate * duration

    @property
    def kernel(self) -> Kernel:
        """One acceleration, two halves of a steering angle aimed at; the classical Runge-Kutta rule."""
        from riskplan.kernels.bicycle import steer  # noqa: PLC0415  numba costs import time

        return steer
