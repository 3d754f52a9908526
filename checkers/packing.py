"""Value types as the contiguous arrays that compiled loops read."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from checkers.validate import Array


class ModeArrays(NamedTuple):
    """A prediction as arrays: means (T, K, 2), covariances (T, K, 4), moments (T, K, (order+1)²), read-only."""

    means: Array
    covariances: Array
    moments: Array
    order: int


def pack_pieces(offsets: Array, forms: Array) -> Array:
    """(N, 5) rows ox, oy, l11, l21, l22: centre and Cholesky factor of Q, ego frame."""
    return _pack_pieces(offsets.tobytes(), forms.tobytes())


@lru_cache(maxsize=256)
def _pack_pieces(offsets: bytes, forms: bytes) -> Array:
    root = np.linalg.cholesky(np.frombuffer(forms).reshape(-1, 2, 2))
    packed = np.column_stack([np.frombuffer(offsets).reshape(-1, 2), root[:, 0, 0], root[:, 1, 0], root[:, 1, 1]])
    packed.flags.writeable = False
    return packed
