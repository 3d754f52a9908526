"""3-D stills and films: a page that renders the frames it is told to, in one run of a headless browser."""

from __future__ import annotations

import base64
import io
import json
import re
from collections.abc import Sequence

import numpy as np
from PIL import Image

from checkers import InputError
from checkers.validate import Array
from riskplan.pictures import browser, overlay, scene3d
from riskplan.pictures.camera import Camera, follow
from riskplan.pictures.encode import Pixels, frame_steps
from riskplan.pictures.picture import Picture

STILL, MOVING = (1280, 640), (960, 480)


def still(pic: Picture, size: tuple[int, int] | None = None, step: int = 0) -> Pixels:
    """(H, W, 4) at `Picture.times[step]`."""
    size = size or STILL
    camera = overlay.view(pic, size)
    return _lettered(_shots(pic, size, camera, [step], -camera.target[None], samples=4), pic, size, camera, [step])[0]


def moving(pic: Picture, size: tuple[int, int] | None = None, *, following: bool = True) -> tuple[list[Pixels], Array]:
    """Frames (H, W, 4) and their times, in at most 60 steps; the camera goes with the ego or stays."""
    size = size or MOVING
    steps = frame_steps(pic.times)
    if following and np.ptp(pic.ego[:, :2], axis=0).max() > 1.0:
        camera, targets = follow(pic)
        places = -targets[steps]
    else:
        camera = overlay.view(pic, size)
        places = np.tile(-camera.target, (len(steps), 1))
    images = _shots(pic, size, camera, steps.tolist(), places)
    return _lettered(images, pic, size, camera, steps.tolist()), pic.times[steps]


def _lettered(
    images: Sequence[Image.Image], pic: Picture, size: tuple[int, int], camera: Camera, steps: Sequence[int]
) -> list[Pixels]:
    card = overlay.card(pic, size, camera)
    frames = []
    for image, step in zip(images, steps, strict=True):
        image.paste(card, mask=card)
        overlay.readout(image, pic, step)
        frames.append(np.array(image.convert("RGBA"), dtype=np.uint8))
    return frames


def _shots(
    pic: Picture, size: tuple[int, int], camera: Camera, steps: Sequence[int], places: Array, *, samples: int = 1
) -> list[Image.Image]:
    """RGB images at the steps, the scene moved to `places` (N, 3); `samples` of each pixel on top of its quarters."""
    data = {
        "commands": [base64.b64encode(message).decode("ascii") for message in scene3d.messages(pic, camera)],
        "size": list(size),
        "samples": samples,
        "frames": [[float(pic.times[step]), *place] for step, place in zip(steps, places.tolist(), strict=True)],
    }
    page = re.sub(
        "@[A-Z]+@",
        lambda match: {
            "@VIEWER@": scene3d.viewer_script().replace("</script", "<\\/script"),
            "@DATA@": json.dumps(data, separators=(",", ":")).replace("<", "\\u003c"),
        }[match.group()],
        _TEMPLATE,
    )
    document = browser.dump(page, timeout=60.0 + 5.0 * len(steps))
    problem = re.search(r'<p id="error">(.*?)</p>', document, re.DOTALL)
    if problem:
        raise InputError(f"the browser could not draw the scene: {' '.join(problem.group(1).split())}")
    found = re.findall(r'<p class="frame">data:image/png;base64,([A-Za-z0-9+/=]+)</p>', document)
    if len(found) != len(steps):  # neither ready nor an error
        raise InputError(f"the browser drew {len(found)} of {len(steps)} frames")
    return [Image.open(io.BytesIO(base64.b64decode(text))).convert("RGB") for text in found]


# Twice as fine and then halved smooths edges; a still can pay for samples within each quarter of a pixel, too. Halving
# on the renderer's side leaves a quarter of the pixels to be read back and packed, and frames in the head of the page
# are never laid out as text: together that is more than half of a film's time.
# Everything happens while the page loads, so that it is there when `--dump-dom` prints it; the viewer's own render loop
# and its later resizing, which would clear the canvas, come too late to matter.
_TEMPLATE = r"""<!DOCTYPE html>
<html><head><meta charset="utf-8"><link rel="icon" href="data:,"></head>
<body><div><div id="view"></div></div>
<script>
"use strict";
function put(text, key, value) {
  const p = document.createElement("p");
  p.setAttribute(key, value);
  p.textContent = text;
  document.head.appendChild(p);
}
window.onerror = message => put(message, "id", "error");
</script>
<script>@VIEWER@</script>
<script>
"use strict";
const data = @DATA@, [width, height] = data.size, THREE = MeshCat.THREE;
const renderer = new THREE.WebGLRenderer({antialias: false, alpha: true});
const viewer = new MeshCat.Viewer(document.getElementById("view"), false, renderer);
for (const text of data.commands) {
  const raw = atob(text), bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  viewer.handle_command_bytearray(bytes);
}
renderer.setPixelRatio(1);
viewer.set_3d_pane_size(width, height);
viewer.animator.pause();
const root = viewer.scene_tree.find(["riskplan"]).object, gl = renderer.getContext();
const Fine = data.samples > 1 ? THREE.WebGLMultisampleRenderTarget : THREE.WebGLRenderTarget;
const fine = new Fine(2 * width, 2 * height);
if (data.samples > 1) fine.samples = data.samples;
for (const [time, ...place] of data.frames) {
  viewer.animator.seek(time);
  root.position.set(...place);
  renderer.setRenderTarget(fine);
  viewer.render();
  renderer.setRenderTarget(null);
  gl.bindFramebuffer(gl.READ_FRAMEBUFFER, renderer.properties.get(fine).__webglFramebuffer);
  gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, null);
  gl.blitFramebuffer(0, 0, 2 * width, 2 * height, 0, 0, width, height, gl.COLOR_BUFFER_BIT, gl.LINEAR);
  gl.bindFramebuffer(gl.READ_FRAMEBUFFER, null);
  put(renderer.domElement.toDataURL("image/png"), "class", "frame");
}
for (const script of document.querySelectorAll("script")) script.remove();  // a megabyte less to print
</script>
</body></html>
"""
