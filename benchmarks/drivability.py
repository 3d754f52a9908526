"""Plans for CommonRoad's own problems, exported and judged by commonroad-drivability-checker: prints tables.

    python -m benchmarks.drivability --data DIR --python drivability/bin/python [--model PM]

commonroad-drivability-checker 2025.4 needs commonroad-io 2024.3, riskplan's environment has a later one. So the
solutions are judged in a second environment, whose interpreter `--python` names (`benchmarks/drivability_judge.py`):

    python -m venv drivability
    drivability/bin/pip install commonroad-drivability-checker==2025.4.0 commonroad-io==2024.3 triangle

Every planning problem of the files is planned for, among traffic predicted from what its start knows, with the body of
CommonRoad's BMW 320i: a `KinematicCar` for the point mass PM, a `KinematicBicycle` with its axles for KS. The checker
looks at the recorded traffic, which the bound on the risk allows to hit. Status 2 if nothing can be judged.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import riskplan as rp
from benchmarks.cases import table
from benchmarks.drivability_judge import CHECKS
from benchmarks.planning_tasks import progress
from riskplan.io.commonroad import CommonRoadScene, load_commonroad
from riskplan.io.solution import AXLES

JUDGE = Path(__file__).with_name("drivability_judge.py")
BMW = 2
LENGTH, WIDTH = 4.508, 1.610  # [m] of vehicle 2 (Althoff & Würsching 2020, table 6), as the rows below
MAX_STEERING_RATE = 0.4  # [rad/s]
POWER = 11.5 * 7.319  # [m²/s³] KS accelerates by at most this over its speed (section 3: a_max v_switch / v)
COSTS = {"PM": "JB1", "KS": "SM1"}


@dataclass(frozen=True)
class Solution:
    """An exported solution of a planning problem."""

    name: str
    scenario: Path
    file: Path


def main(arguments: list[str] | None = None) -> int:
    """Parse, plan, judge, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, metavar="DIR", help="searched for CommonRoad files")
    parser.add_argument("--python", default=sys.executable, metavar="PATH", help="interpreter that has the checker")
    parser.add_argument("--planner", default="rrt", choices=rp.planners(), metavar="NAME")
    parser.add_argument("--files", type=int, default=40, help="how many, spread evenly over the sorted list")
    parser.add_argument("--model", default="PM", choices=COSTS, help="vehicle model of the solutions; default PM")
    parser.add_argument("--bound", type=float, default=0.01, help="on the total risk")
    parser.add_argument("--limit", type=float, default=5.0, help="time limit of a search [s]")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, metavar="DIR", help="keep the solutions there")
    args = parser.parse_args(arguments)
    try:
        versions = judged(args.python, [])["versions"]  # before minutes of planning
    except JudgeError as error:
        print(f"benchmarks.drivability: {error}", file=sys.stderr)
        return 2
    files = sorted(args.data.rglob("*.xml"))
    if not files:
        print(f"benchmarks.drivability: no CommonRoad files under {args.data}", file=sys.stderr)
        return 2
    chosen = [files[i] for i in np.unique(np.linspace(0, len(files) - 1, args.files).astype(int))]
    with tempfile.TemporaryDirectory() as temporary:
        out = args.out or Path(temporary)
        out.mkdir(parents=True, exist_ok=True)
        solutions, other = planned(chosen, out, args)
        try:
            verdicts = judged(args.python, [(str(s.scenario), str(s.file)) for s in solutions])["verdicts"]
        except JudgeError as error:
            print(f"benchmarks.drivability: {error}", file=sys.stderr)
            return 1
    print(f"{len(chosen)} of {len(files)} files, seed {args.seed}, {args.planner}, bound {args.bound:g}", end="; ")
    print(", ".join(f"{name} {number}" for name, number in versions.items()))
    report(args.model, [s.name for s in solutions], verdicts, other)
    return 0


def planned(files: list[Path], out: Path, args: argparse.Namespace) -> tuple[list[Solution], Counter[str]]:
    """The solutions written to `out`, and how many problems have none, by reason."""
    solutions, other = [], Counter[str]()
    for path in progress(files, "plans"):
        try:
            scene = load_commonroad(path)
        except rp.InputError as error:
            print(error, file=sys.stderr)
            other["unreadable file"] += 1
            continue
        for i in range(len(scene.problems)):
            name = path.stem if len(scene.problems) == 1 else f"{path.stem} problem {i}"
            try:
                scenario = scene.scenario(i, vehicle(args.model, scene, i))
            except rp.InputError as error:
                print(f"{name}: {error}", file=sys.stderr)
                other["no scenario"] += 1
                continue
            plan = rp.plan(scenario, args.planner, "exact", args.bound, time_limit=args.limit, seed=args.seed)
            if not plan.solved:
                other[plan.status] += 1
                continue
            file = out / f"{path.stem}-{i}.xml"
            costs = COSTS[args.model]
            rp.save_solution(plan, file, path, i, vehicle_model=args.model, vehicle_type=BMW, cost_function=costs)
            solutions.append(Solution(name, path, file))
    return solutions, other


def vehicle(model: str, scene: CommonRoadScene, problem: int) -> rp.KinematicCar | rp.KinematicBicycle:
    """The BMW 320i, as the solution's model knows it."""
    if model == "PM":
        return rp.KinematicCar(length=LENGTH, width=WIDTH)
    front, rear = AXLES[BMW]
    given = rp.KinematicBicycle()
    # the fastest it can be at the end of the problem, where the engine allows least
    fastest = scene.problems[problem].start.speed + given.max_acceleration * scene.problems[problem].window[1]
    return rp.KinematicBicycle(
        length=LENGTH,
        width=WIDTH,
        wheelbase=front + rear,
        rear=rear,
        max_steering_rate=MAX_STEERING_RATE,
        max_acceleration=min(given.max_acceleration, POWER / max(min(fastest, given.max_speed), 1.0)),
    )


class JudgeError(Exception):
    """No verdicts: one line that says why."""


def judged(python: str, pairs: list[tuple[str, str]]) -> dict[str, Any]:
    """What `drivability_judge.py` answers about (scenario file, solution file)s; JudgeError if it cannot."""
    command = [python, "-I", str(JUDGE)]
    try:
        run = subprocess.run(command, input=json.dumps(pairs), capture_output=True, text=True, check=False)
    except OSError as error:
        raise JudgeError(f"--python {python}: {error.strerror}") from None
    if run.returncode:
        said = run.stderr.strip().splitlines()[-1:] or [f"status {run.returncode}"]
        if run.returncode == 3:
            raise JudgeError(f"--python {python} has no commonroad-drivability-checker: {said[0]}; see --help")
        raise JudgeError(f"{JUDGE.name}: {said[0]}")
    return json.loads(run.stdout)


def report(model: str, names: list[str], verdicts: list[dict[str, str | None]], other: Counter[str]) -> None:
    """How many solutions pass each check, and why the others do not."""
    passed = [sum(v[check] is None for v in verdicts) for check in CHECKS]
    whole = sum(all(v[check] is None for check in CHECKS) for v in verdicts)
    problems = len(names) + other.total()
    counts = [problems, len(names), *passed, whole]
    table(f"{model} solutions", ["problems", "solutions", *CHECKS, "all"], [list(map(str, counts))])
    print("\nNo plan: " + (", ".join(f"{why} {n}" for why, n in other.most_common()) or "none") + ".")
    failed = [
        [name, check, str(v[check])] for name, v in zip(names, verdicts, strict=True) for check in CHECKS if v[check]
    ]
    if failed:
        table("Failures", ["problem", "check", "reason"], failed)


if __name__ == "__main__":
    raise SystemExit(main())
