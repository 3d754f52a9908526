"""CommonRoad XML from strangers: what the reader must not see is found in one pass of expat, before anything is built.

The reader turns angles back by 2π at a time, follows neighbouring lanelets without counting, and believes in every
number; each of these never ends, or fills the memory, on a file made for it.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any
from xml.parsers import expat

from checkers.archive import check_regular
from checkers.validate import FARTHEST, InputError

LARGEST = 50_000_000  # bytes
_ELEMENTS = 2_000_000
_DEEPEST = 64
_ANGLE, _STEPS = 1e4, 1e5  # of angles [rad], of time steps
_NUMBERS = {
    "x",
    "y",
    "z",
    "exact",
    "intervalStart",
    "intervalEnd",
    "length",
    "width",
    "radius",
    "orientation",
    "zRotation",
}
_SIDES = ("adjacentLeft", "adjacentRight")


def checked_content(path: str | Path) -> bytes:
    """The bytes of a CommonRoad file that is safe to hand to the reader.

    Raises:
        InputError: one line that names the file: missing, too large, malformed, another kind of XML, a document type
            declaration, or a number out of range.
    """
    check_regular(path)
    try:
        with open(path, "rb") as file:
            content = file.read(LARGEST + 1)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    if len(content) > LARGEST:
        raise InputError(f"{path}: expected at most {LARGEST / 1e6:g} MB of XML, got more")
    try:
        _Pass().over(content)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (expat.ExpatError, LookupError, ValueError) as error:  # the latter two: encodings that are none
        raise InputError(f"{path}: malformed XML: {error}") from None
    return content


class _Pass:
    """One pass over a document; keeps the open elements, the text of the innermost, and who lies beside whom."""

    def __init__(self) -> None:
        self.open: list[str] = []
        self.count = 0
        self.text = ""
        self.lanelet, self.owner = "", ""
        self.beside: dict[tuple[str, str], str] = {}

    def over(self, content: bytes) -> None:
        parser = expat.ParserCreate()
        parser.StartDoctypeDeclHandler = self.doctype
        parser.StartElementHandler = self.start
        parser.CharacterDataHandler = self.characters
        parser.EndElementHandler = self.end
        parser.buffer_text = True
        parser.Parse(content, True)
        self.check_neighbours()

    def doctype(self, *_: Any) -> None:
        raise InputError("a document type declaration (DOCTYPE) is not accepted")

    def start(self, name: str, attributes: dict[str, str]) -> None:
        if not self.open:
            if name != "commonRoad":
                raise InputError(f"not a CommonRoad file: expected the root commonRoad, got {name}")
            if "timeStepSize" in attributes:
                self.check_time_step(attributes["timeStepSize"])
        self.count += 1
        self.open.append(name)
        self.text = ""
        if self.count > _ELEMENTS or len(self.open) > _DEEPEST:
            raise InputError(f"expected at most {_ELEMENTS} elements, {_DEEPEST} deep, got more")
        if "id" in attributes:
            self.owner = f"{name} {attributes['id'].strip()[:40]}: "
        if name == "lanelet":
            self.lanelet = attributes.get("id", "")
        if name in _SIDES and attributes.get("drivingDir") == "same":
            self.beside[name, self.lanelet.strip()] = attributes.get("ref", "").strip()

    def characters(self, text: str) -> None:
        if self.open and self.open[-1] in _NUMBERS and len(self.text) < 1000:
            self.text += text

    def end(self, name: str) -> None:
        if name in _NUMBERS and self.text.strip():
            most = FARTHEST
            if "orientation" in self.open or name == "zRotation":
                most = _ANGLE
            elif "time" in self.open:
                most = _STEPS
            self.check(self.owner + " ".join(self.open[-3:]), self.text, -most, most)
        self.open.pop()
        self.text = ""

    def check(self, name: str, text: str, low: float, high: float) -> None:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            raise InputError(f"{name}: expected a number in [{low:g}, {high:g}], got {text.strip()[:40]!r}")

    def check_time_step(self, text: str) -> None:
        self.check("timeStepSize", text, 1e-3, 1e3)

    def check_neighbours(self) -> None:
        """Going on to one side never leads back."""
        for side in _SIDES:
            row = {lanelet: other for (name, lanelet), other in self.beside.items() if name == side}
            safe: set[str] = set()
            for first in row:
                trail, at = {first}, row[first]
                while at in row and at not in safe:
                    if at in trail:
                        raise InputError(f"lanelet {first}: its neighbours by {side} lead back to {at}")
                    trail.add(at)
                    at = row[at]
                safe |= trail
