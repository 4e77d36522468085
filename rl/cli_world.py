"""The commands under ``navsim world``: what can be done with world files from a terminal.

What takes long to import is imported where it is used: ``navsim --help`` answers at once. Annotations are not deferred
here, because tyro reads them.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, Literal

from tyro.conf import FlagCreatePairsOff, Positional, UseAppendAction, arg
from tyro.extras import SubcommandApp

from rl.console import busy

world_commands = SubcommandApp()


@world_commands.command
def check(
    files: Positional[tuple[str, ...]] = (),
    strict: FlagCreatePairsOff[bool] = False,
    solve: FlagCreatePairsOff[bool] = False,
    paths: FlagCreatePairsOff[bool] = False,
    json: FlagCreatePairsOff[bool] = False,
) -> None:
    """Say everything that is wrong or odd about world files, with its place, and what the rooms are like.

    The exit status is 0, or 2 if a file breaks the rules, or 1 with --strict if one is only odd.

    Args:
        files: World files, or names of shipped worlds; all of the latter if there is none.
        strict: Let warnings fail.
        solve: Have the planning oracle, which knows the map, drive every path, and warn of those it cannot. It takes
            0.2 to 1 s a path.
        paths: Print each path's length and narrowest passage as well. That passage is the narrowest one on the widest
            way from start to goal, which need not be the shortest way.
        json: Print one JSON document instead, with a report for each file.
    """
    from rich.console import Console
    from rich.progress import track

    from navsim import shipped_worlds
    from navsim.check import check_files
    from navsim.diagnostics import print_reports
    from rl.console import Output

    errors = Console(stderr=True, highlight=False)

    def progress(items: Iterable[Any], total: int) -> Iterable[Any]:
        return track(items, "solving", total=total, console=errors, transient=True)

    reports = check_files(files or shipped_worlds(), solve=solve, progress=progress)
    status = print_reports(reports, Output(highlight=False), errors, paths=paths, json=json, strict=strict)
    if status:
        raise SystemExit(status)


@world_commands.command
def schema(
    output: Annotated[
        Path | None, arg(aliases=["-o"], metavar="FILE", help_behavior_hint="(default: print it)")
    ] = None,
    markdown: FlagCreatePairsOff[bool] = False,
) -> None:
    """Print the world file format as JSON Schema, which gives completion and hover in an editor.

    With the YAML extension of VS Code, write "# yaml-language-server: $schema=world.schema.json" into the first line of
    a world file, after "navsim world schema -o world.schema.json" beside it.

    Args:
        output: File to write instead.
        markdown: The format as a reference page in Markdown.
    """
    from navsim.files import write_text
    from navsim.schema import reference, schema_text

    text = reference() if markdown else schema_text()
    if output is None:
        print(text, end="")
    else:
        write_text(output, text)
        print(output)


@world_commands.command
def show(
    file: Positional[str],
    output: Annotated[
        Path | None, arg(aliases=["-o"], metavar="FILE", help_behavior_hint="(default: FILE's name with .png, here)")
    ] = None,
    names: bool = True,
    camera: Annotated[str | None, arg(metavar="X,Y,YAW", help_behavior_hint="(optional)")] = None,
) -> None:
    """Draw a world from above, with the shortest path between every start and goal.

    Obstacles are coloured by height; what is lower than the camera and what the robot passes under is hatched.

    Args:
        file: World file, or name of a shipped world.
        output: Picture to write, in the format that its suffix says: .png, .svg, .pdf.
        names: Write the obstacles' names on them.
        camera: Draw beside it what a robot sees there: x and y in metres, yaw in degrees, such as 1,-2.5,90.
    """
    from navsim import load_world
    from navsim.show import parse_pose, save_plan_view

    world = load_world(file)
    pose = None if camera is None else parse_pose(camera)
    with busy("drawing"):
        path = save_plan_view(world, output or Path(f"{Path(file).stem}.png"), names=names, pose=pose)
    print(path)


@world_commands.command
def edit(
    file: Positional[str],
    like: Annotated[str | None, arg(metavar="WORLD", help_behavior_hint="(default: a small template)")] = None,
    port: Annotated[int, arg(help_behavior_hint="(default: a free one)")] = 0,
    no_browser: FlagCreatePairsOff[bool] = False,
) -> None:
    """Edit a world file in the browser: the plan, what the robot sees, and the text, each of which changes the others.

    The page is served on this machine only, until Ctrl-C. The text keeps its comments and its order.

    Args:
        file: World file; a new one if it does not exist.
        like: World file, or name of a shipped world, that a new file begins as a copy of.
        port: Port of localhost.
        no_browser: Print the address of the page without opening it.
    """
    from navsim.editor.file import EditedFile
    from navsim.editor.server import edit as serve

    serve(EditedFile(file, like), port=port, open_browser=not no_browser)


@world_commands.command
def generate(
    kind: Literal["clutter", "blocks", "corridors", "office", "warehouse", "forest"] = "clutter",
    size: Annotated[str, arg(metavar="X,Y")] = "7,7",
    density: Annotated[float | None, arg(help_behavior_hint="(default: the kind's own)")] = None,
    seed: int = 0,
    count: int = 1,
    first: int = 1,
    out: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(default: KIND, here)")] = None,
    overview: bool = True,
    solve: bool = False,
) -> None:
    """Make rooms by chance that a robot can drive through, and write them as world files.

    Every start and goal of a room are joined by a way whose gaps are at least 1 m wide. The same settings make the same
    files. To train in such rooms no files are needed: navsim train --world generate:clutter,density=0.11,count=200

    Args:
        kind: Furniture and small things, a third of them low or raised; large boxes; a maze; or what the name says.
        size: Of a room, metres.
        density: Share of the floor that is covered; 0.11 as in complex_eval. Clutter has 24 obstacles in 7x7 m without.
        seed: Of all the rooms.
        count: Rooms to make.
        first: Number of the first room. Room 17 is the same whether it is made alone or among others.
        out: Directory to write them to, as KIND-0001.yaml and so on.
        overview: Draw the first rooms on one sheet, overview.png.
        solve: Have the planning oracle drive every path, and say where it finds no way; slow.
    """
    from navsim.generate import RoomSettings
    from navsim.worldsource import parse_size
    from rl.generating import generate_files

    settings = RoomSettings(kind, parse_size(size), density, seed)
    generate_files(settings, out or Path(kind), count=count, first=first, overview=overview, solve=solve)


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
    margin: Annotated[float | None, arg(help_behavior_hint="(default: 1)")] = None,
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
    from navsim.convert import export_file

    for note in export_file(world, output, format, resolution=resolution, heights=heights):
        print(f"- {note}")
    print(output)
