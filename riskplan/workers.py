"""Planning in several processes, one seed each: the first plan, or the best.

OMPL never releases the interpreter, so processes are what runs in parallel. They are spawned, not forked: a script that
asks for workers needs the usual `if __name__ == "__main__":`. Each takes about a second to start, which is worth it for
searches that last longer.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from dataclasses import dataclass, replace
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any

from checkers import Checker, InputError
from riskplan.result import Plan
from riskplan.scene import Scenario
from riskplan.search import Planner

_POLL = 0.05  # [s] between two looks at `stop`
_GRACE = 2.0  # [s] for a process to end when told to


@dataclass
class _Worker:
    seed: int
    process: SpawnProcess
    answers: Connection


def plan_with_workers(
    scenario: Scenario,
    method: Planner,
    backend: Checker,
    settings: dict[str, Any],
    stop: Callable[[], bool] | None,
) -> Plan:
    """Search with `settings["workers"]` seeds at once.

    With a bound and a planner that ends with its first plan, so does this. Otherwise, as without a bound, all finish
    and the best plan is taken: the one of least cost where the planner states one, else of least risk. With a limit on
    iterations the answer does not depend on the clock: it is that of the lowest seed that has one.

    Raises:
        InputError: as a single search would.
        RuntimeError: if a process ends without an answer.
    """
    context = get_context("spawn")
    workers: list[_Worker] = []
    try:
        for seed in range(settings["seed"], settings["seed"] + settings["workers"]):
            ours, theirs = context.Pipe(duplex=False)
            asked = (scenario, method, backend, {**settings, "seed": seed})
            process = context.Process(target=_search, args=(theirs, os.getpid(), asked), daemon=True)
            process.start()
            theirs.close()
            workers.append(_Worker(seed, process, ours))
        first = settings["bound"] is not None and not getattr(method, "anytime", False)
        return _chosen(workers, first, settings["iterations"] is not None, stop)
    finally:
        for worker in workers:
            _end(worker)


def _chosen(workers: list[_Worker], first: bool, ordered: bool, stop: Callable[[], bool] | None) -> Plan:
    """Listen until the answer is clear."""
    found: dict[int, Plan] = {}
    waiting = {worker.answers: worker.seed for worker in workers}
    while waiting:
        for answers in wait(list(waiting), _POLL):
            assert isinstance(answers, Connection)  # noqa: S101  what was passed in
            seed = waiting.pop(answers)
            found[seed] = _received(answers, seed)
        solved = [seed for seed, plan in found.items() if plan.solved]
        if first and solved and not (ordered and any(seed < min(solved) for seed in waiting.values())):
            break
        if stop is not None and stop() and found:
            break
    candidates = [found[seed] for seed in sorted(found)]
    best = min(candidates, key=lambda plan: (not plan.solved, 0.0 if first else _merit(plan)))
    return replace(best, stats={**best.stats, "answers": len(found)})


def _received(answers: Connection, seed: int) -> Plan:
    try:
        answer = answers.recv()
    except EOFError:
        raise RuntimeError(f"workers: the process with seed {seed} ended without an answer") from None
    if isinstance(answer, Plan):
        return answer
    kind, text = answer
    raise (InputError(text) if kind == "InputError" else RuntimeError(f"workers: seed {seed}: {kind}: {text}"))


def _merit(plan: Plan) -> float:
    """Cost where the planner states one, else risk: less is better."""
    cost = plan.stats.get("cost")
    if isinstance(cost, float):
        return cost
    return 0.0 if plan.risk is None else float(plan.risk.total)


def _end(worker: _Worker) -> None:
    """Leave no process behind."""
    worker.process.terminate()
    worker.process.join(_GRACE)
    if worker.process.is_alive():
        worker.process.kill()
        worker.process.join()
    worker.process.close()
    worker.answers.close()


def _search(answers: Connection, parent: int, asked: tuple[Scenario, Planner, Checker, dict[str, Any]]) -> None:
    """What a process does: search once, tell, and end; also when the one that asked is gone."""
    from riskplan.planning import search_once  # noqa: PLC0415  which imports this module

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the one that asked ends all
    answer: Plan | tuple[str, str]
    try:
        answer = search_once(*asked, stop=lambda: os.getppid() != parent)
    except Exception as error:  # told to the one that asked, whatever it is
        answer = type(error).__name__, str(error)
    answers.send(answer)
    answers.close()
