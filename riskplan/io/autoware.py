"""Autoware `PredictedObjects` (autoware_perception_msgs), as `ros2 topic echo` prints it or any JSON dump of it.

Each object has predicted paths with a confidence each; poses are `time_step` apart, the first at the message's stamp.
The message states no spread of the paths. A bounding box gives length and width, a cylinder its diameter, a polygon the
box about its footprint; existence and class probabilities do not enter: an object reported is taken to be there.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from checkers import GaussianMixturePrediction, InputError
from checkers.validate import Array
from riskplan.io.fields import MOST_AGENTS, MOST_MODES, MOST_STEPS, Reading, entry, items

BOUNDING_BOX, CYLINDER, POLYGON = 0, 1, 2


def looks_like(document: Any) -> bool:
    """Whether a parsed document is of this format."""
    objects = document.get("objects") if isinstance(document, dict) else None
    first = objects[0] if isinstance(objects, list) and objects else None
    return isinstance(first, dict) and "kinematics" in first


def predictions(document: Any, reading: Reading) -> tuple[GaussianMixturePrediction, ...]:
    """The objects, named by their uuid in hexadecimal; times from the message's stamp on.

    An object's paths of unequal length are cut to the shortest: nothing is extrapolated.

    Raises:
        InputError: naming the object and the field.
    """
    if reading.scene is not None:
        raise InputError(f"scene: expected None, as the file holds one message; got {reading.scene!r}")
    objects = items("", document, "objects", MOST_AGENTS)
    return tuple(_agent(f"objects[{i}]", item, reading) for i, item in enumerate(objects))


def _agent(where: str, item: Any, reading: Reading) -> GaussianMixturePrediction:
    kinematics = entry(where, item, "kinematics", dict)
    at = f"{where}.kinematics"
    paths, weights, steps = [], [], []
    for k, path in enumerate(items(at, kinematics, "predicted_paths", MOST_MODES)):
        here = f"{at}.predicted_paths[{k}]"
        poses = items(here, path, "path", MOST_STEPS)
        paths.append(np.array([_pose(f"{here}.path[{t}]", pose) for t, pose in enumerate(poses)]))
        weights.append(entry(here, path, "confidence", float))
        steps.append(_seconds(f"{here}.time_step", entry(here, path, "time_step", dict)))
    if max(steps) != min(steps):
        raise InputError(
            f"{at}.predicted_paths: expected one time_step for all paths, got {min(steps)} and {max(steps)}"
        )
    count = min(map(len, paths))
    stacked = np.stack([p[:count] for p in paths])  # (K, T, 3)
    length, width = _size(f"{where}.shape", entry(where, item, "shape", dict))
    return reading.mixture(
        where,
        np.array(weights, dtype=float),
        stacked[..., :2],
        steps[0] * np.arange(count),
        name=_uuid(where, item),
        length=length,
        width=width,
        headings=stacked[..., 2].T,
    )


def _pose(where: str, pose: Any) -> tuple[float, float, float]:
    """x, y, yaw."""
    position, q = (entry(where, pose, key, dict) for key in ("position", "orientation"))
    x, y = (float(entry(f"{where}.position", position, key, float)) for key in ("x", "y"))
    a, b, c, w = (float(entry(f"{where}.orientation", q, key, float)) for key in ("x", "y", "z", "w"))
    size = a * a + b * b + c * c + w * w
    if not 0.9 < size < 1.1:
        raise InputError(f"{where}.orientation: expected a unit quaternion, got one of squared size {size:g}")
    return x, y, float(np.arctan2(2.0 * (w * c + a * b), 1.0 - 2.0 * (b * b + c * c)))


def _seconds(where: str, duration: Any) -> float:
    seconds = float(entry(where, duration, "sec", int)) + 1e-9 * float(entry(where, duration, "nanosec", int))
    if not 0.0 < seconds < 1e6:
        raise InputError(f"{where}: expected a duration > 0, got {seconds:g} s")
    return seconds


def _size(where: str, shape: Any) -> tuple[float, float]:
    kind = entry(where, shape, "type", int)
    if kind == POLYGON:
        footprint = entry(where, shape, "footprint", dict)
        at = f"{where}.footprint"
        points = items(at, footprint, "points", MOST_STEPS)
        reach = np.abs([[entry(f"{at}.points[{i}]", p, key, float) for key in "xy"] for i, p in enumerate(points)])
        values: Array = 2.0 * np.max(reach, axis=0)
    elif kind in (BOUNDING_BOX, CYLINDER):
        dimensions = entry(where, shape, "dimensions", dict)
        values = np.array([entry(f"{where}.dimensions", dimensions, key, float) for key in "xy"], dtype=float)
        if kind == CYLINDER:
            values[:] = values.max()
    else:
        raise InputError(f"{where}.type: expected 0 (box), 1 (cylinder) or 2 (polygon), got {kind}")
    if not (values > 0.0).all():
        raise InputError(f"{where}: expected a length and a width > 0, got {values.tolist()}")
    return float(values[0]), float(values[1])


def _uuid(where: str, item: Any) -> str:
    given = entry(f"{where}.object_id", entry(where, item, "object_id", dict), "uuid", list)
    if len(given) != 16 or not all(isinstance(b, int) and 0 <= b < 256 for b in given):
        raise InputError(f"{where}.object_id.uuid: expected 16 bytes, got {len(given)} values")
    return bytes(given).hex()


def one_message(content: bytes) -> bytes:
    """`ros2 topic echo` ends each message with a line of three dashes; the last one goes."""
    text = content.rstrip()
    return text[: -len(b"---")] if text.endswith(b"\n---") else content
