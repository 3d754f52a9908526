"""What commonroad-drivability-checker says of CommonRoad solutions; `benchmarks.drivability` runs it.

    PYTHON -I benchmarks/drivability_judge.py < PAIRS

PYTHON is an interpreter that has the checker, so nothing of riskplan is imported here. PAIRS is JSON, a list of
[scenario file, solution file]; the answer is JSON on stdout: `versions` and, per pair, `verdicts`: why each check
failed, null where it passed. Status 3, and one line on stderr, if the checker cannot be imported.
"""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Callable
from importlib.metadata import version
from typing import Any

CHECKS = ("readable", "start", "clear of traffic", "within road", "goal", "feasible")


def main() -> int:
    """Judge what stdin lists."""
    answer = os.fdopen(os.dup(1), "w")  # the checker and its C++ print too: to stderr
    os.dup2(2, 1)
    try:
        import triangle  # noqa: F401, PLC0415  the checker imports it late, for road boundaries
        from commonroad_dc.feasibility import solution_checker  # noqa: F401, PLC0415
    except ImportError as error:
        print(error, file=sys.stderr)
        return 3
    names = ("commonroad-drivability-checker", "commonroad-io")
    verdicts = [judged(scenario, solution) for scenario, solution in json.load(sys.stdin)]
    json.dump({"versions": {name: version(name) for name in names}, "verdicts": verdicts}, answer)
    answer.close()
    return 0


def judged(scenario_file: str, solution_file: str) -> dict[str, str | None]:
    """Check → why it failed, None where it passed; what cannot be read fails every check."""
    from commonroad.common.file_reader import CommonRoadFileReader  # noqa: PLC0415
    from commonroad.common.solution import CommonRoadSolutionReader  # noqa: PLC0415
    from commonroad_dc.feasibility import solution_checker as check  # noqa: PLC0415

    try:
        scenario, problems = CommonRoadFileReader(scenario_file).open()
        solution = CommonRoadSolutionReader.open(solution_file)
    except Exception as error:  # whatever the readers trip over
        return dict.fromkeys(CHECKS, reason(error))
    return {
        "readable": None,
        "start": failure(lambda: check.starts_at_correct_state(solution, problems)),
        "clear of traffic": failure(lambda: not check.obstacle_collision(scenario, problems, solution)),
        "within road": failure(lambda: not check.boundary_collision(scenario, problems, solution)),
        "goal": goal_failure(lambda: check.goal_reached(scenario, problems, solution), solution, problems),
        "feasible": failure(lambda: feasible(check.solution_feasible(solution, scenario.dt, problems))),
    }


def failure(check: Callable[[], bool]) -> str | None:
    """Why it failed; the checker says so by an exception or by False."""
    try:
        return None if check() else "False"
    except Exception as error:
        return reason(error)


def goal_failure(check: Callable[[], bool], solution: Any, problems: Any) -> str | None:
    """The same, and whether the goal is reached by a point mass's speed and direction.

    commonroad-io 2024.3 (`GoalRegion._harmonize_state_types`) puts the speed in place of the velocity's x before it
    takes the heading from x and y, so a point mass never heads west.
    """
    from commonroad.scenario.state import KSState  # noqa: PLC0415

    why = failure(check)
    if why is None or any(one.vehicle_model.name != "PM" for one in solution.planning_problem_solutions):
        return why
    for one in solution.planning_problem_solutions:
        goal = problems.planning_problem_dict[one.planning_problem_id].goal
        states = [
            KSState(
                time_step=s.time_step,
                position=s.position,
                velocity=math.hypot(s.velocity, s.velocity_y),
                orientation=math.atan2(s.velocity_y, s.velocity),
            )
            for s in one.trajectory.state_list
        ]
        if not any(goal.is_reached(s) for s in states):
            return why
    return f"{why} Reached, if the heading is atan2(yVelocity, xVelocity)."


def feasible(found: dict[int, tuple[bool, Any, Any]]) -> bool:
    """Of every planning problem."""
    return all(ok for ok, *_ in found.values())


def reason(error: BaseException) -> str:
    """Kind and text of an error and of what caused it, on one line."""
    said = f"{type(error).__name__}: {' '.join(str(error).split())}"
    return said if error.__cause__ is None else f"{said}, by {reason(error.__cause__)}"


if __name__ == "__main__":
    raise SystemExit(main())
