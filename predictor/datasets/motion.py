"""Speed and heading of tracks that come as positions only."""

from __future__ import annotations

import numpy as np

from checkers.validate import Array

# seconds of past a velocity is fitted to, and the speed below which it has no direction [m/s]
WINDOW, MOVING = 1.0, 0.5


def motion(times: Array, positions: Array) -> tuple[Array, Array]:
    """Headings (T,) [rad] and speeds (T,) [m/s] of positions (T, 2) [m], each from what was observed until then.

    Velocity by least squares over the last second. The heading is its direction; while it is slower than 0.5 m/s the
    last one holds, and before there was any it is 0: nothing tells.
    """
    velocities = np.zeros_like(positions)
    first = np.searchsorted(times, times - WINDOW - 1e-6)
    for k in range(1, len(times)):
        span = slice(min(first[k], k - 1), k + 1)
        age = times[span] - times[span].mean()
        velocities[k] = age @ (positions[span] - positions[k]) / (age @ age)
    speeds: Array = np.hypot(*velocities.T)
    moving = speeds >= MOVING
    latest = np.maximum.accumulate(np.where(moving, np.arange(len(times)), -1))
    directions = np.arctan2(velocities[:, 1], velocities[:, 0])
    headings: Array = np.where(latest >= 0, directions[np.maximum(latest, 0)], 0.0)
    return headings, speeds
