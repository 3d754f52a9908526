"""A system rewritten for deviations from its nominal course, as a sequence of elementary substitutions.

Moments of the variables themselves would cancel: after 50 m of driving, E[x⁸] − … leaves nothing of a spread of 0.1 m.
So every real variable is split into nominal + deviation, every angle's wave into exp(iθ) = exp(iθ̂)(1 − c + i s) with
c = 1 − cos φ, s = sin φ of the deviation φ, and powers of s are reduced by s² = 2c − c², which loses no digits however
small φ is. The nominal course is the system without deviations, so no constant is left over.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

from checkers.dynamics import System
from checkers.expressions import Angle
from checkers.validate import InputError

# a generator is "kind:name": n nominal value, nc and ns nominal cosine and sine, d deviation, c and s of a deviating
# angle, h a coefficient that changes from step to step; "~" marks a noise whose expectation is taken at once
Monomial = tuple[tuple[str, int], ...]
Poly = dict[Monomial, float]
ONE: Monomial = ()
_MOST = 200_000


@dataclass(frozen=True, eq=False)
class Stage:
    """What some generators become, all at once, in terms of the generators before."""

    becomes: dict[str, Poly]


@dataclass(frozen=True, eq=False)
class Deviations:
    """A system as nominal course and stages.

    Attributes:
        stages: one step of the deviations, in order.
        coefficients: nominal polynomials; coefficient i is the generator "h:i" of the stages.
        nominal: real variable -> nominal polynomial of its next nominal value.
    """

    stages: tuple[Stage, ...]
    coefficients: tuple[Poly, ...]
    nominal: dict[str, Poly]


@lru_cache(maxsize=100_000)
def times(a: Monomial, b: Monomial) -> tuple[tuple[Monomial, float], ...]:
    """The product of two monomials, s² reduced to 2c − c²."""
    powers = dict(a)
    for generator, power in b:
        powers[generator] = powers.get(generator, 0) + power
    out: Poly = {ONE: 1.0}
    for generator, power in sorted(powers.items()):
        kind, _, name = generator.partition(":")
        if kind.lstrip("~") != "s" or power < 2:
            out = {_with(m, generator, power): v for m, v in out.items()}
            continue
        cosine = f"{kind[:-1]}c:{name}"
        for _ in range(power // 2):
            grown: Poly = {}
            for m, v in out.items():
                for extra, factor in ((1, 2.0), (2, -1.0)):
                    key = _with(m, cosine, extra)
                    grown[key] = grown.get(key, 0.0) + factor * v
            out = grown
        if power % 2:
            out = {_with(m, generator, 1): v for m, v in out.items()}
    return tuple(out.items())


def product(p: Poly, q: Poly) -> Poly:
    """p · q.

    Raises:
        InputError: if that takes too many terms.
    """
    if len(p) * len(q) > _MOST:
        raise InputError("system: its rules expand to too many terms")
    out: Poly = {}
    for a, x in p.items():
        for b, y in q.items():
            for m, factor in times(a, b):
                out[m] = out.get(m, 0.0) + factor * x * y
    return {m: v for m, v in out.items() if v != 0.0}


def deviations(system: System) -> Deviations:
    """Rewrite a closed system."""
    coefficients: list[Poly] = []
    nominal, steps = {}, {}
    for name in system.reals:
        nominal[name], steps[name] = _split(_expanded(system, name), coefficients)
    waves = {name: _turned(system, name) for name in system.angles}
    stages = _ordered(system, steps, waves)
    used = _noise_uses(stages, system.noises)
    once = {name for name, count in used.items() if count == 1}
    drawn = [_draw(name, kinds) for name, kinds in _drawn(stages, used).items()]
    return Deviations((*drawn, *(_expected(stage, once) for stage in stages)), tuple(coefficients), nominal)


def _with(m: Monomial, generator: str, power: int) -> Monomial:
    powers = dict(m)
    powers[generator] = powers.get(generator, 0) + power
    return tuple(sorted(powers.items()))


def _complex_product(p: tuple[Poly, Poly], q: tuple[Poly, Poly]) -> tuple[Poly, Poly]:
    """(re, im) · (re, im)."""
    minus = product({ONE: -1.0}, q[1])
    return _sum(product(p[0], q[0]), product(p[1], minus)), _sum(product(p[0], q[1]), product(p[1], q[0]))


def _sum(p: Poly, q: Poly) -> Poly:
    out = dict(p)
    for m, v in q.items():
        out[m] = out.get(m, 0.0) + v
    return out


def _wave(system: System, angle: Angle, with_nominal: bool) -> tuple[Poly, Poly]:
    """cos and sin of an angle; without the nominal part, of its deviation."""
    out: tuple[Poly, Poly] = ({ONE: 1.0}, {})
    for name, multiple in angle.multiples:
        share = round(multiple / system.noise_units.get(name, 1.0))
        sign = 1.0 if share > 0 else -1.0
        for _ in range(abs(share)):
            deviating: tuple[Poly, Poly] = ({ONE: 1.0, ((f"c:{name}", 1),): -1.0}, {((f"s:{name}", 1),): sign})
            out = _complex_product(out, deviating)
            if with_nominal:
                out = _complex_product(out, ({((f"nc:{name}", 1),): 1.0}, {((f"ns:{name}", 1),): sign}))
    return out


def _expanded(system: System, name: str) -> Poly:
    """The update of a real variable in nominal values and deviations."""
    total: Poly = {}
    for term in system.terms[name]:
        value: Poly = {ONE: term.coefficient}
        for factor, power in term.powers:
            for _ in range(power):
                value = product(value, {((f"n:{factor}", 1),): 1.0, ((f"d:{factor}", 1),): 1.0})
        for wave, angle in term.waves:
            cos, sin = _wave(system, angle, with_nominal=True)
            c, s = math.cos(angle.constant), math.sin(angle.constant)
            parts = ((cos, c), (sin, -s)) if wave == "cos" else ((sin, c), (cos, s))
            value = _sum(*(product(value, product(part, {ONE: by})) for part, by in parts))
        total = _sum(total, value)
    return total


def _split(update: Poly, coefficients: list[Poly]) -> tuple[Poly, Poly]:
    """(nominal next value, update of the deviation); nominal factors become numbers or new coefficients."""
    by_deviation: dict[Monomial, Poly] = {}
    for m, v in update.items():
        deviating = tuple(g for g in m if g[0][0] != "n")
        by_deviation.setdefault(deviating, {})[tuple(g for g in m if g[0][0] == "n")] = v
    nominal = by_deviation.pop(ONE, {})
    out: Poly = {}
    for m, factor in by_deviation.items():
        if set(factor) == {ONE}:
            out[m] = factor[ONE]
            continue
        if factor not in coefficients:
            coefficients.append(factor)
        out[_with(m, f"h:{coefficients.index(factor)}", 1)] = 1.0
    return nominal, out


def _turned(system: System, name: str) -> dict[str, Poly]:
    cos, sin = _wave(system, system.turns[name], with_nominal=False)
    minus = product({ONE: -1.0}, cos)
    return {f"c:{name}": {m: v for m, v in _sum({ONE: 1.0}, minus).items() if v != 0.0}, f"s:{name}": sin}


def _ordered(system: System, steps: dict[str, Poly], waves: dict[str, dict[str, Poly]]) -> list[Stage]:
    """The simultaneous updates one after the other: a variable changes once nothing else has to read it.

    Where two read each other, the old value of one is kept as a variable of its own.
    """
    waiting = {**{v: {f"d:{v}": steps[v]} for v in steps}, **waves}
    stages: list[Stage] = []
    while waiting:
        free = [v for v in waiting if not any(v in _reads(waiting[q]) for q in waiting if q != v)]
        v = free[0] if free else next(iter(waiting))
        if not free:
            old = f"old_{v}"
            stages.append(Stage({_renamed(g, v, old): {((g, 1),): 1.0} for g in waiting[v]}))
            for q in waiting:
                if q != v:
                    waiting[q] = {g: _rename(p, v, old) for g, p in waiting[q].items()}
        stages += _elementary(v, waiting.pop(v))
    return stages


def _elementary(v: str, becomes: dict[str, Poly]) -> list[Stage]:
    """One substitution as several that each add one monomial: far fewer terms in all."""
    own = f"d:{v}"
    if all(p == {((g, 1),): 1.0} for g, p in becomes.items()):
        return []
    if own not in becomes:
        return [Stage(becomes)]
    scale: Poly = {}
    shears = []
    for m, value in becomes[own].items():
        powers = dict(m)
        if own not in powers:
            shears.append({((own, 1),): 1.0, m: value})
        elif powers[own] == 1 and all(g == own or g.startswith("h:") for g in powers):
            scale[m] = value
        else:
            return [Stage(becomes)]
    first = [] if scale == {((own, 1),): 1.0} else [Stage({own: scale})]
    return first + [Stage({own: shear}) for shear in shears]


def _reads(becomes: dict[str, Poly]) -> set[str]:
    return {g.partition(":")[2] for p in becomes.values() for m in p for g, _ in m}


def _renamed(generator: str, name: str, new: str) -> str:
    kind, _, own = generator.partition(":")
    return f"{kind}:{new}" if own == name else generator


def _rename(p: Poly, name: str, new: str) -> Poly:
    return {tuple(sorted((_renamed(g, name, new), e) for g, e in m)): v for m, v in p.items()}


def _noise_uses(stages: list[Stage], noises: tuple[str, ...]) -> dict[str, int]:
    """In how many stages each noise is read."""
    read = [_reads(stage.becomes) for stage in stages]
    return {name: sum(name in names for names in read) for name in noises}


def _drawn(stages: list[Stage], uses: dict[str, int]) -> dict[str, set[str]]:
    """Noises that several stages read, with their generators: they are drawn first and kept through the step."""
    out: dict[str, set[str]] = {name: set() for name, count in uses.items() if count > 1}
    for stage in stages:
        for g in {g for p in stage.becomes.values() for m in p for g, _ in m}:
            if g.partition(":")[2] in out:
                out[g.partition(":")[2]].add(g)
    return out


def _draw(name: str, kinds: set[str]) -> Stage:
    waves = {f"c:{name}", f"s:{name}"} if kinds - {f"d:{name}"} else set()
    generators = (kinds & {f"d:{name}"}) | waves
    return Stage({g: {((f"~{g}", 1),): 1.0} for g in sorted(generators)})


def _expected(stage: Stage, once: set[str]) -> Stage:
    """The stage with the noises that only it reads marked for their expectation."""

    def mark(p: Poly) -> Poly:
        return {
            tuple(sorted((f"~{g}" if g.partition(":")[2] in once else g, e) for g, e in m)): v for m, v in p.items()
        }

    return Stage({g: mark(p) for g, p in stage.becomes.items()})
