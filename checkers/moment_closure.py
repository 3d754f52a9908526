"""The moments a system needs, found automatically, and their update as a sparse program.

A moment is a monomial in the generators of `checkers.deviations`, its powers packed into one integer. Starting from the
moments of the position, each stage of a step is walked backwards: a moment after the stage needs the monomials that
its substitution expands to (the closure of TreeRing, which Jasour et al. 2021, section V, cite).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from checkers.deviations import ONE, Monomial, Poly, Stage, deviations, product
from checkers.dynamics import System
from checkers.moment_program import Ints, Program, Sparse, Terms, sparse
from checkers.validate import Array, InputError

_LARGEST = 1_000_000  # moments; a table of them is 8 MB a step
_MOST_WORK = 30_000_000  # terms written, a product of two counting as ten: half a minute


@lru_cache(maxsize=64)
def compiled(system: System, order: int) -> Program:
    """The program of a system for moments of the position up to `order`.

    Raises:
        InputError: if that takes too many moments.
    """
    course = deviations(system)
    codec = _Codec(_generators(system, course.stages), order)
    factors = _Factors(len(course.coefficients))
    work = _Work()
    stages = [_Walker(stage, codec, factors, work) for stage in course.stages]
    orders = [(i, j) for i in range(order + 1) for j in range(order + 1 - i)]
    wanted = np.array([codec.key({f"d:{p}": n for p, n in zip(system.position, o, strict=True)}) for o in orders])
    needed = _closed(_distinct(wanted), stages)
    keys = _distinct(np.concatenate([needed, *(k for s in stages for k in (s.targets, s.terms[1]))]))
    position = np.zeros((order + 1, order + 1), dtype=np.uint64)
    position[tuple(np.transpose(orders))] = np.searchsorted(keys, wanted)
    slots = _slots(system)
    parts = factors.sparse  # before the tables are read: it fills them
    return Program(
        codec.generators,
        codec.powers(keys),
        np.searchsorted(keys, needed).astype(np.uint64),
        position,
        sparse([course.nominal[v] for v in system.reals], slots),
        sparse(course.coefficients, slots),
        _turns(system),
        tuple(factors.tables),
        parts,
        _terms(stages, keys),
    )


def _closed(wanted: Ints, stages: Sequence[_Walker]) -> Ints:
    """All moments needed before a step, however many steps follow."""
    needed, new = wanted, wanted
    while len(new):
        for stage in reversed(stages):
            new = stage.before(new)
        new = _without(new, needed)
        needed = _distinct(np.concatenate([needed, new]))
        if len(needed) > _LARGEST:
            raise InputError(f"system: expected at most {_LARGEST} moments, needs more; ask for a lower order")
    return needed


def _distinct(keys: Ints) -> Ints:
    """Sorted; `np.unique` hashes, and packed powers hash badly: 20 times the time."""
    keys = np.sort(keys)
    return keys[np.concatenate([[True], keys[1:] != keys[:-1]])] if len(keys) else keys


def _without(keys: Ints, known: Ints) -> Ints:
    """Distinct keys that are not among others, distinct too."""
    return keys[~np.isin(keys, known, assume_unique=True, kind="sort")]


def _terms(stages: Sequence[_Walker], keys: Ints) -> Terms:
    """Targets with equally many terms stand together, so that a processor can foresee the inner loop."""
    kept = [s for s in stages if len(s.targets)]
    none = np.zeros(0, dtype=np.int64)
    targets, counts, sources, factors = [none], [none], [none], [none]
    for s in kept:
        owner, source, factor = s.terms
        count = np.bincount(owner, minlength=len(s.targets))
        # an adding stage reads lower powers of the variable it changes: highest power first
        order = np.lexsort((s.targets, count, -(s.targets & s.touched) if s.adds else count))
        place = np.empty_like(order)
        place[order] = np.arange(len(order))
        term = np.argsort(place[owner], kind="stable")
        targets.append(s.targets[order])
        counts.append(count[order])
        sources.append(source[term])
        factors.append(factor[term])
    return Terms(
        np.cumsum([len(t) for t in targets]).astype(np.uint64),
        np.array([s.adds for s in kept], dtype=np.bool_),
        np.searchsorted(keys, np.concatenate(targets)).astype(np.uint32),
        np.concatenate([[0], np.cumsum(np.concatenate(counts))]).astype(np.uint64),
        np.searchsorted(keys, np.concatenate(sources)).astype(np.uint32),
        np.concatenate(factors).astype(np.uint32),
    )


@dataclass
class _Work:
    """What a compilation has cost so far, bounded: a system of a few lines can expand without end."""

    done: int = 0

    def spend(self, terms: int) -> None:
        self.done += terms
        if self.done > _MOST_WORK:
            raise InputError("system: its moments expand to too many terms; ask for a lower order or fewer noises")

    def product(self, p: Poly, q: Poly) -> Poly:
        self.spend(10 * len(p) * len(q))
        return product(p, q)


class _Codec:
    """Powers of the generators, packed into one integer each."""

    def __init__(self, generators: tuple[str, ...], order: int) -> None:
        # what is left of 62 bits goes to powers that harmonics raise
        width = [1 if g.startswith("s:") else (2 * order + 1).bit_length() for g in generators]
        growing = sum(w > 1 for w in width)
        spare = min((62 - sum(width)) // growing, 4) if growing else 0
        width = [w + max(spare, 0) if w > 1 else w for w in width]
        self.generators = generators
        self.shift = dict(zip(generators, np.concatenate([[0], np.cumsum(width)[:-1]]).tolist(), strict=True))
        self.limit = dict(zip(generators, [1 << w for w in width], strict=True))
        if sum(width) > 62:
            raise InputError(f"system: too many variables for moments of order {order}; ask for a lower order")

    def key(self, powers: dict[str, int]) -> int:
        """The integer; differences of powers give differences of integers."""
        for generator, power in powers.items():
            if power >= self.limit[generator]:
                raise InputError("system: its moments have too high powers; ask for a lower order")
        return sum(power << self.shift[generator] for generator, power in powers.items())

    def moved(self, keys: Ints, group: int, steps: Ints) -> Ints:
        """Keys (N, S) some steps, stated from `group`, away from keys (N,); powers must stay in their bits."""
        steps_of = self.powers(group + steps) - self.powers(np.array([group]))
        limits = np.array([self.limit[g] for g in self.generators])
        if ((self.powers(keys)[:, None] + steps_of[None]) >= limits).any():
            raise InputError("system: its moments have too high powers; ask for a lower order")
        return keys[:, None] + steps

    def powers(self, keys: Ints) -> Ints:
        """(N, G)."""
        columns = [(keys >> self.shift[g]) & (self.limit[g] - 1) for g in self.generators]
        return np.stack(columns, axis=-1)

    def mask(self, generators: Sequence[str]) -> int:
        """The bits of some generators."""
        return sum((self.limit[g] - 1) << self.shift[g] for g in generators)


class _Factors:
    """Different factors, numbered as they come; each a polynomial in coefficients and expectations of noises."""

    def __init__(self, coefficients: int) -> None:
        self.coefficients = coefficients
        self.tables: dict[tuple[str, int, int, int], int] = {}
        self.numbers: dict[frozenset[tuple[Monomial, float]], int] = {}

    def number(self, factor: Poly) -> int:
        return self.numbers.setdefault(frozenset(factor.items()), len(self.numbers))

    @property
    def sparse(self) -> Sparse:
        slots: dict[str, int] = {f"h:{i}": i for i in range(self.coefficients)}
        return sparse([dict(f) for f in self.numbers], slots, self._expectations)

    def _expectations(self, m: Monomial) -> list[int]:
        """Slots of the expectations in a factor: noises are independent, so one for each noise."""
        powers: dict[str, dict[str, int]] = {}
        for generator, power in m:
            kind, _, name = generator.partition(":")
            if kind[0] == "~":
                powers.setdefault(name, {})[kind[1:]] = power
        entries = [(name, p.get("d", 0), p.get("s", 0), p.get("c", 0)) for name, p in sorted(powers.items())]
        return [self.coefficients + self.tables.setdefault(e, len(self.tables)) for e in entries]


class _Walker:
    """One stage, expanded for the moments that turn out to be needed."""

    def __init__(self, stage: Stage, codec: _Codec, factors: _Factors, work: _Work) -> None:
        self.stage, self.codec, self.factors, self.work = stage, codec, factors, work
        self.touched = codec.mask([*stage.becomes])
        read = {g for p in stage.becomes.values() for m in p for g, _ in m}
        self.involved = sorted({*stage.becomes, *(g for g in read if g.startswith("s:"))})
        (own, update), *others = stage.becomes.items()
        one = ((own, 1),)
        self.adds = not others and update.get(one) == 1.0 and sum(own in dict(m) for m in update) == 1
        self.raised: dict[str, list[Poly]] = {g: [{ONE: 1.0}] for g in stage.becomes}
        self.targets: Ints = np.zeros(0, dtype=np.int64)
        self._written: list[tuple[Ints, Ints, Ints]] = []

    @property
    def terms(self) -> tuple[Ints, Ints, Ints]:
        """(N,) each: target by its place, source by its key, factor by its number."""
        none: Ints = np.zeros(0, dtype=np.int64)
        owners, sources, factors = zip((none, none, none), *self._written, strict=True)
        return np.concatenate(owners), np.concatenate(sources), np.concatenate(factors)

    def before(self, keys: Ints) -> Ints:
        """The moments needed before the stage for those after it; expansions are kept."""
        changed = (keys & self.touched) != 0
        new = _without(_distinct(keys[changed]), self.targets)
        sources = [keys if self.adds else keys[~changed]]
        groups, member = np.unique(new & self.codec.mask(self.involved), return_inverse=True)
        for g, group in enumerate(groups):
            mine = np.flatnonzero(member == g)
            steps, factors = self._expansion(int(group))
            self.work.spend(len(steps) * len(mine))
            source = self.codec.moved(new[mine], int(group), steps).ravel()
            owners = np.repeat(len(self.targets) + mine, len(steps))
            self._written.append((owners, source, np.tile(factors, len(mine))))
            sources.append(source)
        self.targets = np.concatenate([self.targets, new])
        return _distinct(np.concatenate(sources))

    def _expansion(self, group: int) -> tuple[Ints, Ints]:
        """What the involved generators of a moment become: steps to the sources' keys, and factors."""
        powers = self.codec.powers(np.array([group]))[0].tolist()
        total: Poly = {ONE: 1.0}
        for generator, power in zip(self.codec.generators, powers, strict=True):
            if generator in self.stage.becomes:
                total = self.work.product(total, self._power(generator, power))
            elif power:
                total = self.work.product(total, {((generator, power),): 1.0})
        by_source: dict[int, Poly] = {}
        for m, value in total.items():
            random = tuple(g for g in m if g[0][0] in "h~")
            key = self.codec.key({g: p for g, p in m if g[0] not in "h~"})
            by_source.setdefault(key, {})[random] = value
        if self.adds:
            del by_source[group]
        steps = np.array([key - group for key in by_source], dtype=np.int64)
        return steps, np.array([self.factors.number(f) for f in by_source.values()], dtype=np.int64)

    def _power(self, generator: str, power: int) -> Poly:
        raised = self.raised[generator]
        while len(raised) <= power:
            raised.append(self.work.product(raised[-1], self.stage.becomes[generator]))
        return raised[power]


def _generators(system: System, stages: Sequence[Stage]) -> tuple[str, ...]:
    """Every generator a moment may have; the position's first."""
    found = {f"d:{v}" for v in system.reals}
    for stage in stages:
        found |= set(stage.becomes)
        found |= {g for p in stage.becomes.values() for m in p for g, _ in m if g[0] not in "h~"}
    return tuple(sorted(found))


def _slots(system: System) -> dict[str, int]:
    """Where the nominal values stand: reals, cosines and sines of angles, noises, cosines and sines of noises."""
    names = [f"n:{v}" for v in system.reals]
    names += [f"{kind}:{a}" for a in system.angles for kind in ("nc", "ns")]
    names += [f"n:{w}" for w in system.noises]
    names += [f"{kind}:{w}" for w in system.noises for kind in ("nc", "ns")]
    return {name: i for i, name in enumerate(names)}


def _turns(system: System) -> Array:
    columns = {name: i for i, name in enumerate((*system.angles, *system.noises))}
    out = np.zeros((len(system.angles), len(columns) + 1))
    for row, name in zip(out, system.angles, strict=True):
        row[-1] = system.turns[name].constant
        for other, multiple in system.turns[name].multiples:
            row[columns[other]] = multiple
    return out
