"""Plans as CommonRoad solutions: the XML that commonroad-io reads and the CommonRoad server scores.

A plan's car is a point moving along its heading within limits of acceleration and curvature: CommonRoad's point mass
PM. A plan of a `KinematicBicycle` with the axles of the vehicle type (`AXLES`) and a rate of steering of at most
0.4 rad/s is one of CommonRoad's kinematic single-track model KS. Positions are the body's centre in both; the speed of
KS is the rear axle's.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as et

import numpy as np

from checkers import InputError
from checkers.validate import Array, as_count, as_instance, as_option
from riskplan.io.text import write_text
from riskplan.io.trajectory import columns
from riskplan.result import Plan

MODELS = ("KS", "PM")
COST_FUNCTIONS = ("JB1", "SA1", "WX1", "SM1", "SM2", "SM3", "MW1", "TR1", "TR2")
PM_COST_FUNCTIONS = ("JB1", "WX1", "MW1")
STANDING = 1e-9  # [m/s]
# a, b [m] from the centre to the front and the rear axle of Ford Escort, BMW 320i, VW Vanagon
# (Althoff & Würsching 2020, table 6)
AXLES = {1: (0.88392, 1.50876), 2: (1.1561957064, 1.4227170936), 3: (1.1507916024, 1.3211363976)}


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
        vehicle_model: "PM", or "KS" for a plan of a `KinematicBicycle`: a `KinematicCar` knows no rate of steering, and
            its plans mostly fail there.
        vehicle_type: 1 Ford Escort, 2 BMW 320i, 3 VW Vanagon: the body the solution is judged with. Plan with its size.
        cost_function: of CommonRoad, by which the server ranks.

    Raises:
        InputError: for a plan without a trajectory or off the file's time grid, unknown names, an unreadable scenario.
    """
    as_option("vehicle_model", vehicle_model, MODELS)
    as_option("cost_function", cost_function, PM_COST_FUNCTIONS if vehicle_model == "PM" else COST_FUNCTIONS)
    as_instance("plan", plan, Plan)
    as_count("problem", problem)
    if isinstance(vehicle_type, bool) or not isinstance(vehicle_type, int) or vehicle_type not in AXLES:
        raise InputError(f"vehicle_type: expected one of {', '.join(map(str, AXLES))}; got {vehicle_type!r}")
    from predictor.io_commonroad import open_commonroad  # noqa: PLC0415  an extra

    scenario, problems = open_commonroad(commonroad)
    found = list(problems.planning_problem_dict.values())
    if not 0 <= problem < len(found):
        raise InputError(f"problem: expected 0 to {len(found) - 1}, got {problem!r}")
    first = int(found[problem].initial_state.time_step)
    states = _states(plan, vehicle_model, AXLES[vehicle_type])
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


def _states(plan: Plan, model: str, axles: tuple[float, float]) -> dict[str, Array]:
    """XML name → values (T,)."""
    curvature = columns(plan)["curvature"]
    x, y, heading = plan.poses.T
    if model == "PM":
        # CommonRoad turns the body of a point mass into the direction of its velocity, so a car that stands keeps some
        speeds = np.where(plan.speeds == 0.0, STANDING, plan.speeds)
        along, across = speeds * np.cos(heading), speeds * np.sin(heading)
        return {"x": x, "y": y, "xVelocity": along, "yVelocity": across}
    wheelbase, speeds = sum(axles), plan.speeds
    if plan.steering.any():
        angle = plan.steering
        speeds = speeds * np.cos(np.arctan(axles[1] / wheelbase * np.tan(angle)))  # of the rear axle
    else:  # a car without wheels that turn: at a time between two curvatures, their middle
        curvature = np.append(curvature[:-1], curvature[-2:-1])
        middle = 0.5 * (np.append(curvature[:1], curvature)[:-1] + curvature)
        angle = np.arctan(wheelbase * middle)
    return {"x": x, "y": y, "steeringAngle": angle, "velocity": speeds, "orientation": heading}


def _time_steps(times: Array, dt: float) -> Array:
    steps = np.round(times / dt)
    off = np.flatnonzero(np.abs(times - steps * dt) > 1e-6)
    if len(off) or (np.diff(steps) != 1).any():
        bad = int(off[0]) if len(off) else int(np.flatnonzero(np.diff(steps) != 1)[0]) + 1
        raise InputError(f"plan.times[{bad}]: expected every step of {dt:g} s, got {times[bad]:g} s")
    return steps.astype(int)
