"""3-D pictures in a real Chromium, and what happens where there is none."""

from __future__ import annotations

import dataclasses
import html
import io
import json
import os
import re
import threading
import warnings
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from checkers import InputError
from riskplan.cli import main
from riskplan.demo_scene import DATA as SHIPPED
from riskplan.doctor import BROWSER_VARIABLE, find_browser
from riskplan.outputs import write_results
from riskplan.pictures import browser, draw, film, overlay, palette, render
from riskplan.pictures.camera import follow, project
from riskplan.pictures.picture import picture
from tests.pictured import STEPS, TIMES, overtake, overtaking_plan

needs_browser = pytest.mark.skipif(find_browser() is None, reason="no Chromium found")
SMALL = (320, 200)


@pytest.fixture(scope="module")
def scenario():
    return overtake()


@pytest.fixture(scope="module")
def plan(scenario):
    return overtaking_plan(scenario, edges=500)


@pytest.fixture(scope="module")
def page(scenario, plan, tmp_path_factory):
    return render(scenario, plan, tmp_path_factory.mktemp("page") / "scene.html", samples=20, density=20).read_text()


def short(plan, steps):
    """The first steps of a plan: a film of few frames."""
    cut = {name: getattr(plan, name)[:steps] for name in ("times", "poses", "speeds")}
    return dataclasses.replace(plan, **cut, risk=None, marginals=())


PROBE = r"""<script>
"use strict";
const errors = [];
window.addEventListener("error", event => errors.push(event.message));
function count() {  // pixels that are not as they were
  viewer.render();
  const gl = viewer.renderer.getContext(), w = gl.drawingBufferWidth, h = gl.drawingBufferHeight;
  const now = new Uint8Array(4 * w * h);
  gl.readPixels(0, 0, w, h, gl.RGBA, gl.UNSIGNED_BYTE, now);
  let changed = 0;
  if (count.last) for (let i = 0; i < now.length; i += 4)
    changed += Math.abs(now[i] - count.last[i]) + Math.abs(now[i + 1] - count.last[i + 1]) +
      Math.abs(now[i + 2] - count.last[i + 2]) > 6;
  count.last = now;
  return changed;
}
viewer.set_3d_pane_size(640, 360);
const report = {owned: {}, ego: [], clicks: {}, readout: []};
player.pause();
player.seek(3.0);
count();
for (const path of NODES) {
  node(path).set_property("visible", false);
  report.owned[path] = count();
  node(path).set_property("visible", true);
  count();
}
for (const t of TIMES) {
  time.value = t;
  time.oninput();
  show();
  viewer.scene.updateMatrixWorld();
  const at = root.worldToLocal(node("ego").object.getWorldPosition(new MeshCat.THREE.Vector3()));
  report.ego.push([at.x, at.y]);
  report.readout.push(now.textContent);
}
count();
for (const check of document.querySelectorAll("#show input")) {
  const shown = () => node(check.dataset.node).object.visible;
  check.click();
  const hidden = !shown(), pixels = check.closest("#parts") ? count() : 1;
  check.click();
  report.clicks[check.dataset.node] = [hidden, pixels, shown()];
  if (check.closest("#parts")) count();
}
const playing = player.playing;
toggle.click();
report.toggled = [playing, player.playing];
follow.click();
show();
report.followed = [root.position.x + node("ego").object.position.x, viewer.camera.position.length()];
follow.click();
report.home = root.position.equals(home);
report.requests = performance.getEntriesByType("resource").map(entry => entry.name);
report.failed = document.getElementById("failed").textContent;
report.errors = errors;
const out = document.createElement("p");
out.id = "report";
out.textContent = JSON.stringify(report);
document.body.append(out);
</script>
</body>"""

NODES = ["road", "lines", "goal", "obstacles", "tree", "plan", "plan/casing", "plan/ribbon", "samples/0/futures"]
NODES += ["samples/1/dots", "ego", "ego/body", "ego/shape", "agents/1-truck", "modes/0/0/ellipses", "modes/1/0/rims"]
NODES += ["modes/0/1/now"]
AT = [0, 17, STEPS]


@pytest.fixture(scope="module")
def probed(page, tmp_path_factory):
    """One run answers everything about the page; the names of what Chromium asked the network for come along."""
    log = tmp_path_factory.mktemp("net") / "log.json"
    script = PROBE.replace("NODES", json.dumps(NODES)).replace("TIMES", json.dumps([float(TIMES[k]) for k in AT]))
    flags = ["--host-resolver-rules=MAP * ~NOTFOUND", f"--log-net-log={log}", "--window-size=640,360"]
    document = browser.dump(page.replace("</body>", script), flags=flags)
    found = re.search(r'<p id="report">(.*?)</p>', document, re.DOTALL)
    assert found, document[-2000:]
    return json.loads(html.unescape(found.group(1))), log.read_text()


@needs_browser
@pytest.mark.parametrize("node", NODES)
def test_every_node_owns_pixels(probed, node):
    assert probed[0]["owned"][node] > 15


@needs_browser
def test_the_ego_is_where_the_plan_says(probed, plan):
    np.testing.assert_allclose(probed[0]["ego"], plan.poses[AT, :2], atol=2e-3)


@needs_browser
def test_the_panel_works_by_click(probed):
    report = probed[0]
    assert {"agents", "modes", "samples", "tree", "ego/shape", "plan", "goal", "modes/2/1"} <= set(report["clicks"])
    for node, (hidden, pixels, shown) in report["clicks"].items():
        assert hidden and shown, node
        assert pixels > 0, node
    assert report["toggled"] == [False, True]


@needs_browser
def test_the_readout_tells_the_risk_of_the_step_and_so_far(probed, plan):
    first, middle, last = probed[0]["readout"]
    assert first.startswith("t = 0.0 s   this step")
    assert f"this step {palette.number(float(plan.risk.per_step[17]))}" in middle
    assert last.endswith(f"so far ≤ {palette.number(float(plan.risk.total))}")


@needs_browser
def test_the_camera_follows_and_comes_home(probed, scenario, plan):
    camera, targets = follow(picture(scenario, plan))
    ahead, distance = probed[0]["followed"]
    assert ahead == pytest.approx(plan.poses[0, 0] - targets[0, 0], abs=1e-3)
    assert distance == pytest.approx(camera.distance)
    assert probed[0]["home"]


@needs_browser
def test_nothing_is_fetched_and_nothing_fails(probed):
    report, log = probed
    assert report["errors"] == []
    assert report["failed"] == ""
    assert all(name.startswith("data:") for name in report["requests"])
    asked = {url for url in re.findall(r'"url":"([^"]+)"', log) if not url.startswith(("data:", "chrome", "devtools"))}
    assert not [url for url in asked if not url.startswith("file:")]


@needs_browser
def test_without_webgl_the_page_says_so(page):
    document = browser.dump(page, flags=["--disable-3d-apis", "--disable-software-rasterizer"])
    message = re.search(r'<div id="failed"[^>]*style="display: block;"[^>]*>(.*?)</div>', document, re.DOTALL)
    assert message
    assert "no WebGL" in message.group(1)
    assert "hardware acceleration" in message.group(1)


@needs_browser
def test_a_still_without_webgl_is_an_error(scenario, plan, monkeypatch):
    monkeypatch.setattr(browser, "FLAGS", (*browser.FLAGS, "--disable-3d-apis"))
    with pytest.raises(InputError, match="could not draw the scene: .*WebGL"):
        film.still(picture(scenario, plan), SMALL)


@needs_browser
@pytest.mark.parametrize("suffix", [".png", ".gif"])
def test_two_runs_give_the_same_bytes(scenario, plan, tmp_path, suffix):
    files = [render(scenario, short(plan, 3), tmp_path / f"{n}{suffix}", view="3d", size=SMALL) for n in "ab"]
    assert files[0].read_bytes() == files[1].read_bytes()
    with Image.open(files[0]) as image:
        assert image.size == SMALL
        assert getattr(image, "n_frames", 1) == (3 if suffix == ".gif" else 1)


@needs_browser
@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="Linux only")
def test_a_still_opens_no_port(scenario, plan):
    drawn, seen = [], 0
    work = threading.Thread(target=lambda: drawn.append(film.still(picture(scenario, plan), SMALL)))
    work.start()
    while work.is_alive():
        processes = descendants(os.getpid())
        seen = max(seen, len(processes))
        assert not listening([os.getpid(), *processes])
        threading.Event().wait(0.05)
    assert drawn
    assert seen >= 2  # the browser and its helpers were looked at


def descendants(parent):
    """Process ids below one."""
    children = {}
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            text = status.read_text()
        except OSError:  # it has ended
            continue
        children.setdefault(int(text.rsplit(")", 1)[1].split()[1]), []).append(int(status.parent.name))
    found = list(children.get(parent, []))
    for pid in found:
        found += children.get(pid, [])
    return found


def listening(processes):
    """Sockets of these processes that wait for connections."""
    own = set()
    for pid in processes:
        for link in Path(f"/proc/{pid}/fd").glob("*"):
            try:
                own.add(os.readlink(link))
            except OSError:
                continue
    rows = [line.split() for name in ("tcp", "tcp6") for line in Path("/proc/net", name).read_text().splitlines()[1:]]
    return [row[1] for row in rows if row[3] == "0A" and f"socket:[{row[9]}]" in own]


@needs_browser
def test_a_still_shows_the_ego_at_the_time_asked_for(scenario, plan):
    pic = picture(scenario, plan)
    bare = dataclasses.replace(pic, agents=(), tree=pic.tree[:0], ego_rings=(), title="")
    size = (600, 300)
    step = 20
    frame = film.still(bare, size, step)[..., :3].astype(float)
    blue = np.abs(frame - 255 * palette.rgb(palette.EGO)).max(axis=-1) < 40
    rows, columns = np.nonzero(blue)
    (expected,) = project(overlay.view(bare, size), plan.poses[step : step + 1, :2], 2.0) * size
    assert blue.sum() > 20
    assert np.hypot(columns.mean() - expected[0], rows.mean() - expected[1]) < 12.0


@needs_browser
def test_mp4_in_3d(scenario, plan, tmp_path):
    pytest.importorskip("imageio_ffmpeg", reason="needs the extra video")
    made = render(scenario, short(plan, 2), tmp_path / "a.mp4", view="3d", size=SMALL)
    assert made.read_bytes()[4:8] == b"ftyp"


@pytest.fixture
def no_browser(monkeypatch, tmp_path):
    monkeypatch.delenv(BROWSER_VARIABLE, raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))


@pytest.mark.usefixtures("no_browser")
def test_without_a_browser_3d_says_what_to_install(scenario, plan, tmp_path):
    with pytest.raises(InputError, match="install chromium-headless-shell, chromium or google-chrome"):
        render(scenario, plan, tmp_path / "a.png", view="3d")
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("no_browser")
def test_without_a_browser_auto_draws_the_top_view_and_warns(scenario, plan, tmp_path):
    with pytest.warns(UserWarning, match="no Chromium found: drawing the top view instead of 3-D"):
        auto = render(scenario, plan, tmp_path / "a.png", size=SMALL)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        asked = render(scenario, plan, tmp_path / "b.png", size=SMALL, view="top")
        render(scenario, plan, tmp_path / "c.html")  # never needs one
    assert auto.read_bytes() == asked.read_bytes()


@pytest.mark.usefixtures("no_browser")
def test_the_command_says_what_it_fell_back_to(tmp_path, capsys):
    scene = str(SHIPPED / "overtake.yaml")
    assert main(["render", scene, "--out", str(tmp_path / "a.png"), "--size", "320x200"]) == 0
    assert "riskplan: note: no Chromium found: drawing the top view" in capsys.readouterr().err
    assert main(["render", scene, "--out", str(tmp_path / "b.png"), "--size", "320x200", "--view", "top"]) == 0
    assert capsys.readouterr().err == ""
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert main(["render", scene, "--out", str(tmp_path / "c.png"), "--view", "3d"]) == 2
    assert "needs Chromium" in capsys.readouterr().err


def test_results_of_planning_are_the_same_with_and_without_a_browser(scenario, plan, tmp_path, monkeypatch):
    def refuse(*_args, **_kwargs):
        raise AssertionError("no browser is looked for")

    monkeypatch.setattr("riskplan.doctor.find_browser", refuse)
    monkeypatch.setattr(browser, "find_browser", refuse)
    write_results(tmp_path / "out", scenario, plan, None)
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"plan.json", "scene.html", "scene.png"}


def test_a_browser_named_wrongly_is_named(scenario, plan, tmp_path, monkeypatch):
    monkeypatch.setenv(BROWSER_VARIABLE, "/nowhere/chromium")
    with pytest.raises(InputError, match="RISKPLAN_CHROMIUM: no program at '/nowhere/chromium'"):
        render(scenario, plan, tmp_path / "a.png", view="3d")


def fake_browser(monkeypatch, tmp_path, script):
    program = tmp_path / "fake"
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o755)
    monkeypatch.setenv(BROWSER_VARIABLE, str(program))


@pytest.mark.parametrize(
    ("script", "problem"),
    [
        ("echo oh dear >&2; exit 3", "failed with status 3: oh dear"),
        ("echo '<html></html>'", "drew 0 of 1 frames"),
        ("echo '<p id=\"error\">no\nWebGL</p>'", "could not draw the scene: no WebGL"),
        ("exit 0", "failed with status 0: no output"),
    ],
)
def test_a_browser_that_fails_is_an_error_of_one_line(scenario, plan, tmp_path, monkeypatch, script, problem):
    fake_browser(monkeypatch, tmp_path, script)
    with pytest.raises(InputError, match=problem):
        render(scenario, plan, tmp_path / "a.png", view="3d", size=SMALL)


def test_a_browser_that_hangs_is_ended_with_its_helpers(tmp_path, monkeypatch):
    sign = tmp_path / "alive"
    fake_browser(monkeypatch, tmp_path, f"(sleep 2; touch {sign}) & sleep 60")
    with pytest.raises(InputError, match=r"no answer within 0\.3 s"):
        browser.dump("<html></html>", timeout=0.3)
    threading.Event().wait(2.2)
    assert not sign.exists()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"view": "side"}, "view: expected one of auto, 3d, top; got 'side'"),
        ({"samples": -1}, "samples: expected an integer >= 0, got -1"),
        ({"density": 1.5}, "density: expected an integer >= 0, got 1.5"),
        ({"time": np.nan}, "time: expected a finite number"),
    ],
)
def test_bad_arguments_are_named(scenario, plan, tmp_path, wrong, message):
    with pytest.raises(InputError, match=message):
        render(scenario, plan, tmp_path / "a.png", **wrong)


def test_odd_sizes_and_missing_ffmpeg_are_named(scenario, plan, tmp_path, monkeypatch):
    with pytest.raises(InputError, match=r"size: expected even numbers for \.mp4, got \(301, 200\)"):
        render(scenario, plan, tmp_path / "a.mp4", size=(301, 200), view="top")
    monkeypatch.setitem(__import__("sys").modules, "imageio_ffmpeg", None)
    with pytest.raises(InputError, match=r"pip install 'riskplan\[video\]'"):
        render(scenario, plan, tmp_path / "a.mp4", view="top")


class Server:
    """Answers a `meshcat.Visualizer` as meshcat's server does, within this process: no port, no browser."""

    def __init__(self):
        import zmq
        from meshcat.visualizer import ViewerWindow

        self.commands = []
        self._socket = ViewerWindow.context.socket(zmq.REP)
        self._socket.bind("inproc://riskplan-test")
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self):
        import umsgpack

        while True:
            parts = self._socket.recv_multipart()
            if parts == [b"stop"]:
                self._socket.send(b"ok")
                self._socket.close(linger=0)
                return
            self.commands += [umsgpack.unpackb(parts[2])] if len(parts) == 3 else []
            self._socket.send(b"http://nowhere" if parts == [b"url"] else b"ok")


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning", "ignore:Unclosed socket")  # meshcat's
def test_a_live_visualiser_of_the_user_is_drawn_into(scenario, plan, capsys):
    import meshcat

    server = Server()
    vis = meshcat.Visualizer(zmq_url="inproc://riskplan-test")
    draw(vis, scenario, plan, samples=3, density=3)
    commands = list(server.commands)
    vis.window.zmq_socket.send(b"stop")
    vis.window.zmq_socket.recv()
    vis.window.zmq_socket.close(linger=0)
    capsys.readouterr()
    assert (commands[0]["type"], commands[0]["path"]) == ("delete", "/meshcat/riskplan") or commands[0][
        "path"
    ].endswith("riskplan")
    assert commands[-1]["type"] == "set_animation"
    drawn = {c["path"].removeprefix("/riskplan/") for c in commands if c["type"] == "set_object"}
    assert {"road", "plan/ribbon", "ego/body", "agents/1-truck/body", "samples/0/futures", "samples/2/dots"} <= drawn


def test_a_page_of_many_agents_stays_readable(scenario, plan, tmp_path):
    many = dataclasses.replace(scenario, agents=scenario.agents * 4)
    text = render(many, None, tmp_path / "many.html").read_text()
    assert text.count('"name":"truck"') == 4


def test_a_small_png_keeps_the_colours_of_the_scales():
    from riskplan.pictures.encode import png

    rng = np.random.default_rng(0)
    frame = np.full((80, 240, 4), 255, dtype=np.uint8)
    frame[:40, :, :3] = rng.integers(0, 256, (40, 240, 3))  # a crowd of colours that would like the palette
    frame[40:, :, :3] = (255 * palette.ramp(palette.RISK, np.linspace(0, 1, 240))).round()
    small = Image.open(io.BytesIO(png(frame, small=True)))
    assert small.mode == "P"
    got = np.asarray(small.convert("RGB"))[60].astype(int)
    assert np.abs(got - frame[60, :, :3]).max() <= 16
