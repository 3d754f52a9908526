"""Record simulated traffic, with every vehicle's true controls: what differentiated tracks of real data lack.

The simulator is highway-env (the extra `simulator`), without a display; it stands in for CARLA, with which the paper
recorded (Jasour et al. 2021, section VII-C).
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence

import numpy as np

from checkers.validate import InputError, as_count, as_option, as_seed, as_tuple
from predictor.recordings import Recording

MAPS = ("highway", "merge", "intersection", "roundabout")
# steps of a scene at 10 Hz; of a window, and from one window of a track to its next
STEPS, WINDOW, EVERY = 200, 50, 10


def record(samples: int, seed: int = 0, maps: Sequence[str] = MAPS) -> Iterator[Recording]:
    """Scenes of 20 s at 10 Hz, on the map with the fewest so far, until there are `samples` windows of 5 s, 1 s apart.

    Asking for more samples with the same seed and maps adds scenes and changes none.

    Raises:
        InputError: an unknown map, a count below 1, or no highway-env.
    """
    as_count("samples", samples, 1)
    as_seed("seed", seed)
    if not as_tuple("maps", maps, str):
        raise InputError(f"maps: expected some of {', '.join(MAPS)}; got none")
    for i, kind in enumerate(maps):
        as_option(f"maps[{i}]", kind, MAPS)
    os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    try:
        from predictor.simulator.traffic import simulated  # noqa: PLC0415 (an extra)
    except ImportError:
        raise InputError("recording needs highway-env: pip install '.[simulator]' in the checkout") from None
    found, scene = dict.fromkeys(maps, 0), 0
    while sum(found.values()) < samples:
        kind = min(found, key=lambda name: found[name])
        recording = simulated(f"{kind}-{seed}-{scene}", kind, STEPS, np.random.default_rng([seed, scene]))
        found[kind] += windows_in(recording)
        scene += 1
        yield recording


def windows_in(recording: Recording) -> int:
    """How many windows of 5 s, 1 s apart, the tracks of a recording hold."""
    return sum(max(0, (len(t.times) - WINDOW) // EVERY + 1) for t in recording.tracks)
