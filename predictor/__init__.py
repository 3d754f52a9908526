"""Predictors of what other agents may do: from a recorded past to a Gaussian mixture.

What needs torch (the extra `predictor`) is imported on first use.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from predictor.adapters import from_gmm2d, from_mode_gaussians, from_trajectories
from predictor.constant_velocity import ConstantVelocity
from predictor.frames import Frames
from predictor.growth import PowerGrowth
from predictor.manoeuvres import Manoeuvres
from predictor.recordings import DataSet, Recording, open_data
from predictor.tracks import Track

if TYPE_CHECKING:
    from predictor.learned import LearnedPredictor

__all__ = [
    "ConstantVelocity",
    "DataSet",
    "Frames",
    "LearnedPredictor",
    "Manoeuvres",
    "PowerGrowth",
    "Recording",
    "Track",
    "from_gmm2d",
    "from_mode_gaussians",
    "from_trajectories",
    "open_data",
]

# name -> module that needs torch
_LEARNED = {"LearnedPredictor": "predictor.learned"}


def __getattr__(name: str) -> Any:
    if name not in _LEARNED:
        raise AttributeError(f"module 'predictor' has no attribute {name!r}")
    try:
        return getattr(import_module(_LEARNED[name]), name)
    except ModuleNotFoundError as error:
        if error.name not in ("torch", "safetensors"):
            raise
        from checkers import InputError  # noqa: PLC0415

        raise InputError(f"{name} needs {error.name}: pip install '.[predictor]' in the checkout") from None
