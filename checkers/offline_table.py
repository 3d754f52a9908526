"""Solve the table of `offline-sos` once: `python -m checkers.offline_table --out checkers/data/offline_sos.json`.

Each entry is the indicator polynomial that is optimal for the moments of one random quadratic form, rounded to four
digits; entries are chosen greedily for what they gain on the other forms. Rounding is harmless: a polynomial
Π (1 − u/t)² with positive roots t is ≥ 1 for u ≤ 0 and ≥ 0 everywhere, whatever its roots.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from checkers.kernels.tail import MAX_ORDER, gaussian_form, jacobi, radau, table_bound
from checkers.validate import Array

ORDERS = (2, 4, 6, 8)


def main() -> None:
    """Write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--entries", type=int, default=32, help="per order")
    parser.add_argument("--forms", type=int, default=800, help="random forms the entries are chosen for")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    rng = np.random.default_rng(args.seed)
    table = {str(order): solve(order, args.forms, args.entries, rng).tolist() for order in ORDERS}
    args.out.write_text(json.dumps(table) + "\n", encoding="utf-8")


def solve(order: int, forms: int, entries: int, rng: np.random.Generator) -> Array:
    """(entries, order/2) roots − 1 of the chosen polynomials, in units of E g."""
    candidates = np.empty((forms, order // 2))
    bounds = np.empty((forms, forms))  # of each candidate for each form
    z, noise, room = np.empty((forms, MAX_ORDER + 1)), np.zeros((forms, MAX_ORDER + 1)), np.empty(128)
    scale = np.empty((forms, 2))
    for i in range(forms):
        roots = None
        while roots is None:
            scale[i] = gaussian_form(*random_form(rng), order, z[i], noise[i])
            roots = optimal_roots(order, scale[i, 0], scale[i, 1], z[i], noise[i], room)
        candidates[i] = [float(f"{root:.4g}") for root in roots]
    for i in range(forms):
        for j in range(forms):
            bounds[i, j] = table_bound(*scale[j], z[j], noise[j], candidates[i : i + 1], room)
    chosen: list[int] = []
    best = np.ones(forms)
    for _ in range(entries):
        gain = np.log(np.minimum(bounds, best)).sum(axis=1)
        chosen.append(int(np.argmin(gain)))
        best = np.minimum(best, bounds[chosen[-1]])
    picked: Array = candidates[np.sort(chosen)]
    return picked


def random_form(rng: np.random.Generator) -> tuple[float, ...]:
    """Whitened mean and covariance of a mode outside the disc, from near to 30 standard deviations away."""
    s1, s2 = np.exp(rng.uniform(np.log(0.05), np.log(3.0), 2)) ** 2
    angle, distance = rng.uniform(0, 2 * np.pi), 1.0 + 10 ** rng.uniform(-1, 1.5) * np.sqrt(max(s1, s2))
    return distance * np.cos(angle), distance * np.sin(angle), s1, 0.0, s2, s1 * s2


def optimal_roots(order: int, mean: float, sd: float, z: Array, noise: Array, room: Array) -> Array | None:
    """Roots − 1 of the sharp polynomial of a form, in units of E g; None if some of it lies left of g = 0."""
    if mean <= 0.0:
        return None
    side = order // 2 + 1
    rows = jacobi(z, noise, side, room[:8], room[8:16], room[32 : 32 + side * side].reshape(side, side))
    if rows < order // 2:
        return None
    count = radau(room[:8], room[8:16], rows, -mean / sd, room[16:24], room[24:32])
    roots = sd / mean * np.sort(room[17 : 16 + count])
    return roots if len(roots) == order // 2 and roots[0] > -1.0 else None


if __name__ == "__main__":
    main()
