"""The self-contained 3-D page: viewer, commands, legend, controls in one HTML file that fetches nothing."""

from __future__ import annotations

import base64
import html
import json
import re
from collections.abc import Sequence

from riskplan.pictures import palette
from riskplan.pictures.agent_view import AgentView, agent_node
from riskplan.pictures.camera import follow
from riskplan.pictures.picture import Picture, legend


def page(pic: Picture, script: str, commands: Sequence[bytes]) -> str:
    """HTML of a picture.

    Args:
        pic: for the legend and the readout.
        script: the viewer's JavaScript.
        commands: its messages, in order.
    """
    near, _ = follow(pic)
    data = {
        "commands": [base64.b64encode(command).decode("ascii") for command in commands],
        "times": pic.times.tolist(),
        "soFar": None if pic.so_far is None else [palette.claimed(pic.claim, risk) for risk in pic.so_far.tolist()],
        "here": [palette.number(risk) for risk in pic.path_risk.tolist()] if len(pic.path) > 1 else None,
        "step": "this step" if pic.per_step.startswith("risk") else "first hit now",
        "near": near.distance,
        "lead": near.target.tolist(),
        "agents": [_agent_entry(i, agent) for i, agent in enumerate(pic.agents)],
        "parts": [[label, node] for label, node, there in _parts(pic) if there],
    }
    parts = {
        "@TITLE@": html.escape(pic.title),
        "@GROUND@": palette.GROUND,
        "@INK@": palette.INK,
        "@FAINT@": palette.FAINT_INK,
        "@FACTS@": "".join(f"<dt>{html.escape(k)}</dt><dd>{html.escape(v)}</dd>" for k, v in pic.facts),
        "@BARS@": "".join(_bar(*bar) for bar in legend(pic)) + "".join(f"<p>{html.escape(n)}</p>" for n in pic.notes),
        # "</script" inside a string would end the element; JSON and JavaScript both allow the escapes
        "@VIEWER@": script.replace("</script", "<\\/script"),
        "@DATA@": json.dumps(data, separators=(",", ":")).replace("<", "\\u003c"),
    }
    # one pass, so that a name that looks like a placeholder stays a name
    return re.sub("@[A-Z]+@", lambda match: parts[match.group()], _TEMPLATE)


def _parts(pic: Picture) -> list[tuple[str, str, bool]]:
    """(label, node below /riskplan, whether there is one) of what can be shown and hidden as a whole."""
    sampled = any(agent.futures.size or agent.dots.size for agent in pic.agents)
    return [
        ("agents", "agents", bool(pic.agents)),
        ("modes", "modes", bool(pic.agents)),
        ("samples", "samples", sampled),
        ("search", "tree", len(pic.tree) > 0),
        ("ellipsoid", "ego/shape", bool(pic.ego_rings)),
        ("plan", "plan", len(pic.path) > 1),
        ("goal", "goal", bool(pic.goals)),
    ]


def _agent_entry(i: int, agent: AgentView) -> dict[str, object]:
    weights = agent.weights[0].tolist()
    return {
        "name": agent.name or f"agent {i}",
        "colour": agent.colour,
        "node": agent_node(i, agent.name),
        "modes": [[f"{weight:.2g}", f"modes/{i}/{mode}"] for mode, weight in enumerate(weights)],
        "samples": f"samples/{i}",
    }


def _bar(label: str, ramp: palette.Ramp, low: str, high: str) -> str:
    return (
        f'<div class="bar"><span>{html.escape(label)}</span><div><i style="background:linear-gradient(90deg,'
        f'{",".join(ramp)})"></i><small>{html.escape(low)}<b>{html.escape(high)}</b></small></div></div>'
    )


_TEMPLATE = r"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy"
 content="default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:">
<meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="icon" href="data:,">
<title>@TITLE@</title>
<style>
body { margin: 0; overflow: hidden; background: @GROUND@; color: @INK@;
  font: 15px/1.35 system-ui, "DejaVu Sans", sans-serif; }
#view { width: 100vw; height: 100vh; overflow: hidden; }
#legend { position: absolute; left: 20px; top: 20px; padding: 14px 18px; width: 380px; pointer-events: none; }
#legend h1 { margin: 0 0 8px; font-size: 19px; font-weight: 600; overflow-wrap: anywhere; }
#legend dl { display: grid; grid-template-columns: 142px 1fr; margin: 0 0 10px; gap: 1px 8px; }
#legend dt { color: @FAINT@; } #legend dd { margin: 0; overflow-wrap: anywhere; }
#legend p { margin: 8px 0 0; color: @FAINT@; font-size: 13px; }
.bar { display: grid; grid-template-columns: 142px 1fr; gap: 8px; margin-top: 7px; align-items: start;
  line-height: 1.2; }
.bar i { display: block; height: 11px; margin-top: 3px; } .bar small { color: @FAINT@; display: block; }
.bar small b { float: right; font-weight: 400; }
#play { position: absolute; left: 20px; bottom: 16px; display: flex; gap: 14px; padding: 7px 16px 7px 8px;
  align-items: center; max-width: calc(100vw - 64px); }
#play, #legend { border-radius: 10px; background: rgba(255,255,255,.95);
  box-shadow: 0 1px 6px rgba(20,30,40,.28); }
.dg.main { opacity: .55; }
#show { position: absolute; right: 20px; bottom: 16px; padding: 10px 16px; border-radius: 10px; max-width: 300px;
  max-height: calc(100vh - 90px); overflow: auto; background: rgba(255,255,255,.95);
  box-shadow: 0 1px 6px rgba(20,30,40,.28); font-size: 14px; }
#show summary { cursor: pointer; font-weight: 600; } #show label { display: inline-block; margin-right: 12px; }
#show .agent { display: flex; flex-wrap: wrap; gap: 0 4px; padding: 4px 0; border-top: 1px solid @GROUND@; }
#show .agent > label:first-child { flex: 1 0 100%; overflow-wrap: anywhere; }
#show .agent b { display: inline-block; width: 11px; height: 11px; border-radius: 3px; margin-right: 5px; }
#show .agent > label:not(:first-child) { color: @FAINT@; margin-left: 20px; margin-right: 0; }
#failed { display: none; position: absolute; left: 50%; top: 50%; transform: translate(-50%, -50%); max-width: 34em;
  padding: 18px 24px; border-radius: 10px; background: #fff; border: 2px solid #dc2a36; }
#play button { width: 40px; height: 34px; border: 0; border-radius: 8px; background: @GROUND@;
  font-size: 15px; cursor: pointer; }
#play input[type=range] { width: 260px; }
#play output { min-width: 21em; font-size: 17px; font-variant-numeric: tabular-nums; white-space: pre; }
</style>
</head>
<body>
<div id="view"></div>
<div id="legend"><h1>@TITLE@</h1><dl>@FACTS@</dl>@BARS@</div>
<div id="play"><button id="toggle" title="play or pause">&#10074;&#10074;</button>
<input id="time" type="range" min="0" max="1" step="any" value="0" aria-label="time">
<output id="now"></output>
<label title="the camera goes with the ego"><input id="follow" type="checkbox"> follow</label></div>
<details id="show" open><summary>show</summary><div id="parts"></div></details>
<div id="failed" role="alert"></div>
<script>
"use strict";
function failed(why) {
  const box = document.getElementById("failed");
  if (box.textContent) return;  // what came first is the reason of the rest
  box.textContent = why;
  box.style.display = "block";
  for (const id of ["play", "show"]) document.getElementById(id).style.display = "none";
}
window.addEventListener("error", event => failed("The scene cannot be drawn: " + event.message));
const probe = document.createElement("canvas");
if (!(probe.getContext("webgl2") || probe.getContext("webgl")))
  failed("This browser offers no WebGL, which the 3-D view needs: turn on hardware acceleration, or use another " +
         "browser. `riskplan render … --view top` draws a top view (.png, .gif, .mp4) instead.");
else if (window.innerWidth < 900) document.getElementById("show").open = false;
</script>
<script>@VIEWER@</script>
<script>
"use strict";
const data = @DATA@;
const viewer = new MeshCat.Viewer(document.getElementById("view"));
for (const text of data.commands) {
  const raw = atob(text), bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  viewer.handle_command_bytearray(bytes);
}
viewer.controls.maxPolarAngle = 0.49 * Math.PI;
const player = viewer.animator, end = data.times[data.times.length - 1];
const [toggle, time, follow, now, parts] =
  ["toggle", "time", "follow", "now", "parts"].map(id => document.getElementById(id));

// `find` would make what it does not find
function node(path) {
  let at = viewer.scene_tree.children.riskplan;
  for (const name of path.split("/")) at = at && at.children[name];
  return at;
}
function box(into, label, paths, colour) {
  const row = document.createElement("label"), check = document.createElement("input");
  check.type = "checkbox";
  check.checked = true;
  check.dataset.node = paths[0];
  check.onchange = () => {
    for (const path of paths) if (node(path)) node(path).set_property("visible", check.checked);
    viewer.set_dirty();
  };
  row.append(check);
  if (colour) row.append(Object.assign(document.createElement("b"), {style: "background:" + colour}));
  row.append(label);
  into.append(row);
}
for (const [label, path] of data.parts) box(parts, label, [path]);
for (const agent of data.agents) {
  const row = document.createElement("div");
  row.className = "agent";
  box(row, agent.name, [agent.node, agent.samples, ...agent.modes.map(m => m[1])], agent.colour);
  for (const [weight, path] of agent.modes) box(row, weight, [path]);
  document.getElementById("show").append(row);
}
if (data.agents.length > 8) document.getElementById("show").open = false;

const root = viewer.scene_tree.children.riskplan.object;
const home = root.position.clone(), ego = node("ego").object, far = viewer.camera.position.length();
time.max = end;
toggle.onclick = () => player.playing ? player.pause() : player.play();
time.oninput = () => { player.pause(); player.seek(+time.value); player.display_progress(+time.value); };
follow.onchange = () => {
  viewer.camera.position.setLength(follow.checked ? data.near : far);
  if (!follow.checked) root.position.copy(home);
  viewer.set_dirty();
};
function show() {
  const t = Math.min(player.time, end);
  let k = data.times.length - 1;
  while (k > 0 && data.times[k] > t + 1e-6) k--;
  const here = data.here ? "   " + data.step + " " + data.here[k] : "";
  now.textContent = "t = " + t.toFixed(1) + " s" + here + (data.soFar ? "   so far " + data.soFar[k] : "");
  toggle.textContent = player.playing ? "\u275A\u275A" : "\u25B6";
  time.value = t;
  if (follow.checked) {
    root.position.set(-ego.position.x - data.lead[0], -ego.position.y - data.lead[1], 0);
    viewer.set_dirty();
  }
}
(function loop() { requestAnimationFrame(loop); show(); })();
</script>
</body>
</html>
"""
