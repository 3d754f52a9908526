"""What readers of text files share."""

from __future__ import annotations

from pathlib import Path

from checkers.archive import check_regular
from checkers.validate import InputError

LARGEST = 200_000_000  # bytes


def read_text(path: Path) -> str:
    """The content of a UTF-8 file of at most `LARGEST` bytes.

    Raises:
        InputError: one line that names the file.
    """
    check_regular(path)
    try:
        with open(path, "rb") as file:
            content = file.read(LARGEST + 1)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    if len(content) > LARGEST:
        raise InputError(f"{path}: expected at most {LARGEST / 1e6:g} MB of text, got more")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: expected UTF-8 text, got the byte {content[error.start]:#04x}") from None
