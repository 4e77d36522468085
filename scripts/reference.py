"""Writes the format reference in docs/worlds.md and the schema in worlds/ anew, after a change of the models.

python scripts/reference.py
"""

from pathlib import Path

import tyro

from navsim.schema import reference, schema_text

BEGIN, END = "<!-- reference: written by scripts/reference.py -->\n\n", "\n<!-- end of the reference -->\n"
ROOT = Path(__file__).resolve().parents[1]


def main() -> None:
    """Write the format reference in docs/worlds.md, between its two marks, and the schema in worlds/ anew."""
    page = ROOT / "docs" / "worlds.md"
    before, _, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    page.write_text(before + BEGIN + reference() + END + rest.partition(END)[2], encoding="utf-8")
    (ROOT / "worlds" / "world.schema.json").write_text(schema_text(), encoding="utf-8")


if __name__ == "__main__":
    tyro.cli(main)
