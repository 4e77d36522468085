"""Rooms made by chance: clutter, blocks, corridors, offices, warehouses and forests that a robot can drive through.

A kind's module decides where things stand; :mod:`navsim.generate.rooms` finds starts and goals and checks the passages.
"""

from navsim.generate.density import floor_covered
from navsim.generate.layout import ImpossibleError
from navsim.generate.placing import PASSAGE
from navsim.generate.rooms import KINDS, LARGEST_DENSITY, RoomSettings, generate_world, generate_worlds
from navsim.generate.writing import room_text, write_rooms

__all__ = [
    "KINDS",
    "LARGEST_DENSITY",
    "PASSAGE",
    "ImpossibleError",
    "RoomSettings",
    "floor_covered",
    "generate_world",
    "generate_worlds",
    "room_text",
    "write_rooms",
]
