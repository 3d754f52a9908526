"""Plans and reports as strict JSON: `plan.json`, `report.json`."""

from __future__ import annotations

import json
import platform
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from checkers import PATH_DEPENDENCE, InputError, Kind, TrajectoryRisk
from checkers.validate import FARTHEST, Array, as_array, as_option, as_scalar, as_times
from riskplan.io.text import DEEPEST, MOST_VALUES, numbers, plain, read_bytes, short
from riskplan.result import STATUSES, Plan, Report

FORMAT, VERSION = "riskplan-plan", 1
_PACKAGES = ("riskplan", "numpy", "scipy", "numba", "ompl")
_RISK_FIELDS = ("total", "per_agent", "per_step", "boole", "max_step")


def plan_to_dict(plan: Plan) -> dict[str, Any]:
    """What `plan.json` holds; the search tree is left out."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "status": plan.status,
        "message": plan.message,
        "bound": plan.bound,
        "seed": plan.settings.get("seed"),
        "risk": risk_to_dict(plan.risk),
        "trajectory": {name: plain(getattr(plan, name)) for name in ("times", "poses", "speeds", "steering")},
        "marginals": [plain(m) for m in plan.marginals],
        "settings": plain(dict(plan.settings)),
        "stats": plain(dict(plan.stats)),
        "versions": versions(),
    }


def plan_text(plan: Plan) -> str:
    """The same as text, one top-level key a line."""
    return json_text(plan_to_dict(plan))


def json_text(values: dict[str, Any]) -> str:
    """Strict JSON, one top-level key a line: what is long stays out of the way of what is read."""
    lines = [f"{json.dumps(k)}: {json.dumps(v, allow_nan=False)}" for k, v in values.items()]
    return "{\n" + ",\n".join(lines) + "\n}\n"


def risk_to_dict(risk: TrajectoryRisk | None) -> dict[str, Any] | None:
    """Numbers, kind and dependence of a trajectory's risk."""
    if risk is None:
        return None
    values = {name: plain(np.asarray(getattr(risk, name))) for name in _RISK_FIELDS}
    return {**values, "kind": risk.kind.value, "dependence": risk.dependence}


def report_to_dict(report: Report) -> dict[str, Any]:
    """What `report.json` holds."""
    verdicts = [
        {
            "checker": v.checker,
            "kind": v.kind,
            "risk": risk_to_dict(v.risk),
            "seconds": v.seconds,
            "problem": v.problem,
        }
        for v in report.verdicts
    ]
    sampled = None if report.sampled is None else plain(dict(vars(report.sampled)))
    spending = None  # not known is not nothing spent
    if report.spending.shape[-1] > 0:
        total = np.minimum(report.spending.sum(axis=1), 1.0)
        spending = {"total": plain(total), "per_agent": plain(report.spending)}
    return {
        "format": "riskplan-report",
        "version": VERSION,
        "agents": list(report.agents),
        "bound": report.bound,
        "within_bound": report.within_bound,
        "consistent": report.consistent,
        "verdicts": verdicts,
        "monte_carlo": sampled,
        "times": plain(report.times),
        "spending": spending,
        "stats": plain(dict(report.stats)),
        "versions": versions(),
    }


def versions() -> dict[str, str | None]:
    """Of Python and the packages the numbers depend on, without importing them."""
    return {"python": platform.python_version(), **{name: _version(name) for name in _PACKAGES}}


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def read_plan(path: str | Path) -> Plan:
    """The plan in a `plan.json`.

    Raises:
        InputError: one line: the file, the field, what was expected and what came.
    """
    try:
        return plan_of(parse_json(read_bytes(path)))
    except InputError as error:
        text = str(error)
        raise InputError(text if text.startswith(str(path)) else f"{path}: {text}") from None


def plan_of(values: Any) -> Plan:
    """The plan that `plan_to_dict` described; every field is checked."""
    root = _Fields("", values)
    if root.get("format", str) != FORMAT or root.get("version", int) != VERSION:
        raise InputError(f"format: expected {FORMAT} version {VERSION}, got {short(root.values.get('format'))}")
    steps, poses, speeds, steering = _trajectory(root.within("trajectory"))
    status = as_option("status", root.get("status", str), STATUSES)
    if status == "solved" and not len(steps):
        raise InputError("trajectory.times: expected at least one time in a solved plan")
    bound = root.get("bound", float, type(None))
    stats = root.get("stats", dict)
    plan = Plan(
        status=status,
        times=steps,
        poses=poses,
        speeds=speeds,
        risk=_risk(root, len(steps)),
        marginals=_marginals(root.get("marginals", list), len(steps)),
        bound=None if bound is None else as_scalar("bound", bound, low=0.0, high=1.0),
        message=root.get("message", str),
        settings=_settings(root.within("settings")),
        stats=stats,
        steering=steering,
    )
    if plan.risk is not None and len(plan.risk.per_agent) != len(plan.marginals):
        raise InputError(f"marginals: expected {len(plan.risk.per_agent)} agents, got {len(plan.marginals)}")
    return plan


def _settings(d: _Fields) -> dict[str, Any]:
    """What judging again reads is checked; the rest is carried."""
    as_option(d.name("dependence"), d.values.get("dependence", "independent"), PATH_DEPENDENCE)
    for key, kind in (("checker", str), ("checker_options", dict)):
        if key in d.values:
            d.get(key, kind)
    return dict(d.values)


class _Fields:
    """A mapping of the file, asked for keys by type."""

    def __init__(self, where: str, values: Any) -> None:
        if not isinstance(values, dict):
            raise InputError(f"{where or 'the document'}: expected an object, got {short(values)}")
        self.where, self.values = where, values

    def name(self, key: str) -> str:
        return f"{self.where}.{key}" if self.where else key

    def get(self, key: str, *types: type[Any]) -> Any:
        if key not in self.values:
            raise InputError(f"{self.name(key)}: missing")
        value = self.values[key]
        wanted = (*types, int) if float in types else types
        if not isinstance(value, wanted) or (isinstance(value, bool) and bool not in types):
            names = " or ".join(_WORDS[t] for t in types)
            raise InputError(f"{self.name(key)}: expected {names}, got {short(value)}")
        return value

    def within(self, key: str) -> _Fields:
        return _Fields(self.name(key), self.get(key, dict))

    def array(self, key: str, shape: tuple[int | str, ...]) -> Array:
        name = self.name(key)
        return as_array(name, numbers(name, self.get(key, list)), shape, largest=FARTHEST)

    def shares(self, key: str, shape: tuple[int | str, ...]) -> Array:
        return _shares(self.name(key), self.array(key, shape))


_WORDS: dict[type, str] = {
    dict: "an object",
    list: "a list",
    str: "text",
    int: "an integer",
    float: "a number",
    type(None): "null",
}


def _trajectory(d: _Fields) -> tuple[Array, Array, Array, Array]:
    if not d.get("times", list):
        return np.zeros(0), np.zeros((0, 3)), np.zeros(0), np.zeros(0)
    times = as_times("trajectory.times", d.array("times", ("T",)))
    count = len(times)
    # files of before vehicles could steer have no angles
    steering = d.array("steering", (count,)) if "steering" in d.values else np.zeros(count)
    return times, d.array("poses", (count, 3)), d.array("speeds", (count,)), steering


def _risk(root: _Fields, steps: int) -> TrajectoryRisk | None:
    if root.get("risk", dict, type(None)) is None:
        return None
    d = root.within("risk")
    scalar: Callable[[str], Any] = lambda key: np.float64(  # noqa: E731
        as_scalar(d.name(key), d.get(key, float), low=0.0, high=1.0)
    )
    kinds = {kind.value: kind for kind in Kind}
    return TrajectoryRisk(
        total=scalar("total"),
        per_agent=d.shares("per_agent", ("A",)),
        per_step=d.shares("per_step", (steps,)),
        boole=scalar("boole"),
        max_step=scalar("max_step"),
        kind=kinds[as_option(d.name("kind"), d.get("kind", str), tuple(kinds))],
        dependence=as_option(d.name("dependence"), d.get("dependence", str), PATH_DEPENDENCE),
    )


def _marginals(rows: list[Any], steps: int) -> tuple[Array, ...]:
    names = [f"marginals[{i}]" for i in range(len(rows))]
    return tuple(
        _shares(name, as_array(name, numbers(name, row), (steps, "K"), finite=False))
        for name, row in zip(names, rows, strict=True)
    )


def _shares(name: str, values: Array) -> Array:
    """Probabilities; NaN is let through, where it may be."""
    bad = np.argwhere((values < 0) | (values > 1))
    if len(bad):
        index = tuple(int(i) for i in bad[0])
        raise InputError(f"{name}{list(index)}: expected a number in [0, 1], got {values[index]:g}")
    return values


def _integer(text: str) -> int | float:
    return int(text) if len(text) <= 18 else float(text)


def parse_json(content: bytes) -> Any:
    """Strict JSON as Python values; NaN and infinity are refused."""

    def refuse(token: str) -> Any:
        raise InputError(f"not valid JSON: {token} is no number")

    if sum(map(content.count, (b",", b"[", b"{"))) > MOST_VALUES:
        raise InputError(f"expected at most {MOST_VALUES} values, got more")
    try:
        value = json.loads(content.decode(), parse_constant=refuse, parse_int=_integer)
    except (json.JSONDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"not valid JSON: {' '.join(str(error).split())}") from None
    _check_depth(value, DEEPEST)
    return value


def _check_depth(value: Any, levels: int) -> None:
    if isinstance(value, dict | list):
        if not levels:
            raise InputError(f"expected at most {DEEPEST} levels of lists and objects")
        for item in value.values() if isinstance(value, dict) else value:
            _check_depth(item, levels - 1)
