"""Run the demos and keep their pictures, small, in docs/gallery: `python demos/gallery.py [NAME …]`."""

import runpy
import sys
from pathlib import Path

import numpy as np
from PIL import Image

from riskplan.pictures.encode import png

HERE, MADE, KEPT = Path(__file__).parent, Path("out/demos"), Path("docs/gallery")
PICTURES = {
    "overtake": ["overtake.png", "overtake-top.png", "overtake-map.png", "overtake-risk.png"],
    "left_turn": ["left-turn.png"],
    "crowd": ["crowd.png"],
    "backends": ["backends.png"],
    "controls": ["controls.png"],
    "requery": ["requery.png"],
    "closed_loop": ["closed-loop.png"],
}
WIDTHS, MOST_BYTES = (960, 840, 720), 150_000


def keep(source: Path, target: Path) -> None:
    """A picture of 256 colours, as wide as fits."""
    image = Image.open(source).convert("RGBA")
    for width in WIDTHS:
        size = (width, round(image.height * width / image.width))
        small = np.array(image.resize(size, Image.Resampling.LANCZOS), dtype=np.uint8)
        target.write_bytes(png(small, small=True))
        if target.stat().st_size <= MOST_BYTES:
            break
    print(f"{target}: {target.stat().st_size / 1000:.0f} kB, {width} wide")


def main(names: list[str]) -> None:
    """Each demo in this process, one after the other."""
    KEPT.mkdir(parents=True, exist_ok=True)
    for name in names or PICTURES:
        if not (HERE / f"{name}.py").exists():
            continue
        runpy.run_path(str(HERE / f"{name}.py"), run_name="__main__")
        for picture in PICTURES[name]:
            keep(MADE / picture, KEPT / picture)


if __name__ == "__main__":
    main(sys.argv[1:])
