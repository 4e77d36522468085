"""The contact sheet of many worlds."""

from __future__ import annotations

import io

import pytest
from PIL import Image

from navsim import World, generate_worlds
from navsim.overview import save_overview


def test_every_world_is_on_the_sheet(tmp_path):
    worlds = list(generate_worlds("blocks", (4.0, 4.0), count=3))
    sizes = []
    for count in (1, 3):
        path = save_overview(worlds[:count], tmp_path / f"{count}.png")
        sizes.append(Image.open(io.BytesIO(path.read_bytes())).size)
    assert sizes[1][0] == 3 * sizes[0][0]


def test_a_sheet_needs_worlds_and_a_format_that_is_known(tmp_path):
    with pytest.raises(ValueError, match="an overview needs at least one world"):
        save_overview([], tmp_path / "none.png")
    with pytest.raises(ValueError, match="pictures are written as"):
        save_overview([World.from_dict({"format": 1, "size": [4, 4]})], tmp_path / "sheet.gif2")
