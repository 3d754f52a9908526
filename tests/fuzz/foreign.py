"""Other programs' formats: seeds, how they are spoilt, how they are read. The files of an input are one text."""

from __future__ import annotations

import copy
import io
import json
import random
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

import riskplan as rp
from checkers.archive import read_arrays

from . import corpus, mutate

T, K = 4, 2
GROWTH = rp.PowerGrowth(along=(0.3, 0.8, 1.2), across=(0.3, 0.3, 1.0))
_PART = b"\n\x1e--part--\x1e\n"  # between the files of one input

FILES = {  # of each target, the names of the files its inputs are
    "argoverse1": ("scene.csv",),
    "argoverse2": ("scenario_s.parquet", "log_map_archive_s.json"),
    "nuscenes": ("nuscenes.json",),
    "waymo": ("waymo.json",),
    "waymo-bytes": ("waymo.binproto",),
    "autoware": ("autoware.yaml",),
    "grid": ("map.yaml", "map.png"),
    "agents-npz": ("agents.npz",),
    "agents-parquet": ("agents.parquet",),
    "tensors": ("tensors.npz",),
    "eth-ucy": ("tracks.txt",),
    "recordings": ("recordings.npz",),
    "windows": ("windows.npz",),
    "batch-list": ("list.npz",),
}


def joined(*parts: bytes) -> bytes:
    """Files as one input."""
    return _PART.join(parts)


def parted(data: bytes, count: int) -> list[bytes]:
    """The files of an input; what is missing is empty."""
    parts = data.split(_PART, count - 1)
    return parts + [b""] * (count - len(parts))


# ----------------------------------------------------------------------------------------------------
# seeds


def argoverse1() -> list[list[str]]:
    """Rows of a CSV."""
    rows = [["TIMESTAMP", "TRACK_ID", "OBJECT_TYPE", "X", "Y", "CITY_NAME"]]
    for i, (kind, speed) in enumerate((("AV", 8.0), ("AGENT", 5.0), ("OTHERS", 0.0))):
        rows += [
            [str(1000 + 0.1 * k), str(i), kind, str(100 + 6 * i), str(200 + 0.1 * k * speed), "MIA"] for k in range(20)
        ]
    return rows


def argoverse2() -> tuple[dict[str, list[Any]], dict[str, Any]]:
    """Columns of a scenario of 6 s, and its map of one lane."""
    names = ("track_id", "object_type", "object_category", "timestep", "position_x", "position_y", "heading",
             "velocity_x", "velocity_y")  # fmt: skip
    columns: dict[str, list[Any]] = {name: [] for name in names}
    for track, kind, y, speed in (("AV", "vehicle", 0.0, 8.0), ("7", "bus", 3.5, 5.0), ("8", "pedestrian", 8.0, 0.0)):
        for t in range(0, 110, 2 if track == "8" else 1):
            row = (track, kind, 3 if track == "7" else 1, t, 0.1 * t * speed, y, 0.0, speed, 0.0)
            for name, value in zip(names, row, strict=True):
                columns[name].append(value)

    def line(y: float) -> list[dict[str, float]]:
        return [{"x": x, "y": y, "z": 0.0} for x in (-10.0, 60.0, 200.0)]

    lane = {
        "left_lane_boundary": line(1.75),
        "right_lane_boundary": line(-1.75),
        "successors": [2],
        "left_neighbor_id": None,
        "right_neighbor_id": None,
    }
    other = {**lane, "left_lane_boundary": line(5.25), "right_lane_boundary": line(1.75), "centerline": line(3.5)}
    return columns, {"lane_segments": {"1": lane, "2": {**other, "successors": []}}}


def nuscenes() -> list[dict[str, Any]]:
    """Two agents of one sample."""
    paths = [[[2.0 * t, 0.1 * k * t] for t in range(1, 13)] for k in range(K)]
    item = {"instance": "a", "sample": "s", "prediction": paths, "probabilities": [0.25, 0.75]}
    return [item, {**item, "instance": "b", "probabilities": [1.0, 0.0]}]


def waymo(*, joint: bool = False) -> dict[str, Any]:
    """A motion submission, of either challenge."""

    def path(speed: float) -> dict[str, Any]:
        return {"centerX": [0.5 * t * speed for t in range(1, 17)], "centerY": [0.1 * speed] * 16}

    if joint:
        modes = [
            {"confidence": w, "trajectories": [{"objectId": i, "trajectory": path(i + w)} for i in (1, 2)]}
            for w in (0.25, 0.75)
        ]
        return {"scenarioPredictions": [{"scenarioId": "s", "jointPrediction": {"jointTrajectories": modes}}]}
    scored = [{"trajectory": path(8.0), "confidence": 0.25}, {"trajectory": path(4.0), "confidence": 0.75}]
    single = {"predictions": [{"objectId": 12, "trajectories": scored}]}
    return {"scenarioPredictions": [{"scenarioId": "s", "singlePredictions": single}]}


def waymo_bytes() -> bytes:
    """The same submission in protobuf's wire format."""

    def counted(number: int, body: bytes) -> bytes:
        size, out = len(body), b""
        while size > 127:
            out, size = out + bytes([size & 127 | 128]), size >> 7
        return bytes([number << 3 | 2]) + out + bytes([size]) + body

    modes = b""
    for mode in waymo()["scenarioPredictions"][0]["singlePredictions"]["predictions"][0]["trajectories"]:
        axes = [np.array(mode["trajectory"][key], dtype="<f4").tobytes() for key in ("centerX", "centerY")]
        path = counted(2, axes[0]) + counted(3, axes[1])
        modes += counted(2, counted(1, path) + b"\x15" + np.float32(mode["confidence"]).tobytes())
    scene = counted(1, b"s") + counted(2, counted(1, b"\x08\x0c" + modes))
    return counted(3, b"me@example.org") + b"\x10\x01" + counted(1, scene)


def autoware() -> dict[str, Any]:
    """Three objects, one of each shape."""
    turn = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
    paths = [
        {
            "path": [{"position": {"x": 1.0 * t, "y": 0.1 * k * t, "z": 0.0}, "orientation": turn} for t in range(T)],
            "time_step": {"sec": 0, "nanosec": 100_000_000},
            "confidence": (0.25, 0.75)[k],
        }
        for k in range(K)
    ]
    shapes = (
        {"type": 0, "dimensions": {"x": 4.2, "y": 1.7, "z": 1.5}},
        {"type": 1, "dimensions": {"x": 0.6, "y": 0.5, "z": 1.5}},
        {"type": 2, "footprint": {"points": [{"x": 1.5, "y": 0.5}, {"x": -2.0, "y": -0.75}, {"x": -1.0, "y": 0.5}]}},
    )
    objects = [
        {
            "object_id": {"uuid": [i, *range(15)]},
            "existence_probability": 0.9,
            "kinematics": {"predicted_paths": paths},
            "shape": shape,
        }
        for i, shape in enumerate(shapes)
    ]
    return {"header": {"stamp": {"sec": 5, "nanosec": 0}, "frame_id": "map"}, "objects": objects}


def grid() -> tuple[dict[str, Any], bytes]:
    """A `map.yaml` and its image."""
    from PIL import Image  # noqa: PLC0415

    pixels, out = np.full((6, 8), 254, dtype=np.uint8), io.BytesIO()
    pixels[0], pixels[3, 2:5], pixels[5, 7] = 0, 0, 205
    Image.fromarray(pixels).save(out, "png")
    keys = {"resolution": 0.5, "origin": [1.0, 2.0, 0.1], "negate": 0, "occupied_thresh": 0.65, "free_thresh": 0.196}
    return {"image": "map.png", **keys, "mode": "trinary"}, out.getvalue()


def agents() -> dict[str, np.ndarray]:
    """Arrays with an axis of two agents."""
    g = corpus.gaussian()
    means, covariances = np.array(g["means"]), np.array(g["covariances"])
    return {
        "times": np.array(g["times"]) + 0.1,
        "weights": np.array([g["weights"]] * 2),
        "means": np.stack([means, means + 5.0]),
        "covariances": np.stack([covariances] * 2),
        "names": np.array(["a", "b"]),
        "lengths": np.array([4.5, 12.0]),
        "widths": np.array([1.8, 2.5]),
        "headings": np.zeros((2, *means.shape[:2])),
    }


def table() -> dict[str, list[Any]]:
    """The same as columns."""
    a = agents()
    names = ("agent", "mode", "weight", "time", "x", "y", "cov_xx", "cov_xy", "cov_yy", "heading", "length", "width")
    columns: dict[str, list[Any]] = {name: [] for name in names}
    for i, t, k in np.ndindex(*a["means"].shape[:3]):
        c = a["covariances"][i, t, k]
        row = (str(a["names"][i]), k, a["weights"][i, k], a["times"][t], *a["means"][i, t, k], c[0, 0], c[0, 1],
               c[1, 1], 0.0, a["lengths"][i], a["widths"][i])  # fmt: skip
        for name, value in zip(names, row, strict=True):
            columns[name].append(value if isinstance(value, str | int) else float(value))
    return columns


def tensors() -> list[dict[str, np.ndarray]]:
    """Arguments of the adapters, told apart by their names."""
    times, rng = 0.1 * np.arange(1, T + 1), np.random.default_rng(0)
    paths = np.cumsum(rng.normal([0.8, 0.0], 0.02, (K, T, 2)), axis=1)
    trajectories = np.concatenate([paths, np.full((K, T, 2), -0.5), np.zeros((K, T, 1))], axis=-1)
    scores = np.array([0.25, 0.75])
    return [
        {
            "log_pis": np.log(scores),
            "mus": paths.swapaxes(0, 1),
            "log_sigmas": np.full((T, K, 2), -0.5),
            "corrs": np.full((T, K), 0.1),
            "times": times,
        },
        {
            "probabilities": scores,
            "trajectories": trajectories,
            "times": times,
            "spread": np.asarray("log_sigma"),
            "log_sigma_range": np.array([-1.609, 5.0]),
            "largest_corr": np.asarray(0.5),
        },
        {"probabilities": scores, "trajectories": paths, "times": times},
    ]


def eth_ucy() -> bytes:
    """Two pedestrians."""
    return b"".join(b"%d %d %.1f %.1f\n" % (10 * k, i, 0.5 * k, 1.0 * i) for k in range(12) for i in (1, 2))


def recordings() -> dict[str, np.ndarray]:
    """What the recorder writes."""
    from predictor.datasets.simulator import FORMAT  # noqa: PLC0415

    t = 0.1 * np.arange(8.0)
    rows = np.column_stack([t, 10 * t, 0 * t, 0 * t, 0 * t + 10, 0 * t, 0 * t])
    meta = {"name": "r", "dt": 0.1, "group": "g", "ego": "a", "focal": ["b"], "controls": ["a"],
            "tracks": [["a", "car", 4.5, 1.8, 8], ["b", "car", 4.5, 1.8, 8]], "lanes": [["l", [], [], 2]]}  # fmt: skip
    lane = np.array([[0.0, 0.0, 0.0, 2.0, 0.0, -2.0], [50.0, 0.0, 50.0, 2.0, 50.0, -2.0]])
    return {"format": np.asarray(FORMAT), "count": np.asarray(1), "0.meta": np.asarray(json.dumps(meta)),
            "0.states": np.concatenate([rows, rows + [0, 0, 5, 0, 0, 0, 0]]), "0.lanes": lane}  # fmt: skip


def windows() -> dict[str, np.ndarray]:
    """Training samples, as they are saved."""
    from predictor.windows import FORMAT  # noqa: PLC0415

    t = 0.1 * np.arange(12.0)
    tracks = [
        rp.Track(n, t, np.column_stack([10 * t, 0 * t + y]), 0 * t, 0 * t + 10, 4.5, 1.8)
        for n, y in (("a", 0.0), ("b", 4.0))
    ]
    made = rp.windows([rp.Recording("r", 0.1, tuple(tracks))], past=4, future=4, every=2)
    return {"format": np.asarray(FORMAT), **{f.name: np.asarray(getattr(made, f.name)) for f in fields(made)}}


ARRAYS: dict[str, Callable[[], list[dict[str, Any]]]] = {
    "agents-npz": lambda: [agents()],
    "tensors": tensors,
    "recordings": lambda: [recordings()],
    "windows": lambda: [windows()],
    "batch-list": lambda: [{"scenario": np.array(["a.yaml", "b.xml"]), "problem": np.array([0, 1])}],
}


def seeds(target: str) -> list[bytes]:
    """Valid inputs of a target."""
    if target == "argoverse1":
        return [csv(argoverse1())]
    if target == "argoverse2":
        columns, document = argoverse2()
        return [joined(parquet(columns), json.dumps(document).encode()), joined(parquet(columns))]
    if target == "grid":
        document, image = grid()
        return [joined(corpus.yaml_bytes(document), image)]
    if target in ARRAYS:
        return [corpus.npz(arrays) for arrays in ARRAYS[target]()]
    known: dict[str, Callable[[], list[bytes]]] = {
        "nuscenes": lambda: [corpus.yaml_bytes(nuscenes())],
        "waymo": lambda: [corpus.yaml_bytes(waymo(joint=joint)) for joint in (False, True)],
        "waymo-bytes": lambda: [waymo_bytes()],
        "autoware": lambda: [corpus.yaml_bytes(autoware())],
        "agents-parquet": lambda: [parquet(table())],
        "eth-ucy": lambda: [eth_ucy()],
    }
    return known[target]()


def csv(rows: list[list[str]]) -> bytes:
    """Rows as text."""
    return "\n".join(",".join(map(str, row)) for row in rows).encode("utf-8", "surrogatepass")


def parquet(columns: dict[str, list[Any]]) -> bytes:
    """Columns as a parquet file; a column of mixed kinds becomes text."""
    import pyarrow as pa  # noqa: PLC0415
    from pyarrow import parquet as pq  # noqa: PLC0415

    arrays = {}
    for name, column in columns.items():
        try:
            arrays[name] = pa.array(column)
        except (pa.ArrowException, TypeError, ValueError, OverflowError):
            arrays[name] = pa.array([str(value)[:100] for value in column])
    out = io.BytesIO()
    pq.write_table(pa.table(arrays), out)
    return out.getvalue()


# ----------------------------------------------------------------------------------------------------
# made worse


def maker(target: str) -> Callable[[random.Random], bytes]:
    """How inputs of a target are made."""
    if target == "argoverse1":
        rows = argoverse1()
        return lambda rng: _sometimes_raw(rng, csv(_cells(rng, rows)))
    if target == "argoverse2":
        columns, document = argoverse2()

        def scene(rng: random.Random) -> bytes:
            changed = _columns(rng, columns) if rng.random() < 0.7 else columns
            place = mutate.document(rng, document) if rng.random() < 0.5 else document
            return joined(_sometimes_raw(rng, parquet(changed)), _sometimes_raw(rng, corpus.yaml_bytes(place)))

        return scene
    if target == "grid":
        keys, image = grid()

        def place(rng: random.Random) -> bytes:
            changed = mutate.document(rng, keys) if rng.random() < 0.7 else keys
            return joined(corpus.yaml_bytes(changed), mutate.raw(rng, image) if rng.random() < 0.5 else image)

        return place
    if target == "agents-parquet":
        own = table()
        return lambda rng: _sometimes_raw(rng, parquet(_columns(rng, own)))
    documents = {
        "nuscenes": [nuscenes()],
        "waymo": [waymo(), waymo(joint=True)],
        "autoware": [autoware()],
    }
    if target in documents:
        return lambda rng: _sometimes_raw(
            rng, corpus.yaml_bytes(mutate.document(rng, {"": rng.choice(documents[target])}).get(""))
        )
    if target in ARRAYS:
        given = ARRAYS[target]()
        return lambda rng: mutate.arrays(rng, rng.choice(given))
    (content,) = seeds(target)  # waymo-bytes, eth-ucy
    return lambda rng: mutate.raw(rng, content)


def _sometimes_raw(rng: random.Random, content: bytes) -> bytes:
    return mutate.raw(rng, content) if rng.random() < 0.1 else content


def _cells(rng: random.Random, rows: list[list[str]]) -> list[list[str]]:
    """A CSV with cells, rows and columns spoilt."""
    rows = copy.deepcopy(rows)
    for _ in range(rng.choice((1, 1, 2, 4))):
        what, i = rng.randrange(5), rng.randrange(len(rows)) if rows else 0
        if not rows or not rows[i]:
            break
        j = rng.randrange(len(rows[i]))
        if what == 0:
            del rows[i]
        elif what == 1:
            rows[i:i] = [rows[i]] * rng.choice((1, 1, 30))
        elif what == 2:
            for row in rows:
                del row[j : j + 1]
        else:
            rows[i][j] = rng.choice(
                (*mutate.TEXTS, "AV", "AGENT", str(rng.gauss(0, 1000)), "1000.1", '"', "'", "é", "\r", "0" * 200_000)
            )
    return rows


def _columns(rng: random.Random, columns: dict[str, list[Any]]) -> dict[str, list[Any]]:
    """Columns with values, rows and whole columns spoilt; all of one length."""
    d = {name: list(values) for name, values in columns.items()}
    for _ in range(rng.choice((1, 1, 2, 3))):
        name, what = rng.choice(list(d)), rng.randrange(7)
        count = len(d[name])
        if what == 0 and len(d) > 1:
            del d[name]
        elif what == 1 and count:
            kept = [i for i in range(count) if rng.random() < rng.choice((0.0, 0.5, 0.99))]
            d = {key: [values[i] for i in kept] for key, values in d.items()}
        elif what == 2:
            d = {key: values + values[:3] for key, values in d.items()}
        elif what == 3:
            d[name] = [rng.choice(mutate.NASTY)] * count
        elif what == 4:
            d[name] = [v * rng.choice((-1.0, 0.0, 1e9, 1e160)) if isinstance(v, float) else str(v) for v in d[name]]
        elif count:
            i, old = rng.randrange(count), d[name][0]
            near = isinstance(old, int | float) and rng.random() < 0.7
            d[name][i] = (
                rng.choice((None, float("nan"), float("inf"), -1.0, 0.0, 1e9, old + rng.gauss(0.0, 3.0)))
                if near
                else rng.choice(mutate.NASTY)
            )
    return d


# ----------------------------------------------------------------------------------------------------
# read


def read(target: str, paths: list[Path]) -> Any:
    """What the importer makes of the files."""
    path = paths[0]
    if target in ("argoverse1", "argoverse2"):
        return rp.load_scenario(path)
    if target == "grid":
        return rp.load_occupancy_grid(path)
    if target in ("eth-ucy", "recordings"):
        return list(rp.open_data(path, "eth-ucy" if target == "eth-ucy" else "simulator").recordings())
    if target == "windows":
        return rp.Windows.load(path)
    if target == "batch-list":
        from riskplan.batching import items  # noqa: PLC0415

        return items(path)
    if target == "tensors":
        return adapted(path)
    try:
        return rp.load_predictions(path, growth=GROWTH)
    except rp.InputError as error:
        if "growth: expected None" not in str(error):
            raise
        return rp.load_predictions(path)


def adapted(path: Path) -> Any:
    """The arrays as arguments of the adapter whose names they have; arrays of another kind never get there."""
    values = {
        key: v.item() if v.ndim == 0 and (v.dtype.kind in "Ub" or key == "largest_corr") else v
        for key, v in read_arrays(path, "x").items()
    }
    if "mus" in values or "log_pis" in values:
        needed, adapter = ("log_pis", "mus", "log_sigmas", "corrs", "times"), rp.from_gmm2d
    elif "spread" in values:
        needed, adapter = ("probabilities", "trajectories", "times", "spread"), rp.from_mode_gaussians
    else:
        needed, adapter = ("probabilities", "trajectories", "times"), rp.from_trajectories
        values["growth"] = GROWTH
    unknown = [name for name in values if not name.isidentifier()]
    if unknown or not set(needed) <= set(values):
        raise rp.InputError("an argument is missing, which Python refuses")
    return adapter(**values)
