"""The two OMPL classes in a user's own SpaceInformation. OMPL may hang or abort, so each case runs in a subprocess."""

import subprocess
import sys
import textwrap

import numpy as np
import pytest

import riskplan as rp
from tests.scenes import overtake

PRELUDE = """
import numpy as np
import itertools
from ompl import base as ob, geometric as og, util as ou
import riskplan as rp
from tests.scenes import overtake
ou.RNG.setSeed(1)  # a tree whose time only grows can starve: unlucky seeds find nothing in a minute
scene = overtake()
checker = rp.checker("exact")
"""


def run(code, timeout=150):
    done = subprocess.run(
        [sys.executable, "-c", PRELUDE + textwrap.dedent(code)],
        capture_output=True,
        text=True,
        timeout=timeout,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


PLAN = """
    {space}
    si = ob.SpaceInformation(space)
    svc = rp.ompl.RiskStateValidityChecker(si, scene.agents, scene.ego, checker, step_bound={bound})
    mv = rp.ompl.RiskMotionValidator(si, scene.agents, scene.ego, checker, step_bound={bound})
    si.setStateValidityChecker(svc)
    si.setMotionValidator(mv)
    si.setup()
    pdef = ob.ProblemDefinition(si)
    start, goal = si.allocState(), si.allocState()
    {write}
    put(start, 0.0, 3.5, 0.0)
    put(goal, 100.0, 3.5, 6.0)
    pdef.setStartAndGoalStates(start, goal, 4.0)
    planner = og.RRT(si)
    planner.setRange(12.0)
    planner.setProblemDefinition(pdef)
    planner.setup()
    asked = itertools.count()
    planner.solve(ob.PlannerTerminationCondition(lambda: next(asked) > 20_000))
    assert pdef.hasExactSolution()
    path = pdef.getSolutionPath()
    for s in path.getStates():
        {read}
        print(float(x), float(y), float(heading), float(t))
"""
VECTOR = {
    "space": """space = ob.RealVectorStateSpace(4)
    b = ob.RealVectorBounds(4)
    for i, (lo, hi) in enumerate([(-10, 120), (-1.75, 8.75), (-0.05, 0.05), (0, 6)]):
        b.setLow(i, float(lo)); b.setHigh(i, float(hi))
    space.setBounds(b)""",
    "write": """def put(s, x, y, t):
        s[0], s[1], s[2], s[3] = x, y, 0.0, t""",
    "read": "x, y, heading, t = s[0], s[1], s[2], s[3]",
}
COMPOUND = {
    "space": """place, time = ob.SE2StateSpace(), ob.RealVectorStateSpace(1)
    b = ob.RealVectorBounds(2)
    b.setLow(0, -10.0); b.setHigh(0, 120.0); b.setLow(1, -1.75); b.setHigh(1, 8.75)
    place.setBounds(b)
    tb = ob.RealVectorBounds(1); tb.setLow(0.0); tb.setHigh(6.0)
    time.setBounds(tb)
    space = ob.CompoundStateSpace()
    space.addSubspace(place, 1.0); space.addSubspace(time, 10.0)""",
    "write": """def put(s, x, y, t):
        s[0].setX(x); s[0].setY(y); s[0].setYaw(0.0); s[1][0] = t""",
    "read": "x, y, heading, t = s[0].getX(), s[0].getY(), s[0].getYaw(), s[1][0]",
}


@pytest.mark.parametrize("parts", [VECTOR, COMPOUND], ids=["vector", "se2-time"])
def test_plain_rrt_keeps_the_step_bound(parts):
    bound = 0.05
    out = run(PLAN.format(bound=bound, **parts))
    states = np.array(
        [[float(v) for v in line.split()] for line in out.split("\n") if line and line[0] in "-0123456789"]
    )
    scene = overtake()
    assert (np.diff(states[:, 3]) > 0).all()
    # judged by the public primitives on the grid, along the same straight lines
    times = scene.times[scene.times <= states[-1, 3]]
    poses = np.column_stack([np.interp(times, states[:, 3], states[:, i]) for i in range(2)] + [np.zeros(len(times))])
    turn = np.unwrap(states[:, 2])
    poses[:, 2] = np.interp(times, states[:, 3], turn)
    risks = [rp.checker("exact")(poses, a.at(times), scene.ego) for a in scene.agents]
    risk = rp.trajectory_risk(risks, [a.at(times) for a in scene.agents])
    assert risk.per_step.max() <= bound * 1.001
    # without agents the straight way would have been taken: the bound did something
    straight = np.column_stack([np.linspace(0, 100, 61), np.full(61, 3.5), np.zeros(61)])
    risks = [rp.checker("exact")(straight, a, scene.ego) for a in scene.agents]
    assert rp.trajectory_risk(risks, scene.agents).per_step.max() > bound


def test_validity_is_the_marginal_risk_at_the_state():
    out = run("""
    space = ob.RealVectorStateSpace(4)
    b = ob.RealVectorBounds(4); b.setLow(-1000.0); b.setHigh(1000.0); space.setBounds(b)
    si = ob.SpaceInformation(space); si.setup()
    s = si.allocState()
    for bound in (1e-6, 1e-3, 0.5):
        svc = rp.ompl.RiskStateValidityChecker(si, scene.agents, scene.ego, checker, step_bound=bound)
        for x in np.linspace(0, 60, 13):
            s[0], s[1], s[2], s[3] = float(x), 3.5, 0.0, 2.0
            agents = [a.at(np.array([2.0])) for a in scene.agents]
            pose = np.array([[x, 3.5, 0.0]])
            risks = [checker(pose, a, scene.ego) for a in agents]
            total = float(sum(rp.trajectory_risk([r], [a]).per_step[0] for r, a in zip(risks, agents)))
            assert type(svc.isValid(s)) is bool
            if abs(total / bound - 1) > 0.01:
                assert svc.isValid(s) == (total <= bound), (x, bound, total)
        s[3] = 6.5
        assert svc.isValid(s) is False  # beyond the predictions nothing is known
        s[3] = -0.5
        assert svc.isValid(s) is False
    print("done")
    """)
    assert "done" in out


def test_motion_goes_forward_in_time_and_looks_between_its_ends():
    out = run("""
    space = ob.RealVectorStateSpace(4)
    b = ob.RealVectorBounds(4); b.setLow(-1000.0); b.setHigh(1000.0); space.setBounds(b)
    si = ob.SpaceInformation(space); si.setup()
    mv = rp.ompl.RiskMotionValidator(si, scene.agents, scene.ego, checker, step_bound=0.01)
    a, c = si.allocState(), si.allocState()
    def put(s, x, y, t):
        s[0], s[1], s[2], s[3] = x, y, 0.0, t
    put(a, 0.0, 3.5, 0.0); put(c, 10.0, 3.5, 1.0)
    print(mv.checkMotion(a, c), mv.checkMotion(c, a), mv.checkMotion(a, a))
    # through the slow car: both ends free, the middle not
    put(a, 10.0, 3.5, 1.0); put(c, 85.0, 3.5, 3.0)
    svc = rp.ompl.RiskStateValidityChecker(si, scene.agents, scene.ego, checker, step_bound=0.01)
    print(svc.isValid(a), svc.isValid(c), mv.checkMotion(a, c))
    """)
    assert out.split() == ["True", "False", "False", "True", "True", "False"]


def test_unknown_space_and_bad_bound_are_refused():
    out = run("""
    space = ob.SO2StateSpace()
    si = ob.SpaceInformation(space)
    for make in (
        lambda: rp.ompl.RiskMotionValidator(si, scene.agents, scene.ego, checker, step_bound=0.1),
        lambda: rp.ompl.RiskStateValidityChecker(si, scene.agents, scene.ego, checker, step_bound=0.1),
        lambda: rp.ompl.RiskStateValidityChecker(si, scene.agents, scene.ego, checker, step_bound=1.5),
    ):
        try:
            make()
        except rp.InputError as error:
            print(str(error).split(":")[0])
    """)
    assert out.split() == ["pose_time", "pose_time", "step_bound"]


def test_many_plans_in_one_process_do_not_pile_up():
    out = run(
        """
        import resource
        def used():
            return int(open("/proc/self/statm").read().split()[1]) * 4096 / 1e6
        rp.plan(scene, planner="rrt", bound=0.1, time_limit=5.0, seed=0)
        sizes = []
        for i in range(60):
            rp.plan(scene, planner="rrt", bound=0.1, time_limit=5.0, seed=i)
            sizes.append(used())
        print(sizes[19], sizes[-1])
        """,
        timeout=120,
    )
    early, late = map(float, out.split())
    assert late - early < 40.0  # MB over 40 plans
