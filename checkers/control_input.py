"""Boundary of `ControlPrediction`: start, controls and times in the many forms they may be given, checked once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from checkers.dynamics import System
from checkers.joint_normal import JointNormal
from checkers.prediction import MODES
from checkers.propagation import Draws, Initial
from checkers.random_variables import RandomVariable, as_random_variable
from checkers.validate import Array, InputError, as_array, as_option, as_times, as_weights, shown


@dataclass(frozen=True, eq=False)
class StepMixture:
    """Controls of one mode, drawn anew each step from one of C components, all noises together.

    Attributes:
        weights: (T, C).
        components: (C, W, T) random variables: per component, noise and step.
    """

    weights: Array
    components: tuple[tuple[Draws, ...], ...]


def start_blocks(value: Any, system: System) -> Initial:
    """The start as independent blocks of variables.

    Raises:
        InputError: naming the variable.
    """
    if not isinstance(value, Mapping):
        given = list(value) if isinstance(value, list | tuple) or getattr(value, "ndim", 0) == 1 else None
        if given is None or len(given) != len(system.variables):
            raise InputError(f"initial: expected a mapping or a value for each of {', '.join(system.variables)}")
        value = dict(zip(system.variables, given, strict=True))
    out: dict[tuple[str, ...], RandomVariable | JointNormal] = {}
    for key, block in value.items():
        names = key if isinstance(key, tuple) else (key,)
        for name in names:
            if name not in system.variables:
                raise InputError(f"initial: expected variables {', '.join(system.variables)}; got {name!r}")
            if any(name in other for other in out) or names.count(name) > 1:
                raise InputError(f"initial: {name!r} is given twice")
        if isinstance(block, JointNormal):
            angle = next((n for n in names if n in system.angles), None)
            if angle is not None:
                raise InputError(f"initial: {angle!r} is an angle and must be independent of the other variables")
            if len(block.mean) != len(names):
                raise InputError(f"initial[{names}]: expected {len(names)} variables, got {len(block.mean)}")
            out[names] = block
        elif len(names) > 1:
            raise InputError(f"initial[{names}]: expected a JointNormal, got {type(block).__name__}")
        else:
            out[names] = as_random_variable(block, f"initial[{names[0]!r}]")
    missing = [v for v in system.variables if not any(v in names for names in out)]
    if missing:
        raise InputError(f"initial: {missing[0]!r} is missing; expected {', '.join(system.variables)}")
    # one order, however it was given, so that equal seeds sample equal futures
    return dict(sorted(out.items(), key=lambda item: system.variables.index(item[0][0])))


def control_modes(
    given: Any, weights: Any, kind: str, system: System, steps: int
) -> tuple[tuple[StepMixture, ...], Array]:
    """Modes as step mixtures, and their weights (K,).

    Raises:
        InputError: naming the mode, the noise and the step.
    """
    if not isinstance(given, Mapping | StepMixture | Sequence) or isinstance(given, str):
        raise InputError(f"controls: expected a mapping for each mode, in a list, got {shown(given)}")
    modes = [given] if isinstance(given, Mapping | StepMixture) else list(given)
    if not modes:
        raise InputError("controls: expected at least one mode, got none")
    as_option("modes", kind, MODES)
    if weights is None and len(modes) > 1:
        raise InputError(f"weights: expected one for each of {len(modes)} modes, got none")
    shares = as_weights("weights", np.ones(1) if weights is None else weights, steps, len(modes))
    if kind == "per_step":
        components = tuple(_component(m, k, system, steps) for k, m in enumerate(modes))
        return (StepMixture(np.broadcast_to(shares, (steps, len(modes))), components),), np.ones(1)
    if shares.ndim == 2:
        raise InputError("weights: expected (K,) for persistent modes, got one row a step; use modes='per_step'")
    kept = [
        _step_mixture(m, k, system, steps)
        if isinstance(m, StepMixture)
        else StepMixture(np.ones((steps, 1)), (_component(m, k, system, steps),))
        for k, m in enumerate(modes)
    ]
    return tuple(kept), shares


def _step_mixture(mode: StepMixture, k: int, system: System, steps: int) -> StepMixture:
    weights = as_weights(f"controls[{k}].weights", np.asarray(mode.weights), steps, len(mode.components))
    parts = [dict(zip(system.noises, c, strict=True)) if not isinstance(c, Mapping) else c for c in mode.components]
    components = tuple(_component(c, k, system, steps) for c in parts)
    return StepMixture(np.broadcast_to(weights, (steps, len(components))), components)


def _component(value: Any, k: int, system: System, steps: int) -> tuple[Draws, ...]:
    if not isinstance(value, Mapping):
        raise InputError(
            f"controls[{k}]: expected a mapping from {', '.join(system.noises)} to random variables, "
            f"got {type(value).__name__}"
        )
    for name in value:
        if name not in system.noises:
            raise InputError(f"controls[{k}]: expected noises {', '.join(system.noises)}; got {name!r}")
    out = []
    for name in system.noises:
        if name not in value:
            raise InputError(f"controls[{k}]: {name!r} is missing; expected {', '.join(system.noises)}")
        where, given = f"controls[{k}][{name!r}]", value[name]
        if isinstance(given, np.ndarray) and not given.ndim:
            given = given[()]
        if isinstance(given, list | tuple | np.ndarray):
            if len(given) != steps:
                raise InputError(f"{where}: expected one for each of {steps} steps, got {len(given)}")
            out.append(tuple(as_random_variable(x, f"{where}[{t}]") for t, x in enumerate(given)))
        else:
            out.append((as_random_variable(given, where),) * steps)
    return tuple(out)


def grid_times(value: Any, dt: float, steps: int) -> Array:
    """The times wanted, all steps by default; others than steps are refused."""
    if value is None:
        return as_array("times", np.arange(steps + 1) * dt, (steps + 1,))
    times = as_times("times", value)
    rows = times / dt
    off = np.flatnonzero((np.abs(rows - np.rint(rows)) * dt > 1e-6) | (rows < -1e-6) | (rows > steps + 1e-6))
    if len(off):
        raise InputError(
            f"times[{int(off[0])}]: expected a multiple of dt = {dt:g} s from 0 to {steps * dt:g} s, "
            f"got {times[off[0]]:g}"
        )
    return times
