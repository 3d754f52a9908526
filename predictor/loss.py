"""Likelihoods of mixtures of trajectories, and the loss `α L2 + NLL` (Jasour et al. 2021, section VI-D)."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from predictor.network import Mixture

LOG_2PI = math.log(2.0 * math.pi)


def loss(mixture: Mixture, truth: Tensor, alpha: float, joint: bool) -> Tensor:
    """α L2 + NLL, both per predicted step, averaged over the batch.

    With `joint`, NLL is the mean of the whole trajectory's and of the steps' own. The first alone hardly minds how
    large errors that persist are stated (twice too large costs R log 2 of 2 T densities), and risk depends on it.

    Args:
        mixture: as stated by the network.
        truth: (N, T, 2), in the network's units.
        alpha: weight of the L2 term.
        joint: whether modes and factors are drawn once per trajectory.
    """
    value = nll(mixture, truth, False)
    if joint:
        value = 0.5 * (value + nll(mixture, truth, True))
    return alpha * best_mode_error(mixture, truth).mean() + value.mean()


def nll(mixture: Mixture, truth: Tensor, joint: bool) -> Tensor:
    """(N,) negative log-likelihood per predicted step [nat]: of the whole trajectory, or of each step on its own."""
    if joint:
        return -joint_log_likelihood(mixture, truth) / truth.shape[1]
    return -marginal_log_likelihood(mixture, truth).mean(dim=1)


def best_mode_error(mixture: Mixture, truth: Tensor) -> Tensor:
    """(N,) mean distance over time of the mode nearest to the truth: only that mode learns, so modes stay apart.

    The paper does not say how modes enter its L2 term.
    """
    distance: Tensor = torch.linalg.vector_norm(mixture.means - truth.unsqueeze(2), dim=-1)
    return distance.mean(dim=1).amin(dim=1)


def joint_log_likelihood(mixture: Mixture, truth: Tensor) -> Tensor:
    """(N,) log-density of whole trajectories (N, T, 2): one mode and one ξ each; the weights are those of step 0."""
    return torch.logsumexp(mixture.log_weights[:, 0] + mode_log_likelihood(mixture, truth), dim=1)


def mode_log_likelihood(mixture: Mixture, truth: Tensor) -> Tensor:
    """(N, K) log-density of the trajectory given the mode, linear in T.

    The covariance over all steps is block-diagonal plus B Bᵀ: by the matrix determinant lemma and Woodbury's identity
    only M = I + B̃ᵀB̃, R by R, is factorised (B̃ = L⁻¹B, r̃ = L⁻¹r). The quadratic form r̃ᵀ(I + B̃B̃ᵀ)⁻¹r̃ is evaluated as the
    minimum |r̃ − B̃ξ|² + |ξ|² at ξ = M⁻¹B̃ᵀr̃, which cancels nothing in single precision.
    """
    residual = whitened(mixture.roots, (truth.unsqueeze(2) - mixture.means).unsqueeze(-1)).squeeze(-1)  # (N, T, K, 2)
    log_det = 2.0 * diagonal(mixture.roots).log().sum(dim=(1, 3))
    steps = truth.shape[1]
    if mixture.factors is None:
        return -0.5 * (residual.square().sum(dim=(1, 3)) + log_det + 2 * steps * LOG_2PI)
    factors = whitened(mixture.roots, mixture.factors)  # (N, T, K, 2, R)
    inner = torch.einsum("ntkir,ntkis->nkrs", factors, factors)
    lower = torch.linalg.cholesky(inner + torch.eye(inner.shape[-1], dtype=inner.dtype, device=inner.device))
    pull = torch.einsum("ntkir,ntki->nkr", factors, residual)
    xi = torch.cholesky_solve(pull.unsqueeze(-1), lower).squeeze(-1)
    rest = residual - torch.einsum("ntkir,nkr->ntki", factors, xi)
    quadratic = rest.square().sum(dim=(1, 3)) + xi.square().sum(dim=-1)
    log_det = log_det + 2.0 * diagonal(lower).log().sum(dim=-1)
    return -0.5 * (quadratic + log_det + 2 * steps * LOG_2PI)


def marginal_log_likelihood(mixture: Mixture, truth: Tensor) -> Tensor:
    """(N, T) log-density of each step's position on its own."""
    roots = mixture.roots
    if mixture.factors is not None:
        roots = cholesky(covariances(mixture))
    residual = whitened(roots, (truth.unsqueeze(2) - mixture.means).unsqueeze(-1)).squeeze(-1)
    log_det = diagonal(roots).log().sum(dim=-1)
    log_density = -0.5 * residual.square().sum(dim=-1) - log_det - LOG_2PI
    return torch.logsumexp(mixture.log_weights + log_density, dim=-1)


def covariances(mixture: Mixture) -> Tensor:
    """(N, T, K, 2, 2) of the position: both parts."""
    own = mixture.roots @ mixture.roots.transpose(-1, -2)
    return own if mixture.factors is None else own + mixture.factors @ mixture.factors.transpose(-1, -2)


def cholesky(covariance: Tensor) -> Tensor:
    """Lower factor of (..., 2, 2), written out: the batched routine is many times slower at this size."""
    a = covariance[..., 0, 0].sqrt()
    b = covariance[..., 1, 0] / a
    c = (covariance[..., 1, 1] - b.square()).clamp_min(1e-12).sqrt()
    return torch.stack([a, torch.zeros_like(a), b, c], dim=-1).view(covariance.shape)


def whitened(roots: Tensor, values: Tensor) -> Tensor:
    """L⁻¹ v for lower (..., 2, 2) and v (..., 2, R)."""
    first = values[..., 0, :] / roots[..., 0, 0, None]
    second = (values[..., 1, :] - roots[..., 1, 0, None] * first) / roots[..., 1, 1, None]
    return torch.stack([first, second], dim=-2)


def diagonal(matrices: Tensor) -> Tensor:
    """Last two axes' diagonal."""
    return matrices.diagonal(dim1=-2, dim2=-1)
