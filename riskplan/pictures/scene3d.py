"""The 3-D scene in meshcat. The only module that imports meshcat (0.6 s), so import it late.

Nothing here starts meshcat's server: a `Recorder` stands in for its window and keeps the commands.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import umsgpack  # type: ignore[import-untyped]
from numpy.typing import NDArray

with warnings.catch_warnings():  # of pyzmq, about what meshcat imports for its server, which is not used here
    warnings.simplefilter("ignore", DeprecationWarning)
    import meshcat
    import meshcat.animation
    import meshcat.geometry as g

from checkers.validate import Array
from riskplan.pictures import geometry, palette, solids
from riskplan.pictures.agent_view import AgentView, agent_node
from riskplan.pictures.camera import Camera, look
from riskplan.pictures.picture import SIGMAS, Picture
from riskplan.pictures.recorder import Recorder
from riskplan.pictures.solids import Mesh, flat, merge

# Flat things write no depth and are drawn in this order, all at z = 0: nothing to flicker, whatever the zoom.
_LAYERS = (
    "road",
    "lines",
    "goal",
    "tree",
    "dots",
    "futures",
    "ellipses",
    "rims",
    "now",
    "casing",
    "ribbon",
    "shadow",
    "shape",
)


_ALL_KEYS, _FEWEST_KEYS = 6_000, 6  # of all ellipses of the moment together, and of one


class _Property:
    """meshcat's own SetProperty lower-cases the name, and so loses `renderOrder`."""

    def __init__(self, path: Any, name: str, value: Any) -> None:
        self._data = {"type": "set_property", "path": path.lower(), "property": name, "value": value}

    def lower(self) -> dict[str, Any]:
        return self._data


def viewer_script() -> str:
    """The viewer's JavaScript, as shipped with meshcat."""
    return (Path(meshcat.__file__).parent / "viewer" / "dist" / "main.min.js").read_text(encoding="utf-8")


def messages(pic: Picture, camera: Camera | None = None) -> list[bytes]:
    """The scene as the viewer's messages, the animation last."""
    recorder = Recorder()
    draw(meshcat.Visualizer(window=recorder), pic, camera)
    return [umsgpack.packb(command) for command in recorder.commands]


def draw(vis: Any, pic: Picture, camera: Camera | None = None) -> None:
    """Build the scene under `/riskplan` of a `meshcat.Visualizer`; the animation command comes last."""
    _stage(vis)
    for name, mesh in _ground(pic):
        _put(vis, name, mesh, _layer(name))
    for i, polygon in enumerate(pic.obstacles):
        _put(vis, f"obstacles/{i}", solids.column(polygon, 1.8, palette.OBSTACLE))
    if len(pic.tree):
        _tree(vis, pic)
    clips = {"ego": _clip(pic.times, pic.ego)}
    keys = _keys(len(pic.times), sum(agent.means.shape[1] for agent in pic.agents))
    for i, agent in enumerate(pic.agents):
        _sampled(vis, i, agent)
        for mode in range(agent.means.shape[1]):
            node = f"modes/{i}/{mode}"
            for name, mesh in _mode_meshes(agent, mode, pic.limits[1], 0.15 * pic.stroke).items():
                _put(vis, f"{node}/{name}", mesh, name)
            at, spread = (now[keys, mode] for now in agent.now[1:])
            clips[f"{node}/now"] = _ellipse_clip(pic.times[keys], at, spread)
    length, width = pic.ego_size
    ego = solids.robot(length, palette.EGO) if pic.ego_round else solids.vehicle(length, width, palette.EGO)
    _body(vis, "ego", ego, length, width, pic.grown)
    shape = [solids.curtain(ring[:-1], 0.9 * pic.stroke, palette.EGO) for ring in pic.ego_rings]
    if shape:
        _put(vis, "ego/shape", merge(shape), "shape")
    for i, agent in enumerate(pic.agents):
        name = agent_node(i, agent.name)
        _body(vis, name, solids.body(agent.length, agent.width, agent.colour), agent.length, agent.width, pic.grown)
        clips[name] = _clip(pic.times, agent.track)
    _camera(vis, camera or look(pic))
    animation = meshcat.animation.Animation({vis[f"/riskplan/{name}"].path: clip for name, clip in clips.items()})
    vis.set_animation(animation, play=True, repetitions=1_000_000_000)


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
    return next(part for part in reversed(name.split("/")) if part in _LAYERS)


def _ground(pic: Picture) -> Iterator[tuple[str, Mesh]]:
    asphalt, white = palette.rgb(palette.ASPHALT), palette.rgb(palette.LINE)
    yield "road", merge([flat(polygon, geometry.triangulate(polygon), asphalt) for polygon in pic.road])
    solid = [_band(line, 0.18 * pic.stroke, white) for line in pic.edges]
    dashed = [_band(dash, 0.15, white) for line in pic.dividers for dash in geometry.dashes(line)]
    if solid + dashed:
        yield "lines", merge(solid + dashed)
    goal = palette.rgb(palette.GOAL)
    for i, polygon in enumerate(pic.goals):
        fill = flat(polygon, geometry.triangulate(polygon), np.array([*goal, 0.25]))
        closed = np.concatenate([polygon, polygon[:1]])
        yield f"goal/{i}", merge([fill, _band(closed, 0.3 * pic.stroke, np.array([*goal, 0.9]))])
    if len(pic.path) > 1:
        left = np.column_stack([-np.sin(pic.path[:, 2]), np.cos(pic.path[:, 2])])
        shade = palette.ramp(palette.RISK, pic.path_risk / pic.limits[0])
        yield (
            "plan/casing",
            flat(*geometry.strip(pic.path[:, :2], left, 0.95 * pic.stroke), palette.rgb(palette.CASING)),
        )
        yield (
            "plan/ribbon",
            flat(*geometry.strip(pic.path[:, :2], left, 0.70 * pic.stroke), np.concatenate([shade, shade])),
        )


def _band(line: Array, width: float, colour: Array) -> Mesh:
    return flat(*geometry.strip(line, geometry.normals(line), width), colour)


def _tree(vis: Any, pic: Picture) -> None:
    colour = np.repeat(palette.ramp(palette.TIME, pic.tree[:, 4] / max(pic.limits[2], 1e-9)), 2, axis=0)
    _hairlines(vis, "tree", pic.tree[:, :4].reshape(-1, 2), colour, palette.tree_alpha(len(pic.tree)))


def _sampled(vis: Any, i: int, agent: AgentView) -> None:
    """Futures as thin lines, positions as dots."""
    tint = 0.35 + 0.65 * palette.rgb(agent.colour)
    if agent.futures.size:
        n, steps = agent.futures.shape[:2]
        ends = np.stack([agent.futures[:, :-1], agent.futures[:, 1:]], axis=2).reshape(-1, 2)
        shade = np.broadcast_to(tint, (2 * n * (steps - 1), 3))
        _hairlines(vis, f"samples/{i}/futures", ends, shade, palette.futures_alpha(n))
    if len(agent.dots):
        material = _DotMaterial(size=0.16)
        points = g.PointsGeometry(_level(agent.dots), np.tile(tint, (len(agent.dots), 1)).T.astype(np.float32))
        node = vis[f"/riskplan/samples/{i}/dots"]
        node.set_object(g.Points(points, material))
        node.window.send(_Property(node.path, "renderOrder", _LAYERS.index("dots")))


def _hairlines(vis: Any, name: str, ends: Array, colours: Array, opacity: float) -> None:
    """Line segments one pixel wide from pairs of points (2 N, 2)."""
    points = g.PointsGeometry(_level(ends), colours.T.astype(np.float32))
    material = g.LineBasicMaterial(vertexColors=True, transparent=True, opacity=opacity, depthWrite=False)
    node = vis[f"/riskplan/{name}"]
    node.set_object(g.LineSegments(points, material))
    node.window.send(_Property(node.path, "renderOrder", _LAYERS.index(_layer(name))))


def _level(points: Array) -> np.ndarray:
    return np.column_stack([points, np.zeros(len(points))]).T.astype(np.float32)


class _DotMaterial(g.PointsMaterial):  # type: ignore[misc]
    """meshcat's own is always opaque."""

    def lower(self, object_data: Any) -> dict[str, Any]:
        return {**super().lower(object_data), "transparent": True, "opacity": 0.4, "depthWrite": False}


def _mode_meshes(agent: AgentView, mode: int, limit: float, rim_width: float) -> dict[str, Mesh]:
    """All ellipses of one mode in one mesh, the outlines of every fifth, and the one of the moment: a unit circle."""
    rings = geometry.ellipses(agent.means[:, mode], agent.covariances[:, mode], SIGMAS)
    weight = agent.weights[:, mode]
    tint = np.column_stack(
        [palette.ramp(palette.WEIGHT, weight / limit), palette.fill_alpha(weight, agent.weights.shape[1])]
    )
    n = rings.shape[1]
    fill = flat(rings.reshape(-1, 2), geometry.fan(rings), np.repeat(tint, n, axis=0))
    ringed = tint[agent.rims, :3]
    rim = np.repeat(np.column_stack([ringed, np.full(len(ringed), 0.85)]), 2 * n, axis=0)
    angle = 2 * np.pi * np.arange(40) / 40
    circle = np.column_stack([np.cos(angle), np.sin(angle)])[None]
    disc = flat(circle[0], geometry.fan(circle), np.array([*tint[0, :3], 0.30]))
    edge = flat(*geometry.rims(circle, 0.09), np.array([*tint[0, :3], 1.0]))
    return {
        "ellipses": fill,
        "rims": flat(*geometry.rims(rings[agent.rims], rim_width), rim),
        "now": merge([disc, edge]),
    }


def _body(vis: Any, name: str, mesh: Mesh, length: float, width: float, grown: float) -> None:
    _put(vis, f"{name}/body", mesh._replace(vertices=grown * mesh.vertices))
    shadow = solids.shadow(length, width)
    _put(vis, f"{name}/shadow", shadow._replace(vertices=grown * shadow.vertices), "shadow")


def _camera(vis: Any, view: Camera) -> None:
    """The viewer turns about the world's origin for good, so the scene is moved instead."""
    vis["/riskplan"].set_property("position", (-view.target).tolist())
    camera = vis["/Cameras/default/rotated/<object>"]
    for key, value in (("fov", view.fov), ("near", view.distance / 100), ("far", view.distance * 20)):
        camera.set_property(key, float(value))
    x, y, z = view.eye.tolist()
    camera.set_property("position", [x, z, -y])  # its parent is turned: y is up


def _clip(times: Array, track: Array) -> Any:
    """Position and turn of a body over time; headings are continuous, so no turn takes the long way."""
    return _moves(times, track[:, :2], track[:, 2])


def _keys(steps: int, modes: int) -> NDArray[np.int64]:
    """The steps at which the ellipses of the moment are told where to be: all, but fewer in a crowd."""
    return np.linspace(0, steps - 1, min(steps, max(_FEWEST_KEYS, _ALL_KEYS // max(modes, 1)))).round().astype(np.int64)


def _ellipse_clip(times: Array, means: Array, covariances: Array) -> Any:
    """Position, turn and size of a unit circle that is an ellipse at `SIGMAS` over time.

    Eigenvectors have no sign and no order: the long axis is followed modulo half a turn.
    """
    a, b, d = covariances[:, 0, 0], covariances[:, 0, 1], covariances[:, 1, 1]
    turn = np.unwrap(0.5 * np.arctan2(2 * b, a - d), period=np.pi)
    middle, half = (a + d) / 2, np.hypot((a - d) / 2, b)
    axes = SIGMAS * np.sqrt(np.maximum([middle + half, middle - half], 0.0) + geometry.SPECK**2)
    return _moves(times, means, turn, np.column_stack([*axes, np.ones(len(times))]))


def _moves(times: Array, at: Array, turn: Array, scale: Array | None = None) -> Any:
    half, nothing = turn / 2, np.zeros(len(times))
    values = {
        "position": ("vector3", np.column_stack([at, nothing])),
        "quaternion": ("quaternion", np.column_stack([nothing, nothing, np.sin(half), np.cos(half)])),
    }
    if scale is not None:
        values["scale"] = ("vector3", scale)
    tracks = {
        name: meshcat.animation.AnimationTrack(name, kind, times.tolist(), rows.tolist())
        for name, (kind, rows) in values.items()
    }
    return meshcat.animation.AnimationClip(tracks, fps=1)  # key times are seconds
