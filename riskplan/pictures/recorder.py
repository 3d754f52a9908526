"""Stands in for meshcat's window, so that no server is needed: keeps what is sent. Knows nothing of meshcat itself."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import umsgpack  # type: ignore[import-untyped]


class Recorder:
    """Stands in for meshcat's window: keeps what is sent, as plain messages, the same on every run."""

    def __init__(self) -> None:
        self.commands: list[dict[str, Any]] = []
        self._ids: dict[str, str] = {}

    def send(self, command: Any) -> None:
        """Take a meshcat command (anything with `lower()`)."""
        self.commands.append(self._plain(command.lower()))

    def _plain(self, value: Any, key: str = "") -> Any:
        if isinstance(value, dict):
            return {str(k): self._plain(v, str(k)) for k, v in value.items()}
        if isinstance(value, list | tuple):
            return [self._plain(v) for v in value]
        if isinstance(value, np.ndarray):
            return self._plain(value.tolist())
        if isinstance(value, np.generic):
            value = value.item()
        if isinstance(value, str) and key in ("uuid", "geometry", "material"):
            return self._ids.setdefault(value, f"id-{len(self._ids)}")
        good = math.isfinite(value) if isinstance(value, float) else np.isfinite(_floats(value)).all()
        if not good:  # the viewer would draw nothing, without a word
            raise ValueError(f"scene: a number that is not finite in {key!r}")
        return value


def _floats(value: Any) -> Any:
    """The numbers of a packed float32 array (extension type 0x17); nothing of anything else."""
    if isinstance(value, umsgpack.Ext) and value.type == 0x17:
        return np.frombuffer(value.data, dtype=np.float32)
    return ()
