"""Planning on recorded traffic: `python -m benchmarks.planning --data DIR` prints the README's tables.

Two tasks from each CommonRoad file: `horizon` (a recorded driver replaced for 3 s) and `problem` (the file's own).
Every plan is sampled against its bound and replayed against the recorded rectangles; the recorded driver's own path is
scored by the same evaluator. Times are wall clock per plan, preparation and judging included, after warm-up.
"""

from __future__ import annotations

import argparse
import sys
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import TypeVar

import numpy as np
import shapely

import riskplan as rp
from checkers.backends.monte_carlo import clopper_pearson
from predictor import Track
from riskplan.evaluator import RiskEvaluator
from riskplan.io.commonroad import CommonRoadScene, load_commonroad
from riskplan.report import sample_risk

BOUNDS = (0.1, 0.01, 0.001)
PLANNERS = ("rrt", "prm")
T = TypeVar("T")


@dataclass(frozen=True)
class Task:
    """One planning task and the recording that judges it."""

    name: str
    kind: str
    scenario: rp.Scenario
    others: tuple[Track, ...]
    driver: Track | None
    seed: int


@dataclass(frozen=True)
class Outcome:
    """What one planner made of one task at one bound."""

    task: Task
    planner: str
    bound: float | None
    plan: rp.Plan
    seconds: float


def main(arguments: list[str] | None = None) -> int:
    """Parse, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", required=True, help="directory with CommonRoad files, searched recursively")
    parser.add_argument("--files", type=int, default=40, help="how many files, spread evenly over the sorted list")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--tasks", default="horizon,problem", help="which tasks, comma-separated")
    parser.add_argument("--long", type=float, default=60.0, help="time limit of the reference run [s]; 0 for none")
    parser.add_argument("--long-files", type=int, default=10, help="how many tasks get the reference run")
    parser.add_argument("--samples", type=int, default=20_000, help="Monte Carlo samples per plan")
    options = parser.parse_args(arguments)
    files = sorted(Path(options.data).rglob("*.xml"))
    if not files:
        print(f"benchmarks.planning: no .xml files under {options.data}", file=sys.stderr)
        return 2
    chosen = [files[i] for i in np.unique(np.linspace(0, len(files) - 1, options.files).astype(int))]
    tasks = list(progress([t for f in chosen for t in tasks_of(f, options.seed)], "tasks"))
    if not tasks:
        print(f"benchmarks.planning: no tasks in the {len(chosen)} files chosen", file=sys.stderr)
        return 2
    warm_up(tasks)
    print(f"{len(chosen)} of {len(files)} files, seed {options.seed}; ego: six discs along the lane; checker exact")
    for kind in options.tasks.split(","):
        report(kind, [t for t in tasks if t.kind == kind], options)
    return 0


def tasks_of(path: Path, seed: int) -> Iterator[Task]:
    """The tasks of one file; files without one are skipped with a note."""
    scene = load_commonroad(path)
    number = zlib.crc32(path.name.encode()) + seed
    horizon = scene.horizon_task(np.random.default_rng(number))
    if horizon is not None:
        yield Task(scene.name, "horizon", horizon.scenario, horizon.others, horizon.driver, number % 2**31)
    try:
        scenario = scene.scenario()
    except rp.InputError as error:
        print(f"{path.name}: {error}", file=sys.stderr)
        return
    yield Task(scene.name, "problem", scenario, recorded(scene, scenario), None, number % 2**31)


def recorded(scene: CommonRoadScene, scenario: rp.Scenario) -> tuple[Track, ...]:
    """What the agents of the file's own problem really did."""
    start = scene.problems[0].time
    names = {a.name for a in scenario.agents}
    end = start + float(scenario.horizon or 0.0)
    return tuple(
        t.window(start, end) for t in scene.tracks if t.name in names and t.times[0] <= start + 1e-6 < t.times[-1]
    )


def warm_up(tasks: list[Task]) -> None:
    """Load the compiled kernels."""
    for planner in PLANNERS:
        rp.plan(tasks[0].scenario, planner=planner, time_limit=0.2)


def report(kind: str, tasks: list[Task], options: argparse.Namespace) -> None:
    """Run one kind of task and print its tables."""
    if not tasks:
        print(f"\n### `{kind}`: no tasks in these files")
        return
    drivers = {t.name: stated(t.scenario, t.driver) for t in tasks if t.driver is not None}
    print(
        f"\n### `{kind}`: {len(tasks)} tasks, median {np.median([len(t.scenario.agents) for t in tasks]):.0f} agents\n"
    )
    if drivers:
        print_drivers(drivers)
    outcomes = [run(t, p, b, 5.0) for t in progress(tasks, kind) for p in PLANNERS for b in BOUNDS]
    empty = {(t.name, p): run(without_agents(t), p, 0.1, 5.0) for t in progress(tasks, "no agents") for p in PLANNERS}
    print_solved(outcomes, empty)
    print_unsolved(outcomes)
    print_truth(outcomes, options)
    if kind == "horizon":
        print_least_risk([run(t, p, None, 1.0) for t in progress(tasks, "least risk") for p in PLANNERS], drivers)
        if options.long > 0:
            print_reference(outcomes, tasks[:: max(1, len(tasks) // options.long_files)], options.long)


def run(task: Task, planner: str, bound: float | None, limit: float) -> Outcome:
    """One plan, timed."""
    began = perf_counter()
    plan = rp.plan(task.scenario, planner=planner, bound=bound, time_limit=limit, seed=task.seed)
    return Outcome(task, planner, bound, plan, perf_counter() - began)


def without_agents(task: Task) -> Task:
    """The same task on an empty road."""
    return Task(task.name, task.kind, task.scenario.with_agents(()), (), None, task.seed)


def stated(scenario: rp.Scenario, driver: Track) -> float:
    """Risk of the recorded driver's path by the same evaluator."""
    poses = np.column_stack([driver.positions, driver.headings])
    evaluator = RiskEvaluator(scenario.agents, scenario.ego, rp.checker("exact"), scenario.times)
    risk, _ = evaluator.judge(poses)
    return 0.0 if risk is None else float(risk.total)


def collides(plan: rp.Plan, task: Task) -> bool:
    """Whether the plan's rectangle meets a recorded one at a common grid time."""
    car = task.scenario.vehicle
    for other in task.others:
        for time, position, heading in zip(other.times, other.positions, other.headings, strict=True):
            step = round(float(time) / task.scenario.time_step)
            if step >= len(plan.poses):
                break
            x, y, own = plan.poses[step]
            if np.hypot(*(position - (x, y))) > car.length + other.length:
                continue
            if rectangle((x, y), own, car.length, car.width).intersects(
                rectangle(position, heading, other.length, other.width)
            ):
                return True
    return False


def rectangle(centre: object, heading: float, length: float, width: float) -> shapely.Polygon:
    """An oriented rectangle."""
    c, s = np.cos(heading), np.sin(heading)
    corners = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * [length / 2, width / 2]
    return shapely.Polygon(corners @ np.array([[c, s], [-s, c]]) + np.asarray(centre))


def print_drivers(drivers: dict[str, float]) -> None:
    """The yardstick: what the statement says of paths that hit nobody."""
    values = np.array(list(drivers.values()))
    shares = ", ".join(f"{np.mean(values <= b):.0%} within {b:g}" for b in BOUNDS)
    print(f"Recorded drivers' own paths: median stated risk {np.median(values):.3g}; {shares}.\n")


def print_solved(outcomes: list[Outcome], empty: dict[tuple[str, str], Outcome]) -> None:
    """Shares, times, price of risk."""
    print("| planner | bound | in 1 s | in 5 s | median [ms] | p95 [ms] | same tasks, no agents [ms] | price of risk |")
    print("|---|---|---|---|---|---|---|---|")
    for planner in PLANNERS:
        for bound in BOUNDS:
            rows = [o for o in outcomes if o.planner == planner and o.bound == bound]
            solved = [o for o in rows if o.plan.solved]
            if not solved:
                print(f"| {planner} | {bound:g} | 0 % | 0 % | – | – | – | – |")
                continue
            times = np.array([o.seconds for o in solved])
            plain = np.array([empty[o.task.name, planner].seconds for o in solved])
            within = [f"{np.sum(times <= limit) / len(rows):.0%}" for limit in (1.0, 5.0)]
            print(
                f"| {planner} | {bound:g} | {within[0]} | {within[1]} "
                f"| {1e3 * np.median(times):.0f} | {1e3 * np.quantile(times, 0.95):.0f} "
                f"| {1e3 * np.median(plain):.0f} | {np.median(times) / np.median(plain):.1f} |"
            )


def print_unsolved(outcomes: list[Outcome]) -> None:
    """Why there is no plan, by kind."""
    reasons: Counter[str] = Counter()
    for o in outcomes:
        if not o.plan.solved:
            seen = o.plan.stats.get("lowest_risk_seen")
            detail = (
                ""
                if o.plan.status != "no_plan_found"
                else (", goal seen above the bound" if seen else ", goal not seen")
            )
            reasons[f"{o.plan.status}{detail}"] += 1
    print("\nUnsolved after 5 s: " + (", ".join(f"{k} {v}" for k, v in reasons.most_common()) or "none") + ".")


def print_truth(outcomes: list[Outcome], options: argparse.Namespace) -> None:
    """Monte Carlo against the bound, replay against the recording."""
    above = 0
    print(
        "\n| planner | bound | plans | Monte Carlo above bound | collisions expected from the stated risk "
        "| replayed (95 % interval) |"
    )
    print("|---|---|---|---|---|---|")
    for planner in PLANNERS:
        for bound in BOUNDS:
            solved = [o for o in outcomes if o.planner == planner and o.bound == bound and o.plan.solved]
            if not solved:
                continue
            over = sum(exceeds(o, options.samples, options.seed) for o in progress(solved, "sampling"))
            hits = sum(collides(o.plan, o.task) for o in solved)
            low, high = clopper_pearson(np.array([hits]), len(solved), 0.95)
            expected = sum(float(o.plan.risk.total) for o in solved if o.plan.risk is not None)
            above += over
            print(
                f"| {planner} | {bound:g} | {len(solved)} | {over} | {expected:.3g} "
                f"| {hits} ({low[0] * len(solved):.2g} to {high[0] * len(solved):.2g}) |"
            )


def exceeds(outcome: Outcome, samples: int, seed: int) -> bool:
    """Whether the sampled risk is above the bound beyond its interval."""
    task, plan = outcome.task, outcome.plan
    if not task.scenario.agents or outcome.bound is None:
        return False
    sampled = sample_risk(plan.poses, plan.times, task.scenario.agents, task.scenario.ego, samples, seed)
    return sampled.interval[0] > outcome.bound


def print_least_risk(outcomes: list[Outcome], drivers: dict[str, float]) -> None:
    """`bound=None` against the recorded driver, at 90 % of his progress or more."""
    print("\n| planner, bound=None, 1 s | arrived | no riskier than the driver | median stated risk, plan | driver |")
    print("|---|---|---|---|---|")
    for planner in PLANNERS:
        rows = [o for o in outcomes if o.planner == planner]
        solved = [
            (float(o.plan.risk.total) if o.plan.risk else 0.0, drivers[o.task.name]) for o in rows if o.plan.solved
        ]
        better = sum(plan <= driver for plan, driver in solved)
        plans = np.median([p for p, _ in solved]) if solved else np.nan
        own = np.median(list(drivers.values()))
        print(
            f"| {planner} | {len(solved)}/{len(rows)} | {better / len(rows):.0%} of all tasks "
            f"| {plans:.3g} | {own:.3g} |"
        )


def print_reference(outcomes: list[Outcome], tasks: list[Task], limit: float) -> None:
    """How many of the tasks that a long run solves are solved in 1 s."""
    print(f"\n| planner | bound | of {len(tasks)} tasks, solved in {limit:g} s | of these in 1 s |\n|---|---|---|---|")
    quick = {(o.task.name, o.planner, o.bound): o for o in outcomes}
    for planner in PLANNERS:
        for bound in BOUNDS:
            solved = fast = 0
            for task in progress(tasks, f"reference {planner} {bound:g}"):
                known = quick[task.name, planner, bound]
                if not known.plan.solved:
                    known = run(task, planner, bound, limit)
                solved += known.plan.solved
                fast += known.plan.solved and known.seconds <= 1.0
            print(f"| {planner} | {bound:g} | {solved} | {fast} |")


def progress(items: list[T], what: str) -> Iterator[T]:
    """The items, counted on stderr if that is a terminal."""
    for i, item in enumerate(items):
        if sys.stderr.isatty():
            print(f"\r\033[K{what} {i + 1}/{len(items)}", end="", file=sys.stderr, flush=True)
        yield item
    if sys.stderr.isatty():
        print("\r\033[K", end="", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
