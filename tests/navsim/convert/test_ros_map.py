"""ROS maps: which cells count, where they come to lie, and what is left of a world that goes there and back."""

from __future__ import annotations

import math
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest
import shapely
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from same_view import CAMERA, poses_in, worlds

import navsim
from navsim.convert import ConversionError, Room, load_ros_map, save_ros_map
from navsim.convert.ros_map import read_ros_map
from navsim.robot import TURTLEBOT2


def map_file(directory: Path, pixels: np.ndarray, **settings) -> Path:
    """A map of a picture (top row first) at 0.1 m a cell; ``settings`` change or add keys."""
    pixels = np.asarray(pixels, dtype=np.uint8)
    (directory / "room.pgm").write_bytes(b"P5\n%d %d\n255\n" % pixels.shape[::-1] + pixels.tobytes())
    lines = {
        "image": "room.pgm", "resolution": 0.1, "origin": "[0, 0, 0]", "negate": 0, "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    } | settings  # fmt: skip
    path = directory / "room.yaml"
    path.write_text("".join(f"{key}: {value}\n" for key, value in lines.items()))
    return path


def floor(rows: int = 40, columns: int = 60) -> np.ndarray:
    return np.full((rows, columns), 254)


def shape_of(world: navsim.World) -> shapely.Geometry:
    """What stands in the robot's way, from above, as far as the room reaches."""
    found = []
    for prism in world.prisms:
        if prism.obstacle >= 0 and prism.overlaps_heights(0.0, TURTLEBOT2.height):
            if prism.is_cylinder:
                found.append(shapely.Point(prism.vertices[0]).buffer(prism.radius, quad_segs=64))
            else:
                found.append(shapely.Polygon(prism.vertices))
    return shapely.union_all(found).intersection(shapely.box(*-world.half_size, *world.half_size))


def test_an_occupied_rectangle_is_a_box_where_the_map_has_it(tmp_path):
    pixels = floor()
    pixels[5:10, 20:30] = 0  # rows 5 to 10 from the top: y from 3.0 to 3.5 m
    world, notes = load_ros_map(map_file(tmp_path, pixels, origin="[-1.0, 2.0, 0.0]"), wall_height=1.5)
    assert (world.size, world.walls.height) == ((6.0, 4.0), 1.5)
    (box,) = world.obstacles
    # The room reaches from (-1, 2) to (5, 6), so its centre is (2, 4); the box's is (1.5, 5.25).
    assert (box.kind, box.at, box.size, box.height) == ("box", (-0.5, 1.25), (1.0, 0.5), 1.5)
    assert any("(2, 4) in the file" in note for note in notes)


def test_a_turned_map_lies_as_its_picture_does_and_asked_places_are_where_the_map_has_them(tmp_path):
    pixels = floor()
    pixels[5:10, 20:30] = 0
    yaw = math.radians(30.0)

    def in_map(x, y):  # of a point of the picture, metres from its lower left corner
        return math.cos(yaw) * x - math.sin(yaw) * y - 1.0, math.sin(yaw) * x + math.cos(yaw) * y + 2.0

    path = map_file(tmp_path, pixels, origin=f"[-1.0, 2.0, {yaw}]")
    world, notes = load_ros_map(path, room=Room(starts=(in_map(1.0, 1.0),), goals=(in_map(5.0, 3.0),)))
    assert world.size == (6.0, 4.0)
    (box,) = world.obstacles
    assert (box.at, box.size, box.yaw_deg) == ((-0.5, 1.25), (1.0, 0.5), 0.0)
    assert world.starts[0].at == pytest.approx((-2.0, -1.0), abs=1e-6)
    assert world.goals[0].at == pytest.approx((2.0, 1.0), abs=1e-6)
    x, y = in_map(3.0, 2.0)
    assert any("turned by 30 degrees" in note and f"({x:g}, {y:g}) in the file" in note for note in notes)


def test_a_yaw_in_degrees_is_refused(tmp_path):
    with pytest.raises(ConversionError, match=r"room.yaml:3: origin.* 90 looks like degrees"):
        load_ros_map(map_file(tmp_path, floor(), origin="[0, 0, 90]"))


@given(
    yaw=st.floats(-math.tau, math.tau),
    x=st.floats(-20.0, 20.0),
    y=st.floats(-20.0, 20.0),
    closed=st.booleans(),
    seed=st.integers(0, 10_000),
)
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_how_a_map_is_turned_and_where_it_lies_changes_nothing_of_its_world(tmp_path, yaw, x, y, closed, seed):
    generator = np.random.default_rng(seed)
    pixels = np.full(generator.integers(30, 80, 2), 254)
    for row, column in generator.integers(1, 25, (3, 2)):
        pixels[row : row + 3, column : column + 4] = 0
    if closed:
        pixels[[0, -1]] = 0
        pixels[:, [0, -1]] = 0
    as_drawn, _ = load_ros_map(map_file(tmp_path, pixels))
    turned, _ = load_ros_map(map_file(tmp_path, pixels, origin=f"[{x}, {y}, {yaw}]"))
    assert turned.size == as_drawn.size
    assert turned.walls == as_drawn.walls
    assert len(turned.prisms) == len(as_drawn.prisms)
    for one, other in zip(turned.prisms, as_drawn.prisms, strict=True):
        np.testing.assert_allclose(one.vertices, other.vertices, atol=3e-6)


@pytest.mark.parametrize(
    ("settings", "value", "means"),
    [
        ({}, 0, "occupied"), ({}, 89, "occupied"), ({}, 90, "unknown"), ({}, 205, "unknown"), ({}, 206, "free"),
        ({"negate": 1}, 255, "occupied"), ({"negate": "true"}, 20, "free"), ({"negate": 1}, 100, "unknown"),
        ({"free_thresh": 0.25}, 205, "free"), ({"occupied_thresh": 0.5}, 127, "occupied"),
        ({"mode": "scale"}, 0, "occupied"), ({"mode": "scale"}, 150, "free"),
        ({"mode": "raw"}, 100, "occupied"), ({"mode": "raw"}, 0, "free"), ({"mode": "raw"}, 205, "unknown"),
        ({"mode": "raw"}, 66, "occupied"),
    ],
)  # fmt: skip
def test_cells_mean_what_map_server_takes_them_for(tmp_path, settings, value, means):
    free = {"1": 0, "true": 0}.get(str(settings.get("negate", 0)), 0 if settings.get("mode") == "raw" else 254)
    pixels = np.full((40, 60), free)
    pixels[10:20, 10:20] = value
    path = map_file(tmp_path, pixels, **settings)
    for unknown in ("free", "occupied"):
        scene = read_ros_map(path, unknown=unknown)
        assert len(scene.solids) == (means == "occupied" or (means == "unknown" and unknown == "occupied"))
        assert any("100 cells in the room are unknown" in note for note in scene.notes) == (means == "unknown")


@pytest.mark.parametrize(
    ("mode", "grey", "alpha", "means"),
    [
        ("trinary", 70, 255, "unknown"), ("trinary", 205, 255, "free"), ("trinary", 0, 255, "occupied"),
        ("trinary", 0, 0, "occupied"), ("trinary", 255, 0, "unknown"),
        ("scale", 70, 255, "occupied"), ("scale", 0, 254, "unknown"), ("scale", 254, 0, "unknown"),
    ],
)  # fmt: skip
def test_transparent_cells_mean_what_map_server_takes_them_for(tmp_path, mode, grey, alpha, means):
    """It averages alpha in with the colours of trinary maps, and takes what is transparent in others for unknown."""
    pixels = np.full((40, 60, 4), 255, dtype=np.uint8)
    pixels[10:20, 10:20] = (grey, grey, grey, alpha)
    imageio.imwrite(tmp_path / "room.png", pixels)
    path = map_file(tmp_path, floor(), image="room.png", mode=mode)
    for unknown in ("free", "occupied"):
        scene = read_ros_map(path, unknown=unknown)
        assert len(scene.solids) == (means == "occupied" or (means == "unknown" and unknown == "occupied"))
        assert any("100 cells in the room are unknown" in note for note in scene.notes) == (means == "unknown")


def test_numbers_are_read_as_ros_reads_them(tmp_path):
    pixels = floor()
    pixels[5:10, 20:30] = 0
    plain, _ = load_ros_map(map_file(tmp_path, pixels, resolution="0.05", origin="[-0.00001, 0, 0]"))
    other, _ = load_ros_map(map_file(tmp_path, pixels, resolution="5e-2", origin="[-1e-05, 0, 0]"))
    assert other.to_dict() == plain.to_dict()


def test_borders_of_unknown_cells_are_cut_off(tmp_path):
    pixels = np.full((100, 100), 205)
    pixels[30:70, 20:80] = 254
    world, _ = load_ros_map(map_file(tmp_path, pixels))
    assert world.size == (6.0, 4.0)


def test_a_closed_rim_becomes_the_walls(tmp_path):
    pixels = floor()
    pixels[:2], pixels[-2:], pixels[:, :2], pixels[:, -2:] = 0, 0, 0, 0
    world, notes = load_ros_map(map_file(tmp_path, pixels))
    assert (world.size, world.walls.thickness, world.obstacles) == ((5.6, 3.6), 0.2, ())
    assert any("rim of 2" in note for note in notes)
    pixels[20, 0] = 254
    world, _ = load_ros_map(map_file(tmp_path, pixels))
    assert world.walls.thickness == 0.1
    assert len(world.obstacles) > 0


@pytest.mark.parametrize("resolution", [0.02, 0.03, 0.05, 0.07])
@pytest.mark.parametrize("name", ["complex_train", "simple_eval"])
def test_walls_come_back_whatever_the_resolution(name, resolution, tmp_path):
    world = navsim.load_world(name)
    save_ros_map(world, tmp_path / "map.yaml", resolution=resolution)
    picture = imageio.imread(tmp_path / "map.pgm")
    for edge in (picture[0], picture[-1], picture[:, 0], picture[:, -1]):
        assert (edge == 0).mean() > 0.9
    back, notes = load_ros_map(tmp_path / "map.yaml")
    assert any("rim" in note for note in notes)
    np.testing.assert_allclose(back.size, world.size, atol=2.0 * resolution)


def test_transparent_pixels_are_unknown_in_scale_mode(tmp_path):
    from PIL import Image

    pixels = np.full((40, 60, 2), 255, dtype=np.uint8)
    pixels[10:20, 10:20] = [0, 255]
    pixels[10:20, 30:40] = [0, 0]
    Image.fromarray(pixels, "LA").save(tmp_path / "room.png")
    path = map_file(tmp_path, floor(), image="room.png", mode="scale")
    assert len(read_ros_map(path).solids) == 1


@pytest.mark.parametrize("resolution", [0.02, 0.05])
@pytest.mark.parametrize("name", navsim.shipped_worlds())
def test_outlines_of_shipped_worlds_come_back_within_a_cell(name, resolution, tmp_path):
    world = navsim.load_world(name)
    save_ros_map(world, tmp_path / "map.yaml", resolution=resolution)
    back, _ = load_ros_map(tmp_path / "map.yaml", tolerance=0.0)
    assert (back.size, back.walls.height) == (world.size, 2.0)
    assert back.walls.thickness == pytest.approx(0.1)
    before, after = shape_of(world), shape_of(back)
    cell = math.sqrt(2.0) * resolution + 1e-6
    assert before.difference(after.buffer(1e-6)).area < 1e-9  # nothing is lost,
    assert after.difference(before.buffer(cell)).area < 1e-9  # nothing grows by more than a cell's diagonal
    simplified = shape_of(load_ros_map(tmp_path / "map.yaml")[0])
    allowed = cell + 0.75 * resolution
    # Pockets that nothing gets into are filled; they are beyond the reach of this test of borders.
    assert before.difference(simplified.buffer(0.75 * resolution + 1e-6)).area < 1e-9
    outside = simplified.difference(before.buffer(allowed))
    assert outside.area < 1e-9 or outside.area < 0.02


def test_a_fine_map_of_upright_walls_looks_the_same_to_the_camera_within_a_cell(tmp_path):
    shapes = [
        {"box": {"at": [1.0, -0.5], "size": [0.6, 0.4], "height": 2.0, "yaw_deg": 30}},
        {"cylinder": {"at": [-1.0, 1.2], "radius": 0.25, "height": 2.0}},
        {"polygon": {"points": [[-2, -2], [-1, -2], [-1, -1.8], [-1.8, -1.8], [-1.8, -1], [-2, -1]], "height": 2.0}},
    ]
    world = navsim.World.from_dict({"format": 1, "size": [6.0, 5.0], "obstacles": shapes})
    resolution = 0.005
    save_ros_map(world, tmp_path / "map.yaml", resolution=resolution)
    back, _ = load_ros_map(tmp_path / "map.yaml")
    poses = poses_in(world, 60)
    images, others = (navsim.render_depth(each, poses, CAMERA) for each in (world, back))
    # A ray that grazes a face meets it a cell earlier many cells nearer: nearly all rays do not.
    assert (np.abs(images - others) <= 3.0 * resolution).mean() > 0.98
    assert np.median(np.abs(images - others)) <= resolution


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(world=worlds())
def test_any_world_comes_back_from_a_map_within_a_cell(world, tmp_path):
    save_ros_map(world, tmp_path / "map.yaml", resolution=0.04)
    scene = read_ros_map(tmp_path / "map.yaml", tolerance=0.0)
    if not scene.solids:
        assert shape_of(world).area < 1e-6
        return
    back, _ = load_ros_map(tmp_path / "map.yaml", tolerance=0.0, room=Room(size=world.size))
    before, after = shape_of(world), shape_of(back)
    assert before.difference(after.buffer(1e-5)).area < 1e-6
    reach = after.difference(before.buffer(0.04 * math.sqrt(2.0) + 1e-5))
    assert reach.area < 1e-6 or reach.area < 0.1  # pockets


def test_only_obstacles_at_the_given_heights_are_on_the_map(tmp_path):
    world = navsim.load_world("complex_eval")
    counts = {}
    for heights in ((0.0, 0.42), (0.16, 0.2), (0.0, 2.0)):
        notes = save_ros_map(world, tmp_path / "map.yaml", low=heights[0], high=heights[1])
        counts[heights] = sum("is not on the map" in note for note in notes)
        for obstacle in world.obstacles:
            on_it = obstacle.base < heights[1] and obstacle.top > heights[0]
            assert any(f"'{obstacle.name}' is not on the map" in note for note in notes) != on_it
    assert counts[0.0, 2.0] == 0 < counts[0.0, 0.42] < counts[0.16, 0.2]


def test_walls_that_are_not_on_the_map_are_told(tmp_path):
    rooms = {height: navsim.World(size=(6, 6), walls=navsim.Walls(height=height)) for height in (0.12, 0.2)}
    notes = {height: save_ros_map(room, tmp_path / "m.yaml", low=0.15) for height, room in rooms.items()}
    assert "the walls are not on the map: nothing of them is between 0.15 and" in notes[0.12][0]
    assert not any("the walls are not" in note for note in notes[0.2])


def test_maps_that_cannot_be_written_are_refused(tmp_path):
    world = navsim.load_world("simple_eval")
    for settings_, part in (
        ({"resolution": 0.0}, "resolution must be greater than 0"),
        ({"resolution": 1e-5}, "coarsen it"),
        ({"low": 0.5, "high": 0.5}, "low < high"),
    ):
        with pytest.raises(ValueError, match=part):
            save_ros_map(world, tmp_path / "map.yaml", **settings_)
    with pytest.raises(ValueError, match=r"name it 'map\.yaml'"):
        save_ros_map(world, tmp_path / "map.pgm")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("settings", "part"),
    [
        ({"image": "none.pgm"}, "none.pgm: cannot be read"),
        ({"image": "room.yaml"}, "is not a picture"),
        ({"image": '"two\\nlines.pgm"'}, "room.yaml:1: image: must name the picture, such as map.pgm"),
        ({"image": "[1, 2]"}, "room.yaml:1: image: must be text"),
        ({"resolution": -0.1}, "room.yaml:2: resolution: must be metres per cell"),
        ({"resolution": ".nan"}, "must be a finite number"),
        ({"resolution": "fine"}, "must be a number, not 'fine'"),
        ({"origin": "[0, 0, 0, 0]"}, "room.yaml:3: origin: must be a list of 2 to 3 numbers"),
        ({"origin": "[0, .inf, 0]"}, "origin[1]: must be a finite number"),
        ({"mode": "colour"}, "mode: must be trinary, scale or raw"),
        ({"occupied_thresh": 7}, "occupied_thresh: must lie between 0 and 1"),
        ({"negate": "perhaps"}, "negate: must be true or false"),
    ],
)
def test_errors_name_file_line_and_key(tmp_path, settings, part):
    with pytest.raises(ConversionError) as error:
        load_ros_map(map_file(tmp_path, floor(), **settings))
    assert part in str(error.value)
    assert "\n" not in str(error.value)


def test_a_picture_of_too_many_pixels_is_refused_unread(tmp_path):
    path = map_file(tmp_path, floor())
    (tmp_path / "room.pgm").write_bytes(b"P5\n100000 100000\n255\n")
    with pytest.raises(ConversionError, match="scale it down"):
        load_ros_map(path)


@pytest.mark.slow
def test_a_large_noisy_map_is_read(tmp_path):
    """2000 x 2000 cells, as SLAM leaves them: rooms, slanting walls, speckles."""
    generator = np.random.default_rng(0)
    pixels = np.full((2000, 2000), 254, dtype=np.uint8)
    for k in range(0, 2000, 200):
        pixels[k : k + 4], pixels[:, k : k + 4] = 0, 0
    for k in range(100, 2000, 200):
        pixels[:, k : k + 40][::200] = 254
        pixels[k : k + 40] = np.where(pixels[k : k + 40] == 0, 254, pixels[k : k + 40])
        pixels[:, k : k + 40] = np.where(pixels[:, k : k + 40] == 0, 254, pixels[:, k : k + 40])
    speckles = generator.integers(0, 2000, (3000, 2))
    pixels[speckles[:, 0], speckles[:, 1]] = 0
    world, _ = load_ros_map(map_file(tmp_path, pixels, resolution=0.05))
    assert world.size == (100.0, 100.0)
    assert len(world.obstacles) > 2000
