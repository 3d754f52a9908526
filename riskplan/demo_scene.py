"""The scenes of `riskplan demo`: a hand-made one, and simulated traffic whose agents the shipped network predicts."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from checkers import InputError
from riskplan.scene import Scenario

if TYPE_CHECKING:
    from predictor import Recording

DATA = Path(__file__).parent / "data"
SCENES = ("traffic", "overtake")


def demo_scene(name: str) -> Scenario:
    """A scene by name.

    Raises:
        InputError: an unknown name, or no torch for "traffic": what to install.
    """
    from riskplan.io import load_scenario  # noqa: PLC0415  slow to import

    if name not in SCENES:
        raise InputError(f"scene: expected one of {', '.join(SCENES)}; got {name!r}")
    scenario = load_scenario(DATA / f"{name}.yaml")
    if name == "overtake":
        return scenario
    from predictor import open_data  # noqa: PLC0415

    return with_learned_agents(scenario, next(iter(open_data(DATA / "traffic.npz").recordings())))


def with_learned_agents(scenario: Scenario, observed: Recording) -> Scenario:
    """The scenario among observed traffic, as the shipped network predicts it for 3 s from the last observation on."""
    from predictor import LearnedPredictor  # noqa: PLC0415  needs torch

    times = 0.1 * np.arange(31)
    agents = LearnedPredictor.shipped().predict(observed.tracks, times, lanes=observed.lanes)
    return scenario.with_agents(agents)
