"""Trained networks in files: weights as safetensors, beside them a model card in JSON. Nothing is ever unpickled.

The card says what the network is (`network`), what it was trained on (`data`, `settings`), how good it is (`metrics`,
before and after recalibration), and carries the recalibration itself. It names the weights it belongs to by their hash.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load as load_tensors
from safetensors.torch import save as save_tensors
from torch import Tensor

from checkers.archive import check_regular
from checkers.validate import InputError, as_path
from checkers.writing import written
from predictor.baselines import build
from predictor.calibration import Recalibration
from predictor.network import MixtureNetwork, NetworkConfig

FORMAT = "riskplan-network-1"
LARGEST = 64 * 1024 * 1024  # bytes; ours have less than a thousandth of that


@dataclass(frozen=True, eq=False)
class Model:
    """A network, ready to predict, and its card.

    Attributes:
        network: in evaluation mode.
        config: of the network.
        recalibration: fitted on validation data; None: not recalibrated.
        card: everything else that is known: data, settings, metrics.
    """

    network: MixtureNetwork
    config: NetworkConfig
    recalibration: Recalibration | None = None
    card: Mapping[str, Any] = field(default_factory=dict)


def save_model(path: str | Path, model: Model) -> None:
    """Write `path` (.safetensors) and the card beside it (.json); each appears complete or not at all."""
    path = Path(path)
    state = {name: value.detach().cpu().contiguous().clone() for name, value in model.network.state_dict().items()}
    content = save_tensors(state)
    card = {
        "format": FORMAT,
        "weights_sha256": hashlib.sha256(content).hexdigest(),
        "network": model.config.to_dict(),
        "recalibration": None if model.recalibration is None else model.recalibration.to_dict(),
        **model.card,
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    _replace(path, content)
    _replace(path.with_suffix(".json"), (json.dumps(card, indent=1, allow_nan=False) + "\n").encode())


def load_model(path: str | Path) -> Model:
    """Read what `save_model` wrote.

    Raises:
        InputError: naming the file: missing, not safetensors, weights of another network, or a card of other weights.
    """
    path = as_path("path", path)
    if not path.name:
        raise InputError(f"{path}: expected a .safetensors file")
    card = _card(path.with_suffix(".json"))
    content = _bytes(path)
    if hashlib.sha256(content).hexdigest() != card["weights_sha256"]:
        raise InputError(
            f"{path}: is not the file its card {path.with_suffix('.json').name} describes (SHA-256 differs)"
        )
    try:
        state = load_tensors(content)
    except SafetensorError as error:
        raise InputError(f"{path}: not a safetensors file: {error}") from None
    try:
        config = NetworkConfig.from_dict(card["network"])
        given = card.get("recalibration")
        recalibration = None if given is None else Recalibration.from_dict(given)
    except (InputError, TypeError) as error:
        raise InputError(f"{path.with_suffix('.json')}: {error}") from None
    network = build(config)
    _check_state(path, state, network.state_dict())
    network.load_state_dict(state)
    network.eval()
    rest = {k: v for k, v in card.items() if k not in ("format", "weights_sha256", "network", "recalibration")}
    return Model(network, config, recalibration, rest)


def _check_state(path: Path, state: dict[str, Tensor], wanted: dict[str, Tensor]) -> None:
    for name in wanted:
        if name not in state:
            raise InputError(f"{path}: expected the weights {name!r}, which are missing")
    for name, value in sorted(state.items()):
        if name not in wanted:
            raise InputError(f"{path}: expected no weights {name!r}")
        if value.shape != wanted[name].shape or value.dtype != wanted[name].dtype:
            want, got = (f"{tuple(v.shape)} {str(v.dtype).removeprefix('torch.')}" for v in (wanted[name], value))
            raise InputError(f"{path}: {name}: expected {want}, got {got}")
        if not bool(torch.isfinite(value).all()):
            raise InputError(f"{path}: {name}: expected finite numbers")


def _card(path: Path) -> dict[str, Any]:
    content = _bytes(path)
    try:
        card = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not a model card: {error}") from None
    if not isinstance(card, dict) or card.get("format") != FORMAT:
        found = card.get("format") if isinstance(card, dict) else type(card).__name__
        raise InputError(f"{path}: expected a model card of format {FORMAT!r}, got {found!r}")
    for name, kind in (("weights_sha256", str), ("network", dict)):
        if not isinstance(card.get(name), kind):
            raise InputError(f"{path}: {name}: expected {kind.__name__}, got {type(card.get(name)).__name__}")
    return card


def _bytes(path: Path) -> bytes:
    check_regular(path)
    try:
        if path.stat().st_size > LARGEST:
            raise InputError(f"{path}: expected at most {LARGEST} bytes, got {path.stat().st_size}")
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None


def _replace(path: Path, content: bytes) -> None:
    with written(path) as aside:
        aside.write_bytes(content)
