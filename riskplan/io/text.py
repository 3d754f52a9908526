"""What the text formats share: reading with a limit, writing all or nothing, numbers in and out."""

from __future__ import annotations

import reprlib
from pathlib import Path
from typing import Any

import numpy as np

from checkers import InputError
from checkers.archive import check_regular
from checkers.validate import Array
from checkers.writing import written

LARGEST = 50_000_000  # bytes of a text file
# numbers, texts, lists and mappings of a text file, 2 to 3 s of reading; predictions beyond that belong in an .npz
MOST_VALUES = 1_000_000
DEEPEST = 32  # levels of lists and mappings

_REPR = reprlib.Repr()
_REPR.maxlevel, _REPR.maxlist, _REPR.maxdict, _REPR.maxtuple = 8, 40, 40, 40
_REPR.maxstring = _REPR.maxlong = _REPR.maxother = 200


def read_bytes(path: str | Path) -> bytes:
    """The content of a file of at most `LARGEST` bytes.

    Raises:
        InputError: one line that names the file.
    """
    check_regular(path)
    try:
        with open(path, "rb") as file:
            content = file.read(LARGEST + 1)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    if len(content) > LARGEST:
        raise InputError(f"{path}: expected at most {LARGEST / 1e6:g} MB of text, got more")
    return content


def write_text(path: str | Path, text: str) -> None:
    """Write UTF-8, complete or not at all.

    Raises:
        InputError: if the place cannot be written.
    """
    with written(path) as part:
        part.write_bytes(text.encode())


def numbers(name: str, value: Any) -> Array:
    """Nested lists of numbers, and of None for NaN, as an array; text and booleans are refused.

    Raises:
        InputError: naming `name`.
    """
    try:
        if _holds_boolean(value):
            raise TypeError("bool")
        array = np.array(value)
        if array.dtype.kind == "O":  # None among the numbers
            kinds = {type(v) for v in array.ravel()}
            if not kinds <= {int, float, type(None)}:
                raise TypeError(", ".join(sorted(k.__name__ for k in kinds)))
            array = array.astype(np.float64)
    except (ValueError, TypeError, OverflowError):
        raise InputError(f"{name}: expected numbers in lists of equal length, got {short(value)}") from None
    if array.dtype.kind not in "iuf":
        raise InputError(f"{name}: expected numbers, got {short(value)}")
    return array.astype(np.float64)


def _holds_boolean(value: Any) -> bool:
    return any(map(_holds_boolean, value)) if isinstance(value, list) else isinstance(value, bool)


def short(value: Any, length: int = 60) -> str:
    """A value for an error message, on one short line."""
    text = " ".join(_REPR.repr(value).split())
    return text if len(text) <= length else text[: length - 3] + "..."


def plain(value: Any) -> Any:
    """Numpy and tuples as what JSON knows; numbers that are not finite as None."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
