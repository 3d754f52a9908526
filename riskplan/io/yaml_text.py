"""YAML as data: numbers, text, lists and mappings, nothing else.

PyYAML's parser supplies the events; what they mean follows the core schema of YAML 1.2, so `1e-3` is a number and `no`
is text. Tags, anchors and aliases are refused, and so is a key that appears twice.
"""

from __future__ import annotations

import re
from typing import Any

import yaml

from checkers import InputError
from riskplan.io.text import DEEPEST, MOST_VALUES

_INTEGER = re.compile(r"[-+]?[0-9]{1,18}")
_NUMBER = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_CONSTANTS: dict[str, Any] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
    **dict.fromkeys((".nan", ".NaN", ".NAN"), float("nan")),
    **{sign + text: float(sign + "inf") for sign in ("", "+", "-") for text in (".inf", ".Inf", ".INF")},
}


def parse_yaml(content: bytes, name: str) -> Any:
    """The one document in `content`.

    Args:
        content: UTF-8 or UTF-16 text.
        name: of the file, for messages.

    Raises:
        InputError: one line: `name`, line and column, what is wrong.
    """
    loader = None
    try:
        loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)(content)
        return _document(_Counting(loader))
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        problem = " ".join(str(error.problem or error.context or "malformed").split())
        raise InputError(f"{name}{_place(mark)}: not valid YAML: {problem}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise InputError(f"{name}: not valid YAML: {' '.join(str(error).split())}") from None
    except _Refused as refusal:
        raise InputError(f"{name}{_place(refusal.mark)}: {refusal}") from None
    finally:
        if loader is not None:
            loader.dispose()


class _Counting:
    """Events of a parser, up to a number of them."""

    def __init__(self, loader: Any) -> None:
        self._loader, self._left = loader, MOST_VALUES

    def get_event(self) -> Any:
        event = self._loader.get_event()
        self._left -= 1
        if not self._left:
            raise _Refused(event, f"expected at most {MOST_VALUES} values; larger predictions belong in an .npz")
        return event


class _Refused(Exception):
    def __init__(self, event: Any, message: str) -> None:
        super().__init__(message)
        self.mark = event.start_mark


def _document(loader: Any) -> Any:
    loader.get_event()  # start of the stream
    if isinstance(loader.get_event(), yaml.StreamEndEvent):
        return None
    value = _value(loader, loader.get_event(), 0)
    loader.get_event()  # end of the document
    after = loader.get_event()
    if not isinstance(after, yaml.StreamEndEvent):
        raise _Refused(after, "expected one YAML document, got a second one")
    return value


def _value(loader: Any, event: Any, depth: int) -> Any:
    if isinstance(event, yaml.AliasEvent) or event.anchor is not None:
        raise _Refused(event, "anchors and aliases are not supported: repeat the value, or keep it in an .npz")
    if event.tag not in (None, "!", "tag:yaml.org,2002:str"):
        raise _Refused(event, f"tags are not supported, got {event.tag}")
    if isinstance(event, yaml.ScalarEvent):
        return _scalar(event.value) if event.implicit[0] else event.value
    if depth >= DEEPEST:
        raise _Refused(event, f"expected at most {DEEPEST} levels of lists and mappings")
    if isinstance(event, yaml.SequenceStartEvent):
        items = []
        while not isinstance(event := loader.get_event(), yaml.SequenceEndEvent):
            items.append(_value(loader, event, depth + 1))
        return items
    pairs: dict[str, Any] = {}
    while not isinstance(event := loader.get_event(), yaml.MappingEndEvent):
        if not isinstance(event, yaml.ScalarEvent) or event.anchor is not None or event.tag is not None:
            raise _Refused(event, "expected plain text as a key")
        if event.value in pairs:
            raise _Refused(event, f"{event.value}: key appears twice")
        pairs[event.value] = _value(loader, loader.get_event(), depth + 1)
    return pairs


def _scalar(text: str) -> Any:
    if _INTEGER.fullmatch(text):
        return int(text)
    if _NUMBER.fullmatch(text):
        return float(text)
    return _CONSTANTS.get(text, text)


def _place(mark: Any) -> str:
    return f": line {mark.line + 1}, column {mark.column + 1}" if mark is not None else ""


def quoted(text: str) -> str:
    """Text in double quotes that every YAML reader takes back."""
    out = []
    for c in text:
        if c in '"\\':
            out.append("\\" + c)
        elif " " <= c <= "~":
            out.append(c)
        else:
            out.append(f"\\u{ord(c):04x}" if ord(c) < 0x10000 else f"\\U{ord(c):08x}")
    return '"' + "".join(out) + '"'


def number_text(value: float | int) -> str:
    """A number that reads back as the same bits, here and by readers of YAML 1.1 (`1.0e-05`, `.inf`, `.nan`)."""
    if isinstance(value, int):
        return str(value)
    text = repr(float(value))
    if text in ("inf", "-inf", "nan"):
        return text.replace("inf", ".inf").replace("nan", ".nan")
    mantissa, e, exponent = text.partition("e")
    return mantissa + ("" if "." in mantissa or not e else ".0") + e + exponent
