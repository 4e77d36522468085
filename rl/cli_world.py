"""The commands under ``navsim world``: what can be done with world files from a terminal.

What takes long to import is imported where it is used: ``navsim --help`` answers at once. Annotations are not deferred
here, because tyro reads them.
"""

from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg
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
