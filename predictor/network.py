"""The conditional LSTM encoder-decoder, whole (Jasour et al. 2021, section VI and VII-A).

Encoder: at each observed step the position, the lanes and the ego's future go through an MLP each (two layers, ReLU);
their codes, side by side, enter an LSTM, whose last hidden state is the latent vector. Decoder: an LSTM that reads the
latent vector at each predicted step, and one linear layer that turns each hidden state into the mixture of that step.

Beyond the paper, by configuration: a head whose errors persist over time (`head="persistent"`), weights that belong
to the trajectory (`weights="persistent"`), and means stated relative to the constant-velocity course
(`anchor="velocity"`). Where the paper is silent: lanes are a set of points, so their MLP runs over each point and the
largest value of each feature is kept (Qi et al. 2017, PointNet); the ego's future is one flat vector.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import softplus

from checkers.validate import Array, InputError, as_option, as_scalar

TARGETS = ("positions", "controls")
HEADS = ("independent", "persistent")
WEIGHTS = ("per_step", "persistent")
ANCHORS = ("none", "velocity", "growing")
ARCHITECTURES = ("lstm", "mlp")
# what is stated with a growing anchor, relative to constant velocity, is in units that grow so with time
GROWTH = 1.5


@dataclass(frozen=True)
class NetworkConfig:
    """What the network reads and states; the defaults are the paper's.

    Attributes:
        architecture: "lstm" (the paper's), or "mlp" (`predictor.baselines.FeedForward`).
        target: "positions", or "controls": change of speed and of heading per step.
        head: "independent" errors from step to step (the paper's), or "persistent": x_t = μ_t + B_t ξ + ε_t with one
            ξ ~ N(0, I) per trajectory. Controls are independent (`ControlPrediction` knows nothing else).
        weights: "per_step", or one set of mode weights for the whole trajectory ("persistent"; a persistent head has
            no other).
        lanes, ego_future: whether lane points and the ego's future are read.
        lane_points: how many of the nearest lane points are read.
        anchor: "none", or "velocity": positions are stated relative to constant velocity, by least squares over the
            last five observed steps, and the velocity of each observed step is read beside the position; or "growing":
            besides, deviations and spreads are stated in units that grow with time, as drivers' errors do: bounded
            states hardly say both 0.1 m at the first step and 10 m at the last.
        observed, predicted: number of steps.
        modes: of the mixture.
        hidden: width of the MLPs and of the LSTMs.
        rank: of B_t in a persistent head.
        dt: length of a step [s].
        scale: metres per unit of the network's positions; covariances scale with its square.
        origin: (2,) subtracted from positions first [m]; for networks that read world coordinates.
        normalised: whether positions are turned into the target's own frame before (`predictor.frames`).
        control_scale: change of speed [m/s] and of heading [rad] per unit of the network's controls.
        floor: least standard deviation of ε [m] (positions) or in units of `control_scale` (controls).

    Raises:
        InputError: naming the field.
    """

    architecture: str = "lstm"
    target: str = "positions"
    head: str = "independent"
    weights: str = "per_step"
    lanes: bool = False
    ego_future: bool = False
    lane_points: int = 48
    anchor: str = "none"
    observed: int = 20
    predicted: int = 30
    modes: int = 3
    hidden: int = 32
    rank: int = 2
    dt: float = 0.1
    scale: float = 10.0
    origin: tuple[float, float] = (0.0, 0.0)
    normalised: bool = True
    control_scale: tuple[float, float] = (0.1, 0.01)
    floor: float = 0.1

    def __post_init__(self) -> None:
        options = {
            "architecture": ARCHITECTURES,
            "target": TARGETS,
            "head": HEADS,
            "weights": WEIGHTS,
            "anchor": ANCHORS,
        }
        for name, valid in options.items():
            as_option(name, getattr(self, name), valid)
        for name, least in (
            ("observed", 5),
            ("predicted", 1),
            ("modes", 1),
            ("hidden", 1),
            ("rank", 1),
            ("lane_points", 1),
        ):
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or value < least:
                raise InputError(f"{name}: expected an integer >= {least}, got {value!r}")
        for name in ("dt", "scale", "floor"):
            as_scalar(name, getattr(self, name), low=0.0, strict=True)
        for name in ("lanes", "ego_future", "normalised"):
            if not isinstance(getattr(self, name), bool):
                raise InputError(f"{name}: expected true or false, got {getattr(self, name)!r}")
        for name in ("origin", "control_scale"):
            pair = getattr(self, name)
            if not isinstance(pair, tuple | list) or len(pair) != 2:
                raise InputError(f"{name}: expected two numbers, got {pair!r}")
            low = 0.0 if name == "control_scale" else -float("inf")
            both = tuple(as_scalar(name, v, low=low, strict=name == "control_scale") for v in pair)
            object.__setattr__(self, name, both)
        if self.head == "persistent" and self.weights != "persistent":
            raise InputError("weights: a persistent head has persistent weights, got 'per_step'")
        if self.target == "controls" and (self.head != "independent" or self.anchor != "none"):
            raise InputError("head: controls have independent errors and no anchor")

    @classmethod
    def from_dict(cls, values: Any) -> NetworkConfig:
        """From what `to_dict` gave; an unknown field is an error that lists the valid ones."""
        known = [f.name for f in fields(cls)]
        if not isinstance(values, dict):
            raise InputError(f"network: expected a mapping of {', '.join(known)}, got {type(values).__name__}")
        for name in values:
            if name not in known:
                raise InputError(f"network: expected fields {', '.join(known)}; got {name!r}")
        return cls(**values)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)

    @property
    def times(self) -> Array:
        """(T,) of the predicted steps [s]."""
        return self.dt * np.arange(1, self.predicted + 1, dtype=np.float64)

    @property
    def unit(self) -> float:
        """What distances in the network's units are multiplied with: metres, or for controls nothing."""
        return self.scale if self.target == "positions" else 1.0


class Inputs(NamedTuple):
    """What the network reads, in its own units (`scale`), target frame.

    past (N, P, 2); lanes (N, L, 2), NaN where there are fewer points, or None; ego (N, F, 2), NaN where there is none,
    or None.
    """

    past: Tensor
    lanes: Tensor | None = None
    ego: Tensor | None = None


class Mixture(NamedTuple):
    """What the network states, in its own units.

    log_weights (N, T, K), rows equal for persistent weights; means (N, T, K, 2); roots (N, T, K, 2, 2), the lower
    Cholesky factors of the covariance of ε_t; factors (N, T, K, 2, R) or None.
    """

    log_weights: Tensor
    means: Tensor
    roots: Tensor
    factors: Tensor | None = None


def mlp(inputs: int, width: int) -> nn.Sequential:
    """Two layers with ReLU."""
    return nn.Sequential(nn.Linear(inputs, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU())


class Head(nn.Module):
    """One linear layer from hidden states (N, T, H) to a mixture with positive definite covariances."""

    def __init__(self, config: NetworkConfig, hidden: int) -> None:
        super().__init__()
        self.config = config
        self.rank = config.rank if config.head == "persistent" else 0
        self.out = nn.Linear(hidden, config.modes * (1 + 2 + 3 + 2 * self.rank))

    def forward(self, hidden: Tensor, past: Tensor) -> Mixture:
        """Mixture; `past` (N, P, 2) is what an anchor extrapolates."""
        c = self.config
        out = self.out(hidden).view(*hidden.shape[:2], c.modes, -1)  # (N, T, K, 6 + 2R)
        logits = out[..., 0]
        unit = self.units(out)
        means = unit * out[..., 1:3]
        if c.weights == "persistent":
            logits = logits.mean(dim=1, keepdim=True).expand_as(logits)
        if c.anchor != "none":
            means = means + extrapolated(past, c.predicted).unsqueeze(2)
        floor = c.floor if c.target == "controls" else c.floor / c.scale
        scales = unit * softplus(out[..., 3:5]) + floor
        zero, lower = torch.zeros_like(logits), unit[..., 0] * out[..., 5]
        roots = torch.stack([scales[..., 0], zero, lower, scales[..., 1]], dim=-1).view(*means.shape, 2)
        if c.target == "controls":  # the noises of a system are independent of each other
            roots = torch.diag_embed(scales)
        factors = (unit * out[..., 6:]).reshape(*means.shape, self.rank) if self.rank else None
        return Mixture(logits.log_softmax(dim=-1), means, roots, factors)

    def units(self, out: Tensor) -> Tensor:
        """(T, 1, 1) what is stated of each step (of `out`'s kind of numbers) counts in."""
        steps = self.config.predicted
        share = torch.arange(1.0, steps + 1.0, dtype=out.dtype, device=out.device)[:, None, None] / steps
        return share**GROWTH if self.config.anchor == "growing" else torch.ones_like(share)


class MixtureNetwork(nn.Module):
    """A network that states a `Mixture` of `Inputs`, as its `config` says."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.config = config


class EncoderDecoder(MixtureNetwork):
    """The paper's network."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__(config)
        h = config.hidden
        self.past = mlp(2 if config.anchor == "none" else 4, h)
        self.lanes = mlp(2, h) if config.lanes else None
        self.ego = mlp(2 * config.predicted, h) if config.ego_future else None
        self.encoder = nn.LSTM(h * (1 + config.lanes + config.ego_future), h, batch_first=True)
        self.decoder = nn.LSTM(h, h, batch_first=True)
        self.head = Head(config, h)

    def forward(self, inputs: Inputs) -> Mixture:
        """The mixture of each step."""
        observed = inputs.past
        if self.config.anchor != "none":
            observed = torch.cat([observed, velocities(observed, self.config.dt)], dim=-1)
        codes = self.past(observed)  # (N, P, H)
        context = [c.unsqueeze(1).expand_as(codes) for c in self.context(inputs)]
        _, state = self.encoder(torch.cat([codes, *context], dim=-1))
        latent = state[0][-1].unsqueeze(1).expand(-1, self.config.predicted, -1)
        hidden, _ = self.decoder(latent, state)
        mixture: Mixture = self.head(hidden, inputs.past)
        return mixture

    def context(self, inputs: Inputs) -> list[Tensor]:
        """(N, H) codes of what the configuration adds to the past."""
        codes = []
        if self.lanes is not None:
            codes.append(pooled(self.lanes, given("lanes", inputs.lanes)))
        if self.ego is not None:
            codes.append(flat(self.ego, given("ego_future", inputs.ego)))
        return codes


def flat(layers: nn.Module, course: Tensor) -> Tensor:
    """(N, H) code of a course (N, F, 2); of one with NaN, which is not known, it is 0."""
    missing = course.isnan().flatten(1).any(dim=1, keepdim=True)
    codes: Tensor = layers(course.nan_to_num().flatten(1)).masked_fill(missing, 0.0)
    return codes


def pooled(layers: nn.Module, points: Tensor) -> Tensor:
    """(N, H) largest of each feature over points (N, L, 2); those with NaN do not count, of none it is 0."""
    missing = points.isnan().any(dim=-1, keepdim=True)
    codes: Tensor = layers(torch.where(missing, 0.0, points)).masked_fill(missing, 0.0)  # ReLU: never below 0
    return codes.amax(dim=1)


def given(name: str, value: Tensor | None) -> Tensor:
    """What the configuration asks for, or an error."""
    if value is None:
        raise InputError(f"{name}: the network was built to read it, got none")
    return value


def velocities(past: Tensor, dt: float) -> Tensor:
    """(N, P, 2) by differences of (N, P, 2); the first is taken to be the second."""
    steps = torch.diff(past, dim=1) / dt
    return torch.cat([steps[:, :1], steps], dim=1)


def extrapolated(past: Tensor, steps: int) -> Tensor:
    """(N, T, 2) straight on from the last of (N, P, 2), at the velocity by least squares over the last 5."""
    age = torch.arange(-2.0, 3.0, dtype=past.dtype, device=past.device)
    velocity = (age[:, None] * past[:, -5:]).sum(dim=1, keepdim=True) / 10.0
    ahead = torch.arange(1.0, steps + 1.0, dtype=past.dtype, device=past.device)[:, None]
    return past[:, -1:] + ahead * velocity


def parameters(network: nn.Module) -> int:
    """How many numbers are trained."""
    return sum(p.numel() for p in network.parameters())
