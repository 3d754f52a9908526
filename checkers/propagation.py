"""Exact moments of the position under uncertain controls (Jasour et al. 2021, section V)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from checkers.dynamics import System
from checkers.joint_normal import JointNormal
from checkers.moment_closure import compiled
from checkers.moment_program import Program
from checkers.moments import gaussian_central_moments
from checkers.quadrature import Rule
from checkers.random_variables import RandomVariable
from checkers.validate import Array, InputError

Initial = Mapping[tuple[str, ...], RandomVariable | JointNormal]
Draws = Sequence[RandomVariable]  # one a step


class PositionMoments(NamedTuple):
    """Means (T + 1, M, 2) [m] and central moments (T + 1, M, order + 1, order + 1), NaN where i + j > order."""

    means: Array
    central: Array


class KernelInput(NamedTuple):
    """What `checkers.kernels.propagate.propagate` reads, for M modes of C components each."""

    reals: Array
    angles: Array
    centres: Array
    units: Array
    turns: Array
    tables: Array
    weights: Array
    moments: Array
    carried: NDArray[np.uint64]
    place: NDArray[np.uint64]
    axes: NDArray[np.uint64]


def position_moments(
    system: System, initial: Initial, modes: Sequence[Sequence[Sequence[Draws]]], weights: Array, order: int
) -> PositionMoments:
    """Propagate the moments of the position; exact up to rounding.

    Args:
        system: closed.
        initial: blocks of independent variables, covering all.
        modes: (M, C, W, T): per mode, per component of a mixture drawn anew each step, and per noise, a random
            variable per step.
        weights: (M, T, C) of the components.
        order: highest order, 2 to 12.

    Returns:
        at times 0, dt, …, T·dt.
    """
    from checkers.kernels.propagate import propagate  # noqa: PLC0415  numba costs import time

    program = compiled(system, order)
    given = kernel_input(system, program, initial, modes, weights)
    shape = (len(modes), weights.shape[1] + 1)
    means, central = np.empty((*shape, 2)), np.full((*shape, order + 1, order + 1), np.nan)
    propagate(kernel_program(program), *given, means, central)
    _forget_rounding(central)
    return PositionMoments(np.swapaxes(means, 0, 1), np.swapaxes(central, 0, 1))


def _forget_rounding(central: Array) -> None:
    """Put what rounding may have left in the place of a spread far below an earlier one, as after a full circle.

    Such a spread is known to the rounding of the earlier one only, and what is not known is not certainty: it becomes
    a round Gaussian of the size of that rounding.

    Raises:
        InputError: for a spread so far below 0 that rounding does not explain it.
    """
    spread = central[..., 2, 0] + central[..., 0, 2]
    noise = 1e-13 * np.maximum.accumulate(spread, axis=1)
    if (spread < -100.0 * noise).any():
        raise InputError("moments: lost to rounding, a variance came out negative; ask for a lower order")
    gone = (spread <= noise) & (noise > 0.0)
    order = central.shape[-1] - 1
    central[gone] = gaussian_central_moments(noise[gone, None, None] * np.eye(2), order)


def kernel_program(program: Program) -> tuple[tuple[NDArray[Any], ...], ...]:
    """The program as plain tuples of arrays."""
    p = program
    return tuple(p.nominal), tuple(p.coefficients), tuple(p.factors), tuple(p.terms)


def kernel_input(
    system: System,
    program: Program,
    initial: Initial,
    modes: Sequence[Sequence[Sequence[Draws]]],
    weights: Array,
) -> KernelInput:
    """Nominal start, initial moments, and expectations of the noises."""
    nominal = dict(_nominal(initial))
    units = np.array([system.noise_units.get(w, 0.0) for w in system.noises])
    means = np.array([[[[x.mean for x in draws] for draws in noises] for noises in mode] for mode in modes])
    means = means.reshape(len(modes), weights.shape[2], len(system.noises), weights.shape[1])
    centres = np.ascontiguousarray(np.einsum("mcwt,mtc->mtw", means, weights))
    moments = np.zeros(len(program.powers))
    moments[program.initial] = _initial_moments(program, initial)
    return KernelInput(
        np.tile([nominal[v] for v in system.reals], (len(modes), 1)),
        np.tile(np.array([nominal[v] for v in system.angles]), (len(modes), 1)),
        centres,
        units,
        program.turns,
        _tables(system, program, modes, means, centres, units),
        np.ascontiguousarray(weights),
        moments,
        program.initial,
        program.position,
        np.array([system.reals.index(v) for v in system.position], dtype=np.uint64),
    )


def check_degree(name: str, variables: Sequence[RandomVariable], power: int) -> None:
    """Refuse a random variable without the moment that is asked of it."""
    for x in variables:
        if x.degree < power:
            raise InputError(
                f"{name}: expected a distribution with a moment of order {power}, got one that has them up to order "
                f"{x.degree}; ask for a lower order"
            )


def _nominal(initial: Initial) -> Iterator[tuple[str, float]]:
    for names, block in initial.items():
        yield from zip(names, block.mean if isinstance(block, JointNormal) else (block.mean,), strict=True)


def _initial_moments(program: Program, initial: Initial) -> Array:
    """Moments of the start, a product over independent blocks."""
    powers = program.powers[program.initial]
    column = {g: powers[:, i] for i, g in enumerate(program.generators)}
    none = np.zeros(len(powers), dtype=np.int64)
    out = np.ones(len(powers))
    for names, block in initial.items():
        if isinstance(block, JointNormal):
            unique, which = np.unique(np.stack([column[f"d:{v}"] for v in names], -1), axis=0, return_inverse=True)
            out *= np.array([block.central_moment(p) for p in unique])[which.ravel()]
            continue
        kinds = np.stack([column.get(f"{kind}:{names[0]}", none) for kind in "dsc"], -1)
        top = kinds.max(axis=0) + 1
        check_degree(f"initial[{names[0]!r}]", [block], int(top[0]) - 1)
        unique, which = np.unique(np.ravel_multi_index(tuple(kinds.T), top), return_inverse=True)
        wanted = np.stack(np.unravel_index(unique, top), -1).astype(np.int64)
        rule = block.rule(float(wanted[:, 1:].sum(axis=1).max()))
        out *= _expectations(rule.deviations[None], rule.weights[None], 1.0, wanted)[0][which]
    return out


def _tables(
    system: System,
    program: Program,
    modes: Sequence[Sequence[Sequence[Draws]]],
    means: Array,
    centres: Array,
    units: Array,
) -> Array:
    """(M, T, C, N) expectations E[δ^d sin^s(unit δ) (1 − cos(unit δ))^c] that the program asks for."""
    count, components, _, steps = means.shape
    out = np.empty((count, steps, components, len(program.tables)))
    for w, noise in enumerate(system.noises):
        mine = [n for n, entry in enumerate(program.tables) if entry[0] == noise]
        if not mine:
            continue
        powers = np.array([program.tables[n][1:] for n in mine])
        frequency = units[w] * float(powers[:, 1:].sum(axis=1).max())
        draws = [x for mode in modes for noises in mode for x in noises[w]]  # (M, C, T)
        check_degree(f"controls: {noise!r}", draws, int(powers[:, 0].max()))
        shift = (means[:, :, w] - centres[:, None, :, w]).ravel()
        out[..., mine] = np.moveaxis(
            _drawn(draws, shift, frequency, units[w], powers).reshape(count, components, steps, -1), 1, 2
        )
    return out


def _drawn(draws: Draws, shift: Array, frequency: float, unit: float, powers: NDArray[np.int64]) -> Array:
    """(D, N) expectations of the noises about their means plus `shift` (D,); each different one evaluated once."""
    place: dict[tuple[int, float], int] = {}
    which = [place.setdefault((id(x), s), len(place)) for x, s in zip(draws, shift.tolist(), strict=True)]
    first = [which.index(i) for i in range(len(place))]
    points, weights = _stacked([draws[i].rule(frequency) for i in first])
    return _expectations(points + shift[first, None], weights, unit, powers)[which]


def _stacked(rules: Sequence[Rule]) -> tuple[Array, Array]:
    """Rules as rows of equal length, filled up with points of no weight."""
    longest = max(len(r.weights) for r in rules)
    points, weights = np.zeros((2, len(rules), longest))
    for i, rule in enumerate(rules):
        points[i, : len(rule.weights)], weights[i, : len(rule.weights)] = rule
    return points, weights


def _expectations(points: Array, weights: Array, unit: float, powers: NDArray[np.int64]) -> Array:
    """(D, N) of points and weights (D, P), powers (N, 3) of the deviation, of its sine and of one minus its cosine."""
    factors = (points, np.sin(unit * points), 2.0 * np.sin(0.5 * unit * points) ** 2)
    grown: dict[tuple[int, ...], Array] = {(0, 0, 0): weights}
    columns = [_grown(grown, (d, s, c), factors).sum(axis=1) for d, s, c in powers.tolist()]
    return np.stack(columns, axis=-1)


def _grown(known: dict[tuple[int, ...], Array], powers: tuple[int, ...], factors: Sequence[Array]) -> Array:
    """weights · Π factor^power, built from the next lower one."""
    if powers not in known:
        axis = next(i for i in (0, 2, 1) if powers[i])
        lower = tuple(p - (i == axis) for i, p in enumerate(powers))
        known[powers] = _grown(known, lower, factors) * factors[axis]
    return known[powers]
