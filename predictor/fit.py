"""From windows to a finished model: train, recalibrate on validation data, measure on test data, write the card."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from checkers.validate import Array, InputError
from predictor.calibration import LEVEL, Recalibration
from predictor.control_forecasts import control_predictions, to_forecasts
from predictor.forecasts import Forecasts, examples_of, frames_of, inputs_of, to_world
from predictor.metrics import joint_nll, marginal_nll, region_mass, summary
from predictor.model_files import Model
from predictor.network import MixtureNetwork, NetworkConfig, parameters
from predictor.train import Listener, Trained, TrainSettings, train
from predictor.windows import Windows, split

FRACTIONS = (0.7, 0.15, 0.15)
_CONTROL_WINDOWS = 300  # moments of controls take a millisecond each
_CONTROL_HALVINGS = 10


@dataclass(frozen=True, eq=False)
class Parts:
    """Windows to train on, to validate (early stop, recalibration) and to test on; no scene is in two of them."""

    training: Windows
    validation: Windows
    test: Windows

    @classmethod
    def of(cls, samples: Windows, seed: int, controls: bool = False) -> Parts:
        """Complete windows (`controls`: with complete controls), split by scene as `FRACTIONS`, place by place.

        A place is what scenes' names have in common up to the first hyphen: a recalibration fitted in one place says
        little of another. One with too few scenes to be split is trained on.

        Raises:
            InputError: none is complete, or too few scenes.
        """
        known = np.isfinite(samples.controls if controls else samples.future).all(axis=(1, 2))
        if not known.any():
            what = "controls" if controls else "futures"
            raise InputError(f"data: none of {len(samples)} windows has complete {what}")
        samples = samples.of(known)
        places = np.array([name.split("-")[0] for name in samples.names])[samples.scenes]
        found = [_split(samples, np.flatnonzero(places == place), seed) for place in sorted(set(places))]
        parts = [np.sort(np.concatenate([rows[i] for rows in found])) for i in range(3)]
        if not all(map(len, parts)):
            raise InputError(
                f"data: expected scenes to train, validate and test on apart, got {len(set(samples.scenes.tolist()))}"
            )
        return cls(*(samples.of(rows) for rows in parts))


def fit(
    config: NetworkConfig,
    parts: Parts,
    settings: TrainSettings,
    data: Mapping[str, Any],
    folder: Path | None = None,
    device: str = "cpu",
    listener: Listener | None = None,
) -> Model:
    """Train on one part, stop and recalibrate by the second, measure on the third.

    A recalibration that makes the validation part less likely (positions and trajectories) is measured, but not kept.

    Args:
        config: of a network that reads world coordinates, origin and scale are set from the training part.
        parts: windows.
        settings: of the training.
        data: what the card says of the data.
        folder, device, listener: as in `train`.
    """
    if not config.normalised:
        points = parts.training.past.reshape(-1, 2)
        x, y = points.mean(axis=0).tolist()
        config = replace(config, origin=(x, y), scale=float(points.std()))
    (training, _), (validation, _) = examples_of(parts.training, config), examples_of(parts.validation, config)
    trained = train(config, training, validation, settings, folder, device, listener)
    network = trained.network.to("cpu")
    recalibration: Recalibration | None
    if config.target == "controls":
        recalibration, metrics = _judge_controls(network, parts)
    else:
        held, raw = forecasts(network, parts.validation), forecasts(network, parts.test)
        fitted = Recalibration.fitted(held, parts.validation.future)
        recalibration = fitted if _surprise(fitted.apply(held), parts) < _surprise(held, parts) else None
        metrics = {
            "test": summary(raw, parts.test.future),
            "test_recalibrated": summary(fitted.apply(raw), parts.test.future),
            "recalibration_kept": recalibration is not None,
        }
    return Model(network, config, recalibration, _card(network, parts, settings, data, trained, metrics))


def forecasts(
    network: MixtureNetwork, samples: Windows, variances: Array | None = None, batch: int = 2048
) -> Forecasts:
    """What a network states of windows, world frame; of controls the moments of the positions.

    Args:
        network: in evaluation mode, on the CPU.
        samples: windows; their future is not looked at.
        variances: (T,) factors on the variances of predicted controls.
        batch: windows at a time.
    """
    config, found = network.config, []
    for start in range(0, len(samples), batch):
        part = samples.of(slice(start, start + batch))
        frames = frames_of(part.past, part.headings, config)
        inputs = inputs_of(frames, part.past, part.lanes, part.ego_future, config)
        with torch.inference_mode():
            mixture = network(inputs)
        if config.target == "controls":
            starts = np.column_stack([part.past[:, -1], part.speeds, part.headings])
            found.append(to_forecasts(control_predictions(mixture, config, starts, variances)))
        else:
            found.append(to_world(mixture, frames, config))
    first = found[0]
    return replace(
        first,
        weights=np.concatenate([f.weights for f in found]),
        means=np.concatenate([f.means for f in found]),
        covariances=np.concatenate([f.covariances for f in found]),
        factors=None if first.factors is None else np.concatenate([f.factors for f in found if f.factors is not None]),
    )


def _split(samples: Windows, rows: NDArray[np.int64], seed: int) -> tuple[NDArray[np.int64], ...]:
    """Rows of one place in three parts."""
    numbered = replace(samples.of(rows), sizes=np.column_stack([rows, rows]))  # to know them again
    try:
        return tuple(part.sizes[:, 0].astype(np.int64) for part in split(numbered, FRACTIONS, seed))
    except InputError:
        return rows, rows[:0], rows[:0]


def _surprise(stated: Forecasts, parts: Parts) -> float:
    truth = parts.validation.future
    return float(marginal_nll(stated, truth).mean() + joint_nll(stated, truth).mean())


def _judge_controls(network: MixtureNetwork, parts: Parts) -> tuple[Recalibration, dict[str, Any]]:
    """One factor for all steps: controls act on all later positions, and their errors are taken as independent.

    Their true errors last, so that independent ones of the same size average out: the factor is far above 1.
    """
    config = network.config
    held = _some(parts.validation)
    rows = np.unique(np.linspace(config.predicted // 3, config.predicted - 1, 3).round().astype(int))
    low, high = np.log(1e-2), np.log(1e4)
    for _ in range(_CONTROL_HALVINGS):
        middle = 0.5 * (low + high)
        stated = forecasts(network, held, np.full(config.predicted, np.exp(middle)))
        enough = bool((region_mass(stated, held.future, rows) <= LEVEL).mean() >= LEVEL)
        low, high = (low, middle) if enough else (middle, high)
    recalibration = Recalibration(config.times[:1], np.array([np.exp(0.5 * (low + high))]))
    test = _some(parts.test)
    return recalibration, {
        "test": summary(forecasts(network, test), test.future),
        "test_recalibrated": summary(forecasts(network, test, recalibration.at(config.times)), test.future),
    }


def _some(samples: Windows) -> Windows:
    """Evenly spread windows with complete futures, few enough for moments."""
    complete = np.flatnonzero(np.isfinite(samples.future).all(axis=(1, 2)))
    if not len(complete):
        raise InputError("future: expected windows with complete futures to judge controls by, got none")
    count = min(_CONTROL_WINDOWS, len(complete))
    return samples.of(complete[np.linspace(0, len(complete) - 1, count).astype(int)])


def _card(
    network: MixtureNetwork,
    parts: Parts,
    settings: TrainSettings,
    data: Mapping[str, Any],
    trained: Trained,
    metrics: Mapping[str, Any],
) -> dict[str, Any]:
    counts = {name: len(getattr(parts, name)) for name in ("training", "validation", "test")}
    scenes = {f"{name}_scenes": len(np.unique(getattr(parts, name).scenes)) for name in counts}
    return {
        "data": {**data, **counts, **scenes},
        "settings": asdict(settings),
        "training": {
            "best_epoch": trained.epoch,
            "epochs": trained.epochs,
            "valid_loss": round(trained.valid_loss, 5),
            "seconds": round(trained.seconds, 1),
            "parameters": parameters(network),
        },
        "metrics": dict(metrics),
        "versions": {name: version(name) for name in ("torch", "numpy", "safetensors")},
    }
