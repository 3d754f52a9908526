"""Run every command and every Python example of the README, in order, in this checkout."""

import os
import re
import subprocess
import sys
from pathlib import Path

DONE_BEFORE = ("make demo", "make test", "make check", "make slow")  # .ci/run has run these, or they are too long
QUICK = {
    "make bench": 'make bench BENCH_ARGS="--files 3 --tasks horizon --long 0 --samples 2000"',
    "python -m benchmarks.propagation": "python -m benchmarks.propagation --scenarios 2 --samples 20000 --repeats 20",
}


def main() -> int:
    """Stop at the first that fails."""
    os.environ["PATH"] = f"{Path('.venv/bin').resolve()}:{os.environ['PATH']}"
    text = Path("README.md").read_text()
    for language, block in re.findall(r"```(sh|python)\n(.*?)```", text, flags=re.DOTALL):
        if language == "python":
            print(f"python: {block.splitlines()[0]} …", flush=True)
            subprocess.run([sys.executable, "-c", block], check=True)
            continue
        for line in block.splitlines():
            command = line.split("#")[0].strip()
            if not command or command.startswith(DONE_BEFORE):
                continue
            for known, quick in QUICK.items():
                command = quick if command.startswith(known) else command
            if "DIR" in command or "make bench" in command:
                if "RISKPLAN_DATA" not in os.environ:
                    print(f"skipped, needs RISKPLAN_DATA: {command}")
                    continue
                command = command.replace("DIR", os.environ["RISKPLAN_DATA"])
            print(f"$ {command}", flush=True)
            subprocess.run(command, shell=True, check=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
