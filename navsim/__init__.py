"""A lightweight 2.5D simulator of mobile-robot navigation from depth images."""

from navsim.errors import WorldError
from navsim.world import World
from navsim.worldfile import SHIPPED_WORLDS_DIRECTORY, load_world, save_world, shipped_worlds

__all__ = ["SHIPPED_WORLDS_DIRECTORY", "World", "WorldError", "load_world", "save_world", "shipped_worlds"]
