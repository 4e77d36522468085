"""Worlds from elsewhere and for elsewhere: Gazebo SDF, ROS maps, IR-SIM, MuJoCo's MJCF.

Readers return a world and a list of remarks: everything in the file that could not be kept as it was. Writers return
such a list as well.
"""

from navsim.convert.errors import ConversionError
from navsim.convert.formats import export_file, export_world, format_of, import_file, import_world
from navsim.convert.irsim import load_irsim
from navsim.convert.mjcf import save_mjcf
from navsim.convert.ros_map import load_ros_map, save_ros_map
from navsim.convert.scene import Room
from navsim.convert.sdf import load_sdf, save_sdf

__all__ = [
    "ConversionError",
    "Room",
    "export_file",
    "export_world",
    "format_of",
    "import_file",
    "import_world",
    "load_irsim",
    "load_ros_map",
    "load_sdf",
    "save_mjcf",
    "save_ros_map",
    "save_sdf",
]
