"""What the readers of other programs' predictions share: fields by name and type, errors that say where."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from checkers import GaussianMixturePrediction, InputError
from riskplan.io.text import short

if TYPE_CHECKING:
    from predictor.growth import Growth

MOST_AGENTS, MOST_MODES, MOST_STEPS = 10_000, 1_000, 10_000
_WORDS: dict[type, str] = {dict: "a mapping", list: "a list", str: "text", int: "an integer", float: "a number"}


@dataclass(frozen=True)
class Reading:
    """What a file leaves open.

    Attributes:
        growth: spread about trajectories that come without one; None: not given.
        scene: which of several scenes in the file; None: the only one.
        normalise: divide probabilities by their sum.
    """

    growth: Growth | None = None
    scene: str | None = None
    normalise: bool = False

    def mixture(self, where: str, weights: Any, paths: Any, times: Any, **labels: Any) -> GaussianMixturePrediction:
        """Trajectories (K, T, 2) without a spread as a prediction, its spread from `growth`.

        Raises:
            InputError: beginning with `where`; also without a `growth`.
        """
        from predictor import from_trajectories  # noqa: PLC0415

        if self.growth is None:
            raise InputError(
                "growth: the format states no spread; pass a model of it, such as "
                "predictor.PowerGrowth(along=(0.3, 0.8, 1.2), across=(0.3, 0.3, 1.0))"
            )
        try:
            return from_trajectories(weights, paths, times, self.growth, normalise=self.normalise, **labels)
        except InputError as error:
            more = "; normalise=True divides them by it" if "sum to 1" in str(error) and not self.normalise else ""
            raise InputError(f"{where}: {error}{more}") from None

    def chosen(self, what: str, scenes: list[str]) -> str:
        """The scene asked for, or the only one."""
        if self.scene is None and len(scenes) == 1:
            return scenes[0]
        if self.scene in scenes and self.scene is not None:
            return self.scene
        some = ", ".join(map(repr, scenes[:3])) + (f" and {len(scenes) - 3} more" if len(scenes) > 3 else "")
        raise InputError(f"scene: expected the {what} of one of {some or 'none'}; got {self.scene!r}")


@contextmanager
def naming(path: str | Path) -> Iterator[None]:
    """Errors begin with the file's name."""
    try:
        yield
    except InputError as error:
        text = str(error)
        raise InputError(text if text.startswith(f"{path}:") else f"{path}: {text}") from None


def mapping(where: str, value: Any) -> dict[str, Any]:
    """A mapping."""
    if not isinstance(value, dict):
        raise InputError(f"{where or 'the document'}: expected a mapping, got {short(value)}")
    return value


def entry(where: str, values: Any, key: str, kind: type[Any], also: str | None = None, default: Any = None) -> Any:
    """The entry `key` (or `also`, another spelling) of the type wanted; integers count as numbers, booleans do not.

    Raises:
        InputError: if it is missing and there is no default, or has another type.
    """
    found = mapping(where, values)
    name = also if key not in found and also is not None else key
    here = f"{where}.{name}" if where else name
    if name not in found:
        if default is not None:
            return default
        raise InputError(f"{f'{where}.{key}' if where else key}: missing")
    value = found[name]
    wanted = (float, int) if kind is float else kind
    if not isinstance(value, wanted) or (isinstance(value, bool) and kind is not bool):
        raise InputError(f"{here}: expected {_WORDS[kind]}, got {short(value)}")
    return value


def items(where: str, values: Any, key: str, most: int, also: str | None = None) -> list[Any]:
    """A list of 1 to `most` items."""
    found: list[Any] = entry(where, values, key, list, also)
    if not 1 <= len(found) <= most:
        raise InputError(f"{where}.{key}".lstrip(".") + f": expected 1 to {most} items, got {len(found)}")
    return found
