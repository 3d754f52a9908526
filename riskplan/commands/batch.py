"""`riskplan batch`: plan or score many scenarios, resumable."""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from typing import Any

from checkers import InputError
from riskplan.commands.shared import SOLVED, json_option, place, risk


def add(to: argparse.ArgumentParser) -> None:
    """Its options."""
    to.add_argument("source", type=place, metavar="SOURCE", help="a folder of scenarios, or a .parquet or .npz list")
    to.add_argument("--out", type=place, required=True, metavar="DIR", help="shards go there; the same DIR resumes")
    to.add_argument("--score", type=place, metavar="DIR", help="judge DIR/NAME/plan.json instead of planning")
    to.add_argument("--planner", default="rrt", metavar="NAME", help="see `riskplan planners`; default rrt")
    to.add_argument("--checker", default="exact", metavar="NAME", help="see `riskplan checkers`; default exact")
    to.add_argument("--bound", type=risk, default=0.01, metavar="RISK", help="on the total, or `none`; default 0.01")
    to.add_argument("--dependence", default="independent", metavar="NAME", help="independent, persistent or boole")
    to.add_argument("--time-limit", type=float, default=1.0, metavar="S", help="of each search [s]; default 1")
    to.add_argument("--limit", type=float, default=120.0, metavar="S", help="of a scenario as a whole [s]; default 120")
    to.add_argument("--seed", type=int, default=0, metavar="N", help="of all randomness; default 0")
    to.add_argument("--workers", type=int, default=1, metavar="N", help="scenarios at once; default 1")
    to.add_argument("--cluster", metavar="ADDRESS", help="of a Dask scheduler, or `local` for one on this machine")
    to.add_argument("--shard-rows", type=int, default=100, metavar="N", help="scenarios per file; default 100")
    to.add_argument("--keep-plans", type=place, metavar="DIR", help="write DIR/NAME/plan.json too")
    json_option(to)


def run(args: argparse.Namespace) -> int:
    """Exit status: 0 when every scenario has a row, failed ones included."""
    from riskplan.batching import batch

    keys = ("score", "planner", "checker", "bound", "dependence", "time_limit", "limit", "seed", "workers")
    options: dict[str, Any] = {key: getattr(args, key) for key in (*keys, "shard_rows", "keep_plans")}
    with _client(args.cluster, args.workers) as client, _bar() as progress:
        summary = batch(args.source, args.out, client=client, progress=progress, **options)
    if args.json:
        print(json.dumps({**asdict(summary), "out": str(args.out)}))
        return SOLVED
    told = ", ".join(f"{count} {status}" for status, count in sorted(summary.statuses.items())) or "nothing to do"
    print(f"scenarios: {summary.scenarios}, done before: {summary.before}; {told}; {summary.seconds:.1f} s")
    print(f"shards written to {args.out}: {summary.shards}")
    return SOLVED


# a Client that fails while it is made complains on stderr when it is collected
_ADDRESS = re.compile(r"([a-z]+://)?[\w.\-\[\]:]+:[0-9]+", re.ASCII)


@contextmanager
def _client(address: str | None, workers: int) -> Iterator[Any]:
    """A Dask client, or None for this machine's own processes."""
    if address is None:
        yield None
        return
    if address != "local" and not _ADDRESS.fullmatch(address):
        raise InputError(f"--cluster: expected local or an address such as tcp://host:8786, got {address!r}")
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        raise InputError("--cluster needs Dask: pip install '.[cluster]' in the checkout") from None
    try:
        if address != "local":
            with Client(address, timeout=10) as client:
                yield client
            return
        with (
            LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as cluster,
            Client(cluster) as client,
        ):
            yield client
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"--cluster: cannot reach {address}: {' '.join(str(error).split())[:200]}") from None


@contextmanager
def _bar() -> Iterator[Callable[[int, int], None] | None]:
    """A progress bar on a terminal's stderr."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    columns = (BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as shown:
        task = shown.add_task("scenarios")
        yield lambda there, total: shown.update(task, completed=there, total=total)
