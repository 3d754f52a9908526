"""Training: epochs of Adam on `α L2 + NLL`, with validation, early stop, exact resumption and several processes.

The random order of epoch e follows from (seed, e) alone, and a checkpoint holds everything else (weights, Adam's
moments, the best weights so far), so training that was killed goes on exactly as if it had not been.
"""

from __future__ import annotations

import csv
import json
import math
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
import torch.distributed as dist
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel

from checkers.validate import InputError, as_option, as_scalar
from predictor.baselines import build
from predictor.loss import best_mode_error, loss
from predictor.network import Inputs, MixtureNetwork, NetworkConfig

SCHEDULES = ("constant", "cosine")
LOG_FIELDS = ("epoch", "rate", "train_loss", "valid_loss", "valid_min_ade", "seconds")


@dataclass(frozen=True)
class TrainSettings:
    """How a network is trained. The paper's: batch 32, rate 1e-4, constant; ours reach the same loss in fewer epochs.

    Attributes:
        alpha: weight of the L2 term, which is in metres (of controls in the network's units).
        rate: of Adam, its highest with a cosine schedule, which falls to a hundredth of it over the `epochs`.
        schedule: "constant" or "cosine".
        batch: windows per step, over all processes together.
        epochs: at most.
        patience: epochs without a better validation loss after which training stops.
        decay: decoupled weight decay (Loshchilov & Hutter 2019).
        clip: largest norm of a gradient.
        hide: share of windows whose lanes and ego future are withheld, so that the network can do without.
        mirror: whether each window is mirrored along the target's x-axis half of the time (normalised networks).
        seed: of the initial weights and of every epoch's order.

    Raises:
        InputError: naming the field.
    """

    alpha: float = 0.1
    rate: float = 2e-3
    schedule: str = "cosine"
    batch: int = 128
    epochs: int = 60
    patience: int = 10
    decay: float = 1e-4
    clip: float = 5.0
    hide: float = 0.1
    mirror: bool = True
    seed: int = 0

    def __post_init__(self) -> None:
        as_option("schedule", self.schedule, SCHEDULES)
        as_scalar("alpha", self.alpha, low=0.0)
        as_scalar("decay", self.decay, low=0.0)
        as_scalar("hide", self.hide, low=0.0, high=1.0)
        for name in ("rate", "clip"):
            as_scalar(name, getattr(self, name), low=0.0, strict=True)
        for name, least in (("batch", 1), ("epochs", 1), ("patience", 1), ("seed", 0)):
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or value < least:
                raise InputError(f"{name}: expected an integer >= {least}, got {value!r}")
        if not isinstance(self.mirror, bool):
            raise InputError(f"mirror: expected true or false, got {self.mirror!r}")

    @classmethod
    def from_dict(cls, values: Any) -> TrainSettings:
        """From plain values; an unknown field is an error that lists the valid ones."""
        known = [f.name for f in fields(cls)]
        for name in values:
            if name not in known:
                raise InputError(f"settings: expected fields {', '.join(known)}; got {name!r}")
        return cls(**values)

    def rate_at(self, epoch: int) -> float:
        """The rate of an epoch, counted from 0."""
        if self.schedule == "constant":
            return self.rate
        return self.rate * (0.01 + 0.99 * 0.5 * (1.0 + math.cos(math.pi * epoch / self.epochs)))


@dataclass(frozen=True, eq=False)
class Examples:
    """Windows as a network reads them: inputs, and the truth (N, T, 2), all in the network's units."""

    inputs: Inputs
    truth: Tensor

    def __len__(self) -> int:
        return len(self.truth)

    def take(self, rows: Tensor) -> Examples:
        """Those rows."""
        return self.map(lambda x: x[rows])

    def to(self, device: torch.device) -> Examples:
        """On a device, in single precision."""
        return self.map(lambda x: x.to(device, torch.float32))

    def map(self, change: Callable[[Tensor], Tensor]) -> Examples:
        """With every tensor changed."""
        past, lanes, ego = self.inputs
        known = Inputs(change(past), None if lanes is None else change(lanes), None if ego is None else change(ego))
        return Examples(known, change(self.truth))


class Progress(NamedTuple):
    """What is told after each batch (`valid_loss` NaN) and after each epoch."""

    epoch: int
    share: float
    train_loss: float
    valid_loss: float
    valid_min_ade: float


class Trained(NamedTuple):
    """The best network by validation loss, and how it came about."""

    network: MixtureNetwork
    epoch: int
    epochs: int
    valid_loss: float
    seconds: float


Listener = Callable[[Progress], None]


class _State(NamedTuple):
    """Everything that changes while training."""

    network: MixtureNetwork
    optimiser: torch.optim.Optimizer
    best: dict[str, Tensor]
    told: dict[str, float]  # epoch done, best epoch and loss, seconds


def train(
    config: NetworkConfig,
    training: Examples,
    validation: Examples,
    settings: TrainSettings,
    folder: Path | None = None,
    device: str = "cpu",
    listener: Listener | None = None,
) -> Trained:
    """Train a network; with a `folder` its checkpoint is written there each epoch, and gone on from if there is one.

    Started by `torchrun`, each process takes its share of every batch (gloo on CPUs, nccl on CUDA); the first writes.

    Args:
        config: what to train.
        training, validation: in the units of `config`, from the same scenes never.
        settings: how.
        folder: for `checkpoint.safetensors` and `log.csv`; None: nothing is written.
        device: "cpu", "cuda" or "cuda:1".
        listener: told after each batch and each epoch; an exception it raises ends training, resumable.

    Raises:
        InputError: no examples, an unknown device, or a checkpoint of other settings.
    """
    if not len(training) or not len(validation):
        raise InputError(
            f"data: expected windows to train and to validate on, got {len(training)} and {len(validation)}"
        )
    where = _device(device)
    told = {"config": config.to_dict(), "settings": asdict(settings), "windows": [len(training), len(validation)]}
    training, validation = training.to(where), validation.to(where)
    state = _start(config, settings, where)
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        state = _resumed(state, folder, told)
    wrapped = DistributedDataParallel(state.network) if dist.is_initialized() else state.network
    while state.told["epoch"] < settings.epochs and state.told["epoch"] - state.told["best_epoch"] < settings.patience:
        state = _epoch(state, wrapped, training, validation, settings, listener)
        if folder is not None and _rank() == 0:
            _log(folder, state.told)
            _write(folder, state, told)
    state.network.load_state_dict(state.best)
    state.network.eval()
    done = state.told
    return Trained(state.network, int(done["best_epoch"]), int(done["epoch"]), done["best_loss"], done["seconds"])


def joint_likelihood(config: NetworkConfig) -> bool:
    """Whether the whole trajectory's likelihood counts: where a mode is drawn once."""
    return config.weights == "persistent"


def evaluate(network: MixtureNetwork, examples: Examples, alpha: float, batch: int = 1024) -> tuple[float, float]:
    """Loss, and minADE in the network's units, over all examples."""
    network.eval()
    joint = joint_likelihood(network.config)
    sums = np.zeros(2)
    with torch.no_grad():
        for start in range(0, len(examples), batch):
            part = examples.take(torch.arange(start, min(start + batch, len(examples)), device=examples.truth.device))
            mixture = network(part.inputs)
            value = loss(mixture, part.truth, alpha * network.config.unit, joint)
            sums += len(part) * np.array([float(value), float(best_mode_error(mixture, part.truth).mean())])
    return float(sums[0] / len(examples)), float(sums[1] / len(examples))


def mirrored(examples: Examples, flip: Tensor) -> Examples:
    """With y (of controls: the turn) negated where `flip` (N,) is true."""
    sign = torch.where(flip, -1.0, 1.0).view(-1, 1, 1)
    turn = torch.cat([torch.ones_like(sign), sign], dim=-1)
    return examples.map(lambda x: x * turn)


def withheld(examples: Examples, hide: Tensor) -> Examples:
    """With lanes and ego future unknown where `hide` (N,) is true."""
    without = examples.map(lambda x: torch.where(hide.view(-1, 1, 1), torch.nan, x))
    return Examples(without.inputs._replace(past=examples.inputs.past), examples.truth)


def _mask(rows: Any, device: torch.device) -> Tensor:
    return torch.from_numpy(rows).to(device)


def _epoch(
    state: _State,
    wrapped: nn.Module,
    training: Examples,
    validation: Examples,
    settings: TrainSettings,
    listener: Listener | None,
) -> _State:
    epoch, started = int(state.told["epoch"]), time.monotonic()
    config = state.network.config
    for group in state.optimiser.param_groups:
        group["lr"] = settings.rate_at(epoch)
    wrapped.train()
    total, count = 0.0, 0
    for share, part in _batches(training, settings, epoch, config):
        value = loss(wrapped(part.inputs), part.truth, settings.alpha * config.unit, joint_likelihood(config))
        state.optimiser.zero_grad()
        torch.autograd.backward(value)
        torch.nn.utils.clip_grad_norm_(state.network.parameters(), settings.clip)
        state.optimiser.step()
        total, count = total + float(value.detach()), count + 1
        if listener is not None:
            listener(Progress(epoch + 1, share, total / count, math.nan, math.nan))
    valid_loss, min_ade = evaluate(state.network, validation, settings.alpha)
    told = {**state.told, "epoch": epoch + 1, "train_loss": total / count, "valid_loss": valid_loss}
    told |= {"rate": settings.rate_at(epoch), "valid_min_ade": min_ade * config.unit}
    told["seconds"] = state.told["seconds"] + time.monotonic() - started
    best = state.best
    if valid_loss < told["best_loss"]:
        told |= {"best_epoch": epoch + 1, "best_loss": valid_loss}
        best = {name: value.clone() for name, value in state.network.state_dict().items()}
    if listener is not None:
        listener(Progress(epoch + 1, 1.0, total / count, valid_loss, told["valid_min_ade"]))
    return state._replace(best=best, told=told)


def _batches(
    examples: Examples, settings: TrainSettings, epoch: int, config: NetworkConfig
) -> Iterator[tuple[float, Examples]]:
    """The epoch's batches, of several processes this one's equal share of each, with how much is done by then."""
    rng = np.random.default_rng((settings.seed, epoch))
    order, (flips, hidden) = rng.permutation(len(examples)), rng.random((2, len(examples)))
    world = _world()
    most = max(settings.batch, world)
    for start in range(0, len(order), most):
        rows = order[start : start + most]
        rows = rows[: len(rows) // world * world][_rank() :: world]  # equal shares: their mean is the batch's mean
        if not len(rows):
            continue
        device = examples.truth.device
        part = withheld(examples.take(torch.from_numpy(rows).to(device)), _mask(hidden[rows] < settings.hide, device))
        if settings.mirror and config.normalised:
            part = mirrored(part, _mask(flips[rows] < 0.5, device))
        yield min(1.0, (start + most) / len(order)), part


def _start(config: NetworkConfig, settings: TrainSettings, device: torch.device) -> _State:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(settings.seed)
        network = build(config).to(device)
    optimiser = torch.optim.AdamW(network.parameters(), lr=settings.rate, weight_decay=settings.decay)
    best = {name: value.clone() for name, value in network.state_dict().items()}
    return _State(network, optimiser, best, {"epoch": 0, "best_epoch": 0, "best_loss": math.inf, "seconds": 0.0})


def _write(folder: Path, state: _State, told: dict[str, Any]) -> None:
    """The checkpoint, complete or not at all."""
    tensors = {f"network.{n}": v for n, v in state.network.state_dict().items()}
    tensors |= {f"best.{n}": v for n, v in state.best.items()}
    for i, moments in state.optimiser.state_dict()["state"].items():
        tensors |= {f"adam.{i}.{n}": torch.as_tensor(v) for n, v in moments.items()}
    meta = {"told": json.dumps(told), "state": json.dumps({k: v for k, v in state.told.items() if math.isfinite(v)})}
    aside = folder / ".checkpoint.part"
    save_file({n: v.detach().cpu().contiguous().clone() for n, v in tensors.items()}, aside, metadata=meta)
    os.replace(aside, folder / "checkpoint.safetensors")


def _resumed(state: _State, folder: Path, told: dict[str, Any]) -> _State:
    """The state of the folder's checkpoint, or the one given if there is none."""
    path = folder / "checkpoint.safetensors"
    if not path.exists():
        return state
    try:
        with safe_open(path, framework="pt") as file:
            meta = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  not a dict
        known, past = json.loads(meta["told"]), json.loads(meta["state"])
    except (SafetensorError, OSError, KeyError, ValueError) as error:
        raise InputError(f"{path}: not a readable checkpoint: {error}") from None
    _check_same(path, known, json.loads(json.dumps(told)))
    state.network.load_state_dict(_under("network.", tensors))
    moments: dict[int, dict[str, Tensor]] = {}
    for name, value in _under("adam.", tensors).items():
        i, key = name.split(".", 1)
        moments.setdefault(int(i), {})[key] = value
    state.optimiser.load_state_dict({**state.optimiser.state_dict(), "state": moments})
    return state._replace(best=_under("best.", tensors), told={**state.told, **past})


def _check_same(path: Path, known: dict[str, Any], told: dict[str, Any]) -> None:
    for part, values in told.items():
        if known.get(part) == values:
            continue
        if isinstance(values, dict):
            name = next(k for k in values if known.get(part, {}).get(k) != values[k])
            was, now, part = known.get(part, {}).get(name), values[name], name
        else:
            was, now = known.get(part), values
        raise InputError(f"{path}: is of a training with {part} = {was}, got {now}; choose another folder")


def _under(prefix: str, tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}


def _log(folder: Path, told: dict[str, float]) -> None:
    """A row in `log.csv`; rows of epochs after the checkpoint that was gone on from are dropped."""
    path = folder / "log.csv"
    rows: list[dict[str, str]] = []
    if path.exists():
        with path.open(newline="", encoding="utf-8") as file:
            rows = [row for row in csv.DictReader(file) if int(row["epoch"]) < told["epoch"]]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, LOG_FIELDS)
        writer.writeheader()
        writer.writerows(rows)
        writer.writerow({name: f"{told[name]:.6g}" for name in LOG_FIELDS})


def _device(name: str) -> torch.device:
    """The device of this process; by `torchrun` the group is joined first."""
    kind = name.split(":")[0]
    as_option("device", kind, ("cpu", "cuda"))
    if kind == "cuda" and not torch.cuda.is_available():
        raise InputError("device: CUDA is not available here; use cpu")
    if "WORLD_SIZE" in os.environ and int(os.environ["WORLD_SIZE"]) > 1:
        if not dist.is_initialized():
            dist.init_process_group("nccl" if kind == "cuda" else "gloo")
        if kind == "cuda":
            return torch.device("cuda", int(os.environ["LOCAL_RANK"]))
    try:
        return torch.device(name)
    except RuntimeError:
        raise InputError(f"device: expected cpu, cuda or cuda:1, got {name!r}") from None


def _rank() -> int:
    return dist.get_rank() if dist.is_initialized() else 0


def _world() -> int:
    return dist.get_world_size() if dist.is_initialized() else 1
