"""Small builders shared by the tests of `checkers`."""

from __future__ import annotations

from dataclasses import fields

import mpmath as mp
import numpy as np

from checkers import GaussianMixturePrediction, InputError, MomentPrediction, checker, checkers

# options tried on every backend; those it does not have, or refuses, are left out
OPTIONS = [
    {"order": 2},
    {"order": 6},
    {"order": 12},
    {"solver": "clarabel"},
    {"order": 6, "solver": "clarabel"},
    {"n_h": 3},
    {"n_h": 37},
    {"samples": 2000, "seed": 7},
]


def variants():
    """(name, options) of every registered backend, plain and with the options it has."""
    out = []
    for name in checkers():
        plain = checker(name)
        out.append((name, {}))
        known = {f.name for f in fields(plain)}
        for options in OPTIONS:
            if known >= set(options):
                try:
                    checker(name, **options)
                except InputError:
                    continue
                out.append((name, options))
    return out


def spin(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def covariance(sigma1, sigma2, angle=0.0):
    r = spin(angle)
    c = r @ np.diag([sigma1**2, sigma2**2]) @ r.T
    return 0.5 * (c + c.T)


def single(mean, cov, **labels):
    """One step, one mode."""
    return GaussianMixturePrediction([0.0], [1.0], [[mean]], [[np.asarray(cov, dtype=float)]], **labels)


def row(means, covs, **labels):
    """One mode, one step per case: a row of independent cases."""
    means = np.asarray(means, dtype=float)
    return GaussianMixturePrediction(
        np.arange(len(means), dtype=float),
        [1.0],
        means[:, None],
        np.asarray(covs, dtype=float)[:, None],
        **labels,
    )


def mixture(rng, steps=4, modes=3, per_step=False, **labels):
    """A random mixture around the origin."""
    shape = (steps, modes) if per_step else (modes,)
    sigma = rng.uniform(0.2, 2.0, (steps, modes, 2))
    angle = rng.uniform(0, np.pi, (steps, modes))
    covs = [[covariance(*sigma[t, k], angle[t, k]) for k in range(modes)] for t in range(steps)]
    return GaussianMixturePrediction(
        np.arange(1, steps + 1) * 0.5,
        rng.dirichlet(np.ones(modes), shape[:-1]),
        rng.uniform(-4, 4, (steps, modes, 2)),
        covs,
        modes="per_step" if per_step else "persistent",
        **labels,
    )


def cases(rng, n, sigma=(0.05, 5.0), ratio=8.0, reach=6.0):
    """n random (pose, mean, covariance): means from inside an ellipse of size about 2 to `reach` σ away."""
    poses = np.column_stack([rng.uniform(-50, 50, (n, 2)), rng.uniform(-7, 7, n)])
    small = np.exp(rng.uniform(*np.log(sigma), n))
    large = small * np.exp(rng.uniform(0, np.log(ratio), n))
    covs = np.stack([covariance(a, b, t) for a, b, t in zip(small, large, rng.uniform(0, np.pi, n), strict=True)])
    way = rng.uniform(0, 2 * np.pi, n)
    way = np.column_stack([np.cos(way), np.sin(way)])
    sigma_way = np.sqrt(np.einsum("ni,nij,nj->n", way, covs, way))
    distance = rng.uniform(0, 2.5, n) + rng.uniform(0, reach, n) * sigma_way * (rng.random(n) < 0.7)
    return poses, poses[:, :2] + distance[:, None] * way, covs


def discrete(points, weights, order):
    """Moments of a few point masses, computed in many digits and then rounded."""
    with mp.workdps(60):
        points = [[mp.mpf(float(v)) for v in p] for p in points]
        weights = [mp.mpf(float(w)) for w in weights]
        weights = [w / mp.fsum(weights) for w in weights]
        mean = [mp.fsum(w * p[a] for w, p in zip(weights, points, strict=True)) for a in range(2)]
        # central about the mean that will be stored
        mean = [mp.mpf(float(v)) for v in mean]
        out = np.full((order + 1, order + 1), np.nan)
        for i in range(order + 1):
            for j in range(order + 1 - i):
                terms = [
                    w * (p[0] - mean[0]) ** i * (p[1] - mean[1]) ** j for w, p in zip(weights, points, strict=True)
                ]
                out[i, j] = float(mp.fsum(terms))
        return MomentPrediction([0.0], [1.0], [[[float(v) for v in mean]]], out[None, None])
