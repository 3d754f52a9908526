"""What a vehicle tells the planners. One file a vehicle: its limits, its motion, its metric."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import fields
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from checkers import EgoCover, EgoShape, InputError
from checkers.validate import FARTHEST, LARGEST_BODY, Array, as_scalar

if TYPE_CHECKING:
    from checkers.kernels.abi import Kernel


class Metric(NamedTuple):
    """How far apart two states are, in metres: what a tree's nearest neighbour sees.

    Attributes:
        heading: of a radian [m/rad].
        speed: of a metre per second [s].
        time: of a second [m/s].
    """

    heading: float
    speed: float
    time: float


class CurveLimits(NamedTuple):
    """Limits under which the vehicle can follow arcs and straights at changing speed; in the order kernels read.

    Attributes:
        acceleration, deceleration: along the curve [m/s²], both positive.
        curvature: of the arcs [1/m]; it may jump where they meet.
        speed: [m/s].
        lateral: largest speed² × curvature [m/s²].
        reverse: speed backwards [m/s]; 0 for a vehicle that a roadmap drives forwards only.
    """

    acceleration: float
    deceleration: float
    curvature: float
    speed: float
    lateral: float
    reverse: float = 0.0


class Vehicle(ABC):
    """Size, limits and motion of the ego: the base of frozen dataclasses, whose fields are their parameters.

    The state is the pose of the body's centre, its speed, and a steering angle where the vehicle has one.
    """

    type: ClassVar[str]  # its name in scenario files
    metric: ClassVar[Metric]
    reverses: ClassVar[bool] = False  # whether the speed may be negative
    disc: ClassVar[bool] = False  # whether the body is a disc, not a rectangle

    @property
    @abstractmethod
    def body(self) -> tuple[float, float]:
        """Length and width [m]."""

    @property
    @abstractmethod
    def top_speed(self) -> float:
        """Largest speed, either way [m/s]."""

    @property
    @abstractmethod
    def top_acceleration(self) -> float:
        """Largest rate at which it gains speed [m/s²]."""

    @property
    @abstractmethod
    def top_turn(self) -> float:
        """Largest turn per distance [1/m]; infinite for a body whose heading does not matter."""

    @property
    @abstractmethod
    def kernel(self) -> Kernel:
        """The compiled motion, see `riskplan.kernels.steer`."""

    @property
    @abstractmethod
    def limits(self) -> Array:
        """(16,) what the kernel reads."""

    @property
    def curves(self) -> CurveLimits | None:
        """Limits for a roadmap's arcs and straights; None for a vehicle that cannot follow them."""
        return None

    @property
    def top_steering(self) -> float:
        """Largest steering angle [rad]; 0 for a vehicle without one."""
        return 0.0

    def sweep(self, speed: float, duration: float) -> tuple[float, float, float]:
        """Bounds of how far a pose within `duration` [s] is from this one, at speeds up to `speed` either way.

        Returns:
            displacement of the centre along the heading and across it [m], and turn [rad].
        """
        along = speed * duration
        turn = self.top_turn * along
        return along, min(along, 0.5 * turn * along), turn

    def shape(self) -> EgoShape:
        """A shape for the risk that holds the body and each agent's own size, at any heading: six discs."""
        return EgoCover.discs(*self.body)

    def check_state(self, speed: float, steering: float) -> None:
        """Refuse a start that the vehicle cannot be in; a speed above its limit may have come about otherwise."""
        if speed < 0 and not self.reverses:
            raise InputError(f"start.speed: expected a number >= 0 for a {type(self).__name__}, got {speed:g}")
        if abs(steering) > self.top_steering:
            raise InputError(
                f"start.steering: expected at most {self.top_steering:g} rad either way "
                f"for a {type(self).__name__}, got {steering:g}"
            )


def check_positive(vehicle: Any) -> None:
    """Every field of a vehicle is a number > 0."""
    for f in fields(vehicle):
        most = LARGEST_BODY if f.name in ("length", "width", "radius", "wheelbase", "rear") else FARTHEST
        value = as_scalar(f"vehicle.{f.name}", getattr(vehicle, f.name), low=0.0, high=most, strict=True)
        object.__setattr__(vehicle, f.name, value)


def packed(*values: float) -> Array:
    """Limits as an array of the length all kernels share."""
    out = np.zeros(16)
    out[: len(values)] = values
    return out


def curve_limits(vehicle: Vehicle) -> CurveLimits:
    """Limits for a roadmap's curves.

    Raises:
        InputError: for a vehicle that cannot follow them.
    """
    if vehicle.curves is None:
        raise InputError(
            f"vehicle: a {type(vehicle).__name__} cannot follow a roadmap's arcs and straights, where the curvature "
            "jumps; expected a planner over controls, such as 'rrt'"
        )
    return vehicle.curves
