"""Files that appear complete or not at all."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from checkers.validate import InputError, as_path


@contextmanager
def written(path: str | Path) -> Iterator[Path]:
    """A place beside `path` to write to, moved there at the end; removed if anything fails.

    Raises:
        InputError: naming the path, if it cannot be written.
    """
    target = as_path("path", path)
    if not target.name:
        raise InputError(f"{path}: cannot be written: it names no file")
    part = target.with_name(f".{target.name[:200]}.{os.getpid()}.part")
    try:
        yield part
        os.replace(part, target)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from None
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
