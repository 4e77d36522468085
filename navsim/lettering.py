"""Names in pictures, in whatever letters: matplotlib's own font has no Chinese, Japanese or Korean ones."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import Any, NamedTuple

from matplotlib import rcParams
from matplotlib.font_manager import FontEntry, FontProperties, findfont, fontManager, get_font

_UNKNOWN = "▯"
_NO_LETTERS = ("Last Resort",)  # matplotlib's font of boxes that stand for what no font has


class Lettering(NamedTuple):
    """A text as it can be drawn."""

    text: str
    """With a box for each letter that no installed font has, about which matplotlib would warn each time."""
    families: list[str]
    """Of fonts, as an artist's ``fontfamily``: matplotlib's, then those with letters that it lacks."""


def lettering(text: str) -> Lettering:
    """How to draw a name that comes from a file."""
    own = list(rcParams["font.family"])
    missing = frozenset(text) - _known(text, _own_fonts(tuple(own)))
    families = []
    while missing:
        family, has = _best(missing)
        if not has:
            break
        families.append(family)
        missing -= has
    return Lettering("".join(_UNKNOWN if letter in missing else letter for letter in text), own + families)


def _known(letters: Iterable[str], files: Iterable[str]) -> frozenset[str]:
    """Those of the letters that one of the fonts has."""
    codes = {letter: ord(letter) for letter in letters}
    return frozenset(
        letter for letter, code in codes.items() if letter.isspace() or any(code in _charmap(file) for file in files)
    )


def _own_fonts(families: tuple[str, ...]) -> tuple[str, ...]:
    """Files of the fonts that matplotlib writes with, one after the other for what the one before it lacks."""
    settings: Any = rcParams  # whose keys mypy wants to be literal
    names = [name for family in families for name in settings.get(f"font.{family}", [family])]
    installed = {entry.name for entry in fontManager.ttflist}
    return tuple(findfont(FontProperties(family=name)) for name in names if name in installed)


@lru_cache(maxsize=256)
def _best(letters: frozenset[str]) -> tuple[str, frozenset[str]]:
    """The installed family that has most of the letters, and which."""
    family, most = "", frozenset[str]()
    for entry in sorted(fontManager.ttflist, key=_oddity):
        if not entry.name.startswith(_NO_LETTERS):
            has = _known(letters, [entry.fname])
            if len(has) > len(most):
                family, most = entry.name, has
    return family, most


def _oddity(entry: FontEntry) -> tuple[bool, bool]:
    return entry.style != "normal", str(entry.weight) not in ("400", "normal", "regular")


@lru_cache(maxsize=1024)
def _charmap(file: str) -> frozenset[int]:
    """The code points that a font has letters for; none where it is a font that cannot be scaled, or read."""
    try:
        font = get_font(file)
        return frozenset(font.get_charmap()) if font.scalable else frozenset()
    except (OSError, RuntimeError):
        return frozenset()
