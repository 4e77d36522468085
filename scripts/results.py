"""The page of results: python scripts/results.py --help"""

import sys
from pathlib import Path

import tyro
from rich.console import Console

from rl.results import write_results


def main(results: Path = Path("docs/results"), page: Path = Path("docs/results.md")) -> None:
    """Write the page of results from what was trained and measured so far.

    The baselines are driven once, which takes some minutes.

    Args:
        results: Directory with the JSON of scripts/ablations.py and scripts/reproduce.py.
        page: Markdown file to write.
    """
    try:
        write_results(results, page, Console())
    except (OSError, ValueError) as error:
        sys.exit(str(error))


if __name__ == "__main__":
    tyro.cli(main)
