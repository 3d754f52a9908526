"""The result of a batch on disk: parquet shards that are there complete or not at all, and the settings they share."""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from checkers import InputError
from riskplan.io.text import read_bytes, write_text

# parquet readers pass over names that begin with a dot or an underscore
_SETTINGS, _LOCK = "_batch.json", ".lock"

# column -> (parquet type, meaning); docs/batch.md and the test of the schema are made of this table
COLUMNS: dict[str, tuple[str, str]] = {
    "scenario": ("string", "name: path relative to the folder or the list, with #N for problem N > 0"),
    "seed": ("int64", "of this scenario: a hash of its name and of the batch's seed"),
    "status": ("string", "solved, scored, why there is no plan, or bad_input, timed_out, crashed, error"),
    "reason": ("string", "one line; of failures, what was wrong"),
    "agents": ("int32", "number of agents"),
    "risk": ("double", "total, as judged; null without a plan or without agents"),
    "boole": ("double", "sum over steps, modes and agents: holds under any dependence"),
    "max_step": ("double", "largest single step: no dependence makes the risk less"),
    "kind": ("string", "what the risk claims: exact, upper bound, estimate"),
    "dependence": ("string", "independent, persistent, boole"),
    "checker": ("string", "backend that judged"),
    "planner": ("string", "null when scoring"),
    "bound": ("double", "stated bound; null for none"),
    "stated": ("double", "when scoring: the total the plan's file states"),
    "seconds": ("double", "wall time of this scenario, reading included [s]"),
    "times": ("list<double>", "(T,) of the trajectory [s]"),
    "x": ("list<double>", "(T,) [m]"),
    "y": ("list<double>", "(T,) [m]"),
    "heading": ("list<double>", "(T,) [rad]"),
    "speed": ("list<double>", "(T,) [m/s]"),
}


def parquet() -> Any:
    """pyarrow and its parquet module, which are extras.

    Raises:
        InputError: saying what to install.
    """
    try:
        import pyarrow  # noqa: PLC0415
        import pyarrow.parquet  # noqa: PLC0415
    except ImportError:
        raise InputError("batch needs pyarrow: pip install '.[batch]' in the checkout") from None
    return pyarrow


def schema() -> Any:
    """The shards' pyarrow schema, each column with its meaning as metadata."""
    pa = parquet()
    types = {
        "string": pa.string(),
        "int64": pa.int64(),
        "int32": pa.int32(),
        "double": pa.float64(),
        "list<double>": pa.list_(pa.float64()),
    }
    return pa.schema(
        [pa.field(name, types[kind], metadata={"meaning": text}) for name, (kind, text) in COLUMNS.items()]
    )


@contextmanager
def claimed(folder: Path) -> Iterator[None]:
    """The folder, made if need be, for one writer; the claim ends with the process, however that ends.

    Raises:
        InputError: if another process writes there, or nobody can.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = open(folder / _LOCK, "w")  # noqa: SIM115
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error.strerror}") from None
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise InputError(f"{folder}: another batch is writing there") from None
        for stray in folder.glob(".part-*.writing"):  # of a writer that was killed: it was never a shard
            stray.unlink()
        yield


def check_settings(folder: Path, settings: Mapping[str, Any]) -> None:
    """Note the settings in an empty folder; in one that has some, refuse others: rows must be of one kind.

    Raises:
        InputError: naming the first setting that differs.
    """
    path = folder / _SETTINGS
    if not path.exists():
        if any(folder.glob("part-*.parquet")):
            raise InputError(f"{folder}: shards without {_SETTINGS}: not a batch's folder")
        write_text(path, json.dumps(dict(settings), indent=1) + "\n")
        return
    try:
        before = json.loads(read_bytes(path))
    except ValueError:
        raise InputError(f"{path}: not valid JSON") from None
    for key, value in settings.items():
        old = before.get(key) if isinstance(before, dict) else None
        if old != value:
            raise InputError(f"{folder}: was begun with {key} {old!r}, got {value!r}; resume alike, or elsewhere")


def done(folder: Path) -> set[str]:
    """Names of the scenarios that have a row.

    Raises:
        InputError: for a shard that cannot be read, and for a row that is there twice.
    """
    pa = parquet()
    found: set[str] = set()
    for path in sorted(folder.glob("part-*.parquet")):
        try:
            names = pa.parquet.read_table(path, columns=["scenario"])["scenario"].to_pylist()
        except (OSError, pa.ArrowException, KeyError) as error:
            reason = " ".join(str(error).split())[:200]
            raise InputError(f"{path}: not a shard; without it its rows are computed again: {reason}") from None
        for name in names:
            if name in found:
                raise InputError(f"{path}: {name!r} has a row in an earlier shard too")
            found.add(name)
    return found


def next_number(folder: Path) -> int:
    """Of the next shard."""
    return max((int(p.stem[5:]) for p in folder.glob("part-*.parquet") if p.stem[5:].isdigit()), default=-1) + 1


def write_shard(folder: Path, number: int, rows: Sequence[Mapping[str, Any]]) -> Path:
    """Write rows as one shard: aside, flushed to the disk, then moved into place.

    Raises:
        InputError: if the disk is full or the folder gone.
    """
    pa = parquet()
    aside, path = folder / f".part-{number:08d}.writing", folder / f"part-{number:08d}.parquet"
    table = pa.Table.from_pylist([dict(row) for row in rows], schema=schema())
    try:
        with open(aside, "wb") as file:
            pa.parquet.write_table(table, file, compression="zstd")
            file.flush()
            os.fsync(file.fileno())
        os.replace(aside, path)
        directory = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(directory)  # the name, too, outlives a power cut
        finally:
            os.close(directory)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None
    return path
