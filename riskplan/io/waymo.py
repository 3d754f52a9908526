"""Waymo motion submissions: `MotionChallengeSubmission` in protobuf's JSON form, or its bytes.

Positions at 2 Hz, the first half a second after the current step, 16 of them, in the scenario's frame; a confidence per
trajectory that need not sum to 1 (Ettinger et al. 2021; motion_submission.proto). No covariances, sizes or headings.
Joint predictions of the interaction challenge are read as each object's marginal.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from checkers import GaussianMixturePrediction, InputError
from checkers.validate import Array
from riskplan.io.fields import MOST_AGENTS, MOST_MODES, Reading, entry, items, mapping
from riskplan.io.text import numbers, short

STEP, STEPS = 0.5, 16
_MOST = 1_000_000


def looks_like(document: Any) -> bool:
    """Whether parsed JSON is of this format."""
    return isinstance(document, dict) and bool({"scenarioPredictions", "scenario_predictions"} & set(document))


def predictions(document: Any, reading: Reading) -> tuple[GaussianMixturePrediction, ...]:
    """The agents of one scenario, named by their object ids; times from the current step on.

    Raises:
        InputError: naming the entry and the field.
    """
    root = "scenarioPredictions" if "scenarioPredictions" in mapping("", document) else "scenario_predictions"
    scenes = items("", document, root, _MOST)
    ids = [str(entry(f"{root}[{i}]", s, "scenarioId", str, "scenario_id")) for i, s in enumerate(scenes)]
    index = ids.index(reading.chosen("scenario id", ids))
    scene, where = scenes[index], f"{root}[{index}]"
    for key, also in (("singlePredictions", "single_predictions"), ("jointPrediction", "joint_prediction")):
        if key in scene or also in scene:
            name = key if key in scene else also
            found = _single if key == "singlePredictions" else _joint
            agents = found(f"{where}.{name}", mapping(f"{where}.{name}", scene[name]))
            return tuple(
                reading.mixture(f"{where}: object {name}", weights, paths, STEP * np.arange(1, STEPS + 1), name=name)
                for name, weights, paths in agents
            )
    raise InputError(f"{where}.singlePredictions: missing")


def _single(where: str, values: dict[str, Any]) -> list[tuple[str, Array, Array]]:
    """(object id, confidences (K,), trajectories (K, T, 2)) of each object."""
    out = []
    for i, item in enumerate(items(where, values, "predictions", MOST_AGENTS)):
        here = f"{where}.predictions[{i}]"
        modes = items(here, item, "trajectories", MOST_MODES)
        weights = [entry(f"{here}.trajectories[{k}]", m, "confidence", float) for k, m in enumerate(modes)]
        paths = [_path(f"{here}.trajectories[{k}]", m) for k, m in enumerate(modes)]
        out.append((_object_id(here, item), np.array(weights, dtype=float), np.stack(paths)))
    return out


def _joint(where: str, values: dict[str, Any]) -> list[tuple[str, Array, Array]]:
    """The same from joint trajectories, each of which has one path for every object."""
    joint = items(where, values, "jointTrajectories", MOST_MODES, "joint_trajectories")
    weights, paths = [], []
    for k, mode in enumerate(joint):
        here = f"{where}.jointTrajectories[{k}]"
        weights.append(entry(here, mode, "confidence", float))
        parts = items(here, mode, "trajectories", MOST_AGENTS)
        named = [
            (_object_id(f"{here}.trajectories[{i}]", p), f"{here}.trajectories[{i}]", p) for i, p in enumerate(parts)
        ]
        paths.append({name: _path(at, part) for name, at, part in named})
        if paths[k].keys() != paths[0].keys() or len(paths[k]) != len(parts):
            raise InputError(f"{here}.trajectories: expected each object of the first joint trajectory once")
    return [(name, np.array(weights, dtype=float), np.stack([p[name] for p in paths])) for name in paths[0]]


def _object_id(where: str, item: Any) -> str:
    """Protobuf's JSON leaves out 0 for no field of proto2, but writes large integers as text."""
    name = "objectId" if "objectId" in mapping(where, item) else "object_id"
    value = item.get(name)
    if isinstance(value, bool) or not isinstance(value, int | str):
        raise InputError(f"{where}.objectId: expected an integer, got {short(value)}")
    return str(value)


def _path(where: str, item: Any) -> Array:
    """(T, 2) of what has a trajectory."""
    values = entry(where, item, "trajectory", dict)
    axes = []
    for key, also in (("centerX", "center_x"), ("centerY", "center_y")):
        axis = numbers(f"{where}.trajectory.{key}", entry(f"{where}.trajectory", values, key, list, also))
        if axis.shape != (STEPS,):
            raise InputError(f"{where}.trajectory.{key}: expected {STEPS} numbers, 8 s at 2 Hz, got {axis.shape}")
        axes.append(axis)
    return np.stack(axes, axis=-1)
