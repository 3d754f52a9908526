"""Low-poly bodies as coloured triangles: cars, trucks, people, obstacles, shadows, the ego's risk shape."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from checkers.validate import Array
from riskplan.pictures import geometry, palette


class Mesh(NamedTuple):
    """Triangles: vertices (N, 3) [m], faces (M, 3), colours (N, 3) or with opacity (N, 4)."""

    vertices: Array
    faces: geometry.Faces
    colours: Array


Facet = tuple[Array, str]  # a convex polygon (n, 3) and its colour


def flat(points: Array, faces: geometry.Faces, colours: Array) -> Mesh:
    """A mesh on the ground from points (N, 2)."""
    vertices = np.column_stack([points, np.zeros(len(points))])
    return Mesh(vertices, faces, np.broadcast_to(colours, (len(points), colours.shape[-1])))


def merge(meshes: Sequence[Mesh]) -> Mesh:
    """One mesh of several: one draw call instead of many."""
    offsets = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=False)]),
        np.concatenate([mesh.colours for mesh in meshes]),
    )


def body(length: float, width: float, colour: str) -> Mesh:
    """A vehicle, or a person below 1.2 m; along x, centred, standing on z = 0."""
    if length < 1.2:
        return _lowered(_facets(_person(max(length, width), colour)), max(length, width) / 0.3)
    return vehicle(length, width, colour)


def vehicle(length: float, width: float, colour: str) -> Mesh:
    """A car, a truck from 6.5 m on; along x, centred, standing on z = 0."""
    facets = _truck(length, width, colour) if length >= 6.5 else _car(length, width, colour)
    return _lowered(_facets(facets), length / 3.0)


def robot(diameter: float, colour: str) -> Mesh:
    """A drum with a dark band and a pointer ahead, centred, standing on z = 0."""
    ring = _circle(0.5 * diameter, 20)
    facets = _prism(ring, ring * 0.94, 0.05, 0.34, colour, colour)
    facets += _prism(ring * 0.94, ring * 0.94, 0.34, 0.42, palette.GLASS, palette.GLASS)
    facets += _prism(ring * 0.94, ring * 0.7, 0.42, 0.56, colour, colour)
    tip = 0.5 * diameter * np.array([[0.6, 0.0], [0.05, 0.3], [0.05, -0.3]])
    facets.append((np.column_stack([tip, np.full(3, 0.575)]), palette.LINE))
    return _lowered(_facets(facets), diameter / 0.5)


def _lowered(mesh: Mesh, share: float) -> Mesh:
    """Heights are of full-grown bodies; smaller ones are lower, too."""
    return mesh._replace(vertices=mesh.vertices * [1.0, 1.0, min(1.0, share)])


def _person(width: float, colour: str) -> list[Facet]:
    """Legs, a coat, a head."""
    ring = _circle(0.5 * width, 10)
    facets = _prism(ring * 0.5, ring * 0.62, 0.0, 0.8, palette.GLASS, palette.GLASS)
    facets += _prism(ring * 0.78, ring * 0.95, 0.62, 1.32, colour, colour)
    facets += _prism(ring * 0.95, ring * 0.35, 1.32, 1.46, colour, colour)
    head = [(0.22, 1.46), (0.4, 1.54), (0.42, 1.64), (0.28, 1.74)]
    for (low, z0), (high, z1) in zip(head, head[1:], strict=False):
        facets += _prism(ring * low, ring * high, z0, z1, palette.SKIN, palette.SKIN)
    return facets


def _circle(radius: float, n: int) -> Array:
    angle = 2 * np.pi * np.arange(n) / n
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def column(polygon: Array, height: float, colour: str) -> Mesh:
    """A polygon (N, 2), convex or not, raised to `height`."""
    top = Mesh(
        np.column_stack([polygon, np.full(len(polygon), height)]),
        geometry.triangulate(polygon),
        _paint(polygon, colour),
    )
    return merge([top, _facets(_sides(polygon, polygon, 0.0, height, colour))])


def shadow(length: float, width: float) -> Mesh:
    """A soft dark spot under a body: opaque in the middle, gone 0.35 m outside of it, less for small ones."""
    soft = min(1.0, width)
    angle = 2 * np.pi * np.arange(32) / 32
    unit = np.column_stack([np.cos(angle), np.sin(angle)])
    unit = np.sign(unit) * np.abs(unit) ** 0.45  # between an ellipse and a rectangle
    half = np.array([length / 2, width / 2])
    inner, outer = unit * (half - 0.1 * soft), unit * (half + 0.35 * soft)
    a = np.arange(32)
    b = (a + 1) % 32
    band = np.concatenate([np.column_stack([a, b, 32 + b]), np.column_stack([a, 32 + b, 32 + a])])
    colours = np.concatenate([np.tile([0, 0, 0, 0.5], (32, 1)), np.zeros((32, 4))])
    return flat(np.concatenate([inner, outer]), np.concatenate([geometry.fan(inner[None]), band]), colours)


def curtain(ring: Array, height: float, colour: str) -> Mesh:
    """A closed line (N, 2) as a wall that fades upwards, with a faint floor and a clear foot line."""
    n = len(ring)
    tint = palette.rgb(colour)
    lower, upper = np.column_stack([ring, np.zeros(n)]), np.column_stack([ring, np.full(n, height)])
    a = np.arange(n)
    b = (a + 1) % n
    wall = Mesh(
        np.concatenate([lower, upper]),
        np.concatenate([np.column_stack([a, b, n + b]), np.column_stack([a, n + b, n + a])]),
        np.concatenate([np.tile([*tint, 0.40], (n, 1)), np.tile([*tint, 0.05], (n, 1))]),
    )
    floor = flat(ring, geometry.triangulate(ring), np.array([*tint, 0.16]))
    line = flat(*geometry.rims(ring[None], 0.08), np.array([*tint, 0.9]))
    return merge([floor, wall, line])


class _Slice(NamedTuple):
    """A level rectangle: from and to along x as shares of the length, a share of the width, a height [m]."""

    rear: float
    front: float
    width: float
    height: float


def _car(length: float, width: float, colour: str) -> list[Facet]:
    hull = _box(length, width, _Slice(-0.5, 0.5, 1.0, 0.27), _Slice(-0.495, 0.465, 0.93, 0.80), colour)
    roof = _Slice(-0.27, 0.05, 0.68, 1.40)
    cabin = _box(length, width, _Slice(-0.40, 0.20, 0.86, 0.80), roof, palette.GLASS, colour)
    return hull + cabin + _wheels((-0.31, 0.31), length, width)


def _truck(length: float, width: float, colour: str) -> list[Facet]:
    cab = 0.5 - min(2.2 / length, 0.3)  # where the cab begins
    cargo, frame = _Slice(-0.5, cab - 0.02, 1.0, 0.65), _Slice(-0.48, 0.48, 0.7, 0.4)
    facets = _box(length, width, cargo, cargo._replace(height=3.2), palette.CARGO)
    facets += _box(length, width, frame, frame._replace(height=0.65), palette.TYRE)
    facets += _box(length, width, _Slice(cab, 0.5, 0.96, 0.45), _Slice(cab, 0.475, 0.92, 2.7), colour)
    y, low, high = 0.42 * width, 0.496 * length + 0.02, 0.484 * length + 0.02
    screen = np.array([[low, -y, 1.5], [low, y, 1.5], [high, y, 2.35], [high, -y, 2.35]])
    return [*facets, (screen, palette.GLASS), *_wheels((-0.36, -0.22, 0.38), length, width, 0.48)]


def _box(length: float, width: float, low: _Slice, high: _Slice, side: str, top: str = "") -> list[Facet]:
    """What lies between two slices; the lid may have a colour of its own."""
    lower, upper = (
        np.array([[s.rear, -1], [s.front, -1], [s.front, 1], [s.rear, 1]]) * [length, s.width * width / 2]
        for s in (low, high)
    )
    return _prism(lower, upper, low.height, high.height, side, top or side)


def _wheels(places: Sequence[float], length: float, width: float, radius: float = 0.33) -> list[Facet]:
    angle = 2 * np.pi * np.arange(10) / 10
    facets = []
    for share in places:
        for side in (-1.0, 1.0):
            y0, y1 = side * (width / 2 - 0.24), side * (width / 2 + 0.03)
            x, z = share * length + radius * np.cos(angle), radius + radius * np.sin(angle)
            inner, outer = (np.column_stack([x, np.full(10, y), z]) for y in (y0, y1))
            tread = [np.stack([inner[i - 1], inner[i], outer[i], outer[i - 1]]) for i in range(10)]
            facets += [(ring, palette.TYRE) for ring in (*tread, outer)]
    return facets


def _prism(low_ring: Array, high_ring: Array, low: float, high: float, side: str, top: str) -> list[Facet]:
    lid = np.column_stack([high_ring, np.full(len(high_ring), high)])
    return [*_sides(low_ring, high_ring, low, high, side), (lid, top)]


def _sides(low_ring: Array, high_ring: Array, low: float, high: float, colour: str) -> list[Facet]:
    lower = np.column_stack([low_ring, np.full(len(low_ring), low)])
    upper = np.column_stack([high_ring, np.full(len(high_ring), high)])
    return [(np.stack([lower[i - 1], lower[i], upper[i], upper[i - 1]]), colour) for i in range(len(lower))]


def _facets(facets: Sequence[Facet]) -> Mesh:
    """Facets share no vertices, so the viewer's vertex normals are face normals: flat shading."""
    return merge([Mesh(ring, geometry.fan(ring[None]), _paint(ring, colour)) for ring, colour in facets])


def _paint(vertices: Array, colour: str) -> Array:
    return np.tile(palette.rgb(colour), (len(vertices), 1))
