"""The commands under ``navsim world``: what can be done with world files from a terminal.

What takes long to import is imported where it is used: ``navsim --help`` answers at once. Annotations are not deferred
here, because tyro reads them.
"""

from pathlib import Path
from typing import Annotated

from tyro.conf import FlagCreatePairsOff, Positional, arg
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
