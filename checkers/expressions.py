"""Update rules as text, read into sums of terms: `x + dt * v * cos(theta)`. Parsed, never evaluated."""

from __future__ import annotations

import ast
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from checkers.validate import Array, InputError, shown

Powers = tuple[tuple[str, int], ...]
_MOST = 4096


@dataclass(frozen=True)
class Angle:
    """Σ multiple · name + constant [rad]."""

    multiples: tuple[tuple[str, float], ...]
    constant: float = 0.0

    def at(self, values: Mapping[str, Array]) -> Array | float:
        """The angle for values of its names, any common shape."""
        return sum((m * values[name] for name, m in self.multiples), start=self.constant)


@dataclass(frozen=True)
class Term:
    """coefficient · Π name^power · Π cos or sin of an angle."""

    coefficient: float
    powers: Powers = ()
    waves: tuple[tuple[str, Angle], ...] = ()

    def at(self, values: Mapping[str, Array]) -> Array | float:
        """The term for values of its names, any common shape."""
        product: Array | float = self.coefficient
        for name, power in self.powers:
            product = product * values[name] ** power
        for wave, angle in self.waves:
            product = product * (np.cos if wave == "cos" else np.sin)(angle.at(values))
        return product

    @property
    def names(self) -> set[str]:
        """Every name in it."""
        return {n for n, _ in self.powers} | {n for _, angle in self.waves for n, _ in angle.multiples}


def parse(text: str, where: str, names: Collection[str], constants: Mapping[str, float]) -> tuple[Term, ...]:
    """The terms of a polynomial in `names` and in cosines and sines of their linear combinations.

    Args:
        text: + - * / ** of numbers, names and constants; division by numbers only; cos(…) and sin(…).
        where: for messages.
        names: variables and noises.
        constants: names of numbers.

    Raises:
        InputError: naming `where` and what in the text is not of this form.
    """
    if not isinstance(text, str):
        raise InputError(f"{where}: expected text such as 'x + dt * v * cos(theta)', got {shown(text)}")
    try:
        tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise InputError(f"{where}: cannot read {shown(text)}: {getattr(error, 'msg', error)}") from None
    try:
        return _merged(_Reader(where, names, constants).terms(tree))
    except (RecursionError, MemoryError):
        raise InputError(f"{where}: nested too deeply") from None


def as_angle(terms: tuple[Term, ...], where: str) -> Angle:
    """Terms that are linear in their names, as an angle."""
    multiples: dict[str, float] = {}
    constant = 0.0
    for term in terms:
        if term.waves or len(term.powers) > 1 or any(p != 1 for _, p in term.powers):
            raise InputError(f"{where}: expected an angle to be a sum of multiples of names, got a product or a power")
        if term.powers:
            multiples[term.powers[0][0]] = term.coefficient
        else:
            constant = term.coefficient
    return Angle(tuple(sorted(multiples.items())), constant)


@dataclass(frozen=True)
class _Reader:
    where: str
    names: Collection[str]
    constants: Mapping[str, float]

    def terms(self, node: ast.expr) -> list[Term]:
        if isinstance(node, ast.Constant):
            return [Term(self.number(node))]
        if isinstance(node, ast.Name):
            return [self.name(node.id)]
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
            sign = -1.0 if isinstance(node.op, ast.USub) else 1.0
            return [replace(t, coefficient=sign * t.coefficient) for t in self.terms(node.operand)]
        if isinstance(node, ast.BinOp):
            return self.binary(node)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ("cos", "sin"):
            if len(node.args) != 1 or node.keywords:
                raise InputError(f"{self.where}: expected {node.func.id} of one angle, got {shown(ast.unparse(node))}")
            angle = as_angle(_merged(self.terms(node.args[0])), f"{self.where}: {shown(ast.unparse(node))}")
            return [Term(1.0, (), ((node.func.id, angle),))]
        raise self.refused(node)

    def binary(self, node: ast.BinOp) -> list[Term]:
        left, right = self.terms(node.left), self.terms(node.right)
        if isinstance(node.op, ast.Add):
            return left + right
        if isinstance(node.op, ast.Sub):
            return left + [replace(t, coefficient=-t.coefficient) for t in right]
        if isinstance(node.op, ast.Mult):
            return self.product(left, right)
        number = right[0].coefficient if len(right) == 1 and not (right[0].powers or right[0].waves) else None
        if isinstance(node.op, ast.Div) and number:
            return [replace(t, coefficient=t.coefficient / number) for t in left]
        if isinstance(node.op, ast.Pow) and number in (0, 1, 2, 3, 4, 5, 6, 7, 8):
            out = [Term(1.0)]
            for _ in range(int(number)):
                out = self.product(out, left)
            return out
        raise self.refused(node)

    def product(self, left: list[Term], right: list[Term]) -> list[Term]:
        """Like terms are added at once: a rule from a file must not grow without bound."""
        if len(left) * len(right) > _MOST:
            raise InputError(f"{self.where}: expected at most {_MOST} terms in a product, got {len(left) * len(right)}")
        return list(_merged([_product(a, b) for a in left for b in right]))

    def number(self, node: ast.Constant) -> float:
        if isinstance(node.value, bool) or not isinstance(node.value, int | float):
            raise self.refused(node)
        value = float(min(max(node.value, -1e300), 1e300))
        if not np.isfinite(value) or abs(value) >= 1e300:
            raise self.refused(node)
        return value

    def name(self, name: str) -> Term:
        if name in self.constants:
            return Term(self.constants[name])
        if name not in self.names:
            known = ", ".join([*self.names, *self.constants])
            raise InputError(f"{self.where}: {name!r} is missing: neither a variable nor a noise; known are {known}")
        return Term(1.0, ((name, 1),))

    def refused(self, node: ast.AST) -> InputError:
        return InputError(
            f"{self.where}: expected sums and products of names, numbers, cos and sin, got {shown(ast.unparse(node))}"
        )


def _product(a: Term, b: Term) -> Term:
    powers = dict(a.powers)
    for name, power in b.powers:
        powers[name] = powers.get(name, 0) + power
    waves = tuple(sorted(a.waves + b.waves, key=repr))
    return Term(a.coefficient * b.coefficient, tuple(sorted(powers.items())), waves)


def _merged(terms: list[Term]) -> tuple[Term, ...]:
    """Equal terms added, those that vanish dropped."""
    sums: dict[Any, float] = {}
    for t in terms:
        sums[t.powers, t.waves] = sums.get((t.powers, t.waves), 0.0) + t.coefficient
    return tuple(Term(c, powers, waves) for (powers, waves), c in sums.items() if c != 0.0)
