"""Collision primitives: the probability that a predicted agent enters the ego's shape at a pose."""

from checkers.kind import Kind
from checkers.prediction import GaussianMixturePrediction, MomentPrediction, Prediction, load_prediction
from checkers.risk import DEPENDENCE, Risk, TrajectoryRisk, trajectory_risk
from checkers.shapes import EgoCover, EgoEllipsoid, EgoShape
from checkers.validate import InputError

__all__ = [
    "DEPENDENCE",
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
    "load_prediction",
    "trajectory_risk",
]
