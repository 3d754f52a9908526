"""Frames to bytes: PNG, GIF with one palette, MP4. The same frames give the same bytes."""

from __future__ import annotations

import io
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial import cKDTree

from checkers import InputError
from checkers.validate import Array
from riskplan.pictures import palette

Pixels = NDArray[np.uint8]

MOST_FRAMES = 60


def frame_steps(times: Array) -> NDArray[np.int64]:
    """The steps of an animation that a film shows: at most 60, evenly picked."""
    last = len(times) - 1
    return np.linspace(0, last, min(last + 1, MOST_FRAMES)).round().astype(np.int64)


def png(frame: Pixels, *, small: bool = False) -> bytes:
    """One frame (H, W, 4); `small`: of 256 colours, the scales' among them, a third of the size."""
    out = io.BytesIO()
    image = _paletted([frame])[0] if small else Image.fromarray(frame).convert("RGB")
    image.save(out, "PNG", optimize=small)
    return out.getvalue()


def gif(frames: Sequence[Pixels], times: Array) -> bytes:
    """Frames (H, W, 4), shown at `times` [s], in real time and for ever; the last one rests for a second."""
    paletted = _paletted(frames)
    gaps = np.append(np.diff(times), 1.0)
    out = io.BytesIO()
    paletted[0].save(
        out,
        "GIF",
        save_all=True,
        append_images=paletted[1:],
        duration=[max(20, round(100 * float(gap)) * 10) for gap in gaps],
        loop=0,
    )
    return out.getvalue()


def mp4(frames: Sequence[Pixels], times: Array) -> bytes:
    """H.264 of frames (H, W, 4) with even sizes, in real time.

    Raises:
        InputError: without the extra `video`, or if ffmpeg fails.
    """
    program = need_video()
    span = float(times[-1] - times[0])
    rate = (len(frames) - 1) / span if span > 0 else 10.0
    height, width = frames[0].shape[:2]
    command = [program, "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}"]
    command += ["-r", f"{rate:.6f}", "-i", "-", "-an", "-vcodec", "libx264", "-pix_fmt", "yuv420p", "-crf", "18"]
    command += ["-preset", "medium", "-threads", "1", "-fflags", "+bitexact", "-flags:v", "+bitexact"]
    command += ["-map_metadata", "-1", "-movflags", "+faststart", "-y"]
    raw = b"".join(np.ascontiguousarray(frame[..., :3]).tobytes() for frame in frames)
    with tempfile.TemporaryDirectory(prefix="riskplan-") as folder:
        target = Path(folder) / "film.mp4"
        run = subprocess.run([*command, str(target)], input=raw, capture_output=True, check=False)
        if run.returncode:
            raise InputError(f"ffmpeg failed: {run.stderr.decode(errors='replace').strip()[-300:]}")
        return target.read_bytes()


def need_video() -> str:
    """Path of the ffmpeg that comes with the extra `video`.

    Raises:
        InputError: without it.
    """
    try:
        import imageio_ffmpeg  # noqa: PLC0415
    except ImportError:
        raise InputError(".mp4: needs ffmpeg: pip install 'riskplan[video]'") from None
    return str(imageio_ffmpeg.get_ffmpeg_exe())


def _paletted(frames: Sequence[Pixels]) -> list[Image.Image]:
    """Frames (H, W, 4) with one common palette: every colour becomes its nearest.

    A palette of a frame's own would blur the ramps, dithering would flicker, and Pillow's search for the
    nearest colour is not exact: flat areas would come out in two shades.
    """
    colours = _common_palette(frames)
    nearest = cKDTree(colours)
    table = np.full(1 << 24, -1, dtype=np.int16)
    codes = [frame.view("<u4")[..., 0] & 0xFFFFFF for frame in frames]
    index = np.zeros(codes[0].shape, dtype=np.uint8)
    images = []
    for i, code in enumerate(codes):
        moved = code != codes[i - 1] if i else np.ones_like(code, dtype=bool)
        wanted = code[moved]
        new = np.unique(wanted[table[wanted] < 0])
        if len(new):
            table[new] = nearest.query(np.column_stack([new & 255, new >> 8 & 255, new >> 16]))[1]
        index[moved] = table[wanted]
        images.append(Image.fromarray(index.copy()))
        images[-1].putpalette(colours.ravel().tolist())
    return images


def _common_palette(frames: Sequence[Pixels]) -> NDArray[np.int64]:
    """(256, 3): the colours of areas and ramps, then what frames from all over the film mix from them."""
    plain = (palette.GROUND, palette.ASPHALT, palette.LINE, palette.INK, palette.GLASS, palette.EGO)
    areas = [palette.rgb(colour)[None] for colour in (*plain, *palette.AGENTS)]
    scales = (palette.RISK, palette.WEIGHT, palette.TIME)
    ramps = [palette.ramp(scale, np.linspace(0, 1, 24)) for scale in scales]
    fixed = (np.concatenate(areas + ramps) * 255).round().astype(int)
    some = np.concatenate([frames[i][..., :3] for i in sorted({0, len(frames) // 2, len(frames) - 1})])
    mixed = Image.fromarray(some).quantize(256 - len(fixed), Image.Quantize.MEDIANCUT).getpalette() or []
    return np.concatenate([fixed, np.reshape(mixed, (-1, 3)).astype(int)])[:256]
