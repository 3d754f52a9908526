"""Many random inputs, each with a limit of time and memory, and what came of them."""

from __future__ import annotations

import contextlib
import json
import random
import resource
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from . import corpus, foreign, mutate
from .targets import Targets
from .trial import limits, tried

# part of all inputs that each importer gets: cheap ones more
SHARES = {
    **{"yaml": 0.08, "plan": 0.08, "npz": 0.12, "xml": 0.06, "roadmap": 0.06, "cli": 0.01},
    **{"argoverse1": 0.05, "argoverse2": 0.04, "nuscenes": 0.06, "waymo": 0.06, "waymo-bytes": 0.08, "autoware": 0.05},
    **{"grid": 0.05, "agents-npz": 0.05, "agents-parquet": 0.04, "tensors": 0.05, "eth-ucy": 0.02, "recordings": 0.02},
    **{"windows": 0.01, "batch-list": 0.01},
}


def maker(target: str) -> Callable[[random.Random], Any]:
    """How inputs of a target are made."""
    if target in foreign.FILES:
        return foreign.maker(target)
    scenes, predictions, commands = corpus.scenarios(), corpus.predictions(), corpus.commands()
    xml, plan, roadmap = corpus.commonroad(), corpus.plan(), corpus.roadmap()

    def text(rng: random.Random, document: Any) -> bytes:
        content = corpus.yaml_bytes(mutate.document(rng, document))
        if rng.random() < 0.01:
            content = content.replace(b": ", b": " + rng.choice((b"[", b"{a: ", b'{"a": ')) * rng.choice((40, 5000)), 1)
        return mutate.raw(rng, content) if rng.random() < 0.15 else content

    return {
        "yaml": lambda rng: text(rng, rng.choice(scenes)),
        "plan": lambda rng: text(rng, plan),
        "npz": lambda rng: mutate.arrays(rng, rng.choice(predictions)),
        "roadmap": lambda rng: mutate.arrays(rng, roadmap),
        "xml": lambda rng: mutate.xml(rng, xml),
        "cli": lambda rng: mutate.command(rng, rng.choice(commands)),
    }[target]


def made(make: Callable[[random.Random], Any], name: str) -> Any:
    """An input; where spoiling itself overflows, another one."""
    for attempt in range(100):
        with contextlib.suppress(ArithmeticError, RuntimeError, ValueError, MemoryError), np.errstate(all="ignore"):
            return make(random.Random(f"{name}:{attempt}"))
    raise RuntimeError(f"no input could be made for {name}")


def campaign(inputs: int, only: str | None, seed: int, seconds: float, megabytes: int, keep: Path | None) -> int:
    """Run and print."""
    findings: Counter[tuple[str, str]] = Counter()
    rows, total = [], 0
    with tempfile.TemporaryDirectory() as name:
        targets = Targets(Path(name)).all()
        for target in [only] if only else list(SHARES):
            make, count = maker(target), inputs if only else round(inputs * SHARES[target])
            for warm in seeds(target):  # compiled before the clock and the limit count
                targets[target](warm)
            accepted, slowest, began = 0, 0.0, perf_counter()
            with limits(megabytes):
                for i in range(count):
                    data = made(make, f"{seed}:{target}:{i}")
                    took, finding, spent = tried(targets[target], data, seconds)
                    accepted, slowest = accepted + bool(took), max(slowest, spent)
                    if finding:
                        findings[target, finding] += 1
                        if keep and findings[target, finding] == 1:
                            keep.mkdir(parents=True, exist_ok=True)
                            content = data if isinstance(data, bytes) else json.dumps(data).encode()
                            (keep / f"{target}-{i}").write_bytes(content)
            total += count
            memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            rows.append((target, count, accepted, 1e3 * slowest, memory, perf_counter() - began))
            print(f"{target}: {count} inputs, {perf_counter() - began:.0f} s", flush=True)
    print("\n| importer | inputs | accepted | slowest [ms] | peak memory so far [MB] | seconds |")
    print("|---|---|---|---|---|---|")
    for row in rows:
        print("| {} | {} | {} | {:.0f} | {:.0f} | {:.0f} |".format(*row))
    print(f"\n{total} inputs, {sum(findings.values())} with findings, of {len(findings)} kinds")
    for (target, finding), count in findings.most_common():
        print(f"{count:6d} × {target}: {finding}")
    return 1 if findings else 0


def seeds(target: str) -> list[Any]:
    """Valid inputs of a target."""
    if target in foreign.FILES:
        return list(foreign.seeds(target))
    return {
        "yaml": [corpus.yaml_bytes(d) for d in corpus.scenarios()],
        "plan": [corpus.yaml_bytes(corpus.plan())],
        "npz": [corpus.npz(d) for d in corpus.predictions()],
        "roadmap": [corpus.npz(corpus.roadmap())],
        "xml": [corpus.commonroad()],
        "cli": corpus.commands(),
    }[target]
