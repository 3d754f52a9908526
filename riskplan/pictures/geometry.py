"""Plane geometry for pictures: outlines, strips, triangles, lane dividers. Arrays in and out, metres."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import shapely
from numpy.typing import NDArray

from checkers.validate import Array

Faces = NDArray[np.int64]

SPECK = 0.03  # standard deviation added to each [m]: a certain position is still a visible dot


def ellipses(means: Array, covariances: Array, sigmas: float, n: int = 28) -> Array:
    """Outlines (…, n, 2) at `sigmas` standard deviations of means (…, 2), covariances (…, 2, 2).

    A triangular factor maps the unit circle to the ellipse. Unlike eigenvectors it has no free sign or order,
    so neighbouring ellipses never flip.
    """
    angle = 2 * np.pi * np.arange(n) / n
    floor = SPECK**2
    a = np.sqrt(covariances[..., 0, 0] + floor)[..., None]
    b = covariances[..., 0, 1][..., None] / a
    c = np.sqrt(np.maximum(covariances[..., 1, 1][..., None] + floor - b**2, 0.0))
    x = a * np.cos(angle)
    y = b * np.cos(angle) + c * np.sin(angle)
    return means[..., None, :] + sigmas * np.stack([x, y], axis=-1)


def place(points: Array, pose: Array) -> Array:
    """Points (…, 2) of a body frame in the world, for a pose x, y, heading."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.asarray(points @ np.array([[c, s], [-s, c]]) + pose[:2])


def rectangle(length: float, width: float) -> Array:
    """(4, 2) corners of a centred body, counter-clockwise."""
    return np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * [length / 2, width / 2]


def disc(length: float, width: float, n: int = 24) -> Array:
    """(n, 2) outline of a centred ellipse with these diameters."""
    angle = 2 * np.pi * np.arange(n) / n
    return np.column_stack([np.cos(angle), np.sin(angle)]) * [length / 2, width / 2]


def fan(rings: Array) -> Faces:
    """Triangles of M convex rings (M, n, …) whose vertices are stacked ring after ring: (M (n - 2), 3)."""
    count, n = rings.shape[:2]
    corner = np.arange(1, n - 1)
    one = np.column_stack([np.zeros_like(corner), corner, corner + 1])
    return np.asarray(one[None] + n * np.arange(count)[:, None, None]).reshape(-1, 3)


def rims(rings: Array, width: float) -> tuple[Array, Faces]:
    """Bands of `width` inside M rings (M, n, 2): vertices (2 M n, 2) and triangles."""
    count, n = rings.shape[:2]
    spokes = rings - rings.mean(axis=1, keepdims=True)
    reach = np.maximum(np.linalg.norm(spokes, axis=-1, keepdims=True), 1e-9)
    inner = rings - spokes * np.minimum(width / reach, 1.0)
    a = np.arange(n)
    b = (a + 1) % n
    one = np.concatenate([np.column_stack([a, b, n + b]), np.column_stack([a, n + b, n + a])])
    faces = one[None] + 2 * n * np.arange(count)[:, None, None]
    return np.concatenate([rings, inner], axis=1).reshape(-1, 2), np.asarray(faces).reshape(-1, 3)


def normals(points: Array) -> Array:
    """(N, 2) unit vectors to the left of a polyline (N, 2)."""
    ahead = np.gradient(points, axis=0)
    ahead /= np.maximum(np.linalg.norm(ahead, axis=-1, keepdims=True), 1e-12)
    return np.column_stack([-ahead[:, 1], ahead[:, 0]])


def strip(points: Array, left: Array, width: float) -> tuple[Array, Faces]:
    """A band of `width` along points (N, 2), `left` (N, 2) being normals: vertices (2 N, 2), left first."""
    n = len(points)
    a = np.arange(n - 1)
    faces = np.concatenate([np.column_stack([a, n + a, n + a + 1]), np.column_stack([a, n + a + 1, a + 1])])
    return np.concatenate([points + left * width / 2, points - left * width / 2]), faces


def triangulate(polygon: Array) -> Faces:
    """Ear clipping of a simple polygon (N, 2), any orientation: (N - 2, 3) vertex indices.

    A polygon that crosses itself still gets N - 2 triangles: when no ear is left, any corner is cut.
    """
    ring = np.arange(len(polygon))
    if area(polygon) < 0:
        ring = ring[::-1]
    at = polygon[ring]
    # only these can ever lie within an ear: cutting ears bends no other corner inwards
    inward = np.zeros(len(polygon), dtype=bool)
    inward[ring] = _cross(at - np.roll(at, 1, axis=0), np.roll(at, -1, axis=0) - at) <= 0
    left, faces, i, stuck = ring.tolist(), [], 0, 0
    while len(left) > 3:
        i %= len(left)
        corner = [left[i - 1], left[i], left[(i + 1) % len(left)]]
        if stuck > len(left) or _is_ear(polygon[corner], polygon[inward]):
            faces.append(corner)
            inward[left.pop(i)] = False
            stuck = 0
        else:
            stuck += 1
            i += 1
    return np.array([*faces, left], dtype=np.int64)


def area(ring: Array) -> float:
    """Signed area of a polygon (N, 2) [m²]; positive counter-clockwise."""
    x, y = (ring - ring[0]).T
    return float(0.5 * (x @ np.roll(y, -1) - y @ np.roll(x, -1)))


def _is_ear(triangle: Array, others: Array) -> bool:
    sides = np.roll(triangle, -1, axis=0) - triangle
    if sides[0, 0] * sides[1, 1] - sides[0, 1] * sides[1, 0] <= 0:
        return False
    inside = (_cross(sides, others[:, None] - triangle) >= 0).all(axis=-1)
    # the corners themselves, and vertices in the same place (a keyhole), block nothing
    return all((others[k] == triangle).all(axis=-1).any() for k in np.flatnonzero(inside))


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def resample(line: Array, spacing: float) -> Array:
    """Points (M, 2) along a polyline at about `spacing`, ends included."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=-1))])
    s = np.linspace(0.0, along[-1], max(2, round(float(along[-1]) / spacing) + 1))
    return np.column_stack([np.interp(s, along, line[:, 0]), np.interp(s, along, line[:, 1])])


def dashes(line: Array, dash: float = 3.0, gap: float = 6.0) -> list[Array]:
    """A polyline cut into pieces of `dash` metres."""
    points = resample(line, 1.0)
    period, length = round(dash + gap), round(dash)
    pieces = [points[i : i + length + 1] for i in range(0, len(points), period)]
    return [piece for piece in pieces if len(piece) > 1]


def dividers(lanes: Sequence[Array]) -> list[Array]:
    """Lines half-way between neighbouring, parallel lane centre lines (2 to 5.5 m apart)."""
    fine = [resample(lane, 1.0) for lane in lanes]
    boxes = [(points.min(axis=0) - 2.75, points.max(axis=0) + 2.75) for points in fine]
    found = []
    for i, j in combinations(range(len(fine)), 2):
        if np.all(boxes[i][0] <= boxes[j][1]) and np.all(boxes[j][0] <= boxes[i][1]):
            found += _between(fine[i], fine[j])
    return found


def _between(one: Array, other: Array) -> list[Array]:
    left, left_other = normals(one), normals(other)
    near = np.linalg.norm(one[:, None] - other[None], axis=-1).argmin(axis=1)
    gap = other[near] - one
    distance = np.linalg.norm(gap, axis=-1)
    aside = np.abs((gap * left).sum(axis=-1)) > 0.95 * distance
    parallel = np.abs((left * left_other[near]).sum(axis=-1)) > 0.98
    good = np.flatnonzero(aside & parallel & (distance > 2.0) & (distance < 5.5))
    runs = np.split(good, np.flatnonzero(np.diff(good) > 1) + 1)
    return [(one[run] + other[near[run]]) / 2 for run in runs if len(run) > 2]


def union_rings(polygons: Sequence[Array], inset: float = 0.0) -> list[Array]:
    """Outlines and holes (N, 2), closed, of the union of polygons, moved inwards by `inset`."""
    seam = 0.1  # neighbouring map polygons often miss each other by centimetres
    shapes = [shapely.make_valid(shapely.Polygon(polygon)).buffer(seam) for polygon in polygons]
    union = shapely.union_all(shapes).buffer(-seam - inset)
    rings = []
    for part in getattr(union, "geoms", [union]):
        if not part.is_empty:
            rings += [np.asarray(ring.coords) for ring in (part.exterior, *part.interiors)]
    return rings


def buffered(line: Array, half_width: float) -> Array:
    """Outline (N, 2) of the strip within `half_width` of a polyline, with flat ends."""
    around = shapely.LineString(line).buffer(half_width, cap_style="flat")
    parts = getattr(around, "geoms", [around])
    return np.asarray(max(parts, key=lambda part: part.area).exterior.coords)[:-1]
