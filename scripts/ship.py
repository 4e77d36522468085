"""Makes a policy that comes with the library: python scripts/ship.py --help"""

import sys
from pathlib import Path
from typing import Literal

import tyro
from rich.console import Console

from rl.pretrained import DIRECTORY
from rl.run import Run
from rl.shipping import ship


def main(
    run: Path,
    name: str,
    /,
    weights: Literal["best", "last"] = "last",
    symmetric: Literal["yes", "no"] | None = None,
    chosen: str = "",
    directory: Path = DIRECTORY,
) -> None:
    """Pack a run's policy, measure what the packed file does, and write its model card.

    Args:
        run: Directory of the run.
        name: What follows "pretrained:".
        weights: The run's last, which nothing was chosen by, or those that did best in its evaluations.
        symmetric: Whether it acts by the mean of its network's values for what it sees and for the mirror image; as its
            settings have it by default.
        chosen: A sentence for the card on how this run was chosen among others, if it was.
        directory: Where the file and its card go.
    """
    try:
        mirrors = None if symmetric is None else symmetric == "yes"
        shipped = Run.open(run)
        print(ship(shipped, directory, name, weights=weights, symmetric=mirrors, chosen=chosen, console=Console()))
    except (OSError, ValueError) as error:
        sys.exit(str(error))


if __name__ == "__main__":
    tyro.cli(main)
