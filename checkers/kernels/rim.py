"""P(z + N(0, I) ∈ K) for a fixed set K in the plane, as an integral along K's rim.

With g(q) = (1 − e^(−q/2)) / q, which is entire, and y = rim − z,
    P = (1/2π) ∮ g(|y|²) (y × dy) = [z ∈ K] + (1/2π) ∮ (g(|y|²) − 1/|y|²) (y × dy)
by Green's theorem. The second integrand is below e^(−|y|²/2), so only the rim near z is integrated; along that,
∮ (y × dy)/|y|² is the angle it is seen under. Far panels are summed as −e^(−|y|²/2)/|y|² (y × dy), which keeps the
relative accuracy of small P. Sets are octagons (rows of edges) or unions of ellipses (rows of pieces, and the arcs of
their rims that are not inside another).
"""

import math

import numba as nb
import numpy as np

# an edge: outward normal, its level n·y, and where it begins and ends along the tangent (−n₂, n₁)
EDGE = 5
# a piece: centre, A with {|A (y − centre)| ≤ 1}, its short half-axis 1/|A|, A⁻¹, and its long half-axis |A⁻¹|
PIECE = 12
_FAR = 2.5  # beyond, e^(−q/2)/q is as smooth as g
FINEST, FINE, ROUGH = 1.0, 2.0, 3.5  # longest panel: 8 nodes leave 1e-15, 4e-12 or 5e-8
_STEEP = 2.25  # e-foldings of e^(−q/2), times the longest panel, in one panel of a rim that is far
_BEYOND = 83.0  # squared distance, past the nearest, of what adds less than rounding
_BEND = 0.7  # rad of an ellipse in one panel
_DEPTH = 128  # of halvings
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)


@nb.njit(cache=True, error_model="numpy")
def rim_distance(octagon, row, z1, z2):
    """Signed distance from z to an edge's line, or a lower bound of that to a piece's rim: below 0 inside."""
    if octagon:
        return row[0] * z1 + row[1] * z2 - row[2]
    y1, y2 = z1 - row[0], z2 - row[1]
    u1, u2 = row[2] * y1 + row[3] * y2, row[4] * y1 + row[5] * y2
    return (math.sqrt(u1 * u1 + u2 * u2) - 1.0) * row[6]


@nb.njit(cache=True, error_model="numpy")
def clearance(octagon, rows, z1, z2):
    """Lower bound of the signed distance from z to the set: below 0 inside it."""
    worst, least = -np.inf, np.inf
    for i in range(len(rows)):
        distance = rim_distance(octagon, rows[i], z1, z2)
        worst, least = max(worst, distance), min(least, distance)
    return worst if octagon else least


@nb.njit(cache=True, error_model="numpy")
def normal(octagon, row, z1, z2, wide):
    """Unit normal (n1, n2) of the rim near z, and by how much (at most 1) it turns within `wide` of it."""
    if octagon:
        return row[0], row[1], 0.0
    y1, y2 = z1 - row[0], z2 - row[1]
    u1, u2 = row[2] * y1 + row[3] * y2, row[4] * y1 + row[5] * y2
    n1, n2 = row[2] * u1 + row[4] * u2, row[3] * u1 + row[5] * u2
    size = math.sqrt(n1 * n1 + n2 * n2)
    sharpest = row[6] * row[6] / row[11]  # radius of curvature at the ends of the long axis
    away = abs(rim_distance(octagon, row, z1, z2)) * row[11] / row[6]
    if size == 0.0 or wide + away >= sharpest:
        return 1.0, 0.0, 1.0
    return n1 / size, n2 / size, (wide + away) / sharpest


@nb.njit(cache=True, error_model="numpy")
def mass(octagon, rows, arcs, z1, z2, reach, panel):
    """P, where what is beyond `reach` of z counts as e^(−reach²/2) at most.

    Args:
        rows: (8, EDGE) or (N, PIECE); arcs: (M, 3) piece, from, to [rad], unread for octagons.
        panel: longest panel, FINEST, FINE or ROUGH.
    """
    away = clearance(octagon, rows, z1, z2)
    if away >= reach:
        return 0.0
    if away <= -reach:
        return 1.0
    square = _squared_distance(octagon, rows, z1, z2) if away > 0.0 else 0.0
    reach = min(reach, math.sqrt(square + _BEYOND))
    steep = _STEEP * panel if square > _FAR * _FAR else np.inf
    around = 0.0
    for i in range(len(rows) if octagon else len(arcs)):
        if octagon:
            around += _edge(rows[i], z1, z2, reach, panel, steep)
        else:
            around += _arc(rows, arcs[i], z1, z2, reach, panel, steep)
    return min(max((1.0 if away <= 0.0 else 0.0) + around / (2.0 * math.pi), 0.0), 1.0)


@nb.njit(cache=True, error_model="numpy")
def _squared_distance(octagon, rows, z1, z2):
    """Squared distance from z to a point of the rim, the nearest of an octagon's, towards the centre of a piece's."""
    least = np.inf
    for i in range(len(rows)):
        row = rows[i]
        if octagon:
            tangent = row[0] * z2 - row[1] * z1
            along = max(row[3] - tangent, tangent - row[4], 0.0)
            least = min(least, rim_distance(octagon, row, z1, z2) ** 2 + along * along)
        else:
            y1, y2 = z1 - row[0], z2 - row[1]
            norm = math.hypot(row[2] * y1 + row[3] * y2, row[4] * y1 + row[5] * y2)
            least = min(least, (1.0 - 1.0 / norm) ** 2 * (y1 * y1 + y2 * y2))
    return least


@nb.njit(cache=True, error_model="numpy")
def _density(q, far):
    """g(q), or its part −e^(−q/2)/q."""
    if far:
        return -math.exp(-0.5 * q) / q
    if q > 0.1:
        return (1.0 - math.exp(-0.5 * q)) / q
    term, total = 0.5, 0.5
    for k in range(2, 10):
        term *= -0.5 * q / k
        total += term
    return total


@nb.njit(cache=True, error_model="numpy")
def _edge(row, z1, z2, reach, panel, steep):
    """∫ (g − 1/q) (y × dy) along one edge."""
    h = -(row[0] * z1 + row[1] * z2 - row[2])  # above 0 inside, to the last bit as `clearance` says
    if abs(h) >= reach:
        return 0.0
    tangent = row[0] * z2 - row[1] * z1
    wide = math.sqrt(reach * reach - h * h)
    low, high = max(row[3] - tangent, -wide), min(row[4] - tangent, wide)
    if low >= high:
        return 0.0
    if low <= -wide and high >= wide:  # as good as a line
        outside = -math.pi * math.erfc(abs(h) / math.sqrt(2.0))
        return outside if h >= 0.0 else -outside
    count = math.ceil((high - low) * max(1.0 / panel, low / steep, -high / steep))
    half = 0.5 * (high - low) / count
    total, side = 0.0, h if h != 0.0 else 1e-300
    for p in range(count):
        middle = low + (2 * p + 1) * half
        far = max(abs(middle) - half, 0.0) ** 2 + h * h >= _FAR * _FAR
        part = 0.0
        for k in range(8):
            x = middle + half * _NODES[k]
            part += _WEIGHTS[k] * _density(h * h + x * x, far)
        total += part * h * half
        if not far:
            total -= math.atan((middle + half) / side) - math.atan((middle - half) / side)
    return total


@nb.njit(cache=True, error_model="numpy")
def _arc(rows, arc, z1, z2, reach, panel, steep):
    """The same along what is near of an arc of the rim of a piece."""
    row = rows[int(arc[0])]
    y1, y2 = z1 - row[0], z2 - row[1]
    u1, u2 = row[2] * y1 + row[3] * y2, row[4] * y1 + row[5] * y2
    norm = math.sqrt(u1 * u1 + u2 * u2)
    within = reach / row[6]
    if abs(norm - 1.0) >= within:
        return 0.0
    # in the plane of u the rim's point at angle θ is |e^(iθ) − u|, and at least that times the short half-axis away
    turn = (within * within - (norm - 1.0) ** 2) / (4.0 * norm + 1e-300)
    if turn >= 1.0:
        return _panels(row, y1, y2, arc[1], arc[2], norm <= 1.0, reach, panel, steep)
    nearest, half = math.atan2(u2, u1), 2.0 * math.asin(math.sqrt(turn))
    total = 0.0
    for lap in range(-1, 3):  # arcs lie in [0, 2π]
        low = max(arc[1], nearest - half + 2.0 * math.pi * lap)
        high = min(arc[2], nearest + half + 2.0 * math.pi * lap)
        if low < high:
            total += _panels(row, y1, y2, low, high, norm <= 1.0, reach, panel, steep)
    return total


@nb.njit(cache=True, error_model="numpy")
def _panels(row, y1, y2, low, high, inside, reach, panel, steep):
    """The same from one angle to another; y: from the piece's centre to z, which may be inside the piece.

    Halved until a part is out of reach or short, by its own speed: an ellipse may be 1e9 times as long as wide.
    """
    i11, i12, i21, i22 = row[7], row[8], row[9], row[10]
    sign = 1.0 if i11 * i22 - i12 * i21 > 0.0 else -1.0
    total, known, top = 0.0, -1.0, 1
    turns, stack = np.empty((8, 2)), np.empty((_DEPTH, 2))
    stack[0, 0], stack[0, 1] = low, high
    c0 = s0 = 0.0
    while top > 0:
        top -= 1
        middle, half = 0.5 * (stack[top, 0] + stack[top, 1]), 0.5 * (stack[top, 1] - stack[top, 0])
        c, s = math.cos(middle), math.sin(middle)
        x1, x2 = i11 * c + i12 * s - y1, i21 * c + i22 * s - y2
        d1, d2 = i12 * c - i11 * s, i22 * c - i21 * s
        along = half * (math.sqrt(d1 * d1 + d2 * d2) + row[11] * half)
        if x1 * x1 + x2 * x2 >= (reach + along) ** 2:
            continue
        rough = 2.0 * along > panel or 2.0 * half > _BEND
        if steep < np.inf:  # slope and curvature of q/2 along the rim
            bend = d1 * d1 + d2 * d2 + abs(x1 * (x1 + y1) + x2 * (x2 + y2))
            rough |= 2.0 * half * abs(x1 * d1 + x2 * d2) > steep or 2.0 * half * math.sqrt(bend) > panel
        if rough and top + 2 <= _DEPTH:
            stack[top + 1, 0], stack[top + 1, 1] = middle, stack[top, 1]
            stack[top, 1] = middle
            top += 2
            continue
        if abs(half - known) > 1e-12 * half:
            known, c0, s0 = half, math.cos(half), math.sin(half)
            for k in range(8):
                turns[k, 0], turns[k, 1] = math.cos(half * _NODES[k]), math.sin(half * _NODES[k])
        part, far = 0.0, x1 * x1 + x2 * x2 >= (_FAR + along) ** 2
        for k in range(8):
            ck, sk = c * turns[k, 0] - s * turns[k, 1], s * turns[k, 0] + c * turns[k, 1]
            x1, x2 = i11 * ck + i12 * sk - y1, i21 * ck + i22 * sk - y2
            d1, d2 = i12 * ck - i11 * sk, i22 * ck - i21 * sk
            part += _WEIGHTS[k] * _density(x1 * x1 + x2 * x2, far) * (x1 * d2 - x2 * d1)
        total += part * half * sign
        if not far:
            ca, sa, cb, sb = c * c0 + s * s0, s * c0 - c * s0, c * c0 - s * s0, s * c0 + c * s0
            a1, a2 = i11 * ca + i12 * sa - y1, i21 * ca + i22 * sa - y2
            b1, b2 = i11 * cb + i12 * sb - y1, i21 * cb + i22 * sb - y2
            cross = sign * (a1 * b2 - a2 * b1)
            angle = math.atan2(cross, a1 * b1 + a2 * b2)
            if inside and cross < 0.0:  # between the chord and the arc
                angle += 2.0 * math.pi
            total -= angle
    return total
