"""A control prediction as plain data (text, numbers, lists, mappings), for files of any format, and back."""

from __future__ import annotations

import inspect
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from checkers import distributions, dynamics
from checkers.control_input import StepMixture
from checkers.control_prediction import ControlPrediction
from checkers.dynamics import System
from checkers.joint_normal import JointNormal
from checkers.propagation import Draws
from checkers.random_variables import Constant, Discrete, Mixture, RandomVariable
from checkers.validate import InputError, as_option

_FAMILIES = {
    cls.__name__.lower(): cls
    for cls in (
        distributions.Normal,
        distributions.Uniform,
        distributions.Beta,
        distributions.Gamma,
        distributions.Exponential,
        distributions.Triangular,
        Discrete,
        Mixture,
    )
}
_SHIPPED = {
    name: getattr(dynamics, name) for name in ("dubins", "dubins_lateral", "unicycle", "dubins_3d", "constant_turn")
}


def document(pred: ControlPrediction) -> dict[str, Any]:
    """The prediction without its labels: system, steps, start, weights and controls, and times unless all.

    Raises:
        InputError: for a random variable known by a rule only, such as a scipy distribution of no family of ours.
    """
    s = pred.system
    initial: dict[str, Any] = {}
    joint = []
    for names, block in pred.initial.items():
        if isinstance(block, JointNormal):
            joint.append(
                {"variables": list(names), "mean": block.mean.tolist(), "covariance": block.covariance.tolist()}
            )
        else:
            initial[names[0]] = _plain(block)
    return {
        "system": {
            "updates": dict(s.updates),
            "noises": list(s.noises),
            "dt": s.dt,
            "position": list(s.position),
            "name": s.name,
        },
        "steps": int(pred.steps),
        "initial": initial,
        **({"joint": joint} if joint else {}),
        "weights": pred.weights.tolist(),
        "controls": [_mode(pred, mode) for mode in pred.controls],
        **({} if len(pred.times) == pred.steps + 1 else {"times": pred.times.tolist()}),
    }


def prediction(d: Mapping[str, Any], **labels: Any) -> ControlPrediction:
    """The prediction of a document; labels are given besides.

    Raises:
        InputError: naming the field.
    """
    _keys("controls", d, ("system", "steps", "initial", "controls"), ("joint", "weights", "modes", "times"))
    initial: dict[Any, Any] = {
        key: _random(v, f"initial[{key!r}]") for key, v in _mapping("initial", d["initial"]).items()
    }
    for i, block in enumerate(d.get("joint", ())):
        _keys(f"joint[{i}]", block, ("variables", "mean", "covariance"))
        initial[tuple(block["variables"])] = JointNormal(block["mean"], block["covariance"])
    if not isinstance(d["controls"], list):
        raise InputError(f"controls: expected a list of modes, got {type(d['controls']).__name__}")
    modes = [_read_mode(k, m) for k, m in enumerate(d["controls"])]
    given = {key: d[key] for key in ("weights", "modes", "times") if key in d}
    return ControlPrediction(_system(d["system"]), initial, modes, d["steps"], **given, **labels)


def saved(pred: ControlPrediction, path: str | Path) -> None:
    """Write an `.npz` of text and numbers."""
    labels = {key: getattr(pred, key) for key in ("name", "length", "width")}
    present = {key: np.asarray(value) for key, value in labels.items() if value is not None}
    text = json.dumps(document(pred), allow_nan=False)
    with open(path, "wb") as file:
        np.savez(file, allow_pickle=False, type=np.asarray("controls"), document=np.asarray(text), **present)


def loaded(document: str, **labels: Any) -> ControlPrediction:
    """What `saved` wrote."""
    try:
        d = json.loads(document)
    except (ValueError, RecursionError) as error:
        raise InputError(f"document: expected JSON: {error}") from None
    return prediction(d, **labels)


def _mode(pred: ControlPrediction, mode: StepMixture) -> dict[str, Any]:
    components = [
        {w: _steps(draws) for w, draws in zip(pred.system.noises, component, strict=True)}
        for component in mode.components
    ]
    if len(components) == 1:
        return components[0]
    return {"weights": mode.weights.tolist(), "components": components}


def _steps(draws: Draws) -> Any:
    same = all(x is draws[0] for x in draws)
    return _plain(draws[0]) if same else [_plain(x) for x in draws]


def _plain(x: RandomVariable) -> Any:
    if isinstance(x, Constant):
        return x.value
    family = type(x).__name__.lower()
    if family not in _FAMILIES:
        raise InputError(f"random variable: expected one of {', '.join(_FAMILIES)} to write, got {family}")
    fields = {name: getattr(x, name) for name in inspect.signature(type(x)).parameters}
    if isinstance(x, Mixture):
        fields["components"] = [_plain(c) for c in x.components]
    return {family: {name: v.tolist() if isinstance(v, np.ndarray) else v for name, v in fields.items()}}


def _random(value: Any, where: str) -> RandomVariable:
    if isinstance(value, int | float) and not isinstance(value, bool):
        return Constant(value)
    if not isinstance(value, Mapping) or len(value) != 1:
        raise InputError(f"{where}: expected a number or one of {', '.join(_FAMILIES)} with its numbers, got {value!r}")
    ((family, fields),) = value.items()
    cls = _FAMILIES[as_option(where, family, tuple(_FAMILIES))]
    known = inspect.signature(cls).parameters
    needed = tuple(n for n, p in known.items() if p.default is p.empty)
    _keys(f"{where}.{family}", fields, needed, tuple(n for n in known if n not in needed))
    if cls is Mixture:
        parts = [_random(c, f"{where}.mixture.components[{i}]") for i, c in enumerate(fields["components"])]
        return Mixture(fields["weights"], tuple(parts))
    try:
        found: RandomVariable = cls(**fields)
        return found
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def _read_mode(k: int, value: Any) -> Any:
    where = f"controls[{k}]"
    if "components" not in _mapping(where, value):
        return {w: _read_steps(v, f"{where}[{w!r}]") for w, v in value.items()}
    _keys(where, value, ("weights", "components"))
    parts = [
        {w: _read_steps(v, f"{where}.components[{c}][{w!r}]") for w, v in part.items()}
        for c, part in enumerate(value["components"])
    ]
    return StepMixture(value["weights"], tuple(parts))  # type: ignore[arg-type]  # completed by ControlPrediction


def _read_steps(value: Any, where: str) -> Any:
    if isinstance(value, list):
        return [_random(x, f"{where}[{t}]") for t, x in enumerate(value)]
    return _random(value, where)


def _system(d: Any) -> System:
    if "shipped" not in _mapping("system", d):
        _keys("system", d, ("updates", "noises", "dt"), ("position", "name"))
        fields: dict[str, Any] = {key: tuple(v) if isinstance(v, list) else v for key, v in d.items()}
        return System(**fields)
    make = _SHIPPED[as_option("system.shipped", d["shipped"], tuple(_SHIPPED))]
    _keys("system", d, ("shipped", *inspect.signature(make).parameters))
    made: System = make(**{key: v for key, v in d.items() if key != "shipped"})
    return made


def _mapping(where: str, value: Any) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise InputError(f"{where}: expected a mapping, got {type(value).__name__}")
    return value


def _keys(where: str, value: Any, needed: tuple[str, ...], optional: tuple[str, ...] = ()) -> None:
    for key in _mapping(where, value):
        if key not in needed + optional:
            raise InputError(f"{where}: unknown key {key!r}; expected one of {', '.join(needed + optional)}")
    for key in needed:
        if key not in value:
            raise InputError(f"{where}: {key} is missing; expected {', '.join(needed)}")
