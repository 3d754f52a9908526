"""Collision sets in the plane of ξ, seen from its origin: which rays meet them, and from where to where.

A step's set is {ξ : μ + B ξ collides}, convex, and one row of 12 numbers:
    ellipse   m1, m2, a11, a12, a21, a22, |m|² − 1      {ξ : |m + A ξ| ≤ 1}
    octagon   p, q1, q2 of four strips                  {ξ : |p + q·ξ| ≤ 1 for all four}; two rectangles that touch
B need not be invertible: the sets are then strips, everything, or nothing. Rows lie in columns, rows[number, set], so
that one ray meets many sets by vector instructions; hence no branches in the chords.
"""

import math

import numba as nb
import numpy as np

ELLIPSE, OCTAGON = 0, 1
ROW = 12
# what `features` knows of a set: its cone of rays, radii of the tangent points, nearest point, far ends, sensitivity
LOW, WIDTH, LOW_RADIUS, HIGH_RADIUS, NEAR, DISTANCE, SHAKE, TIP = range(8)
FEATURES = 8
FULL_CIRCLE = 2.0 * math.pi


INSIDE, ENDLESS = -1, -2  # ends of a span that no set has: at radius 0, at no radius


@nb.njit(inline="always", error_model="numpy")
def ellipse_chord(rows, j, ux, uy):
    """(enter, leave) of the ray r (ux, uy), r ≥ 0; enter > leave if it misses.

    Roots of |m + r A u|² = 1 without cancellation; the discriminant is |Au|² − (m × Au)².
    """
    v1 = rows[2, j] * ux + rows[3, j] * uy
    v2 = rows[4, j] * ux + rows[5, j] * uy
    a = v1 * v1 + v2 * v2 + 1e-300
    b = rows[0, j] * v1 + rows[1, j] * v2
    c = rows[6, j]
    k = rows[0, j] * v2 - rows[1, j] * v1
    d = a - k * k
    far = math.sqrt(d if d > 0.0 else 0.0) + abs(b)
    near = c / far
    leave = -near if b > 0.0 else far / a
    missed = (c > 0.0) & (d <= 0.0)
    return (near if near > 0.0 else 0.0), (-1.0 if missed else leave)


@nb.njit(inline="always", error_model="numpy")
def _strip_chord(rows, i, j, ux, uy):
    """Radii, not ordered by sign, at which a line through the origin enters and leaves strip i of octagon j."""
    q = rows[i + 1, j] * ux + rows[i + 2, j] * uy
    inverse = 1.0 / (q if abs(q) > 1e-300 else 1e-300)
    middle, half = -rows[i, j] * inverse, abs(inverse)
    return middle - half, middle + half


@nb.njit(inline="always", error_model="numpy")
def octagon_chord(rows, j, ux, uy):
    """(enter, leave) of the ray r (ux, uy), r ≥ 0; enter > leave if it misses."""
    enter, leave = _strip_chord(rows, 0, j, ux, uy)
    enter = enter if enter > 0.0 else 0.0
    for i in (3, 6, 9):
        low, high = _strip_chord(rows, i, j, ux, uy)
        enter = low if low > enter else enter
        leave = high if high < leave else leave
    return enter, leave


@nb.njit(inline="always", error_model="numpy")
def edge_at(rows, j, ux, uy, radius, leaving):
    """Edge of octagon j at which the ray enters or leaves it: 2 i + 1 where strip i is +1, 2 i where it is −1."""
    edge, best = 0, np.inf
    for i in range(4):
        low, high = _strip_chord(rows, 3 * i, j, ux, uy)
        positive = rows[3 * i + 1, j] * ux + rows[3 * i + 2, j] * uy > 0.0
        off = abs((high if leaving else low) - radius)
        if off < best:
            best, edge = off, 2 * i + (positive if leaving else not positive)
    return edge


@nb.njit(inline="always", error_model="numpy")
def chord(kind, rows, j, ux, uy):
    """(enter, leave) for either kind."""
    if kind == OCTAGON:
        return octagon_chord(rows, j, ux, uy)
    return ellipse_chord(rows, j, ux, uy)


@nb.njit(inline="always", error_model="numpy")
def end_radius(kind, rows, end, leaving, ux, uy):
    """Radius at which the ray enters or leaves what `end` names: 8 × set (+ edge of an octagon); NaN if it misses."""
    if end < 0:
        return 0.0 if end == INSIDE else np.inf
    j = end >> 3
    if kind == OCTAGON:
        edge = end & 7
        level = 1.0 if edge & 1 else -1.0
        i = 3 * (edge >> 1)
        return (level - rows[i, j]) / (rows[i + 1, j] * ux + rows[i + 2, j] * uy)
    enter, leave = ellipse_chord(rows, j, ux, uy)
    if enter > leave:
        return np.nan
    return leave if leaving else enter


@nb.njit(inline="always", error_model="numpy")
def fill_ellipse(row, piece, d1, d2, b11, b12, b21, b22):
    """Row of one ellipsoid piece (see `whiten.pack_pieces`) for the mean (d1, d2) and factor B in the ego frame."""
    a, b, c = piece[2], piece[3], piece[4]
    r1, r2 = d1 - piece[0], d2 - piece[1]
    m1, m2 = a * r1 + b * r2, c * r2
    row[0], row[1] = m1, m2
    row[2], row[3] = a * b11 + b * b21, a * b12 + b * b22
    row[4], row[5] = c * b21, c * b22
    row[6] = m1 * m1 + m2 * m2 - 1.0


@nb.njit(inline="always", error_model="numpy")
def fill_octagon(row, sizes, turn, d1, d2, b11, b12, b21, b22):
    """Row of box ⊕ box: sizes = half length and width of ego and agent, `turn` the agent's heading in the ego frame.

    Two rectangles meet exactly if their projections overlap along the four edge normals (separating axes).
    """
    c, s = math.cos(turn), math.sin(turn)
    ac, as_ = abs(c), abs(s)
    ego_l, ego_w, length, width = sizes[0], sizes[1], sizes[2], sizes[3]
    _strip(row, 0, 1.0, 0.0, ego_l + length * ac + width * as_, d1, d2, b11, b12, b21, b22)
    _strip(row, 3, 0.0, 1.0, ego_w + length * as_ + width * ac, d1, d2, b11, b12, b21, b22)
    _strip(row, 6, c, s, length + ego_l * ac + ego_w * as_, d1, d2, b11, b12, b21, b22)
    _strip(row, 9, -s, c, width + ego_l * as_ + ego_w * ac, d1, d2, b11, b12, b21, b22)


@nb.njit(inline="always", error_model="numpy")
def _strip(row, i, n1, n2, reach, d1, d2, b11, b12, b21, b22):
    row[i] = (n1 * d1 + n2 * d2) / reach
    row[i + 1] = (n1 * b11 + n2 * b21) / reach
    row[i + 2] = (n1 * b12 + n2 * b22) / reach


@nb.njit(inline="always", error_model="numpy")
def _cone(out, a11, a12, a21, a22, low1, low2, high1, high2):
    """Cone of the rays that meet a set, from the vectors mean → tangent point, counter-clockwise, in the map's image.

    The preimage of w under A is along adj(A) w, which also holds in the limit of a singular A.
    """
    det = a11 * a22 - a12 * a21
    x1, y1 = a22 * low1 - a12 * low2, a11 * low2 - a21 * low1
    x2, y2 = a22 * high1 - a12 * high2, a11 * high2 - a21 * high1
    if det < 0.0:
        x1, y1, x2, y2 = -x2, -y2, -x1, -y1
    out[LOW] = math.atan2(y1, x1)
    out[WIDTH] = math.atan2(abs(x1 * y2 - y1 * x2), x1 * x2 + y1 * y2)
    out[LOW_RADIUS] = math.hypot(x1, y1) / abs(det) if det != 0.0 else np.inf
    out[HIGH_RADIUS] = math.hypot(x2, y2) / abs(det) if det != 0.0 else np.inf


@nb.njit(inline="always", error_model="numpy")
def _tip(a11, a12, a21, a22, m1, m2):
    """Direction of a far end of a long thin set, or NaN: centre −A⁻¹m plus the long half-axis (the other is opposite).

    Rays are spaced densely enough to find everything that is less than 12 times as long as wide.
    """
    s11, s12, s22 = a11 * a11 + a21 * a21, a11 * a12 + a21 * a22, a12 * a12 + a22 * a22
    half = 0.5 * (s11 - s22)
    big = 0.5 * (s11 + s22) + math.hypot(half, s12)
    det = a11 * a22 - a12 * a21
    if 12.0 * abs(det) >= big or big == 0.0:
        return np.nan
    angle = 0.5 * math.atan2(s12, half) + 0.5 * math.pi  # of the small eigenvector
    size = math.sqrt(big)
    sign = 1.0 if det >= 0.0 else -1.0
    x = -sign * (a22 * m1 - a12 * m2) / size
    y = -sign * (a11 * m2 - a21 * m1) / size
    return math.atan2(y + math.sin(angle), x + math.cos(angle))


@nb.njit(cache=True, error_model="numpy")
def ellipse_features(row, out):
    """Fill `out` (FEATURES,) for an ellipse."""
    m1, m2, c = row[0], row[1], row[6]
    a11, a12, a21, a22 = row[2], row[3], row[4], row[5]
    out[TIP] = _tip(a11, a12, a21, a22, m1, m2)
    if c <= 0.0:
        _around(out)
        return
    # tangent points of the unit disc from m: −m √c ∓ m⊥ over |m|², times √c
    root, size = math.sqrt(c), math.sqrt(c) / (c + 1.0)
    _cone(
        out,
        a11,
        a12,
        a21,
        a22,
        size * (-m1 * root - m2),
        size * (-m2 * root + m1),
        size * (-m1 * root + m2),
        size * (-m2 * root - m1),
    )
    s11, s12, s22 = a11 * a11 + a12 * a12, a11 * a21 + a12 * a22, a21 * a21 + a22 * a22
    # nearest point: ξ = −ν Aᵀ y, y = (1 + ν S)⁻¹ m on the rim; Newton is monotone as in gaussian.nearest
    nu, y1, y2 = 0.0, m1, m2
    for _ in range(40):
        t11, t12, t22 = 1.0 + nu * s11, nu * s12, 1.0 + nu * s22
        det = t11 * t22 - t12 * t12
        y1, y2 = (t22 * m1 - t12 * m2) / det, (t11 * m2 - t12 * m1) / det
        f = y1 * y1 + y2 * y2
        z1, z2 = s11 * y1 + s12 * y2, s12 * y1 + s22 * y2
        slope = y1 * (t22 * z1 - t12 * z2) / det + y2 * (t11 * z2 - t12 * z1) / det
        step = f * (math.sqrt(f) - 1.0) / slope
        if not step > 0.0 or nu > 1e100:
            break
        nu += step
        if step <= 1e-6 * nu:
            break
    g1, g2 = a11 * y1 + a21 * y2, a12 * y1 + a22 * y2
    slope = math.hypot(g1, g2)
    distance = nu * slope if out[WIDTH] > 0.0 and nu <= 1e100 else np.inf
    out[NEAR], out[DISTANCE] = math.atan2(-g2, -g1), distance
    out[SHAKE] = distance * (math.sqrt(c + 1.0) + distance * math.sqrt(s11 + s22) + 1.0) / slope


@nb.njit(inline="always", error_model="numpy")
def _around(out):
    """The origin is inside: every ray meets the set at once."""
    out[LOW], out[WIDTH], out[LOW_RADIUS], out[HIGH_RADIUS] = 0.0, FULL_CIRCLE, np.inf, np.inf
    out[NEAR], out[DISTANCE], out[SHAKE] = np.nan, 0.0, 0.0


@nb.njit(cache=True, error_model="numpy")
def octagon_features(rows, j, sizes, turn, d1, d2, b11, b12, b21, b22, out):
    """Fill `out` (FEATURES,) for an octagon, with the arguments of `fill_octagon`."""
    out[TIP] = _tip(rows[1, j], rows[2, j], rows[4, j], rows[5, j], rows[0, j], rows[3, j])
    if max(abs(rows[0, j]), abs(rows[3, j]), abs(rows[6, j]), abs(rows[9, j])) <= 1.0:
        _around(out)
        return
    c, s = math.cos(turn), math.sin(turn)
    low1, low2, high1, high2 = -d1, -d2, -d1, -d2
    for i in range(16):  # the corners of the sum are among the sums of corners
        x = sizes[0] * (1.0 if i & 1 else -1.0) - d1
        y = sizes[1] * (1.0 if i & 2 else -1.0) - d2
        along, across = sizes[2] * (1.0 if i & 4 else -1.0), sizes[3] * (1.0 if i & 8 else -1.0)
        x, y = x + c * along - s * across, y + s * along + c * across
        if low1 * y - low2 * x < 0.0:
            low1, low2 = x, y
        if high1 * y - high2 * x > 0.0:
            high1, high2 = x, y
    _cone(out, b11, b12, b21, b22, low1, low2, high1, high2)
    _nearest_of_octagon(rows, j, out)


@nb.njit(inline="always", error_model="numpy")
def _nearest_of_octagon(rows, j, out):
    """Bisect the cone by the side on which the foot of the entered edge lies, jumping to that foot where it can."""
    low1, low2 = math.cos(out[LOW]), math.sin(out[LOW])
    high1, high2 = math.cos(out[LOW] + out[WIDTH]), math.sin(out[LOW] + out[WIDTH])
    u1, u2 = math.cos(out[LOW] + 0.5 * out[WIDTH]), math.sin(out[LOW] + 0.5 * out[WIDTH])
    out[NEAR], out[DISTANCE], out[SHAKE] = out[LOW] + 0.5 * out[WIDTH], np.inf, 0.0
    for _ in range(12):
        enter, leave = octagon_chord(rows, j, u1, u2)
        if enter > leave:
            return
        edge = edge_at(rows, j, u1, u2, enter, False)
        strip = 3 * (edge >> 1)
        sign = 1.0 if rows[strip, j] < 0.0 else -1.0
        foot1, foot2 = sign * rows[strip + 1, j], sign * rows[strip + 2, j]
        slope = math.hypot(foot1, foot2)
        foot1, foot2 = foot1 / slope, foot2 / slope
        out[NEAR], out[DISTANCE] = math.atan2(u2, u1), enter
        out[SHAKE] = enter * (abs(rows[strip, j]) + enter * slope + 1.0) / slope
        side = u1 * foot2 - u2 * foot1
        if abs(side) < 1e-6:
            return
        if side > 0.0:
            low1, low2 = u1, u2
        else:
            high1, high2 = u1, u2
        if low1 * foot2 - low2 * foot1 > 0.0 and foot1 * high2 - foot2 * high1 > 0.0:
            u1, u2 = foot1, foot2
        else:
            u1, u2 = low1 + high1, low2 + high2
            size = math.hypot(u1, u2)
            u1, u2 = u1 / size, u2 / size
