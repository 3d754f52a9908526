"""One scenario at a time in a process of its own, so that whatever a scenario does ends with that process.

Parent and child talk in lines of JSON over pipes. A child that takes too long is killed, one that dies is replaced;
either becomes the reason of a row.
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import select
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from time import perf_counter
from typing import Any

STARTING = 600.0  # a first start ever compiles kernels [s]


class Child:
    """A worker process; `ask` hands it one scenario."""

    def __init__(self, planner: str) -> None:
        threads = dict.fromkeys(("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
        self._process = subprocess.Popen(
            [sys.executable, "-m", "riskplan.batching_child"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, **threads},
            start_new_session=True,  # Ctrl-C reaches the parent, which then ends its children
        )
        self.planner = planner
        self.answer({"warm_up": planner}, STARTING)

    def answer(self, request: dict[str, Any], limit: float) -> dict[str, Any] | str:
        """What the child answers within `limit` s; else why not: "timed_out", or how it died. It is gone then."""
        process = self._process
        pipe_in, pipe_out = process.stdin, process.stdout
        if pipe_in is None or pipe_out is None:  # never: both are pipes
            return "no pipes"
        deadline = perf_counter() + limit
        try:
            pipe_in.write(json.dumps(request).encode() + b"\n")
            pipe_in.flush()
        except OSError:
            return self._death()
        got = bytearray()
        while not got.endswith(b"\n"):
            ready, _, _ = select.select([pipe_out], [], [], max(deadline - perf_counter(), 0.0))
            if not ready:
                self.close()
                return "timed_out"
            more = os.read(pipe_out.fileno(), 1 << 16)
            if not more:
                return self._death()
            got += more
        found: dict[str, Any] = json.loads(got)
        return found

    @property
    def alive(self) -> bool:
        """Whether it can be asked."""
        return self._process.poll() is None

    def kill(self) -> None:
        """End it, whatever it is at."""
        self._process.kill()

    def close(self) -> None:
        """End it and let go of its pipes."""
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()

    def _death(self) -> str:
        status = self._process.wait()
        self.close()
        try:
            return f"ended by {signal.Signals(-status).name}" if status < 0 else f"ended with status {status}"
        except ValueError:
            return f"ended by signal {-status}"


class Children:
    """The workers of this process: lent one at a time, kept between shards."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._idle: list[Child] = []
        self._lent: set[Child] = set()
        self._closed = False

    def ask(self, planner: str, request: dict[str, Any], limit: float) -> dict[str, Any] | str:
        """One scenario to a child; see `Child.answer`."""
        with self._lending(planner) as child:
            return child.answer(request, limit)

    def open(self) -> None:
        """Lend again after `close`."""
        self._closed = False

    def close(self) -> None:
        """End all, lent ones too: what waits for them is told so."""
        with self._lock:
            self._closed = True
            idle, self._idle = self._idle, []
            busy = list(self._lent)
        for child in busy:
            child.kill()  # whoever waits for it closes it
        for child in idle:
            child.close()

    @contextlib.contextmanager
    def _lending(self, planner: str) -> Iterator[Child]:
        with self._lock:
            fitting = [c for c in self._idle if c.planner == planner and c.alive]
            child = fitting[0] if fitting else None
            if child is not None:
                self._idle.remove(child)
        if self._closed:
            raise InterruptedError("the batch has ended")
        child = child or Child(planner)
        with self._lock:
            self._lent.add(child)
        try:
            yield child
        finally:
            with self._lock:
                self._lent.discard(child)
                if child.alive and not self._closed:
                    self._idle.append(child)
            if self._closed:
                child.close()


def main() -> int:
    """The child: a line in, a line out, until the parent's end of the pipe closes."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what libraries print is no answer
    requests: queue.Queue[bytes] = queue.Queue()

    def listen() -> None:
        for line in sys.stdin.buffer:
            requests.put(line)
        os._exit(0)  # the parent is gone: nobody waits for what is being computed

    threading.Thread(target=listen, daemon=True).start()
    while True:
        answers.write(json.dumps(_answered(json.loads(requests.get()))).encode() + b"\n")
        answers.flush()


def _answered(request: dict[str, Any]) -> dict[str, Any]:
    from checkers import InputError  # noqa: PLC0415

    began = perf_counter()
    try:
        if "warm_up" in request:
            from riskplan.planning import make_planner  # noqa: PLC0415
            from riskplan.warm_up import warm_up  # noqa: PLC0415

            warm_up(type(make_planner(request["warm_up"])))
            row: dict[str, Any] = {}
        else:
            row = _scored(request) if request["plan"] else _planned(request)
    except InputError as error:
        row = {"status": "bad_input", "reason": _line(error)}
    except Exception as error:  # a scenario that finds a bug must not end the batch
        row = {"status": "error", "reason": f"{type(error).__name__}: {_line(error)}"}
    return {**row, "seconds": perf_counter() - began}


def _planned(request: dict[str, Any]) -> dict[str, Any]:
    from riskplan.io import load_scenario, save_plan  # noqa: PLC0415
    from riskplan.persisting import persisting  # noqa: PLC0415
    from riskplan.planning import plan  # noqa: PLC0415

    s = request["settings"]
    scenario = persisting(load_scenario(request["path"], request["problem"]), s["dependence"])[0]
    made = plan(
        scenario,
        planner=s["planner"],
        checker=s["checker"],
        bound=s["bound"],
        dependence=s["dependence"],
        time_limit=s["time_limit"],
        seed=request["seed"],
    )
    if request["keep"]:
        target = Path(request["keep"])
        target.parent.mkdir(parents=True, exist_ok=True)
        save_plan(made, target)
    return {"status": made.status, "reason": made.message, "agents": len(scenario.agents), **_told(made)}


def _scored(request: dict[str, Any]) -> dict[str, Any]:
    from checkers import InputError, checker  # noqa: PLC0415
    from riskplan.assess import judge_again  # noqa: PLC0415
    from riskplan.io import load_plan, load_scenario  # noqa: PLC0415
    from riskplan.persisting import persisting  # noqa: PLC0415

    stored = load_plan(request["plan"])
    if not stored.solved:
        raise InputError(f"{request['plan']}: expected a plan with a trajectory, got status {stored.status!r}")
    scenario = load_scenario(request["path"], request["problem"])
    scenario = persisting(scenario, str(stored.settings.get("dependence", "independent")))[0]
    judged, same = judge_again(stored, scenario, checker(request["settings"]["checker"]))
    return {
        "status": "scored",
        "reason": "the same numbers as stated" if same else "",
        "agents": len(scenario.agents),
        "stated": None if stored.risk is None else float(stored.risk.total),
        **_told(judged),
    }


def _told(plan: Any) -> dict[str, Any]:
    told: dict[str, Any] = {"bound": plan.bound}
    if plan.risk is not None:
        numbers = {name: float(getattr(plan.risk, name)) for name in ("boole", "max_step")}
        told |= {"risk": float(plan.risk.total), **numbers, "kind": plan.risk.kind.value}
        told |= {"dependence": plan.risk.dependence}
    if len(plan.times):
        columns = zip(("x", "y", "heading"), plan.poses.T.tolist(), strict=True)
        told |= {"times": plan.times.tolist(), **dict(columns), "speed": plan.speeds.tolist()}
    return told


def _line(error: BaseException) -> str:
    return " ".join(str(error).split())[:500]


if __name__ == "__main__":
    sys.exit(main())
