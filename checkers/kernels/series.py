"""P(|y| ≤ 1) for y ~ N(m, S) in the plane by a series of positive terms (Ruben 1962), in a few operations a term."""

import math

import numba as nb

LONGEST = 160  # terms; beyond, quadrature is faster
_SCALE = 1e-250  # where sums start, so that they neither overflow nor lose a small probability
_SHIFT = -math.log(_SCALE)
_LARGEST = 1260.0  # exponent that a sum so scaled can hold


@nb.njit(inline="always", error_model="numpy")
def serves(along, across, big, small):
    """Whether the series is short and within range for variances big ≥ small > 0 and the mean in their axes."""
    half = 0.5 / small
    offset = 0.5 * (along * along / big + across * across / small)
    return half + offset < _LARGEST and half + math.sqrt(half * offset) < 0.5 * LONGEST


@nb.njit(cache=True, error_model="numpy")
def disc(along, across, big, small, cut):
    """P(|y| ≤ 1) to a relative error of `cut`, or NaN if that takes too many terms.

    Ruben's mixture with β = the small variance, P = Σ a_k P(χ²_(2k+2) ≤ 1/β), has a_k ≥ 0. Their generating function
    G(z) ∝ (1 − γz)^(−1/2) exp(½ b₁² z + ½ b₂² (1 − γ) z / (1 − γz)), γ = 1 − small/big, satisfies a first-order
    differential equation with positive coefficients in z, 1/(1 − γz) and its square, so each a_k costs three
    recursions without cancellation. With the χ² laws as Poisson tails the sum becomes
    e^(−h) Σ_j h^j / j! · (a_0 + … + a_(j−1)), h = 1/(2β). It ends when terms at least halve and the last is below
    the cut.
    """
    h = 0.5 / small
    b1, b2 = across * across / small, along * along / big
    kept = small / big
    gamma = (big - small) / big
    from_a, from_once, from_twice = (
        0.5 * (b1 + gamma + b2 * kept),
        0.5 * gamma * (gamma + b2 * kept),
        0.5 * gamma * b2 * kept,
    )
    a = cumulated = _SCALE
    once, twice = 0.0, 0.0  # coefficients k − 1 of G/(1 − γz) and G/(1 − γz)²: a_k waits for a_(k−1) alone
    poisson = h
    total = before = _SCALE * h
    for k in range(1, LONGEST):
        share = 1.0 / k
        once_more = a + gamma * once
        a = (share * from_a) * a + share * (from_once * once + from_twice * twice)
        twice = once_more + gamma * twice
        once = once_more
        cumulated += a
        poisson *= h / (k + 1)
        term = poisson * cumulated
        total += term
        if term <= cut * total and term <= 0.5 * before:
            return math.sqrt(kept) * total * math.exp(_SHIFT - 0.5 * (b1 + b2) - h)
        before = term
    return math.nan
