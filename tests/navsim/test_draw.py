"""Pictures: what is drawn, where, and in which colours."""

from __future__ import annotations

import io
import math

import imageio.v3 as imageio
import numpy as np
import pytest
import shapely
import shapely.affinity
from matplotlib.colors import to_rgb, to_rgba
from matplotlib.patches import Circle, Polygon, Rectangle

from navsim.camera import DepthCamera
from navsim.draw import (
    NO_RETURN,
    OUTCOME_COLOURS,
    depth_colours,
    draw_depth,
    draw_depth_stack,
    draw_heading,
    draw_paths,
    draw_q_values,
    draw_world,
    figure_png,
    new_figure,
    save_figure,
)
from navsim.world import Cylinder, World

OBSTACLES = {
    "crate": {"box": {"name": "crate", "at": [1.0, -0.5], "size": [0.6, 0.4], "height": 0.8, "yaw_deg": 30}},
    "cabinet": {"box": {"name": "cabinet", "at": [-2.0, 0.0], "size": [0.6, 0.4], "height": 1.8}},
    "can": {"cylinder": {"name": "can", "at": [-1.0, 1.2], "radius": 0.15, "height": 0.25}},
    "table": {"box": {"name": "table", "at": [0.0, 2.0], "size": [1.2, 0.6], "base": 0.7, "height": 0.03}},
    "beam": {"box": {"name": "beam", "at": [0.0, -2.0], "size": [1.2, 0.1], "base": 0.33, "height": 0.1}},
    "corner": {
        "polygon": {"name": "corner", "points": [[2, 2], [3, 2], [3, 2.2], [2.2, 2.2], [2.2, 3], [2, 3]], "height": 1}
    },
}


def world_of(*names: str) -> World:
    return World.from_dict(
        {
            "format": 1,
            "size": [7, 7],
            "obstacles": [OBSTACLES[name] for name in names],
            "starts": [{"at": [0, 0], "yaw_deg": 90}, [-3, -3]],
            "goals": [[2.5, -2.5], [-2.5, 2.5]],
        }
    )


def plan_of(world: World, **options):
    figure = new_figure(5, 5)
    axes = figure.add_subplot()
    draw_world(axes, world, **options)
    return axes


def shapes(axes, kind):
    return [patch for patch in axes.patches if type(patch) is kind]


def legend_texts(axes):
    return [text.get_text() for text in axes.get_legend().get_texts()]


def test_a_turned_box_is_drawn_where_it_stands():
    axes = plan_of(world_of("crate"))
    (patch,) = shapes(axes, Polygon)
    corners = patch.get_xy()
    upright = shapely.box(0.7, -0.7, 1.3, -0.3)
    expected = shapely.affinity.rotate(upright, 30, origin=(1.0, -0.5))
    assert shapely.Polygon(corners).symmetric_difference(expected).area < 1e-12


def test_a_concave_polygon_is_one_shape_without_seams():
    axes = plan_of(world_of("corner"))
    (patch,) = shapes(axes, Polygon)
    assert shapely.Polygon(patch.get_xy()).area == pytest.approx(1.0 * 0.2 + 0.2 * 0.8)


def test_taller_obstacles_are_darker():
    axes = plan_of(world_of("crate", "cabinet"))
    low, high = sorted(shapes(axes, Polygon), key=lambda patch: patch.get_zorder())
    assert sum(low.get_facecolor()[:3]) > sum(high.get_facecolor()[:3])


def test_what_a_planar_laser_would_miss_is_hatched_and_explained():
    axes = plan_of(world_of("crate", "can", "table", "beam"))
    crate, beam, table = (
        next(patch for patch in shapes(axes, Polygon) if np.allclose(patch.get_xy()[:4].mean(axis=0), middle))
        for middle in ([1.0, -0.5], [0.0, -2.0], [0.0, 2.0])
    )
    (can,) = [patch for patch in shapes(axes, Circle) if patch.get_radius() == 0.15]
    assert crate.get_hatch() is None
    hatches = {can.get_hatch(), table.get_hatch(), beam.get_hatch()}
    assert len(hatches) == 3
    assert None not in hatches
    assert legend_texts(axes)[:3] == [
        "lower than the camera (0.297 m)",
        "the robot (0.42 m) fits under",
        "off the floor, too low to pass",
    ]


def test_a_higher_camera_makes_more_obstacles_low():
    axes = plan_of(world_of("crate"), camera=DepthCamera(mount_z=1.0))
    assert "lower than the camera (1 m)" in legend_texts(axes)


def test_starts_and_goals_are_numbered_and_only_given_yaws_have_arrows():
    axes = plan_of(world_of("crate"))
    assert {text.get_text() for text in axes.texts} >= {"0", "1"}
    arrows = [patch for patch in axes.patches if type(patch).__name__ == "FancyArrowPatch"]
    assert len(arrows) == 1
    (x_from, y_from), (x_to, y_to) = arrows[0]._posA_posB
    assert x_from == pytest.approx(x_to) == pytest.approx(0.0)
    assert y_from < y_to
    assert len([line for line in axes.lines if line.get_marker() == "D"]) == 2


def test_random_starts_and_goals_leave_the_plan_empty():
    axes = plan_of(World.from_dict({"format": 1, "size": [4, 4], "starts": "random", "goals": "random"}))
    assert not axes.texts
    assert axes.get_legend() is None


def test_walls_stand_outside_the_room_and_an_open_floor_has_none():
    walled = shapes(plan_of(world_of("crate")), Rectangle)
    assert [patch.get_width() for patch in walled] == pytest.approx([7.2, 7.0])
    open_floor = World.from_dict({"format": 1, "size": [4, 4], "walls": "none", "starts": [[0, 0]], "goals": [[1, 1]]})
    assert [patch.get_width() for patch in shapes(plan_of(open_floor), Rectangle)] == [4.0]


def test_names_are_written_when_asked_for():
    assert "crate" not in {text.get_text() for text in plan_of(world_of("crate")).texts}
    assert "crate" in {text.get_text() for text in plan_of(world_of("crate"), names=True).texts}


def test_only_the_largest_obstacles_are_named_where_there_are_very_many(monkeypatch):
    monkeypatch.setattr("navsim.draw.MOST_NAMES", 3)
    world = World(
        size=(20, 5),
        obstacles=[Cylinder(name=f"can{i}", at=(2.0 * i - 9, 0), radius=0.1 + 0.01 * i, height=1) for i in range(8)],
    )
    names = {text.get_text() for text in plan_of(world, names=True).texts}
    assert {name for name in names if name.startswith("can")} == {"can5", "can6", "can7"}


def test_paths_have_the_colour_of_their_outcome_and_are_counted():
    axes = plan_of(world_of("crate"))
    line = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 0.0]])
    draw_paths(axes, [line, line + 1, line + 2], ["success", "collision", "success"])
    drawn = {
        tuple(np.round(lines.get_colors()[0][:3], 4)): len(lines.get_segments()) for lines in axes.collections[::2]
    }
    assert drawn == {
        tuple(np.round(to_rgb(OUTCOME_COLOURS["success"]), 4)): 2,
        tuple(np.round(to_rgb(OUTCOME_COLOURS["collision"]), 4)): 1,
    }
    written = {text.get_text() for legend in axes.findobj(type(axes.get_legend())) for text in legend.get_texts()}
    assert {"2 success", "1 collision", "start", "goal"} <= written


def test_outcome_colours_differ_for_colour_blind_readers():
    # Brettel et al. 1997 / Viénot et al. 1999: linear maps of linear RGB for protanopia and deuteranopia.
    protanopia = np.array([[0.11238, 0.88762, 0.0], [0.11238, 0.88762, 0.0], [0.00401, -0.00401, 1.0]])
    deuteranopia = np.array([[0.29275, 0.70725, 0.0], [0.29275, 0.70725, 0.0], [-0.02234, 0.02234, 1.0]])
    colours = np.array([to_rgb(colour) for colour in OUTCOME_COLOURS.values()]) ** 2.2
    for vision in (np.eye(3), protanopia, deuteranopia):
        perceived = np.clip(colours @ vision.T, 0, 1) ** (1 / 2.2)
        distances = [np.linalg.norm(a - b) for i, a in enumerate(perceived) for b in perceived[:i]]
        assert min(distances) > 0.2


@pytest.mark.parametrize(
    ("trajectories", "outcomes", "message"),
    [
        ([np.zeros((2, 3))], ["lost"], "'lost'"),
        ([np.zeros((2, 3))], ["success", "timeout"], "1 trajectories with 2 outcomes"),
    ],
)
def test_paths_that_cannot_be_drawn_say_why(trajectories, outcomes, message):
    with pytest.raises(ValueError, match=message):
        draw_paths(plan_of(world_of("crate")), trajectories, outcomes)


def test_a_depth_image_has_the_same_colours_from_counts_and_from_metres():
    counts = np.array([[255, 51], [102, 26]], dtype=np.uint8)
    figure = new_figure(3, 2)
    first = draw_depth(figure.add_subplot(121), counts)
    second = draw_depth(figure.add_subplot(122), counts.astype(np.float32) * np.float32(5 / 255))
    np.testing.assert_allclose(first.get_array(), second.get_array())
    assert first.get_clim() == (0.0, 5.0)
    np.testing.assert_allclose(first.get_array()[0], [5.0, 1.0])


def test_no_return_has_a_colour_that_no_depth_has():
    figure = new_figure(3, 2)
    image = draw_depth(figure.add_subplot(), np.array([[0, 255]], dtype=np.uint8))
    shown = image.to_rgba(image.get_array())
    np.testing.assert_allclose(shown[0, 0], to_rgba(NO_RETURN), atol=1e-2)
    depths = depth_colours()(np.linspace(0, 1, 256))[:, :3]
    assert np.abs(depths - np.array(to_rgb(NO_RETURN))).max(axis=1).min() > 0.1


def test_nearer_is_brighter():
    near, far = depth_colours()(0.0)[:3], depth_colours()(1.0)[:3]
    assert sum(near) > sum(far)


def test_a_depth_picture_has_the_shape_of_the_field_of_view():
    figure = new_figure(4, 3)
    axes = figure.add_subplot()
    draw_depth(axes, np.full((64, 80), 100, dtype=np.uint8), colour_bar=False)
    figure.canvas.draw()
    box = axes.get_window_extent()
    assert box.width / box.height == pytest.approx(640 / 480, rel=1e-3)


def test_the_greatest_q_value_stands_out():
    axes = new_figure(4, 3).add_subplot()
    draw_q_values(axes, [0.1, 0.3, -0.2, 0.5, 0.4, 0.0, 0.2])
    tops = [bar.get_y() + bar.get_height() for bar in axes.patches]
    np.testing.assert_allclose(tops, [0.1, 0.3, -0.2, 0.5, 0.4, 0.0, 0.2])
    colours = [bar.get_facecolor() for bar in axes.patches]
    assert [colours.count(colour) for colour in colours].index(1) == 3


def test_the_heading_arrow_points_left_for_positive_angles():
    axes = new_figure(2, 2).add_subplot()
    draw_heading(axes, math.pi / 2)
    (arrow,) = [patch for patch in axes.patches if type(patch).__name__ == "FancyArrowPatch"]
    (_, _), (x, y) = arrow._posA_posB
    assert x < -0.5
    assert y == pytest.approx(0.0, abs=1e-9)
    assert axes.get_title() == "goal: 90° to the left"


def test_a_depth_stack_shows_four_images_the_newest_last():
    figure = new_figure(8, 4)
    stack = np.stack([np.full((64, 80), 60 * index, dtype=np.uint8) for index in range(1, 5)])
    draw_depth_stack(figure, stack, 0.5, np.arange(7) / 10)
    images = [axes for axes in figure.axes if axes.images]
    assert [axes.get_title() for axes in images] == ["0.6 s ago", "0.4 s ago", "0.2 s ago", "now"]
    assert [round(float(axes.images[0].get_array().max()) * 255 / 5) for axes in images] == [60, 120, 180, 240]


def test_figures_become_png_files_and_bytes(tmp_path):
    figure = new_figure(2, 1, dpi=50)
    draw_q_values(figure.add_subplot(), [1.0, 2.0])
    path = save_figure(figure, tmp_path / "made" / "picture.png")
    assert imageio.imread(path).shape[:2] == (50, 100)
    assert imageio.imread(io.BytesIO(figure_png(figure))).shape[:2] == (50, 100)


def test_an_unknown_picture_format_names_those_that_are_known(tmp_path):
    with pytest.raises(ValueError, match=r"picture\.xyz: pictures are written as .*\.png"):
        save_figure(new_figure(1, 1), tmp_path / "picture.xyz")


def test_what_turns_about_its_own_middle_has_no_arrow(recwarn):
    motion = {"hinge": [0, 0], "swing_deg": [0, 90], "speed_deg": 30}
    turning = {"cylinder": {"at": [0, 0], "radius": 0.3, "height": 1, "motion": motion}}
    axes = new_figure(3, 3).add_subplot()
    draw_world(axes, World.from_dict({"format": 1, "size": [6, 6], "obstacles": [turning]}))
    assert not recwarn.list
    assert np.isfinite([annotation.xy for annotation in axes.texts if hasattr(annotation, "xy")]).all()


@pytest.mark.parametrize("suffix", [".pgf", ".rgba"])
def test_formats_that_are_no_pictures_are_refused(tmp_path, suffix):
    with pytest.raises(ValueError, match="pictures are written as"):
        save_figure(new_figure(1, 1), tmp_path / f"picture{suffix}")
    assert not any(tmp_path.iterdir())
