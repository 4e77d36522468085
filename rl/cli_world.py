"""The commands under ``navsim world``: what can be done with world files from a terminal.

What takes long to import is imported where it is used: ``navsim --help`` answers at once. Annotations are not deferred
here, because tyro reads them.
"""

from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import FlagCreatePairsOff, Positional, UseAppendAction, arg
from tyro.extras import SubcommandApp

from rl.console import busy

world_commands = SubcommandApp()


@world_commands.command
def check(files: Positional[tuple[str, ...]] = ()) -> None:
    """Say whether world files keep the rules, and everything that is wrong with those that do not.

    Args:
        files: World files, or names of shipped worlds; all of the latter if there is none.
    """
    from navsim import WorldError, load_world, shipped_worlds

    problems: list[str] = []
    for file in files or shipped_worlds():
        try:
            print(f"{file}: {load_world(file)}")
        except WorldError as error:
            problems += error.problems
    if problems:
        raise WorldError(problems)


@world_commands.command
def show(
    file: Positional[str],
    output: Annotated[
        Path | None, arg(aliases=["-o"], metavar="FILE", help_behavior_hint="(default: WORLD.png, here)")
    ] = None,
) -> None:
    """Draw a world from above, with the shortest path between every start and goal.

    Args:
        file: World file, or name of a shipped world.
        output: Picture to write, in the format that its suffix says: .png, .svg, .pdf.
    """
    from navsim import load_world
    from navsim.show import save_plan_view

    world = load_world(file)
    with busy("drawing"):
        path = save_plan_view(world, output or Path(f"{world.name}.png"))
    print(path)


@world_commands.command(name="import")
def import_(
    file: Positional[Path],
    output: Annotated[
        Path | None, arg(aliases=["-o"], metavar="FILE", help_behavior_hint="(default: FILE's name with .yaml, here)")
    ] = None,
    format: Annotated[
        Literal["sdf", "ros-map", "ir-sim"] | None, arg(help_behavior_hint="(default: what name and content say)")
    ] = None,
    model_path: Annotated[UseAppendAction[tuple[Path, ...]], arg(metavar="DIRECTORY")] = (),
    visual: FlagCreatePairsOff[bool] = False,
    approximate: Literal["nothing", "bounding-box", "convex-hull"] = "nothing",
    pushable: FlagCreatePairsOff[bool] = False,
    height: Annotated[float | None, arg(help_behavior_hint="(default: 2)")] = None,
    unknown: Annotated[Literal["free", "occupied"] | None, arg(help_behavior_hint="(default: free)")] = None,
    tolerance: Annotated[float | None, arg(help_behavior_hint="(default: 0.75 cells)")] = None,
    size: Annotated[
        tuple[float, float] | None, arg(metavar="X Y", help_behavior_hint="(default: what the file says)")
    ] = None,
    margin: float = 1.0,
    open_floor: FlagCreatePairsOff[bool] = False,
    starts: Annotated[
        tuple[tuple[float, float], ...],
        arg(metavar="X Y [X Y ...]", help_behavior_hint="(default: the file's, or random)"),
    ] = (),
    goals: Annotated[
        tuple[tuple[float, float], ...],
        arg(metavar="X Y [X Y ...]", help_behavior_hint="(default: the file's, or random)"),
    ] = (),
) -> None:
    """Make a world file of a Gazebo world (.sdf, .world), a ROS map (map.yaml) or an IR-SIM world (.yaml).

    What cannot be kept is named, one line each, here and at the head of the world file. Lengths are metres;
    coordinates are the file's own, whose room's centre becomes the origin. For example:

    navsim world import house.world --model-path ~/models --approximate bounding-box -o house.yaml

    navsim world import map.yaml --height 1.5 --starts 0 0 --goals 3 1 3 -2

    Args:
        file: File to read.
        output: World file to write.
        format: Format of FILE.
        model_path: SDF: directory with the models that FILE includes. May be given again. Gazebo's own
            variables (GZ_SIM_RESOURCE_PATH, GAZEBO_MODEL_PATH) and the directories around FILE count as well.
        visual: SDF: read what is seen instead of what is bumped into.
        approximate: SDF: what stands for what is no upright prism, such as meshes and spheres: the prism around its
            bounding box, or over its convex hull. Meshes take pip install "navsim-rl[meshes]".
        pushable: SDF: let the robot push light single bodies that Gazebo lets move; else they stand still.
        height: ROS map, IR-SIM: height of everything, which these do not tell, metres.
        unknown: ROS map: what cells are taken for that the map does not know.
        tolerance: ROS map: how far outlines may be from the cells' borders, metres; 0 keeps to the cells.
        size: Extents of the room, metres.
        margin: SDF: free floor around what stands there, where no four walls make a room, metres.
        open_floor: Build no walls where the file has none.
        starts: Where episodes begin, instead of at random.
        goals: Where episodes are to end, instead of at random.
    """
    from navsim.convert import Room, import_file

    room = Room(size, margin, not open_floor, starts, goals)
    with busy("importing"):
        path, world, notes = import_file(
            file,
            output,
            format=format,
            room=room,
            model_paths=model_path,
            visual=visual,
            approximate=approximate,
            pushable=pushable,
            height=height,
            unknown=unknown,
            tolerance=tolerance,
        )
    for note in notes:
        print(f"- {note}")
    print(f"{path}: {world}")


@world_commands.command
def export(
    world: Annotated[Positional[str], arg(metavar="WORLD")],
    output: Annotated[Path, arg(aliases=["-o"], metavar="FILE")],
    format: Annotated[
        Literal["sdf", "mjcf", "ros-map"] | None, arg(help_behavior_hint="(default: what the suffix says)")
    ] = None,
    resolution: Annotated[float | None, arg(help_behavior_hint="(default: 0.05)")] = None,
    heights: Annotated[
        tuple[float, float] | None, arg(metavar="LOW HIGH", help_behavior_hint="(default: 0 to 0.42, the robot's)")
    ] = None,
) -> None:
    """Write a world for Gazebo (.sdf, .world), MuJoCo (.xml) or ROS (.yaml, with a .pgm beside it).

    What cannot be kept is named, one line each. For example:

    navsim world export my_room.yaml -o my_room.sdf

    navsim world export my_room.yaml -o maps/my_room.yaml --resolution 0.02 --heights 0.15 0.2

    Args:
        world: World file, or name of a shipped world.
        output: File to write.
        format: Format of the file.
        resolution: ROS map: side of a cell, metres.
        heights: ROS map: obstacles with something between these heights are on it, metres. A laser scanner sees what
            is at its own height; the robot bumps into what is between the floor and its top.
    """
    from navsim import load_world
    from navsim.convert import export_world

    for note in export_world(load_world(world), output, format, resolution=resolution, heights=heights):
        print(f"- {note}")
    print(output)
