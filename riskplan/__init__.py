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
            "EgoBox",
            "EgoCover",
            "EgoEllipsoid",
            "EgoShape",
            "GaussianMixturePrediction",
            "InputError",
            "Kind",
            "MomentPrediction",
            "PathRisk",
            "Prediction",
            "Risk",
            "TrajectoryRisk",
            "checker",
            "checkers",
            "fit_factors",
            "as_gaussian",
            "covariance_over_time",
            "hunter_bound",
            "leading_factors",
            "load_prediction",
            "merged",
            "path_risk",
            "persistent",
            "trajectory_risk",
            "trajectory_risk_gradient",
            "Beta",
            "Constant",
            "ControlPrediction",
            "Discrete",
            "Exponential",
            "Gamma",
            "JointNormal",
            "Mixture",
            "Normal",
            "RandomVariable",
            "Triangular",
            "Uniform",
            "as_random_variable",
            "dynamics",
            "propagate",
            "trigonometric_moment",
            "with_factors",
        ),
        "checkers",
    ),
    **dict.fromkeys(
        (
            "ConstantVelocity",
            "LearnedPredictor",
            "Manoeuvres",
            "Frames",
            "PowerGrowth",
            "Recording",
            "Track",
            "from_gmm2d",
            "from_mode_gaussians",
            "from_trajectories",
            "open_data",
        ),
        "predictor",
    ),
    **dict.fromkeys(("Windows", "split", "windows"), "predictor.windows"),
    "record": "predictor.recorder",
    "save_recordings": "predictor.datasets.simulator",
    **dict.fromkeys(("Goal", "GoalRegion", "Scenario", "State"), "riskplan.scene"),
    **dict.fromkeys(("CheckerVerdict", "Plan", "Report", "SampledRisk"), "riskplan.result"),
    **dict.fromkeys(("PlannerInfo", "make_planner", "plan", "planners"), "riskplan.planning"),
    **dict.fromkeys(("load_occupancy_grid", "load_plan", "load_scenario", "save_plan", "save_scenario"), "riskplan.io"),
    "OccupancyGrid": "riskplan.io.occupancy_grid",
    "KinematicBicycle": "riskplan.vehicles.kinematic_bicycle",
    "KinematicCar": "riskplan.vehicles.kinematic_car",
    "PointRobot": "riskplan.vehicles.point_robot",
    "ReedsSheppCar": "riskplan.vehicles.reeds_shepp_car",
    "Vehicle": "riskplan.vehicles",
    **dict.fromkeys(("Collision", "Cycle", "Simulation"), "riskplan.closed_loop_result"),
    "Traffic": "riskplan.closed_loop_traffic",
    "simulate": "riskplan.closed_loop",
    **dict.fromkeys(("Inflated", "inflated"), "riskplan.between_steps"),
    "load_commonroad": "riskplan.io.commonroad",
    "load_predictions": "riskplan.io.predictions",
    "save_solution": "riskplan.io.solution",
    "save_trajectory": "riskplan.io.trajectory",
    "audit": "riskplan.report",
    **dict.fromkeys(("BatchSummary", "batch"), "riskplan.batching"),
    **dict.fromkeys(("draw", "render"), "riskplan.pictures"),
    **dict.fromkeys(("RiskMap", "risk_map"), "riskplan.pictures.risk_map"),
    "Roadmap": "riskplan.ompl.roadmap",
    "Prm": "riskplan.ompl.prm",
    "PrmLazy": "riskplan.ompl.prm_lazy",
    "Rrt": "riskplan.ompl.rrt",
    "RrtStar": "riskplan.ompl.rrt_star",
    "SweepPoint": "riskplan.pareto",
    "sweep": "riskplan.pareto",
}

_MODULES = {"ompl": "riskplan.ompl", "plots": "riskplan.pictures.plots"}

__all__ = [*sorted(_PUBLIC), *_MODULES]  # noqa: PLE0604  names are given by `__getattr__`
__version__ = "0.1.0"

if TYPE_CHECKING:
    from checkers import Checker as Checker
    from checkers import CheckerInfo as CheckerInfo
    from checkers import EgoBox as EgoBox
    from checkers import EgoCover as EgoCover
    from checkers import EgoEllipsoid as EgoEllipsoid
    from checkers import EgoShape as EgoShape
    from checkers import GaussianMixturePrediction as GaussianMixturePrediction
    from checkers import InputError as InputError
    from checkers import Kind as Kind
    from checkers import MomentPrediction as MomentPrediction
    from checkers import PathRisk as PathRisk
    from checkers import Prediction as Prediction
    from checkers import Risk as Risk
    from checkers import TrajectoryRisk as TrajectoryRisk
    from checkers import checker as checker
    from checkers import checkers as checkers
    from checkers import fit_factors as fit_factors
    from checkers import as_gaussian as as_gaussian
    from checkers import covariance_over_time as covariance_over_time
    from checkers import hunter_bound as hunter_bound
    from checkers import with_factors as with_factors
    from checkers import leading_factors as leading_factors
    from checkers import load_prediction as load_prediction
    from checkers import merged as merged
    from checkers import path_risk as path_risk
    from checkers import persistent as persistent
    from checkers import trajectory_risk as trajectory_risk
    from checkers import trajectory_risk_gradient as trajectory_risk_gradient
    from checkers import Beta as Beta
    from checkers import Constant as Constant
    from checkers import ControlPrediction as ControlPrediction
    from checkers import Discrete as Discrete
    from checkers import Exponential as Exponential
    from checkers import Gamma as Gamma
    from checkers import JointNormal as JointNormal
    from checkers import Mixture as Mixture
    from checkers import Normal as Normal
    from checkers import RandomVariable as RandomVariable
    from checkers import Triangular as Triangular
    from checkers import Uniform as Uniform
    from checkers import as_random_variable as as_random_variable
    from checkers import dynamics as dynamics
    from checkers import propagate as propagate
    from checkers import trigonometric_moment as trigonometric_moment
    from predictor import ConstantVelocity as ConstantVelocity
    from predictor import Frames as Frames
    from predictor import LearnedPredictor as LearnedPredictor
    from predictor import PowerGrowth as PowerGrowth
    from predictor import Recording as Recording
    from predictor import Manoeuvres as Manoeuvres
    from predictor import Track as Track
    from predictor import from_gmm2d as from_gmm2d
    from predictor import from_mode_gaussians as from_mode_gaussians
    from predictor import from_trajectories as from_trajectories
    from predictor import open_data as open_data
    from predictor.datasets.simulator import save_recordings as save_recordings
    from predictor.recorder import record as record
    from predictor.windows import Windows as Windows
    from predictor.windows import split as split
    from predictor.windows import windows as windows
    from riskplan import ompl as ompl
    from riskplan.batching import BatchSummary as BatchSummary
    from riskplan.batching import batch as batch
    from riskplan.between_steps import Inflated as Inflated
    from riskplan.between_steps import inflated as inflated
    from riskplan.io import load_occupancy_grid as load_occupancy_grid
    from riskplan.io import load_plan as load_plan
    from riskplan.io import load_scenario as load_scenario
    from riskplan.io import save_plan as save_plan
    from riskplan.io import save_scenario as save_scenario
    from riskplan.io.commonroad import load_commonroad as load_commonroad
    from riskplan.io.predictions import load_predictions as load_predictions
    from riskplan.io.solution import save_solution as save_solution
    from riskplan.io.trajectory import save_trajectory as save_trajectory
    from riskplan.io.occupancy_grid import OccupancyGrid as OccupancyGrid
    from riskplan.ompl.prm import Prm as Prm
    from riskplan.ompl.prm_lazy import PrmLazy as PrmLazy
    from riskplan.ompl.roadmap import Roadmap as Roadmap
    from riskplan.ompl.rrt import Rrt as Rrt
    from riskplan.pictures import draw as draw
    from riskplan.pictures import plots as plots
    from riskplan.ompl.rrt_star import RrtStar as RrtStar
    from riskplan.pictures import render as render
    from riskplan.pictures.risk_map import RiskMap as RiskMap
    from riskplan.pictures.risk_map import risk_map as risk_map
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
    from riskplan.scene import Scenario as Scenario
    from riskplan.scene import State as State
    from riskplan.closed_loop import simulate as simulate
    from riskplan.closed_loop_result import Collision as Collision
    from riskplan.closed_loop_result import Cycle as Cycle
    from riskplan.closed_loop_result import Simulation as Simulation
    from riskplan.closed_loop_traffic import Traffic as Traffic
    from riskplan.pareto import SweepPoint as SweepPoint
    from riskplan.pareto import sweep as sweep
    from riskplan.vehicles import Vehicle as Vehicle
    from riskplan.vehicles.kinematic_bicycle import KinematicBicycle as KinematicBicycle
    from riskplan.vehicles.kinematic_car import KinematicCar as KinematicCar
    from riskplan.vehicles.point_robot import PointRobot as PointRobot
    from riskplan.vehicles.reeds_shepp_car import ReedsSheppCar as ReedsSheppCar


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return import_module(_MODULES[name])
    if name not in _PUBLIC:
        raise AttributeError(f"module 'riskplan' has no attribute {name!r}")
    value = getattr(import_module(_PUBLIC[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
