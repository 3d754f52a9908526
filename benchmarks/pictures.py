"""Time and size of pictures of the demo scene: `python -m benchmarks.pictures [--repeats N] [--no-3d] [--demos]`.

Each is drawn in this process after one warm-up draw (imports, compilation); the bytes of all runs are compared. The
aims are those of the project's issue 8. A film has one frame per step of the plan. On a busy machine the CPU column,
browser included (Linux), says more. `--demos` runs the demos of the gallery instead, each in its own process, after
one run that compiles.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter, sleep

import riskplan as rp
from riskplan.doctor import find_browser

# name, file, options, aim [s], largest size [MB]
CASES: tuple[tuple[str, str, dict, float | None, float | None], ...] = (
    ("3-D page", "scene.html", {}, 0.5, 3.0),
    ("top view, still", "top.png", {"view": "top"}, 0.7, None),
    ("top view, film", "top.gif", {"view": "top"}, 15.0, None),
    ("top view, film", "top.mp4", {"view": "top"}, None, None),
    ("3-D, still 1280 x 640", "still.png", {"view": "3d", "size": (1280, 640)}, 4.0, None),
    ("3-D, film 960 x 480", "film.gif", {"view": "3d"}, 15.0, None),
    ("3-D, film 960 x 480", "film.mp4", {"view": "3d"}, None, None),
)

DEMOS = ("overtake", "left_turn", "crowd", "backends", "controls", "requery", "closed_loop")


def main(argv: Sequence[str] | None = None) -> None:
    """Plan once, draw each picture `repeats` times, print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=3, help="draws of each, at least 2; default 3")
    parser.add_argument("--no-3d", action="store_true", help="only what needs no browser")
    parser.add_argument("--demos", action="store_true", help="the demos' time instead; aim 20 s each")
    args = parser.parse_args(argv)
    if args.demos:
        time_demos(args.repeats)
        return
    scenario = rp.load_scenario(Path(rp.__file__).parent / "data" / "overtake.yaml")
    plan = rp.plan(scenario, planner="rrt", checker="exact", bound=0.01, time_limit=10.0, seed=0)
    print(f"{plan.message}; {len(plan.times)} steps, {len(plan.search)} edges of the search; {find_browser()}\n")
    print("| picture | file | best [s] | median [s] | CPU [s] | aim [s] | size [MB] | same bytes |")
    print("|---|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for name, file, options, aim, largest in CASES:
            if options.get("view") == "3d" and (args.no_3d or find_browser() is None):
                continue
            seconds, own, contents = [], [], set()
            if not file.startswith(("film", "still")):
                rp.render(scenario, plan, Path(folder) / file, **options)
            for _ in range(max(2, args.repeats)):
                began = perf_counter()
                with Cpu() as cpu:
                    made = rp.render(scenario, plan, Path(folder) / file, **options)
                seconds.append(perf_counter() - began)
                own.append(cpu.seconds)
                contents.add(made.read_bytes())
            size = len(next(iter(contents))) / 1e6
            limit = f"{size:.2f}" + (f" (≤ {largest:g})" if largest else "")
            times = f"{min(seconds):.2f} | {sorted(seconds)[len(seconds) // 2]:.2f} | {min(own):.2f} | {aim or ''}"
            print(f"| {name} | {Path(file).suffix} | {times} | {limit} | {'yes' if len(contents) == 1 else 'NO'} |")


class Cpu:
    """Processor time of this process and all below it, looked up while they live."""

    def __enter__(self) -> "Cpu":
        self._before, self._seen, self._over = _processor_times(), {}, False
        self._watch = threading.Thread(target=self._look)
        self._watch.start()
        return self

    def _look(self) -> None:
        while not self._over:
            self._seen |= _processor_times()
            sleep(0.05)

    def __exit__(self, *_: object) -> None:
        self._over = True
        self._watch.join()
        self.seconds = sum((self._seen | _processor_times()).values()) - sum(self._before.values())


def _processor_times() -> dict[int, float]:
    """Seconds of this process and of each one below it that lives."""
    rows = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rsplit(")", 1)[1].split()
        except OSError:  # it has ended
            continue
        rows[int(stat.parent.name)] = int(fields[1]), (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    own = {os.getpid()}
    for _ in range(6):  # generations
        own |= {pid for pid, (parent, _) in rows.items() if parent in own}
    return {pid: seconds for pid, (_, seconds) in rows.items() if pid in own}


def time_demos(repeats: int) -> None:
    """Seconds of each demo of the gallery, imports included."""
    root = Path(rp.__file__).parent.parent
    environment = {**os.environ, "PYTHONPATH": str(root)}
    print("| demo | lines | best [s] | CPU without the browser [s] |\n|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "riskplan").symlink_to(root / "riskplan")
        for name in DEMOS:
            script, seconds, own = root / "demos" / f"{name}.py", [], []
            for _ in range(1 + max(1, repeats)):
                began, busy = perf_counter(), os.times().children_user
                subprocess.run([sys.executable, script], cwd=folder, env=environment, check=True, capture_output=True)
                seconds.append(perf_counter() - began)
                own.append(os.times().children_user - busy)
            lines = len(script.read_text().splitlines())
            print(f"| {name} | {lines} | {min(seconds[1:]):.1f} | {min(own[1:]):.1f} |", flush=True)


if __name__ == "__main__":
    main()
