"""The commands under ``navsim world``: what can be done with world files from a terminal.

What takes long to import is imported where it is used: ``navsim --help`` answers at once. Annotations are not deferred
here, because tyro reads them.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

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
