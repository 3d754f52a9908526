"""Reading data sets and samples kept as `.npz`: no pickle, sizes checked before anything is allocated."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from checkers.archive import open_arrays
from checkers.validate import InputError

# a data set has three arrays a recording, and more of both than a prediction
MOST, LARGEST = 1_000_000, 16 << 30


@contextmanager
def open_npz(path: str | Path, wanted: str) -> Iterator[Mapping[str, Any]]:
    """The arrays of a file whose array `format` says `wanted`, read when asked for.

    Raises:
        InputError: one line that names the file; for arrays that cannot be read too.
    """
    with open_arrays(path, "file of arrays", most=MOST, largest=LARGEST) as data:
        got = str(data["format"]) if "format" in data else "none"
        if got != wanted:
            raise InputError(f"{path}: format: expected {wanted!r}, got {got!r}")
        yield data


def read_npz(path: str | Path, wanted: str) -> dict[str, Any]:
    """All arrays but the format.

    Raises:
        InputError: one line that names the file.
    """
    with open_npz(path, wanted) as data:
        return {key: value for key, value in data.items() if key != "format"}
