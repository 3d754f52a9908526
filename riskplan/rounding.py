"""Risks as text, rounded to the side that keeps what they claim."""

from __future__ import annotations

from decimal import ROUND_CEILING, ROUND_FLOOR, ROUND_HALF_EVEN, Decimal

from checkers import Kind


def risk_text(value: float | None, rounding: str = ROUND_HALF_EVEN, digits: int = 3) -> str:
    """A probability with three significant digits, rounded the way its claim allows."""
    if value is None or value != value:
        return "-"
    exact = Decimal(float(value))
    if not exact:
        return "0"
    step = Decimal(1).scaleb(exact.adjusted() - digits + 1)
    rounded = exact.quantize(step, rounding=rounding)
    if rounded.adjusted() > exact.adjusted():  # 0.9996 became 1.000
        rounded = rounded.quantize(step.scaleb(1))
    return f"{rounded:f}" if rounded.adjusted() >= -4 else f"{rounded:.{digits - 1}e}"


def upper(value: float | None) -> str:
    """An upper end: never printed below its value."""
    return risk_text(value, ROUND_CEILING)


def lower(value: float | None) -> str:
    """A lower end: never printed above its value."""
    return risk_text(value, ROUND_FLOOR)


def by_kind(value: float | None, kind: str) -> str:
    """A bound is rounded up, the rest to nearest."""
    return upper(value) if kind == Kind.UPPER_BOUND.value else risk_text(value)
