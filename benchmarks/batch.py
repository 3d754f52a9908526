"""Throughput of `riskplan batch`, and what it makes of a cluster: `python -m benchmarks.batch --data DIR`.

The same CommonRoad problems are planned by 1 and 2 workers of this machine and by a Dask LocalCluster of 2. From what
these runs measure (a scenario, its hand-over, a worker's start, a shard's write) follows the projection, on paper.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np
import pyarrow.parquet as pq
from distributed import Client, LocalCluster

import riskplan as rp
from benchmarks.cases import table
from riskplan.batching_child import Child
from riskplan.batching_shards import write_shard

SHARD = 100


@dataclass(frozen=True)
class Run:
    """One way to do the same work: rows, wall time, and the seconds spent inside scenarios."""

    name: str
    workers: int
    rows: int
    wall: float
    inside: float


def main(arguments: list[str] | None = None) -> int:
    """Parse, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder with CommonRoad files, searched recursively")
    parser.add_argument("--files", type=int, default=48, help="how many, spread evenly over the sorted list")
    parser.add_argument("--rows", type=int, default=8, help="scenarios per shard")
    parser.add_argument("--nodes", type=int, default=100, help="of the projection")
    parser.add_argument("--cores", type=int, default=16, help="per node of the projection")
    parser.add_argument("--scenarios", type=int, default=1_000_000, help="of the projection")
    args = parser.parse_args(arguments)
    files = sorted(args.data.rglob("*.xml"))
    if not files:
        print(f"benchmarks.batch: no .xml files under {args.data}", file=sys.stderr)
        return 2
    chosen = [files[i] for i in np.unique(np.linspace(0, len(files) - 1, args.files).astype(int))]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        listed = folder / "list.npz"
        np.savez(listed, scenario=np.array([str(f) for f in chosen]))
        start = started()
        runs = [measured(f"{n} worker{'s' * (n > 1)}", n, listed, folder / str(n), args.rows) for n in (1, 2)]
        with (
            LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
            Client(cluster) as client,
        ):
            runs.append(measured("Dask LocalCluster of 2", 2, listed, folder / "dask", args.rows, client))
        write = shard_write(folder / "1", folder)
    one = runs[0].wall
    rows: list[list[object]] = [
        [r.name, r.rows, r.wall, 3600 * r.rows / r.wall, one / r.wall, 1e3 * handover(r, start)] for r in runs
    ]
    head = ["run", "scenarios", "wall [s]", "scenarios per hour", "× 1 worker", "hand-over [ms a scenario]"]
    table(f"planning {len(chosen)} CommonRoad problems, rrt, bound 0.01, {args.rows} rows a shard", head, rows)
    print(f"\nStart of a worker: {start:.2f} s. Write of a shard of {SHARD} rows: {1e3 * write:.1f} ms.")
    project(runs[-1], start, write, args.scenarios, args.nodes, args.cores)
    return 0


def started() -> float:
    """Seconds from nothing to a worker that plans, kernels compiled before."""
    Child("rrt").close()
    began = perf_counter()
    Child("rrt").close()
    return perf_counter() - began


def measured(name: str, workers: int, listed: Path, out: Path, rows: int, client: Client | None = None) -> Run:
    """One run of the batch."""
    summary = rp.batch(listed, out, workers=workers, client=client, shard_rows=rows, time_limit=0.5)
    inside = float(np.sum(pq.read_table(out, columns=["seconds"])["seconds"].to_numpy()))
    return Run(name, workers, summary.scenarios, summary.seconds, inside)


def handover(run: Run, start: float) -> float:
    """Seconds a scenario costs beyond itself: waiting, pipes, shards, the last worker working alone."""
    return max(run.wall * run.workers - run.inside - run.workers * start, 0.0) / run.rows


def shard_write(out: Path, folder: Path) -> float:
    """Seconds to write a shard of `SHARD` rows like these, flushed to this disk."""
    rows = pq.read_table(out).to_pylist()
    rows = (rows * (SHARD // len(rows) + 1))[:SHARD]
    began = perf_counter()
    for i in range(10):
        write_shard(folder, i, rows)
    return (perf_counter() - began) / 10


def project(run: Run, start: float, write: float, scenarios: int, nodes: int, cores: int) -> None:
    """On paper: workers share the scenarios, one process writes all shards."""
    each, more = run.inside / run.rows, handover(run, start)
    compute = scenarios * (each + more) / (nodes * cores) + start
    writing = scenarios / SHARD * write
    print(f"\n### Projection, on paper: {scenarios:g} scenarios, {nodes} nodes of {cores} cores like these\n")
    print(
        f"T = max(N (s + h) / (nodes × cores) + start, N / {SHARD} × w)\n"
        f"  = max({scenarios:g} × ({each:.3f} + {more:.3f}) / {nodes * cores} + {start:.2f}, "
        f"{scenarios / SHARD:g} × {write:.4f}) s\n"
        f"  = max({compute:.0f}, {writing:.0f}) s = {max(compute, writing) / 60:.1f} min"
    )
    print(
        "\ns: a scenario, h: its hand-over on the LocalCluster, w: a shard's write by the one writer. Not in it: a "
        "shared disk slower\nthan this one, nodes that fail, and the wait for the slowest shard, at most "
        f"{SHARD} × s = {SHARD * each:.0f} s."
    )


if __name__ == "__main__":
    sys.exit(main())
