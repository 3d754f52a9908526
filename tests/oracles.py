"""Second opinions: the same quantities by other mathematics, without the package's kernels.

- `cone` and `strip`: the Gaussian mass of an ellipse by two different integrals in mpmath (polar about the
  mean, Cartesian in the principal axes). Pieces grow geometrically from the peak, with a fixed rule on each:
  adaptive `mpmath.quad` stops early on narrow peaks.
- `cone_bulk`: the polar integral in 80-bit arithmetic, for hundreds of cases.
- `sampled`: the share of plain samples.
- `gaussian_form_moments`, `point_form_moments`, `tail_bound`: moments of g = |y|² − 1 by direct expansion and
  the sharp tail bound by orthogonal polynomials, all in mpmath.
- `trajectory`: risk of a trajectory by enumerating modes and hit/miss histories.
"""

from __future__ import annotations

import itertools
import math
from functools import cache

import mpmath as mp
import numpy as np

LONG = np.longdouble
DIGITS = 32


# ----------------------------------------------------------------------------------------------------
# the ellipse as a unit disc, in mpmath


def whiten(pose, mean, covariance, q):
    """(m, S) in mpmath such that the ellipse {x : (x − v)ᵀ R Q Rᵀ (x − v) ≤ 1} is |y| ≤ 1."""
    with mp.workdps(DIGITS):
        c, s = mp.cos(mp.mpf(float(pose[2]))), mp.sin(mp.mpf(float(pose[2])))
        turn = mp.matrix([[c, -s], [s, c]])
        lower = mp.cholesky(turn * _matrix(q) * turn.T)
        d = mp.matrix([mp.mpf(float(mean[i])) - mp.mpf(float(pose[i])) for i in range(2)])
        return lower.T * d, lower.T * _matrix(covariance) * lower


def _matrix(a):
    a = np.asarray(a, dtype=float)
    return mp.matrix([[mp.mpf(float(a[i, j])) for j in range(2)] for i in range(2)])


def as_mp(m, s):
    """Whitened doubles m (2,), s = (s11, s12, s22) as mpmath matrices, exactly."""
    m, s = [mp.mpf(float(v)) for v in m], [mp.mpf(float(v)) for v in s]
    return mp.matrix(m), mp.matrix([[s[0], s[1]], [s[1], s[2]]])


@cache
def _rule(n):
    with mp.workdps(DIGITS + 10):
        nodes = []
        for i in range(n):  # Newton from the classical guess
            x = mp.cos(mp.pi * (i + mp.mpf(3) / 4) / (n + mp.mpf(1) / 2))
            for _ in range(8):
                p0, p1 = mp.mpf(1), x
                for k in range(2, n + 1):
                    p0, p1 = p1, ((2 * k - 1) * x * p1 - (k - 1) * p0) / k
                slope = n * (x * p1 - p0) / (x * x - 1)
                x -= p1 / slope
            nodes.append((x, 2 / ((1 - x * x) * slope**2)))
        return nodes


def _piecewise(f, cuts, nodes, exponent=None):
    """Fixed rule on each piece; skipped where the quasi-convex `exponent` is far above its least."""
    rule, total = _rule(nodes), mp.mpf(0)
    levels = [exponent(cut) for cut in cuts] if exponent else [0] * len(cuts)
    limit = min(levels) + 80
    for k, (low, high) in enumerate(itertools.pairwise(cuts)):
        if min(levels[k], levels[k + 1]) > limit:
            continue
        half, middle = (high - low) / 2, (high + low) / 2
        total += half * sum(w * f(middle + half * x) for x, w in rule)
    return total


def _graded(points, low, high, ratio, depth):
    """Cuts of [low, high] that shrink geometrically towards each of the points."""
    cuts = {low, high}
    for p in points:
        if low <= p <= high:
            cuts.add(p)
        for k in range(depth):
            for cut in (p - (high - low) * ratio**k, p + (high - low) * ratio**k):
                if low < cut < high:
                    cuts.add(cut)
    return sorted(cuts)


def _principal(s):
    """Variances and unit vectors of a 2×2 mpmath matrix."""
    half, cross = (s[0, 0] - s[1, 1]) / 2, s[0, 1]
    radius = mp.sqrt(half**2 + cross**2)
    big = (s[0, 0] + s[1, 1]) / 2 + radius
    small = (s[0, 0] * s[1, 1] - cross**2) / big
    angle = mp.atan2(cross, half) / 2
    return small, big, angle


# ----------------------------------------------------------------------------------------------------
# two formulas for the same mass


def cone(m, s, nodes=14):
    """P(|y| ≤ 1), y ~ N(m, S): over the rays from the mean that meet the disc."""
    with mp.workdps(DIGITS):
        a11 = mp.sqrt(s[0, 0])
        a21 = s[0, 1] / a11
        a22 = mp.sqrt(s[1, 1] - a21**2)
        c = m[0] ** 2 + m[1] ** 2 - 1

        def ray(angle):
            x, y = mp.cos(angle), mp.sin(angle)
            x, y = a11 * x, a21 * x + a22 * y
            a, b = x * x + y * y, m[0] * x + m[1] * y
            return a, b, b * b - a * c

        def inside(angle):
            a, b, d = ray(angle)
            root = mp.sqrt(d)
            far = (root - b) / a if b < 0 else -c / (root + b)
            return -mp.expm1(-far * far / 2)

        quarter = mp.pi / 2
        axis = _principal(mp.matrix([[a11**2 + a21**2, a21 * a22], [a21 * a22, a22**2]]))[2]
        if c <= 0:
            # features: principal axes of S and rays along the tangent
            tangent = mp.atan2(m[0] * a11 + m[1] * a21, -m[1] * a22)
            points = [p + k * quarter for p in (axis, tangent) for k in range(-8, 9)]
            cuts = _graded(points, mp.mpf(0), 2 * mp.pi, mp.mpf("0.35"), 22)
            return _piecewise(inside, cuts, nodes) / (2 * mp.pi)

        # D(u) = uᵀ Lᵀ (m mᵀ − c I) L u ≥ 0 is a double cone; the half with B < 0 points at the disc
        b1, b2 = m[0] * a11 + m[1] * a21, m[1] * a22
        form = mp.matrix(
            [
                [b1 * b1 - c * (a11**2 + a21**2), b1 * b2 - c * a21 * a22],
                [b1 * b2 - c * a21 * a22, b2 * b2 - c * a22**2],
            ]
        )
        half, cross = (form[0, 0] - form[1, 1]) / 2, form[0, 1]
        radius = mp.sqrt(half**2 + cross**2)
        middle = mp.atan2(cross, half) / 2
        trace = (form[0, 0] + form[1, 1]) / 2
        up, down = trace + radius, radius - trace
        if ray(middle)[1] > 0:
            middle += mp.pi
        width = mp.atan2(mp.sqrt(up), mp.sqrt(down))

        def near(u):
            a, b, d = ray(middle + width * mp.sin(u))
            root = mp.sqrt(max(d, mp.mpf(0)))
            return c / (root - b), (root - b) / a

        def density(u):
            low, high = near(u)
            return mp.exp(-low * low / 2) * -mp.expm1(-(high - low) * (high + low) / 2) * width * mp.cos(u)

        peak = _least(lambda u: near(u)[0], -quarter, quarter)
        shares = [(axis + k * quarter - middle) / width for k in range(-8, 9)]
        axes = [mp.asin(share) for share in shares if abs(share) < 1]
        cuts = _graded([peak, *axes, -quarter, quarter], -quarter, quarter, mp.mpf("0.5"), 40)
        return _piecewise(density, cuts, nodes, lambda u: near(u)[0] ** 2 / 2) / (2 * mp.pi)


def strip(m, s, nodes=16):
    """The same in the principal axes: ∫ φ((sin t − m₁)/s₁)/s₁ [Φ-difference over ±cos t in y₂] cos t dt."""
    with mp.workdps(DIGITS):
        small, big, angle = _principal(s)
        c, si = mp.cos(angle), mp.sin(angle)
        mx, my = abs(-si * m[0] + c * m[1]), abs(c * m[0] + si * m[1])
        sx, sy = mp.sqrt(small), mp.sqrt(big)
        root2 = mp.sqrt(2)

        def slice_(t):
            z, half = (mp.sin(t) - mx) / sx, mp.cos(t)
            low, high = (my - half) / sy / root2, (my + half) / sy / root2
            inner = (mp.erfc(low) - mp.erfc(high)) / 2 if low > 0 else (mp.erf(high) - mp.erf(low)) / 2
            return mp.exp(-z * z / 2) * inner * half

        def exponent(t):
            return (((mp.sin(t) - mx) / sx) ** 2 + max(mp.mpf(0), (my - mp.cos(t)) / sy) ** 2) / 2

        quarter = mp.pi / 2
        peak = _least(exponent, -quarter, quarter)
        edge = [mp.acos(my)] if my < 1 else []
        points = [peak, *edge, *[-e for e in edge], *([mp.asin(mx)] if mx < 1 else []), -quarter, quarter]
        # erfc(low) − erfc(high) of nearly equal tails: work with digits to spare
        with mp.workdps(DIGITS + 20):
            cuts = _graded(points, -quarter, quarter, mp.mpf("0.5"), 40)
            total = _piecewise(slice_, cuts, nodes, exponent)
        return total / (sx * mp.sqrt(2 * mp.pi))


def _least(f, low, high):
    """Minimum of a quasi-convex function by golden section; a coarse peak is enough to place the pieces."""
    ratio = (mp.sqrt(5) - 1) / 2
    a, b = high - ratio * (high - low), low + ratio * (high - low)
    fa, fb = f(a), f(b)
    for _ in range(55):
        if fa <= fb:
            high, b, fb = b, a, fa
            a = high - ratio * (high - low)
            fa = f(a)
        else:
            low, a, fa = a, b, fb
            b = low + ratio * (high - low)
            fb = f(b)
    return (low + high) / 2


# ----------------------------------------------------------------------------------------------------
# bulk: the polar integral in 80-bit arithmetic


def cone_bulk(m, s):
    """P(|y| ≤ 1) for m (N, 2) and s (N, 3) = s11, s12, s22, to about 1e-13 for σ ratios below 100."""
    return np.array([float(_cone_long(*[LONG(v) for v in (*a, *b)])) for a, b in zip(m, s, strict=True)])


def truth(poses, means, covariances, q):
    """The same for poses (N, 3), means (N, 2), covariances (N, 2, 2) and an ellipse q in the ego frame."""
    out = []
    for pose, mean, covariance in zip(poses, means, covariances, strict=True):
        m, s = whiten(pose, mean, covariance, q)
        values = (m[0], m[1], s[0, 0], s[0, 1], s[1, 1])
        out.append(float(_cone_long(*[LONG(mp.nstr(v, 25)) for v in values])))
    return np.array(out)


_X20, _W20 = (a.astype(LONG) for a in np.polynomial.legendre.leggauss(20))


def _cone_long(m1, m2, s11, s12, s22):
    a11 = np.sqrt(s11)
    a21 = s12 / a11
    a22 = np.sqrt((s11 * s22 - s12 * s12) / s11)
    c = m1 * m1 + m2 * m2 - 1
    pi = LONG(mp.nstr(mp.pi, 25))

    def ray(angle):
        x, y = np.cos(angle), np.sin(angle)
        x, y = a11 * x, a21 * x + a22 * y
        a, b = x * x + y * y, m1 * x + m2 * y
        d = a - (m1 * y - m2 * x) ** 2  # = b² − a c, without its cancellation
        return a, b, np.maximum(d, b * b if c <= 0 else 0)

    axis = 0.5 * np.arctan2(2 * a21 * a22, a11**2 + a21**2 - a22**2)
    if c <= 0:
        tangent = np.arctan2(m1 * a11 + m2 * a21, -m2 * a22)
        points = [p + k * pi / 2 for p in (axis, tangent) for k in range(-8, 9)]
        angle, weight = _long_nodes(points, LONG(0), 2 * pi, LONG(0.35), 22)
        a, b, d = ray(angle)
        root = np.sqrt(d)
        far = np.where(b < 0, (root - b) / a, -c / np.where(b < 0, 1, root + b))
        return (weight * -np.expm1(-far * far / 2)).sum() / (2 * pi)
    b1, b2 = m1 * a11 + m2 * a21, m2 * a22
    p, q, r = b1 * b1 - c * (a11**2 + a21**2), b1 * b2 - c * a21 * a22, b2 * b2 - c * a22**2
    radius = np.hypot((p - r) / 2, q)
    middle = np.arctan2(q, (p - r) / 2) / 2
    if ray(middle)[1] > 0:
        middle += pi
    trace, determinant = (p + r) / 2, c * (a11 * a22) ** 2  # of the form: −determinant
    up, down = (trace + radius, determinant / (trace + radius)) if trace > 0 else (0, radius - trace)
    width = np.arctan2(np.sqrt(up or determinant / down), np.sqrt(down))
    low, high = -pi / 2, pi / 2
    for _ in range(60):  # shrink around the nearest ray
        u = np.linspace(low, high, 9, dtype=LONG)
        _, b, d = ray(middle + width * np.sin(u))
        i = int(np.argmin(c / (np.sqrt(d) - b)))
        low, high = u[max(i - 1, 0)], u[min(i + 1, 8)]
    shares = [(axis + k * pi / 2 - middle) / width for k in range(-8, 9)]
    axes = [np.arcsin(share) for share in shares if abs(share) < 1]
    u, weight = _long_nodes([(low + high) / 2, *axes, -pi / 2, pi / 2], -pi / 2, pi / 2, LONG(0.4), 32)
    a, b, d = ray(middle + width * np.sin(u))
    root = np.sqrt(d)
    near, far = c / (root - b), (root - b) / a
    f = np.exp(-near * near / 2) * -np.expm1(-(far - near) * (far + near) / 2)
    return (weight * f * np.cos(u)).sum() * width / (2 * pi)


def _long_nodes(points, low, high, ratio, depth):
    cuts = np.array(_graded(points, low, high, ratio, depth), dtype=LONG)
    half, middle = np.diff(cuts) / 2, (cuts[1:] + cuts[:-1]) / 2
    return (middle[:, None] + half[:, None] * _X20).ravel(), (half[:, None] * _W20).ravel()


def sampled(m, covariance, n, seed):
    """Share of n plain samples of N(m, S) in the unit disc."""
    y = np.random.default_rng(seed).multivariate_normal(m, covariance, n, method="svd")
    return float(((y**2).sum(axis=1) <= 1.0).mean())


# ----------------------------------------------------------------------------------------------------
# moments of g = |y|² − 1 and the sharp bound they allow


def gaussian_form_moments(m, s, order):
    """E[g^k], k = 0…order, for y ~ N(m, S), by expanding products of one-dimensional moments."""
    with mp.workdps(60):
        small, big, angle = _principal(s)
        c, si = mp.cos(angle), mp.sin(angle)
        x = _normal_moments(c * m[0] + si * m[1], big, 2 * order)
        y = _normal_moments(-si * m[0] + c * m[1], small, 2 * order)
        return [_expand(k, lambda i, j: x[i] * y[j]) for k in range(order + 1)]


def point_form_moments(points, weights, order):
    """E[g^k] of a discrete distribution of y."""
    with mp.workdps(60):
        points = [(mp.mpf(float(a)), mp.mpf(float(b))) for a, b in points]
        weights = [mp.mpf(float(w)) for w in weights]
        g = [x * x + y * y - 1 for x, y in points]
        return [sum(w * v**k for v, w in zip(g, weights, strict=True)) for k in range(order + 1)]


def _normal_moments(mean, variance, order):
    out = []
    for n in range(order + 1):
        terms = [
            mp.binomial(n, 2 * j) * mean ** (n - 2 * j) * variance**j * mp.fac2(2 * j - 1) for j in range(n // 2 + 1)
        ]
        out.append(mp.fsum(terms))
    return out


def _expand(k, moment):
    terms = []
    for a in range(k + 1):
        for b in range(k + 1 - a):
            count = math.factorial(k) // (math.factorial(a) * math.factorial(b) * math.factorial(k - a - b))
            terms.append((-1) ** (k - a - b) * count * moment(2 * a, 2 * b))
    return mp.fsum(terms)


def tail_bound(raw, x0=0):
    """Largest P(X ≤ x₀) under raw moments 0…2n: quasi-orthogonal polynomial, Vandermonde weights."""
    with mp.workdps(60):
        n = (len(raw) - 1) // 2
        x0 = mp.mpf(x0)
        # q of degree n + 1 with q(x₀) = 0, orthogonal to 1, x, …, x^(n−1) against (x − x₀) dμ
        shifted = [
            mp.fsum(mp.binomial(k, j) * raw[j] * (-x0) ** (k - j) for j in range(k + 1)) for k in range(len(raw))
        ]
        # r(x) = x^n + Σ a_j x^j, E[x · r(x) · x^i] = 0 for i < n: nodes other than x₀
        system = mp.matrix(n, n)
        right = mp.matrix(n, 1)
        for i in range(n):
            for j in range(n):
                system[i, j] = shifted[i + j + 1]
            right[i] = -shifted[i + n + 1] if i + n + 1 < len(shifted) else mp.mpf(0)
        a = mp.lu_solve(system, right)
        companion = mp.matrix(n, n)  # of r: `mp.polyroots` takes coefficients in an order that depends on the release
        for i in range(n):
            companion[i, n - 1] = -a[i]
            if i:
                companion[i, i - 1] = 1
        with mp.workdps(180):
            roots = mp.eig(companion, left=False, right=False) if n > 1 else [-a[0]]
        nodes = [mp.mpf(0), *[mp.re(r) for r in roots]]
        vander = mp.matrix(n + 1, n + 1)
        for i in range(n + 1):
            for j in range(n + 1):
                vander[i, j] = nodes[j] ** i
        weights = mp.lu_solve(vander, mp.matrix(shifted[: n + 1]))
        return mp.fsum(w for w, node in zip(weights, nodes, strict=True) if node <= 0)


# ----------------------------------------------------------------------------------------------------
# trajectories


def trajectory(weights, risks, modes):
    """Risk of one agent: sum over mode sequences and hit/miss histories with at least one hit, in mpmath."""
    steps, count = np.shape(risks)
    with mp.workdps(60):
        r = [[mp.mpf(float(v)) for v in row] for row in risks]
        w = [[mp.mpf(float(v)) for v in row] for row in np.broadcast_to(weights, (steps, count))]
        total = mp.mpf(0)
        if modes == "persistent":
            sequences = [((z,) * steps, w[0][z]) for z in range(count)]
        else:
            sequences = [
                (z, mp.fprod(w[t][z[t]] for t in range(steps))) for z in itertools.product(range(count), repeat=steps)
            ]
        for z, chance in sequences:
            for hits in itertools.product((False, True), repeat=steps):
                if any(hits):
                    total += chance * mp.fprod(r[t][z[t]] if hit else 1 - r[t][z[t]] for t, hit in enumerate(hits))
        return total
