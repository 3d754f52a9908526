"""An agent whose controls are predicted: its position's moments are propagated exactly, its futures simulated."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from checkers.control_input import StepMixture, control_modes, grid_times, start_blocks
from checkers.dynamics import System
from checkers.joint_normal import JointNormal
from checkers.prediction import MomentPrediction
from checkers.propagation import PositionMoments, position_moments
from checkers.show import prediction_table
from checkers.validate import LARGEST_BODY, Array, InputError, as_draws, as_scalar, as_times

LARGEST_ORDER = 12


@dataclass(frozen=True, eq=False)
class ControlPrediction:
    """A mixture of uncertain controls driving a system (Jasour et al. 2021, sections V and VII-B).

    Attributes:
        system: how the agent moves.
        initial: its state at time 0: a mapping from each variable to a number or a random variable, or from several
            real variables together, as a tuple, to a `JointNormal`; or a sequence in the order of the system's
            variables. Entries are independent.
        controls: per mode, a mapping from each noise to a random variable (or number), or to one per step; a single
            mapping is a single mode. Kept as one `StepMixture` per mode.
        steps: number of steps T.
        weights: (K,) of the modes; with "per_step" also (T, K).
        modes: "persistent" if one mode holds for the whole trajectory. With "per_step" one is drawn each step; the
            position then follows a single distribution, so it is kept as one persistent mode.
        times: where the agent is predicted, multiples of the system's dt up to T·dt; None: all, from 0.
        name, length, width: as of any prediction.

    Raises:
        InputError: naming the field and the index.
    """

    system: System
    initial: Any
    controls: Any
    steps: int
    weights: Any = None
    modes: str = "persistent"
    times: Any = None
    name: str = ""
    length: float | None = None
    width: float | None = None

    def __post_init__(self) -> None:
        put = object.__setattr__
        if not isinstance(self.system, System):
            raise InputError(f"system: expected a System, got {type(self.system).__name__}")
        steps = self.steps
        if not isinstance(steps, int | np.integer) or isinstance(steps, bool) or not 1 <= steps <= 100_000:
            raise InputError(f"steps: expected an integer from 1 to 100000, got {steps!r}")
        put(self, "initial", start_blocks(self.initial, self.system))
        controls, weights = control_modes(self.controls, self.weights, self.modes, self.system, int(steps))
        put(self, "controls", controls)
        put(self, "weights", weights)
        put(self, "modes", "persistent")
        put(self, "times", grid_times(self.times, self.system.dt, int(steps)))
        for field in ("length", "width"):
            value = getattr(self, field)
            put(
                self, field, None if value is None else as_scalar(field, value, low=0.0, high=LARGEST_BODY, strict=True)
            )
        if not isinstance(self.name, str):
            raise InputError(f"name: expected text, got {self.name!r}")

    @property
    def order(self) -> None:
        """None: every moment can be had, and the agent sampled."""

    @property
    def headings(self) -> None:
        """Not stated: a heading is random here."""

    @property
    def means(self) -> Array:
        """(T, K, 2) [m]."""
        return self.moments(2).means

    @property
    def covariances(self) -> Array:
        """(T, K, 2, 2) [m²]."""
        return self.moments(2).covariances

    @property
    def step_weights(self) -> Array:
        """Weights as (T, K)."""
        return np.broadcast_to(self.weights, (len(self.times), len(self.weights)))

    def moments(self, order: int) -> MomentPrediction:
        """The same agent as exact moments of its position up to `order`, 2 to 12; computed once.

        Raises:
            InputError: for another order, and where the spread shrinks so far below what it was (a circle closed at an
                uncertain speed) that double precision leaves no moments of that order.
        """
        if not isinstance(order, int | np.integer) or isinstance(order, bool) or not 2 <= order <= LARGEST_ORDER:
            raise InputError(f"moments: expected an order from 2 to {LARGEST_ORDER}, got {order!r}")
        known: dict[int, MomentPrediction] = self.__dict__.setdefault("_moments", {})
        if order not in known:
            means, central = self._propagated(int(order))
            rows = self._rows
            try:
                found = MomentPrediction(
                    self.times,
                    self.weights,
                    means[rows],
                    central[rows],
                    name=self.name,
                    length=self.length,
                    width=self.width,
                )
            except InputError as error:
                raise InputError(
                    f"moments: order {order} of {self.name or 'the prediction'} is lost to rounding: "
                    f"a spread is far below an earlier one; ask for a lower order ({error})"
                ) from None
            known[int(order)] = found
        return known[int(order)]

    def at(self, times: Any) -> ControlPrediction:
        """The prediction at some of its times.

        Raises:
            InputError: for a time that is none of its steps: nothing is interpolated or extrapolated.
        """
        times = as_times("times", times)
        nearest = np.abs(self.times[None, :] - times[:, None]).argmin(axis=1)
        off = np.flatnonzero(np.abs(self.times[nearest] - times) > 1e-6)
        if len(off):
            raise InputError(
                f"times[{int(off[0])}]: {self.name or 'the prediction'} is known at its own steps of "
                f"{self.system.dt:g} s from {self.times[0]:g} to {self.times[-1]:g} s, got {times[off[0]]:g}"
            )
        return self if np.array_equal(times, self.times) else replace(self, times=times)

    def sample(self, n: int, rng: np.random.Generator) -> Array:
        """(n, T, 2) trajectories of the system itself, step by step; a mode is drawn once per trajectory."""
        n = as_draws(n, rng)
        mode = rng.choice(len(self.weights), size=n, p=self.weights)
        out = np.empty((n, len(self.times), 2))
        for k in range(len(self.weights)):
            mine = np.flatnonzero(mode == k)
            out[mine] = self.sample_mode(k, len(mine), rng)
        return out

    def sample_mode(self, k: int, n: int, rng: np.random.Generator) -> Array:
        """(n, T, 2) trajectories of mode k."""
        return self._simulated(self.controls[k], n, rng)

    def save(self, path: str | Path) -> None:
        """Write to an `.npz` (no pickle)."""
        from checkers.control_document import saved  # noqa: PLC0415  only files need it

        saved(self, path)

    def _repr_html_(self) -> str:
        return prediction_table(self)

    @property
    def _rows(self) -> np.ndarray:
        return np.asarray(np.rint(self.times / self.system.dt), dtype=np.int64)

    def _propagated(self, order: int) -> PositionMoments:
        last = max(int(self._rows[-1]), 1)  # nothing beyond the last time asked for
        count = max(len(mode.components) for mode in self.controls)
        weights = np.zeros((len(self.controls), last, count))
        modes = []
        for k, mode in enumerate(self.controls):
            weights[k, :, : len(mode.components)] = mode.weights[:last]
            # modes of fewer components are filled up with one of no weight
            padded = [*mode.components, *[mode.components[0]] * (count - len(mode.components))]
            modes.append([[draws[:last] for draws in component] for component in padded])
        return position_moments(self.system, self.initial, modes, weights, order)

    def _simulated(self, mode: StepMixture, n: int, rng: np.random.Generator) -> Array:
        values: dict[str, Array] = {}
        for names, block in self.initial.items():
            drawn = block.sample(n, rng)
            values.update(zip(names, drawn.T if isinstance(block, JointNormal) else [drawn], strict=True))
        rows = self._rows.tolist()
        out = np.empty((n, len(rows), 2))
        for t in range(rows[-1] + 1):
            if t in rows:
                out[:, rows.index(t), 0], out[:, rows.index(t), 1] = (values[p] for p in self.system.position)
            if t < rows[-1]:
                values = self.system.step(values, self._drawn(mode, t, n, rng))
        return out

    def _drawn(self, mode: StepMixture, t: int, n: int, rng: np.random.Generator) -> dict[str, Array]:
        components = mode.components
        if len(components) == 1:
            return {w: d[t].sample(n, rng) for w, d in zip(self.system.noises, components[0], strict=True)}
        which = rng.choice(len(components), size=n, p=mode.weights[t])
        out = {w: np.empty(n) for w in self.system.noises}
        for c, component in enumerate(components):
            mine = np.flatnonzero(which == c)
            for w, draws in zip(self.system.noises, component, strict=True):
                out[w][mine] = draws[t].sample(len(mine), rng)
        return out


def propagate(
    system: System, initial: Any, controls: Any, steps: int, order: int = 4, weights: Any = None
) -> MomentPrediction:
    """Exact moments of an agent's position at times 0, dt, …, steps·dt.

    Args:
        system: how it moves, such as `dynamics.dubins(0.1)`.
        initial, controls, weights: as in `ControlPrediction`, modes persistent.
        steps: number of steps.
        order: of the moments, 2 to 12.

    Raises:
        InputError: naming the field and the index.
    """
    return ControlPrediction(system, initial, controls, steps, weights).moments(order)
