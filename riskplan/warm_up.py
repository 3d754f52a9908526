"""Compile what a search needs before its clock starts; kernels are kept on disk, so it takes seconds only once."""

from __future__ import annotations

from functools import cache

import numpy as np

from checkers import EgoCover, GaussianMixturePrediction, checker
from riskplan.evaluator import RiskEvaluator
from riskplan.scene import Goal, Scenario, State
from riskplan.search import Budget, Planner, Problem


@cache
def warm_up(planner: type[Planner]) -> None:
    """Search once per process and kind of planner, in a scene of three steps; all checkers share the loops."""
    times = np.linspace(0.0, 0.3, 4)
    means = np.tile(np.array([10.0, 3.0]), (4, 1, 1))
    agent = GaussianMixturePrediction(times, np.ones(1), means, np.tile(np.eye(2), (4, 1, 1, 1)))
    scene = Scenario(
        start=State(0.0, 0.0, 0.0, 10.0),
        goal=Goal.at(3.0, 0.0, radius=1.5),
        bounds=(-10.0, -5.0, 20.0, 5.0),
        agents=(agent,),
        ego=EgoCover.discs(1.0, 1.0, 2),
        drivable=(np.array([[-20.0, -5.0], [30.0, -5.0], [30.0, 5.0], [-20.0, 5.0]]),),
        lanes=(np.array([[-20.0, 0.0], [30.0, 0.0]]),),
    )
    evaluator = RiskEvaluator(scene.agents, scene.ego, checker("exact"), scene.times)
    few = 40 if getattr(planner, "anytime", False) else 2000  # one that goes on would go on to its limit
    found = planner().search(Problem(scene, evaluator), Budget(1.0, 60.0, iterations=few), 0)
    if found.states is not None:
        evaluator.judge(found.states[:, :3])
