"""Predictors of what other agents may do: from a recorded past to a Gaussian mixture."""

from predictor.constant_velocity import ConstantVelocity
from predictor.tracks import Track

__all__ = ["ConstantVelocity", "Track"]
