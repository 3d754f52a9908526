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
    "Roadmap": "riskplan.ompl.roadmap",
    "Prm": "riskplan.ompl.prm",
    "Rrt": "riskplan.ompl.rrt",
}

__all__ = [*sorted(_PUBLIC), "ompl"]  # noqa: PLE0604  names are given by `__getattr__`
__version__ = "0.1.0"

if TYPE_CHECKING:
    from checkers import Checker as Checker
    from checkers import CheckerInfo as CheckerInfo
    from checkers import EgoCover as EgoCover
    from checkers import EgoEllipsoid as EgoEllipsoid
    from checkers import EgoShape as EgoShape
    from checkers import GaussianMixturePrediction as GaussianMixturePrediction
    from checkers import InputError as InputError
    from checkers import Kind as Kind
    from checkers import MomentPrediction as MomentPrediction
    from checkers import Prediction as Prediction
    from checkers import Risk as Risk
    from checkers import TrajectoryRisk as TrajectoryRisk
    from checkers import checker as checker
    from checkers import checkers as checkers
    from checkers import load_prediction as load_prediction
    from checkers import trajectory_risk as trajectory_risk
    from predictor import ConstantVelocity as ConstantVelocity
    from predictor import Track as Track
    from riskplan import ompl as ompl
    from riskplan.io import load_plan as load_plan
    from riskplan.io import load_scenario as load_scenario
    from riskplan.io import save_plan as save_plan
    from riskplan.io import save_scenario as save_scenario
    from riskplan.ompl.prm import Prm as Prm
    from riskplan.ompl.roadmap import Roadmap as Roadmap
    from riskplan.ompl.rrt import Rrt as Rrt
    from riskplan.pictures import render as render
    from riskplan.planning import PlannerInfo as PlannerInfo
    from riskplan.planning import make_planner as make_planner
    from riskplan.planning import plan as plan
    from riskplan.planning import planners as planners
    from riskplan.report import audit as audit
    from riskplan.result import CheckerVerdict as CheckerVerdict
    from riskplan.result import Plan as Plan
    from riskplan.result import Report as Report
    from riskplan.result import SampledRisk as SampledRisk
    from riskplan.scene import Goal as Goal
    from riskplan.scene import GoalRegion as GoalRegion
    from riskplan.scene import KinematicCar as KinematicCar
    from riskplan.scene import Scenario as Scenario
    from riskplan.scene import State as State


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
