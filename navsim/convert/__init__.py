"""Worlds from elsewhere and for elsewhere: Gazebo SDF, ROS maps, IR-SIM, MuJoCo's MJCF.

Readers return a world and a list of remarks: everything in the file that could not be kept as it was. Writers return
such a list as well.
"""

from navsim.convert.errors import ConversionError
from navsim.convert.scene import Room
from navsim.convert.sdf import load_sdf, save_sdf

__all__ = ["ConversionError", "Room", "load_sdf", "save_sdf"]
