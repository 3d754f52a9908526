"""The loop of moment propagation: nominal course, factors and sparse stages, step after step."""

import math

import numba as nb
import numpy as np


@nb.njit(cache=True, error_model="numpy")
def evaluate(sums, coefficients, products, slots, values, out):
    """out[i] = Σ_j coefficients[j] Π values[slots of j] (see `moment_closure.Sparse`)."""
    for i in range(len(sums) - 1):
        total = 0.0
        for j in range(sums[i], sums[i + 1]):
            value = coefficients[j]
            for s in range(products[j], products[j + 1]):
                value *= values[slots[s]]
            total += value
        out[i] = total


@nb.njit(cache=True, error_model="numpy")
def advance(stages, adds, targets, terms, sources, factor_of, factors, moments, scratch):
    """Run the stages of one step on `moments` in place."""
    for s in range(len(stages) - 1):
        first, last = stages[s], stages[s + 1]
        if adds[s]:
            for r in range(first, last):
                total = moments[targets[r]]
                for k in range(terms[r], terms[r + 1]):
                    total += factors[factor_of[k]] * moments[sources[k]]
                moments[targets[r]] = total
            continue
        for r in range(first, last):
            total = 0.0
            for k in range(terms[r], terms[r + 1]):
                total += factors[factor_of[k]] * moments[sources[k]]
            scratch[r - first] = total
        for r in range(first, last):
            moments[targets[r]] = scratch[r - first]


@nb.njit(cache=True, error_model="numpy")
def propagate(
    program, reals, angles, centres, units, turns, tables, weights, moments, carried, place, axes, means, out
):
    """Fill means (K, T + 1, 2) and central moments out (K, T + 1, order + 1, order + 1) of the position.

    Args:
        program: nominal, coefficients and factors (`Sparse`), and terms (`Terms`), as nested tuples.
        reals, angles: (K, R), (K, A) nominal values at the start, overwritten.
        centres: (K, T, W) nominal values of the noises; units: (W,) their multiples inside angles.
        turns: (A, A + W + 1).
        tables: (K, T, C, N) expectations of the noises, per component of the step's mixture.
        weights: (K, T, C) of the components.
        moments: (S,) at the start.
        carried: (I,) the moments that are carried from step to step.
        place: (order + 1, order + 1) of the position's moments; axes: (2,) of the position among the reals.
    """
    nominal, coefficients, parts, terms = program
    modes, steps, components, count = len(tables), len(tables[0]), tables.shape[2], len(coefficients[0]) - 1
    values = np.empty(reals.shape[1] + 2 * angles.shape[1] + 3 * centres.shape[2])
    slots, factors = np.empty(count + tables.shape[3]), np.empty(len(parts[0]) - 1)
    scratch, now, branch, before = np.empty((4, len(moments)))
    turned = np.empty(angles.shape[1])
    for k in range(modes):
        now[:] = moments
        for t in range(steps + 1):
            dx, dy = centred(now, place, out[k, t])
            means[k, t, 0], means[k, t, 1] = reals[k, axes[0]] + dx, reals[k, axes[1]] + dy
            if t == steps:
                break
            fill(values, reals[k], angles[k], centres[k, t], units)
            evaluate(*coefficients, values, slots)
            if components > 1:
                before[:] = now
                now[carried] = 0.0
            for c in range(components):
                slots[count:] = tables[k, t, c]
                evaluate(*parts, slots, factors)
                if components == 1:
                    advance(*terms, factors, now, scratch)
                    break
                branch[:] = before
                advance(*terms, factors, branch, scratch)
                for i in carried:
                    now[i] += weights[k, t, c] * branch[i]
            evaluate(*nominal, values, reals[k])
            turn(turns, angles[k], centres[k, t], turned)


@nb.njit(cache=True, error_model="numpy")
def turn(turns, angles, centre, turned):
    """Advance the nominal angles."""
    count = len(angles)
    for a in range(count):
        turned[a] = turns[a, -1]
        for b in range(count):
            turned[a] += turns[a, b] * angles[b]
        for w in range(len(centre)):
            turned[a] += turns[a, count + w] * centre[w]
    angles[:] = turned


@nb.njit(cache=True, error_model="numpy")
def fill(values, reals, angles, centre, units):
    """The nominal values in the order of `moment_closure._slots`."""
    at = len(reals)
    values[:at] = reals
    for a in range(len(angles)):
        values[at], values[at + 1] = math.cos(angles[a]), math.sin(angles[a])
        at += 2
    for w in range(len(centre)):
        values[at + w] = centre[w]
    at += len(centre)
    for w in range(len(centre)):
        if units[w] != 0.0:
            values[at], values[at + 1] = math.cos(units[w] * centre[w]), math.sin(units[w] * centre[w])
        at += 2


@nb.njit(cache=True, error_model="numpy")
def centred(raw, place, out):
    """Fill out (order+1, order+1) with central moments from E[δxⁱ δyʲ] = raw[place[i, j]]; returns the mean of δ.

    The nominal position is about a spread from the mean, so this binomial shift costs a digit or two at most.
    """
    order = len(place) - 1
    mx, my = raw[place[1, 0]], raw[place[0, 1]]
    for i in range(order + 1):
        for j in range(order + 1 - i):
            total, x = 0.0, 1.0
            for a in range(i + 1):
                y = x
                for b in range(j + 1):
                    total += y * raw[place[i - a, j - b]]
                    y *= -my * (j - b) / (b + 1)
                x *= -mx * (i - a) / (a + 1)
            out[i, j] = total
    out[1, 0] = 0.0
    out[0, 1] = 0.0
    return mx, my
