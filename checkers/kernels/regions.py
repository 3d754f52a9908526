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
# what `features` knows of a set: unit vectors and radii of the tangent points, clockwise end first (no radius if every
# ray meets the set); unit vector and radius of the nearest point; angles of the far ends or NaN; how rounding moves it
LOW_X, LOW_Y, LOW_RADIUS, HIGH_X, HIGH_Y, HIGH_RADIUS, NEAR_X, NEAR_Y, DISTANCE, TIP, OTHER_TIP, SHAKE = range(12)
FEATURES = 12
FULL_CIRCLE = 2.0 * math.pi
INSIDE, ENDLESS = -1, -2  # ends of a span that no set has: at radius 0, at no radius


@nb.njit(cache=True, error_model="numpy")
def ellipse_chord(rows, j, ux, uy):
    """(enter, leave) of the ray r (ux, uy), r ≥ 0; (inf, −1) if it misses.

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
    near = near if near > 0.0 else 0.0
    missed = ((c > 0.0) & (d <= 0.0)) | (leave <= near)
    return (np.inf if missed else near), (-1.0 if missed else leave)


@nb.njit(cache=True, error_model="numpy")
def _strip_chord(rows, i, j, ux, uy):
    """Radii, not ordered by sign, at which a line through the origin enters and leaves strip i of octagon j."""
    q = rows[i + 1, j] * ux + rows[i + 2, j] * uy
    inverse = 1.0 / (q if abs(q) > 1e-300 else 1e-300)
    middle, half = -rows[i, j] * inverse, abs(inverse)
    return middle - half, middle + half


@nb.njit(cache=True, error_model="numpy")
def octagon_chord(rows, j, ux, uy):
    """(enter, leave) of the ray r (ux, uy), r ≥ 0; (inf, −1) if it misses."""
    enter, leave = _strip_chord(rows, 0, j, ux, uy)
    enter = enter if enter > 0.0 else 0.0
    for i in (3, 6, 9):
        low, high = _strip_chord(rows, i, j, ux, uy)
        enter = low if low > enter else enter
        leave = high if high < leave else leave
    missed = leave <= enter
    return (np.inf if missed else enter), (-1.0 if missed else leave)


@nb.njit(cache=True, error_model="numpy")
def edge_at(rows, j, ux, uy, radius, leaving):
    """Edge of octagon j at which the ray enters or leaves it: 2 i + 1 where strip i is +1, 2 i where it is −1.

    The one whose own radius differs least from `radius`; compared as products, since divisions are dear.
    """
    edge, off, per = 0, np.inf, 1.0
    for i in range(4):
        slope = rows[3 * i + 1, j] * ux + rows[3 * i + 2, j] * uy
        positive = (slope > 0.0) == leaving
        away = abs(rows[3 * i, j] + slope * radius - (1.0 if positive else -1.0))
        if away * per < off * abs(slope):
            edge, off, per = 2 * i + positive, away, abs(slope)
    return edge


@nb.njit(cache=True, error_model="numpy")
def chord(kind, rows, j, ux, uy):
    """(enter, leave) for either kind."""
    if kind == OCTAGON:
        return octagon_chord(rows, j, ux, uy)
    return ellipse_chord(rows, j, ux, uy)


@nb.njit(cache=True, error_model="numpy")
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


@nb.njit(cache=True, error_model="numpy")
def fill_ellipse(row, piece, d1, d2, b11, b12, b21, b22):
    """Row of one ellipsoid piece (see `whiten.pack_pieces`) for the mean (d1, d2) and factor B in the ego frame."""
    a, b, c = piece[2], piece[3], piece[4]
    r1, r2 = d1 - piece[0], d2 - piece[1]
    m1, m2 = a * r1 + b * r2, c * r2
    row[0], row[1] = m1, m2
    row[2], row[3] = a * b11 + b * b21, a * b12 + b * b22
    row[4], row[5] = c * b21, c * b22
    row[6] = m1 * m1 + m2 * m2 - 1.0


@nb.njit(cache=True, error_model="numpy")
def fill_octagon(row, sizes, c, s, d1, d2, b11, b12, b21, b22):
    """Row of box ⊕ box: sizes = half length and width of ego and agent, (c, s) the agent's course in the ego frame.

    Two rectangles meet exactly if their projections overlap along the four edge normals (separating axes).
    """
    ac, as_ = abs(c), abs(s)
    ego_l, ego_w, length, width = sizes[0], sizes[1], sizes[2], sizes[3]
    _strip(row, 0, 1.0, 0.0, ego_l + length * ac + width * as_, d1, d2, b11, b12, b21, b22)
    _strip(row, 3, 0.0, 1.0, ego_w + length * as_ + width * ac, d1, d2, b11, b12, b21, b22)
    _strip(row, 6, c, s, length + ego_l * ac + ego_w * as_, d1, d2, b11, b12, b21, b22)
    _strip(row, 9, -s, c, width + ego_l * as_ + ego_w * ac, d1, d2, b11, b12, b21, b22)


@nb.njit(cache=True, error_model="numpy")
def _strip(row, i, n1, n2, reach, d1, d2, b11, b12, b21, b22):
    per = 1.0 / reach
    row[i] = (n1 * d1 + n2 * d2) * per
    row[i + 1] = (n1 * b11 + n2 * b21) * per
    row[i + 2] = (n1 * b12 + n2 * b22) * per


@nb.njit(cache=True, error_model="numpy")
def level(kind, rows, j, x, y):
    """(how far out a point is in set j, what rounding makes of that): below 1 inside, NaN if it is at infinity."""
    if kind == OCTAGON:
        worst, noise = 0.0, 0.0
        for i in (0, 3, 6, 9):
            along, across = rows[i + 1, j] * x, rows[i + 2, j] * y
            worst = max(abs(rows[i, j] + along + across), worst)  # NaN stays
            noise = max(noise, 1e-12 * (1.0 + abs(rows[i, j])) + 1e-14 * (abs(along) + abs(across)))
        return worst, noise
    a, b, c, d = rows[2, j] * x, rows[3, j] * y, rows[4, j] * x, rows[5, j] * y
    noise = 1e-12 * (1.0 + abs(rows[0, j]) + abs(rows[1, j])) + 1e-14 * (abs(a) + abs(b) + abs(c) + abs(d))
    return math.hypot(rows[0, j] + a + b, rows[1, j] + c + d), noise


@nb.njit(cache=True, error_model="numpy")
def _cone(out, a11, a12, a21, a22, low1, low2, high1, high2):
    """Cone of the rays that meet a set, from the vectors mean → tangent point, counter-clockwise, in the map's image.

    The preimage of w under A is along adj(A) w, which also holds in the limit of a singular A.
    """
    det = a11 * a22 - a12 * a21
    x1, y1 = a22 * low1 - a12 * low2, a11 * low2 - a21 * low1
    x2, y2 = a22 * high1 - a12 * high2, a11 * high2 - a21 * high1
    if det < 0.0:
        x1, y1, x2, y2 = -x2, -y2, -x1, -y1
    size1, size2, det = math.sqrt(x1 * x1 + y1 * y1), math.sqrt(x2 * x2 + y2 * y2), abs(det)
    _aim(out, LOW_X, x1, y1, size1, size1 / det if det > 0.0 else np.inf)
    _aim(out, HIGH_X, x2, y2, size2, size2 / det if det > 0.0 else np.inf)


@nb.njit(cache=True, error_model="numpy")
def _aim(out, at, x, y, size, radius):
    """Write the unit vector along (x, y), of the given size, and a radius."""
    per = 1.0 / size if size > 0.0 else 0.0
    out[at], out[at + 1], out[at + 2] = x * per, y * per, radius


@nb.njit(cache=True, error_model="numpy")
def _tip(a11, a12, a21, a22, m1, m2):
    """Directions of the far ends of a long thin set, or NaN: centre −A⁻¹m plus and minus the long half-axis.

    Rays are spaced densely enough to find everything that is less than 12 times as long as wide.
    """
    s11, s12, s22 = a11 * a11 + a21 * a21, a11 * a12 + a21 * a22, a12 * a12 + a22 * a22
    half = 0.5 * (s11 - s22)
    big = 0.5 * (s11 + s22) + math.hypot(half, s12)
    det = a11 * a22 - a12 * a21
    if 12.0 * abs(det) >= big or big == 0.0:
        return np.nan, np.nan
    angle = 0.5 * math.atan2(s12, half) + 0.5 * math.pi  # of the small eigenvector
    size = math.sqrt(big)
    sign = 1.0 if det >= 0.0 else -1.0
    x = -sign * (a22 * m1 - a12 * m2) / size
    y = -sign * (a11 * m2 - a21 * m1) / size
    along, across = math.cos(angle), math.sin(angle)
    return math.atan2(y + across, x + along), math.atan2(y - across, x - along)


@nb.njit(cache=True, error_model="numpy")
def ellipse_features(row, out):
    """Fill `out` (FEATURES,) for an ellipse."""
    m1, m2, c = row[0], row[1], row[6]
    a11, a12, a21, a22 = row[2], row[3], row[4], row[5]
    out[TIP], out[OTHER_TIP] = _tip(a11, a12, a21, a22, m1, m2)
    if c <= 0.0:
        _around(out)
        return
    # tangent points of the unit disc from m: −m √c ∓ m⊥ over |m|², times √c
    root, size = math.sqrt(c), math.sqrt(c) / (c + 1.0)
    low1, low2 = size * (-m1 * root - m2), size * (-m2 * root + m1)
    high1, high2 = size * (-m1 * root + m2), size * (-m2 * root - m1)
    _cone(out, a11, a12, a21, a22, low1, low2, high1, high2)
    s11, s12, s22 = a11 * a11 + a12 * a12, a11 * a21 + a12 * a22, a21 * a21 + a22 * a22
    # nearest point: ξ = −ν Aᵀ y, y = (1 + ν S)⁻¹ m on the rim; Newton is monotone as in gaussian.nearest
    nu, y1, y2, f = 0.0, m1, m2, c + 1.0
    det2 = (a11 * a22 - a12 * a21) ** 2
    for _ in range(40):
        t11, t12, t22 = 1.0 + nu * s11, nu * s12, 1.0 + nu * s22
        per = 1.0 / (1.0 + nu * (s11 + s22) + nu * nu * det2)  # t11 t22 − t12² would cancel if A is nearly singular
        y1, y2 = (t22 * m1 - t12 * m2) * per, (t11 * m2 - t12 * m1) * per
        f = y1 * y1 + y2 * y2
        z1, z2 = s11 * y1 + s12 * y2, s12 * y1 + s22 * y2
        slope = (y1 * (t22 * z1 - t12 * z2) + y2 * (t11 * z2 - t12 * z1)) * per
        step = f * (math.sqrt(f) - 1.0) / slope
        if not step > 0.0 or nu > 1e100:
            break
        nu += step
        if step <= 1e-6 * nu:
            break
    g1, g2 = a11 * y1 + a21 * y2, a12 * y1 + a22 * y2
    slope = math.sqrt(g1 * g1 + g2 * g2)
    cross = out[LOW_X] * out[HIGH_Y] - out[LOW_Y] * out[HIGH_X]
    met = cross != 0.0 or out[LOW_X] * out[HIGH_X] + out[LOW_Y] * out[HIGH_Y] < 0.0
    # a line that misses never gets to the rim, also where rounding leaves a cone
    distance = nu * slope if met and nu <= 1e100 and f <= 1.001 else np.inf
    _aim(out, NEAR_X, -g1, -g2, slope, distance)
    out[SHAKE] = distance * (math.sqrt(c + 1.0) + distance * math.sqrt(s11 + s22) + 1.0) / slope


@nb.njit(cache=True, error_model="numpy")
def _around(out):
    """The origin is inside: every ray meets the set at once."""
    out[LOW_RADIUS], out[HIGH_RADIUS] = np.nan, np.nan
    out[DISTANCE], out[SHAKE] = 0.0, 0.0


@nb.njit(cache=True, error_model="numpy")
def octagon_features(rows, j, sizes, c, s, d1, d2, b11, b12, b21, b22, out):
    """Fill `out` (FEATURES,) for an octagon, with the arguments of `fill_octagon`."""
    out[TIP], out[OTHER_TIP] = _tip(rows[1, j], rows[2, j], rows[4, j], rows[5, j], rows[0, j], rows[3, j])
    if max(abs(rows[0, j]), abs(rows[3, j]), abs(rows[6, j]), abs(rows[9, j])) <= 1.0:
        _around(out)
        return
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


@nb.njit(cache=True, error_model="numpy")
def _nearest_of_octagon(rows, j, out):
    """The foot of an edge that faces the origin if it is on the octagon, else the nearest corner of such an edge."""
    best = np.inf
    _aim(out, NEAR_X, 0.0, 0.0, 0.0, np.inf)
    out[SHAKE] = 0.0
    for k in range(28):  # four feet; of each facing strip's edge the corners with both edges of the six others
        i = 3 * k if k < 4 else 3 * ((k - 4) // 6)
        p, q1, q2 = rows[i, j], rows[i + 1, j], rows[i + 2, j]
        if abs(p) <= 1.0:
            continue
        u = (1.0 if p > 0.0 else -1.0) - p
        if k < 4:
            per = u / (q1 * q1 + q2 * q2)
            x, y = q1 * per, q2 * per
        else:  # the other edge need not face the origin: factors shear, and corners may be sharp
            o = (i + 3 + 3 * ((k - 4) % 6 // 2)) % 12
            r, s1, s2 = rows[o, j], rows[o + 1, j], rows[o + 2, j]
            v = (1.0 if k & 1 else -1.0) - r
            per = 1.0 / (q1 * s2 - q2 * s1)
            x, y = (u * s2 - v * q2) * per, (v * q1 - u * s1) * per
        if x * x + y * y < best and _on(rows, j, x, y):
            best = x * x + y * y
            distance, slope = math.sqrt(best), math.sqrt(q1 * q1 + q2 * q2)
            _aim(out, NEAR_X, x, y, distance, distance)
            out[SHAKE] = distance * (abs(p) + distance * slope + 1.0) / slope
            if k < 4:
                return


@nb.njit(cache=True, error_model="numpy")
def _on(rows, j, x, y):
    """Whether a point is on octagon j, up to rounding."""
    for i in (0, 3, 6, 9):
        if not abs(rows[i, j] + rows[i + 1, j] * x + rows[i + 2, j] * y) <= 1.0 + 1e-9 * (1.0 + abs(rows[i, j])):
            return False
    return True
