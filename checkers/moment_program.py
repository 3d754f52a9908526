"""Moment dynamics as arrays: what the compiler `moment_closure` makes and the kernel runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from checkers.deviations import Monomial, Poly
from checkers.validate import Array

Ints = NDArray[np.int64]
# unsigned, as compiled code would otherwise test every index for being negative: more than twice the time
Offsets = NDArray[np.uint64]
Indices = NDArray[np.uint32]


class Sparse(NamedTuple):
    """Polynomials in some values: entry i is Σ_j coefficients[j] · Π values[slots of j]; offsets as in a CSR matrix."""

    sums: Offsets
    coefficients: Array
    products: Offsets
    slots: Indices


class Terms(NamedTuple):
    """The stages' programs: stage → targets → terms, each term a source moment times a factor.

    A stage that `adds` leaves its targets in place and adds to them, in an order that reads no changed moment.
    """

    stages: Offsets
    adds: NDArray[np.bool_]
    targets: Indices
    terms: Offsets
    sources: Indices
    factors: Indices


@dataclass(frozen=True, eq=False)
class Program:
    """What `checkers.kernels.propagate` runs.

    Attributes:
        generators: the names behind the columns of `powers`.
        powers: (S, G) the moments carried.
        initial: (I,) those needed before a step.
        position: (order+1, order+1) index of E[δxⁱ δyʲ], where i + j ≤ order.
        nominal, coefficients: next nominal values and the step's coefficients, over the nominal values (`_slots`).
        turns: (A, A + W + 1) next nominal angles: multiples of angles and noises, and a constant.
        tables: (noise, power of d, of s, of c) of the expectations that the factors read.
        factors: over the coefficients followed by the tables.
        terms: the stages.
    """

    generators: tuple[str, ...]
    powers: Ints
    initial: Offsets
    position: Offsets
    nominal: Sparse
    coefficients: Sparse
    turns: Array
    tables: tuple[tuple[str, int, int, int], ...]
    factors: Sparse
    terms: Terms


def sparse(
    polys: Sequence[Poly], slots: dict[str, int], extra: Callable[[Monomial], list[int]] | None = None
) -> Sparse:
    """Polynomials over the values in `slots`; `extra` gives the slots of a monomial's other generators."""
    sums, coefficients, products, flat = [0], [], [0], []
    for poly in polys:
        for m, value in poly.items():
            coefficients.append(value)
            flat += [slots[g] for g, power in m if g in slots for _ in range(power)]
            flat += extra(m) if extra else []
            products.append(len(flat))
        sums.append(len(coefficients))
    return Sparse(
        np.array(sums, dtype=np.uint64),
        np.array(coefficients, dtype=np.float64),
        np.array(products, dtype=np.uint64),
        np.array(flat, dtype=np.uint32),
    )
