"""Coverage-guided fuzzing by atheris (the extra `fuzz`), from the seeds of `corpus`."""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
from collections import Counter
from pathlib import Path

import atheris

from .trial import limits, tried

_CODE = ["riskplan", "predictor", "checkers", "yaml", "zipfile", "commonroad.common.reader"]


def guided(target: str, runs: int, seconds: float, megabytes: int, keep: Path | None) -> int:
    """Fuzz one importer; print the count and the findings. Ends the process, as libFuzzer does."""
    os.environ["NUMBA_DISABLE_JIT"] = "1"  # instrumented kernels do not compile: run them as the Python they are
    folder = Path(tempfile.mkdtemp(prefix="riskplan-fuzz-"))
    pool = folder / "corpus"
    pool.mkdir()
    with atheris.instrument_imports(include=_CODE):
        from .campaign import seeds  # noqa: PLC0415
        from .targets import Targets  # noqa: PLC0415

        take = Targets(folder, judged=False).all()[target]
        for seed in seeds(target):  # readers are imported when first used
            (pool / hashlib.sha1(seed).hexdigest()).write_bytes(seed)  # noqa: S324  a file name
            take(seed)
    findings: Counter[str] = Counter()
    counts = [0, 0]

    def one(data: bytes) -> None:
        accepted, finding, _ = tried(take, data, seconds)
        counts[0] += 1
        counts[1] += bool(accepted)
        if finding:
            findings[finding] += 1
            if keep and findings[finding] == 1:
                keep.mkdir(parents=True, exist_ok=True)
                (keep / f"{target}-guided-{counts[0]}").write_bytes(data)
        if counts[0] == runs:
            print(f"{target}, guided by coverage: {counts[0]} inputs, {counts[1]} accepted, {len(findings)} findings")
            for text, count in findings.most_common():
                print(f"{count:6d} × {text}")
            sys.stdout.flush()

    options = ["-verbosity=0", "-print_final_stats=0", "-max_len=20000", f"-runs={runs}", "-rss_limit_mb=0"]
    atheris.Setup([sys.argv[0], *options, str(pool)], one)
    with limits(megabytes):
        atheris.Fuzz()
    return 0
