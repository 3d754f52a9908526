"""Risk behind OMPL's two questions: is this state valid, is this motion valid."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from ompl import base as ob

from checkers import Checker, EgoShape, InputError
from checkers.validate import Array, as_scalar
from riskplan.evaluator import RiskEvaluator
from riskplan.scene import Agent

_STATIC_SPACING = 0.5  # [m]
PoseTime = Callable[[Any], tuple[float, float, float, float]]


class RiskStateValidityChecker(ob.StateValidityChecker):
    """A state is valid iff its risk is within every bound given.

    With `step_bound`, the risk is the marginal one of the state's pose at the state's time, summed over agents; where
    it is not known (a time outside a prediction, a pose that is not finite) the state is not valid. With `total`, it is
    what that function returns for the state: the planner's accumulated total, held against `total_bound()`.

    Args:
        si: SpaceInformation; only its state space is kept (capturing `si` in a callback leaks it).
        agents: predictions.
        ego: shape.
        checker: backend.
        step_bound: largest marginal risk of a state.
        pose_time: (x, y, heading, time) of a state; None: worked out from the type of the space (see `pose_time_of`).
        static: whether (x, y, heading) is free of the static world.
        total: accumulated risk of a state; `total_bound`: its present limit.
        times: grid; None: that of the agents.
    """

    def __init__(
        self,
        si: Any,
        agents: Sequence[Agent],
        ego: EgoShape,
        checker: Checker,
        step_bound: float | None = None,
        *,
        pose_time: PoseTime | None = None,
        static: Callable[[float, float, float], bool] | None = None,
        total: Callable[[Any], float] | None = None,
        total_bound: Callable[[], float] | None = None,
        times: Array | None = None,
    ) -> None:
        super().__init__(si)
        if (total is None) != (total_bound is None):
            raise InputError("total: expected together with total_bound")
        self.step_bound = _bound(step_bound)
        self.evaluator = _evaluator(agents, ego, checker, times)
        self._pose_time = pose_time
        if pose_time is None and (static is not None or step_bound is not None):
            self._pose_time = pose_time_of(si.getStateSpace())
        self._static = static
        self._total, self._total_bound = total, total_bound

    def isValid(self, state: Any) -> bool:  # noqa: N802  OMPL's name
        """OMPL's question; a risk that is not known (a time outside the predictions) is not valid."""
        if self._total is not None and self._total_bound is not None:
            if not self._total(state) <= self._total_bound():
                return False
        if self._pose_time is None:
            return True
        x, y, heading, time = self._pose_time(state)
        if self._static is not None and not self._static(x, y, heading):
            return False
        if self.step_bound is None or not self.evaluator.agents:
            return True
        return bool(self.evaluator.at_time(np.array([x, y, heading]), time) <= self.step_bound)


class RiskMotionValidator(ob.MotionValidator):
    """A motion is valid iff it goes forward in time and the risk at every grid step it passes is within a bound.

    Between the ends the state space's own interpolation is followed. Planners that account for the total risk, as `rrt`
    and `prm` do, ask `charge` for the poses they drive instead.

    Args: as for `RiskStateValidityChecker`; `static` is asked every half metre.
        evaluator: made already from the same agents, ego and checker; None: a new one.
    """

    def __init__(
        self,
        si: Any,
        agents: Sequence[Agent],
        ego: EgoShape,
        checker: Checker,
        step_bound: float | None = None,
        *,
        pose_time: PoseTime | None = None,
        static: Callable[[float, float, float], bool] | None = None,
        times: Array | None = None,
        evaluator: RiskEvaluator | None = None,
    ) -> None:
        super().__init__(si)
        self.step_bound = _bound(step_bound)
        self.evaluator = evaluator or _evaluator(agents, ego, checker, times)
        self._space = si.getStateSpace()
        self._pose_time = pose_time or pose_time_of(self._space)
        self._static = static
        self._scratch = self._space.allocState()

    def checkMotion(self, first: Any, second: Any) -> bool:  # noqa: N802  OMPL's name
        """OMPL's question; both C++ overloads arrive here."""
        start, end = self._pose_time(first)[3], self._pose_time(second)[3]
        if not end > start:
            return False
        grid = self.evaluator.times
        inner = grid[(grid > start + 1e-9) & (grid < end - 1e-9)]
        if self._static is not None and not self._static_free(first, second):
            return False
        for time in [*inner, end]:
            self._space.interpolate(first, second, float((time - start) / (end - start)), self._scratch)
            x, y, heading, _ = self._pose_time(self._scratch)
            if self.step_bound is not None and self.evaluator.agents:
                risk = self.evaluator.at_time(np.array([x, y, heading]), float(time))
                if not risk <= self.step_bound:
                    return False
        return True

    def _static_free(self, first: Any, second: Any) -> bool:
        """The static world is asked every half metre, whatever the times."""
        a, b = self._pose_time(first), self._pose_time(second)
        count = int(np.hypot(b[0] - a[0], b[1] - a[1]) / _STATIC_SPACING) + 1
        for i in range(1, count + 1):
            self._space.interpolate(first, second, i / count, self._scratch)
            if self._static is not None and not self._static(*self._pose_time(self._scratch)[:3]):
                return False
        return True

    def charge(self, poses: Array, first_step: int, before: Array, limit: float, after: Array) -> float:
        """Total risk at the end of a motion over grid steps, see `RiskEvaluator.charge`."""
        return self.evaluator.charge(poses, first_step, before, limit, after)


def pose_time_of(space: Any) -> PoseTime:
    """How to read (x, y, heading, time) from a state of a known kind of space.

    Known are: RealVector(4) with x, y, heading, time in that order; compounds and SpaceTime of (SE2 or Dubins or
    Reeds–Shepp or RealVector x, y[, heading]) and time as a TimeStateSpace or RealVector(1).

    Raises:
        InputError: for another space; pass `pose_time` then.
    """
    if isinstance(space, ob.RealVectorStateSpace) and space.getDimension() == 4:
        return lambda s: (s[0], s[1], s[2], s[3])
    if isinstance(space, ob.CompoundStateSpace) and space.getSubspaceCount() == 2:
        place, time = space.getSubspace(0), space.getSubspace(1)
        if isinstance(time, ob.TimeStateSpace):
            read_time = _time_of_time
        elif isinstance(time, ob.RealVectorStateSpace) and time.getDimension() == 1:
            read_time = _time_of_vector
        else:
            raise InputError("pose_time: expected a space whose second part is time; pass pose_time=")
        if isinstance(place, ob.SE2StateSpace):  # Dubins and Reeds–Shepp derive from it
            return lambda s: (s[0].getX(), s[0].getY(), s[0].getYaw(), read_time(s[1]))
        if isinstance(place, ob.RealVectorStateSpace) and place.getDimension() >= 2:
            if place.getDimension() >= 3:
                return lambda s: (s[0][0], s[0][1], s[0][2], read_time(s[1]))
            return lambda s: (s[0][0], s[0][1], 0.0, read_time(s[1]))
    raise InputError(f"pose_time: no rule for a {type(space).__name__}; pass pose_time=")


def _time_of_time(state: Any) -> float:
    return float(state.position)


def _time_of_vector(state: Any) -> float:
    return float(state[0])


def _bound(value: float | None) -> float | None:
    return None if value is None else as_scalar("step_bound", value, low=0.0, high=1.0)


def _evaluator(agents: Sequence[Agent], ego: EgoShape, checker: Checker, times: Array | None) -> RiskEvaluator:
    if times is None:
        times = agents[0].times if agents else np.zeros(1)
    return RiskEvaluator(tuple(agents), ego, checker, np.asarray(times, dtype=float))
