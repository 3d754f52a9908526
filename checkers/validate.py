"""Boundary checks: every value type turns its input into clean, read-only float arrays here, once."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


# metres: beyond, squares and powers of coordinates lose all meaning
FARTHEST = 1e9
# metres: no body is larger
LARGEST_BODY = 1e6
_MESSAGE = 1000


class InputError(ValueError):
    """Malformed input. The message is one line that names the field, the index, what was expected and what came.

    One line it is, whatever was quoted in it: line breaks become spaces, and of a thousand characters and more the
    middle is left out.
    """

    def __init__(self, message: object = "") -> None:
        text = " ".join(str(message).split())
        super().__init__(text if len(text) <= _MESSAGE else f"{text[: _MESSAGE - 300]} … {text[-290:]}")


def as_array(
    name: str, value: Any, shape: Sequence[int | str], *, finite: bool = True, largest: float = np.inf
) -> Array:
    """Copy `value` into a read-only, C-ordered float64 array of `shape` (letters stand for any length ≥ 1).

    No entry may exceed `largest` in size.
    """
    try:
        if np.iscomplexobj(value):
            raise TypeError("complex numbers")
        array = np.array(value, dtype=np.float64, order="C")  # kernels are compiled for one order
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"{name}: expected numbers of shape {_show(shape)}, got {type(value).__name__}: {error}"
        ) from None
    fits = array.ndim == len(shape) and all(
        size == want if isinstance(want, int) else size >= 1 for size, want in zip(array.shape, shape, strict=True)
    )
    if not fits:
        raise InputError(f"{name}: expected shape {_show(shape)}, got {array.shape}")
    if finite:
        bad = np.argwhere(~np.isfinite(array))
        if len(bad):
            index = tuple(int(i) for i in bad[0])
            raise InputError(f"{name}{_at(index)}: expected a finite number, got {array[index]}")
    if largest < np.inf:
        bad = np.argwhere(np.abs(array) > largest)
        if len(bad):
            index = tuple(int(i) for i in bad[0])
            raise InputError(f"{name}{_at(index)}: expected a size of at most {largest:g}, got {array[index]:g}")
    array.flags.writeable = False
    return array


def as_scalar(name: str, value: Any, *, low: float = -np.inf, high: float = np.inf, strict: bool = False) -> float:
    """A finite float in [low, high], or in (low, high] when `strict`."""
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | float | np.integer | np.floating):
        raise InputError(f"{name}: expected a number, got {value!r}")
    try:
        number = float(value)
    except OverflowError:
        raise InputError(
            f"{name}: expected a number that fits a double, got an integer of {len(str(value))} digits"
        ) from None
    below = number <= low if strict else number < low
    if not np.isfinite(number) or below or number > high:
        bracket = "(" if strict else "["
        raise InputError(f"{name}: expected a finite number in {bracket}{low:g}, {high:g}], got {number!r}")
    return number


def as_count(name: str, value: Any, low: int = 0, high: int | None = None) -> int:
    """An integer in [low, high]; booleans and floats are none."""
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | np.integer) or value < low:
        raise InputError(f"{name}: expected an integer >= {low}, got {shown(value)}")
    if high is not None and value > high:
        raise InputError(f"{name}: expected an integer <= {high}, got {shown(int(value))}")
    return int(value)


def as_flag(name: str, value: Any) -> bool:
    """True or False, nothing that merely counts as one."""
    if not isinstance(value, bool | np.bool_):
        raise InputError(f"{name}: expected True or False, got {shown(value)}")
    return bool(value)


def as_text(name: str, value: Any) -> str:
    """Text."""
    if not isinstance(value, str):
        raise InputError(f"{name}: expected text, got {shown(value)}")
    return value


def as_instance(name: str, value: Any, *kinds: type[Any]) -> Any:
    """An instance of one of the classes."""
    if not isinstance(value, kinds):
        wanted = " or ".join(kind.__name__ for kind in kinds)
        raise InputError(f"{name}: expected a {wanted}, got {type(value).__name__}")
    return value


def as_tuple(name: str, value: Any, *kinds: type[Any]) -> tuple[Any, ...]:
    """Instances of the classes, or anything if there are none, in an iterable that is no text."""
    if isinstance(value, str | bytes | dict) or not isinstance(value, Iterable):
        raise InputError(f"{name}: expected a sequence, got {shown(value)}")
    try:
        items = tuple(value)
    except TypeError:  # an array without axes
        raise InputError(f"{name}: expected a sequence, got {shown(value)}") from None
    for i, item in enumerate(items if kinds else ()):
        as_instance(f"{name}[{i}]", item, *kinds)
    return items


def as_iterable(name: str, value: Any) -> Iterable[Any]:
    """What can be gone through once, maybe long and made as it goes; no text."""
    if isinstance(value, str | bytes | dict | np.ndarray) or not isinstance(value, Iterable):
        raise InputError(f"{name}: expected a sequence, got {shown(value)}")
    return value


def as_path(name: str, value: Any) -> Path:
    """A path, as text or as one, that a file system may have: no null characters, no part of more than 255 bytes."""
    path = Path(as_instance(name, value, str, os.PathLike))
    if "\0" in str(path) or any(len(os.fsencode(part)) > 255 for part in path.parts):
        raise InputError(f"{name}: expected a path, got {shown(str(path))}")
    return path


def as_callable(name: str, value: Any) -> Any:
    """A function, or None."""
    if value is not None and not callable(value):
        raise InputError(f"{name}: expected a function or None, got {shown(value)}")
    return value


def as_seed(name: str, value: Any) -> int:
    """Of random numbers, in [0, 2^31)."""
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | np.integer) or not 0 <= value < 2**31:
        raise InputError(f"{name}: expected an integer in [0, 2^31), got {shown(value)}")
    return int(value)


def as_draws(n: Any, rng: Any) -> int:
    """How many samples to draw, and that the generator is one."""
    if not isinstance(n, int | np.integer) or isinstance(n, bool) or not 0 <= n < 2**31:
        raise InputError(f"sample: expected a count >= 0, got {shown(n)}")
    if not isinstance(rng, np.random.Generator):
        raise InputError(f"sample: rng: expected a numpy Generator such as np.random.default_rng(0), got {rng!r}")
    return int(n)


def shown(text: Any, most: int = 80) -> str:
    """A value as one short line for a message."""
    line = repr(text)
    return line if len(line) <= most else f"{line[:most]}… ({len(line)} characters)"


def as_option(name: str, value: Any, valid: Sequence[str]) -> str:
    """One of the valid names; the error lists them."""
    if not isinstance(value, str) or value not in valid:
        raise InputError(f"{name}: expected one of {', '.join(valid)}; got {value!r}")
    return value


def as_times(name: str, value: Any) -> Array:
    """Strictly increasing times (T,) [s]."""
    times = as_array(name, value, ("T",))
    falls = np.flatnonzero(np.diff(times) <= 0)
    if len(falls):
        k = int(falls[0]) + 1
        raise InputError(f"{name}[{k}]: expected times to increase, got {times[k]:g} after {times[k - 1]:g}")
    return times


def as_weights(name: str, value: Any, steps: int, modes: int) -> Array:
    """Mode weights (K,) or (T, K), non-negative, summing to 1 within 1e-6, then normalised exactly."""
    weights = as_array(name, value, (modes,) if _depth(value) == 1 else (steps, modes))
    ndim = weights.ndim
    negative = np.argwhere(weights < 0)
    if len(negative):
        index = tuple(int(i) for i in negative[0])
        raise InputError(f"{name}{_at(index)}: expected a weight >= 0, got {weights[index]:g}")
    sums = weights.sum(axis=-1)
    off = np.flatnonzero(np.abs(np.atleast_1d(sums) - 1.0) > 1e-6)
    if len(off):
        where = "" if ndim == 1 else f"[{int(off[0])}]"
        raise InputError(
            f"{name}{where}: expected weights that sum to 1, got a sum of {np.atleast_1d(sums)[off[0]]:.9g}"
        )
    # a sum that is 1 up to rounding is left alone: normalising twice must change nothing
    exact = np.abs(sums - 1.0) <= 8 * np.finfo(float).eps
    normalised: Array = np.where(exact[..., None], weights, weights / np.where(sums > 0, sums, 1.0)[..., None])
    normalised.flags.writeable = False
    return normalised


def as_covariances(name: str, value: Any, shape: Sequence[int | str]) -> Array:
    """Symmetric positive semi-definite (…, 2, 2) matrices."""
    covariances = as_array(name, value, (*shape, 2, 2), largest=FARTHEST**2)
    scale = np.abs(covariances).max(axis=(-2, -1))
    skew = np.abs(covariances[..., 0, 1] - covariances[..., 1, 0])
    _refuse_first(name, skew > 1e-9 * scale, covariances, "a symmetric matrix")
    symmetric = 0.5 * (covariances + np.swapaxes(covariances, -1, -2))
    lowest = lowest_eigenvalue(symmetric)
    _refuse_first(name, lowest < -1e-12 * scale, covariances, "a positive semi-definite matrix")
    symmetric.flags.writeable = False
    return symmetric


def lowest_eigenvalue(symmetric: Array) -> Array:
    """(…) of symmetric (…, 2, 2), to rounding of the largest entry; hundreds of times faster than LAPACK in a loop."""
    a, b, d = symmetric[..., 0, 0], symmetric[..., 0, 1], symmetric[..., 1, 1]
    lowest: Array = 0.5 * (a + d) - np.hypot(0.5 * (a - d), b)
    return lowest


def _refuse_first(name: str, bad: NDArray[np.bool_], values: Array, expected: str) -> None:
    where = np.argwhere(bad)
    if len(where):
        index = tuple(int(i) for i in where[0])
        raise InputError(f"{name}{_at(index)}: expected {expected}, got {values[index].tolist()}")


def _depth(value: Any) -> int:
    """Number of axes of nested sequences, ragged ones included."""
    if isinstance(value, np.ndarray):
        return value.ndim
    return 1 + _depth(value[0]) if isinstance(value, list | tuple) and len(value) else 0


def _show(shape: Sequence[int | str]) -> str:
    return "(" + ", ".join(str(s) for s in shape) + ("," if len(shape) == 1 else "") + ")"


def _at(index: tuple[int, ...]) -> str:
    return f"[{', '.join(map(str, index))}]" if index else ""
