"""What the paper's network is measured against: a small MLP of today's kind (physics is in `predictor.kinematic`)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from predictor.network import (
    EncoderDecoder,
    Head,
    Inputs,
    Mixture,
    MixtureNetwork,
    NetworkConfig,
    flat,
    given,
    mlp,
    pooled,
)


class Residual(nn.Module):
    """x + W₂ ReLU(W₁ LayerNorm(x))."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.LayerNorm(width), nn.Linear(width, 2 * width), nn.ReLU(), nn.Linear(2 * width, width)
        )

    def forward(self, x: Tensor) -> Tensor:
        """(N, width)."""
        y: Tensor = x + self.layers(x)
        return y


class FeedForward(MixtureNetwork):
    """A residual MLP of about the LSTM's size that states all steps at once.

    The past enters as one flat vector of steps taken, lanes and ego future as in the LSTM; two residual blocks; a code
    of 16 numbers per predicted step, turned into that step's mixture by the same linear head.
    """

    CODE = 16

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__(config)
        h = config.hidden
        self.past = nn.Linear(2 * config.observed, h)
        self.lanes = mlp(2, h) if config.lanes else None
        self.ego = mlp(2 * config.predicted, h) if config.ego_future else None
        self.mix = nn.Linear(h * (1 + config.lanes + config.ego_future), h)
        self.blocks = nn.Sequential(Residual(h), Residual(h))
        self.steps = nn.Linear(h, config.predicted * self.CODE)
        self.head = Head(config, self.CODE)

    def forward(self, inputs: Inputs) -> Mixture:
        """The mixture of each step."""
        past = inputs.past
        # where it is, and each velocity
        moved = torch.cat([past[:, -1:], torch.diff(past, dim=1) / self.config.dt], dim=1)
        codes = [self.past(moved.flatten(1))]
        if self.lanes is not None:
            codes.append(pooled(self.lanes, given("lanes", inputs.lanes)))
        if self.ego is not None:
            codes.append(flat(self.ego, given("ego_future", inputs.ego)))
        latent = self.blocks(self.mix(torch.cat(codes, dim=-1)))
        steps = self.steps(latent).view(-1, self.config.predicted, self.CODE)
        mixture: Mixture = self.head(steps.relu(), past)
        return mixture


def build(config: NetworkConfig) -> MixtureNetwork:
    """The network of a configuration, with fresh weights."""
    return EncoderDecoder(config) if config.architecture == "lstm" else FeedForward(config)
