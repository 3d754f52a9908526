"""Compile what a search needs before its clock starts; kernels are kept on disk, so it takes seconds only once."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from checkers import EgoBox, EgoCover, GaussianMixturePrediction, checker
from checkers.validate import Array
from riskplan.futures import make_evaluator
from riskplan.scene import Goal, Scenario, State
from riskplan.search import Budget, Planner, Problem
from riskplan.world import goal_too_far


@cache
def warm_up(planner: type[Planner], dependence: str = "independent") -> None:
    """Search and judge once per process, kind of planner and dependence, in a scene of three steps.

    All checkers share the loops; where errors persist, shapes and agents of every kind have loops of their own.
    """
    times = np.linspace(0.0, 0.3, 4)
    agent = _agent(times)
    scene = Scenario(
        start=State(0.0, 0.0, 0.0, 10.0),
        goal=Goal.at(3.0, 0.0, radius=1.5),
        bounds=(-10.0, -5.0, 20.0, 5.0),
        agents=(agent,),
        ego=EgoCover.discs(1.0, 1.0, 2),
        drivable=(np.array([[-20.0, -5.0], [30.0, -5.0], [30.0, 5.0], [-20.0, 5.0]]),),
        lanes=(np.array([[-20.0, 0.0], [30.0, 0.0]]),),
    )
    if dependence != "persistent":
        _search(planner, scene, dependence)
        return
    for ego in (scene.ego, EgoBox(1.0, 1.0)):
        for share in (1.0, 0.9):  # all of the error persists, or the rest is drawn at every step
            known = replace(agent, factors=share * agent.covariances)
            _search(planner, replace(scene, ego=ego, agents=(known,)), dependence)


def _agent(times: Array) -> GaussianMixturePrediction:
    """Two modes."""
    means = np.stack([5.0 + 4.0 * times, 2.0 + 0.0 * times], axis=-1)[:, None].repeat(2, axis=1)
    spread = np.tile(np.eye(2), (len(times), 2, 1, 1))
    headings = np.zeros((len(times), 2))
    return GaussianMixturePrediction(times, np.full(2, 0.5), means, spread, length=4.0, width=2.0, headings=headings)


def _search(planner: type[Planner], scene: Scenario, dependence: str) -> None:
    evaluator = make_evaluator(scene.agents, scene.ego, checker("exact"), scene.times, dependence)
    few = 40 if getattr(planner, "anytime", False) else 2000  # one that goes on would go on to its limit
    planner().search(Problem(scene, evaluator), Budget(1.0, 60.0, iterations=few), 0)
    # and for what cannot be reached, which asks for more
    far = replace(scene, goal=Goal.at(18.0, 0.0, radius=1.5))
    problem = Problem(far, evaluator)
    goal_too_far(far, problem.goal)
    planner().search(problem, Budget(1.0, 60.0, iterations=40), 0)
    driven = np.column_stack([10.0 * scene.times, np.zeros((len(scene.times), 2))])
    evaluator.judge(driven)  # whatever was found
    evaluator.confirmed(driven, 0.0)
