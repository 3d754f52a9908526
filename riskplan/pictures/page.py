"""The self-contained 3-D page: viewer, commands, legend, controls in one HTML file that fetches nothing."""

from __future__ import annotations

import base64
import html
import json
import re
from collections.abc import Sequence

from riskplan.pictures import palette
from riskplan.pictures.picture import SIGMAS, Picture


def page(pic: Picture, script: str, commands: Sequence[bytes]) -> str:
    """HTML of a picture.

    Args:
        pic: for the legend and the readout.
        script: the viewer's JavaScript.
        commands: its messages, in order.
    """
    data = {
        "commands": [base64.b64encode(command).decode("ascii") for command in commands],
        "times": pic.times.tolist(),
        "soFar": None if pic.so_far is None else [palette.number(risk) for risk in pic.so_far.tolist()],
    }
    parts = {
        "@TITLE@": html.escape(pic.title),
        "@GROUND@": palette.GROUND,
        "@INK@": palette.INK,
        "@FAINT@": palette.FAINT_INK,
        "@FACTS@": "".join(f"<dt>{html.escape(k)}</dt><dd>{html.escape(v)}</dd>" for k, v in pic.facts),
        "@BARS@": "".join(_bar(*bar) for bar in legend(pic)),
        # "</script" inside a string would end the element; JSON and JavaScript both allow the escapes
        "@VIEWER@": script.replace("</script", "<\\/script"),
        "@DATA@": json.dumps(data, separators=(",", ":")).replace("<", "\\u003c"),
    }
    # one pass, so that a name that looks like a placeholder stays a name
    return re.sub("@[A-Z]+@", lambda match: parts[match.group()], _TEMPLATE)


def legend(pic: Picture) -> list[tuple[str, palette.Ramp, str, str]]:
    """(label, ramp, low end, high end) of the colour scales that the picture uses."""
    risk, weight, time = pic.limits
    bars = []
    if len(pic.path):
        bars.append(("risk per step", palette.RISK, "0", palette.number(risk)))
    if pic.agents:
        bars.append((f"mode weight ({SIGMAS:g}σ)", palette.WEIGHT, "0", f"{weight:g}"))
    if len(pic.tree):
        bars.append(("search", palette.TIME, "0 s", f"{time:.3g} s"))
    return bars


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
.bar { display: grid; grid-template-columns: 142px 1fr; gap: 8px; margin-top: 7px; align-items: start;
  line-height: 1.2; }
.bar i { display: block; height: 11px; margin-top: 3px; } .bar small { color: @FAINT@; display: block; }
.bar small b { float: right; font-weight: 400; }
#play { position: absolute; left: 20px; bottom: 16px; display: flex; gap: 14px; padding: 7px 16px 7px 8px;
  align-items: center; max-width: calc(100vw - 64px); }
#play, #legend { border-radius: 10px; background: rgba(255,255,255,.95);
  box-shadow: 0 1px 6px rgba(20,30,40,.28); }
.dg.main { opacity: .55; }
#play button { width: 40px; height: 34px; border: 0; border-radius: 8px; background: @GROUND@;
  font-size: 15px; cursor: pointer; }
#play input[type=range] { width: 300px; }
#play output { min-width: 15em; font-size: 17px; font-variant-numeric: tabular-nums; white-space: pre; }
</style>
</head>
<body>
<div id="view"></div>
<div id="legend"><h1>@TITLE@</h1><dl>@FACTS@</dl>@BARS@</div>
<div id="play"><button id="toggle" title="play or pause">&#10074;&#10074;</button>
<input id="time" type="range" min="0" max="1" step="any" value="0" aria-label="time">
<output id="now"></output><label><input id="follow" type="checkbox"> follow</label></div>
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
const [toggle, time, follow, now] =
  ["toggle", "time", "follow", "now"].map(id => document.getElementById(id));
const root = viewer.scene_tree.find(["riskplan"]).object, home = root.position.clone();
const ego = viewer.scene_tree.find(["riskplan", "ego"]).object;
time.max = end;
toggle.onclick = () => player.playing ? player.pause() : player.play();
time.oninput = () => { player.pause(); player.seek(+time.value); player.display_progress(+time.value); };
follow.onchange = () => { if (!follow.checked) root.position.copy(home); viewer.set_dirty(); };
function show() {
  const t = Math.min(player.time, end);
  let k = data.times.length - 1;
  while (k > 0 && data.times[k] > t + 1e-6) k--;
  now.textContent = "t = " + t.toFixed(1) + " s" + (data.soFar ? "   risk so far " + data.soFar[k] : "");
  toggle.textContent = player.playing ? "\u275A\u275A" : "\u25B6";
  time.value = t;
  if (follow.checked) { root.position.copy(ego.position).negate(); viewer.set_dirty(); }
}
(function loop() { requestAnimationFrame(loop); show(); })();
</script>
</body>
</html>
"""
