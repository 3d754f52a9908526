"""P(Σ λ_r χ²_1(δ_r²) ≤ 1) by inversion of the Laplace transform along a contour through the saddle point."""

import math

import numba as nb
import numpy as np

_MAX_NODES = 1 << 17


@nb.njit(inline="always", error_model="numpy")
def _root(re, im):
    """Square root with positive imaginary part of re + i·im, im ≥ 0."""
    big = math.sqrt(0.5 * (math.sqrt(re * re + im * im) + abs(re)))
    small = 0.5 * im / big if big > 0.0 else 0.0
    return (big, small) if re >= 0.0 else (small, big)


@nb.njit(inline="always", error_model="numpy")
def _transform(re, im, variances, offsets):
    """E e^(z(1 − Q)) / z at z = re + i·im, im ≥ 0, as (exponent, phase, modulus², denominator): see `_line_sum`."""
    exponent, phase = re, im
    d_re, d_im = re, im
    for r in range(len(variances)):
        w_re, w_im = 1.0 + 2.0 * variances[r] * re, 2.0 * variances[r] * im
        b2 = offsets[r] * offsets[r] / (w_re * w_re + w_im * w_im)
        # b² z / w = b² z w* / |w|²
        exponent -= b2 * (re * w_re + im * w_im)
        phase -= b2 * im  # im·w_re − re·w_im = im
        root_re, root_im = _root(w_re, w_im)
        d_re, d_im = d_re * root_re - d_im * root_im, d_re * root_im + d_im * root_re
    return exponent, phase, d_re, d_im


@nb.njit(inline="always", error_model="numpy")
def _log_modulus(re, im, variances, offsets):
    """log |E e^(z(1 − Q)) / z|."""
    exponent, _, d_re, d_im = _transform(re, im, variances, offsets)
    return exponent - 0.5 * math.log(d_re * d_re + d_im * d_im)


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
def quadratic_form_cdf(variances, offsets, guess):
    """(P(Σ_r (b_r + √v_r ξ_r)² ≤ 1), absolute error bound), any number of terms ≥ 1, from a guess of the saddle point.

    Imhof (1961) inverts the characteristic function along the imaginary axis; shifted to the saddle point z₀ > 0 and
    bent into its parabola of steepest descent (Helstrom 1996) z = z₀ + iv − κv², κ = −ψ‴/(6ψ″), the integrand decays
    like a Gaussian and the result keeps its relative accuracy in the lower tail. The trapezoid rule is halved until
    two sums agree; the error returned adds that difference, a bound on what lies beyond the last node and rounding.
    """
    z0 = _saddle(variances, offsets, guess)
    _, d2, d3 = _derivatives(z0, variances, offsets)
    peak = _log_modulus(z0, 0.0, variances, offsets)
    kappa = _bend(z0, -d3 / (6.0 * d2), peak, 1.0 / math.sqrt(d2), variances, offsets)
    step = 0.75 / math.sqrt(d2)  # two sums then agree where the integrand is nearly Gaussian
    total, absolute, reach, last = _line_sum(z0, kappa, peak, step, 0.0, variances, offsets)
    change = np.inf
    nodes = reach
    while nodes < _MAX_NODES:
        middle, more, reach, last = _line_sum(z0, kappa, peak, step, 0.5, variances, offsets)
        change = abs(middle - total) * step * 0.5
        total, absolute, step = total + middle, absolute + more, 0.5 * step
        nodes = 2 * reach
        if change <= 1e-12 * abs(total) * step:
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
            here = _log_modulus(z0 - kappa * v * v, v, variances, offsets)
            if not here < before:
                break
            if here < peak - 45.0:
                return kappa
            before = here
            v = 1.05 * v + 0.4 * width  # closely: a valley may lie before a rise
        kappa *= 0.3
    return 0.0


@nb.njit(cache=True, error_model="numpy")
def _saddle(variances, offsets, guess):
    """Minimum of the convex exponent on (0, ∞) to a relative 1e-4: Newton in log z, bracketed."""
    low, high, z = 0.0, np.inf, guess
    for _ in range(200):
        d1, d2, _ = _derivatives(z, variances, offsets)
        if d1 > 0.0:
            high = z
        else:
            low = z
        step = d1 / (d1 + z * d2)  # of log z
        newton = z * math.exp(-min(max(step, -3.0), 3.0)) if math.isfinite(step) else z
        if not low < newton < high:
            newton = 4.0 * z if high == np.inf else 0.25 * z if low == 0.0 else math.sqrt(low * high)
        if abs(newton - z) <= 1e-4 * z or newton > 1e300:
            return newton
        z = newton
    return z


@nb.njit(cache=True, error_model="numpy")
def _line_sum(z0, kappa, peak, step, shift, variances, offsets):
    """Sum of Re[e^(ψ − peak) dz/d(iv)] over v = (k + shift)·step ≥ 0, v = 0 at half weight; until negligible."""
    total, absolute, last = 0.0, 0.0, 0.0
    k = 0
    while k < _MAX_NODES:
        v = (k + shift) * step
        exponent, phase, d_re, d_im = _transform(z0 - kappa * v * v, v, variances, offsets)
        size = math.exp(exponent - peak) / (d_re * d_re + d_im * d_im)
        cos, sin, slope = math.cos(phase), math.sin(phase), 2.0 * kappa * v
        # real part of size · e^(i·phase) · conj(d) · (1 + i·slope)
        term = size * ((cos * d_re + sin * d_im) - slope * (sin * d_re - cos * d_im))
        last = size * math.sqrt((d_re * d_re + d_im * d_im) * (1.0 + slope * slope))
        if k == 0 and shift == 0.0:
            term *= 0.5
        total += term
        absolute += abs(term)
        k += 1
        # the modulus falls throughout (see `_bend`), so the first negligible node ends the sum
        if last <= 1e-17 * absolute:
            break
    return total, absolute, k, last
