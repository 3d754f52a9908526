"""Reading `.npz` files of unknown origin: no pickle, clear errors."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from zipfile import BadZipFile
from zlib import error as ZlibError

import numpy as np

from checkers.validate import InputError

# bytes one array may claim to have: more is a mistake or an attack
LARGEST = 4 << 30


@contextmanager
def open_npz(path: str | Path, wanted: str) -> Iterator[Any]:
    """The arrays of a file whose array `format` says `wanted`, read when asked for.

    Raises:
        InputError: one line that names the file; for arrays that cannot be read too.
    """
    try:
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as data:
            large = [i for i in data.zip.infolist() if i.file_size > LARGEST]
            if large:
                raise InputError(f"{path}: {large[0].filename} claims {large[0].file_size} bytes, more than {LARGEST}")
            got = str(data["format"]) if "format" in data else "none"
            if got != wanted:
                raise InputError(f"{path}: format: expected {wanted!r}, got {got!r}")
            yield data
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except InputError:
        raise
    except (ValueError, OSError, EOFError, BadZipFile, ZlibError, AttributeError, TypeError, MemoryError) as error:
        reason = "it holds pickled objects or is no .npz" if "pickle" in str(error) else error
        raise InputError(f"{path}: cannot be read: {reason}") from None


def read_npz(path: str | Path, wanted: str) -> dict[str, Any]:
    """All arrays but the format.

    Raises:
        InputError: one line that names the file.
    """
    with open_npz(path, wanted) as data:
        return {key: data[key] for key in data.files if key != "format"}
