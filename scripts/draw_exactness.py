"""Draws docs/images/exactness.png: what the camera sees, and how far that is from what Embree's rays meet.

The reference is that of the tests, so this runs in a checkout with the development tools:

    python scripts/draw_exactness.py
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import tyro
import yaml
from matplotlib.colors import LogNorm
from matplotlib.patches import Polygon

import navsim
from navsim.camera import DepthCamera
from navsim.draw import VIEW, draw_depth, draw_world, new_figure, save_figure
from navsim.worldfile import SHIPPED_WORLDS_DIRECTORY

REPOSITORY = Path(__file__).parents[1]
sys.path.insert(0, str(REPOSITORY / "tests" / "navsim"))

from reference import MeshReference, camera_position, depth_image  # noqa: E402 - found on the path set above


def draw(
    world: str = "complex_eval",
    pose: tuple[float, float, float] = (-2.6, -2.9, 62.0),
    out: Path = REPOSITORY / "docs" / "images" / "exactness.png",
) -> None:
    """Draw a plan view, a depth image of 320x256 pixels, and its deviation from Embree.

    Args:
        world: Name of a shipped world.
        pose: Of the robot: x and y in metres, yaw in degrees.
        out: File to write.
    """
    camera, place = DepthCamera(width=320, height=256), np.array([*pose[:2], math.radians(pose[2])])
    loaded = navsim.load_world(world)
    image = navsim.render_depth(loaded, place[None], camera)[0]
    description = yaml.safe_load((SHIPPED_WORLDS_DIRECTORY / f"{world}.yaml").read_text(encoding="utf-8"))
    reference = MeshReference(description, camera.mount_z, (float(place[0]), float(place[1])))
    error = 1e3 * np.abs(image - depth_image(reference, camera, place))

    figure = new_figure(13.0, 3.9, dpi=100)
    plan, seen, off = figure.subplots(1, 3, width_ratios=[1.0, 1.25, 1.25])
    draw_world(plan, loaded, starts=False, goals=False, colour_bar=False, legend=False)
    eye, half_angle = camera_position(camera, place)[:2], math.radians(camera.horizontal_fov_deg) / 2
    reach = camera.max_range / math.cos(half_angle)
    corners = [eye] + [
        eye + reach * np.array([math.cos(place[2] + side), math.sin(place[2] + side)])
        for side in (half_angle, -half_angle)
    ]
    plan.add_patch(Polygon(np.array(corners), fc=VIEW, ec=VIEW, alpha=0.3, zorder=7, clip_on=True))
    plan.set_title("the view, 60° wide and 5 m deep", fontsize=10)
    draw_depth(seen, image, camera)
    seen.set_title(f"depth, {camera.width}x{camera.height}", fontsize=10)
    shown = off.imshow(np.maximum(error, 1e-6), norm=LogNorm(1e-6, 1e1), cmap="magma", aspect=seen.get_aspect())
    off.set_xticks([])
    off.set_yticks([])
    off.set_title(f"off from Embree: {np.count_nonzero(error > 1.0)} pixels by over 1 mm", fontsize=10)
    figure.colorbar(shown, ax=off, label="mm")
    save_figure(figure, out)
    print(f"{out}: median {np.median(error):.1e} mm, greatest {error.max():.1e} mm")


if __name__ == "__main__":
    tyro.cli(draw)
