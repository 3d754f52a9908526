"""What planners are measured on: tasks from recorded traffic, from predictions of it, and the shipped scenes."""

from __future__ import annotations

import sys
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.resources import files as packaged
from pathlib import Path
from typing import TypeVar

import numpy as np

import riskplan as rp
from predictor import Track
from riskplan.io.commonroad import CommonRoadScene, load_commonroad

KINDS = ("horizon", "problem", "argoverse", "demos")
T = TypeVar("T")
_AROUND = 2  # agents of an `argoverse` task


@dataclass(frozen=True)
class Task:
    """One planning task and the recording that judges it."""

    name: str
    kind: str
    scenario: rp.Scenario
    others: tuple[Track, ...]
    driver: Track | None
    seed: int


def tasks_of_kinds(kinds: Sequence[str], data: Path, count: int, seed: int) -> tuple[str, list[Task]]:
    """What was read, in words, and the tasks of those kinds."""
    tasks: list[Task] = []
    read = []
    if {"horizon", "problem"} & set(kinds):
        files = sorted(data.rglob("*.xml"))
        chosen = [files[i] for i in np.unique(np.linspace(0, len(files) - 1, count).astype(int))] if files else []
        tasks += [t for f in progress(chosen, "tasks") for t in tasks_of(f, seed) if t.kind in kinds]
        read.append(f"{len(chosen)} of {len(files)} files")
    if "argoverse" in kinds:
        for path in sorted(data.rglob("argoverse1-predictions.npz")):
            tasks += argoverse_tasks(path, count, seed)
            read.append(f"{count} tasks among predictions of {path.name}")
    if "demos" in kinds:
        scenes = sorted(p.name for p in packaged("riskplan.data").iterdir() if p.name.endswith(".yaml"))
        tasks += [Task(n, "demos", rp.load_scenario(packaged("riskplan.data") / n), (), None, seed) for n in scenes]
        read.append(f"{len(scenes)} shipped scenes")
    return ", ".join(read), tasks


def argoverse_tasks(path: Path, count: int, seed: int) -> Iterator[Task]:
    """Random tasks of 3 s on open ground, among two agents whose predictions are moved there.

    Each agent's likeliest mode comes, turned at random, about 10 m from where the ego would be at a constant speed at
    some time between 1 and 3 s.
    """
    with np.load(path) as data:
        weights, means, covariances = data["weights"], data["means"], data["covariances"]
        times = np.concatenate([[0.0], data["times"]])
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        speed = rng.uniform(5.0, 14.0)
        agents = []
        for each in rng.integers(len(weights), size=_AROUND):
            turn = rng.uniform(-np.pi, np.pi)
            c, s = np.cos(turn), np.sin(turn)
            rotation = np.array([[c, -s], [s, c]])
            step = int(rng.integers(10, len(means[each])))
            likeliest = means[each][step, weights[each].argmax()]
            place = np.array([speed * times[step + 1], 0.0]) + 10.0 * rng.standard_normal(2)
            moved = (means[each] - likeliest) @ rotation.T + place
            spread = rotation @ covariances[each] @ rotation.T
            agents.append(
                rp.GaussianMixturePrediction(
                    times[1:], weights[each], moved, spread, name=f"{each}", length=4.6, width=1.9
                )
            )
        scenario = rp.Scenario(
            start=rp.State(0.0, 0.0, 0.0, speed),
            goal=rp.Goal.at(3.0 * speed, 0.0, radius=6.0, heading=0.0, heading_tolerance=0.5, time=(2.5, 3.0)),
            bounds=(-10.0, -30.0, 3.0 * speed + 20.0, 30.0),
            agents=agents,
            ego=rp.EgoCover.discs(4.5, 1.8, n=6),
            horizon=3.0,
        )
        yield Task(f"argoverse {number}", "argoverse", scenario, (), None, number)


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


def progress(items: list[T], what: str) -> Iterator[T]:
    """The items, counted on stderr if that is a terminal."""
    for i, item in enumerate(items):
        if sys.stderr.isatty():
            print(f"\r\033[K{what} {i + 1}/{len(items)}", end="", file=sys.stderr, flush=True)
        yield item
    if sys.stderr.isatty():
        print("\r\033[K", end="", file=sys.stderr, flush=True)
