"""Collision primitives: the probability that a predicted agent enters the ego's shape at a pose.

The value types are imported at once; the backends, which need numba, on first use.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from checkers.kind import Kind
from checkers.prediction import GaussianMixturePrediction, MomentPrediction, Prediction, load_prediction
from checkers.risk import DEPENDENCE, Risk, TrajectoryRisk, trajectory_risk
from checkers.shapes import EgoCover, EgoEllipsoid, EgoShape
from checkers.validate import InputError

if TYPE_CHECKING:
    from checkers.base import Checker, CheckerInfo
    from checkers.registry import checker, checkers

_LATER = {
    "Checker": "checkers.base",
    "CheckerInfo": "checkers.base",
    "checker": "checkers.registry",
    "checkers": "checkers.registry",
}

__all__ = [
    "DEPENDENCE",
    "Checker",
    "CheckerInfo",
    "EgoCover",
    "EgoEllipsoid",
    "EgoShape",
    "GaussianMixturePrediction",
    "InputError",
    "Kind",
    "MomentPrediction",
    "Prediction",
    "Risk",
    "TrajectoryRisk",
    "checker",
    "checkers",
    "load_prediction",
    "trajectory_risk",
]


def __getattr__(name: str) -> Any:
    if name not in _LATER:
        raise AttributeError(f"module 'checkers' has no attribute {name!r}")
    return getattr(import_module(_LATER[name]), name)
