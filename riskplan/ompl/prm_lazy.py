"""`prm-lazy`: ways along the roadmap are judged only when they lead to the goal."""

from __future__ import annotations

import heapq
from dataclasses import dataclass, field

from riskplan.ompl.prm import TOGETHER, Query, Search, check_options, search_roadmaps
from riskplan.ompl.roadmap import Roadmap
from riskplan.search import Budget, Problem, SearchResult

_Entry = tuple[float, float, int, int, tuple[float, ...]]


@dataclass(frozen=True)
class PrmLazy:
    """`prm` after LazyPRM (Bohlin & Kavraki 2000): first a way to the goal, then its risk, label by label.

    Where the risk passes the limit, that label and all that was reached through it are given up, what they kept out
    comes back, and the search goes on. Labels that no way to the goal leads through are never judged, which pays where
    a judgement costs more than a search: programs, samples, many agents.

    Attributes:
        size, roadmap: as of `prm`.
    """

    size: int = 300
    roadmap: Roadmap | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        check_options("prm-lazy", self.size, self.roadmap)

    def search(self, problem: Problem, budget: Budget, seed: int) -> SearchResult:
        """As `prm`."""
        return search_roadmaps(self.size, self.roadmap, (problem, budget, seed), lambda query: _Late(query).run())


class _Late:
    """A query whose labels are charged late."""

    def __init__(self, query: Query) -> None:
        self.query = query
        self.heap: list[_Entry] = []
        self.serial = 0
        self.judged, self.dead, self.passed = {0}, set[int](), set[int]()
        self.children: dict[int, list[int]] = {}
        self.owner: dict[tuple[int, ...], int] = {}
        self.kept_out: dict[int, list[_Entry]] = {}

    def run(self) -> Search:
        """Best-first as if there were no risk, and from the last label that holds on after each way that does not."""
        q = self.query
        self._push(0)
        while len(q.labels) < q.most and not q.budget.over():
            yield
            if not self.heap:  # those kept out by labels that hold may have spent less
                for each in list(self.kept_out):
                    self._let_pass(each)
            if not self.heap:
                break
            entry = heapq.heappop(self.heap)
            number = entry[3]
            if number in self.dead:
                continue
            driven = q.driven(number, entry[4])
            if driven is None:
                continue
            label, arrived = driven
            holder = self.owner.get(label.key)
            if not arrived and holder is not None and holder not in self.passed:
                self.kept_out.setdefault(holder, []).append(entry)
                continue
            new = len(q.labels)
            q.labels.append(label)
            self.children.setdefault(number, []).append(new)
            if not arrived:
                self.owner[label.key] = new
                self._push(new)
            elif self._holds(new):
                q.best = new
                if q.budget.found(q.labels[new].total):
                    return

    def _push(self, number: int) -> None:
        label, latest = self.query.labels[number], self.query.problem.goal.latest
        for child in self.query.children(label):
            self.serial += 1
            after = min(label.step + child[1], latest)
            heapq.heappush(self.heap, (child[3] // TOGETHER, -after, self.serial, number, tuple(child)))

    def _holds(self, last: int) -> bool:
        """Charge the way to an arrival from the last label that was judged on; give up the first that is too risky."""
        labels, chain = self.query.labels, [last]
        while chain[-1] not in self.judged:
            chain.append(labels[chain[-1]].parent)
        for number in chain[-2::-1]:
            charged = self.query.charged(labels[number], number == last)
            if charged is None:
                self._give_up(number)
                return False
            labels[number] = charged
            self.judged.add(number)
        return True

    def _give_up(self, number: int) -> None:
        """The label and all that was reached through it; what they kept out comes back."""
        gone = [number]
        while gone:
            each = gone.pop()
            self.dead.add(each)
            self._let_pass(each)
            gone.extend(self.children.get(each, ()))

    def _let_pass(self, number: int) -> None:
        self.passed.add(number)
        for entry in self.kept_out.pop(number, ()):
            heapq.heappush(self.heap, entry)
