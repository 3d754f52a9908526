"""Other models' outputs as predictions: a function for each form they come in.

Tensors are taken as they are, of numpy, torch or anything `numpy.asarray` understands. A model's own frame is undone
by `frame`. Nothing is guessed: what a form leaves open is a required argument.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from checkers.prediction import GaussianMixturePrediction
from checkers.validate import Array, InputError, as_array, as_flag, as_instance, as_option, as_scalar, as_times
from predictor.frames import Frames
from predictor.growth import Growth

SPREADS = ("sigma", "log_sigma")


def from_gmm2d(
    log_pis: Any,
    mus: Any,
    log_sigmas: Any,
    corrs: Any,
    times: Any,
    *,
    modes: str = "persistent",
    frame: Frames | None = None,
    **labels: Any,
) -> GaussianMixturePrediction:
    """One agent's mixture per step, in the arrays of the GMM2D of Trajectron++ (Salzmann et al. 2020).

    Args:
        log_pis: (T, K), or (K,) for all steps; logarithms of the mode weights, up to a constant.
        mus: (T, K, 2) [m], or (T, 2K) as its constructor takes them. Leading axes of length 1 are dropped, here and
            below: samples and agents are told apart by the caller.
        log_sigmas: like `mus`, logarithms of the standard deviations along x and y.
        corrs: (T, K) correlations, in (−1, 1).
        times: (T,) of the steps [s].
        modes: "persistent": a mode, such as the latent z of Trajectron++, is drawn once per trajectory; "per_step":
            weights differ between steps and a mode is drawn at each.
        frame: of one target, if the arrays are in its frame; None: they are in the world.
        labels: name, length, width, headings (T, K) as in `GaussianMixturePrediction`; headings in the same frame.

    Raises:
        InputError: naming the array.
    """
    times = as_times("times", times)
    corrs = as_array("corrs", _trimmed("corrs", corrs, 2), (len(times), "K"))
    shape = (*corrs.shape, 2)
    means = as_array("mus", _components("mus", mus, corrs.shape[1]), shape)
    log_sigmas = as_array("log_sigmas", _components("log_sigmas", log_sigmas, corrs.shape[1]), shape, largest=20.0)
    covariances = _covariances(np.exp(log_sigmas), corrs)
    given = _plain("log_pis", log_pis)
    given = _trimmed("log_pis", given, 1 if given.size == corrs.shape[1] else 2)
    log_weights = as_array("log_pis", given, corrs.shape if given.ndim == 2 else corrs.shape[1:])
    weights = _softmax(log_weights)
    return _prediction(times, weights, means, covariances, modes, frame, labels)


def from_mode_gaussians(
    probabilities: Any,
    trajectories: Any,
    times: Any,
    *,
    spread: str,
    log_sigma_range: tuple[float, float] | None = None,
    largest_corr: float | None = None,
    normalise: bool = False,
    frame: Frames | None = None,
    **labels: Any,
) -> GaussianMixturePrediction:
    """One agent's modes, a Gaussian per step each, as MTR (Shi et al. 2022) and the models of UniTraj give them.

    Mind what a model's loss did with its raw outputs and state it here. MTR: `spread="log_sigma"`,
    `log_sigma_range=(-1.609, 5.0)`, `largest_corr=0.5`, and `normalise=True` for the few modes kept of many. The models
    of UniTraj give probabilities and standard deviations: `spread="sigma"`.

    Args:
        probabilities: (K,) of the modes; each holds for a whole trajectory.
        trajectories: (K, T, 5 or more): x, y [m], spread along x, spread along y, correlation; the rest is ignored.
        times: (T,) of the steps [s].
        spread: what the third and fourth are: "sigma" [m] or "log_sigma".
        log_sigma_range: limits the model's loss put on the logarithm; None: none.
        largest_corr: limit the loss put on the size of the correlation; None: none.
        normalise: divide probabilities by their sum, instead of refusing a sum other than 1.
        frame, labels: as in `from_gmm2d`.

    Raises:
        InputError: naming the array and the index.
    """
    times = as_times("times", times)
    as_option("spread", spread, SPREADS)
    given = _trimmed("trajectories", trajectories, 3)
    values = as_array("trajectories", given[..., :5] if given.ndim else given, ("K", len(times), 5))
    sigmas, corrs = values[..., 2:4], values[..., 4]
    if spread == "sigma":
        bad = np.argwhere(sigmas <= 0)
        if len(bad):
            k, t, axis = (int(i) for i in bad[0])
            raise InputError(f"trajectories[{k}, {t}, {axis + 2}]: expected sigma > 0, got {sigmas[k, t, axis]:g}")
        log_sigmas: Array = np.log(sigmas)
    else:
        log_sigmas = as_array(
            "trajectories[..., 2:4]", sigmas, sigmas.shape, largest=20.0 if log_sigma_range is None else 1e9
        )
    if log_sigma_range is not None:
        lowest, highest = as_array("log_sigma_range", log_sigma_range, (2,), largest=20.0).tolist()
        if not lowest < highest:
            raise InputError(f"log_sigma_range: expected (lowest, highest), got {(lowest, highest)}")
        log_sigmas = np.clip(log_sigmas, lowest, highest)
    if largest_corr is not None:
        largest_corr = as_scalar("largest_corr", largest_corr, low=0.0, high=1.0)
        corrs = np.clip(corrs, -largest_corr, largest_corr)
    covariances = np.swapaxes(_covariances(np.exp(log_sigmas), corrs), 0, 1)
    weights = _weights(probabilities, len(values), normalise)
    means = np.swapaxes(values[..., :2], 0, 1)
    return _prediction(times, weights, means, covariances, "persistent", frame, labels)


def from_trajectories(
    probabilities: Any,
    trajectories: Any,
    times: Any,
    growth: Growth,
    *,
    normalise: bool = False,
    frame: Frames | None = None,
    **labels: Any,
) -> GaussianMixturePrediction:
    """One agent's trajectories with probabilities and no spread, as submitted to Argoverse 2 and nuScenes.

    A trajectory without a spread states that the future is known exactly, and a risk computed from it would be 0 or 1.
    So the spread is an argument: `PowerGrowth.fit` finds one from recorded futures.

    Args:
        probabilities: (K,) of the trajectories.
        trajectories: (K, T, 2) [m].
        times: (T,) of the steps [s], from the last observation on.
        growth: gives the covariance about each trajectory at each time.
        normalise: as in `from_mode_gaussians`.
        frame, labels: as in `from_gmm2d`.

    Raises:
        InputError: naming the array and the index.
    """
    times = as_times("times", times)
    if not isinstance(growth, Growth):
        raise InputError(f"growth: expected a model of the spread such as PowerGrowth, got {type(growth).__name__}")
    values = as_array("trajectories", _trimmed("trajectories", trajectories, 3), ("K", len(times), 2))
    covariances = np.swapaxes(growth.covariances(times, values), 0, 1)
    weights = _weights(probabilities, len(values), normalise)
    return _prediction(times, weights, np.swapaxes(values, 0, 1), covariances, "persistent", frame, labels)


def _prediction(
    times: Array,
    weights: Array,
    means: Array,
    covariances: Array,
    modes: str,
    frame: Frames | None,
    labels: dict[str, Any],
) -> GaussianMixturePrediction:
    unknown = sorted(set(labels) - {"name", "length", "width", "headings"})
    if unknown:
        raise InputError(f"{unknown[0]}: expected one of name, length, width, headings; got {unknown[0]!r}")
    if frame is not None:
        as_instance("frame", frame, Frames)
        if len(frame.origins) != 1:
            raise InputError(f"frame: expected the frame of one target, got {len(frame.origins)}")
        means, covariances = frame.to_world(means[None])[0], frame.covariances_to_world(covariances[None])[0]
        if labels.get("headings") is not None:
            labels = {**labels, "headings": _plain("headings", labels["headings"]) + frame.angles[0]}
    if labels.get("headings") is not None:
        labels = {**labels, "headings": _plain("headings", labels["headings"])}
    return GaussianMixturePrediction(times, weights, means, covariances, modes, **labels)


def _plain(name: str, value: Any) -> Array:
    """An array of what may be a tensor on another device that still counts gradients."""
    for step in ("detach", "cpu"):
        if hasattr(value, step):
            value = getattr(value, step)()
    try:
        if np.iscomplexobj(value):
            raise TypeError("complex numbers")
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name}: expected an array of numbers, got {type(value).__name__}: {error}") from None


def _trimmed(name: str, value: Any, axes: int) -> Array:
    """With leading axes of length 1 dropped down to that many."""
    array = _plain(name, value)
    while array.ndim > axes and len(array) == 1:
        array = array[0]
    return array


def _components(name: str, value: Any, modes: int) -> Array:
    """(T, K, 2) from that or from (T, 2K)."""
    array = _plain(name, value)
    if array.ndim >= 2 and array.shape[-1] == 2 * modes and not (array.shape[-1] == 2 and array.shape[-2] == modes):
        array = array.reshape(*array.shape[:-1], modes, 2)
    elif modes == 1 and array.ndim == 2:
        array = array[:, None]
    return _trimmed(name, array, 3)


def _covariances(sigmas: Array, corrs: Array) -> Array:
    bad = np.argwhere(~(np.abs(corrs) < 1))
    if len(bad):
        index = tuple(int(i) for i in bad[0])
        raise InputError(f"correlation{list(index)}: expected a number in (-1, 1), got {corrs[index]:g}")
    cross = corrs * sigmas[..., 0] * sigmas[..., 1]
    rows = [np.stack([sigmas[..., 0] ** 2, cross], -1), np.stack([cross, sigmas[..., 1] ** 2], -1)]
    return np.stack(rows, -2)


def _softmax(log_weights: Array) -> Array:
    raised = np.exp(log_weights - log_weights.max(axis=-1, keepdims=True))
    weights: Array = raised / raised.sum(axis=-1, keepdims=True)
    return weights


def _weights(probabilities: Any, modes: int, normalise: bool) -> Array:
    weights = as_array("probabilities", _trimmed("probabilities", probabilities, 1), (modes,))
    if as_flag("normalise", normalise):
        if np.any(weights < 0) or not weights.sum() > 0:
            raise InputError(f"probabilities: expected numbers >= 0, not all 0, got {weights.tolist()}")
        weights = weights / weights.sum()
    return weights
