"""Ego shapes: unions of ellipsoids fixed to the ego frame, big enough for the ego *and* the agent's body.

The agent is a point (its centre); its body is added to the ego's by the Minkowski sum. Every shape is a tuple of
pieces `{x : (x − o)ᵀ Q (x − o) ≤ 1}`; the risk of several pieces is the union bound (the sum, at most 1).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from checkers.validate import Array, InputError, as_array, as_scalar


class Body(Protocol):
    """What a shape needs to know of an agent: its size, if known."""

    @property
    def length(self) -> float | None:
        """[m]."""

    @property
    def width(self) -> float | None:
        """[m]."""


class EgoShape(Protocol):
    """Anything made of ellipsoids in the ego frame."""

    def pieces(self, agent: Body) -> tuple[Array, Array]:
        """Centres (N, 2) [m] and forms Q (N, 2, 2) [1/m²] of the ellipsoids this agent's centre must stay out of."""


@dataclass(frozen=True, eq=False)
class EgoEllipsoid:
    """The paper's shape: `{x : xᵀ Q x ≤ 1}` in the ego frame, Q (2, 2) symmetric positive definite [1/m²]."""

    Q: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "Q", _positive_definite("Q", self.Q))

    @classmethod
    def around(
        cls,
        length: float,
        width: float,
        agent_length: float = 0.0,
        agent_width: float = 0.0,
        relative_heading: float | None = None,
    ) -> EgoEllipsoid:
        """The smallest ellipse about the centre that contains the Minkowski sum of both rectangles.

        `relative_heading` [rad] is the agent's heading minus the ego's; None means any, and the agent becomes its
        circumscribed disc. With 0 the shape is true for traffic along the lane only.
        """
        corners = _minkowski_corners(*_sizes(length, width, agent_length, agent_width), relative_heading)
        return cls(smallest_ellipse(corners))

    def pieces(self, agent: Body) -> tuple[Array, Array]:
        """One ellipsoid about the origin, the same for every agent: (1, 2), (1, 2, 2)."""
        del agent
        return np.zeros((1, 2)), self.Q[None]


@dataclass(frozen=True)
class EgoCover:
    """`n` equal discs along the body, each around one of n equal slices of the Minkowski sum.

    Attributes:
        length, width: of the ego [m].
        n: number of discs; more are tighter beside the car, and overlap more.
        agent_length, agent_width: of the agents [m]; None: what the prediction carries, a point if it carries none.
        relative_heading: the agent's heading minus the ego's [rad]; None means any, and widens every disc by the
            agent's circumscribed disc. With 0 the shape is true for traffic along the lane only.
    """

    length: float
    width: float
    n: int = 6
    agent_length: float | None = None
    agent_width: float | None = None
    relative_heading: float | None = None

    def __post_init__(self) -> None:
        _sizes(self.length, self.width, self.agent_length or 0.0, self.agent_width or 0.0)
        if not isinstance(self.n, int) or isinstance(self.n, bool) or self.n < 1:
            raise InputError(f"n: expected an integer >= 1, got {self.n!r}")
        if self.relative_heading is not None:
            as_scalar("relative_heading", self.relative_heading)

    @classmethod
    def discs(
        cls,
        length: float,
        width: float,
        n: int = 6,
        agent_length: float | None = None,
        agent_width: float | None = None,
        relative_heading: float | None = None,
    ) -> EgoCover:
        """The same as the constructor."""
        return cls(length, width, n, agent_length, agent_width, relative_heading)

    def pieces(self, agent: Body) -> tuple[Array, Array]:
        """(n, 2), (n, 2, 2): discs for an agent of this size."""
        agent_length = (agent.length or 0.0) if self.agent_length is None else self.agent_length
        agent_width = (agent.width or 0.0) if self.agent_width is None else self.agent_width
        if self.relative_heading is None:
            half_length, half_width = self.length / 2, self.width / 2
            margin = float(np.hypot(agent_length, agent_width)) / 2
        else:
            box = _bounding_box(agent_length, agent_width, self.relative_heading)
            half_length, half_width, margin = (self.length + box[0]) / 2, (self.width + box[1]) / 2, 0.0
        radius = float(np.hypot(half_length / self.n, half_width)) + margin
        centres = (2 * np.arange(self.n) + 1 - self.n) * half_length / self.n
        offsets = np.column_stack([centres, np.zeros(self.n)])
        return offsets, np.broadcast_to(np.eye(2) / radius**2, (self.n, 2, 2))


def smallest_ellipse(points: Array) -> Array:
    """Q of the smallest-area origin-centred ellipse that contains `points` (N, 2) and their mirror images.

    Khachiyan's (1996) coordinate ascent with away steps (Todd & Yıldırım 2007); the result is scaled until the farthest
    point lies on the boundary, so containment holds exactly however early the ascent stops.
    """
    scale = np.abs(points).max(axis=0)  # to a box of about unit size: conditioning is then the shape's own
    unit = points / scale
    weights = np.full(len(unit), 1.0 / len(unit))
    for _ in range(2_000):
        inverse = np.linalg.inv((weights[:, None] * unit).T @ unit)
        reach = ((unit @ inverse) * unit).sum(axis=1)
        far, near = int(np.argmax(reach)), int(np.argmin(np.where(weights > 0, reach, np.inf)))
        if max(reach[far] - 2.0, 2.0 - reach[near]) <= 1e-9:
            break
        # towards the farthest point, or away from the nearest one that still has weight
        pick = far if reach[far] - 2.0 >= 2.0 - reach[near] else near
        step = (reach[pick] / 2.0 - 1.0) / (reach[pick] - 1.0)
        if pick == near and reach[near] - 1.0 <= 0.0:
            step = -np.inf
        step = max(step, -weights[pick] / (1.0 - weights[pick])) if pick == near else step
        weights = (1 - step) * weights
        weights[pick] = max(weights[pick] + step, 0.0)
    q: Array = inverse / (reach.max() * (1 + 1e-12)) / np.outer(scale, scale)
    return 0.5 * (q + q.T)


def _minkowski_corners(
    length: float, width: float, agent_length: float, agent_width: float, relative_heading: float | None
) -> Array:
    ego = _corners(length, width, 0.0)
    if relative_heading is not None:
        other = _corners(agent_length, agent_width, as_scalar("relative_heading", relative_heading))
    else:
        # a polygon around the agent's circumscribed disc, so that the sum with it contains the sum with the disc
        sides = 256
        radius = float(np.hypot(agent_length, agent_width)) / 2 / np.cos(np.pi / sides)
        angle = 2 * np.pi * np.arange(sides) / sides
        other = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    corners: Array = (ego[:, None] + other[None]).reshape(-1, 2)
    return corners


def _corners(length: float, width: float, heading: float) -> Array:
    c, s = np.cos(heading), np.sin(heading)
    signs = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
    corners: Array = signs * [length / 2, width / 2] @ np.array([[c, s], [-s, c]])
    return corners


def _bounding_box(length: float, width: float, heading: float) -> tuple[float, float]:
    extent = np.abs(_corners(length, width, as_scalar("relative_heading", heading))).max(axis=0)
    return 2 * float(extent[0]), 2 * float(extent[1])


def _sizes(length: float, width: float, agent_length: float, agent_width: float) -> tuple[float, float, float, float]:
    return (
        as_scalar("length", length, low=1e-6, high=1e6),
        as_scalar("width", width, low=1e-6, high=1e6),
        as_scalar("agent_length", agent_length, low=0.0, high=1e6),
        as_scalar("agent_width", agent_width, low=0.0, high=1e6),
    )


def _positive_definite(name: str, value: Array) -> Array:
    q = as_array(name, value, (2, 2))
    if abs(q[0, 1] - q[1, 0]) > 1e-9 * np.abs(q).max():
        raise InputError(f"{name}: expected a symmetric matrix, got {q.tolist()}")
    try:
        root = np.linalg.cholesky(q)
        sound = np.linalg.eigvalsh(q)[0] > 0 and root[1, 1] > 1e-7 * root[0, 0] and root[0, 0] > 1e-7 * root[1, 1]
    except np.linalg.LinAlgError:
        sound = False
    if not sound:
        raise InputError(f"{name}: expected a positive definite matrix, got {q.tolist()}")
    return q
