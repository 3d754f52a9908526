"""Where OMPL's PRM draws its vertices from."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from ompl import base as ob

from checkers.validate import Array

_OFF_LANE = 0.2  # share of poses drawn anywhere


class LaneSampler(ob.ValidStateSampler):
    """Poses on and about the lanes, in their direction; a share of them, and all without lanes, anywhere.

    Args:
        si: SpaceInformation (SE2).
        lanes: (E, 6) lane pieces (see `world.lane_segments`).
        bounds: (4,) x_min, y_min, x_max, y_max.
        rng: of the draws.
        free: whether (x, y, heading) is free of the static world.
    """

    def __init__(
        self,
        si: Any,
        lanes: Array,
        bounds: Array,
        rng: np.random.Generator,
        free: Callable[[float, float, float], bool],
    ) -> None:
        super().__init__(si)
        self._lanes, self._bounds, self._rng, self._free = lanes, bounds, rng, free
        self._cumulated = np.cumsum(lanes[:, 4]) / max(lanes[:, 4].sum(), 1e-12)
        self._pool: list[list[float]] = []

    def sample(self, state: Any) -> bool:
        """Write a free pose; False if this draw was not free."""
        if not self._pool:
            self._pool = self._draw(256).tolist()
        x, y, heading = self._pool.pop()
        if not self._free(x, y, heading):
            return False
        state.setX(x)
        state.setY(y)
        state.setYaw(heading)
        return True

    def sampleNear(self, state: Any, near: Any, distance: float) -> bool:  # noqa: N802, ARG002  OMPL's name
        """The same: PRM does not ask for it."""
        return self.sample(state)

    def _draw(self, count: int) -> Array:
        rng, low, high = self._rng, self._bounds[:2], self._bounds[2:]
        anywhere = np.column_stack([rng.uniform(low, high, (count, 2)), rng.uniform(-np.pi, np.pi, count)])
        if not len(self._lanes):
            return anywhere
        lane = self._lanes[np.minimum(np.searchsorted(self._cumulated, rng.random(count)), len(self._lanes) - 1)]
        along = rng.random(count) * lane[:, 4]
        # a third of the poses lie on the lane, another keeps to it closely: in a narrow one no others are of use
        loose = rng.choice([1.0, 0.2, 0.0], count)
        across = rng.standard_normal(count) * 0.6 * loose
        poses = np.column_stack(
            [
                lane[:, 0] + along * lane[:, 2] - across * lane[:, 3],
                lane[:, 1] + along * lane[:, 3] + across * lane[:, 2],
                (lane[:, 5] + rng.standard_normal(count) * 0.08 * loose + np.pi) % (2 * np.pi) - np.pi,
            ]
        )
        inside = ((poses[:, :2] >= low) & (poses[:, :2] <= high)).all(axis=1)
        # off the lanes too, but in a lane's direction: between lanes when changing them
        sideways = np.column_stack([anywhere[:, :2], poses[:, 2]])
        kind = rng.random(count)
        poses = np.where((kind < _OFF_LANE)[:, None], sideways, poses)
        poses = np.where((kind < 0.25 * _OFF_LANE)[:, None], anywhere, poses)
        return poses[inside | (kind < _OFF_LANE)]
