"""E_ξ[1 − Π_t (1 − r_t(ξ))] over the factors ξ that persist, for steps that are independent given ξ."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from checkers.kernels.given import DONE, SPLIT, fill_sets, first_hits, over_cells
from checkers.kernels.path import ALIGNED, BOXES, sweep_steps
from checkers.kernels.rim import EDGE, FINE, FINEST, PIECE, ROUGH
from checkers.kind import Kind
from checkers.validate import Array

_LEAST = 1e-280  # largest risk of a step below which that of the path is not worked out
_BLUR = 1e-9  # of the sizes at hand: standard deviation given to a rest that has none
_MOST_CELLS = 60_000  # about two million nodes
_REPLICATES, _POINTS = 16, 1024


def over_factors(
    shape_kind: int, shape: Array, poses: Array, inputs: tuple[Array, ...], tolerance: float, seed: int
) -> tuple[Array, float, Kind]:
    """First-hit probabilities (T,), absolute error of their sum, and kind.

    Up to two factors: the plane of ξ is cut into cells until each is small against what the rest ε smooths the
    integrand by (a rule that does not resolve it agrees with itself by accident), then where two Gauss rules differ
    most. More factors, or a rest too small for that: Sobol' points (Owen 1995 scrambling) through the normal
    quantile, and three standard errors between replicates, an estimate.

    Args:
        poses: (T, 3).
        inputs: means (T, 2), factors (T, 2, R), covariances of the rest (T, 2, 2), headings (T,).
        tolerance: of the sum, relative.
        seed: of the scrambling.
    """
    largest = _largest_step(shape_kind, shape, poses, inputs)
    if largest < _LEAST:
        return np.zeros(len(poses)), len(poses) * _LEAST, Kind.EXACT
    sets = moving_sets(shape_kind, shape, poses, inputs)
    # the risk is at least that of the likeliest step: what is left out and what is rounded is small against it
    left_out = 0.01 * tolerance * largest
    reach = float(np.sqrt(-2.0 * np.log(left_out / (100.0 * len(poses)))))
    found = _cells(sets, reach, tolerance) if inputs[1].shape[-1] <= 2 else None
    if found is None:
        return _sobol(sets, reach, seed)
    return found[0], found[1] + left_out, Kind.EXACT


def moving_sets(
    shape_kind: int, shape: Array, poses: Array, inputs: tuple[Array, ...]
) -> tuple[bool, Array, Array, Array]:
    """(octagon, rows, arcs, moves): the sets in the plane of the white rest, see `kernels.rim` and `kernels.given`."""
    means, factors, rest, headings = inputs
    roots = _roots(shape_kind, shape, poses, means, rest)
    octagon = shape_kind == BOXES
    rows = np.empty((len(poses), 8, EDGE) if octagon else (len(poses), len(shape), PIECE))
    fill_sets(shape_kind, shape, poses, means, roots, headings, rows)
    arcs = np.array([[0.0, 0.0, 2.0 * np.pi]]) if octagon or shape_kind == ALIGNED else exposed_arcs(shape)
    return octagon, rows, arcs, np.ascontiguousarray(np.linalg.solve(roots, factors))


def _largest_step(shape_kind: int, shape: Array, poses: Array, inputs: tuple[Array, ...]) -> float:
    """The largest marginal of the steps."""
    means, factors, rest, headings = inputs
    values, vectors = np.linalg.eigh(factors @ np.swapaxes(factors, -1, -2) + rest)
    roots = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    value, error = np.empty((2, 1, len(poses)))
    sweep_steps(shape_kind, shape, poses[None], means, roots, headings, 1e-3, value, error)
    return float(value.max())


def _roots(shape_kind: int, shape: Array, poses: Array, means: Array, rest: Array) -> Array:
    """Invertible roots (T, 2, 2) of the rest's covariances."""
    size = shape.max() if shape_kind in (BOXES, ALIGNED) else 1.0 / np.abs(shape[:, 2:]).max()
    least = _BLUR * (size + np.hypot(*(means - poses[:, :2]).T))
    values, vectors = np.linalg.eigh(rest)
    roots: Array = vectors * np.maximum(np.sqrt(np.maximum(values, 0.0)), least[:, None])[:, None, :]
    return roots


def exposed_arcs(pieces: Array) -> Array:
    """(M, 3) piece, from, to [rad]: the parts of ellipses' rims outside all others; pieces as `packing.pack_pieces`."""
    return _exposed_arcs(pieces.tobytes())


@lru_cache(maxsize=256)
def _exposed_arcs(packed: bytes) -> Array:
    pieces = np.frombuffer(packed).reshape(-1, 5)
    forms = np.zeros((len(pieces), 2, 2))
    forms[:, 0, 0], forms[:, 0, 1], forms[:, 1, 1] = pieces[:, 2:].T
    distinct = np.unique(pieces, axis=0, return_index=True)[1]
    arcs = []
    for i in distinct:
        others = [j for j in distinct if j != i]
        # piece j in the plane where i is the unit disc: {|m + A u| ≤ 1}
        maps = forms[others] @ np.linalg.inv(forms[i])
        offsets = np.einsum("jab,jb->ja", forms[others], pieces[i, :2] - pieces[others, :2])
        cuts = np.concatenate([[0.0, 2.0 * np.pi], *(_crossings(m, a) for m, a in zip(offsets, maps, strict=True))])
        cuts.sort()
        middles = 0.5 * (cuts[1:] + cuts[:-1])
        rim = np.stack([np.cos(middles), np.sin(middles)])
        covered = (np.linalg.norm(offsets[:, :, None] + maps @ rim, axis=1) < 1.0).any(axis=0)
        arcs += [(i, low, high) for low, high, c in zip(cuts, cuts[1:], covered, strict=False) if high > low and not c]
    found = np.array(arcs, float).reshape(-1, 3)
    found.flags.writeable = False
    return found


def _crossings(m: Array, a: Array) -> Array:
    """Angles in [0, 2π) at which |m + A (cos θ, sin θ)| is 1: roots on the unit circle of a quartic in e^(iθ)."""
    square, linear = a.T @ a, 2.0 * a.T @ m
    second = 0.25 * (square[0, 0] - square[1, 1] - 2j * square[0, 1])
    first = 0.5 * (linear[0] - 1j * linear[1])
    constant = 0.5 * np.trace(square) + m @ m - 1.0
    roots = np.roots([second, first, constant, np.conj(first), np.conj(second)])
    angles: Array = np.angle(roots[np.abs(np.abs(roots) - 1.0) < 1e-6]) % (2.0 * np.pi)
    return angles


@lru_cache(maxsize=8)
def _rules(nodes: int) -> Array:
    """(2, 2, Q) Gauss–Legendre nodes and weights, of Q and of Q − 1."""
    rules = np.zeros((2, 2, nodes))
    rules[0] = np.polynomial.legendre.leggauss(nodes)
    rules[1, :, :-1] = np.polynomial.legendre.leggauss(nodes - 1)
    return rules


def _cells(sets: tuple[bool, Array, Array, Array], reach: float, tolerance: float) -> tuple[Array, float] | None:
    """(first hits (T,), error), or None if the cells needed are too many."""
    rank, steps = sets[3].shape[2], len(sets[1])
    rules, panel = (_rules(5), ROUGH) if tolerance > 1e-6 else (_rules(8), FINE if tolerance > 1e-9 else FINEST)
    kept: list[tuple[Array, Array, Array, Array]] = []
    cells = np.zeros((1, 2, rank))
    cells[:, 1] = reach
    count = 0
    while True:
        count += len(cells)
        if count > _MOST_CELLS:
            return None
        values, errors = np.empty((len(cells), steps)), np.empty(len(cells))
        axes, states = np.empty((2, len(cells)), np.int64)
        over_cells(*sets, cells, reach, panel, rules, values, errors, axes, states)
        done, coarse = states == DONE, states == SPLIT
        kept.append((cells[done], values[done], errors[done], axes[done]))
        if coarse.any():
            cells = _halved(cells[coarse], axes[coarse])
            continue
        every = [np.concatenate(part) for part in zip(*kept, strict=True)]
        total, error = every[1].sum(axis=0), float(every[2].sum())
        if error <= tolerance * total.sum():
            return total, error
        # the least errors that add up to half of what is allowed stay
        order = np.argsort(every[2])
        stays = np.cumsum(every[2][order]) <= 0.5 * tolerance * total.sum()
        kept = [tuple(part[order[stays]] for part in every)]
        cells = _halved(every[0][order[~stays]], every[3][order[~stays]])


def _halved(cells: Array, axes: Array) -> Array:
    """Each cell cut in two across its axis."""
    which = np.arange(len(cells))
    half = cells[which, 1, axes] / 2
    low, high = cells.copy(), cells.copy()
    low[which, 1, axes] = high[which, 1, axes] = half
    low[which, 0, axes] -= half
    high[which, 0, axes] += half
    return np.concatenate([low, high])


def _sobol(sets: tuple[bool, Array, Array, Array], reach: float, seed: int) -> tuple[Array, float, Kind]:
    from scipy.special import ndtri  # noqa: PLC0415  slow to import, seldom needed
    from scipy.stats.qmc import Sobol  # noqa: PLC0415

    rng = np.random.default_rng(seed)
    means = []
    for _ in range(_REPLICATES):
        uniform = Sobol(sets[3].shape[2], scramble=True, seed=rng).random(_POINTS)
        nodes = ndtri(np.clip(uniform, 1e-16, 1 - 1e-16))
        out = np.empty((len(nodes), len(sets[1])))
        first_hits(*sets, nodes, reach, ROUGH, out)
        means.append(out.mean(axis=0))
    spread = 3.0 * float(np.std(np.sum(means, axis=1), ddof=1)) / np.sqrt(_REPLICATES)
    # where no point hit, the risk is not known to be below one hit in all points
    floor = 3.0 / (_REPLICATES * _POINTS)
    total: Array = np.mean(means, axis=0)
    return total, max(spread, floor if total.sum() < floor else 0.0), Kind.ESTIMATE
