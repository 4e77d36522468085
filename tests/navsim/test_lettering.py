"""Names in letters that matplotlib's own font lacks."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from matplotlib.font_manager import fontManager, get_font
from PIL import Image

from navsim.lettering import lettering
from navsim.overview import save_overview
from navsim.show import save_plan_view
from navsim.world import Box, World

CIRCLED = "Ⓐ"  # not in DejaVu Sans, but in STIX, which comes with matplotlib as well
NOWHERE = "\U00016fe4"  # a Khitan mark that no common font has


def test_letters_are_taken_from_installed_fonts():
    assert lettering("table 2, Größe") == ("table 2, Größe", ["sans-serif"])
    text, families = lettering(f"gate {CIRCLED}")
    assert text == f"gate {CIRCLED}"
    assert families[0] == "sans-serif"
    files = [entry.fname for entry in fontManager.ttflist if entry.name == families[1]]
    assert any(ord(CIRCLED) in get_font(file).get_charmap() for file in files)
    assert not families[1].startswith("Last Resort")


def test_what_no_font_has_is_a_box():
    assert lettering(f"a{NOWHERE}{CIRCLED}").text == f"a▯{CIRCLED}"


@pytest.mark.parametrize("name", [CIRCLED, "桌子", f"{NOWHERE}b", "$x_1$"])
def test_names_are_drawn_without_a_warning(name, tmp_path):
    world = World(size=(4, 4), name=name, obstacles=[Box(at=(0, 0), size=(1, 1), height=1, name=name)])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        save_plan_view(world, tmp_path / "a.png", names=True)
        save_overview([world], tmp_path / "b.png")
    assert np.asarray(Image.open(tmp_path / "b.png")).std() > 0
