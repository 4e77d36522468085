"""The paths that a policy misses, drawn and explained: python scripts/failures.py --help"""

import sys
from pathlib import Path

import tyro
from rich.console import Console

from rl.failures import write_failures


def main(
    policy: str = "pretrained:I",
    /,
    world: str = "complex_eval",
    num_paths: int | None = None,
    page: Path = Path("docs/failures.md"),
    picture: Path = Path("docs/images/failures.png"),
) -> None:
    """Drive the paths of a world, and write a page on those that fail.

    Args:
        policy: Directory of a run, pretrained:NAME, or a baseline.
        world: World file, name of a shipped world, or generated rooms.
        num_paths: How many paths to drive; by default all, up to 1000 in several worlds.
        page: Markdown file to write.
        picture: Image file to write.
    """
    try:
        write_failures(policy, world, page, picture, num_paths=num_paths, console=Console())
    except (ValueError, OSError) as error:
        sys.exit(str(error))


if __name__ == "__main__":
    tyro.cli(main)
