"""All kinds of predicted agents, and reading one from a file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from checkers.archive import read_arrays
from checkers.control_prediction import ControlPrediction
from checkers.prediction import GaussianMixturePrediction, MomentPrediction
from checkers.validate import InputError, as_option

Prediction = GaussianMixturePrediction | MomentPrediction | ControlPrediction
AGENTS = (GaussianMixturePrediction, MomentPrediction, ControlPrediction)


def load_prediction(path: str | Path) -> Prediction:
    """Read what `save` wrote; files with pickled objects are refused."""
    values = read_arrays(path, "prediction file")
    kind = str(values.pop("type", ""))
    as_option(f"{path}: type", kind, ("gaussian", "moments", "controls"))
    plain: dict[str, Any] = {key: value.item() if value.ndim == 0 else value for key, value in values.items()}
    try:
        if kind == "controls":
            from checkers.control_document import loaded  # noqa: PLC0415  only files need it

            return loaded(**plain)
        return (GaussianMixturePrediction if kind == "gaussian" else MomentPrediction)(**plain)
    except TypeError as error:
        raise InputError(f"{path}: {error}") from None
