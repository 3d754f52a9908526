"""A path's risk bounded by second moments over two times: no independence, no family of distributions."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from checkers.base import as_poses
from checkers.control_prediction import ControlPrediction
from checkers.over_time import covariance_over_time
from checkers.registry import checker
from checkers.risk import TrajectoryRisk, trajectory_risk
from checkers.shapes import EgoShape
from checkers.validate import Array, InputError

_TINY = 1e-9  # of a spread: below it counts as that, so that nothing is divided by zero


def hunter_bound(poses: Any, pred: ControlPrediction, ego: EgoShape) -> TrajectoryRisk:
    """Upper bound of the probability that the agent enters the ego's shape at any step of a path.

    Hunter (1976): over a tree of steps, P(any) ≤ P(root) + Σ P(t, but not its parent) = Σ P(t) − Σ P(t and its parent).
    The root is the step of the largest marginal bound, the tree leads from it along time to both sides. P(root) is
    Marshall & Olkin's bound; that of a step without its parent is the mean of the least quadratic in both positions
    that is ≥ 0 everywhere and ≥ 1 where one is inside and the other is not, by the S-procedure: a semidefinite
    program, whose answer is lifted until it holds. Never above Boole's sum of the marginal bounds.

    Args:
        poses: (T, 3) x, y [m], heading [rad] at the prediction's times.
        pred: whose mean and covariance over time are known.
        ego: shape; for one of several pieces the bound is summed over them.

    Returns:
        `dependence` "hunter"; `per_step` is what each step adds.
    """
    if not isinstance(pred, ControlPrediction):
        raise InputError(
            f"prediction: two-time moments are known of a ControlPrediction, got {type(pred).__name__}; "
            "use path_risk(..., dependence='boole')"
        )
    poses = as_poses(poses, len(pred.times))
    if poses.ndim != 2:
        raise InputError(f"poses: expected shape (T, 3), got {poses.shape}")
    known = pred.moments(2)
    marginal = checker("marshall-olkin")(poses, known, ego)
    over_time = covariance_over_time(pred)
    offsets, forms = ego.pieces(known)
    added = np.zeros_like(marginal.value)
    for k, covariance in enumerate(over_time):
        value = marginal.value[:, k]
        root = int(value.argmax())
        added[root, k] = value[root]
        forward = [(t, t - 1) for t in range(root + 1, len(value))]
        for t, parent in [*forward, *((t, t + 1) for t in range(root))]:
            pair = np.r_[2 * parent : 2 * parent + 2, 2 * t : 2 * t + 2]
            mean = known.means[[parent, t], k] - poses[[parent, t], :2]
            without = sum(
                _entered(mean, covariance[np.ix_(pair, pair)], poses[[parent, t], 2], form, offset)
                for form, offset in zip(forms, offsets, strict=True)
            )
            added[t, k] = min(value[t], without)
    steps = added @ known.weights
    total = np.minimum(steps.sum(), 1.0)
    summary = trajectory_risk([marginal], [known], "boole")
    return replace(summary, total=total, per_agent=total[None], per_step=np.minimum(steps, 1.0), dependence="hunter")


def _entered(mean: Array, covariance: Array, headings: Array, form: Array, offset: Array) -> float:
    """P(the second position is in its ellipse, the first is not in its own) ≤ this.

    Args:
        mean: (2, 2) of both positions, relative to the ego's.
        covariance: (4, 4) of both together.
        headings: (2,) of the ego.
        form, offset: ellipse in the ego frame.
    """
    # in both the first position and the way from it to the second, each scaled by its own spread: steps are small
    way = np.kron([[1.0, 0.0], [-1.0, 1.0]], np.eye(2))
    moved = way @ covariance @ way.T
    spread = np.sqrt(np.maximum(np.diag(moved), _TINY**2))
    basis = np.linalg.inv(way) * spread
    moments = np.eye(5)
    moments[1:, 1:] = 0.5 * (moved + moved.T) / np.outer(spread, spread)
    moments[0, 0] = 1.0
    sets = []
    for i, heading in enumerate(headings):
        c, s = np.cos(heading), np.sin(heading)
        turn = np.array([[c, s], [-s, c]])
        # rows of the whitened, ego-frame position in terms of 1 and the four scaled deviations
        row = np.column_stack([turn @ mean[i] - offset, turn @ basis[2 * i : 2 * i + 2]])
        inside = row.T @ form @ row
        inside[0, 0] -= 1.0
        sets.append(inside)
    return _least_quadratic(moments, sets[1], sets[0])


def _least_quadratic(moments: Array, inside: Array, outside: Array) -> float:
    """min ⟨Q, M⟩ over Q ⪰ 0, Q − e₀e₀ᵀ + λ G_in − μ G_out ⪰ 0, λ, μ ≥ 0, certified; 1 if the solver fails."""
    import clarabel  # noqa: PLC0415  0.1 s, needed here only
    from scipy import sparse  # noqa: PLC0415

    inside, outside = inside / np.abs(inside).max(), outside / np.abs(outside).max()
    columns, rows = np.tril_indices(len(moments))
    scale = np.where(rows == columns, 1.0, np.sqrt(2.0))
    count = len(rows)
    flat_in, flat_out, flat_m = ((g[rows, columns] * scale) for g in (inside, outside, moments))
    first = np.zeros(count)
    first[0] = 1.0
    constraint = np.zeros((2 * count + 2, count + 2))
    constraint[:count, :count] = constraint[count : 2 * count, :count] = -np.eye(count)
    constraint[count : 2 * count, count], constraint[count : 2 * count, count + 1] = -flat_in, flat_out
    constraint[2 * count :, count:] = -np.eye(2)
    target = np.concatenate([np.zeros(count), -first, np.zeros(2)])
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    cones = [clarabel.PSDTriangleConeT(len(moments))] * 2 + [clarabel.NonnegativeConeT(2)]
    cost = np.concatenate([flat_m, np.zeros(2)])
    nothing = sparse.csc_matrix((count + 2, count + 2))
    answer = clarabel.DefaultSolver(nothing, cost, sparse.csc_matrix(constraint), target, cones, settings).solve()
    x = np.asarray(answer.x)
    if str(answer.status) not in ("Solved", "AlmostSolved") or not np.isfinite(x).all():
        return 1.0
    found = np.zeros_like(moments)
    found[rows, columns] = found[columns, rows] = x[:count] / scale
    inner, outer = np.maximum(x[count:], 0.0)
    rest = found + inner * inside - outer * outside
    rest[0, 0] -= 1.0
    # what the solver left negative, and rounding, is lifted away; a lift costs its share of the trace
    size = float(np.abs(found).max() + inner + outer + 1.0)
    lowest = min(float(np.linalg.eigvalsh(m)[0]) for m in (found, rest))
    lift = max(0.0, -lowest) + 1e-13 * size
    bound = float((found * moments).sum() + lift * np.trace(moments)) + 1e-13 * size * len(moments) ** 2
    return float(min(max(bound, 0.0), 1.0))
