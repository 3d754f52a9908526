"""Risk values, and their way from marginals to a trajectory (math: steps, then modes, then agents)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from checkers.agents import AGENTS, Prediction
from checkers.kind import Kind
from checkers.validate import Array, InputError, as_option, as_tuple


@dataclass(frozen=True, eq=False)
class Risk:
    """Probability that the agent is inside the ego shape, per step and mode, given the mode.

    Attributes:
        value: (…, T, K) in [0, 1].
        kind: what the value claims to be.
        error: (…, T, K) absolute error bound of the numerics, or None if the backend gives none.
        lower: (…, T, K) lower bound of the risk, or None.
        checker: name of the backend.
    """

    value: Array
    kind: Kind
    error: Array | None = None
    lower: Array | None = None
    checker: str = ""

    def __post_init__(self) -> None:
        # NaN, "not known", is allowed here and stays NaN in every sum
        wrong = (self.value < 0.0) | (self.value > 1.0)
        if wrong.any():
            bad = np.argwhere(wrong)
            got = self.value[tuple(bad[0])]
            raise InputError(f"risk.value{bad[0].tolist()}: expected a probability in [0, 1], got {got!r}")

    @classmethod
    def unchecked(cls, value: Array, kind: Kind, error: Array | None, lower: Array | None, checker: str) -> Risk:
        """For backends, whose values are probabilities by construction: the check costs as much as a bound."""
        made = object.__new__(cls)
        made.__dict__.update(value=value, kind=kind, error=error, lower=lower, checker=checker)
        return made


@dataclass(frozen=True, eq=False)
class TrajectoryRisk:
    """Risk of a whole trajectory. Leading batch axes of the marginals stay in front of every shape.

    Attributes:
        total: () risk of colliding with any agent at any step, under `dependence`.
        per_agent: (A,) the same for each agent; `total` is their sum, at most 1 (valid without independence of agents).
        per_step: (T,) marginal risk of each step, summed over agents, at most 1.
        boole: () sum of all marginals, at most 1: an upper bound under any dependence.
        max_step: () largest marginal of one agent at one step: a lower bound under any dependence.
        kind: claim of the numbers, given `dependence`.
        dependence: "independent" (over time, given a persistent mode) or "boole".
    """

    total: Array
    per_agent: Array
    per_step: Array
    boole: Array
    max_step: Array
    kind: Kind
    dependence: str = "independent"

    @property
    def frechet(self) -> tuple[Array, Array]:
        """(lower, upper): holds under any dependence between steps and agents if the marginals are exact."""
        return self.max_step, self.boole


DEPENDENCE = ("independent", "boole")
PATH_DEPENDENCE = ("independent", "persistent", "boole")


def trajectory_risk(
    risks: Sequence[Risk], predictions: Sequence[Prediction], dependence: str = "independent"
) -> TrajectoryRisk:
    """Combine marginals over steps, modes and agents (Jasour et al. 2021, eq. 4 and section IV-B).

    A persistent mode gives Σ_z w_z (1 − Π_t (1 − r_tz)); per-step modes give 1 − Π_t (1 − Σ_z w_tz r_tz). Products
    are summed as log1p and returned by expm1, so risks far below 1e-16 survive. Time independence is an
    assumption, not a bound: under negative dependence the truth may be larger; `dependence="boole"` never is.

    Args:
        risks: one `Risk` per agent, values (…, T, K), or (…, T, 1) of the mixture taken whole.
        predictions: the agents, in the same order.
        dependence: "independent" or "boole".

    Raises:
        InputError: on unequal lengths or shapes. No agents means no risk, but also no shape: pass at least one.
    """
    as_option("dependence", dependence, DEPENDENCE)
    as_tuple("risks", risks, Risk)
    as_tuple("predictions", predictions, *AGENTS)
    if len(risks) != len(predictions) or not risks:
        raise InputError(
            f"risks: expected one per prediction and at least one, got {len(risks)} for {len(predictions)}"
        )
    agents, steps, booles, tops = [], [], [], []
    for index, (risk, pred) in enumerate(zip(risks, predictions, strict=True)):
        steps_modes = pred.means.shape[:2]
        whole = risk.value.shape[-2:] == (steps_modes[0], 1)  # of the mixture taken whole, or of a single mode
        if risk.value.shape[-2:] != steps_modes and not whole:
            raise InputError(f"risks[{index}].value: expected (..., {pred.means.shape[:2]}), got {risk.value.shape}")
        if len(pred.times) != len(predictions[0].times) or np.abs(pred.times - predictions[0].times).max() > 1e-6:
            raise InputError(
                f"predictions[{index}].times: expected one time grid for all agents; resample with .at(times)"
            )
        marginal = risk.value[..., 0] if whole else (pred.step_weights * risk.value).sum(axis=-1)
        if dependence == "boole":
            total = marginal.sum(axis=-1)
        elif pred.modes == "persistent" and not whole:
            total = (pred.weights * _any(risk.value, axis=-2)).sum(axis=-1)
        else:
            total = _any(marginal, axis=-1)
        agents.append(np.minimum(total, 1.0) + 0.0)  # no negative zero
        steps.append(marginal)
        booles.append(marginal.sum(axis=-1))
        tops.append(marginal.max(axis=-1))
    if len({m.shape for m in steps}) != 1:
        raise InputError(f"risks: expected one time grid for all agents, got shapes {[m.shape for m in steps]}")
    per_agent = np.stack(agents, axis=-1)
    summed = dependence == "boole" or len(risks) > 1  # a sum over events that may coincide is a bound
    return TrajectoryRisk(
        total=np.minimum(per_agent.sum(axis=-1), 1.0),
        per_agent=per_agent,
        per_step=np.minimum(np.sum(steps, axis=0), 1.0),
        boole=np.minimum(np.sum(booles, axis=0), 1.0),
        max_step=np.minimum(np.max(tops, axis=0), 1.0),
        kind=Kind.weakest([r.kind for r in risks] + ([Kind.UPPER_BOUND] if summed else [])),
        dependence=dependence,
    )


def _any(risk: Array, axis: int) -> Array:
    """1 − Π (1 − r) without losing small r; r = 1 gives 1."""
    with np.errstate(divide="ignore"):
        result: Array = -np.expm1(np.log1p(-np.minimum(risk, 1.0)).sum(axis=axis))
    return result
