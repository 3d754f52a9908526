"""`batch`: many scenarios planned or scored, a row each, in shards on disk; a killed batch goes on where it was."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

from checkers import PATH_DEPENDENCE, InputError, checker
from checkers.archive import check_regular, read_arrays
from checkers.validate import as_callable, as_count, as_option, as_path, as_scalar, as_seed, shown
from riskplan.batching_child import Children
from riskplan.batching_shards import check_settings, claimed, done, next_number, parquet, write_shard
from riskplan.io import SUFFIXES
from riskplan.planning import make_planner

# of this process, which may be a worker of a cluster: kept between shards, ended with the batch
_CHILDREN = Children()


@dataclass(frozen=True)
class Item:
    """A scenario of a batch: its name, its file, and which planning problem of it."""

    name: str
    path: Path
    problem: int = 0


@dataclass(frozen=True)
class BatchSummary:
    """What a run of a batch did.

    Attributes:
        scenarios: in the source.
        before: that had a row already.
        statuses: status -> rows written by this run.
        shards: files written by this run.
        seconds: wall time.
    """

    scenarios: int
    before: int
    statuses: Mapping[str, int]
    shards: int
    seconds: float


def batch(
    source: str | Path,
    out: str | Path,
    *,
    score: str | Path | None = None,
    planner: str = "rrt",
    checker: str = "exact",
    bound: float | None = 0.01,
    dependence: str = "independent",
    time_limit: float = 1.0,
    seed: int = 0,
    limit: float = 120.0,
    workers: int = 1,
    client: Any = None,
    shard_rows: int = 100,
    keep_plans: str | Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> BatchSummary:
    """Plan for every scenario of `source`, or score plans of them, and leave one row each in `out/part-*.parquet`.

    Scenarios that have a row are not done again, so the same call continues a batch that was killed. What fails is a
    row too: `status` says how, `reason` why. Columns: `riskplan.batching_shards.COLUMNS`. Seeds come from the
    scenarios' names, so a row depends neither on the order nor on the number of workers; but what runs until
    `time_limit` (`bound=None`, planners that keep improving, a search that finds nothing) depends on the machine.

    Args:
        source: a folder, searched for scenario files; or a `.parquet` or `.npz` list of paths relative to it, column
            `scenario`, with `problem` (CommonRoad) if need be.
        out: folder of the shards. Its settings are kept in `_batch.json`; others are refused.
        score: a folder with NAME/plan.json, NAME without its suffix: judge those by `checker` instead of planning.
        planner, checker, bound, dependence, time_limit: as in `rp.plan`; of a scored plan, dependence and bound are
            its own.
        seed: of the batch.
        limit: for one scenario, everything included [s]; then it is `timed_out`.
        workers: scenarios at once on this machine, by joblib; each in a process of its own.
        client: a `dask.distributed.Client`, to spread shards over its workers instead; they must see the same files.
        shard_rows: scenarios per shard; a kill loses the work on shards not yet written.
        keep_plans: a folder, not in `out`: write every plan to NAME/plan.json there, as `score` reads them.
        progress: told (rows there, scenarios).

    Raises:
        InputError: for what concerns all rows: no scenarios, unknown names, settings that differ from those in `out`.
    """
    began = perf_counter()
    settings = _settings(planner, checker, bound, dependence, time_limit, seed, score)
    as_count("workers", workers, 1, 1024)
    as_count("shard_rows", shard_rows, 1)
    as_callable("progress", progress)
    if client is not None and not callable(getattr(client, "submit", None)):
        raise InputError(f"client: expected a dask.distributed.Client, got {shown(client)}")
    limit = as_scalar("limit", limit, low=0.0, strict=True)
    folder = as_path("out", out).absolute()
    found = items(as_path("source", source).absolute(), folder)
    plans = None if score is None else as_path("score", score).absolute()
    if plans is not None and not plans.is_dir():
        raise InputError(f"{score}: expected a folder of plans")
    with claimed(folder):
        check_settings(folder, settings)
        there = done(folder)
        todo = [item for item in found if item.name not in there]
        keep = None if keep_plans is None else as_path("keep_plans", keep_plans).absolute()
        if keep is not None and (keep == folder or folder in keep.parents):
            raise InputError(
                f"keep_plans: expected a folder outside {out}, which is for shards alone; got {keep_plans}"
            )
        requests = [_request(item, settings, plans, keep) for item in todo]
        jobs = [(requests[i : i + shard_rows], limit) for i in range(0, len(requests), shard_rows)]
        statuses: Counter[str] = Counter()
        number = first = next_number(folder)
        if progress is not None:
            progress(len(found) - len(todo), len(found))
        for rows in _finished(jobs, workers, client):
            write_shard(folder, number, rows)
            number += 1
            statuses.update(str(row["status"]) for row in rows)
            if progress is not None:
                progress(len(found) - len(todo) + sum(statuses.values()), len(found))
    return BatchSummary(len(found), len(found) - len(todo), dict(statuses), number - first, perf_counter() - began)


def items(source: Path, out: Path | None = None) -> list[Item]:
    """The scenarios of a folder or a list, by name.

    Raises:
        InputError: if there are none, or two of one name.
    """
    if source.is_dir():
        files = (p for p in source.rglob("*") if p.suffix.lower() in SUFFIXES and p.is_file())
        outside = (p for p in files if out is None or out == source or out not in p.parents)
        found = [Item(p.relative_to(source).as_posix(), p) for p in outside]
    elif source.suffix in (".parquet", ".npz"):
        found = _listed(source)
    else:
        raise InputError(f"{source}: expected a folder of scenarios, or a list of them as .parquet or .npz")
    if not found:
        raise InputError(f"{source}: no scenarios ({', '.join(SUFFIXES)})")
    twice = [name for name, count in Counter(item.name for item in found).items() if count > 1]
    if twice:
        raise InputError(f"{source}: {twice[0]!r} is there twice")
    return sorted(found, key=lambda item: item.name)


def seed_of(name: str, seed: int) -> int:
    """In [0, 2^31), of a scenario's name and the batch's seed."""
    return int.from_bytes(hashlib.blake2b(f"{seed}:{name}".encode(), digest_size=4).digest(), "big") >> 1


def end_children() -> None:
    """End this process's idle and busy scenario processes."""
    _CHILDREN.close()


def _settings(
    planner: str,
    backend: str,
    bound: float | None,
    dependence: str,
    time_limit: float,
    seed: int,
    score: str | Path | None,
) -> dict[str, Any]:
    checker(backend)
    make_planner(planner)
    as_seed("seed", seed)
    if score is not None:
        return {"does": "score", "checker": backend, "planner": None, "seed": seed}
    return {
        "does": "plan",
        "planner": planner,
        "checker": backend,
        "bound": None if bound is None else as_scalar("bound", bound, low=0.0, high=1.0),
        "dependence": as_option("dependence", dependence, PATH_DEPENDENCE),
        "time_limit": as_scalar("time_limit", time_limit, low=0.0),
        "seed": seed,
    }


def _listed(path: Path) -> list[Item]:
    """The list in a file: column or array `scenario`, and `problem` if there is one."""
    try:
        if path.suffix == ".npz":
            columns = {key: v.tolist() for key, v in read_arrays(path, "list of scenarios").items()}
        else:
            check_regular(path)
            pa = parquet()
            table = pa.parquet.read_table(path)
            columns = {key: table[key].to_pylist() for key in ("scenario", "problem") if key in table.column_names}
    except InputError:
        raise
    except Exception as error:  # pyarrow has dozens of kinds
        raise InputError(f"{path}: not a readable list: {' '.join(str(error).split())[:200]}") from None
    names = columns.get("scenario")
    if not isinstance(names, list) or not all(isinstance(n, str) and n for n in names):
        raise InputError(f"{path}: expected a column scenario of paths")
    problems = columns.get("problem", [0] * len(names))
    if (
        not isinstance(problems, list)
        or len(problems) != len(names)
        or not all(isinstance(p, int) and not isinstance(p, bool) and p >= 0 for p in problems)
    ):
        raise InputError(f"{path}: expected a column problem of integers >= 0")
    pairs = zip(names, problems, strict=True)
    return [Item(f"{n}#{p}" if p else n, (path.parent / n).absolute(), p) for n, p in pairs]


def _request(item: Item, settings: dict[str, Any], plans: Path | None, keep: Path | None) -> dict[str, Any]:
    name = Path(item.name).with_suffix("").as_posix()
    name = f"{name}#{item.problem}" if item.problem else name
    return {
        "name": item.name,
        "path": str(item.path),
        "problem": item.problem,
        "seed": seed_of(item.name, settings["seed"]),
        "plan": None if plans is None else str(plans / name / "plan.json"),
        "keep": None if keep is None else str(keep / name / "plan.json"),
        "settings": settings,
    }


def _finished(
    jobs: Sequence[tuple[list[dict[str, Any]], float]], workers: int, client: Any
) -> Iterator[list[dict[str, Any]]]:
    """The rows of each job, as they are done: by joblib's threads, or by a Dask client."""
    _CHILDREN.open()
    try:
        if client is not None:
            yield from _on_cluster(jobs, client)
            return
        try:
            from joblib import Parallel, delayed  # noqa: PLC0415  an extra
        except ImportError:
            raise InputError("batch needs joblib: pip install '.[batch]' in the checkout") from None
        # threads, as all they do is wait for the processes that work
        parallel = Parallel(
            n_jobs=workers, backend="threading", return_as="generator_unordered", pre_dispatch="2*n_jobs"
        )
        yield from parallel(delayed(rows_of)(requests, limit) for requests, limit in jobs)
    finally:
        _CHILDREN.close()


def _on_cluster(jobs: Sequence[tuple[list[dict[str, Any]], float]], client: Any) -> Iterator[list[dict[str, Any]]]:
    from distributed import as_completed  # noqa: PLC0415  an extra

    futures = client.map(lambda job: rows_of(*job), list(jobs), pure=False, retries=2)
    try:
        for future in as_completed(futures):
            yield future.result()
            future.release()
    finally:
        client.cancel(futures)


def rows_of(requests: Sequence[dict[str, Any]], limit: float) -> list[dict[str, Any]]:
    """The rows of one shard, computed here, in a child process."""
    return [_row(request, limit) for request in requests]


def _row(request: dict[str, Any], limit: float) -> dict[str, Any]:
    settings, began = request["settings"], perf_counter()
    answer = _CHILDREN.ask(settings["planner"] or "rrt", request, limit)
    if isinstance(answer, str):
        late = answer == "timed_out"
        reason = f"took more than {limit:g} s" if late else f"its process {answer}"
        answer = {"status": "timed_out" if late else "crashed", "reason": reason, "seconds": perf_counter() - began}
    told = {key: settings.get(key) for key in ("planner", "checker", "dependence", "bound")}
    return {"scenario": request["name"], "seed": request["seed"], **told, **answer}
