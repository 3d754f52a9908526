"""Where to look from: the one view of the scene that shows what matters, as near as possible."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from checkers.validate import Array
from riskplan.pictures import geometry
from riskplan.pictures.picture import Picture

ASPECT = 1.75  # width by height of a usual window

_ASIDE, _DOWN = np.deg2rad(27), np.deg2rad(24)
_STEEP = np.deg2rad(38)  # where what matters lies all around the ego rather than ahead of it
_BEND = np.deg2rad(35)  # between the way's beginning and its end: from here on it is a turn
_FOV = 29.0
_FILL = np.array([0.92, 0.88])  # of the half width and height that may be used: there is a legend, too
_NEAR = 46.0  # distance of the camera that follows the ego [m]
_LEAD = 11.0  # how far ahead of the ego it looks [m]


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


def look(pic: Picture, aspect: float = ASPECT, beside: float = 0.0) -> Camera:
    """Look along the ego's way, from behind, aside and above; `beside`: share of the width to be left free, left."""
    points = subjects(pic)
    bearing = _bearing(pic)
    along = np.array([np.cos(bearing), np.sin(bearing)])
    across = np.ptp(points @ [-along[1], along[0]])
    down = _DOWN if across < 0.5 * np.ptp(points @ along) else _STEEP
    yaw = bearing + _ASIDE
    view = fit(points, yaw, down, aspect * (1.0 - beside), 15.0 * pic.stroke)
    shift = beside * view.distance * np.tan(np.deg2rad(_FOV) / 2) * aspect
    return view._replace(target=view.target - shift * np.array([np.sin(yaw), -np.cos(yaw), 0.0]))


def follow(pic: Picture) -> tuple[Camera, Array]:
    """A camera that goes with the ego, and the (T, 3) points it looks at over `Picture.times`.

    It keeps its direction: one that turned with the ego would make the still world swing.
    """
    bearing = _bearing(pic)
    lead = _LEAD * min(1.0, pic.ego_size[0] / 4.0) * np.array([np.cos(bearing), np.sin(bearing)])
    targets = np.column_stack([pic.ego[:, :2] + lead, np.zeros(len(pic.ego))])
    yaw, scale = bearing + _ASIDE, np.clip(pic.ego_size[0] / 4.5, 0.4, 1.5)
    forward = _forward(yaw, _DOWN)
    distance = _NEAR * float(scale)
    return Camera(targets[0], -distance * forward, distance, _FOV), targets


def fit(points: Array, yaw: float, down: float = _DOWN, aspect: float = ASPECT, least: float = 15.0) -> Camera:
    """The nearest camera looking towards `yaw`, `down` [rad], that shows all points (N, 2) of the ground, centred,
    from no nearer than `least` [m].
    """
    level = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    forward = _forward(yaw, down)
    right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
    up = np.cross(right, forward)
    tangent = np.tan(np.deg2rad(_FOV) / 2) * np.array([aspect, 1.0]) * _FILL
    spots = np.column_stack([points, np.zeros(len(points))])
    target, distance = spots.mean(axis=0), 1.0
    for _ in range(30):  # perspective: what is in the middle depends on how near we are
        seen = spots - target
        across, depth = np.column_stack([seen @ right, seen @ up]), seen @ forward
        distance = max(float((np.abs(across) / tangent - depth[:, None]).max()), least)
        shot = across / (distance + depth)[:, None]
        middle = (shot.max(axis=0) + shot.min(axis=0)) / 2 * distance
        target = target + middle[0] * right + middle[1] / np.sin(down) * level * 0.5
    return Camera(target, -distance * forward, distance, _FOV)


def project(camera: Camera, points: Array, aspect: float) -> Array:
    """(N, 2) places in the picture of points (N, 2) of the ground: from (0, 0), top left, to (1, 1)."""
    forward = -camera.eye / camera.distance
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    seen = np.column_stack([points, np.zeros(len(points))]) - camera.target - camera.eye
    depth = np.maximum(seen @ forward, 1e-3)
    half = np.tan(np.deg2rad(camera.fov) / 2)
    x, y = seen @ right / (depth * half * aspect), seen @ np.cross(right, forward) / (depth * half)
    return np.column_stack([(1 + x) / 2, (1 - y) / 2])


def subjects(pic: Picture) -> Array:
    """(N, 2) points that have to be seen: the ego first, the end of its way (or the goal) last."""
    x0, y0, x1, y1 = pic.window
    along = np.array([np.cos(pic.ego[0, 2]), np.sin(pic.ego[0, 2])])
    starts = [agent.track[0, :2] for agent in pic.agents]
    # who comes from behind will come into the picture; to show where from would make all else small
    ahead = [at[None] for at in starts if at @ along > -3.0]
    near = [at for at in ahead if x0 <= at[0, 0] <= x1 and y0 <= at[0, 1] <= y1]
    # the end of the way shows where the goal is; without one, all of it
    goals = [goal.mean(axis=0, keepdims=True) if len(pic.path) > 1 else goal for goal in pic.goals]
    rings = [geometry.place(ring, pic.ego[0]) for ring in pic.ego_rings]
    end = pic.ego[-1:, :2] if len(pic.path) > 1 else goals[0].mean(axis=0, keepdims=True)
    return np.concatenate([pic.ego[:, :2], *rings, *near, *goals, end])


def _bearing(pic: Picture) -> float:
    """Where the way leads; where it bends, as it begins: what comes towards us is seen then."""
    points = subjects(pic)
    ahead, heading = points[-1] - points[0], float(pic.ego[0, 2])
    if np.hypot(*ahead) <= 1.0:
        return heading
    chord = float(np.arctan2(ahead[1], ahead[0]))
    turned = (chord - heading + np.pi) % (2 * np.pi) - np.pi
    return heading + turned * (1.0 if abs(turned) < _BEND else 0.25)


def _forward(yaw: float, down: float) -> Array:
    return np.array([np.cos(yaw) * np.cos(down), np.sin(yaw) * np.cos(down), -np.sin(down)])
