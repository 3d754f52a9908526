"""nuScenes prediction results: the JSON that its devkit's `Prediction.serialize` writes and its leaderboard takes.

A list of {"instance", "sample", "prediction" (K, T, 2) [m, world], "probabilities" (K,)}, at 2 Hz from half a second on
(Caesar et al. 2020; results format of the prediction challenge). No covariances, sizes or headings.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from checkers import GaussianMixturePrediction, InputError
from riskplan.io.fields import MOST_MODES, Reading, entry, items
from riskplan.io.text import numbers, short

STEP, MOST_STEPS = 0.5, 12  # 6 s at 2 Hz, by the rules
_MOST = 1_000_000


def looks_like(document: Any) -> bool:
    """Whether parsed JSON is of this format."""
    return isinstance(document, list) and bool(document) and isinstance(document[0], dict) and "instance" in document[0]


def predictions(document: Any, reading: Reading) -> tuple[GaussianMixturePrediction, ...]:
    """The agents of one sample, named by their instance tokens; times from the sample on.

    Raises:
        InputError: naming the entry and the field.
    """
    if not isinstance(document, list) or not 1 <= len(document) <= _MOST:
        raise InputError(f"the document: expected a list of 1 to {_MOST} predictions, got {short(document)}")
    samples = [entry(f"[{i}]", item, "sample", str) for i, item in enumerate(document)]
    chosen = reading.chosen("sample token", list(dict.fromkeys(samples)))
    return tuple(_agent(f"[{i}]", item, reading) for i, item in enumerate(document) if samples[i] == chosen)


def _agent(where: str, item: Any, reading: Reading) -> GaussianMixturePrediction:
    modes = items(where, item, "prediction", MOST_MODES)
    paths = numbers(f"{where}.prediction", modes)
    if paths.ndim != 3 or paths.shape[2] != 2 or not 1 <= paths.shape[1] <= MOST_STEPS:
        raise InputError(
            f"{where}.prediction: expected shape (modes, 1 to {MOST_STEPS} steps at 2 Hz, 2), got {paths.shape}"
        )
    weights = numbers(f"{where}.probabilities", items(where, item, "probabilities", MOST_MODES))
    times = STEP * np.arange(1, paths.shape[1] + 1)
    return reading.mixture(where, weights, paths, times, name=entry(where, item, "instance", str))
