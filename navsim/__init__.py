"""A lightweight 2.5D simulator of mobile-robot navigation from depth images."""

from navsim.camera import DepthCamera
from navsim.errors import WorldError
from navsim.raycast import render_depth
from navsim.robot import ACTIONS, NUM_ACTIONS, TURTLEBOT2, Robot
from navsim.simulator import Observation, Simulator, Transition
from navsim.task import Path, Task
from navsim.world import (
    Box,
    Cylinder,
    Goal,
    Motion,
    Polygon,
    Pushable,
    Start,
    Swing,
    Walls,
    World,
)
from navsim.worldfile import SHIPPED_WORLDS_DIRECTORY, load_world, save_world, shipped_worlds

__all__ = [
    "ACTIONS",
    "NUM_ACTIONS",
    "SHIPPED_WORLDS_DIRECTORY",
    "TURTLEBOT2",
    "Box",
    "Cylinder",
    "DepthCamera",
    "Goal",
    "Motion",
    "Observation",
    "Path",
    "Polygon",
    "Pushable",
    "Robot",
    "Simulator",
    "Start",
    "Swing",
    "Task",
    "Transition",
    "Walls",
    "World",
    "WorldError",
    "load_world",
    "render_depth",
    "save_world",
    "shipped_worlds",
]
