"""Risk as a validity check in an OMPL set-up of your own: og.RRT over x, y, heading, time; risk bounded per step."""

import numpy as np
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

import riskplan as rp


def main() -> None:
    """Everything inside a function: OMPL's bindings complain at exit about objects kept as module globals."""
    ou.RNG.setSeed(1)  # og.RRT over time starves on unlucky seeds
    scenario = rp.load_scenario("riskplan/data/overtake.yaml")
    space = ob.RealVectorStateSpace(4)  # x, y [m], heading [rad], time [s]
    bounds = ob.RealVectorBounds(4)
    x0, y0, x1, y1 = scenario.bounds
    for i, (low, high) in enumerate([(x0, x1), (y0, y1), (-0.05, 0.05), (0.0, 6.0)]):
        bounds.setLow(i, low)
        bounds.setHigh(i, high)
    space.setBounds(bounds)
    si = ob.SpaceInformation(space)
    checks = (si, scenario.agents, scenario.ego, rp.checker("exact"))
    validity = rp.ompl.RiskStateValidityChecker(*checks, step_bound=0.02, static=scenario.world.free)
    si.setStateValidityChecker(validity)
    si.setMotionValidator(rp.ompl.RiskMotionValidator(*checks, step_bound=0.02, static=scenario.world.free))
    si.setup()
    problem = ob.ProblemDefinition(si)
    start, goal = si.allocState(), si.allocState()
    start[0], start[1], start[2], start[3] = scenario.start.x, scenario.start.y, 0.0, 0.0
    goal[0], goal[1], goal[2], goal[3] = scenario.start.x + 85.0, scenario.start.y, 0.0, 6.0
    problem.setStartAndGoalStates(start, goal, 8.0)
    planner = og.RRT(si)
    planner.setRange(12.0)
    planner.setProblemDefinition(problem)
    planner.setup()
    planner.solve(ob.timedPlannerTerminationCondition(60.0))
    print("exact solution:", problem.hasExactSolution())
    states = problem.getSolutionPath().getStates()
    risks = [validity.evaluator.at_time(np.array([s[0], s[1], s[2]]), s[3]) for s in states]
    print(f"largest risk of a state {max(risks):.4f}, bound 0.02: within {max(risks) <= 0.02}")
    for state in states:
        print(f"t = {state[3]:.2f} s: x = {state[0]:.1f} m, y = {state[1]:.2f} m")


if __name__ == "__main__":
    main()
