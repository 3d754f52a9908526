"""Every public callable at its boundary: whatever an argument is, it is taken or refused by an InputError."""

from __future__ import annotations

import argparse
import contextlib
import inspect
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from fuzz.trial import limits, tried
from PIL import Image
from scenes import overtake

import riskplan as rp
from riskplan.cli import main
from riskplan.commands import parser

# what no argument means: refused everywhere
NOTHING_KNOWN = object()
JUNK: dict[str, Any] = {
    "object": NOTHING_KNOWN,
    "text": "wrong",
    "None": None,
    "-1": -1,
    "-0.5": -0.5,
    "3": 3,
    "huge": 10**400,
    "1e308": 1e308,
    "1e-310": 1e-310,
    "nan": float("nan"),
    "inf": float("inf"),
    "1j": 1j,
    "True": True,
    "[]": [],
    "{}": {},
    "['a']": ["a"],
    "[None]": [None],
    "[[1], 2]": [[1], 2],
    "0-d": np.array(1.0),
    "complex": np.full((2, 2), 1j),
    "bytes": b"wrong",
    "class": int,
    "dates": np.array(["2026-01-01"], dtype="M8[s]"),
}
# what comes out of the library; its fields are not for callers to fill
RESULTS = {
    *("ConstantVelocity", "LearnedPredictor", "Manoeuvres", "Roadmap"),
    *("BatchSummary", "CheckerInfo", "CheckerVerdict", "Collision", "Cycle", "Inflated", "PathRisk", "Plan"),
    *("PlannerInfo", "Report", "RiskMap", "Simulation", "SampledRisk", "SweepPoint", "TrajectoryRisk", "Risk"),
}
# types to subclass or to compare with, and names without arguments
NO_CALLS = {
    *("Checker", "EgoShape", "InputError", "Kind", "Prediction", "RandomVariable", "Vehicle", "checkers", "planners"),
    *("dynamics", "ompl", "plots"),
}
SECONDS = 10.0  # of one call, on the processor


def arrays() -> dict[str, Any]:
    t = 0.1 * np.arange(1, 6)
    means = np.stack([10 + 5 * t, 0 * t], axis=-1)[:, None]
    covariances = np.broadcast_to(np.diag([0.3, 0.2]), (5, 1, 2, 2)).copy()
    return {"times": t, "weights": [1.0], "means": means, "covariances": covariances}


def gaussian(**more: Any) -> rp.GaussianMixturePrediction:
    return rp.GaussianMixturePrediction(**arrays(), length=4.5, width=1.8, headings=np.zeros((5, 1)), **more)


def track(name: str = "a", y: float = 0.0) -> rp.Track:
    t = 0.1 * np.arange(12.0)
    return rp.Track(name, t, np.column_stack([10 * t, 0 * t + y]), 0 * t, 0 * t + 10, 4.5, 1.8)


def recording() -> rp.Recording:
    return rp.Recording("r", 0.1, (track(), track("b", 4.0)))


def samples() -> rp.Windows:
    return rp.windows([recording(), rp.Recording("s", 0.1, (track(), track("b", 4.0)))], past=4, future=4, every=2)


@pytest.fixture(scope="module")
def calls(tmp_path_factory) -> dict[str, tuple[Callable[..., Any], dict[str, Any]]]:
    """Name -> a callable and arguments that it takes, all of them by name."""
    folder = tmp_path_factory.mktemp("boundary")
    scenario = overtake()
    plan = rp.plan(scenario, bound=0.1, time_limit=20.0, seed=1)
    assert plan.solved
    rp.save_plan(plan, folder / "plan.json")
    rp.save_scenario(scenario, folder / "scene.yaml")
    agent, ego = gaussian(), rp.EgoEllipsoid.around(4.5, 1.8)
    agent.save(folder / "agent.npz")
    (folder / "tracks.txt").write_text("0 1 0 0\n10 1 1 0\n")
    Image.fromarray(np.full((3, 3), 254, dtype=np.uint8)).save(folder / "map.png")
    (folder / "map.yaml").write_text(
        "image: map.png\nresolution: 0.5\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n"
    )
    system = rp.dynamics.dubins(0.1)
    where = {"x": 25.0, "y": 0.0, "v": 9.0, "theta": 0.0}
    noise = {"w_v": rp.Normal(0.0, 0.05), "w_theta": rp.Normal(0.0, 0.005)}
    driven = rp.ControlPrediction(system, where, [noise], steps=3)
    moments = agent.moments(4)
    poses = np.zeros((5, 3))
    backend = rp.checker("exact")
    risk = backend(poses, agent, ego)
    paths = np.cumsum(np.full((2, 5, 2), 0.5), axis=1)
    growth = {"along": (0.3, 0.8, 1.2), "across": (0.3, 0.3, 1.0)}
    planning = {
        "planner": "rrt",
        "checker": "exact",
        "dependence": "independent",
        "time_limit": 0.01,
        "seed": 0,
        "stop": None,
    }
    region = {"polygon": [[0, 0], [1, 0], [1, 1]], "heading": 0.0, "heading_tolerance": 0.5, "speed": (0.0, 9.0)}
    made: dict[str, tuple[Callable[..., Any], dict[str, Any]]] = {
        "Beta": (rp.Beta, {"a": 2.0, "b": 3.0, "low": 0.0, "high": 1.0}),
        "Constant": (rp.Constant, {"value": 1.0}),
        "Discrete": (rp.Discrete, {"values": [0.0, 1.0], "weights": [0.5, 0.5]}),
        "Exponential": (rp.Exponential, {"scale": 1.0, "shift": 0.0}),
        "Gamma": (rp.Gamma, {"shape": 1.0, "scale": 1.0, "shift": 0.0}),
        "JointNormal": (rp.JointNormal, {"mean": [0.0, 1.0], "covariance": np.eye(2)}),
        "Mixture": (rp.Mixture, {"weights": [0.5, 0.5], "components": (rp.Normal(0, 1), rp.Normal(1, 1))}),
        "Normal": (rp.Normal, {"mu": 0.0, "sd": 1.0}),
        "Triangular": (rp.Triangular, {"low": 0.0, "mode": 0.5, "high": 1.0}),
        "Uniform": (rp.Uniform, {"low": 0.0, "high": 1.0}),
        "GaussianMixturePrediction": (
            rp.GaussianMixturePrediction,
            {**arrays(), "modes": "persistent", "name": "a", "length": 4.5, "width": 1.8, "headings": np.zeros((5, 1)),
             "factors": np.full((5, 1, 2, 1), 0.1)},
        ),
        "MomentPrediction": (
            rp.MomentPrediction,
            {"times": moments.times, "weights": [1.0], "means": moments.means,
             "central_moments": moments.central_moments, "modes": "persistent", "name": "a", "length": 4.5,
             "width": 1.8, "headings": None, "factors": None},
        ),
        "ControlPrediction": (
            rp.ControlPrediction,
            {"system": system, "initial": where, "controls": [noise], "steps": 3, "weights": [1.0],
             "modes": "persistent", "times": None, "name": "a", "length": 4.5, "width": 1.8},
        ),
        "EgoBox": (rp.EgoBox, {"length": 4.5, "width": 1.8}),
        "EgoCover": (rp.EgoCover, {"length": 4.5, "width": 1.8, "n": 3, "agent_length": 4.0, "agent_width": 1.8,
                                   "relative_heading": 0.0}),
        "EgoCover.discs": (rp.EgoCover.discs, {"length": 4.5, "width": 1.8, "n": 3}),
        "EgoEllipsoid": (rp.EgoEllipsoid, {"Q": np.eye(2)}),
        "EgoEllipsoid.around": (rp.EgoEllipsoid.around, {"length": 4.5, "width": 1.8, "agent_length": 4.0,
                                                         "agent_width": 1.8, "relative_heading": 0.0}),
        "Frames": (rp.Frames, {"origins": [[0.0, 0.0]], "angles": [0.0], "scale": 1.0}),
        "Goal": (rp.Goal, {"regions": (rp.GoalRegion(**region),), "time": (0.0, 3.0)}),
        "Goal.at": (rp.Goal.at, {"x": 0.0, "y": 0.0, "radius": 1.0, "heading": 0.0, "heading_tolerance": 0.5}),
        "GoalRegion": (rp.GoalRegion, region),
        "State": (rp.State, {"x": 0.0, "y": 0.0, "heading": 0.0, "speed": 1.0, "steering": 0.0}),
        "Scenario": (rp.Scenario, {f: getattr(scenario, f) for f in scenario.__dataclass_fields__}),
        "Track": (rp.Track, {f: getattr(track(), f) for f in track().__dataclass_fields__}),
        "Traffic": (rp.Traffic, {"tracks": (track(),)}),
        "Recording": (
            rp.Recording,
            {"name": "r", "dt": 0.1, "tracks": (track(),), "lanes": (), "controls": {}, "focal": (), "ego": None,
             "group": "g"},
        ),
        "Windows": (rp.Windows, {f: getattr(samples(), f) for f in samples().__dataclass_fields__}),
        "Windows.load": (rp.Windows.load, {"path": folder / "windows.npz"}),
        "Windows.save": (samples().save, {"path": folder / "windows.npz"}),
        "OccupancyGrid": (
            rp.OccupancyGrid,
            {"blocked": np.eye(3, dtype=bool), "resolution": 0.5, "origin": (0.0, 0.0, 0.0), "closed": True},
        ),
        "PowerGrowth": (rp.PowerGrowth, growth),
        "PowerGrowth.fit": (
            rp.PowerGrowth.fit,
            {"times": arrays()["times"], "trajectories": paths[None], "probabilities": [[0.5, 0.5]],
             "truth": paths[:1]},
        ),
        "KinematicBicycle": (rp.KinematicBicycle, _defaults(rp.KinematicBicycle)),
        "KinematicCar": (rp.KinematicCar, _defaults(rp.KinematicCar)),
        "PointRobot": (rp.PointRobot, _defaults(rp.PointRobot)),
        "ReedsSheppCar": (rp.ReedsSheppCar, _defaults(rp.ReedsSheppCar)),
        "Prm": (rp.Prm, {"size": 50, "roadmap": None}),
        "PrmLazy": (rp.PrmLazy, {"size": 50, "roadmap": None}),
        "Rrt": (rp.Rrt, _defaults(rp.Rrt)),
        "RrtStar": (rp.RrtStar, _defaults(rp.RrtStar)),
        "Roadmap.load": (rp.Roadmap.load, {"path": folder / "none.npz"}),
        "ConstantVelocity.predict": (
            rp.ConstantVelocity.fitted().predict, {"past": track(), "times": [1.1, 1.2]}
        ),
        "Manoeuvres.predict": (
            rp.Manoeuvres.fitted().predict, {"past": track(), "times": [1.1, 1.2], "lanes": (), "others": ()}
        ),
        "as_gaussian": (rp.as_gaussian, {"pred": moments}),
        "as_random_variable": (rp.as_random_variable, {"value": 1.0, "name": "x"}),
        "audit": (
            rp.audit, {"plan": plan, "scenario": scenario, "checkers": ["exact"], "monte_carlo": 100, "seed": 0}
        ),
        "checker": (rp.checker, {"name": "sos", "order": 4, "solver": "clarabel"}),
        "checker call": (
            lambda poses, pred, ego: backend(poses, pred, ego), {"poses": poses, "pred": agent, "ego": ego}
        ),
        "covariance_over_time": (rp.covariance_over_time, {"pred": driven}),
        "draw": (rp.draw, {"vis": None, "scenario": scenario, "plan": plan, "samples": 0, "density": 0, "seed": 0}),
        "fit_factors": (rp.fit_factors, {"residuals": np.random.default_rng(0).normal(size=(20, 5, 2)), "rank": 2}),
        "from_gmm2d": (
            rp.from_gmm2d,
            {"log_pis": [0.0], "mus": arrays()["means"], "log_sigmas": np.zeros((5, 1, 2)), "corrs": np.zeros((5, 1)),
             "times": arrays()["times"], "modes": "persistent", "frame": None, "name": "a", "length": 4.5, "width": 1.8,
             "headings": np.zeros((5, 1))},
        ),
        "from_mode_gaussians": (
            rp.from_mode_gaussians,
            {"probabilities": [0.5, 0.5], "trajectories": np.concatenate([paths, 0 * paths, 0 * paths[..., :1]], -1),
             "times": arrays()["times"], "spread": "log_sigma", "log_sigma_range": (-1.6, 5.0), "largest_corr": 0.5,
             "normalise": False, "frame": None},
        ),
        "from_trajectories": (
            rp.from_trajectories,
            {"probabilities": [0.5, 0.5], "trajectories": paths, "times": arrays()["times"],
             "growth": rp.PowerGrowth(**growth), "normalise": False, "frame": None},
        ),
        "hunter_bound": (rp.hunter_bound, {"poses": np.zeros((4, 3)), "pred": driven, "ego": ego}),
        "inflated": (rp.inflated, {"scenario": scenario, "bound": 0.01}),
        "leading_factors": (rp.leading_factors, {"covariance": rp.covariance_over_time(driven), "rank": 1}),
        "load_occupancy_grid": (rp.load_occupancy_grid, {"path": folder / "map.yaml", "unknown": "free"}),
        "load_plan": (rp.load_plan, {"path": folder / "plan.json"}),
        "load_prediction": (rp.load_prediction, {"path": folder / "agent.npz"}),
        "load_predictions": (
            rp.load_predictions,
            {"path": folder / "agent.npz", "format": "npz", "growth": None, "scene": None, "normalise": False},
        ),
        "load_commonroad": (rp.load_commonroad, {"path": folder / "scene.xml"}),
        "load_scenario": (rp.load_scenario, {"path": folder / "scene.yaml", "problem": 0}),
        "make_planner": (rp.make_planner, {"name": "rrt", "motion_steps": 15, "goal_bias": 0.2}),
        "merged": (rp.merged, {"pred": agent, "order": 4}),
        "open_data": (rp.open_data, {"path": folder / "tracks.txt", "kind": "eth-ucy", "on_bad": None}),
        "path_risk": (
            rp.path_risk,
            {"poses": poses, "predictions": [agent], "ego": ego, "dependence": "independent", "tolerance": 1e-6,
             "seed": 0},
        ),
        "persistent": (rp.persistent, {"pred": agent}),
        "plan": (
            rp.plan,
            {"scenario": scenario, **planning, "bound": 0.1, "between_steps": "grid", "step_bound": None,
             "agent_bound": None, "iterations": 10, "workers": 1, "goal_bias": 0.2},
        ),
        "sweep": (rp.sweep, {"scenario": scenario, "bounds": [0.1], **planning, "iterations": 10}),
        "propagate": (
            rp.propagate,
            {"system": system, "initial": where, "controls": noise, "steps": 3, "order": 4, "weights": None},
        ),
        "render": (
            rp.render,
            {"scenario": scenario, "plan": plan, "path": folder / "a.png", "view": "top", "title": "t",
             "size": (200, 100), "time": 0.0, "follow": True, "samples": 0, "density": 0, "seed": 0},
        ),
        "risk_map": (
            rp.risk_map,
            {"scenario": scenario, "time": 1.0, "backend": "exact", "heading": 0.0, "spacing": 5.0,
             "window": (0.0, 0.0, 20.0, 10.0)},
        ),
        "save_plan": (rp.save_plan, {"plan": plan, "path": folder / "b.json"}),
        "save_recordings": (rp.save_recordings, {"recordings": [recording()], "path": folder / "r.npz"}),
        "save_scenario": (rp.save_scenario, {"scenario": scenario, "path": folder / "b.yaml"}),
        "save_solution": (
            rp.save_solution,
            {"plan": plan, "path": folder / "s.xml", "commonroad": folder / "none.xml", "problem": 0,
             "vehicle_model": "PM", "vehicle_type": 2, "cost_function": "JB1"},
        ),
        "save_trajectory": (
            rp.save_trajectory, {"plan": plan, "path": folder / "t.csv", "format": "csv", "frame": "map"}
        ),
        "simulate": (
            rp.simulate,
            {"scenario": scenario, "traffic": [track("other", 40.0)], "planner": "rrt", "checker": "exact",
             "bound": 0.1, "dependence": "independent", "steps": 2, "replan": 0.1, "time_limit": 0.01, "seed": 0},
        ),
        "split": (rp.split, {"samples": samples(), "fractions": (0.5, 0.5), "seed": 0}),
        "trajectory_risk": (
            rp.trajectory_risk, {"risks": [risk], "predictions": [agent], "dependence": "independent"}
        ),
        "trajectory_risk_gradient": (
            rp.trajectory_risk_gradient,
            {"risks": [risk], "gradients": [np.zeros((5, 1, 3))], "predictions": [agent], "dependence": "independent"},
        ),
        "trigonometric_moment": (rp.trigonometric_moment, {"x": rp.Normal(0, 1), "m": 1, "n": 1}),
        "windows": (
            rp.windows,
            {"recordings": [recording()], "past": 4, "future": 4, "dt": 0.1, "every": 2, "least": 1, "lane_points": 4,
             "focal": False, "rng": 0},
        ),
        "with_factors": (rp.with_factors, {"pred": driven, "rank": 1, "order": 2}),
        "batch": (
            rp.batch,
            {"source": folder / "empty", "out": folder / "out", "score": None, "planner": "rrt", "checker": "exact",
             "bound": 0.1, "dependence": "independent", "time_limit": 0.01, "seed": 0, "limit": 5.0, "workers": 1,
             "client": None, "shard_rows": 1, "keep_plans": None, "progress": None},
        ),
        "record": (rp.record, {"samples": 1, "seed": 0, "maps": ("highway",)}),
        "pred.at": (agent.at, {"times": [0.1]}),
        "pred.moments": (agent.moments, {"order": 4}),
        "pred.sample": (agent.sample, {"n": 3, "rng": np.random.default_rng(0)}),
        "pred.save": (agent.save, {"path": folder / "c.npz"}),
        "driven.at": (driven.at, {"times": [0.1]}),
        "driven.moments": (driven.moments, {"order": 4}),
        "driven.sample": (driven.sample, {"n": 3, "rng": np.random.default_rng(0)}),
        "moments.at": (moments.at, {"times": [0.1]}),
        "dynamics.dubins": (rp.dynamics.dubins, {"dt": 0.1}),
    }  # fmt: skip
    return made


def _defaults(kind: type[Any]) -> dict[str, Any]:
    return {name: p.default for name, p in inspect.signature(kind).parameters.items()}


NAMES = sorted(set(rp.__all__) - RESULTS - NO_CALLS)
CASES = [*NAMES, "EgoCover.discs", "EgoEllipsoid.around", "Goal.at", "Windows.load", "Windows.save", "PowerGrowth.fit",
         "Roadmap.load", "ConstantVelocity.predict", "Manoeuvres.predict", "checker call", "pred.at", "pred.moments",
         "pred.sample", "pred.save", "driven.at", "driven.moments", "driven.sample", "moments.at",
         "dynamics.dubins"]  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_whatever_comes_is_taken_or_refused_in_one_line(calls, name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    call, given = calls[name]

    def taken(change: dict[str, Any]) -> bool:
        try:
            with contextlib.redirect_stderr(None):
                made = call(**{**given, **change})
                if name == "record":
                    next(made)
        except rp.InputError as error:
            if "\n" in str(error):
                raise AssertionError("several lines") from error
            return False
        return True

    taken({})  # kernels are compiled outside the limit
    found = []
    for argument in given:
        for label, junk in JUNK.items():
            with limits(4000):
                accepted, finding, _ = tried(taken, {argument: junk}, SECONDS)
            if finding or (accepted and junk is NOTHING_KNOWN):
                found.append(f"{argument}={label}: {finding or 'taken'}")
    assert not found, "\n".join(found)


# ----------------------------------------------------------------------------------------------------
# the command line

WORDS = ("", "x", "-1", "nan", "inf", "1e400", "0", "9" * 400, "a\x00b", "é\u2028", "none", "1,2", "0x0", "/dev/null/a")
COMMANDS: dict[str, list[str]] = {
    "plan": ["{scene}", "--time-limit", "0.01", "--monte-carlo", "0"],
    "simulate": ["{scene}", "--time-limit", "0.01", "--steps", "1"],
    "assess": ["{scene}", "{plan}", "--monte-carlo", "0"],
    "sweep": ["{scene}", "--bounds", "0.1", "--time-limit", "0.01"],
    "render": ["{scene}", "{plan}", "--out", "a.png", "--view", "top", "--size", "200x150"],
    "batch": ["{folder}", "--out", "out", "--time-limit", "0.01"],
    "export": ["{plan}", "--to", "csv", "--out", "a.csv"],
    "record": ["--samples", "1", "--out", "r.npz"],
    "train": ["--data", "{folder}", "--out", "model"],
    "predict": ["{scene}", "--out", "predicted"],
    "completion": ["bash"],
}


def test_every_command_with_options_is_in_the_table():
    own = {name for name, command in subcommands().items() if any(a.dest != "help" for a in command._actions)}
    assert own - set(COMMANDS) <= {"checkers", "planners", "demo", "doctor"}  # these take --json and --out


def subcommands() -> dict[str, argparse.ArgumentParser]:
    (group,) = (a for a in parser()._actions if isinstance(a, argparse._SubParsersAction))
    return dict(group.choices)


@pytest.mark.parametrize("name", COMMANDS)
def test_any_word_for_any_option_ends_in_a_plan_or_in_one_line(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    scenario = overtake()
    rp.save_scenario(scenario, tmp_path / "scene.yaml")
    (tmp_path / "folder").mkdir()
    plan = rp.plan(scenario, bound=0.1, time_limit=20.0, seed=1)
    rp.save_plan(plan, tmp_path / "plan.json")
    places = {f"{{{key}}}": str(tmp_path / path) for key, path in
              (("scene", "scene.yaml"), ("plan", "plan.json"), ("folder", "folder"))}  # fmt: skip
    base = [places.get(word, word) for word in COMMANDS[name]]
    options = [a.option_strings[-1] for a in subcommands()[name]._actions if a.option_strings and a.nargs != 0]
    if name == "record":  # what these accept takes seconds
        options = [option for option in options if option not in ("--seed", "--samples")]

    def ended(argv: list[str]) -> bool:
        try:
            status = main(argv)
        except SystemExit as end:
            status = int(end.code or 0)
        told = capsys.readouterr()
        assert status in (0, 1, 2), told.err[-500:]
        assert status != 2 or (told.err.count("\n") == 1 and told.err.startswith("riskplan: error: ")), told.err
        return status != 2

    found = []
    for option in options:
        for word in WORDS:
            with limits(4000):
                _, finding, _ = tried(ended, [name, *base, f"{option}={word}"], SECONDS)
            if finding:
                found.append(f"{option}={word!r:.20}: {finding}")
    assert not found, "\n".join(found)
