"""Collision primitives: the probability that a predicted agent enters the ego's shape at a pose.

The value types are imported at once; the backends, which need numba, on first use.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from checkers import dynamics
from checkers.agents import Prediction, load_prediction
from checkers.control_prediction import ControlPrediction, propagate
from checkers.dependence import fit_factors, leading_factors
from checkers.distributions import Beta, Exponential, Gamma, Normal, Triangular, Uniform
from checkers.joint_normal import JointNormal
from checkers.kind import Kind
from checkers.merge import merged
from checkers.over_time import as_gaussian, covariance_over_time, with_factors
from checkers.persistence import persistent
from checkers.prediction import GaussianMixturePrediction, MomentPrediction
from checkers.random_variables import (
    Constant,
    Discrete,
    Mixture,
    RandomVariable,
    as_random_variable,
    trigonometric_moment,
)
from checkers.risk import DEPENDENCE, PATH_DEPENDENCE, Risk, TrajectoryRisk, trajectory_risk
from checkers.risk_gradient import trajectory_risk_gradient
from checkers.shapes import EgoBox, EgoCover, EgoEllipsoid, EgoShape
from checkers.validate import InputError

if TYPE_CHECKING:
    from checkers.base import Checker, CheckerInfo
    from checkers.hunter import hunter_bound
    from checkers.path import PathRisk, path_risk
    from checkers.registry import checker, checkers

_LATER = {
    "Checker": "checkers.base",
    "CheckerInfo": "checkers.base",
    "checker": "checkers.registry",
    "checkers": "checkers.registry",
    "PathRisk": "checkers.path",
    "path_risk": "checkers.path",
    "hunter_bound": "checkers.hunter",
}

__all__ = [
    "DEPENDENCE",
    "PATH_DEPENDENCE",
    "Beta",
    "Checker",
    "CheckerInfo",
    "Constant",
    "ControlPrediction",
    "Discrete",
    "EgoBox",
    "EgoCover",
    "EgoEllipsoid",
    "EgoShape",
    "Exponential",
    "Gamma",
    "GaussianMixturePrediction",
    "InputError",
    "JointNormal",
    "Kind",
    "Mixture",
    "MomentPrediction",
    "Normal",
    "PathRisk",
    "Prediction",
    "RandomVariable",
    "Risk",
    "TrajectoryRisk",
    "Triangular",
    "Uniform",
    "as_gaussian",
    "as_random_variable",
    "checker",
    "checkers",
    "covariance_over_time",
    "dynamics",
    "hunter_bound",
    "load_prediction",
    "merged",
    "propagate",
    "fit_factors",
    "leading_factors",
    "load_prediction",
    "path_risk",
    "persistent",
    "trajectory_risk",
    "trajectory_risk_gradient",
    "trigonometric_moment",
    "with_factors",
]


def __getattr__(name: str) -> Any:
    if name not in _LATER:
        raise AttributeError(f"module 'checkers' has no attribute {name!r}")
    return getattr(import_module(_LATER[name]), name)
