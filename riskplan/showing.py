"""The way from a value to its picture in a notebook, found only when one is shown."""

from importlib import import_module
from typing import Any


def shown(value: Any) -> str:
    """HTML of a scenario, a plan or a report. The value types know nothing of pictures; this finds them by name."""
    return str(import_module("riskplan.pictures.notebook").html_of(value))
