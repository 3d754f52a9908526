"""`riskplan train`: train a predictor on recorded tracks."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from checkers import InputError
from riskplan import interrupt
from riskplan.commands.shared import SOLVED, check_out, json_option, place, progress

if TYPE_CHECKING:
    from predictor.train import Listener, Progress
    from predictor.windows import Windows


def add(to: argparse.ArgumentParser) -> None:
    """Its options."""
    to.add_argument("--data", type=place, required=True, metavar="PATH", help="a data set, or windows saved as .npz")
    to.add_argument("--kind", metavar="NAME", help="of the data; default: by the suffix of its files")
    to.add_argument(
        "--out", type=place, required=True, metavar="DIR", help="for the weights, their card, checkpoint, log"
    )
    to.add_argument("--target", default="positions", metavar="NAME", help="positions or controls")
    to.add_argument("--architecture", default="lstm", metavar="NAME", help="lstm or mlp")
    to.add_argument("--head", default="persistent", metavar="NAME", help="errors over time: persistent or independent")
    to.add_argument(
        "--anchor", default="growing", metavar="NAME", help="output relative to velocity: growing, velocity, none"
    )
    to.add_argument("--lanes", action="store_true", help="read lane centre lines")
    to.add_argument("--ego-future", action="store_true", help="read the ego's future")
    to.add_argument("--paper", action="store_true", help="head, anchor, batch and rate of the paper")
    to.add_argument("--epochs", type=int, default=60, metavar="N", help="at most; default 60")
    to.add_argument("--every", type=int, default=5, metavar="N", help="steps from one window of a track to its next")
    to.add_argument("--device", default="cpu", metavar="NAME", help="cpu (default), cuda or cuda:1; see also torchrun")
    to.add_argument("--threads", type=int, default=1, metavar="N", help="of torch; more rarely helps; default 1")
    to.add_argument("--seed", type=int, default=0, metavar="N", help="of the split and the training; default 0")
    json_option(to)


def run(args: argparse.Namespace) -> int:
    """Exit status."""
    with needing_torch("riskplan train"):
        import torch

        from predictor.fit import Parts, fit
        from predictor.model_files import save_model
    if args.threads < 1 or args.epochs < 1 or args.every < 1:
        raise InputError("threads, epochs and every: expected whole numbers >= 1")
    check_out(args.out)
    config, settings = _configured(args)
    with progress(f"reading {args.data}"):
        samples = _samples(args, config.target == "controls")
    parts = Parts.of(samples, args.seed, config.target == "controls")
    torch.set_num_threads(args.threads)
    with _bar(args.epochs) as listener:
        data = {"name": args.data.resolve().name, "every": args.every, "split_seed": args.seed}
        model = fit(config, parts, settings, data, args.out, args.device, listener)
    path = args.out / "model.safetensors"
    if _first():
        save_model(path, model)
        told = {"file": str(path), **{key: model.card[key] for key in ("data", "training", "metrics")}}
        print(json.dumps(told) if args.json else _summary(told))
    return SOLVED


@contextmanager
def needing_torch(what: str) -> Iterator[None]:
    """Say what to install where torch is missing."""
    try:
        yield
    except ModuleNotFoundError as error:
        if error.name not in ("torch", "safetensors"):
            raise
        raise InputError(f"{what} needs {error.name}: pip install '.[predictor]' in the checkout") from None


def _configured(args: argparse.Namespace) -> tuple[Any, Any]:
    from predictor.network import NetworkConfig
    from predictor.train import TrainSettings

    common = {"target": args.target, "lanes": args.lanes, "ego_future": args.ego_future}
    if args.paper:
        settings = TrainSettings(rate=1e-4, batch=32, schedule="constant", epochs=args.epochs, seed=args.seed)
        return NetworkConfig(**common), settings
    controls = args.target == "controls"
    config = NetworkConfig(
        **common,
        architecture=args.architecture,
        head="independent" if controls else args.head,
        anchor="none" if controls else args.anchor,
        weights="persistent",
    )
    return config, TrainSettings(epochs=args.epochs, seed=args.seed)


def _samples(args: argparse.Namespace, controls: bool) -> Windows:
    """Windows as saved, or cut from the data set and kept beside the weights."""
    from predictor.recordings import open_data
    from predictor.windows import Windows, is_windows, windows

    if is_windows(args.data):
        return Windows.load(args.data)
    bad: list[InputError] = []
    data = open_data(args.data, args.kind, bad.append)
    found = windows(_checked(data.recordings()), every=args.every, least=1 if controls else 30)
    for error in bad:
        print(f"riskplan: note: left out: {error}", file=sys.stderr)
    return found


def _checked(recordings: Iterator[Any]) -> Iterator[Any]:
    for recording in recordings:
        interrupt.check()
        yield recording


def _first() -> bool:
    """Whether this is the only process, or the first of `torchrun`'s."""
    import torch.distributed as dist

    return not dist.is_initialized() or dist.get_rank() == 0


@contextmanager
def _bar(epochs: int) -> Iterator[Listener]:
    """A progress bar on a terminal's stderr, a line per epoch elsewhere; Ctrl-C ends training, resumable."""
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Bar(*columns, console=console, disable=not console.is_terminal, transient=True) as bar:
        task = bar.add_task("training", total=float(epochs))
        shown = time.monotonic()

        def listen(told: Progress) -> None:
            nonlocal shown
            interrupt.check()
            done = told.valid_loss == told.valid_loss  # an epoch's end, not a batch's
            text = f"epoch {told.epoch}/{epochs}  loss {told.train_loss:.3f}"
            if done:
                text += f"  validation {told.valid_loss:.3f}  minADE {told.valid_min_ade:.2f}"
                if not console.is_terminal and _first():
                    print(text, file=sys.stderr, flush=True)
            if done or time.monotonic() - shown > 0.2:
                bar.update(task, completed=told.epoch - 1 + told.share, description=text)
                shown = time.monotonic()

        yield listen


def _summary(told: dict[str, Any]) -> str:
    training, metrics = told["training"], told["metrics"]
    lines = [
        f"{training['parameters']} parameters, best of {training['epochs']} epochs: {training['best_epoch']}, "
        f"{training['seconds']:.0f} s",
    ]
    for key, label in (("test", "test"), ("test_recalibrated", "recalibrated")):
        m = metrics[key]
        inside = "  ".join(
            f"{h}: " + "/".join(f"{100 * v:.1f}" for v in shares) for h, shares in m["within_50_90_99"].items()
        )
        lines.append(
            f"{label}: minADE {m['min_ade']:.3f} m, minFDE {m['min_fde']:.3f} m, NLL {m['nll']:.3f}, "
            f"joint NLL {m['joint_nll']:.3f}, within 50/90/99 %: {inside}"
        )
    return "\n".join([*lines, f"wrote {told['file']}"])
