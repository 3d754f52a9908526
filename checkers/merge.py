"""The mixture taken whole: one mode per step with the moments of all."""

from __future__ import annotations

from math import comb

import numpy as np

from checkers.agents import AGENTS, Prediction
from checkers.prediction import MomentPrediction
from checkers.validate import Array, as_instance


def merged(pred: Prediction, order: int) -> MomentPrediction:
    """The agent without its modes: per step the central moments, to `order`, of the whole mixture.

    E[(x − μ)^i (y − μ)^j] = Σ_k w_k Σ C(i, p) C(j, q) d_k^(i−p, j−q) m_k[p, q] with d_k the offset of the
    mode's mean. What persisted with a mode is forgotten: only the step's own distribution is kept.
    """
    modes = as_instance("pred", pred, *AGENTS).moments(order)
    weights = modes.step_weights
    # from one of the modes, so that city coordinates cost no digits
    local = modes.means - modes.means[:, :1]
    centre = (weights[..., None] * local).sum(axis=1)
    mean, offset = modes.means[:, 0] + centre, local - centre[:, None]
    out = np.full((len(mean), 1, order + 1, order + 1), np.nan)
    powers = [np.ones_like(offset)]
    for _ in range(order):
        powers.append(powers[-1] * offset)
    for i in range(order + 1):
        for j in range(order + 1 - i):
            total: Array = np.zeros_like(weights)
            for p in range(i + 1):
                for q in range(j + 1):
                    shift = powers[i - p][..., 0] * powers[j - q][..., 1]
                    total = total + comb(i, p) * comb(j, q) * shift * modes.central_moments[..., p, q]
            out[:, 0, i, j] = (weights * total).sum(axis=1)
    out[:, 0, 1, 0] = out[:, 0, 0, 1] = 0.0  # exact by definition of the mean
    return MomentPrediction(
        modes.times, np.ones(1), mean[:, None], out, name=modes.name, length=modes.length, width=modes.width
    )
