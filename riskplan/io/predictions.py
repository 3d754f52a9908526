"""Predicted agents from files of other programs, one reader a format; and plain arrays and tables.

The content decides what a `.json` or `.yaml` is. Nothing is executed: JSON, YAML without tags, arrays without pickle,
parquet by pyarrow. Sizes are limited before anything is read.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from checkers import GaussianMixturePrediction, InputError, Prediction, load_prediction
from checkers.archive import check_regular, read_arrays
from checkers.validate import Array, as_array, as_flag, as_option, as_path
from riskplan.io import autoware, nuscenes, waymo
from riskplan.io.fields import MOST_AGENTS, Reading, naming
from riskplan.io.text import read_bytes

if TYPE_CHECKING:
    from predictor.growth import Growth

FORMATS = ("scenario", "nuscenes", "waymo", "autoware", "npz", "parquet")
_SUFFIXES = {".xml": "scenario", ".npz": "npz", ".parquet": "parquet", ".binproto": "waymo", ".pb": "waymo"}
_DOCUMENTS = {"nuscenes": nuscenes, "waymo": waymo, "autoware": autoware}
_MOST_ROWS = 20_000_000
_REQUIRED = ("agent", "mode", "weight", "time", "x", "y")
_COVARIANCE = ("cov_xx", "cov_xy", "cov_yy")


def load_predictions(
    path: str | Path,
    format: str | None = None,
    growth: Growth | None = None,
    *,
    scene: str | None = None,
    normalise: bool = False,
) -> tuple[Prediction, ...]:
    """The predicted agents of one scene in a file.

    Formats: "nuscenes" (devkit JSON), "waymo" (motion submission, JSON or bytes), "autoware" (`PredictedObjects`, YAML
    or JSON), "npz" (what `pred.save` wrote, or plain arrays with an axis of agents: times (T,), weights (A, K), means
    (A, T, K, 2), covariances (A, T, K, 2, 2), and if known names (A,), lengths (A,), widths (A,), headings (A, T, K)),
    "parquet" (rows of agent, mode, weight, time, x, y, and if known cov_xx, cov_xy, cov_yy, heading, length, width) and
    "scenario" (the agents of what `load_scenario` reads).

    Args:
        path: file to read.
        format: one of `FORMATS`; None: by suffix and content.
        growth: spread about trajectories, such as `predictor.PowerGrowth`; required exactly where the file states none.
        scene: nuScenes sample token or Waymo scenario id, where a file holds several.
        normalise: divide probabilities by their sum instead of refusing a sum other than 1.

    Raises:
        InputError: one line that names the file and the field.
    """
    if format is not None:
        as_option("format", format, FORMATS)
    as_path("path", path)
    as_flag("normalise", normalise)
    with naming(path):
        reading, kind = Reading(growth, scene, normalise), format or _SUFFIXES.get(Path(path).suffix.lower())
        if kind == "npz":
            return _from_npz(path, reading)
        if kind == "parquet":
            return _from_parquet(path, reading)
        if kind == "scenario":
            return _from_scenario(path, reading)
        return _from_document(path, kind, reading)


def _from_document(path: str | Path, kind: str | None, reading: Reading) -> tuple[Prediction, ...]:
    suffix = Path(path).suffix.lower()
    if suffix == ".json":
        from riskplan.io.plan_file import parse_json  # noqa: PLC0415

        document = parse_json(read_bytes(path))
    elif suffix in (".yaml", ".yml"):
        from riskplan.io.yaml_text import parse_yaml  # noqa: PLC0415

        document = parse_yaml(autoware.one_message(read_bytes(path)), str(path))
    elif kind == "waymo":
        from riskplan.io.waymo_wire import parse_submission  # noqa: PLC0415

        document = parse_submission(read_bytes(path))
    else:
        known = ".json, .yaml, .yml, " + ", ".join(_SUFFIXES)
        raise InputError(f"expected predictions in one of {known}; got {suffix or 'no suffix'}")
    if kind is None:
        kind = next((name for name, module in _DOCUMENTS.items() if module.looks_like(document)), None)
        if kind is None and suffix != ".json":
            return _from_scenario(path, reading)
        if kind is None:
            raise InputError("expected nuScenes, Waymo or Autoware predictions; the content is of none of them")
    found: tuple[Prediction, ...] = _DOCUMENTS[kind].predictions(document, reading)
    return found


def _from_scenario(path: str | Path, reading: Reading) -> tuple[Prediction, ...]:
    from riskplan.io import load_scenario  # noqa: PLC0415

    _states_its_spread(reading)
    return load_scenario(path).agents


def _states_its_spread(reading: Reading) -> None:
    if reading.growth is not None:
        raise InputError("growth: expected None, as the file states covariances of its own")
    if reading.scene is not None:
        raise InputError(f"scene: expected None, as the file holds one scene; got {reading.scene!r}")


def _from_npz(path: str | Path, reading: Reading) -> tuple[Prediction, ...]:
    values = read_arrays(path, "file of predictions")
    if "type" in values:
        _states_its_spread(reading)
        return (load_prediction(path),)
    for key in ("times", "weights", "means"):
        if key not in values:
            raise InputError(f"{key}: missing; the file has {', '.join(sorted(values)) or 'nothing'}")
    known = {"times", "weights", "means", "covariances", "names", "lengths", "widths", "headings", "modes"}
    unknown = sorted(set(values) - known)
    if unknown:
        raise InputError(f"{unknown[0]}: expected one of {', '.join(sorted(known))}")
    times = as_array("times", values["times"], ("T",))
    means = as_array("means", values["means"], ("A", len(times), "K", 2))
    count, modes = len(means), means.shape[2]
    if count > MOST_AGENTS:
        raise InputError(f"means: expected at most {MOST_AGENTS} agents, got {count}")
    weights = as_array("weights", values["weights"], (count, modes))
    labels: list[dict[str, Any]] = [{} for _ in range(count)]
    for key, name, shape in (
        ("lengths", "length", (count,)),
        ("widths", "width", (count,)),
        ("headings", "headings", (count, len(times), modes)),
    ):
        if key in values:
            for label, value in zip(labels, as_array(key, values[key], shape), strict=True):
                label[name] = float(value) if value.ndim == 0 else value
    names = values.get("names", np.array([f"agent {i}" for i in range(count)]))
    if names.dtype.kind != "U" or names.shape != (count,):
        raise InputError(f"names: expected {count} texts, got {names.dtype} of shape {names.shape}")
    for label, name in zip(labels, names.tolist(), strict=True):
        label["name"] = name
    if "covariances" not in values:
        return tuple(
            reading.mixture(f"agents[{i}]", weights[i], means[i].swapaxes(0, 1), times, **labels[i])
            for i in range(count)
        )
    _states_its_spread(reading)
    covariances = as_array("covariances", values["covariances"], (count, len(times), modes, 2, 2))
    return tuple(
        _stated(
            f"agents[{i}]",
            reading,
            times,
            weights[i],
            means[i],
            covariances[i],
            str(values.get("modes", "persistent")),
            labels[i],
        )
        for i in range(count)
    )


def _stated(
    where: str, reading: Reading, times: Array, weights: Array, means: Array, covariances: Array, modes: str, label: Any
) -> GaussianMixturePrediction:
    if reading.normalise and weights.sum() > 0 and (weights >= 0).all():
        weights = weights / weights.sum()
    try:
        return GaussianMixturePrediction(times, weights, means, covariances, modes, **label)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def _from_parquet(path: str | Path, reading: Reading) -> tuple[Prediction, ...]:
    table = _columns(path)
    agents = table["agent"]
    spread = all(name in table for name in _COVARIANCE)
    if not spread and any(name in table for name in _COVARIANCE):
        raise InputError(f"cov_xx: expected all of {', '.join(_COVARIANCE)}, or none")
    if spread:
        _states_its_spread(reading)
    names, index = np.unique(np.array([str(a) for a in agents.tolist()]), return_inverse=True)
    if len(names) > MOST_AGENTS:
        raise InputError(f"agent: expected at most {MOST_AGENTS} agents, got {len(names)}")
    order = np.lexsort((table["time"], table["mode"], index))
    out: list[Prediction] = []
    for name, rows in zip(names.tolist(), np.split(order, np.cumsum(np.bincount(index))[:-1]), strict=True):
        where = f"agent {name!r}"
        modes = np.unique(table["mode"][rows])
        times = np.unique(table["time"][rows])
        if len(rows) != len(modes) * len(times):
            raise InputError(f"{where}: expected each of {len(modes)} modes at each of {len(times)} times, once")
        grid = {key: column[rows].reshape(len(modes), len(times)) for key, column in table.items() if key != "agent"}
        if not (grid["time"] == times).all():
            raise InputError(f"{where}: expected the same times in every mode, each once")
        label: dict[str, Any] = {"name": name}
        for key in ("length", "width"):
            if key in grid:
                label[key] = _constant(f"{where}: {key}", grid[key].ravel())
        if "heading" in grid:
            label["headings"] = grid["heading"].T
        shares = np.array(
            [_constant(f"{where}: weight of mode {m:g}", w) for m, w in zip(modes, grid["weight"], strict=True)]
        )
        paths = np.stack([grid["x"], grid["y"]], axis=-1)
        if not spread:
            out.append(reading.mixture(where, shares, paths, times, **label))
            continue
        rows_of = [[grid["cov_xx"], grid["cov_xy"]], [grid["cov_xy"], grid["cov_yy"]]]
        covariances = np.stack([np.stack(row, -1) for row in rows_of], -2).swapaxes(0, 1)
        out.append(_stated(where, reading, times, shares, paths.swapaxes(0, 1), covariances, "persistent", label))
    return tuple(out)


def _columns(path: str | Path) -> dict[str, Any]:
    try:
        import pyarrow.parquet as pq  # noqa: PLC0415
    except ImportError:
        raise InputError("reading parquet needs pyarrow: pip install '.[data]'") from None
    check_regular(path)
    try:
        with open(path, "rb") as file:
            source = pq.ParquetFile(file)
            names, count = source.schema_arrow.names, source.metadata.num_rows
            missing = [name for name in _REQUIRED if name not in names]
            if missing:
                raise InputError(f"{missing[0]}: missing; the columns are {', '.join(names[:20])}")
            if not 1 <= count <= _MOST_ROWS:
                raise InputError(f"expected 1 to {_MOST_ROWS} rows, got {count}")
            wanted = [n for n in (*_REQUIRED, *_COVARIANCE, "heading", "length", "width") if n in names]
            table = source.read(columns=wanted)
    except InputError:
        raise
    except Exception as error:  # noqa: BLE001  pyarrow raises many kinds for malformed files
        raise InputError(f"not a parquet file: {' '.join(str(error).split())[:200]}") from None
    out = {name: table.column(name).to_numpy(zero_copy_only=False) for name in wanted}
    return {n: c if n == "agent" else as_array(n, c, (count,)) for n, c in out.items()}


def _constant(where: str, values: Array) -> float:
    if values.max() != values.min():
        raise InputError(f"{where}: expected one value, got {values.min():g} to {values.max():g}")
    return float(values[0])
