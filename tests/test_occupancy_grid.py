"""ROS maps: every format, orientation and threshold against a reading by hand; broken and hostile files."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image
from scenes import overtake

import riskplan as rp

YAML = """image: map.pgm
resolution: 0.5
origin: [1.0, 2.0, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""
# black is occupied, white free, grey unknown; the image's first row is the upper edge
PIXELS = np.array([[0, 254, 254], [205, 254, 254]], dtype=np.uint8)


def write(folder, pixels=PIXELS, text=YAML, name="map.pgm"):
    Image.fromarray(np.asarray(pixels)).save(folder / name)
    (folder / "map.yaml").write_text(text)
    return folder / "map.yaml"


def union(grid, within=None):
    area = shapely.union_all([shapely.Polygon(p) for p in grid.obstacles])
    return area if within is None else area.intersection(within).buffer(0)


def test_cells_lie_where_ros_puts_them(tmp_path):
    grid = rp.load_occupancy_grid(write(tmp_path))
    # (0, 0) is the lower left pixel, its lower left corner at the origin
    np.testing.assert_array_equal(grid.blocked, [[True, False, False], [True, False, False]])
    area = union(grid, shapely.Polygon(grid.outline))
    assert area.equals(shapely.box(1.0, 2.0, 1.5, 3.0))
    free = rp.load_occupancy_grid(tmp_path / "map.yaml", unknown="free")
    assert union(free).equals(shapely.box(1.0, 2.5, 1.5, 3.0))


def test_outside_is_blocked_unless_unknown_is_free(tmp_path):
    grid = rp.load_occupancy_grid(write(tmp_path))
    assert union(grid).contains(shapely.Point(0.9, 2.2)) and union(grid).contains(shapely.Point(2.0, 3.1))
    assert not union(grid).contains(shapely.Point(2.0, 2.5))


def test_a_turned_map(tmp_path):
    grid = rp.load_occupancy_grid(write(tmp_path, text=YAML.replace("2.0, 0.0]", "2.0, 1.5707963267948966]")))
    area = union(grid, shapely.Polygon(grid.outline))
    assert area.symmetric_difference(shapely.box(0.0, 2.0, 1.0, 2.5)).area < 1e-9


VARIANTS = {
    "png": (PIXELS, "map.png", {}),
    "negated": (255 - PIXELS, "map.pgm", {"negate: 0": "negate: 1"}),
    "truth values": (255 - PIXELS, "map.pgm", {"negate: 0": "negate: true"}),
    "colour": (np.repeat(PIXELS[..., None], 3, axis=-1), "map.png", {}),
    "16 bit": (PIXELS.astype(np.uint16) * 257, "map.png", {}),
    "trinary": (PIXELS, "map.pgm", {"negate": "mode: trinary\nnegate"}),
    "scale": (PIXELS, "map.pgm", {"negate": "mode: scale\nnegate"}),
}


@pytest.mark.parametrize("case", VARIANTS)
def test_formats_say_the_same(tmp_path, case):
    pixels, name, changes = VARIANTS[case]
    text = YAML.replace("map.pgm", name)
    for old, new in changes.items():
        text = text.replace(old, new)
    grid = rp.load_occupancy_grid(write(tmp_path, pixels, text, name), unknown="free")
    np.testing.assert_array_equal(grid.blocked, [[False, False, False], [True, False, False]])


def test_transparent_pixels_are_unknown_in_mode_scale(tmp_path):
    black = np.zeros((1, 2, 4), dtype=np.uint8)
    black[0, 0, 3] = 255
    white = black.copy()
    white[..., :3] = 255
    for mode, pixels, unknown, expected in [
        ("scale", black, "free", [[True, False]]),
        ("trinary", black, "free", [[True, True]]),
        ("scale", white, "occupied", [[False, True]]),
        ("trinary", white, "occupied", [[False, False]]),
    ]:
        text = YAML.replace("map.pgm", "m.png") + f"mode: {mode}\n"
        grid = rp.load_occupancy_grid(write(tmp_path, pixels, text, "m.png"), unknown)
        np.testing.assert_array_equal(grid.blocked, expected)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    hnp.arrays(bool, st.tuples(st.integers(1, 12), st.integers(1, 12))),
    st.floats(-3, 3),
    st.booleans(),
)
def test_rectangles_cover_the_blocked_cells_and_nothing_else(blocked, yaw, closed):
    grid = rp.OccupancyGrid(blocked, 0.3, (5.0, -7.0, yaw), closed)
    area = union(grid, shapely.Polygon(grid.outline))
    assert area.area == pytest.approx(0.09 * blocked.sum(), abs=1e-9)
    c, s = np.cos(yaw), np.sin(yaw)
    rows, columns = np.indices(blocked.shape)
    middles = 0.3 * np.stack([columns + 0.5, rows + 0.5], axis=-1) @ [[c, s], [-s, c]] + [5.0, -7.0]
    np.testing.assert_array_equal(shapely.contains_xy(area, middles[..., 0], middles[..., 1]), blocked)


def test_the_world_sees_the_map(tmp_path):
    rng = np.random.default_rng(0)
    pixels = np.full((60, 80), 254, dtype=np.uint8)
    pixels[rng.random((60, 80)) < 0.02] = 0
    pixels[25:35, 5:25] = 254
    path = write(tmp_path, pixels, YAML.replace("0.5", "0.25").replace("[1.0, 2.0, 0.0]", "[0, 0, 0]"))
    scene = tmp_path / "s.yaml"
    scene.write_text(
        "version: 1\nbounds: [0, 0, 20, 15]\nhorizon: 1\nstart: {x: 3, y: 7.5, heading: 0}\n"
        "goal: {regions: [{circle: {x: 4, y: 7.5, radius: 1}}]}\n"
        "vehicle: {type: point, radius: 0.2}\nobstacles: {map: map.yaml}\n"
    )
    s = rp.load_scenario(scene)
    area = union(rp.load_occupancy_grid(path))
    shapely.prepare(area)
    for x, y in rng.uniform([0, 0], [20, 15], (2000, 2)):
        gap = area.distance(shapely.Point(x, y))
        if abs(gap - 0.2) > 1e-6:
            assert s.world.free(x, y, 0.0) == (gap > 0.2)
    assert rp.plan(s, bound=0.1, time_limit=10.0).solved
    # written as polygons, it reads back the same
    rp.save_scenario(s, tmp_path / "t.yaml")
    again = rp.load_scenario(tmp_path / "t.yaml")
    assert all(np.array_equal(a, b) for a, b in zip(again.obstacles, s.obstacles, strict=True))


def test_a_large_map_becomes_few_rectangles_and_a_world(tmp_path):
    # a building of 1000 x 1000 cells: walls, doors, unknown surroundings, and speckle
    rng = np.random.default_rng(1)
    pixels = np.full((1000, 1000), 205, dtype=np.uint8)
    pixels[100:900, 100:900] = 254
    pixels[100:900:100, 100:900] = 0
    pixels[100:900, 100:900:100] = 0
    for i in range(100, 900, 100):
        pixels[i - 3 : i + 3, 130:880:100] = 254
    pixels[rng.integers(100, 900, 3000), rng.integers(100, 900, 3000)] = 0
    grid = rp.load_occupancy_grid(write(tmp_path, pixels, YAML.replace("0.5", "0.05")))
    assert len(grid.obstacles) < 6000
    assert sum(shapely.Polygon(p).area for p in grid.obstacles[:-4]) == pytest.approx(0.05**2 * grid.blocked.sum())
    scene = rp.Scenario(
        start=rp.State(8.5, 9.5, 0.0),
        goal=rp.Goal.at(9, 9),
        bounds=(1, 2, 51, 52),
        horizon=1.0,
        obstacles=grid.obstacles,
        vehicle=rp.PointRobot(radius=0.1),
    )
    free = np.array([scene.world.free(x, y, 0.0) for x, y in rng.uniform([1, 2], [51, 52], (500, 2))])
    assert 0.2 < free.mean() < 0.8


BAD = {
    "missing key": (YAML.replace("negate: 0\n", ""), "negate: missing; expected keys image, resolution, origin"),
    "unknown key": (YAML + "colour: 1\n", "colour: unknown key; expected one of image"),
    "no mapping": ("[1]", "the document: expected a mapping, got [1]"),
    "resolution": (YAML.replace("0.5", "-0.5"), "resolution: expected"),
    "text": (YAML.replace("0.65", "high"), "occupied_thresh: expected a number, got 'high'"),
    "origin": (YAML.replace("[1.0, 2.0, 0.0]", "[1.0, 2.0]"), "origin: expected shape (3,), got (2,)"),
    "origin text": (YAML.replace("[1.0, 2.0, 0.0]", "home"), "origin: expected [x, y, yaw], got 'home'"),
    "thresholds": (YAML.replace("0.196", "0.8"), "free_thresh: expected at most occupied_thresh 0.65, got 0.8"),
    "negate": (YAML.replace("negate: 0", "negate: 2"), "negate: expected 0 or 1, got 2"),
    "mode": (YAML + "mode: raw\n", "mode: expected one of trinary, scale"),
    "absolute": (YAML.replace("map.pgm", "/etc/passwd.pgm"), "image: expected a .pgm or .png in the map's directory"),
    "outside": (YAML.replace("map.pgm", "../map.pgm"), "image: expected a .pgm or .png in the map's directory"),
    "suffix": (YAML.replace("map.pgm", "map.tiff"), "image: expected a .pgm or .png"),
    "no image": (YAML.replace("map.pgm", "other.pgm"), "other.pgm: no such file"),
    "broken": (YAML.replace("map.pgm", "broken.png"), "image: broken.png is no readable .pgm or .png"),
    "disguised": (YAML.replace("map.pgm", "gif.png"), "image: gif.png is no readable .pgm or .png"),
    "large": (YAML.replace("map.pgm", "large.pgm"), "image: expected at most 16000000 cells, got 5000 x 4000"),
    "huge": (YAML.replace("map.pgm", "huge.pgm"), "image: expected at most 16000000 cells, got more in huge.pgm"),
    "cut": (YAML.replace("map.pgm", "cut.pgm"), "image: cut.pgm is no readable .pgm or .png"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_is_wrong_is_named_in_one_line(tmp_path, case):
    text, message = BAD[case]
    path = write(tmp_path, text=text)
    (tmp_path / "broken.png").write_bytes(b"\x89PNG\r\n\x1a\nnothing")
    Image.fromarray(PIXELS).save(tmp_path / "gif.png", format="GIF")
    (tmp_path / "large.pgm").write_bytes(b"P5\n5000 4000\n255\n")
    (tmp_path / "huge.pgm").write_bytes(b"P5\n100000 100000\n255\n")
    (tmp_path / "cut.pgm").write_bytes(b"P5\n100 100\n255\n123")
    with pytest.raises(rp.InputError) as error:
        rp.load_occupancy_grid(path)
    told = str(error.value)
    assert message in told and "\n" not in told and str(tmp_path) in told


@pytest.mark.parametrize("name", ["/tmp/map.yaml", "../map.yaml", "map.txt"])
def test_a_scenario_reads_maps_beside_it_only(tmp_path, name):
    rp.save_scenario(replace(overtake(), obstacles=()), tmp_path / "s.yaml")
    text = (tmp_path / "s.yaml").read_text() + f"obstacles: {{map: {name}}}\n"
    (tmp_path / "s.yaml").write_text(text)
    with pytest.raises(rp.InputError, match=r"obstacles.map: expected a .yaml in the scenario's directory"):
        rp.load_scenario(tmp_path / "s.yaml")


def test_uncertain_static_obstacles_are_agents_with_constant_moments():
    """A box of uncertain place: its error is one for all time, so it persists; independent steps overstate it."""
    times = np.arange(31) * 0.1
    still = np.broadcast_to(np.array([15.0, 2.6]), (31, 1, 2))
    spread = np.broadcast_to(np.diag([0.3**2, 0.3**2]), (31, 1, 2, 2))
    box = rp.GaussianMixturePrediction(times, [1.0], still, spread, length=1.0, width=1.0, headings=np.zeros((31, 1)))
    box = rp.persistent(box)
    poses = np.column_stack([10.0 * times, 0 * times, 0 * times])
    ego = rp.EgoBox(4.5, 1.8)
    persistent, independent = (float(rp.path_risk(poses, [box], ego, d).total) for d in ("persistent", "independent"))
    # the ego passes along the whole of the box, so it is hit where its near side is within the ego's
    from scipy.stats import norm

    assert persistent == pytest.approx(norm.cdf((0.9 + 0.5 - 2.6) / 0.3), rel=1e-3)
    assert independent > 2 * persistent
    scene = rp.Scenario(
        start=rp.State(0, 0, 0, 10),
        goal=rp.Goal.at(25, 0, radius=4),
        bounds=(-5, -3, 40, 3),
        agents=(box,),
        ego=ego,
    )
    plan = rp.plan(scene, bound=1e-3, dependence="persistent", time_limit=20.0)
    assert plan.solved and float(plan.risk.total) <= 1e-3
