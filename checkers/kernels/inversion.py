"""P(Σ λ_r χ²_1(δ_r²) ≤ 1) by inversion of the Laplace transform along a contour through the saddle point."""

import math

import numba as nb
import numpy as np

_MAX_NODES = 1 << 17


@nb.njit(cache=True, error_model="numpy")
def _log_transform(z, variances, offsets):
    """log E e^(−zQ) + z − log z for complex z: the exponent of the inversion integral."""
    total = z - np.log(z)
    for r in range(len(variances)):
        w = 1.0 + 2.0 * variances[r] * z
        total -= 0.5 * np.log(w) + offsets[r] ** 2 * z / w
    return total


@nb.njit(cache=True, error_model="numpy")
def _derivatives(z, variances, offsets):
    """First three derivatives of that exponent at real z > 0."""
    d1, d2, d3 = 1.0 - 1.0 / z, 1.0 / z**2, -2.0 / z**3
    for r in range(len(variances)):
        v, b2 = variances[r], offsets[r] ** 2
        w = 1.0 + 2.0 * v * z
        d1 -= v / w + b2 / w**2
        d2 += 2.0 * v * v / w**2 + 4.0 * v * b2 / w**3
        d3 -= 8.0 * v**3 / w**3 + 24.0 * v * v * b2 / w**4
    return d1, d2, d3


@nb.njit(cache=True, error_model="numpy")
def quadratic_form_cdf(variances, offsets):
    """(P(Σ_r (b_r + √v_r ξ_r)² ≤ 1), absolute error bound), any number of terms ≥ 1.

    Imhof (1961) inverts the characteristic function along the imaginary axis; shifted to the saddle point z₀ > 0 and
    bent into its parabola of steepest descent (Helstrom 1996) z = z₀ + iv − κv², κ = −ψ‴/(6ψ″), the integrand decays
    like a Gaussian and the result keeps its relative accuracy in the lower tail. The trapezoid rule is halved until
    two sums agree; the error returned adds that difference, a bound on what lies beyond the last node and rounding.
    """
    z0 = _saddle(variances, offsets)
    _, d2, d3 = _derivatives(z0, variances, offsets)
    peak = _log_transform(complex(z0, 0.0), variances, offsets).real
    kappa = _bend(z0, -d3 / (6.0 * d2), peak, 1.0 / math.sqrt(d2), variances, offsets)
    step = 1.0 / math.sqrt(d2)
    total, absolute, reach, last = _line_sum(z0, kappa, peak, step, 0.0, variances, offsets)
    change = np.inf
    nodes = reach
    while nodes < _MAX_NODES:
        middle, more, reach, last = _line_sum(z0, kappa, peak, step, 0.5, variances, offsets)
        change = abs(middle - total) * step * 0.5
        total, absolute, step = total + middle, absolute + more, 0.5 * step
        nodes = 2 * reach
        if change <= 1e-13 * abs(total) * step:
            break
    scale = math.exp(peak) / math.pi
    value = total * step * scale
    beyond = last * step * reach * 2.0
    rounding = (4e-15 + 3e-16 * (abs(peak) + z0)) * absolute * step
    return min(max(value, 0.0), 1.0), (change + beyond + rounding) * scale + 5e-324


@nb.njit(cache=True, error_model="numpy")
def _bend(z0, steepest, peak, width, variances, offsets):
    """The strongest bend, of steepest descent or a fraction of it, along which the integrand falls throughout.

    For nearly Gaussian forms (small variances) a bent contour runs into the growing side of the saddle.
    """
    kappa = steepest
    for _ in range(20):
        v, before = 0.25 * width, peak
        while True:
            here = _log_transform(complex(z0 - kappa * v * v, v), variances, offsets).real
            if not here < before:
                break
            if here < peak - 45.0:
                return kappa
            before = here
            v = 1.05 * v + 0.4 * width  # closely: a valley may lie before a rise
        kappa *= 0.3
    return 0.0


@nb.njit(cache=True, error_model="numpy")
def _saddle(variances, offsets):
    """Minimum of the convex exponent on (0, ∞): bracketed, then bisection in log z and Newton."""
    low, high = 1e-12, 1.0
    while _derivatives(high, variances, offsets)[0] < 0.0:
        low, high = high, high * 4.0
        if high > 1e300:
            return high
    while _derivatives(low, variances, offsets)[0] > 0.0:
        low *= 0.25
    z = math.sqrt(low * high)
    for _ in range(200):
        d1, d2, _ = _derivatives(z, variances, offsets)
        if d1 > 0.0:
            high = z
        else:
            low = z
        newton = z - d1 / d2
        z_next = newton if low < newton < high else math.sqrt(low * high)
        if abs(z_next - z) <= 1e-6 * z:
            return z_next
        z = z_next
    return z


@nb.njit(cache=True, error_model="numpy")
def _line_sum(z0, kappa, peak, step, shift, variances, offsets):
    """Sum of Re[e^(ψ − peak) dz/d(iv)] over v = (k + shift)·step ≥ 0, v = 0 at half weight; until negligible."""
    total, absolute, last = 0.0, 0.0, 0.0
    k = 0
    while k < _MAX_NODES:
        v = (k + shift) * step
        z = complex(z0 - kappa * v * v, v)
        weight = np.exp(_log_transform(z, variances, offsets) - peak)
        term = (weight * complex(1.0, 2.0 * kappa * v)).real
        last = abs(weight) * math.hypot(1.0, 2.0 * kappa * v)
        if k == 0 and shift == 0.0:
            term *= 0.5
        total += term
        absolute += abs(term)
        k += 1
        # the modulus falls throughout (see `_bend`), so the first negligible node ends the sum
        if last <= 1e-17 * absolute:
            break
    return total, absolute, k, last
