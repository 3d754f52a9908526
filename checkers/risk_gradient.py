"""How the risk of a trajectory changes with its poses."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from checkers.agents import AGENTS, Prediction
from checkers.risk import DEPENDENCE, Risk
from checkers.validate import Array, InputError, as_array, as_option, as_tuple


def trajectory_risk_gradient(
    risks: Sequence[Risk],
    gradients: Sequence[Any],
    predictions: Sequence[Prediction],
    dependence: str = "independent",
) -> Array:
    """The gradient of `trajectory_risk(...).total`, before its cap at 1, with every pose.

    R = Σ_z w_z (1 − Π_t (1 − r_tz)) changes with r_tz by w_z Π_{s≠t} (1 − r_sz); the product is summed as log1p over
    the steps before and after t, never divided, so a risk of 1 is no special case and small ones keep their digits.

    Args:
        risks: one per agent, values (…, T, K).
        gradients: one per agent, (…, T, K, 3), as `Checker.gradient` gives them.
        predictions: the agents, in the same order.
        dependence: "independent" or "boole".

    Returns:
        (…, T, 3): with x, y [1/m] and heading [1/rad] of each pose.

    Raises:
        InputError: on unequal lengths or shapes.
    """
    as_option("dependence", dependence, DEPENDENCE)
    as_tuple("risks", risks, Risk)
    as_tuple("gradients", gradients)
    as_tuple("predictions", predictions, *AGENTS)
    if not len(risks) == len(gradients) == len(predictions) or not len(risks):
        raise InputError(
            "gradients: expected as many as risks and predictions and at least one, "
            f"got {len(gradients)} for {len(risks)} and {len(predictions)}"
        )
    total: Array | None = None
    for i, (risk, gradient, pred) in enumerate(zip(risks, gradients, predictions, strict=True)):
        value, change = risk.value, as_array(f"gradients[{i}]", gradient, (*risk.value.shape, 3), finite=False)
        steps_modes = pred.means.shape[:2]
        whole = value.shape[-2:] == (steps_modes[0], 1)
        if value.shape[-2:] != steps_modes and not whole:
            raise InputError(f"risks[{i}].value: expected (..., {steps_modes}), got {value.shape}")
        weights = np.ones((steps_modes[0], 1)) if whole else pred.step_weights
        if dependence == "independent":
            if pred.modes == "persistent":
                weights = weights * _others_survive(value)
            else:
                weights = weights * _others_survive((weights * value).sum(axis=-1, keepdims=True))
        part = (weights[..., None] * change).sum(axis=-2)
        if total is not None and part.shape != total.shape:
            raise InputError(f"gradients[{i}]: expected the steps of the first agent, got {change.shape}")
        total = part if total is None else total + part
    return total if total is not None else np.zeros(0)


def _others_survive(risk: Array) -> Array:
    """Π (1 − r) over all steps but one, for each step of risk (…, T, K)."""
    with np.errstate(divide="ignore"):
        logs = np.log1p(-np.minimum(risk, 1.0))
    before = np.zeros_like(logs)
    after = np.zeros_like(logs)
    before[..., 1:, :] = np.cumsum(logs[..., :-1, :], axis=-2)
    after[..., :-1, :] = np.cumsum(logs[..., :0:-1, :], axis=-2)[..., ::-1, :]
    survival: Array = np.exp(before + after)
    return survival
