"""Planning on recorded traffic: `python -m benchmarks.planning --data DIR` prints the README's tables.

Two tasks from each CommonRoad file: `horizon` (a recorded driver replaced for 3 s) and `problem` (the file's own); on
demand `argoverse` (predictions of recorded vehicles around random tasks) and `demos` (the shipped scenes). Every plan
is sampled against its bound and replayed against the recorded rectangles; the recorded driver's own path is scored by
the same evaluator. Times are wall clock per plan, preparation and judging included, after warm-up.

Times are those of a replanner on a known road among agents predicted anew: every timed plan gets agents that were never
planned among, and pays for bringing them into arrays; what is prepared once per road and per size of vehicle is made
before, by a plan of one iteration that is not timed. The price of risk is the median over the solved tasks of the ratio
of two runs, one right after the other: with agents, and on the same road without any, of the same seed and bound.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter, process_time

import numpy as np
import shapely

import riskplan as rp
from benchmarks.planning_tasks import KINDS, Task, progress, tasks_of_kinds
from checkers.backends.monte_carlo import clopper_pearson
from predictor import Track
from riskplan.evaluator import RiskEvaluator
from riskplan.report import sample_risk

BOUNDS = (0.1, 0.01, 0.001, 1e-5)
PLANNERS = ("rrt", "prm")


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
    parser.add_argument("--tasks", default="horizon,problem", help=f"comma-separated, of {', '.join(KINDS)}")
    parser.add_argument("--planners", default=",".join(PLANNERS), help="which, comma-separated")
    parser.add_argument("--bounds", default=",".join(map(str, BOUNDS)), help="on the total, comma-separated")
    parser.add_argument("--limit", type=float, default=5.0, help="time limit of a search [s]")
    parser.add_argument("--dependence", default="independent", help="independent, persistent or boole")
    parser.add_argument("--moments", action="store_true", help="agents by moments to order 8 only, and projected-sos 8")
    parser.add_argument("--cpu", action="store_true", help="processor time instead of wall clock, for a busy machine")
    parser.add_argument("--long", type=float, default=60.0, help="time limit of the reference run [s]; 0 for none")
    parser.add_argument("--long-files", type=int, default=10, help="how many tasks get the reference run")
    parser.add_argument("--samples", type=int, default=20_000, help="Monte Carlo samples per plan")
    options = parser.parse_args(arguments)
    options.planners = options.planners.split(",")
    options.bounds = [float(b) for b in options.bounds.split(",")]
    kinds = options.tasks.split(",")
    files, tasks = tasks_of_kinds(kinds, Path(options.data), options.files, options.seed)
    if not tasks:
        print(f"benchmarks.planning: no tasks of {options.tasks} under {options.data}", file=sys.stderr)
        return 2
    warm_up(tasks, options)
    checker = "projected-sos of order 8" if options.moments else "exact"
    how = f"checker {checker}, dependence {options.dependence}, {'processor time' if options.cpu else 'wall clock'}"
    print(f"{files}, seed {options.seed}; ego: six discs along the lane; {how}")
    for kind in kinds:
        report(kind, [t for t in tasks if t.kind == kind], options)
    return 0


def warm_up(tasks: list[Task], options: argparse.Namespace) -> None:
    """Load the compiled kernels."""
    for planner in options.planners:
        run(tasks[0], planner, 0.01, 0.2, options)


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
    every = [(t, p) for t in progress(tasks, kind) for p in options.planners]
    outcomes, empty = [], {}
    for t, p in every:
        rp.plan(t.scenario, p, bound=options.bounds[0], time_limit=options.limit, iterations=1)
        for b in options.bounds:
            outcomes.append(run(t, p, b, options.limit, options))
            if outcomes[-1].plan.solved:
                empty[t.name, p, b] = run(without_agents(t), p, b, options.limit, options)
    print_solved(outcomes, empty, options)
    print_unsolved(outcomes)
    print_truth(outcomes, options)
    if kind == "horizon":
        print_least_risk([run(t, p, None, 1.0, options) for t, p in every if not p.endswith("-capped")], drivers)
        if options.long > 0 and options.long_files > 0:
            print_reference(outcomes, tasks[:: max(1, len(tasks) // options.long_files)], options)


def run(task: Task, planner: str, bound: float | None, limit: float, options: argparse.Namespace) -> Outcome:
    """One plan, timed, among agents that are new to the planner."""
    scenario, checker = task.scenario.with_agents([replace(a) for a in task.scenario.agents]), rp.checker("exact")
    if options.moments:
        scenario, checker = (
            scenario.with_agents([a.moments(8) for a in scenario.agents]),
            rp.checker("projected-sos", order=8),
        )
    elif options.dependence == "persistent":
        scenario = scenario.with_agents([rp.persistent(a) for a in scenario.agents])
    clock = process_time if options.cpu else perf_counter
    began = clock()
    plan = rp.plan(scenario, planner, checker, bound, options.dependence, time_limit=limit, seed=task.seed)
    return Outcome(task, planner, bound, plan, clock() - began)


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


def print_solved(
    outcomes: list[Outcome], empty: dict[tuple[str, str, float], Outcome], options: argparse.Namespace
) -> None:
    """Shares, times, price of risk and decisions."""
    print(
        f"| planner | bound | in 1 s | in {options.limit:g} s | median [ms] | p95 [ms] "
        "| preparation, search, judging [ms] | no agents [ms] | price of risk | decisions/s |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    for planner, bound, rows in cases(outcomes):
        solved = [o for o in rows if o.plan.solved]
        if not solved:
            print(f"| {planner} | {bound:g} | 0 % | 0 % | – | – | – | – | – | {decisions(rows):.1e} |")
            continue
        times = np.array([o.seconds for o in solved])
        plain = np.array([empty[o.task.name, planner, bound].seconds for o in solved])
        within = [f"{np.sum(times <= limit) / len(rows):.0%}" for limit in (1.0, options.limit)]
        parts = [1e3 * np.median([o.plan.stats[k] for o in solved]) for k in ("preparation", "search", "judging")]
        print(
            f"| {planner} | {bound:g} | {within[0]} | {within[1]} "
            f"| {1e3 * np.median(times):.3g} | {1e3 * np.quantile(times, 0.95):.3g} "
            f"| {parts[0]:.1f}, {parts[1]:.1f}, {parts[2]:.1f} "
            f"| {1e3 * np.median(plain):.3g} | {np.median(times / plain):.1f} | {decisions(rows):.1e} |"
        )


def cases(outcomes: list[Outcome]) -> Iterator[tuple[str, float, list[Outcome]]]:
    """The outcomes by planner and bound, in the order they were run."""
    for planner, bound in dict.fromkeys((o.planner, o.bound) for o in outcomes if o.bound is not None):
        yield planner, bound, [o for o in outcomes if (o.planner, o.bound) == (planner, bound)]


def decisions(rows: list[Outcome]) -> float:
    """Poses × agent modes judged per second, everything else that planning does included."""
    searched = [o for o in rows if "checked_steps" in o.plan.stats]
    modes = [sum(a.means.shape[1] for a in o.task.scenario.agents) for o in searched]
    count = sum(o.plan.stats["checked_steps"] * m for o, m in zip(searched, modes, strict=True))
    return float(count / max(sum(o.seconds for o in searched), 1e-9))


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
    print("\nUnsolved: " + (", ".join(f"{k} {v}" for k, v in reasons.most_common()) or "none") + ".")


def print_truth(outcomes: list[Outcome], options: argparse.Namespace) -> None:
    """Monte Carlo against the bound, replay against the recording."""
    print(
        "\n| planner | bound | plans | Monte Carlo above bound | collisions expected from the stated risk "
        "| replayed (95 % interval) |"
    )
    print("|---|---|---|---|---|---|")
    for planner, bound, rows in cases(outcomes):
        solved = [o for o in rows if o.plan.solved]
        if not solved:
            continue
        over = sum(exceeds(o, options) for o in progress(solved, "sampling"))
        hits = sum(collides(o.plan, o.task) for o in solved)
        low, high = clopper_pearson(np.array([hits]), len(solved), 0.95)
        expected = sum(float(o.plan.risk.total) for o in solved if o.plan.risk is not None)
        print(
            f"| {planner} | {bound:g} | {len(solved)} | {over} | {expected:.3g} "
            f"| {hits} ({low[0] * len(solved):.2g} to {high[0] * len(solved):.2g}) |"
        )


def exceeds(outcome: Outcome, options: argparse.Namespace) -> bool:
    """Whether the sampled risk is above the bound beyond its interval."""
    task, plan = outcome.task, outcome.plan
    if not task.scenario.agents or outcome.bound is None:
        return False
    agents = task.scenario.agents
    if options.dependence == "persistent":
        agents = tuple(rp.persistent(a) for a in agents)
    sampled = sample_risk(plan.poses, plan.times, agents, task.scenario.ego, options.samples, options.seed)
    return sampled.interval[0] > outcome.bound


def print_least_risk(outcomes: list[Outcome], drivers: dict[str, float]) -> None:
    """`bound=None` against the recorded driver, at 90 % of his progress or more."""
    print("\n| planner, bound=None, 1 s | arrived | no riskier than the driver | median stated risk, plan | driver |")
    print("|---|---|---|---|---|")
    for planner in dict.fromkeys(o.planner for o in outcomes):
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


def print_reference(outcomes: list[Outcome], tasks: list[Task], options: argparse.Namespace) -> None:
    """How many of the tasks that a long run solves are solved in 1 s."""
    print(f"\n| planner | bound | of {len(tasks)} tasks, solved in {options.long:g} s | of these in 1 s |")
    print("|---|---|---|---|")
    quick = {(o.task.name, o.planner, o.bound): o for o in outcomes}
    for planner, bound, _ in cases(outcomes):
        solved = fast = 0
        for task in progress(tasks, f"reference {planner} {bound:g}"):
            known = quick[task.name, planner, bound]
            if not known.plan.solved:
                known = run(task, planner, bound, options.long, options)
            solved += known.plan.solved
            fast += known.plan.solved and known.seconds <= 1.0
        print(f"| {planner} | {bound:g} | {solved} | {fast} |")


if __name__ == "__main__":
    sys.exit(main())
