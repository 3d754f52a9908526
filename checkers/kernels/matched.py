"""Distribution function of the non-central χ² law that stands in for a quadratic form."""

import math

import numba as nb

_LARGEST = 2000.0  # beyond, the law is normal to the accuracy of the match
_SCALE = 1e-250


@nb.njit(cache=True, error_model="numpy")
def matched_cdf(b, s, p, q, mean, sd):
    """P(|y|² ≤ 1) from the χ²_l(δ) that has the form's mean, variance and skewness and nearly its kurtosis.

    Liu, Tang & Zhang (2009). b ≥ s are the variances along the axes, p and q the squared means there; mean and sd
    those of |y|² − 1.
    """
    c2 = b * b + s * s + 2.0 * (b * p + s * q)
    c3 = b**3 + s**3 + 3.0 * (b * b * p + s * s * q)
    c4 = b**4 + s**4 + 4.0 * (b**3 * p + s**3 * q)
    skew, tail = c3 / c2**1.5, c4 / (c2 * c2)
    if skew * skew > tail:
        a = 1.0 / (skew - math.sqrt(skew * skew - tail))
        delta = max(skew * a**3 - a * a, 0.0)
        freedom = a * a - 2.0 * delta
    else:
        a, delta = 1.0 / skew, 0.0
        freedom = a * a
    z = -mean / sd
    x = z * math.sqrt(2.0) * a + freedom + delta
    if not freedom + delta + abs(x) < _LARGEST:
        return 0.5 * math.erfc(-z * math.sqrt(0.5))
    return chi_square_cdf(x, freedom, delta) if x > 0.0 else 0.0


@nb.njit(cache=True, error_model="numpy")
def chi_square_cdf(x, freedom, delta):
    """P(χ²_l(δ) ≤ x), x > 0, as Σ_i y^(l/2+i) e^(−y) / Γ(l/2+i+1) · Σ_(j≤i) e^(−δ/2) (δ/2)^j / j!, y = x/2."""
    y, shape, half = 0.5 * x, 0.5 * freedom, 0.5 * delta
    gamma = _SCALE  # small, so that the sum, of at most e^(y + δ/2), does not overflow
    poisson = cumulated = 1.0
    total = before = gamma
    for i in range(1, 20 * int(_LARGEST)):
        gamma *= y / (shape + i)
        poisson *= half / i
        cumulated += poisson
        term = gamma * cumulated
        total += term
        if term <= 1e-15 * total and term <= 0.5 * before:
            break
        before = term
    exponent = shape * math.log(y) - y - half - math.lgamma(shape + 1.0) - math.log(_SCALE)
    return min(total * math.exp(exponent), 1.0)
