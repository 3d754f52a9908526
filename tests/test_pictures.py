"""Pictures: what is in them, that they are the same on every run, and that nothing leaves the machine."""

from __future__ import annotations

import base64
import dataclasses
import io
import json
import os
import re
import socket
import subprocess
import sys

import numpy as np
import pytest
import umsgpack
from PIL import Image

from checkers import InputError
from riskplan.pictures import geometry, render, scene3d, top
from riskplan.pictures.picture import picture
from riskplan.scene import Goal, Scenario, State
from tests.pictured import STEPS, TIMES, overtake, overtaking_plan, unsolved

SMALL = (600, 220)


@pytest.fixture(scope="module")
def scenario():
    return overtake()


@pytest.fixture(scope="module")
def plan(scenario):
    return overtaking_plan(scenario)


@pytest.fixture(scope="module")
def page(scenario, plan, tmp_path_factory):
    return render(scenario, plan, tmp_path_factory.mktemp("page") / "scene.html").read_text()


def data_of(page):
    return json.loads(re.search(r"^const data = (.*);$", page, re.M).group(1))


def commands_of(page):
    return [umsgpack.unpackb(base64.b64decode(text)) for text in data_of(page)["commands"]]


def meshes_of(page):
    """{path below /riskplan: positions (N, 3) of its mesh}."""
    found = {}
    for command in commands_of(page):
        if command["type"] == "set_object":
            (shape,) = command["object"]["geometries"]
            raw = shape["data"]["attributes"]["position"]["array"].data
            found[command["path"].removeprefix("/riskplan/")] = np.frombuffer(raw, np.float32).reshape(-1, 3)
    return found


def tracks_of(page):
    """{path below /riskplan: {track: (times, values)}} of the animation."""
    last = commands_of(page)[-1]
    assert last["type"] == "set_animation"
    return {
        entry["path"].removeprefix("/riskplan/"): {
            track["name"]: (
                np.array([key["time"] for key in track["keys"]]) / entry["clip"]["fps"],
                np.array([key["value"] for key in track["keys"]]),
            )
            for track in entry["clip"]["tracks"]
        }
        for entry in last["animations"]
    }


def pixels(png):
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)


def seen_from_above(pic, *size):
    return top.still(pic, *size)[..., :3].astype(int)


def view_of(suffix):
    """What these tests draw without a browser."""
    return "auto" if suffix == ".html" else "top"


@pytest.mark.parametrize("suffix", [".html", ".png", ".gif", ".mp4"])
def test_same_input_gives_the_same_bytes(scenario, plan, tmp_path, suffix):
    if suffix == ".mp4":
        pytest.importorskip("imageio_ffmpeg", reason="needs the extra video")
    looks = {"view": view_of(suffix), "size": SMALL, "samples": 5, "density": 5, "seed": 3}
    files = [render(scenario, plan, tmp_path / f"{name}{suffix}", **looks) for name in "ab"]
    assert files[0].read_bytes() == files[1].read_bytes()


def test_page_fetches_nothing(page):
    own = page.replace(scene3d.viewer_script(), "")
    assert len(own) < len(page) - 500_000  # the viewer is in there, whole
    assert re.findall(r"(?:src|href)\s*=\s*[\"']?([^\"'\s>]+)", own) == ["data:,"]
    assert not re.search(r"https?:|wss?:|@import|url\(|fetch\(|XMLHttp|WebSocket|connect\(", own)
    assert "default-src 'none'" in own  # and if something tried to, the browser would refuse


def test_no_socket_and_no_process(scenario, plan, tmp_path, monkeypatch):
    def refuse(*_args, **_kwargs):
        raise AssertionError("rendering must stay in this process")

    import zmq

    for module, name in ((socket, "socket"), (subprocess, "Popen"), (zmq.Context, "socket")):
        monkeypatch.setattr(module, name, refuse)
    for suffix in (".html", ".png", ".gif"):
        render(scenario, plan, tmp_path / f"scene{suffix}", size=SMALL, view=view_of(suffix))


def test_heavy_libraries_are_imported_when_needed_only():
    code = "import sys, riskplan.pictures; print(*{'meshcat', 'matplotlib', 'PIL'} & set(sys.modules))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout == "\n"


def test_names_are_escaped(plan, tmp_path):
    name = "</script><script>alert(1)</script> @DATA@ & \u03c3"
    scenario = overtake(name=name)
    agents = (dataclasses.replace(scenario.agents[0], name=name), *scenario.agents[1:])
    hostile = dataclasses.replace(plan, settings={"planner": "<b>", "checker": "</script>"})
    page = render(dataclasses.replace(scenario, agents=agents), hostile, tmp_path / "scene.html").read_text()
    assert "<script>alert" not in page
    assert "<b>" not in page.replace(scene3d.viewer_script(), "").replace("<b>0", "").replace("<b>5", "")
    assert page.count("&lt;/script&gt;&lt;script&gt;alert(1)&lt;/script&gt; @DATA@ &amp; σ") == 2
    assert page.count("</script>") == 3
    assert len(commands_of(page)) > 50


def test_scene_has_a_node_for_everything(page, scenario):
    expected = {"road", "lines", "goal/0", "plan/casing", "plan/ribbon", "tree", "obstacles/0"}
    expected |= {"ego/body", "ego/shadow", "ego/shape"}
    for i, node in enumerate(["0-car-left", "1-truck", "2-car-right"]):
        expected |= {f"agents/{node}/body", f"agents/{node}/shadow"}
        expected |= {f"modes/{i}/{mode}/{part}" for mode in range(3) for part in ("ellipses", "rims", "now")}
    meshes = meshes_of(page)
    assert set(meshes) == expected
    assert all(len(mesh) and np.isfinite(mesh).all() for mesh in meshes.values())
    assert np.ptp(meshes["agents/1-truck/body"][:, 0]) == pytest.approx(scenario.agents[1].length, abs=0.1)
    assert np.ptp(meshes["ego/body"][:, 1]) == pytest.approx(scenario.vehicle.width, abs=0.1)


def test_ellipses_are_at_two_sigma(page, scenario):
    truck = scenario.agents[1]
    ring = meshes_of(page)["modes/1/0/ellipses"].reshape(-1, 28, 3)[-1, :, :2]
    shown = np.arange(0, STEPS + 1, 3)[-1]
    assert ring.mean(axis=0) == pytest.approx(truck.means[shown, 0], abs=1e-4)
    sigma = np.sqrt(np.diag(truck.covariances[shown, 0]))
    assert np.ptp(ring, axis=0) == pytest.approx(4 * sigma, rel=1e-2)


def test_animation_follows_the_plan_and_the_most_likely_mode(page, scenario, plan):
    tracks = tracks_of(page)
    modes = {f"modes/{i}/{mode}/now" for i in range(3) for mode in range(3)}
    assert set(tracks) == {"ego", "agents/0-car-left", "agents/1-truck", "agents/2-car-right"} | modes
    for k in (0, 17, STEPS):
        time = plan.times[k]
        at = {name: track[".position"] for name, track in tracks.items()}
        assert at["ego"][0][k] == pytest.approx(time)
        assert at["ego"][1][k, :2] == pytest.approx(plan.poses[k, :2])
        assert at["agents/1-truck"][1][k, :2] == pytest.approx(scenario.agents[1].means[k, 0])
        x, y, z, w = tracks["ego"][".quaternion"][1][k]
        assert (x, y, 2 * np.arctan2(z, w)) == pytest.approx((0, 0, plan.poses[k, 2]))


def test_turns_never_take_the_long_way(scenario, plan):
    heading = np.linspace(3.0, 3.5, len(plan.times))
    wrapped = (heading + np.pi) % (2 * np.pi) - np.pi
    turned = dataclasses.replace(plan, poses=np.column_stack([plan.poses[:, :2], wrapped]))
    assert np.abs(np.diff(picture(scenario, turned).ego[:, 2])).max() < 0.02


def test_risk_so_far_ends_at_the_total_or_is_not_shown(scenario, plan):
    so_far = picture(scenario, plan).so_far
    assert (np.diff(so_far) >= 0).all()
    assert so_far[-1] == pytest.approx(float(plan.risk.total))
    other = dataclasses.replace(plan, risk=dataclasses.replace(plan.risk, total=plan.risk.total / 2))
    assert picture(scenario, other).so_far is None


def test_legend_states_status_bound_risk_and_checker(page, plan):
    text = re.sub(r"<[^>]+>", " ", page.split("</style>")[1].split("<script>")[0])
    for part in ("overtake", "solved", "0.05", f"{float(plan.risk.total):.2g}", "rrt", "exact", "weight"):
        assert part in text


@pytest.mark.parametrize("suffix", [".html", ".png", ".gif"])
def test_without_a_plan(scenario, tmp_path, suffix):
    nothing = render(scenario, None, tmp_path / f"none{suffix}", size=SMALL, view=view_of(suffix)).read_bytes()
    searched = render(
        scenario, unsolved(), tmp_path / f"unsolved{suffix}", size=SMALL, view=view_of(suffix)
    ).read_bytes()
    assert nothing != searched
    if suffix == ".html":
        nodes = meshes_of(searched.decode())
        assert "tree" in nodes
        assert "plan/ribbon" not in nodes
        assert "no plan found" in searched.decode()


def test_an_empty_world(tmp_path):
    bare = Scenario(State(0, 0, 1.0), Goal.at(30, 10), (-10, -10, 50, 50), horizon=5.0)
    for suffix in (".html", ".png", ".gif"):
        assert render(bare, None, tmp_path / f"bare{suffix}", size=SMALL, view=view_of(suffix)).stat().st_size > 1000


def test_a_plan_of_one_step_and_agents_that_start_late(scenario, plan, tmp_path):
    late = dataclasses.replace(scenario, agents=(scenario.agents[0].at(TIMES[1:]).moments(4),))
    one = dataclasses.replace(plan, times=TIMES[:1], poses=plan.poses[:1], risk=None, marginals=())
    for suffix in (".html", ".png", ".gif"):
        render(late, one, tmp_path / f"one{suffix}", size=SMALL, view=view_of(suffix))


def test_png_is_a_picture_of_the_plan(scenario, plan, tmp_path):
    one = render(scenario, plan, tmp_path / "a.png", size=SMALL, view="top").read_bytes()
    other = dataclasses.replace(plan, poses=plan.poses * [1.0, -1.0, -1.0])
    two = render(scenario, other, tmp_path / "b.png", size=SMALL, view="top").read_bytes()
    assert one.startswith(b"\x89PNG")
    assert pixels(one).shape == (*SMALL[::-1], 3)
    assert (pixels(one) != pixels(two)).any(axis=-1).sum() > 500


@pytest.fixture(scope="module")
def drawn(scenario, plan):
    pic = picture(scenario, plan)
    return pic, seen_from_above(pic, (1000, 330))


@pytest.mark.parametrize(
    ("part", "without"),
    [
        ("path", {"path": np.zeros((0, 3))}),
        ("agents", {"agents": ()}),
        ("risk shape", {"ego_rings": ()}),
        ("ego", {"ego_size": (0.01, 0.01)}),
        ("tree", {"tree": np.zeros((0, 5))}),
        ("road", {"road": ()}),
        ("edges", {"edges": ()}),
        ("dividers", {"dividers": ()}),
        ("obstacles", {"obstacles": ()}),
        ("goals", {"goals": ()}),
    ],
)
def test_every_part_owns_pixels(drawn, part, without):
    pic, whole = drawn
    rest = seen_from_above(dataclasses.replace(pic, **without), (1000, 330))
    changed = np.abs(whole - rest).max(axis=-1) > 8
    assert changed[100:].sum() > 100, part  # below the legend


def test_gif_moves(scenario, plan, tmp_path):
    with Image.open(render(scenario, plan, tmp_path / "a.gif", size=SMALL, view="top")) as film:
        assert film.size == SMALL
        assert 30 <= film.n_frames <= 60
        first = np.asarray(film.convert("RGB"))
        film.seek(film.n_frames - 1)
        assert (first != np.asarray(film.convert("RGB"))).any(axis=-1).sum() > 500


def test_far_from_the_map_origin_looks_the_same(page, scenario, plan, tmp_path):
    far = overtake(shift=(1e5, -1e5))
    far_plan = overtaking_plan(far)
    far_page = render(far, far_plan, tmp_path / "far.html").read_text()
    near_meshes, far_meshes = meshes_of(page), meshes_of(far_page)
    assert set(near_meshes) == set(far_meshes)
    for name in set(near_meshes) - {"lines"}:
        np.testing.assert_allclose(near_meshes[name], far_meshes[name], atol=1e-4, err_msg=name)
    one, two = (seen_from_above(picture(s, p)) for s, p in ((scenario, plan), (far, far_plan)))
    assert (np.abs(one - two).max(axis=-1) > 8).mean() < 1e-3


def test_unknown_suffix_is_named(scenario, plan, tmp_path):
    with pytest.raises(InputError, match=r"expected a suffix out of \.html, \.png, \.gif, \.mp4; got '\.bmp'"):
        render(scenario, plan, tmp_path / "scene.bmp")
    with pytest.raises(InputError, match="got 'none'"):
        render(scenario, plan, tmp_path / "scene")


def test_missing_directory_and_tiny_size_are_named(scenario, plan, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot make the directory"):
        render(scenario, plan, tmp_path / "file" / "scene.png", view="top")
    with pytest.raises(InputError, match=r"size: expected at least \(200, 150\) pixels, got \(10, 10\)"):
        render(scenario, plan, tmp_path / "scene.png", size=(10, 10))


def test_an_interrupt_leaves_the_old_file(scenario, plan, tmp_path, monkeypatch):
    target = tmp_path / "scene.png"
    target.write_text("old")

    def interrupt(*_args):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", interrupt)
    with pytest.raises(KeyboardInterrupt):
        render(scenario, plan, target, size=(400, 200), view="top")
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("scene.png", "old")]


def test_a_number_that_is_not_finite_is_refused(scenario, plan):
    broken = dataclasses.replace(plan, poses=np.where(np.arange(STEPS + 1)[:, None] == 3, np.nan, plan.poses))
    with pytest.raises(ValueError, match="not finite"):
        scene3d.messages(picture(scenario, broken))


@pytest.mark.parametrize("clockwise", [False, True])
def test_triangles_cover_a_crooked_polygon(clockwise):
    angle = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    star = np.column_stack([np.cos(angle), np.sin(angle)]) * (5 + 2 * np.sin(9 * angle))[:, None]
    star = star[::-1] if clockwise else star
    triangles = star[geometry.triangulate(star)]
    areas = [geometry.area(triangle) for triangle in triangles]
    assert min(areas) > 0
    assert sum(areas) == pytest.approx(abs(geometry.area(star)))


def test_triangulation_ends_for_a_polygon_that_crosses_itself():
    bow = np.array([[0.0, 0.0], [2.0, 2.0], [2.0, 0.0], [0.0, 2.0], [-1.0, 1.0]])
    assert geometry.triangulate(bow).shape == (3, 3)


def test_ellipses_match_the_covariance_and_survive_a_singular_one():
    rng = np.random.default_rng(0)
    root = rng.normal(size=(5, 2, 2))
    covariance = root @ root.transpose(0, 2, 1)
    covariance[0] = 0.0
    rings = geometry.ellipses(np.zeros((5, 2)), covariance, 2.0)
    inverse = np.linalg.inv(covariance + 0.03**2 * np.eye(2))
    np.testing.assert_allclose(np.einsum("eni,eij,enj->en", rings, inverse, rings), 4.0, rtol=2e-2)


def test_dividers_lie_between_neighbours_only():
    along = [np.array([[0.0, y], [50.0, y]]) for y in (0.0, 3.5, 7.0)]
    across = np.array([[25.0, -20.0], [25.0, 30.0]])
    lines = geometry.dividers([*along, across])
    assert sorted({round(float(line[0, 1]), 6) for line in lines}) == [1.75, 5.25]
