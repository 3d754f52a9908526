"""Is a stated risk true? `python -m benchmarks.truth --data DIR [--plot FILE]`.

Recorded traffic (CommonRoad files the shipped predictors were not fitted on), 3 s at a time, a recorded driver
replaced. What is stated of three kinds of path, among the others as predicted from their past, against what happened to
them (true rectangles at every step, as long as an agent was recorded):

- the driver's own path, which he chose seeing the others;
- paths of the planner's tree grown without other agents;
- plans returned at a bound.

Networks that read the ego's future are told the path that is judged: what they state is conditional on it.

Paths of one file meet the same traffic, so intervals of observed shares count clusters of files: Clopper & Pearson
(1934) with the number of paths divided by the design effect of the ratio estimator (Kish 1965).
"""

from __future__ import annotations

import argparse
import sys
import zlib
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import repeat
from multiprocessing import get_context
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from scipy.stats import beta

import riskplan as rp
from benchmarks.cases import table
from benchmarks.planning import rectangle
from benchmarks.planning_tasks import progress
from checkers.shapes import EgoShape
from checkers.validate import Array
from predictor import ConstantVelocity, Manoeuvres
from predictor.constant_velocity import Spread
from predictor.lanes import Lane
from predictor.tracks import SLACK, Track
from riskplan.io.commonroad import CommonRoadScene, HorizonTask, load_commonroad

DEPENDENCE = ("boole", "independent", "persistent")
PLAIN, SPREAD, MODES = "one spread for all", "spread of the situation", "manoeuvres"
# from the paper's way of stating to ours, one step at a time: predictor, shape, dependence
STEPS = (
    (PLAIN, "ellipse", "independent", "one spread, one ellipse, independent steps"),
    (SPREAD, "ellipse", "independent", "spread of the situation"),
    (SPREAD, "rectangles", "independent", "true rectangles"),
    (SPREAD, "rectangles", "persistent", "errors persist"),
    (MODES, "rectangles", "persistent", "manoeuvres"),
)
# judged on the paths of trees too
ON_TREES = (*(step[:3] for step in STEPS), (MODES, "rectangles", "independent"), (MODES, "rectangles", "boole"))
PLANNED = (STEPS[0], STEPS[3], STEPS[4])
SHAPES = ("ellipse", "six discs", "rectangles")
KEYS = [(p, s, d) for p in (PLAIN, SPREAD, MODES) for s in SHAPES for d in DEPENDENCE]
Stated = dict[tuple[str, str, str], list[Array]]
Agents = tuple[rp.GaussianMixturePrediction, ...]
T = TypeVar("T")
BINS = np.array([0.0, 1e-3, 0.01, 0.03, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0])
BOUNDS = (0.1, 0.01)
TOLERANCE = 1e-2
# maximum likelihood on the same files as the shipped parameters, the same spread in every situation
GLOBAL = ConstantVelocity(
    Spread([-0.226, 0, 0, 0, 0, 0], [-1.492, 0, 0, 0, 0, 0], [1.307, 1.61], 0.05),
    Spread([-0.435, 0, 0], [-1.466, 0, 0], [1.467, 1.585], 0.05),
)


@dataclass(frozen=True)
class Drive:
    """A driver's recorded path and others (B, T, 3) in its place, among agents, in the file `cluster`.

    Attributes:
        cluster: name of the file.
        tasks: by predictor.
        agents: by predictor, one set for all paths or one for each; each agent as far as it was recorded, errors
            persistent.
        paths: (B, T, 3); the first is the driver's.
        hits: (B,) whether the path met a recorded rectangle.
    """

    cluster: str
    tasks: dict[str, HorizonTask]
    agents: dict[str, tuple[Agents, ...]]
    paths: Array
    hits: np.ndarray

    @property
    def task(self) -> HorizonTask:
        """What all predictors share of it."""
        return self.tasks[MODES]


@dataclass(frozen=True)
class Learned:
    """A network for agents of which it knows enough past; the shipped manoeuvres for the others.

    Attributes:
        network: of positions.
        ego: (T, 3) path that it is told, its start included; None: it is told nothing.
    """

    network: rp.LearnedPredictor
    ego: Array | None = None

    @property
    def conditional(self) -> bool:
        """Whether it asks what the ego will do."""
        return self.network.model.config.ego_future

    def predict(
        self, past: Track, times: Array, lanes: Sequence[Lane] = (), others: Sequence[Track] = ()
    ) -> rp.GaussianMixturePrediction:
        """As `Manoeuvres.predict`."""
        config = self.network.model.config
        if past.times[-1] - past.times[0] < (config.observed - 1) * config.dt - SLACK:
            return Manoeuvres.fitted().predict(past, times, lanes, others)
        course = None if self.ego is None else self.ego[1 : config.predicted + 1, :2]
        found = self.network.predict([past], lanes=lanes, times=times, ego_future=course)
        return cast("rp.GaussianMixturePrediction", found[0])


@dataclass(frozen=True)
class Planned:
    """What came of planning: under (predictor, shape, dependence), its stated risk if solved, and what it met."""

    key: tuple[str, str, str]
    bound: float
    cluster: str
    risk: float | None
    hit: bool


def main(arguments: list[str] | None = None) -> int:
    """Parse, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--data", type=Path, required=True, help="directory with CommonRoad files, searched recursively"
    )
    parser.add_argument(
        "--weights",
        action="append",
        default=[],
        metavar="FILE",
        help="a network of positions to judge too, trained by benchmarks.prediction --fitted-on; may be repeated",
    )
    parser.add_argument("--plot", type=Path, help="picture of the reliability to write")
    parser.add_argument("--files", type=int, default=100, help="at most so many files, spread evenly")
    parser.add_argument("--drives", type=int, default=6, help="drivers replaced per file")
    parser.add_argument("--paths", type=int, default=3, help="paths of the tree per driver")
    parser.add_argument("--plans", type=int, default=1, help="drivers per file for whom plans are made")
    parser.add_argument("--limit", type=float, default=1.0, help="time limit of a plan [s]")
    parser.add_argument("--reach", type=float, default=30.0, help="agents farther from every path are left out [m]")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    args = parser.parse_args(arguments)
    files = held_out(sorted(args.data.rglob("*.xml")))
    if not files:
        print(f"benchmarks.truth: no .xml files under {args.data}", file=sys.stderr)
        return 2
    chosen = [files[i] for i in np.unique(np.linspace(0, len(files) - 1, args.files).astype(int))]
    with ProcessPoolExecutor(args.jobs, mp_context=get_context("spawn")) as pool:
        done = list(progress_of(pool.map(study, chosen, repeat(args)), len(chosen)))
    drives = [d for found, _, _ in done for d in found]
    if not drives:
        print(f"benchmarks.truth: no drives in {len(chosen)} files", file=sys.stderr)
        return 2
    stated: Stated = {key: [r for _, risks, _ in done for r in risks[key]] for key in done[0][1]}
    agents = np.median([len(d.agents[MODES][0]) for d in drives])
    print(
        f"{len(drives)} drives of 3 s in {len({d.cluster for d in drives})} files, "
        f"median {agents:.0f} agents within {args.reach:g} m"
    )
    print_drivers(drives, stated)
    print_steps(stated)
    print_tree(drives, stated)
    print_plans([p for _, _, plans in done for p in plans], args.limit)
    if args.plot:
        plot(args.plot, drives, stated)
    return 0


def study(path: Path, args: argparse.Namespace) -> tuple[list[Drive], Stated, list[Planned]]:
    """Drives of one file, what is stated of them, and plans for the first few."""
    drives = drives_of(path, args)
    stated = {
        key: [stated_risks(d, *key, whole=key in ON_TREES or key not in KEYS) for d in drives] for key in keys_of(args)
    }
    plans = [
        planned(d, (predictor, shape, dependence), bound, args.limit)
        for d in drives[: args.plans]
        for predictor, shape, dependence, _ in PLANNED
        for bound in BOUNDS
    ]
    return drives, stated, plans


def progress_of(items: Iterable[T], count: int) -> Iterator[T]:
    """The items, counted on stderr if that is a terminal."""
    for item, _ in zip(items, progress(list(range(count)), "files"), strict=True):
        yield item


def held_out(files: Sequence[Path]) -> list[Path]:
    """Those the shipped predictors were judged on, if they are there; else all."""
    names = set(Manoeuvres.fitted().summary["held_out"])
    return [f for f in files if f.stem in names] or list(files)


def predictors(weights: Sequence[str]) -> dict[str, Any]:
    """By name; a network goes by its file's folder."""
    ours = {PLAIN: GLOBAL, SPREAD: ConstantVelocity.fitted(), MODES: Manoeuvres.fitted()}
    return ours | {label(file): Learned(rp.LearnedPredictor.load(file)) for file in weights}


def label(weights: str) -> str:
    """The name of a network's folder."""
    return Path(weights).resolve().parent.name


def keys_of(args: argparse.Namespace) -> list[tuple[str, str, str]]:
    """What is stated of the drivers' paths; of networks with true rectangles only, persistent if their modes are."""
    found = list(KEYS)
    for file in args.weights:
        persists = rp.LearnedPredictor.load(file).model.config.weights == "persistent"
        found += [(label(file), SHAPES[2], d) for d in (DEPENDENCE if persists else DEPENDENCE[:2])]
    return found


def drives_of(path: Path, args: argparse.Namespace) -> list[Drive]:
    """Drives of one file, no driver twice within its 3 s."""
    scene = load_commonroad(path)
    known, found = predictors(args.weights), dict[tuple[str, float], Drive]()
    for i in range(args.drives):
        seed = zlib.crc32(path.name.encode()) + args.seed + i
        tasks: dict[str, HorizonTask] = {}
        for name, predictor in known.items():
            one = scene.horizon_task(np.random.default_rng(seed), predictor=predictor)
            if one is not None:
                tasks[name] = one
        if not tasks:
            break
        task = tasks[MODES]
        if any(name == task.driver.name and abs(t - task.t0) < 3.0 for name, t in found):
            continue
        own = np.column_stack([task.driver.positions, task.driver.headings])
        paths = np.stack([own, *tree_paths(task, args.paths, seed % 2**31, len(own))])
        agents: dict[str, tuple[Agents, ...]] = {}
        for name, one in tasks.items():
            predictor = known[name]
            if isinstance(predictor, Learned) and predictor.conditional:
                agents[name] = tuple(told(scene, predictor, path, seed, args.reach) for path in paths)
            else:
                agents[name] = (seen(one, paths, args.reach),)
        if agents[MODES][0]:
            hits = np.array([collided(p, task) for p in paths])
            found[task.driver.name, task.t0] = Drive(path.stem, tasks, agents, paths, hits)
    return list(found.values())


def tree_paths(task: HorizonTask, count: int, seed: int, steps: int) -> list[Array]:
    """Branches of trees grown without other agents that reach the goal."""
    alone = task.scenario.with_agents(())
    plans = [rp.plan(alone, "rrt", time_limit=0.3, seed=(seed + i) % 2**31) for i in range(count)]
    return [p.poses for p in plans if p.solved and len(p.poses) == steps]


def told(scene: CommonRoadScene, predictor: Learned, path: Array, seed: int, reach: float) -> Agents:
    """As `seen`, by a network that knows that the ego will drive this path (T, 3)."""
    task = scene.horizon_task(np.random.default_rng(seed), predictor=replace(predictor, ego=path))
    assert task is not None  # noqa: S101  it was one for the others
    return seen(task, path[None], reach)


def seen(task: HorizonTask, paths: Array, reach: float) -> Agents:
    """The agents that some mean brings near some path, cut to the steps at which they were recorded."""
    out = []
    for agent, other in zip(mixtures(task.scenario), task.others, strict=True):
        count = min(len(other.times), paths.shape[1])
        away = agent.means[None, :count] - paths[:, :count, None, :2]
        if np.hypot(away[..., 0], away[..., 1]).min() < reach:
            cut = agent.at(agent.times[:count])
            out.append(cut if cut.factors is not None or cut.modes == "per_step" else rp.persistent(cut))
    return tuple(out)


def mixtures(scenario: rp.Scenario) -> list[rp.GaussianMixturePrediction]:
    """The agents, all of them of a predictor."""
    return [a for a in scenario.agents if isinstance(a, rp.GaussianMixturePrediction)]


def shapes(drive: Drive) -> dict[str, EgoShape]:
    """From the paper's ellipse to the true rectangles."""
    car = drive.task.scenario.vehicle
    (agents,) = drive.agents[MODES]
    longest = max(a.length or 0.0 for a in agents), max(a.width or 0.0 for a in agents)
    return {
        SHAPES[0]: rp.EgoEllipsoid.around(car.length, car.width, *longest),
        SHAPES[1]: rp.EgoCover.discs(car.length, car.width, 6, relative_heading=0.0),
        SHAPES[2]: rp.EgoBox(car.length, car.width),
    }


def stated_risks(drive: Drive, predictor: str, shape: str, dependence: str, *, whole: bool) -> Array:
    """(B,) total over the agents, capped at 1; of the driver's own path only, if not `whole`."""
    paths = drive.paths if whole else drive.paths[:1]
    ego, sets = shapes(drive)[shape], drive.agents[predictor]
    if len(sets) == 1:
        return total_risk(paths, sets[0], ego, dependence)
    return np.concatenate([total_risk(p[None], a, ego, dependence) for p, a in zip(paths, sets, strict=False)])


def total_risk(paths: Array, agents: Agents, ego: EgoShape, dependence: str) -> Array:
    """(B,) of paths (B, T, 3), over agents each as long as it was recorded, capped at 1."""
    total = np.zeros(len(paths))
    by_length: dict[int, list[rp.GaussianMixturePrediction]] = {}
    for agent in agents:
        by_length.setdefault(len(agent.times), []).append(agent)
    for count, alike in by_length.items():
        total += rp.path_risk(paths[:, :count], alike, ego, dependence, tolerance=TOLERANCE).total
    return np.minimum(total, 1.0)


def collided(path: Array, task: HorizonTask) -> bool:
    """Whether the ego's rectangle met a recorded one at a common step."""
    car, step = task.scenario.vehicle, task.scenario.time_step
    for other in task.others:
        rows = np.rint(other.times / step).astype(int)
        inside = rows < len(path)
        close = np.hypot(*(other.positions[inside] - path[rows[inside], :2]).T) <= car.length + other.length
        for i in np.flatnonzero(inside)[close]:
            own = rectangle(path[rows[i], :2], path[rows[i], 2], car.length, car.width)
            if own.intersects(rectangle(other.positions[i], other.headings[i], other.length, other.width)):
                return True
    return False


def interval(hits: np.ndarray, clusters: np.ndarray) -> tuple[float, float]:
    """95 % of the share of hits, by the effective number of independent ones among clustered."""
    count, share = len(hits), float(np.mean(hits))
    effect = 1.0
    if 0 < share < 1:
        sums = np.array([(hits[clusters == c] - share).sum() for c in np.unique(clusters)])
        effect = max(1.0, float((sums**2).sum()) / (count * share * (1 - share)))
    effective, successes = count / effect, share * count / effect
    low = 0.0 if successes == 0 else float(beta.ppf(0.025, successes, effective - successes + 1))
    high = 1.0 if share == 1 else float(beta.ppf(0.975, successes + 1, effective - successes))
    return low, high


def expected(risks: Array) -> str:
    """Number of collisions that independent drives at these risks would see, with the 95 % interval."""
    drawn = (np.random.default_rng(0).random((4000, len(risks))) < risks).sum(axis=1)
    low, high = np.quantile(drawn, (0.025, 0.975))
    return f"{risks.sum():.2f} ({low:.0f} to {high:.0f})"


def print_drivers(drives: list[Drive], stated: Stated) -> None:
    """What is stated of the drivers' own paths."""
    rows: list[list[object]] = []
    for key, risks in stated.items():
        own = np.array([r[0] for r in risks])
        quartiles = [float(q) for q in np.quantile(own, (0.25, 0.5, 0.75))]
        rows.append([*key, *quartiles, float(np.mean(own <= 0.02)), expected(own)])
    head = ["predictor", "shape", "dependence", "lower quartile", "median stated risk", "upper quartile"]
    table("Recorded drivers' own paths", [*head, "share ≤ 2 %", "collisions stated (95 %)"], rows)
    hits = np.array([d.hits[0] for d in drives])
    low, high = interval(hits, np.array([d.cluster for d in drives]))
    print(f"\nObserved: {hits.sum()} collisions in {len(hits)}, share {low:.3g} to {high:.3g}.")


def print_steps(stated: Stated) -> None:
    """How much each step away from the paper's statement contributes."""
    rows: list[list[object]] = []
    before = None
    for predictor, shape, dependence, label in STEPS:
        median = float(np.median([r[0] for r in stated[predictor, shape, dependence]]))
        rows.append([label, median, "" if before is None else f"{before / max(median, 1e-12):.1f}"])
        before = median
    table("Drivers' own paths, one step at a time", ["step", "median stated risk", "times less"], rows)


def print_tree(drives: list[Drive], stated: Stated) -> None:
    """Stated against observed, paths of trees that saw nobody."""
    clusters = np.array([d.cluster for d in drives for _ in d.paths[1:]])
    hits = np.concatenate([d.hits[1:] for d in drives])
    if not len(hits):
        return
    low, high = interval(hits, clusters)
    print(
        f"\n{len(hits)} paths of trees grown without other agents: {hits.mean():.3f} collided ({low:.3f} to {high:.3f})"
    )
    rows: list[list[object]] = []
    for key in [*ON_TREES, *(k for k in stated if k not in KEYS)]:
        risks = stated[key]
        flat = np.concatenate([r[1:] for r in risks])
        score = float(np.mean((flat - hits) ** 2))
        log = float(-np.mean(np.log(np.where(hits, np.clip(flat, 1e-6, 1), np.clip(1 - flat, 1e-6, 1)))))
        rows.append([*key, float(flat.mean()), score, log])
    table("the same, stated", ["predictor", "shape", "dependence", "mean stated risk", "Brier score", "log loss"], rows)
    for predictor, shape, dependence, _ in (STEPS[0], STEPS[3], STEPS[4]):
        flat = np.concatenate([r[1:] for r in stated[predictor, shape, dependence]])
        title = f"Reliability on these: {predictor}, {shape}, {dependence}"
        table(
            title, ["stated", "paths", "mean stated", "observed", "95 %", "within"], reliability(flat, hits, clusters)
        )


def reliability(risks: Array, hits: np.ndarray, clusters: np.ndarray) -> list[list[object]]:
    """Bins of stated risk: range, number, mean stated, observed share, interval, whether it holds the mean."""
    rows: list[list[object]] = []
    which = np.clip(np.searchsorted(BINS, risks, side="right") - 1, 0, len(BINS) - 2)
    for b in np.unique(which):
        mine = which == b
        low, high = interval(hits[mine], clusters[mine])
        mean = float(risks[mine].mean())
        name = f"{BINS[b]:g} to {BINS[b + 1]:g}"
        held = "yes" if low <= mean <= high else "no"
        rows.append([name, int(mine.sum()), mean, float(hits[mine].mean()), f"{low:.3g} to {high:.3g}", held])
    return rows


def print_plans(plans: list[Planned], limit: float) -> None:
    """Plans at a bound, by what was assumed when they were made."""
    rows: list[list[object]] = []
    for predictor, shape, dependence, _ in PLANNED:
        for bound in BOUNDS:
            mine = [p for p in plans if p.key == (predictor, shape, dependence) and p.bound == bound]
            made = [p for p in mine if p.risk is not None]
            hits = np.array([p.hit for p in made], dtype=bool)
            low, high = interval(hits, np.array([p.cluster for p in made])) if made else (0.0, 1.0)
            stated = expected(np.array([p.risk for p in made], dtype=float))
            row = [predictor, shape, dependence, bound, f"{len(made)}/{len(mine)}", stated, int(hits.sum())]
            rows.append([*row, f"{low:.3g} to {high:.3g}"])
    head = [
        "predictor",
        "shape",
        "dependence",
        "bound",
        "solved",
        "collisions stated (95 %)",
        "observed",
        "share, 95 %",
    ]
    table(f"Returned plans, rrt, {limit:g} s", head, rows)


def planned(drive: Drive, key: tuple[str, str, str], bound: float, limit: float) -> Planned:
    """A plan for the driver's task, all agents in view for its whole time."""
    predictor, shape, dependence = key
    scenario = drive.tasks[predictor].scenario
    agents = [a if a.factors is not None else rp.persistent(a) for a in mixtures(scenario)]
    scenario = replace(scenario.with_agents(agents), ego=shapes(drive)[shape])
    plan = rp.plan(scenario, "rrt", bound=bound, dependence=dependence, time_limit=limit)
    if plan.risk is None:
        return Planned(key, bound, drive.cluster, None, False)
    return Planned(key, bound, drive.cluster, float(plan.risk.total), collided(plan.poses, drive.task))


def plot(path: Path, drives: list[Drive], stated: Stated) -> None:
    """Bins of stated risk against observed share, paths of trees that saw nobody; drivers' own stated risks above."""
    import matplotlib as mpl  # noqa: PLC0415  slow to import, only for this

    mpl.use("Agg")
    from matplotlib import pyplot as plt  # noqa: PLC0415

    clusters = np.array([d.cluster for d in drives for _ in d.paths[1:]])
    hits = np.concatenate([d.hits[1:] for d in drives])
    figure, (above, below) = plt.subplots(2, 1, figsize=(7, 8.5), height_ratios=(1, 2.2), layout="constrained")
    for i, (predictor, shape, dependence, label) in enumerate(STEPS):
        own = np.sort([r[0] for r in stated[predictor, shape, dependence]])
        name = label if i == 0 else f"+ {label}"
        above.step(
            np.maximum(own, 1e-6), np.arange(1, len(own) + 1) / len(own), where="post", color=f"C{i}", label=name
        )
        if i in (1, 2):
            continue
        flat = np.concatenate([r[1:] for r in stated[predictor, shape, dependence]])
        found = reliability(flat, hits, clusters)
        x, y = (np.array([row[k] for row in found], dtype=float) for k in (2, 3))
        ends = np.array([[float(v) for v in str(row[4]).split(" to ")] for row in found])
        bars = np.abs(ends.T - y)
        below.errorbar(x + 0.004 * (i - 3), y, bars, fmt="o-", capsize=3, color=f"C{i}", label=name)
    above.set(xscale="log", xlabel="stated risk", ylabel="share of drivers", title="Recorded drivers' own paths")
    above.legend(fontsize="small")
    below.plot([0, 1], [0, 1], "k:", linewidth=1)
    below.set(
        xlabel="stated risk", ylabel="observed collisions, 95 %", title="Paths of trees grown without other agents"
    )
    below.legend(fontsize="small", loc="upper left")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)
    plt.close(figure)


if __name__ == "__main__":
    sys.exit(main())
