"""ROS occupancy grids (map_server's `map.yaml` and its image) as static obstacles."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

import numpy as np

from checkers import InputError
from checkers.validate import FARTHEST, Array, as_array, as_flag, as_option, as_scalar
from riskplan.io.schema import short_key
from riskplan.io.text import read_bytes, short
from riskplan.io.yaml_text import parse_yaml

MOST_CELLS = 16_000_000
FINEST, COARSEST = 1e-4, 1e4  # side of a cell [m]
UNKNOWN = ("occupied", "free")
MODES = ("trinary", "scale")
_KEYS = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh", "mode")
_NEEDED = _KEYS[:6]
_OUTSIDE = 20.0  # width of the frame around a map whose outside is not free [m]
_LARGEST = 100_000_000  # bytes of an image


@dataclass(frozen=True, eq=False)
class OccupancyGrid:
    """Square cells that are blocked or not.

    Attributes:
        blocked: (rows, columns) bool; row 0 is at the lower edge, column 0 at the left one.
        resolution: side of a cell [m].
        origin: x, y [m] and yaw [rad] of the lower left corner of the grid.
        closed: whether what lies outside the grid is blocked too.
    """

    blocked: np.ndarray
    resolution: float
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    closed: bool = True

    def __post_init__(self) -> None:
        try:
            blocked = np.asarray(self.blocked)
        except ValueError:
            raise InputError("blocked: expected booleans (rows, columns), got rows of unequal length") from None
        if blocked.ndim != 2 or blocked.dtype != np.bool_ or not 0 < blocked.size <= MOST_CELLS:
            raise InputError(
                f"blocked: expected booleans (rows, columns), at most {MOST_CELLS}, got {blocked.dtype} {blocked.shape}"
            )
        object.__setattr__(self, "blocked", blocked)
        object.__setattr__(self, "resolution", as_scalar("resolution", self.resolution, low=FINEST, high=COARSEST))
        origin = as_array("origin", self.origin, (3,), largest=FARTHEST)
        object.__setattr__(self, "origin", tuple(map(float, origin)))
        object.__setattr__(self, "closed", as_flag("closed", self.closed))

    @cached_property
    def obstacles(self) -> tuple[Array, ...]:
        """Rectangles (4, 2) whose union are the blocked cells, and a frame around the grid if it is closed [m].

        Runs of blocked cells that repeat from row to row are one rectangle. Rectangles that touch share their corners
        to the last bit, so their union has no gaps.
        """
        rows, columns = self.blocked.shape
        boxes = list(_rectangles(self.blocked))
        if self.closed:
            wide = int(np.ceil(_OUTSIDE / self.resolution))
            boxes += [(-wide, -wide, columns + wide, 0), (-wide, rows, columns + wide, rows + wide)]
            boxes += [(-wide, 0, 0, rows), (columns, 0, columns + wide, rows)]
        if not boxes:
            return ()
        x0, y0, x1, y1 = np.array(boxes, dtype=float).T
        cells = np.stack([np.stack([x0, x1, x1, x0]), np.stack([y0, y0, y1, y1])], axis=-1).swapaxes(0, 1)
        return tuple(self._world(cells))

    @property
    def outline(self) -> Array:
        """(4, 2) the grid itself [m]."""
        rows, columns = self.blocked.shape
        corners: Array = self._world(np.array([[0, 0], [columns, 0], [columns, rows], [0, rows]], dtype=float))
        return corners

    def _world(self, cells: Array) -> Array:
        x, y, yaw = self.origin
        c, s = np.cos(yaw), np.sin(yaw)
        place: Array = self.resolution * cells @ np.array([[c, s], [-s, c]]) + [x, y]
        return place


def load_occupancy_grid(path: str | Path, unknown: str = "occupied") -> OccupancyGrid:
    """The map that a `map.yaml` describes: `image` (.pgm or .png), `resolution`, `origin`, `negate` and thresholds.

    A pixel v stands for the occupancy p = (255 - v) / 255, or v / 255 if `negate`; a cell is occupied where
    p > `occupied_thresh`, free where p < `free_thresh`. What is neither (mode `scale` grades it, `trinary` does not) is
    unknown, and so are transparent pixels in mode `scale`.

    Args:
        path: of the `map.yaml`; its image lies in the same directory or below.
        unknown: "occupied", the careful choice, blocks unknown cells and all that lies outside the map; "free" neither.

    Raises:
        InputError: one line that names the file and the field.
    """
    as_option("unknown", unknown, UNKNOWN)
    try:
        d = _checked(parse_yaml(read_bytes(path), str(path)))
        pixels, clear = _image(Path(path).parent, d["image"])
    except InputError as error:
        text = str(error)
        raise InputError(text if text.startswith(str(path)) else f"{path}: {text}") from None
    occupancy = pixels if d["negate"] else 1.0 - pixels
    if d.get("mode", "trinary") == "trinary":
        clear = np.zeros_like(clear)  # map_server reads transparency in mode scale only
    occupied = occupancy > d["occupied_thresh"]
    free = (occupancy < d["free_thresh"]) & ~clear
    blocked = ~free if unknown == "occupied" else occupied & ~clear
    # an image begins at its upper edge
    return OccupancyGrid(np.ascontiguousarray(blocked[::-1]), d["resolution"], d["origin"], unknown == "occupied")


def _checked(document: Any) -> dict[str, Any]:
    if not isinstance(document, dict):
        raise InputError(f"the document: expected a mapping, got {short(document)}")
    for key in document:
        if key not in _KEYS:
            raise InputError(f"{short_key(key)}: unknown key; expected one of {', '.join(_KEYS)}")
    for key in _NEEDED:
        if key not in document:
            raise InputError(f"{key}: missing; expected keys {', '.join(_NEEDED)}")
    d = dict(document)
    for key in ("resolution", "occupied_thresh", "free_thresh"):
        if isinstance(d[key], bool) or not isinstance(d[key], int | float):
            raise InputError(f"{key}: expected a number, got {short(d[key])}")
        d[key] = as_scalar(key, d[key], low=0.0)
    if not d["free_thresh"] <= d["occupied_thresh"]:
        raise InputError(
            f"free_thresh: expected at most occupied_thresh {d['occupied_thresh']:g}, got {d['free_thresh']:g}"
        )
    if d["negate"] not in (0, 1):
        raise InputError(f"negate: expected 0 or 1, got {short(d['negate'])}")
    origin = d["origin"]
    if not isinstance(origin, list) or any(isinstance(v, bool) or not isinstance(v, int | float) for v in origin):
        raise InputError(f"origin: expected [x, y, yaw], got {short(origin)}")
    d["origin"] = tuple(map(float, as_array("origin", origin, (3,))))
    if "mode" in d:
        as_option("mode", d["mode"], MODES)
    return d


def _image(folder: Path, name: Any) -> tuple[Array, np.ndarray]:
    """Brightness in [0, 1] and transparency of the pixels, (rows, columns) from the upper edge."""
    inside = isinstance(name, str) and not (
        PurePosixPath(name).is_absolute() or PureWindowsPath(name).drive or ".." in Path(name).parts
    )
    if not inside or Path(name).suffix.lower() not in (".pgm", ".png"):
        raise InputError(f"image: expected a .pgm or .png in the map's directory or below, got {short(name)}")
    from PIL import Image  # noqa: PLC0415  not everyone has maps

    content = read_bytes(folder / name)
    if len(content) > _LARGEST:
        raise InputError(f"image: expected at most {_LARGEST / 1e6:g} MB, got {name} of {len(content) / 1e6:.0f} MB")
    try:
        # the header is read first: what is too large is never unpacked
        with Image.open(io.BytesIO(content), formats=("PPM", "PNG")) as image:
            columns, rows = image.size
            if rows * columns > MOST_CELLS:
                raise InputError(f"image: expected at most {MOST_CELLS} cells, got {columns} x {rows}")
            deep = image.mode.startswith("I")
            bands = np.asarray(image if deep else image.convert("RGBA"), dtype=np.float64)
    except InputError:
        raise
    except Image.DecompressionBombError:
        raise InputError(f"image: expected at most {MOST_CELLS} cells, got more in {name}") from None
    except Exception as error:  # whatever a broken image makes a decoder raise
        raise InputError(f"image: {name} is no readable .pgm or .png: {short(str(error))}") from None
    if deep:
        return bands / 65535.0, np.zeros(bands.shape, dtype=np.bool_)
    return bands[..., :3].mean(axis=-1) / 255.0, bands[..., 3] < 255


def _rectangles(blocked: np.ndarray) -> Iterator[tuple[int, int, int, int]]:
    """x0, y0, x1, y1 in cells."""
    padded = np.zeros((blocked.shape[0] + 1, blocked.shape[1] + 2), dtype=np.int8)
    padded[:-1, 1:-1] = blocked
    change = np.diff(padded, axis=1)
    begins, ends = np.argwhere(change == 1), np.argwhere(change == -1)
    bounds = np.searchsorted(begins[:, 0], np.arange(len(padded) + 1))
    begun: dict[tuple[int, int], int] = {}
    for row in range(len(padded)):  # the last row is empty and closes what is still open
        part = slice(bounds[row], bounds[row + 1])
        runs = set(zip(begins[part, 1].tolist(), ends[part, 1].tolist(), strict=True))
        for run in [r for r in begun if r not in runs]:
            yield run[0], begun.pop(run), run[1], row
        for run in runs:
            begun.setdefault(run, row)
