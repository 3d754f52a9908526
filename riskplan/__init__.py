"""Motion planning under a stated bound on collision risk; `import riskplan as rp` reaches everything public.

Heavy parts (numba, OMPL, meshcat, torch) are imported on first use.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

# public name -> module that has it; the value types are cheap, the rest is imported when first asked for
_PUBLIC = {
    **dict.fromkeys(
        (
            "Checker",
            "CheckerInfo",
            "EgoCover",
            "EgoEllipsoid",
            "EgoShape",
            "GaussianMixturePrediction",
            "InputError",
            "Kind",
            "MomentPrediction",
            "Prediction",
            "Risk",
            "TrajectoryRisk",
            "checker",
            "checkers",
            "load_prediction",
            "trajectory_risk",
        ),
        "checkers",
    ),
    **dict.fromkeys(("ConstantVelocity", "Track"), "predictor"),
    **dict.fromkeys(("Goal", "GoalRegion", "KinematicCar", "Scenario", "State"), "riskplan.scene"),
    **dict.fromkeys(("CheckerVerdict", "Plan", "Report", "SampledRisk"), "riskplan.result"),
    **dict.fromkeys(("PlannerInfo", "make_planner", "plan", "planners"), "riskplan.planning"),
    **dict.fromkeys(("load_plan", "load_scenario", "save_plan", "save_scenario"), "riskplan.io"),
    "audit": "riskplan.report",
    "render": "riskplan.pictures",
    "Roadmap": "riskplan.ompl.prm",
    "Prm": "riskplan.ompl.prm",
    "Rrt": "riskplan.ompl.rrt",
}

__all__ = [*sorted(_PUBLIC), "ompl"]  # noqa: PLE0604  names are given by `__getattr__`
__version__ = "0.1.0"

if TYPE_CHECKING:
    from checkers import Checker, CheckerInfo, EgoCover, EgoEllipsoid, EgoShape, GaussianMixturePrediction, InputError
    from checkers import Kind, MomentPrediction, Prediction, Risk, TrajectoryRisk
    from checkers import checker, checkers, load_prediction, trajectory_risk
    from predictor import ConstantVelocity, Track
    from riskplan import ompl
    from riskplan.io import load_plan, load_scenario, save_plan, save_scenario
    from riskplan.ompl.prm import Prm, Roadmap
    from riskplan.ompl.rrt import Rrt
    from riskplan.pictures import render
    from riskplan.planning import PlannerInfo, make_planner, plan, planners
    from riskplan.report import audit
    from riskplan.result import CheckerVerdict, Plan, Report, SampledRisk
    from riskplan.scene import Goal, GoalRegion, KinematicCar, Scenario, State


def __getattr__(name: str) -> Any:
    if name == "ompl":
        return import_module("riskplan.ompl")
    if name not in _PUBLIC:
        raise AttributeError(f"module 'riskplan' has no attribute {name!r}")
    value = getattr(import_module(_PUBLIC[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
