"""What faults that a policy does not know of cost it: python scripts/faults.py --help (half an hour on one core)"""

import sys
from pathlib import Path

import tyro
from rich.console import Console

from rl.fault_study import NUM_PATHS, POLICIES, run


def main(
    policies: tuple[str, ...] = POLICIES,
    world: str | None = None,
    num_paths: int = NUM_PATHS,
    results: Path = Path("docs/results/faults.json"),
    page: Path = Path("docs/faults.md"),
    picture: Path = Path("docs/images/faults.png"),
) -> None:
    """Drive policies with a camera mounted otherwise, unequal wheels, late and noisy images, and write a page on it.

    Args:
        policies: Directories of runs, pretrained:NAME, or baselines.
        world: World file, name of a shipped world, or generated rooms; by default the unseen rooms of the results.
        num_paths: How many paths to drive with each fault.
        results: JSON file to write.
        page: Markdown file to write.
        picture: Image file to write.
    """
    where = {} if world is None else {"world": world}
    try:
        run(
            Console(),
            policies=policies,
            num_paths=num_paths,
            results=results,
            page=page,
            picture=picture,
            **where,
        )
    except (ValueError, OSError) as error:
        sys.exit(str(error))


if __name__ == "__main__":
    tyro.cli(main)
