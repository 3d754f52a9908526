"""What is fuzzed: a target raises a `Finding` unless its input is refused by one line, or read right."""

from __future__ import annotations

import contextlib
import io
import os
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import riskplan as rp
from checkers.backends.monte_carlo import clopper_pearson

from . import corpus, foreign

LONGEST = 2000  # characters of a message
EGO = rp.EgoEllipsoid.around(4.5, 1.8, 4.5, 1.8)


class Finding(Exception):
    """Something other than InputError, or values that are not as promised."""


class Targets:
    """The importers, fed by way of files in one folder."""

    def __init__(self, folder: Path, *, judged: bool = True) -> None:
        self.folder, self.judged = folder, judged
        (folder / "agent.npz").write_bytes(corpus.npz(corpus.predictions()[0]))
        self.scene, self.plan_file = folder / "scene.yaml", folder / "plan.json"
        self.scene.write_bytes(corpus.yaml_bytes(corpus.scenarios()[0]))
        self.plan_file.write_bytes(corpus.yaml_bytes(corpus.plan()))

    def all(self) -> dict[str, Callable[[Any], bool]]:
        """By name; each tells whether the input was accepted."""
        return {
            "yaml": lambda data: self._scenario(data, ".yaml"),
            "xml": lambda data: self._scenario(data, ".xml"),
            "npz": self._prediction,
            "plan": self._plan,
            "roadmap": self._roadmap,
            "cli": self._command,
            **{name: partial(self._foreign, name) for name in foreign.FILES},
        }

    def _file(self, name: str, data: bytes) -> Path:
        path = self.folder / name
        path.write_bytes(data)
        return path

    def _scenario(self, data: bytes, suffix: str) -> bool:
        path = self._file(f"input{suffix}", data)
        scenario = refused(lambda: rp.load_scenario(path))
        if scenario is not None:
            # judging costs far more than reading: every fourth
            check_scenario(scenario, judged=self.judged and zlib.crc32(data) % 4 == 0)
        return scenario is not None

    def _prediction(self, data: bytes) -> bool:
        path = self._file("input.npz", data)
        found = refused(lambda: rp.load_prediction(path))
        if found is not None:
            check_agent(found)
        return found is not None

    def _plan(self, data: bytes) -> bool:
        path = self._file("input.json", data)
        plan = refused(lambda: rp.load_plan(path))
        if plan is None:
            return False
        finite("plan", plan.times, plan.poses, plan.speeds)
        if plan.risk is not None:
            share("plan.risk", np.append(plan.risk.per_agent, plan.risk.total))
            share("plan.risk", plan.risk.per_step)
        saved = self.folder / "again.json"
        rp.save_plan(plan, saved)
        rp.load_plan(saved)
        if plan.solved and self.judged:
            scenario = rp.load_scenario(self.scene)
            judged = refused(lambda: _judged(plan, scenario))
            if judged is not None and judged.risk is not None:
                share("judged", np.append(judged.risk.per_agent, judged.risk.total))
        return True

    def _roadmap(self, data: bytes) -> bool:
        path = self._file("roadmap.npz", data)
        roadmap = refused(lambda: rp.Roadmap.load(path))
        if roadmap is not None:
            finite("roadmap", roadmap.vertices, roadmap.lengths, roadmap.curves)
        return roadmap is not None

    def _foreign(self, target: str, data: bytes) -> bool:
        folder = self.folder / target
        folder.mkdir(exist_ok=True)
        names = foreign.FILES[target]
        paths = [self._file(f"{target}/{n}", p) for n, p in zip(names, foreign.parted(data, len(names)), strict=True)]
        for path in paths[1:]:
            if not path.stat().st_size:
                path.unlink()
        found = refused(lambda: foreign.read(target, paths))
        if found is not None:
            self._check_foreign(found, judged=self.judged and zlib.crc32(data) % 4 == 0)
        return found is not None

    def _check_foreign(self, found: Any, *, judged: bool) -> None:
        """What was read is as promised: scenarios and agents as everywhere; a grid's obstacles hold its cells."""
        if isinstance(found, rp.Scenario):
            check_scenario(found, judged=judged)
        elif isinstance(found, rp.OccupancyGrid):
            check_grid(found)
        elif isinstance(found, rp.Windows):
            finite("windows", found.past, found.headings, found.speeds, found.sizes)
        else:
            for item in found if isinstance(found, list | tuple) else [found]:
                if isinstance(item, rp.Recording):
                    for track in item.tracks:
                        finite("recording", track.times, track.positions, track.headings, track.speeds)
                elif isinstance(item, rp.GaussianMixturePrediction):
                    check_agent(item)
                    last = item.at(item.times[-1:])
                    if judged:
                        check_risk(last, np.append(last.means[0, 0] + 1.0, 0.3), EGO)

    def _command(self, words: list[str]) -> bool:
        from riskplan.cli import main  # noqa: PLC0415

        places = {"{scene}": self.scene, "{plan}": self.plan_file, "{out}": self.folder / "out"}
        argv = [str(places.get(word, word)) for word in words]
        out, err = io.StringIO(), io.StringIO()
        here = os.getcwd()
        os.chdir(self.folder)
        try:
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
                status = main(argv)
        except SystemExit as end:
            status = int(end.code or 0)
        finally:
            os.chdir(here)
        if status not in (0, 1, 2) or (status == 2 and err.getvalue().count("\n") > 2):
            raise Finding(f"status {status}: {err.getvalue()[-1500:]}")
        return status != 2


def refused(read: Callable[[], Any]) -> Any:
    """What is read; None if it is refused as it should be: InputError, one line, not endless."""
    try:
        return read()
    except rp.InputError as error:
        text = str(error)
        if "\n" in text or len(text) > LONGEST:
            raise Finding(f"message of {len(text)} characters, {text.count(chr(10))} line breaks") from error
        return None


def check_scenario(s: rp.Scenario, *, judged: bool) -> None:
    """An accepted scenario holds what a scenario promises, and its risks are not below the truth."""
    finite("scenario", np.array(s.bounds), np.array([s.start.x, s.start.y, s.start.heading, s.start.speed]))
    if s.steps < 1 or not len(s.times) == s.steps + 1:
        raise Finding("grid")
    for agent in s.agents:
        check_agent(agent)
    ways = [np.array([s.start.x, s.start.y, s.start.heading])]
    for agent in s.agents[: 3 if judged else 0]:
        try:
            last = agent.at(agent.times[-1:])
            ways.append(np.append(last.means[0, 0] + 1.0, 0.3))
            for pose in ways:
                check_risk(last, pose, s.ego)
        except rp.InputError:
            continue


def check_grid(grid: rp.OccupancyGrid) -> None:
    """The middles of blocked cells lie in an obstacle, those of free cells in none."""
    x, y, yaw = grid.origin
    c, s = np.cos(yaw), np.sin(yaw)
    if not np.isfinite(grid.resolution * max(grid.blocked.shape)) or grid.blocked.size > 10_000:
        return
    obstacles = grid.obstacles
    finite("grid", *obstacles)
    inside = np.zeros(grid.blocked.shape, dtype=bool)
    rows, columns = np.indices(inside.shape)
    turned = np.array([[c, -s], [s, c]])  # columns: the grid's axes in the world
    size = grid.resolution * max(inside.shape) + abs(x) + abs(y)
    for corners in obstacles:
        own = (corners - [x, y]) @ turned / grid.resolution
        low, high = own.min(axis=0), own.max(axis=0)
        inside |= (columns + 0.5 > low[0]) & (columns + 0.5 < high[0]) & (rows + 0.5 > low[1]) & (rows + 0.5 < high[1])
    if size < 1e9 * grid.resolution and not np.array_equal(inside, grid.blocked):
        raise Finding("grid: obstacles are not the blocked cells")


def check_agent(agent: Any) -> None:
    """Finite means, positive semi-definite covariances, weights that sum to 1."""
    try:
        means, covariances, weights = agent.means, agent.covariances, agent.step_weights
    except rp.InputError:
        return
    finite("agent", means, covariances, agent.times)
    share("weights", weights)
    if np.abs(weights.sum(axis=-1) - 1).max() > 1e-9:
        raise Finding(f"weights sum to {weights.sum(axis=-1)}")
    lowest = np.linalg.eigvalsh(covariances)[..., 0]
    if (lowest < -1e-9 * np.abs(covariances).max(axis=(-1, -2))).any():
        raise Finding("covariance not positive semi-definite")


def check_risk(one: Any, pose: np.ndarray, ego: Any) -> None:
    """At one time: what claims to be exact or a bound is not below the share of samples that collide."""
    for name in ("exact", "marshall-olkin"):
        try:
            risk = rp.checker(name)(pose[None], one, ego)
        except rp.InputError:
            continue
        share(name, risk.value)
        if name == "exact" and one.order is None and hasattr(one, "sample"):
            value = float((one.step_weights * risk.value).sum())
            low = sampled(one, pose, ego)
            if value < low - 1e-9:
                raise Finding(f"exact states {value}, sampled at least {low}")


def sampled(one: Any, pose: np.ndarray, ego: Any, n: int = 400) -> float:
    """A lower end of the risk by sampling, wrong once in 1e9."""
    points = one.sample(n, np.random.default_rng(0))[:, 0] - pose[:2]
    c, s = np.cos(pose[2]), np.sin(pose[2])
    own = points @ np.array([[c, -s], [s, c]])
    inside = np.zeros(n, dtype=bool)
    with np.errstate(all="ignore"):
        for offset, q in zip(*ego.pieces(one), strict=True):
            inside |= np.einsum("ni,ij,nj->n", own - offset, q, own - offset) < 1 - 1e-9
    return float(clopper_pearson(np.array([inside.sum()]), n, 1 - 2e-9)[0][0])


def _judged(plan: rp.Plan, scenario: rp.Scenario) -> Any:
    from riskplan.assess import judge_again  # noqa: PLC0415

    name = str(plan.settings.get("checker", "exact"))
    options = plan.settings.get("checker_options") or {}
    return judge_again(plan, scenario, rp.checker(name, **options))[0]


def finite(name: str, *values: np.ndarray) -> None:
    """Refuse what is not finite."""
    if not all(np.isfinite(v).all() for v in values):
        raise Finding(f"{name}: not finite")


def share(name: str, values: Any) -> None:
    """Refuse what is not within [0, 1]."""
    values = np.asarray(values)
    if not ((values >= 0) & (values <= 1 + 1e-12)).all():
        raise Finding(f"{name}: outside [0, 1]: {values[~((values >= 0) & (values <= 1))][:3]}")
