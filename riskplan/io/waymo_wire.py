"""The bytes of a Waymo `MotionChallengeSubmission` as the JSON form that `waymo` reads; no protobuf library needed.

Protobuf's wire format: a message is a row of (field number, wire type) keys with a varint, 4, 8 or a counted number of
bytes each. Unknown fields are skipped; every length is checked before it is used.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from checkers import InputError

# field number -> (name, what it is): a message by its own table, "text", "float", "int", "floats"
_TRAJECTORY = {2: ("centerX", "floats"), 3: ("centerY", "floats")}
_SCORED = {1: ("trajectory", _TRAJECTORY), 2: ("confidence", "float")}
_OBJECT = {1: ("objectId", "int"), 2: ("trajectories*", _SCORED)}
_OF_OBJECT = {1: ("objectId", "int"), 2: ("trajectory", _TRAJECTORY)}
_SCORED_JOINT = {2: ("trajectories*", _OF_OBJECT), 3: ("confidence", "float")}
_SCENARIO = {
    1: ("scenarioId", "text"),
    2: ("singlePredictions", {1: ("predictions*", _OBJECT)}),
    3: ("jointPrediction", {1: ("jointTrajectories*", _SCORED_JOINT)}),
}
_SUBMISSION = {1: ("scenarioPredictions*", _SCENARIO)}
_VARINT, _EIGHT, _COUNTED, _FOUR = 0, 1, 2, 5


def parse_submission(content: bytes) -> dict[str, Any]:
    """The submission as nested mappings and lists.

    Raises:
        InputError: if the bytes are no such message.
    """
    return _message(memoryview(content), _SUBMISSION)


def _message(data: memoryview, table: dict[int, tuple[str, Any]]) -> dict[str, Any]:
    out: dict[str, Any] = {}
    at = 0
    while at < len(data):
        key, at = _varint(data, at)
        value: Any
        wire = key & 7
        if wire == _VARINT:
            value, at = _varint(data, at)
        elif wire in (_EIGHT, _FOUR, _COUNTED):
            size, at = _varint(data, at) if wire == _COUNTED else (8 if wire == _EIGHT else 4, at)
            if size > len(data) - at:
                raise InputError("not a motion submission: the bytes end inside a field")
            value, at = data[at : at + size], at + size
        else:
            raise InputError(f"not a motion submission: wire type {wire}")
        if key >> 3 in table:
            _put(out, *table[key >> 3], wire, value)
    return out


def _put(out: dict[str, Any], name: str, kind: Any, wire: int, value: Any) -> None:
    if isinstance(kind, dict) and wire == _COUNTED:
        found: Any = _message(value, kind)
        if name.endswith("*"):
            out.setdefault(name[:-1], []).append(found)
            return
    elif kind == "floats" and wire in (_COUNTED, _FOUR) and len(value) % 4 == 0:
        out.setdefault(name, []).extend(np.frombuffer(value, dtype="<f4").astype(float).tolist())  # packed, or one
        return
    elif kind == "float" and wire == _FOUR:
        found = float(np.frombuffer(value, dtype="<f4")[0])
    elif kind == "int" and wire == _VARINT:
        found = value - (1 << 64) if value >> 63 else value
    elif kind == "text" and wire == _COUNTED:
        found = bytes(value).decode(errors="replace")
    else:
        raise InputError(f"not a motion submission: wire type {wire} for {name.rstrip('*')}")
    out[name] = found


def _varint(data: memoryview, at: int) -> tuple[int, int]:
    value = 0
    for i in range(10):
        if at + i >= len(data):
            break
        value |= (data[at + i] & 127) << (7 * i)
        if data[at + i] < 128:
            return value & ((1 << 64) - 1), at + i + 1
    raise InputError("not a motion submission: the bytes end inside a number")
