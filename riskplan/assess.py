"""A stored trajectory judged again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from checkers import Checker, InputError, TrajectoryRisk
from riskplan.futures import make_evaluator
from riskplan.result import Plan
from riskplan.scene import Scenario


def judge_again(plan: Plan, scenario: Scenario, checker: Checker) -> tuple[Plan, bool]:
    """The plan with its risk as `checker` judges it now, and whether that is what it said.

    Raises:
        InputError: if the trajectory is not on the scenario's grid.
    """
    steps = len(plan.times)
    if steps > scenario.steps + 1 or not np.allclose(plan.times, scenario.times[:steps], atol=1e-6):
        raise InputError(
            f"trajectory.times: expected the scenario's grid, 0 to {scenario.times[-1]:g} s by {scenario.time_step:g} s"
        )
    dependence = str(plan.settings.get("dependence", "independent"))
    evaluator = make_evaluator(scenario.agents, scenario.ego, checker, scenario.times, dependence)
    risk, marginals = evaluator.judge(plan.poses)
    same = _same_risk(plan.risk, risk) and len(marginals) == len(plan.marginals)
    same = same and all(np.array_equal(a, b, equal_nan=True) for a, b in zip(marginals, plan.marginals, strict=True))
    return replace(plan, risk=risk, marginals=marginals), same


def _same_risk(a: TrajectoryRisk | None, b: TrajectoryRisk | None) -> bool:
    if a is None or b is None:
        return a is b
    values = [(getattr(a, name), getattr(b, name)) for name in ("total", "per_agent", "per_step", "boole", "max_step")]
    return a.kind is b.kind and all(np.array_equal(x, y) for x, y in values)
