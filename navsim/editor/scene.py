"""What the page draws and lists, as plain data for JSON."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np

from navsim.camera import DepthCamera
from navsim.editor.patch import LISTS, dependants, entries
from navsim.editor.reading import Reading
from navsim.errors import Finding
from navsim.planner import shortest_path, shortest_path_length
from navsim.raycast import render_depth
from navsim.robot import TURTLEBOT2
from navsim.world import World

MOST_PATHS = 400
"""Pairs of a start and a goal whose paths are drawn."""
LARGEST_IMAGE = 640 * 480
"""Pixels of a depth image."""


def describe(reading: Reading) -> dict[str, Any]:
    """The world of a text, where its entries stand in it, and what is wrong with it."""
    return {
        "scene": None if reading.world is None else _scene(reading, reading.world),
        "problems": [problem(finding) for finding in reading.findings],
    }


def problem(finding: Finding) -> dict[str, Any]:
    """A finding, with the entry that it is about."""
    where = list(finding.where[:2])
    return {**finding._asdict(), "where": where if len(where) == 2 and where[0] in LISTS else None}


def _scene(reading: Reading, world: World) -> dict[str, Any]:
    tree = reading.tree
    spans = {(name, i): [node.start, node.end] for name, i, node in entries(tree)}
    said = tree.root.data()

    def placed(name: str, i: int, settings: dict[str, Any]) -> dict[str, Any]:
        others = [_called(world, place) for place in dependants(tree, (name, i))] if "*" in tree.text else []
        return {**settings, "span": spans.get((name, i)), "shared": others}

    scene: dict[str, Any] = {
        "name": world.name,
        "size": list(world.size),
        "walls": None if world.walls is None else world.walls.model_dump(mode="json"),
        "walls_given": said["walls"] if isinstance(said.get("walls"), dict) else {},
        "obstacles": [],
    }
    for i, obstacle in enumerate(world.obstacles):
        (own,) = said["obstacles"][i].values()
        settings = {"kind": obstacle.kind, "named": "name" in own, **obstacle.model_dump(mode="json")}
        settings |= {key: own.get(key) for key in ("motion", "pushable")}  # as written, without defaults
        scene["obstacles"].append(placed("obstacles", i, settings))
    for name, places in (("starts", world.starts), ("goals", world.goals)):
        scene[name] = (
            places
            if isinstance(places, str)
            else [placed(name, i, place.model_dump(mode="json")) for i, place in enumerate(places)]
        )
    return scene


def _called(world: World, place: tuple[Any, ...]) -> str:
    if len(place) == 1:
        return str(place[0])
    name, i = place
    return world.obstacles[i].name if name == "obstacles" else f"{name[:-1]} {i}"


def equipment() -> dict[str, Any]:
    """The robot and the camera that the page draws, metres and degrees."""
    camera = DepthCamera()
    return {
        "robot": {"radius": TURTLEBOT2.radius, "height": TURTLEBOT2.height},
        "camera": {
            "horizontal_fov_deg": camera.horizontal_fov_deg,
            "vertical_fov_deg": camera.vertical_fov_deg,
            "mount_x": camera.mount_x,
            "mount_y": camera.mount_y,
            "mount_z": camera.mount_z,
            "max_range": camera.max_range,
            "blind_zone": camera.blind_zone,
            "width": camera.width,
            "height": camera.height,
        },
    }


def depth_millimetres(world: World, pose: tuple[float, float, float], width: int, height: int) -> bytes:
    """The ideal depth image at ``pose`` (x, y, metres; yaw, radians): rows of little-endian uint16, millimetres."""
    image = render_depth(world, np.array([pose]), DepthCamera(width=width, height=height))[0]
    return np.rint(1000.0 * image).astype("<u2").tobytes()


class Paths:
    """Shortest paths of worlds; a newer question ends the work on an older one.

    One question is worked on at a time.
    """

    def __init__(self) -> None:
        self._newest: object = None
        self._lock = threading.Lock()

    def of(self, world: World) -> dict[str, Any] | None:
        """The shortest path between every start and goal that are listed; None if a newer question came.

        Each pair has ``start`` and ``goal``, their places in the lists; ``points``, metres, or None where there is no
        way; and ``length``, metres, to the disc around the goal that counts as reaching it.
        """
        asked = self._newest = object()
        pairs: list[dict[str, Any]] = []
        with self._lock:
            for start, goal in world.paths[:MOST_PATHS]:
                if self._newest is not asked:
                    return None
                ends = world.starts[start].at, world.goals[goal].at  # type: ignore[union-attr]
                path = shortest_path(world, *ends, goal_radius=0.0)
                pair: dict[str, Any] = {"start": start, "goal": goal, "points": None, "length": None}
                if path is not None:
                    pair["points"] = np.round(path, 3).tolist()
                    pair["length"] = round(shortest_path_length(world, *ends), 3)
                pairs.append(pair)
        return {"pairs": pairs, "left_out": max(0, len(world.paths) - MOST_PATHS)}
