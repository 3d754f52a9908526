"""The vehicles planned for, a file each; adding one is one file and one line."""

from __future__ import annotations

from importlib import import_module

from riskplan.vehicles.base import CurveLimits, Metric, Vehicle, curve_limits

__all__ = ["VEHICLES", "CurveLimits", "Metric", "Vehicle", "curve_limits", "vehicle_class"]

# name in scenario files -> module:class; imported when first used, since kernels cost import time
VEHICLES = {
    "car": "kinematic_car:KinematicCar",
    "reeds-shepp": "reeds_shepp_car:ReedsSheppCar",
    "bicycle": "kinematic_bicycle:KinematicBicycle",
    "point": "point_robot:PointRobot",
}


def vehicle_class(name: str) -> type[Vehicle]:
    """The vehicle of that name in scenario files."""
    module, cls = VEHICLES[name].split(":")
    found: type[Vehicle] = getattr(import_module(f"riskplan.vehicles.{module}"), cls)
    return found
