"""`offline-sos`: the best of a table of indicator polynomials solved beforehand (Jasour et al. 2021, Remark 1)."""

import json
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from typing import ClassVar

import numpy as np
from numba import carray

from checkers.base import CheckerInfo, MomentChecker
from checkers.kernels.abi import ROOM, kernel
from checkers.kernels.tail import gaussian_form, general_form, table_bound
from checkers.kind import Kind
from checkers.validate import Array, InputError


@kernel
def _kernel(m1, m2, s11, s12, s22, det, moments, order, options, out):  # type: ignore[no-untyped-def]
    head = carray(options, 2)
    degree, count = int(head[0]), int(head[1])
    room = carray(out, ROOM)
    form, noise = room[2:16], room[16:32]
    if order == 0:
        mean, sd = gaussian_form(m1, m2, s11, s12, s22, det, degree, form, noise)
    else:
        mean, sd = general_form(m1, m2, carray(moments, (order + 1) ** 2), order, degree, form, noise)
    if sd == 0.0:
        return 1.0 if mean <= 0.0 else 0.0
    table = carray(options, 2 + count * degree // 2)[2:].reshape(count, degree // 2)
    return table_bound(mean, sd, form, noise, table, room[32:])


@dataclass(frozen=True)
class OfflineSos(MomentChecker):
    """The smallest mean of the table's polynomials of g / E g: each is an upper bound for every distribution.

    The table is made by `python -m checkers.offline_table`; every entry is Π (1 − u/t)² with positive roots t, which
    is ≥ 1 for u ≤ 0 and ≥ 0 everywhere. Weaker than `sos`, which solves for the moments at hand.

    Attributes:
        order: of the polynomials: 2, 4, 6 or 8.
    """

    order: int = 4

    info: ClassVar[CheckerInfo] = CheckerInfo(
        name="offline-sos",
        kind=Kind.UPPER_BOUND,
        needs="moments of the position to twice the order (8 by default)",
        assumption="none beyond the moments",
        source="Jasour et al. 2021, Remark 1",
        cost="2 µs",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.order, int | np.integer) or self.order not in _tables():
            raise InputError(f"offline-sos: order: expected one of {list(_tables())}, got {self.order!r}")

    @property
    def moments_needed(self) -> int:
        """Twice the order, since g is quadratic."""
        return 2 * self.order

    @property
    def kernel(self) -> int:
        """Address of the compiled kernel."""
        return _kernel.address

    @property
    def options(self) -> Array:
        """Order, number of entries and their roots."""
        return _tables()[self.order]


@lru_cache(maxsize=1)
def _tables() -> dict[int, Array]:
    """Per order the kernel's options: order, number of entries and their roots − 1."""
    text = resources.files("checkers").joinpath("data/offline_sos.json").read_text(encoding="utf-8")
    return {int(order): np.array([int(order), len(rows), *sum(rows, [])]) for order, rows in json.loads(text).items()}
