"""A document against `scenario.schema.json`: the first thing wrong with it, as one line."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any

from jsonschema import Draft202012Validator, ValidationError

from checkers import InputError
from riskplan.io.text import short

_WORDS = {
    "array": "a list",
    "object": "a mapping",
    "number": "a number",
    "integer": "an integer",
    "string": "text",
}
_LIMITS = {
    "minimum": "a number >= {}",
    "exclusiveMinimum": "a number > {}",
    "maximum": "a number <= {}",
    "minItems": "at least {} items",
    "maxItems": "at most {} items",
}
_ENOUGH = 200  # errors looked at: a list of a million wrong entries has a million
# where an upper end may be open
_OPEN = re.compile(r"goal\.(time|regions\[\d+\]\.speed)\[1\]")


def check_document(document: Any) -> None:
    """Check keys, types and limits, and that every number outside the agents' arrays is finite.

    Raises:
        InputError: path of the offending key, what was expected and what came. Unknown keys are reported first: they
            explain the missing ones.
    """
    errors = list(islice(_validator().iter_errors(document), _ENOUGH))
    if errors:
        raise InputError(_line(min(errors, key=lambda e: (e.validator != "additionalProperties", _rank(e)))))
    for where, value in _small_numbers("", document):
        if not math.isfinite(value) and not (value == math.inf and _OPEN.fullmatch(where)):
            raise InputError(f"{where}: expected a finite number, got {value}")


def schema_text() -> str:
    """The JSON Schema of scenario files, as it is shipped."""
    return Path(__file__).with_name("scenario.schema.json").read_text(encoding="utf-8")


@cache
def _validator() -> Draft202012Validator:
    return Draft202012Validator(json.loads(schema_text()))


def _rank(error: ValidationError) -> int:
    return 0 if error.validator == "type" else 1


def _line(error: ValidationError) -> str:
    where, rule = _path(error.absolute_path), error.validator
    value: Any = error.instance
    at = f"{where}: " if where else ""
    schema: Any = error.schema
    limit: Any = error.validator_value
    if rule == "additionalProperties":
        key = next(k for k in value if k not in schema["properties"])
        return f"{_join(where, short_key(key))}: unknown key; expected one of {', '.join(schema['properties'])}"
    if rule == "required":
        key = next(k for k in limit if k not in value)
        return f"{_join(where, key)}: missing; expected keys {', '.join(limit)}"
    if rule == "oneOf":
        choices = [" and ".join(branch["required"]) for branch in limit]
        return f"{at}expected exactly one of {', '.join(choices)}; got {', '.join(map(short_key, value)) or 'none'}"
    if rule == "type":
        kinds = [limit] if isinstance(limit, str) else limit
        wanted = " or ".join(_WORDS[k] for k in kinds)
        return f"{at or 'the document: '}expected {wanted}, got {_came(value)}"
    if rule == "const":
        return f"{at}expected {limit}, got {_came(value)}"
    if rule == "enum":
        return f"{at}expected one of {', '.join(limit)}; got {_came(value)}"
    got = len(value) if rule in ("minItems", "maxItems") else _came(value)
    return f"{at}expected {_LIMITS[str(rule)].format(limit)}, got {got}"


def short_key(key: str) -> str:
    """A key for a message."""
    return key if re.fullmatch(r"[\w.-]{1,40}", key) else short(key, 40)


def _came(value: Any) -> str:
    return "nothing" if value is None else short(value)


def _path(parts: Any) -> str:
    text = ""
    for part in parts:
        text = f"{text}[{part}]" if isinstance(part, int) else _join(text, part)
    return text


def _join(where: str, key: str) -> str:
    return f"{where}.{key}" if where else key


def _small_numbers(where: str, value: Any) -> Iterator[tuple[str, float]]:
    """Every number but those of the agents' arrays, which the predictions check themselves."""
    if isinstance(value, float | int):
        yield where, float(value)
    elif isinstance(value, list):
        for i, item in enumerate(value):
            yield from _small_numbers(f"{where}[{i}]", item)
    elif isinstance(value, dict):
        for key, item in value.items():
            if key not in ("means", "covariances", "central_moments", "weights", "headings", "factors"):
                yield from _small_numbers(_join(where, key), item)
