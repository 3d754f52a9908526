"""The 3-D scene in meshcat. The only module that imports meshcat (0.6 s), so import it late.

Nothing here starts meshcat's server: `Recorder` stands in for its window and keeps the commands.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import meshcat
import meshcat.animation
import meshcat.geometry as g
import numpy as np
import umsgpack  # type: ignore[import-untyped]

from checkers.validate import Array
from riskplan.pictures import geometry, palette, solids
from riskplan.pictures.camera import look
from riskplan.pictures.picture import SIGMAS, AgentView, Picture
from riskplan.pictures.solids import Mesh, flat, merge

# Flat things write no depth and are drawn in this order, all at z = 0: nothing to flicker, whatever the zoom.
_LAYERS = ("road", "lines", "goal", "tree", "ellipses", "rims", "casing", "plan", "shadow", "shape")


class Recorder:
    """Stands in for meshcat's window: keeps what is sent, as plain messages, the same on every run."""

    def __init__(self) -> None:
        self.commands: list[dict[str, Any]] = []
        self._ids: dict[str, str] = {}

    def send(self, command: Any) -> None:
        """Take a meshcat command (anything with `lower()`)."""
        self.commands.append(self._plain(command.lower()))

    def _plain(self, value: Any, key: str = "") -> Any:
        if isinstance(value, dict):
            return {str(k): self._plain(v, str(k)) for k, v in value.items()}
        if isinstance(value, list | tuple):
            return [self._plain(v) for v in value]
        if isinstance(value, np.ndarray):
            return self._plain(value.tolist())
        if isinstance(value, np.generic):
            value = value.item()
        if isinstance(value, str) and key in ("uuid", "geometry", "material"):
            return self._ids.setdefault(value, f"id-{len(self._ids)}")
        data = [value] if isinstance(value, float) else _floats(value)
        if not np.isfinite(data).all():  # the viewer would draw nothing, without a word
            raise ValueError(f"scene: a number that is not finite in {key!r}")
        return value


class _Property:
    """meshcat's own SetProperty lower-cases the name, and so loses `renderOrder`."""

    def __init__(self, path: Any, name: str, value: Any) -> None:
        self._data = {"type": "set_property", "path": path.lower(), "property": name, "value": value}

    def lower(self) -> dict[str, Any]:
        return self._data


def viewer_script() -> str:
    """The viewer's JavaScript, as shipped with meshcat."""
    return (Path(meshcat.__file__).parent / "viewer" / "dist" / "main.min.js").read_text(encoding="utf-8")


def messages(pic: Picture) -> list[bytes]:
    """The scene as the viewer's messages, the animation last."""
    recorder = Recorder()
    draw(meshcat.Visualizer(window=recorder), pic)
    return [umsgpack.packb(command) for command in recorder.commands]


def draw(vis: Any, pic: Picture) -> None:
    """Build the scene under `/riskplan` of a `meshcat.Visualizer`; the animation command comes last."""
    _stage(vis)
    for name, mesh in _ground(pic):
        _put(vis, name, mesh, _layer(name))
    for i, polygon in enumerate(pic.obstacles):
        _put(vis, f"obstacles/{i}", solids.column(polygon, 1.8, palette.OBSTACLE))
    if len(pic.tree):
        _tree(vis, pic)
    for i, agent in enumerate(pic.agents):
        for mode in range(agent.means.shape[1]):
            fill, rim = _mode_meshes(agent, mode, pic.limits[1])
            _put(vis, f"modes/{i}/{mode}/ellipses", fill, "ellipses")
            _put(vis, f"modes/{i}/{mode}/rims", rim, "rims")
    _body(vis, "ego", *pic.ego_size, palette.EGO)
    shape = [solids.curtain(ring[:-1], 0.9, palette.EGO) for ring in pic.ego_rings]
    if shape:
        _put(vis, "ego/shape", merge(shape), "shape")
    names = [agent_node(i, agent.name) for i, agent in enumerate(pic.agents)]
    for name, agent in zip(names, pic.agents, strict=True):
        _body(vis, name, agent.length, agent.width, agent.colour)
    _camera(vis, pic)
    tracks = {"ego": pic.ego, **{name: agent.track for name, agent in zip(names, pic.agents, strict=True)}}
    clips = {vis[f"/riskplan/{name}"].path: _clip(pic.times, track) for name, track in tracks.items()}
    vis.set_animation(meshcat.animation.Animation(clips), play=True, repetitions=1_000_000_000)


def agent_node(index: int, name: str) -> str:
    """Path below `/riskplan` of an agent's body; a slash in its name would split the path."""
    return f"agents/{index}-{re.sub('[^A-Za-z0-9_.-]+', '-', name)}"


def _stage(vis: Any) -> None:
    for name in ("/Grid", "/Axes", "/Lights/PointLightNegativeX", "/Lights/PointLightPositiveX"):
        vis[name].set_property("visible", False)
    for end in ("top_color", "bottom_color"):
        vis["/Background"].set_property(end, palette.rgb(palette.GROUND).tolist())
    vis["/Lights/AmbientLight/<object>"].set_property("intensity", 0.58)
    vis["/Lights/FillLight/<object>"].set_property("intensity", 0.55)
    vis["/Lights/FillLight/<object>"].set_property("position", [-4.0, -7.0, 10.0])


def _put(vis: Any, name: str, mesh: Mesh, layer: str | None = None) -> None:
    """A solid, lit body; or, with a layer, something flat and unlit."""
    shape = g.TriangularMeshGeometry(mesh.vertices, mesh.faces)
    shape.color = mesh.colours.astype(np.float32)  # the constructor refuses opacities
    if layer is None:
        material = g.MeshLambertMaterial(vertexColors=True)
    else:
        material = g.MeshBasicMaterial(vertexColors=True, transparent=True, depthWrite=False)
    node = vis[f"/riskplan/{name}"]
    node.set_object(g.Mesh(shape, material))
    if layer is not None:
        node.window.send(_Property(node.path, "renderOrder", _LAYERS.index(layer)))


def _layer(name: str) -> str:
    return name.split("/")[0]


def _ground(pic: Picture) -> Iterator[tuple[str, Mesh]]:
    asphalt, white = palette.rgb(palette.ASPHALT), palette.rgb(palette.LINE)
    yield "road", merge([flat(polygon, geometry.triangulate(polygon), asphalt) for polygon in pic.road])
    solid = [_band(line, 0.18, white) for line in pic.edges]
    dashed = [_band(dash, 0.15, white) for line in pic.dividers for dash in geometry.dashes(line)]
    if solid + dashed:
        yield "lines", merge(solid + dashed)
    goal = palette.rgb(palette.GOAL)
    for i, polygon in enumerate(pic.goals):
        fill = flat(polygon, geometry.triangulate(polygon), np.array([*goal, 0.25]))
        closed = np.concatenate([polygon, polygon[:1]])
        yield f"goal/{i}", merge([fill, _band(closed, 0.2, np.array([*goal, 0.9]))])
    if len(pic.path) > 1:
        left = np.column_stack([-np.sin(pic.path[:, 2]), np.cos(pic.path[:, 2])])
        shade = palette.ramp(palette.RISK, pic.path_risk / pic.limits[0])
        yield "casing", flat(*geometry.strip(pic.path[:, :2], left, 0.95), palette.rgb(palette.CASING))
        yield "plan", flat(*geometry.strip(pic.path[:, :2], left, 0.70), np.concatenate([shade, shade]))


def _band(line: Array, width: float, colour: Array) -> Mesh:
    return flat(*geometry.strip(line, geometry.normals(line), width), colour)


def _tree(vis: Any, pic: Picture) -> None:
    ends = pic.tree[:, :4].reshape(-1, 2)
    position = np.column_stack([ends, np.zeros(len(ends))])
    colour = np.repeat(palette.ramp(palette.TIME, pic.tree[:, 4] / max(pic.limits[2], 1e-9)), 2, axis=0)
    opacity = palette.tree_alpha(len(pic.tree))
    points = g.PointsGeometry(position.T.astype(np.float32), colour.T.astype(np.float32))
    material = g.LineBasicMaterial(vertexColors=True, transparent=True, opacity=opacity, depthWrite=False)
    node = vis["/riskplan/tree"]
    node.set_object(g.LineSegments(points, material))
    node.window.send(_Property(node.path, "renderOrder", _LAYERS.index("tree")))


def _mode_meshes(agent: AgentView, mode: int, limit: float) -> tuple[Mesh, Mesh]:
    """All ellipses of one mode in one mesh, and the outlines of every fifth in another."""
    rings = geometry.ellipses(agent.means[:, mode], agent.covariances[:, mode], SIGMAS)
    weight = agent.weights[:, mode]
    tint = np.column_stack([palette.ramp(palette.WEIGHT, weight / limit), palette.fill_alpha(weight)])
    n = rings.shape[1]
    fill = flat(rings.reshape(-1, 2), geometry.fan(rings), np.repeat(tint, n, axis=0))
    tint[:, 3] = 0.85
    return fill, flat(*geometry.rims(rings[::5], 0.15), np.repeat(tint[::5], 2 * n, axis=0))


def _body(vis: Any, name: str, length: float, width: float, colour: str) -> None:
    _put(vis, f"{name}/body", solids.body(length, width, colour))
    _put(vis, f"{name}/shadow", solids.shadow(length, width), "shadow")


def _camera(vis: Any, pic: Picture) -> None:
    """The viewer turns about the world's origin for good, so the scene is moved instead."""
    view = look(pic)
    vis["/riskplan"].set_property("position", (-view.target).tolist())
    camera = vis["/Cameras/default/rotated/<object>"]
    for key, value in (("fov", view.fov), ("near", view.distance / 100), ("far", view.distance * 20)):
        camera.set_property(key, value)
    camera.set_property("position", [view.eye[0], view.eye[2], -view.eye[1]])  # its parent is turned: y is up


def _clip(times: Array, track: Array) -> Any:
    """Position and turn of a body over time; headings are continuous, so no turn takes the long way."""
    half = track[:, 2] / 2
    values = {
        "position": ("vector3", np.column_stack([track[:, :2], np.zeros(len(track))])),
        "quaternion": ("quaternion", np.column_stack([0 * half, 0 * half, np.sin(half), np.cos(half)])),
    }
    tracks = {
        name: meshcat.animation.AnimationTrack(name, kind, times.tolist(), rows.tolist())
        for name, (kind, rows) in values.items()
    }
    return meshcat.animation.AnimationClip(tracks, fps=1)  # key times are seconds


def _floats(value: Any) -> Any:
    """The numbers of a packed float32 array (extension type 0x17); nothing of anything else."""
    if isinstance(value, umsgpack.Ext) and value.type == 0x17:
        return np.frombuffer(value.data, dtype=np.float32)
    return ()
