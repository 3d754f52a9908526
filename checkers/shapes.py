"""Ego shapes: unions of ellipsoids fixed to the ego frame, big enough for the ego *and* the agent's body.

The agent is a point (its centre); its body is added to the ego's by the Minkowski sum. Every shape is a tuple of
pieces `{x : (x − o)ᵀ Q (x − o) ≤ 1}`; the risk of several pieces is the union bound (the sum, at most 1).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol, runtime_checkable

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


@runtime_checkable
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

    @staticmethod
    def aligned(length: float, width: float) -> AlignedEllipsoid:
        """An ellipse per step and mode, about both rectangles at the agent's own heading; see `AlignedEllipsoid`."""
        return AlignedEllipsoid(length, width)

    def pieces(self, agent: Body) -> tuple[Array, Array]:
        """One ellipsoid about the origin, the same for every agent: (1, 2), (1, 2, 2)."""
        del agent
        return np.zeros((1, 2)), self.Q[None]


@dataclass(frozen=True)
class EgoBox:
    """The true rectangle, against the agent's true rectangle: the tightest shape. Sizes in metres.

    `path_risk` judges it exactly, as box ⊕ box at the agent's heading; it needs agents with length, width and headings.
    Backends, which know ellipsoids only, get a cover by discs that contains it.
    """

    length: float
    width: float

    def __post_init__(self) -> None:
        _sizes(self.length, self.width, 0.0, 0.0)

    def pieces(self, agent: Body) -> tuple[Array, Array]:
        """Six discs that contain box ⊕ box at any heading of the agent."""
        return EgoCover(self.length, self.width, 6, *agent_size("EgoBox", agent)).pieces(agent)


@dataclass(frozen=True)
class AlignedEllipsoid:
    """An ellipse around both rectangles that turns with the agent's heading, per step and mode. Sizes in metres.

    It contains the sum of the smallest ellipses around either (Kurzhanski & Vályi 1997, section 2.2):
    {x : xᵀ P⁻¹ x ≤ 1}, P = (1 + 1/p) P_ego + (1 + p) P_agent for any p > 0; √(tr P_ego / tr P_agent) makes tr P least.
    `path_risk` takes it; backends, whose shape does not turn, get the ellipse for any heading.
    """

    length: float
    width: float

    def __post_init__(self) -> None:
        _sizes(self.length, self.width, 0.0, 0.0)

    def forms(self, agent: Body) -> tuple[float, float, float, float]:
        """Semi-axes [m] of the ellipses whose matrices add up to P: the ego's along its body, then the agent's."""
        other = agent_size("EgoEllipsoid.aligned", agent)
        # the smallest ellipse around a rectangle has √2 times its half-axes
        ratio = float(np.hypot(self.length, self.width) / np.hypot(*other))
        ego, agent_scale = np.sqrt(0.5 * (1 + 1 / ratio)), np.sqrt(0.5 * (1 + ratio))
        return ego * self.length, ego * self.width, agent_scale * other[0], agent_scale * other[1]

    def pieces(self, agent: Body) -> tuple[Array, Array]:
        """The ellipse that contains both at any heading."""
        return EgoEllipsoid.around(self.length, self.width, *agent_size("EgoEllipsoid.aligned", agent)).pieces(agent)


def agent_size(shape: str, agent: Body) -> tuple[float, float]:
    """Length and width of an agent that must have them.

    Raises:
        InputError: naming what is missing.
    """
    if agent.length is None or agent.width is None:
        raise InputError(
            f"{'length' if agent.length is None else 'width'}: {shape} needs agents that carry it, got None"
        )
    return agent.length, agent.width


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
        _sizes(self.length, self.width, *(0.0 if v is None else v for v in (self.agent_length, self.agent_width)))
        if not isinstance(self.n, int) or isinstance(self.n, bool) or not 1 <= self.n <= 1000:
            raise InputError(f"n: expected an integer from 1 to 1000, got {self.n!r}")
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
        return _discs(self.length, self.width, self.n, agent_length, agent_width, self.relative_heading)


@lru_cache(maxsize=256)
def _discs(
    length: float, width: float, n: int, agent_length: float, agent_width: float, relative_heading: float | None
) -> tuple[Array, Array]:
    """The pieces of an `EgoCover`, read-only."""
    if relative_heading is None:
        half_length, half_width = length / 2, width / 2
        margin = float(np.hypot(agent_length, agent_width)) / 2
    else:
        box = _bounding_box(agent_length, agent_width, relative_heading)
        half_length, half_width, margin = (length + box[0]) / 2, (width + box[1]) / 2, 0.0
    radius = float(np.hypot(half_length / n, half_width)) + margin
    centres = (2 * np.arange(n) + 1 - n) * half_length / n
    offsets = np.column_stack([centres, np.zeros(n)])
    offsets.flags.writeable = False
    return offsets, np.broadcast_to(np.eye(2) / radius**2, (n, 2, 2))


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
