"""Arrays out of an `.npz` from strangers: sizes are checked before anything is allocated, nothing is unpickled."""

from __future__ import annotations

import io
import os
import stat
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy

from checkers.validate import InputError, as_path

LARGEST = 500_000_000  # bytes of all arrays of a file, unpacked
_MEMBERS = 64
_PLAIN = "biufU"  # kinds of numbers and text


def read_arrays(path: str | Path, what: str) -> dict[str, Any]:
    """Every array of the file, by name.

    Args:
        path: of the `.npz`.
        what: it is expected to be, for messages.

    Raises:
        InputError: one line that names the file: missing, no archive, damaged, too large, or of other than numbers and
            text.
    """
    with open_arrays(path, what) as arrays:
        return dict(arrays)


@contextmanager
def open_arrays(
    path: str | Path, what: str, *, most: int = _MEMBERS, largest: int = LARGEST
) -> Iterator[Mapping[str, Any]]:
    """The arrays of a file, each read when asked for.

    Args:
        path, what: as in `read_arrays`.
        most: number of arrays.
        largest: bytes of all of them, unpacked.

    Raises:
        InputError: one line that names the file; from the mapping too.
    """
    check_regular(path)
    with _told(path, what):
        file = open(path, "rb")  # noqa: SIM115
    with file:
        with _told(path, what):
            archive = zipfile.ZipFile(file)
            members = archive.infolist()
            if len(members) > most or sum(m.file_size for m in members) > largest:
                raise InputError(f"expected at most {most} arrays of {largest / 1e6:g} MB together, got more")
        with archive:
            yield _Arrays(path, what, archive, {m.filename.removesuffix(".npy"): m for m in members})


class _Arrays(Mapping[str, Any]):
    """Arrays by name, read from the archive at each look."""

    def __init__(
        self, path: str | Path, what: str, archive: zipfile.ZipFile, members: dict[str, zipfile.ZipInfo]
    ) -> None:
        self._path, self._what, self._archive, self._members = path, what, archive, members

    def __getitem__(self, name: str) -> Any:
        member = self._members[name]
        with _told(self._path, self._what):
            return _array(self._archive, member)

    def __iter__(self) -> Iterator[str]:
        return iter(self._members)

    def __len__(self) -> int:
        return len(self._members)


@contextmanager
def _told(path: str | Path, what: str) -> Iterator[None]:
    """Whatever goes wrong as one line that names the file."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except Exception as error:  # zipfile, zlib and numpy's header reader raise dozens of kinds on damaged files
        reason = "it is no archive of arrays" if isinstance(error, zipfile.BadZipFile) else error
        raise InputError(f"{path}: not a {what}: {reason}") from None


def check_regular(path: str | Path) -> None:
    """Refuse what is missing or no plain file: a pipe would be waited for, a device may have no end.

    Raises:
        InputError: naming the file.
    """
    as_path("path", path)  # an integer would be taken for an open file, and closed
    try:
        mode = os.stat(path).st_mode
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        raise InputError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if stat.S_ISDIR(mode):
        raise InputError(f"{path}: cannot be read: it is a directory")
    if not stat.S_ISREG(mode):
        raise InputError(f"{path}: cannot be read: it is no plain file")


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> Any:
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise InputError(f"{member.filename}: expected it stored or deflated")
    with archive.open(member) as file:
        content = file.read(member.file_size + 1)
    stream = io.BytesIO(content)
    version = npy.read_magic(stream)
    read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, fortran, dtype = read(stream)
    if dtype.hasobject:
        raise InputError(f"{member.filename}: it holds pickled objects")
    if dtype.kind not in _PLAIN:
        raise InputError(f"{member.filename}: expected numbers or text, got {dtype}")
    count = 1
    for size in shape:
        count *= int(size)
    if count < 0 or count * dtype.itemsize != len(content) - stream.tell():
        raise InputError(f"{member.filename}: its header says shape {shape} of {dtype}, its data is of another size")
    flat = np.frombuffer(content, dtype=dtype, count=count, offset=stream.tell()) if count else np.empty(0, dtype)
    return flat.reshape(shape, order="F" if fortran else "C")
