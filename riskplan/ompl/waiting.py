"""The children of labels that are yet to be driven, and which of them is next."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Sequence
from typing import Protocol

import numpy as np

TOGETHER = 5  # arrivals within so many steps are alike
_DEPTH = 0.3  # failures put the other children back by a step, among those alike
_RANK = 8.0  # failures rank them behind those alike
_INHERITED, _LEAST = 0.5, 0.05  # share of a failure for the one before it, and what is too little to count
_LAST = 1e9  # rank of what is riskier than aimed at, above all times


class _Label(Protocol):
    """What is read of a label, see `riskplan.ompl.prm`."""

    @property
    def step(self) -> int: ...
    @property
    def total(self) -> float: ...
    @property
    def parent(self) -> int: ...


class Waiting:
    """Best first by the arrival to be hoped for, then deep first: one entry of a heap for all that a label may drive.

    Where a child fails, its siblings are put back among those alike. An impatient search puts them back in rank, and by
    half as much the siblings of its parent, and so on: where one way after the other fails, the reason is most often
    that all of them come too early. To stay is not put back.

    Attributes:
        labels: that there are, by number; grows outside.
        latest: last step; patient: see above.
        aim: risk above which labels come last.
    """

    def __init__(self, labels: Sequence[_Label], latest: int, patient: bool) -> None:
        self.labels, self.latest, self.aim = labels, latest, np.inf
        self._unit, self._inherited = (np.inf, 0.0) if patient else (_RANK, _INHERITED)
        self._heap: list[tuple[float, float, int, int]] = []  # rank, tie, label, and which child: −1 for the best left
        self._left: list[list[tuple[float, float, int, list[float]]]] = []  # of every label, the best last
        self._stays: list[dict[int, list[float]]] = []  # of every label, by the order of its children
        self._failed: list[float] = []

    def add(self, children: Iterable[list[float]]) -> None:
        """The children, rows of `expand`, of the label whose number is next."""
        self._left.append([])
        self._stays.append({})
        self._failed.append(0.0)
        self._rank(len(self._left) - 1, children)

    def take(self, limit: float) -> tuple[int, list[float]] | None:
        """The next child and its label's number; None if no label within the limit has one left."""
        while self._heap:
            _, tie, number, order = heapq.heappop(self._heap)
            if self.labels[number].total > limit:
                continue
            if order >= 0:
                return number, self._stays[number].pop(order)
            _, own, _, child = self._left[number][-1]
            current = tie >= own + self._failed[number] / _DEPTH
            if current:
                self._left[number].pop()
            self._push(number)
            if current:
                return number, child
        return None

    def failed(self, number: int) -> None:
        """A child of that label cannot be driven or is too risky."""
        part = 1.0
        while number >= 0 and part > _LEAST:
            self._failed[number] += part
            number, part = self.labels[number].parent, self._inherited * part

    def aim_at(self, total: float) -> None:
        """Labels up to that risk next, as if they were the first, and then by risk."""
        self.aim = total
        self._heap.clear()
        for number, rows in enumerate(self._left):
            drives = [row[3] for row in sorted(rows, key=lambda row: row[2])]
            self._rank(number, [*self._stays[number].values(), *drives])

    def _rank(self, number: int, children: Iterable[list[float]]) -> None:
        label = self.labels[number]
        last = None if label.total <= self.aim else _LAST + _decade(label.total)
        rows, stays = [], {}
        for order, child in enumerate(children):
            rank = child[3] // TOGETHER if last is None else last
            tie = -min(label.step + child[1], self.latest)
            if child[0] < 0.0:
                stays[order] = child
                heapq.heappush(self._heap, (rank, tie, number, order))
            else:
                rows.append((rank, tie, order, child))
        rows.sort(reverse=True)
        self._left[number], self._stays[number] = rows, stays
        self._push(number)

    def _push(self, number: int) -> None:
        if self._left[number]:
            (rank, tie, *_), late = self._left[number][-1], self._failed[number]
            heapq.heappush(self._heap, (rank + late // self._unit, tie + late / _DEPTH, number, -1))


def _decade(total: float) -> float:
    """Risk in coarse classes, so that within a class the search goes deep first."""
    return float(np.floor(3.0 * np.log10(max(total, 1e-9))))
