"""Small recordings for the tests of data sets and windows."""

from __future__ import annotations

import numpy as np

from predictor.lanes import Lane
from predictor.recordings import Recording
from predictor.tracks import Track


def straight(name="a", steps=60, dt=0.1, start=(0.0, 0.0), speed=10.0, heading=0.0, first=0, missing=()):
    """A track at constant velocity from step `first` on, without the steps in `missing`."""
    kept = np.array([k for k in range(first, first + steps) if k not in missing])
    times = kept * dt
    way = (speed * (times - first * dt))[:, None] * [np.cos(heading), np.sin(heading)]
    return Track(name, times, np.array(start) + way, np.full(len(times), heading), np.full(len(times), speed), 4.5, 1.8)


def lane(name="l", y=0.0, length=200.0, width=4.0, successors=()):
    x = np.linspace(0.0, length, 11)
    centre, left, right = (np.column_stack([x, np.full(11, y + d)]) for d in (0.0, width / 2, -width / 2))
    return Lane(name, centre, left, right, successors)


def recording(name="r", tracks=None, **more):
    return Recording(name, more.pop("dt", 0.1), tuple(tracks or (straight(),)), **more)
