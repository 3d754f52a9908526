"""Plans as CommonRoad solutions: the XML that commonroad-io reads and the CommonRoad server scores.

A plan's car is a point moving along its heading within limits of acceleration and curvature: CommonRoad's point mass
PM, and its kinematic single-track model KS up to the rate of steering. Positions are the body's centre in both.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as et

import numpy as np

from checkers import InputError
from checkers.validate import Array, as_option
from riskplan.io.text import write_text
from riskplan.io.trajectory import columns
from riskplan.result import Plan

MODELS = ("KS", "PM")
COST_FUNCTIONS = ("JB1", "SA1", "WX1", "SM1", "SM2", "SM3", "MW1", "TR1", "TR2")
PM_COST_FUNCTIONS = ("JB1", "WX1", "MW1")
# wheelbase a + b [m] of the vehicle types: Ford Escort, BMW 320i, VW Vanagon (Althoff & Würsching 2020, table 6)
WHEELBASES = {1: 2.39268, 2: 2.5789128, 3: 2.471928}


def save_solution(
    plan: Plan,
    path: str | Path,
    commonroad: str | Path,
    problem: int = 0,
    *,
    vehicle_model: str = "PM",
    vehicle_type: int = 2,
    cost_function: str = "JB1",
) -> None:
    """Write a plan as the solution of a planning problem of a CommonRoad file, complete or not at all.

    Args:
        plan: with a trajectory, made for that problem.
        path: file to write.
        commonroad: the scenario's XML, which the ids and the initial time step are read from.
        problem: which planning problem of it, in the file's order.
        vehicle_model: "PM", or "KS", which limits the rate of steering: a plan's car does not, and mostly fails there.
        vehicle_type: 1 Ford Escort, 2 BMW 320i, 3 VW Vanagon: the body the solution is judged with. Plan with its size.
        cost_function: of CommonRoad, by which the server ranks.

    Raises:
        InputError: for a plan without a trajectory or off the file's time grid, unknown names, an unreadable scenario.
    """
    as_option("vehicle_model", vehicle_model, MODELS)
    as_option("cost_function", cost_function, PM_COST_FUNCTIONS if vehicle_model == "PM" else COST_FUNCTIONS)
    if vehicle_type not in WHEELBASES:
        raise InputError(f"vehicle_type: expected one of {', '.join(map(str, WHEELBASES))}; got {vehicle_type!r}")
    from predictor.io_commonroad import open_commonroad  # noqa: PLC0415  an extra

    scenario, problems = open_commonroad(commonroad)
    found = list(problems.planning_problem_dict.values())
    if not 0 <= problem < len(found):
        raise InputError(f"problem: expected 0 to {len(found) - 1}, got {problem!r}")
    first = int(found[problem].initial_state.time_step)
    states = _states(plan, vehicle_model, WHEELBASES[vehicle_type])
    steps = _time_steps(plan.times, float(scenario.dt)) + first
    root = et.Element("CommonRoadSolution")
    name = f"{vehicle_model}{vehicle_type}:{cost_function}:{scenario.scenario_id}"
    root.set("benchmark_id", f"{name}:{scenario.scenario_id.scenario_version}")
    kind = vehicle_model.lower()
    trajectory = et.SubElement(root, f"{kind}Trajectory", planningProblem=str(found[problem].planning_problem_id))
    for i, step in enumerate(steps.tolist()):
        state = et.SubElement(trajectory, f"{kind}State")
        for key, values in states.items():
            et.SubElement(state, key).text = repr(float(values[i]))
        et.SubElement(state, "time").text = str(step)
    et.indent(root)
    write_text(path, '<?xml version="1.0" ?>\n' + et.tostring(root, encoding="unicode") + "\n")


def _states(plan: Plan, model: str, wheelbase: float) -> dict[str, Array]:
    """XML name → values (T,)."""
    curvature = columns(plan)["curvature"]
    x, y, heading = plan.poses.T
    if model == "PM":
        along, across = plan.speeds * np.cos(heading), plan.speeds * np.sin(heading)
        return {"x": x, "y": y, "xVelocity": along, "yVelocity": across}
    # the steering angle is a state there: at a time between two curvatures, their middle
    curvature = np.append(curvature[:-1], curvature[-2:-1])
    middle = 0.5 * (np.append(curvature[:1], curvature)[:-1] + curvature)
    angle = np.arctan(wheelbase * middle)
    return {"x": x, "y": y, "steeringAngle": angle, "velocity": plan.speeds, "orientation": heading}


def _time_steps(times: Array, dt: float) -> Array:
    steps = np.round(times / dt)
    off = np.flatnonzero(np.abs(times - steps * dt) > 1e-6)
    if len(off) or (np.diff(steps) != 1).any():
        bad = int(off[0]) if len(off) else int(np.flatnonzero(np.diff(steps) != 1)[0]) + 1
        raise InputError(f"plan.times[{bad}]: expected every step of {dt:g} s, got {times[bad]:g} s")
    return steps.astype(int)
