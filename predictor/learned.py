"""A trained network as a predictor: observed tracks in, predictions in the world frame out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import torch

from checkers import ControlPrediction, GaussianMixturePrediction
from checkers.prediction_batch import gaussian_mixtures
from checkers.validate import Array, InputError, as_array, as_option, as_times
from predictor.control_forecasts import control_predictions
from predictor.forecast_grid import at, headings, with_present
from predictor.forecasts import frames_of, inputs_of, to_world
from predictor.grid import observed_past
from predictor.lane_points import LanePoints
from predictor.lanes import Lane
from predictor.model_files import Model, load_model
from predictor.network import Mixture
from predictor.tracks import SLACK, Track

# in the wheel: trained on simulated traffic only (`python -m benchmarks.prediction --ship`)
SHIPPED = ("positions", "controls")


@dataclass(frozen=True, eq=False)
class LearnedPredictor:
    """A network that predicts agents from their observed tracks.

    Attributes:
        model: the network and its card.
        recalibrated: whether the recalibration of the card is applied.
    """

    model: Model
    recalibrated: bool = True

    @classmethod
    def load(cls, path: str | Path, recalibrated: bool = True) -> LearnedPredictor:
        """From a `.safetensors` with its card beside it, as `riskplan train` writes them.

        Raises:
            InputError: naming the file and what is wrong with it.
        """
        return cls(load_model(path), recalibrated)

    @classmethod
    def shipped(cls, name: str = "positions") -> LearnedPredictor:
        """The weights in the package, trained on simulated traffic: "positions" or "controls"."""
        as_option("name", name, SHIPPED)
        with resources.as_file(resources.files("predictor") / "data") as folder:
            return cls.load(folder / f"{name}.safetensors")

    def predict(
        self,
        tracks: Sequence[Track],
        times: Any = None,
        lanes: Sequence[Lane] | Array | None = None,
        ego_future: Any = None,
    ) -> tuple[GaussianMixturePrediction, ...] | tuple[ControlPrediction, ...]:
        """All tracks at once, each from its own last observation on, world frame; in the order of `tracks`.

        Args:
            tracks: each with the past the network reads (1.9 s at 10 Hz for the shipped ones). Agents standing still
                are seen in the direction of their recorded heading.
            times: (T,) after the last observation [s], 0 to the network's last step; None: the network's own. Of
                controls, multiples of its step.
            lanes: of the map, or (M, 2) points of their centre lines [m]; None: nothing is known of them.
            ego_future: (F, 2) where the ego will be at the network's own times [m]; None: not known.

        Raises:
            InputError: naming the track that is too short, too coarse or has a gap, or the argument.
        """
        if not len(tracks):
            return ()
        for i, track in enumerate(tracks):
            if not isinstance(track, Track):
                raise InputError(f"tracks[{i}]: expected a Track, got {type(track).__name__}")
        config = self.model.config
        past = np.stack([_past(t, config.observed, config.dt) for t in tracks])
        now = np.array([t.headings[-1] for t in tracks])
        frames = frames_of(past, now, config)
        near = self._lanes(lanes, past[:, -1])
        inputs = inputs_of(frames, past, near, self._ego(ego_future, len(tracks)), config)
        with one_thread(), torch.inference_mode():
            mixture: Mixture = self.model.network(inputs)
        names, sizes = [t.name for t in tracks], np.array([(t.length, t.width) for t in tracks])
        if config.target == "controls":
            starts = np.column_stack([past[:, -1], [t.speeds[-1] for t in tracks], now])
            found = control_predictions(mixture, config, starts, self._variances(), names, sizes)
            return found if times is None else tuple(p.at(times) for p in found)
        forecasts = to_world(mixture, frames, config)
        if (variances := self._variances()) is not None:
            forecasts = forecasts.scaled(variances)
        if times is not None:
            forecasts = at(with_present(forecasts, past[:, -1], config.floor), as_times("times", times))
        return gaussian_mixtures(
            forecasts.times,
            forecasts.weights[:, 0] if config.weights == "persistent" else forecasts.weights,
            forecasts.means,
            forecasts.covariances,
            names,
            sizes,
            headings(forecasts, past[:, -1], now),
            forecasts.factors,
            config.weights,
        )

    def _variances(self) -> Array | None:
        recalibration = self.model.recalibration if self.recalibrated else None
        if recalibration is None:
            return None
        config = self.model.config
        return recalibration.at(config.times)

    def _lanes(self, lanes: Any, positions: Array) -> Array | None:
        """(N, L, 2) points near each agent; NaN: none known."""
        if not self.model.config.lanes:
            return None
        if lanes is None or not len(lanes):
            return np.full((len(positions), 1, 2), np.nan)
        if isinstance(lanes[0], Lane):
            points = LanePoints.of(lanes)
        else:
            given = as_array("lanes", lanes, ("M", 2))
            points = LanePoints(given, np.zeros(len(given)))
        return points.near(positions, self.model.config.lane_points)[0]

    def _ego(self, course: Any, count: int) -> Array | None:
        steps = self.model.config.predicted
        if not self.model.config.ego_future:
            return None
        known = np.full((steps, 2), np.nan) if course is None else as_array("ego_future", course, (steps, 2))
        return np.broadcast_to(known, (count, steps, 2))


def _past(track: Track, steps: int, dt: float) -> Array:
    """(steps, 2) last positions; a track recorded at just these times is not interpolated, which would cost most."""
    last = track.times[-steps:]
    if len(last) == steps and np.abs(last - (last[-1] + dt * np.arange(1 - steps, 1))).max() <= SLACK:
        return track.positions[-steps:]
    return observed_past(track, steps, dt)


@contextmanager
def one_thread() -> Iterator[None]:
    """Torch on one thread: a network this small loses time to any other."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
