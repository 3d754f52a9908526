"""Seeds, all made here: one small valid input or more of every format."""

# ruff: noqa: E501  tables of nasty values
from __future__ import annotations

import copy
import io
import json
from typing import Any

import numpy as np

T, K = 3, 2


def gaussian() -> dict[str, Any]:
    """An agent as a Gaussian mixture, as plain data."""
    means = [[[20.0 + t, 3.0 * k] for k in range(K)] for t in range(T)]
    covariances = [[[[0.3 + 0.1 * t, 0.02], [0.02, 0.2]] for _ in range(K)] for t in range(T)]
    return {
        "times": [0.1 * t for t in range(T)],
        "weights": [0.25, 0.75],
        "means": means,
        "covariances": covariances,
        "modes": "persistent",
    }


def moments() -> dict[str, Any]:
    """The same by moments to order 2."""
    g = gaussian()
    central = [
        [[[1.0, 0.0, c[1][1]], [0.0, c[0][1], None], [c[0][0], None, None]] for c in row] for row in g["covariances"]
    ]
    return {
        "times": {"start": 0.0, "step": 0.1, "count": T},
        **_only(g, "weights", "means"),
        "central_moments": central,
    }


def controls() -> dict[str, Any]:
    """An agent by its controls: shipped system, several kinds of random variables."""
    return {
        "system": {"shipped": "dubins", "dt": 0.1},
        "steps": 2,
        "initial": {"x": 20.0, "y": {"normal": {"mu": 3.0, "sd": 0.1}}, "v": 5.0, "theta": 0.0},
        "weights": [0.5, 0.5],
        "controls": [
            {"w_v": {"uniform": {"low": -0.1, "high": 0.1}}, "w_theta": 0.0},
            {"w_v": {"beta": {"a": 2.0, "b": 3.0}}, "w_theta": [{"normal": {"mu": 0.0, "sd": 0.01}}, 0.0]},
        ],
    }


def declared() -> dict[str, Any]:
    """An agent by a system of its own."""
    return {
        "system": {
            "updates": {"x": "x + dt * v * cos(a)", "y": "y + dt * v * sin(a)", "v": "v + w", "a": "a + 0.1 * q"},
            "noises": ["w", "q"],
            "dt": 0.1,
            "position": ["x", "y"],
        },
        "steps": 2,
        "initial": {"x": 20.0, "y": 3.0, "v": 5.0, "a": 0.0},
        "controls": [
            {"w": {"gamma": {"shape": 2.0, "scale": 0.1}}, "q": {"discrete": {"values": [0, 1], "weights": [0.5, 0.5]}}}
        ],
    }


def scenarios() -> list[dict[str, Any]]:
    """Scenario documents that together use every key."""
    base: dict[str, Any] = {
        "version": 1,
        "name": "seed",
        "time_step": 0.1,
        "horizon": 0.2,
        "bounds": [-10, -5, 60, 5],
        "start": {"x": 0, "y": 0, "heading": 0, "speed": 10},
        "goal": {"time": [0.0, 0.2], "regions": [{"box": [1, -4, 30, 4], "heading": 0.0, "heading_tolerance": 0.5}]},
        "agents": [{"name": "car", "length": 4.5, "width": 1.8, "gaussian": gaussian()}],
    }
    more = {
        **base,
        "vehicle": {"length": 4.5, "width": 1.8, "max_speed": 30.0, "max_curvature": 0.2},
        "ego": {"discs": {"length": 4.5, "width": 1.8, "n": 3, "relative_heading": 0.0}},
        "obstacles": [[[10, -5], [12, -5], [12, -4]]],
        "drivable": [[[-10, -5], [60, -5], [60, 5], [-10, 5]]],
        "lanes": [[[-10, 0], [60, 0]]],
        "goal": {
            "regions": [
                {"circle": {"x": 2, "y": 0, "radius": 1.5}, "speed": [0, 20]},
                {"polygon": [[1, 1], [3, 1], [2, 3]]},
            ]
        },
        "agents": [{"name": "m", "moments": moments()}],
    }
    headed = {
        **gaussian(),
        "weights": [1.0],
        "means": [[[20.0, 3.0]]] * T,
        "covariances": [[[[0.3, 0.0], [0.0, 0.2]]]] * T,
    }
    agent = {
        "length": 4.5,
        "width": 1.8,
        "gaussian": headed,
        "headings": [[0.0]] * T,
        "factors": [[[[0.3], [0.1]]]] * T,
    }
    box = {**base, "ego": {"box": {"length": 4.5, "width": 1.8}}, "agents": [agent]}
    ellipse = {**base, "ego": {"ellipsoid": {"Q": [[0.05, 0.0], [0.0, 0.3]]}}, "agents": [{"controls": controls()}]}
    aligned = {**base, "ego": {"aligned": {"length": 4.5, "width": 1.8}}, "agents": [agent]}
    own = {**base, "ego": {"ellipsoid": {"length": 4.5, "width": 1.8}}, "agents": [{"controls": declared()}]}
    filed = {**base, "agents": [{"file": "agent.npz"}]}
    empty = {**base, "agents": []}
    return [copy.deepcopy(d) for d in (base, more, box, ellipse, aligned, own, filed, empty)]


def plan() -> dict[str, Any]:
    """A plan's document, with a trajectory and with a risk."""
    return {
        "format": "riskplan-plan",
        "version": 1,
        "status": "solved",
        "message": "",
        "bound": 0.01,
        "seed": 0,
        "risk": {
            "total": 1e-3,
            "per_agent": [1e-3],
            "per_step": [0.0, 5e-4, 5e-4],
            "boole": 1e-3,
            "max_step": 5e-4,
            "kind": "upper bound",
            "dependence": "independent",
        },
        "trajectory": {
            "times": [0.0, 0.1, 0.2],
            "poses": [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]],
            "speeds": [10.0, 10.0, 10.0],
        },
        "marginals": [[[0.0, 0.0], [5e-4, 0.0], [5e-4, None]]],
        "settings": {"checker": "exact", "checker_options": {}, "dependence": "independent", "planner": "rrt"},
        "stats": {"search": 0.1},
        "versions": {"python": "3"},
    }


def predictions() -> list[dict[str, np.ndarray]]:
    """The arrays of prediction files."""
    g = gaussian()
    arrays = {key: np.asarray(value) for key, value in g.items()}
    central = np.array(moments()["central_moments"], dtype=float)
    m = {**_only(arrays, "times", "weights", "means"), "central_moments": central}
    return [
        {"type": np.asarray("gaussian"), **arrays, "length": np.asarray(4.5), "width": np.asarray(1.8)},
        {"type": np.asarray("moments"), **m, "name": np.asarray("m")},
        {"type": np.asarray("controls"), "document": np.asarray(json.dumps(controls()))},
        {"type": np.asarray("controls"), "document": np.asarray(json.dumps(declared()))},
    ]


def roadmap() -> dict[str, np.ndarray]:
    """The arrays of a roadmap file."""
    vertices = np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0], [5.0, 3.0, 0.5]])
    ends, kinds = np.array([[0, 1]]), np.array([1])
    radii, longest = np.array([20.0, 5.0]), np.asarray(20.0)
    return {"vertices": vertices, "ends": ends, "kinds": kinds, "radii": radii, "longest": longest}


def npz(arrays: dict[str, Any]) -> bytes:
    """Arrays as an .npz."""
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue()


def yaml_bytes(document: Any) -> bytes:
    """A document as YAML, by way of JSON."""
    text = json.dumps(document).replace("NaN", ".nan").replace("-Infinity", "-.inf").replace("Infinity", ".inf")
    return text.encode()


def commonroad() -> bytes:
    """A CommonRoad file of two lanelets, a parked car, a moving car and a planning problem."""

    def bound(y: float) -> str:
        return "".join(f"<point><x>{x}</x><y>{y}</y></point>" for x in (0, 50, 100))

    def exactly(name: str, value: float) -> str:
        return f"<{name}><exact>{value}</exact></{name}>"

    def state(tag: str, step: int, x: float, y: float) -> str:
        place = f"<position><point><x>{x}</x><y>{y}</y></point></position>"
        rest = exactly("orientation", 0.0) + exactly("time", step) + exactly("velocity", 10.0)
        return f"<{tag}>{place}{rest}</{tag}>"

    def full(tag: str, step: int, x: float, y: float) -> str:
        more = exactly("yawRate", 0.0) + exactly("slipAngle", 0.0)
        return state(tag, step, x, y).replace(f"</{tag}>", f"{more}</{tag}>")

    shape = "<shape><rectangle><length>4.5</length><width>1.8</width></rectangle></shape>"
    lanelets = "".join(
        f'<lanelet id="{i}"><leftBound>{bound(y + 3.5)}</leftBound><rightBound>{bound(y)}</rightBound>'
        f'<{side} ref="{3 - i}" drivingDir="same"/><laneletType>urban</laneletType></lanelet>'
        for i, y, side in ((1, 0.0, "adjacentLeft"), (2, 3.5, "adjacentRight"))
    )
    parked = (
        f'<staticObstacle id="3"><type>parkedVehicle</type>{shape}{state("initialState", 0, 60, 5)}</staticObstacle>'
    )
    driven = "".join(state("state", t, 30 + t, 1.75) for t in range(1, 4))
    moving = (
        f'<dynamicObstacle id="4"><type>car</type>{shape}{state("initialState", 0, 30, 1.75)}'
        f"<trajectory>{driven}</trajectory></dynamicObstacle>"
    )
    goal = (
        "<goalState><position><rectangle><length>20</length><width>3</width><orientation>0</orientation>"
        "<center><x>40</x><y>5</y></center></rectangle></position>"
        "<orientation><intervalStart>-0.2</intervalStart><intervalEnd>0.2</intervalEnd></orientation>"
        "<time><intervalStart>20</intervalStart><intervalEnd>40</intervalEnd></time>"
        "<velocity><intervalStart>0</intervalStart><intervalEnd>20</intervalEnd></velocity></goalState>"
    )
    problem = f'<planningProblem id="5">{full("initialState", 0, 10, 5)}{goal}</planningProblem>'
    location = "<location><geoNameId>1</geoNameId><gpsLatitude>1</gpsLatitude><gpsLongitude>1</gpsLongitude></location>"
    return (
        '<?xml version="1.0" encoding="UTF-8"?><commonRoad timeStepSize="0.1" commonRoadVersion="2020a" author="a" '
        'affiliation="a" source="a" benchmarkID="ZAM_Seed-1_1_T-1" date="2026-01-01">'
        f"{location}<scenarioTags><urban/></scenarioTags>{lanelets}{parked}{moving}{problem}</commonRoad>"
    ).encode()


def commands() -> list[list[str]]:
    """Command lines that do little; {scene}, {plan} and {out} are files."""
    return [
        ["plan", "{scene}", "--time-limit", "0.05", "--monte-carlo", "0", "--json"],
        ["plan", "{scene}", "--planner", "prm", "--bound", "none", "--time-limit", "0.05", "--monte-carlo", "10"],
        ["plan", "{scene}", "--dependence", "persistent", "--time-limit", "0.05", "--monte-carlo", "0", "--seed", "3"],
        ["assess", "{scene}", "{plan}", "--checker", "exact,halfspace", "--monte-carlo", "10", "--json"],
        ["checkers", "--json"],
        ["planners"],
    ]


def _only(values: dict[str, Any], *keys: str) -> dict[str, Any]:
    return {key: values[key] for key in keys}
