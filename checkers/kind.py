"""What a number of risk claims to be."""

from __future__ import annotations

from collections.abc import Iterable
from enum import Enum


class Kind(Enum):
    """The claim a risk makes; it travels with the value through every later sum."""

    EXACT = "exact"
    UPPER_BOUND = "upper bound"
    ESTIMATE = "estimate"

    def __str__(self) -> str:
        return self.value

    @staticmethod
    def weakest(kinds: Iterable[Kind]) -> Kind:
        """The claim of a sum: one estimate makes an estimate, else one bound makes a bound."""
        found = set(kinds)
        for kind in (Kind.ESTIMATE, Kind.UPPER_BOUND):
            if kind in found:
                return kind
        return Kind.EXACT
