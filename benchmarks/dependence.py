"""Planning by what is assumed of errors over time: `python -m benchmarks.dependence --data DIR`.

The `horizon` tasks of `benchmarks.planning`, each planned with the same seed as independent steps (six discs), as an
error that persists (six discs, united) and as one that persists with true rectangles. What a check costs is measured
on the same poses for all: recorded drivers' paths shifted aside, charged from the start to the end or the bound.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter

import numpy as np

import riskplan as rp
from benchmarks.planning import collides
from benchmarks.planning_tasks import Task, progress, tasks_of
from checkers.backends.monte_carlo import clopper_pearson
from riskplan.futures import make_evaluator
from riskplan.report import sample_risk

BOUNDS = (0.1, 0.01, 0.001, 1e-5)
PLANNERS = ("rrt", "prm")


@dataclass(frozen=True)
class Assumption:
    """What is assumed of errors over time, and the shape."""

    name: str
    dependence: str
    box: bool

    def scene(self, scenario: rp.Scenario) -> rp.Scenario:
        """The scenario under this assumption."""
        if self.dependence == "persistent":
            scenario = scenario.with_agents([a if a.factors is not None else rp.persistent(a) for a in scenario.agents])
        car = scenario.vehicle
        return replace(scenario, ego=rp.EgoBox(car.length, car.width)) if self.box else scenario


ASSUMPTIONS = (
    Assumption("independent, discs", "independent", False),
    Assumption("persistent, discs", "persistent", False),
    Assumption("persistent, boxes", "persistent", True),
)


def main(arguments: list[str] | None = None) -> int:
    """Parse, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", required=True, help="directory with CommonRoad files, searched recursively")
    parser.add_argument("--files", type=int, default=24, help="how many files, spread evenly over the sorted list")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--limit", type=float, default=1.0, help="time limit of a search [s]")
    parser.add_argument("--samples", type=int, default=100_000, help="Monte Carlo samples per plan")
    options = parser.parse_args(arguments)
    files = sorted(Path(options.data).rglob("*.xml"))
    if not files:
        print(f"benchmarks.dependence: no .xml files under {options.data}", file=sys.stderr)
        return 2
    chosen = [files[i] for i in np.unique(np.linspace(0, len(files) - 1, options.files).astype(int))]
    found = [t for f in progress(chosen, "tasks") for t in tasks_of(f, options.seed)]
    tasks = [t for t in found if t.kind == "horizon" and t.scenario.agents]
    scenes = {a.name: [a.scene(t.scenario) for t in tasks] for a in ASSUMPTIONS}
    for a in ASSUMPTIONS:
        for planner in PLANNERS:
            rp.plan(scenes[a.name][0], planner, time_limit=0.2, dependence=a.dependence)
    agents = np.median([len(t.scenario.agents) for t in tasks])
    print(f"{len(tasks)} `horizon` tasks of {len(chosen)} files, median {agents:.0f} agents, {options.limit:g} s\n")
    print_plans(tasks, scenes, options)
    print_checks(tasks, scenes)
    return 0


def print_plans(tasks: list[Task], scenes: dict[str, list[rp.Scenario]], options: argparse.Namespace) -> None:
    """Solved, time, and the truth of the stated risk."""
    print(
        "| planner | bound | assumption | solved | median [ms] | p95 [ms] | expected, observed collisions | MC above |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for planner in PLANNERS:
        for bound in BOUNDS:
            for a in ASSUMPTIONS:
                seconds, plans = [], []
                for task, scene in progress(list(zip(tasks, scenes[a.name], strict=True)), f"{planner} {bound:g}"):
                    began = perf_counter()
                    found = rp.plan(
                        scene,
                        planner,
                        bound=bound,
                        time_limit=options.limit,
                        seed=task.seed,
                        dependence=a.dependence,
                    )
                    if found.solved:
                        seconds.append(1e3 * (perf_counter() - began))
                        plans.append((task, scene, found))
                times = f"{np.median(seconds):.0f} | {np.quantile(seconds, 0.95):.0f}" if seconds else "- | -"
                expected = sum(float(p.risk.total) for _, _, p in plans if p.risk is not None)
                hits = sum(collides(p, t) for t, _, p in plans)
                above = sum(sampled_above(s, p, bound, a, options.samples) for _, s, p in plans)
                print(
                    f"| {planner} | {bound:g} | {a.name} | {len(plans)}/{len(tasks)} | {times} "
                    f"| {expected:.3f}, {hits} | {above} |",
                    flush=True,
                )


def sampled_above(scene: rp.Scenario, plan: rp.Plan, bound: float, a: Assumption, samples: int) -> bool:
    """Whether sampled futures put the plan above its bound, at 99.9 %."""
    seen = sample_risk(
        plan.poses, plan.times, scene.agents, scene.ego, samples, 1, exact_shape=a.dependence == "persistent"
    )
    low, _ = clopper_pearson(np.array([round(seen.total * samples)]), samples, 0.999)
    return bool(low[0] > bound)


def print_checks(tasks: list[Task], scenes: dict[str, list[rp.Scenario]]) -> None:
    """Time per pose checked, on the same poses for all."""
    print("\n| bound | " + " | ".join(f"{a.name} [µs per pose]" for a in ASSUMPTIONS) + " |")
    print("|---|" + "---|" * len(ASSUMPTIONS))
    for bound in BOUNDS:
        cells = []
        for a in ASSUMPTIONS:
            took, poses = 0.0, 0
            for task, scene in zip(tasks, scenes[a.name], strict=True):
                one, many = charged(task, scene, a, bound)
                took, poses = took + one, poses + many
            cells.append(f"{1e6 * took / poses:.2f}")
        print(f"| {bound:g} | " + " | ".join(cells) + " |", flush=True)


def charged(task: Task, scene: rp.Scenario, a: Assumption, bound: float, paths: int = 40) -> tuple[float, int]:
    """Seconds for charging the driver's path, shifted aside by up to a lane, in motions of ten steps; and its poses."""
    assert task.driver is not None  # noqa: S101  of a horizon task
    checker = rp.checker("exact")
    evaluator = make_evaluator(scene.agents, scene.ego, checker, scene.times, a.dependence, 1e-2 * bound)
    rng = np.random.default_rng(task.seed)
    driven = np.column_stack([task.driver.positions, task.driver.headings])[: len(scene.times)]
    after = np.zeros(evaluator.groups)
    evaluator.charge(driven[1:2], 1, np.zeros(evaluator.groups), np.inf, after)  # packs the agents
    took, count = 0.0, 0
    for shift in rng.uniform(-3.5, 3.5, paths):
        aside = np.column_stack([-np.sin(driven[:, 2]), np.cos(driven[:, 2]), np.zeros(len(driven))])
        poses = np.ascontiguousarray(driven + shift * aside)
        before = np.zeros(evaluator.groups)
        for first in range(1, len(poses), 10):
            after = np.empty_like(before)
            began = perf_counter()
            total = evaluator.charge(poses[first : first + 10], first, before, bound, after)
            took += perf_counter() - began
            count += len(poses[first : first + 10])
            if total > bound:
                break
            before = after
    return took, count


if __name__ == "__main__":
    sys.exit(main())
