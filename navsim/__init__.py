"""A lightweight 2.5D simulator of mobile-robot navigation from depth images."""

from navsim.camera import DepthCamera
from navsim.difficulty import difficulty
from navsim.errors import WorldError
from navsim.generate import generate_world, generate_worlds
from navsim.holes import fill_holes
from navsim.randomization import Randomization
from navsim.raycast import render_depth
from navsim.robot import ACTIONS, NUM_ACTIONS, TURTLEBOT2, Robot
from navsim.sensor import KINECT, SensorModel
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
from navsim.worldsource import worlds_from

__all__ = [
    "ACTIONS",
    "KINECT",
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
    "Randomization",
    "Robot",
    "SensorModel",
    "Simulator",
    "Start",
    "Swing",
    "Task",
    "Transition",
    "Walls",
    "World",
    "WorldError",
    "difficulty",
    "fill_holes",
    "generate_world",
    "generate_worlds",
    "load_world",
    "render_depth",
    "save_world",
    "shipped_worlds",
    "worlds_from",
]
