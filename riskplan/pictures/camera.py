"""Where to look from: the one view of the 3-D page that shows what matters, as near as possible."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from checkers.validate import Array
from riskplan.pictures import geometry
from riskplan.pictures.picture import Picture

_ASIDE, _DOWN = np.deg2rad(30), np.deg2rad(26)
_FOV = 29.0
_SHAPE = 1.75  # width by height of a usual window
_FILL = np.array([0.86, 0.80])  # of the half width and height that may be used: there is a legend, too


class Camera(NamedTuple):
    """A view.

    Attributes:
        target: (3,) what is in the middle [m].
        eye: (3,) where the camera is, relative to the target [m].
        distance: between the two [m].
        fov: vertical [degree].
    """

    target: Array
    eye: Array
    distance: float
    fov: float


def look(pic: Picture) -> Camera:
    """Look along the ego's way, from behind, aside and above."""
    points = _subjects(pic)
    ahead = points[-1] - points[0]
    bearing = np.arctan2(ahead[1], ahead[0]) if np.hypot(*ahead) > 1.0 else pic.ego[0, 2]
    return fit(points, float(bearing) + _ASIDE)


def fit(points: Array, yaw: float) -> Camera:
    """The nearest camera looking towards `yaw` [rad] that shows all points (N, 2) of the ground, centred."""
    level = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    forward = level * np.cos(_DOWN) - [0.0, 0.0, np.sin(_DOWN)]
    right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
    up = np.cross(right, forward)
    tangent = np.tan(np.deg2rad(_FOV) / 2) * np.array([_SHAPE, 1.0]) * _FILL
    spots = np.column_stack([points, np.zeros(len(points))])
    target, distance = spots.mean(axis=0), 1.0
    for _ in range(30):  # perspective: what is in the middle depends on how near we are
        seen = spots - target
        across, depth = np.column_stack([seen @ right, seen @ up]), seen @ forward
        distance = max(float((np.abs(across) / tangent - depth[:, None]).max()), 15.0)
        shot = across / (distance + depth)[:, None]
        middle = (shot.max(axis=0) + shot.min(axis=0)) / 2 * distance
        target = target + middle[0] * right + middle[1] / np.sin(_DOWN) * level * 0.5
    return Camera(target, -distance * forward, distance, _FOV)


def _subjects(pic: Picture) -> Array:
    """(N, 2) points that have to be seen: the ego first, the end of its way (or the goal) last."""
    x0, y0, x1, y1 = pic.window
    starts = [agent.track[0, :2] for agent in pic.agents]
    near = [at[None] for at in starts if x0 <= at[0] <= x1 and y0 <= at[1] <= y1]
    goals = [goal.mean(axis=0, keepdims=True) for goal in pic.goals]
    rings = [geometry.place(ring, pic.ego[0]) for ring in pic.ego_rings]
    end = pic.ego[-1:, :2] if len(pic.path) > 1 else goals[0]
    return np.concatenate([pic.ego[:, :2], *rings, *near, *goals, end])
