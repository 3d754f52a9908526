"""Odd worlds: each has its page, its stills and its panel, or a reason why not."""

from __future__ import annotations

import dataclasses
import html
import io
import json
import re

import numpy as np
import pytest
from PIL import Image

import riskplan as rp
from riskplan.doctor import find_browser
from riskplan.pictures import browser, film, page, palette, scene3d, top
from riskplan.pictures.agent_view import Detail
from riskplan.pictures.encode import png
from riskplan.pictures.picture import picture
from tests.pictured import overtake

T = np.arange(0.0, 4.01, 0.1)
ALL = Detail(3, 3, 0)


def car(x, y, vx=5.0, spread=0.3, modes=1, length=4.6, width=1.9, scale=1.0):
    """Straight on, in `modes` that fan out; everything `scale` times as large."""
    aside = np.linspace(-1.0, 1.0, modes) if modes > 1 else [0.0]
    means = np.stack([np.column_stack([x + vx * T, y + 0.6 * share * T]) for share in aside], axis=1)
    cov = np.tile((spread + 0.2 * T * bool(spread))[:, None, None, None] ** 2 * np.eye(2), (1, modes, 1, 1))
    size = {"length": scale * length, "width": scale * width}
    weights = np.full(modes, 1 / modes)
    return rp.GaussianMixturePrediction(T, weights, scale * means, scale**2 * cov, name=f"at {x:.0f}", **size)


def world(agents, scale=1.0, far=40.0, side=6.0, **others):
    ego = rp.EgoEllipsoid.around(*(scale * side for side in (4.5, 1.8, 4.5, 1.8)))
    start, goal = rp.State(0.0, 0.0, 0.0, speed=10.0 * scale), rp.Goal.at(far * scale, 0.0, radius=0.1 * far * scale)
    bounds = tuple(scale * b for b in (-10.0, -side, 1.5 * far, side))
    return rp.Scenario(start, goal, bounds, agents=agents, ego=ego, horizon=4.0, **others)


def way(scene, far=40.0):
    """Straight ahead, judged by nobody: the numbers are invented."""
    poses = np.column_stack([np.linspace(0.0, far, len(T)), 0.0 * T, 0.0 * T])
    bumps = [np.outer(1e-3 * np.exp(-((T - 2.0) ** 2)), a.weights) for a in scene.agents]
    risk = rp.trajectory_risk([rp.Risk(b, rp.Kind.EXACT) for b in bumps], scene.agents) if bumps else None
    settings = {"planner": "rrt", "checker": "exact"}
    return rp.Plan("solved", T, poses, 0.0 * T + 10.0, risk, tuple(bumps), bound=0.01, settings=settings)


def controlled():
    where, controls = {"x": 20.0, "y": 3.0, "v": 8.0, "theta": 0.0}, {"w_v": rp.Normal(0.0, 0.05)}
    return rp.ControlPrediction(
        rp.dynamics.dubins(0.1), where, [{**controls, "w_theta": rp.Normal(0.0, 0.01)}], steps=40, name="controls"
    )


def crowd(modes=1):
    rng = np.random.default_rng(0)
    return [car(x, y, modes=modes) for x, y in rng.uniform([0.0, -40.0], [300.0, 40.0], (200, 2))]


def failed(scene):
    return rp.Plan("no_plan_found", np.zeros(0), np.zeros((0, 3)), np.zeros(0), None, bound=0.01, message="none")


ODD = {
    "no agents": lambda: (world([]), 40.0),
    "one mode": lambda: (world([car(20.0, 3.0)]), 40.0),
    "twenty modes": lambda: (world([car(20.0, 3.0, modes=20)]), 40.0),
    "no variance": lambda: (world([car(20.0, 3.0, spread=0.0)]), 40.0),
    "no plan": lambda: (world([car(20.0, 3.0)]), None),
    "standing still": lambda: (world([car(20.0, 3.0)]), 0.0),
    "a kilometre": lambda: (world([car(250.0, 20.0, 60.0)], far=900.0, side=60.0), 900.0),
    "centimetres": lambda: (world([car(20.0, 3.0, scale=0.01)], 0.01, vehicle=rp.PointRobot(radius=0.01)), 0.4),
    "a point robot": lambda: (world([car(4.0, 1.5, -0.5, 0.1, 1, 0.5, 0.5)], far=8.0, vehicle=rp.PointRobot()), 8.0),
    "by controls": lambda: (world([controlled()]), 40.0),
    "200 agents": lambda: (world(crowd(), far=200.0, side=50.0), 200.0),
}


@pytest.fixture(scope="module", params=list(ODD))
def odd(request):
    scene, far = ODD[request.param]()
    return request.param, scene, failed(scene) if far is None else way(scene, far)


def pixels(data):
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).astype(float)


def share_of(colour, image):
    return (np.abs(image - 255 * palette.rgb(colour)).max(axis=-1) < 12).mean()


def test_the_top_view_shows_ego_and_road(odd):
    name, scene, plan = odd
    image = pixels(png(top.still(picture(scene, plan, None, ALL), (800, 420), 15)))
    assert share_of(palette.EGO, image) > (5e-5 if name in ("a kilometre", "200 agents") else 3e-4)
    assert share_of(palette.ASPHALT, image) > 0.05


def test_the_page_has_a_panel_for_everything(odd, tmp_path):
    name, scene, plan = odd
    text = rp.render(scene, plan, tmp_path / "odd.html", samples=3, density=3).read_text()
    assert len(text) < 30e6
    data = json.loads(re.search(r"^const data = (.*);$", text, re.M).group(1))
    assert len(data["agents"]) == len(scene.agents)
    assert [len(agent["modes"]) for agent in data["agents"]] == [len(a.weights) for a in scene.agents]
    parts = {label for label, _ in data["parts"]}
    assert ("plan" in parts) == (name != "no plan")
    assert ({"agents", "modes", "samples"} <= parts) == bool(scene.agents)
    assert len(data["times"]) == len(T)


def test_a_notebook_shows_it(odd):
    _, scene, plan = odd
    for value in (scene, plan, *scene.agents[:1]):
        assert re.search("<(img|table)", value._repr_html_())


def test_a_film_moves_or_stands(odd):
    name, scene, plan = odd
    if name == "200 agents":
        scene = scene.with_agents(scene.agents[:3])  # the rest costs seconds and shows nothing new
    frames, times = top.moving(picture(scene, plan), (400, 300))
    assert len(frames) == len(times) == len(T)
    still = name in ("no plan", "standing still") and not scene.agents
    assert still or (frames[0] != frames[-1]).any()


PROBE = """<script>
"use strict";
time.value = time.max;
time.oninput();
viewer.set_3d_pane_size(320, 200);
viewer.render();
const gl = viewer.renderer.getContext(), w = gl.drawingBufferWidth, h = gl.drawingBufferHeight;
const seen = new Uint8Array(4 * w * h), colours = new Set();
gl.readPixels(0, 0, w, h, gl.RGBA, gl.UNSIGNED_BYTE, seen);
for (let i = 0; i < seen.length; i += 4) colours.add(seen[i] << 16 | seen[i + 1] << 8 | seen[i + 2]);
show();
const checks = [...document.querySelectorAll("#show input")];
checks.slice(0, 60).forEach(check => check.click());
const hidden = checks.slice(0, 60).filter(check => !node(check.dataset.node).object.visible).length;
parent.found(NUMBER, {colours: colours.size, ego: ego.position.toArray(), checks: checks.length, hidden,
  readout: now.textContent, failed: document.getElementById("failed").textContent});
</script></body>"""


BROWSED = ["no agents", "twenty modes", "no plan", "a kilometre", "centimetres", "by controls", "200 agents"]


@pytest.fixture(scope="module")
def pages():
    """All pages side by side in one run of the browser: {name: what its probe found}."""
    frames, origins = [], {}
    for i, name in enumerate(BROWSED):
        scene, far = ODD[name]()
        scene = scene.with_agents(scene.agents[:30])
        plan = failed(scene) if far is None else way(scene, far)
        pic = picture(scene, plan, None, ALL)
        text = page.page(pic, scene3d.viewer_script(), scene3d.messages(pic))
        frames.append(html.escape(text.replace("</body>", PROBE.replace("NUMBER", str(i)))))
        origins[name] = pic
    script = "<script>const all = {}; function found(i, what) { all[i] = what; }</script>"
    holders = "".join(f'<iframe width="320" height="200" srcdoc="{frame}"></iframe>' for frame in frames)
    end = """<script>window.onload = () => { const p = document.createElement("p"); p.id = "report";
    p.textContent = JSON.stringify(all); document.body.replaceChildren(p); };</script>"""
    document = browser.dump(f"<!DOCTYPE html><html><body>{script}{holders}{end}</body></html>")
    report = json.loads(html.unescape(re.search(r'<p id="report">(.*?)</p>', document, re.DOTALL).group(1)))
    return {name: (report.get(str(i)), origins[name]) for i, name in enumerate(BROWSED)}


@pytest.mark.skipif(find_browser() is None, reason="no Chromium found")
@pytest.mark.parametrize("name", BROWSED)
def test_the_page_works_in_a_browser(pages, name):
    report, pic = pages[name]
    assert report is not None
    assert report["failed"] == ""
    assert report["colours"] > 10
    np.testing.assert_allclose(report["ego"][:2], pic.ego[-1, :2], atol=1e-2)
    assert report["hidden"] == min(report["checks"], 60)
    assert report["readout"].startswith("t = 4.0 s")


@pytest.mark.skipif(find_browser() is None, reason="no Chromium found")
def test_a_3d_still_of_centimetres_shows_the_robot():
    scene, far = ODD["centimetres"]()
    image = film.still(picture(scene, way(scene, far)), (320, 200), 20)[..., :3].astype(float)
    assert share_of(palette.EGO, image) > 1e-3


def test_centimetres_look_like_metres():
    """The same world a tenth as large has the same picture: nothing about it is measured in metres."""
    pics = []
    for scale in (0.01, 0.001):
        scene = world([car(20.0, 3.0, scale=scale)], scale, vehicle=rp.PointRobot(radius=scale))
        pics.append(picture(scene, way(scene, 40.0 * scale)))
    assert [pic.zoom for pic in pics] == pytest.approx([10.0, 100.0])
    for one, other in zip(pics[0].agents, pics[1].agents, strict=True):
        np.testing.assert_allclose(one.covariances, other.covariances)
        np.testing.assert_allclose(one.track, other.track, atol=1e-9)
    np.testing.assert_allclose(pics[0].ego_rings[0], pics[1].ego_rings[0], atol=1e-3)
    np.testing.assert_allclose(pics[0].window, pics[1].window, atol=1e-3)
    np.testing.assert_allclose(pics[0].edges[0], pics[1].edges[0], atol=1e-9)


def test_a_risk_map_of_a_tiny_world_lies_on_its_own_road():
    scene, _ = ODD["centimetres"]()
    figure = rp.plots.risk_map(rp.risk_map(scene, 1.0, spacing=0.01), scene)
    road = figure.axes[0].collections[0].get_paths()[0].vertices
    np.testing.assert_allclose([road[:, 0].min(), road[:, 0].max()], [scene.bounds[0], scene.bounds[2]], atol=1e-9)


def test_a_small_robot_that_is_no_disc_is_no_person():
    scene = dataclasses.replace(overtake(), vehicle=rp.KinematicCar(length=0.9, width=0.6))
    meshes = [command for command in _objects(scene) if command["path"] == "/riskplan/ego/body"]
    assert len(meshes) == 1
    assert 0.2 < _height(meshes[0]) < 0.8


def _objects(scene):
    import umsgpack

    return [c for c in map(umsgpack.unpackb, scene3d.messages(picture(scene))) if c["type"] == "set_object"]


def _height(command):
    (shape,) = command["object"]["geometries"]
    return np.frombuffer(shape["data"]["attributes"]["position"]["array"].data, np.float32).reshape(-1, 3)[:, 2].max()


def test_many_modes_share_the_ellipses():
    few, many = (picture(world(agents, far=200.0)).agents[0] for agents in ([car(20.0, 3.0)], crowd(3)))
    assert len(few.means) == 21
    assert len(many.means) == 6
    assert len(range(*many.rims.indices(6))) == 3
