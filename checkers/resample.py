"""Predictions on another time grid."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, TypeVar

import numpy as np

from checkers.validate import Array, InputError


def brackets(pred: Any, times: Array) -> tuple[Any, Any, Array]:
    """Own steps left and right of each time, and the share of the right one.

    Raises:
        InputError: if a time lies outside the prediction.
    """
    own = pred.times
    slack = 1e-6
    outside = np.flatnonzero((times < own[0] - slack) | (times > own[-1] + slack))
    if len(outside):
        raise InputError(
            f"times[{int(outside[0])}]: {pred.name or 'the prediction'} covers {own[0]:g} to {own[-1]:g} s, "
            f"got {times[outside[0]]:g}"
        )
    right = np.clip(np.searchsorted(own, times - slack), 0, len(own) - 1)
    left = np.maximum(right - 1, 0)
    gap = np.where(right > left, own[right] - own[left], 1.0)
    share = np.clip((times - own[left]) / gap, 0.0, 1.0)
    # a grid time is a grid time: no interpolation residue from rounding in the times
    share = np.where(np.abs(times - own[right]) <= slack, 1.0, share)
    return left, right, share


_P = TypeVar("_P")


def cut(pred: _P, steps: slice) -> _P:
    """Some steps of a prediction, which need no second validation."""
    if steps.start == 0 and steps.stop == len(pred.times):  # type: ignore[attr-defined]
        return pred
    part = object.__new__(type(pred))  # nothing worked out for the whole comes along
    for field in fields(pred):  # type: ignore[arg-type]
        value = getattr(pred, field.name)
        if isinstance(value, np.ndarray) and not (field.name == "weights" and value.ndim == 1):
            value = value[steps]
        object.__setattr__(part, field.name, value)
    return part


def mixer(left: Any, right: Any, share: Array) -> Any:
    """A function that interpolates (T, …) arrays linearly."""

    def mix(values: Array) -> Array:
        s = share.reshape(-1, *([1] * (values.ndim - 1)))
        blend: Array = np.where(s == 1.0, values[right], (1 - s) * values[left] + s * values[right])
        return blend

    return mix


def labels(pred: Any, left: Any = None, right: Any = None, share: Array | None = None) -> dict[str, Any]:
    """The optional fields of a prediction; interpolated where brackets are given, headings the short way round."""
    headings, factors = pred.headings, pred.factors
    if share is not None:
        factors = None if factors is None else mixer(left, right, share)(factors)
        if headings is not None:
            turn = np.angle(np.exp(1j * (headings[right] - headings[left])))
            headings = headings[left] + share[:, None] * turn
    return {
        "modes": pred.modes,
        "name": pred.name,
        "length": pred.length,
        "width": pred.width,
        "headings": headings,
        "factors": factors,
    }


def single_mode(pred: _P, k: int) -> _P:
    """One mode of a prediction as a prediction of its own, which needs no second validation."""
    part = object.__new__(type(pred))
    for field in fields(pred):  # type: ignore[arg-type]
        value = getattr(pred, field.name)
        if field.name == "weights":
            value = np.ones(1)
        elif isinstance(value, np.ndarray) and field.name != "times":
            value = value[:, k : k + 1]
        object.__setattr__(part, field.name, value)
    return part
