"""The commands under ``navsim world``: what can be done with world files from a terminal.

What takes long to import is imported where it is used: ``navsim --help`` answers at once. Annotations are not deferred
here, because tyro reads them.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, Literal

from tyro.conf import FlagCreatePairsOff, Positional, arg
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
            about a second a path.
        paths: Print each path's length and narrowest passage as well. That passage is the narrowest one on the widest
            way from start to goal, which need not be the shortest way.
        json: Print one JSON document instead, with a report for each file.
    """
    from rich.console import Console
    from rich.progress import track

    from navsim import shipped_worlds
    from navsim.check import check_files
    from navsim.diagnostics import print_reports

    errors = Console(stderr=True, highlight=False)

    def progress(items: Iterable[Any], total: int) -> Iterable[Any]:
        return track(items, "solving", total=total, console=errors, transient=True)

    reports = check_files(files or shipped_worlds(), solve=solve, progress=progress)
    status = print_reports(reports, Console(highlight=False), errors, paths=paths, json=json, strict=strict)
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
    from navsim.schema import reference, schema_text
    from navsim.worldfile import write_atomically

    text = reference() if markdown else schema_text()
    if output is None:
        print(text, end="")
    else:
        write_atomically(output, text)
        print(output)


@world_commands.command
def show(
    file: Positional[str],
    output: Annotated[
        Path | None, arg(aliases=["-o"], metavar="FILE", help_behavior_hint="(default: WORLD.png, here)")
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
        path = save_plan_view(world, output or Path(f"{world.name}.png"), names=names, pose=pose)
    print(path)


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
        kind: What the rooms are like. clutter: furniture, cartons, cans and posts, a third of them lower than the
            camera or raised off the floor. blocks: large boxes. corridors: a maze of walls and doors. office: rooms
            with desks, chairs and cupboards. warehouse: rows of shelving, pallets. forest: trunks, logs and bushes.
        size: Of a room, metres.
        density: Share of the floor that is covered, seen from above; that of complex_eval is 0.11. Without it, clutter
            has 24 obstacles in 7 by 7 m.
        seed: Of all the rooms.
        count: Rooms to make.
        first: Number of the first room. Room 17 is the same whether it is made alone or among others.
        out: Directory to write them to, as KIND-0001.yaml and so on.
        overview: Draw the first rooms on one sheet, overview.png.
        solve: Have the planning oracle drive every path, and say where it finds no way (seconds for each room).
    """
    from navsim.generate import RoomSettings
    from navsim.worldsource import parse_size
    from rl.generating import generate_files

    settings = RoomSettings(kind, parse_size(size), density, seed)
    generate_files(settings, out or Path(kind), count=count, first=first, overview=overview, solve=solve)
