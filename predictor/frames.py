"""Target-centred frames: what is predicted is seen from where the target is, in the direction it came (math.md 6).

In its frame a target's last observed position is the origin, its first lies on the negative x-axis. A target that
stands still came from nowhere: its recorded heading is the x-axis then.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from checkers.validate import Array, as_array, as_scalar

# a target that came less far than this while observed has no direction of its own [m]
STILL = 1.0


@dataclass(frozen=True, eq=False)
class Frames:
    """A frame per target: local = R(angle)ᵀ (world − origin) / scale.

    Attributes:
        origins: (N, 2) world positions of the local origins [m].
        angles: (N,) headings of the local x-axes [rad].
        scale: length of the local unit [m].
    """

    origins: Array
    angles: Array
    scale: float = 1.0

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "origins", as_array("origins", self.origins, ("N", 2)))
        put(self, "angles", as_array("angles", self.angles, (len(self.origins),)))
        put(self, "scale", as_scalar("scale", self.scale, low=0.0, strict=True))

    @classmethod
    def of(cls, past: Any, headings: Any, scale: float = 1.0, still: float = STILL) -> Frames:
        """The frames of targets observed at `past` (N, P, 2) [m], with recorded `headings` (N,) at the end [rad].

        Args:
            past: oldest position first.
            headings: used for targets that moved less than `still` [m] between first and last.
            scale: length of the local unit [m].
            still: [m].
        """
        past = as_array("past", past, ("N", "P", 2))
        headings = as_array("headings", headings, (len(past),))
        way = past[:, -1] - past[:, 0]
        came = np.arctan2(way[:, 1], way[:, 0])
        return cls(past[:, -1], np.where(np.hypot(*way.T) < still, headings, came), scale)

    @property
    def rotations(self) -> Array:
        """(N, 2, 2) from local to world axes."""
        c, s = np.cos(self.angles), np.sin(self.angles)
        return np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)

    def to_local(self, points: Any) -> Array:
        """World points (N, ..., 2) [m] in local units; NaN stays NaN."""
        points = np.asarray(points, dtype=np.float64)
        moved = (points - _over(self.origins, points)) / self.scale
        local: Array = np.einsum("n...j,njk->n...k", moved, self.rotations)
        return local

    def to_world(self, points: Any) -> Array:
        """Local points (N, ..., 2) in the world [m]: the inverse of `to_local`."""
        points = np.asarray(points, dtype=np.float64)
        turned = np.einsum("n...j,nkj->n...k", points, self.rotations)
        world: Array = turned * self.scale + _over(self.origins, points)
        return world

    def covariances_to_world(self, covariances: Any) -> Array:
        """Local covariances (N, ..., 2, 2) in the world [m²]; they grow with the square of the scale."""
        turned = self._turned(np.asarray(covariances, dtype=np.float64), self.rotations)
        return turned * self.scale**2

    def covariances_to_local(self, covariances: Any) -> Array:
        """World covariances (N, ..., 2, 2) [m²] in squared local units."""
        turned = self._turned(np.asarray(covariances, dtype=np.float64), np.swapaxes(self.rotations, -1, -2))
        return turned / self.scale**2

    def factors_to_world(self, factors: Any) -> Array:
        """Local factors (N, ..., 2, R) in the world [m]: their columns turn like points and grow with the scale."""
        factors = np.asarray(factors, dtype=np.float64)
        turned: Array = _each(self.rotations, factors) @ factors
        return turned * self.scale

    def headings_to_local(self, headings: Any) -> Array:
        """World headings (N, ...) [rad] against the local x-axes, in (−π, π]."""
        headings = np.asarray(headings, dtype=np.float64)
        local: Array = np.angle(np.exp(1j * (headings - self.angles.reshape(-1, *[1] * (headings.ndim - 1)))))
        return local

    def _turned(self, covariances: Array, rotations: Array) -> Array:
        own = _each(rotations, covariances)
        turned: Array = own @ covariances @ np.swapaxes(own, -1, -2)  # einsum of three is ten times slower
        return turned


def _each(rotations: Array, matrices: Array) -> Array:
    return rotations.reshape(len(rotations), *[1] * (matrices.ndim - 3), 2, 2)


def _over(origins: Array, points: Array) -> Array:
    return origins.reshape(len(origins), *[1] * (points.ndim - 2), 2)
