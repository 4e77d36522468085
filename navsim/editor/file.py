"""The file behind the page: read once, written only by whoever knows what it holds."""

from __future__ import annotations

import difflib
import hashlib
import os
import re
from pathlib import Path
from typing import NamedTuple

from navsim.editor.patch import EditError, patched
from navsim.errors import WorldError
from navsim.files import write_text
from navsim.worldfile import SHIPPED_WORLDS_DIRECTORY, plain_scalar, shipped_worlds

LARGEST_TEXT = 4 * 2**20
"""Bytes of a file that the editor opens."""
TEMPLATE = """\
format: 1
name: {name}
size: [6.0, 6.0]           # room, metres; the origin is its centre

obstacles:
  - box: {{name: crate, at: [1.0, 0.8], size: [0.8, 0.6], height: 0.5, yaw_deg: 20}}
  - cylinder: {{name: post, at: [-0.9, 1.2], radius: 0.1, height: 1.5}}

starts:
  - {{at: [-2.0, -2.0], yaw_deg: 45}}
goals:
  - [2.0, 2.0]
"""
"""What a new file begins with."""

_BREAK = re.compile(r"\r\n|\n|\r")


class FileState(NamedTuple):
    """What a file held when somebody looked."""

    text: str
    """With line feeds only, without a byte order mark."""
    stamp: str
    """Names the very bytes of the file; empty for one that does not exist."""


class ChangedOnDiskError(Exception):
    """The file holds something else than whoever wants to write it believes."""

    def __init__(self, message: str, state: FileState) -> None:
        super().__init__(message)
        self.state = state


class EditedFile:
    """A world file that is edited.

    Args:
        path: of the file; it need not exist yet.
        like: a world file, or name of a shipped world, that a new file begins as a copy of.

    Raises:
        WorldError: for a path that cannot become a world file, or one that is not UTF-8 text.
    """

    def __init__(self, path: str | os.PathLike[str], like: str | None = None) -> None:
        self.path = Path(path)
        if self.path.is_dir():
            raise WorldError([f"{path}: is a directory, not a world file; name a file such as 'room.yaml'"])
        if not self.path.exists():
            self._refuse_odd_names(path)
        elif like is not None:
            raise WorldError([f"{path}: exists already; leave out --like, or name a new file"])
        self._like = like
        self.state()

    def _refuse_odd_names(self, path: str | os.PathLike[str]) -> None:
        if str(path) in shipped_worlds():
            raise WorldError(
                [f"{path}: is a shipped world; edit a copy: navsim world edit my_{path}.yaml --like {path}"]
            )
        if self.path.suffix not in (".yaml", ".yml"):
            raise WorldError([f"{path}: there is no such file; name a new one with .yaml at its end"])
        if not self.path.parent.is_dir():
            raise WorldError([f"{path}: there is no directory {self.path.parent}; make it first"])

    def state(self) -> FileState:
        """What the file holds now; for one that does not exist, what it shall begin with.

        Raises:
            WorldError: for a file that cannot be read as text.
        """
        content = self._content()
        if content is None:
            return FileState(self._beginning(), "")
        return FileState(_BREAK.sub("\n", _decoded(content, self.path)), _stamp(content))

    def save(self, text: str, stamp: str) -> FileState:
        """Writes ``text``: to a temporary file beside this one, which then takes its name and permissions.

        Lines that are as they were keep their line breaks, and a byte order mark stays.

        Args:
            text: with line feeds only.
            stamp: of the state that ``text`` was made from.

        Raises:
            ChangedOnDiskError: if the file is no longer in that state; nothing is written.
            OSError: if the system refuses.
        """
        content = self._content()
        now = _stamp(content) if content is not None else ""
        if now != stamp:
            what = "has been changed by another program" if content is not None else "has been deleted"
            raise ChangedOnDiskError(f"{self.path} {what} since it was read", self.state())
        new = _with_breaks_of(_decoded_loosely(content), text)
        write_text(self.path, new)
        return FileState(text, _stamp(new.encode()))

    def _content(self) -> bytes | None:
        try:
            with self.path.open("rb") as file:
                content = file.read(LARGEST_TEXT + 1)
        except FileNotFoundError:
            return None
        except OSError as error:
            raise WorldError([f"{self.path}: cannot be read ({error.strerror}); see to its permissions"]) from None
        if len(content) > LARGEST_TEXT:
            raise WorldError([f"{self.path}: is larger than {LARGEST_TEXT // 2**20} MiB; edit it in a text editor"])
        return content

    def _beginning(self) -> str:
        name = self.path.stem if re.fullmatch(r"[A-Za-z]\w*", self.path.stem) else "room"
        if self._like is None:
            return TEMPLATE.format(name=name if isinstance(plain_scalar(name), str) else f'"{name}"')
        shipped = SHIPPED_WORLDS_DIRECTORY / f"{self._like}.yaml"
        source = shipped if self._like in shipped_worlds() else Path(self._like)
        try:
            text = _BREAK.sub("\n", _decoded(source.read_bytes(), source))
        except FileNotFoundError:
            choice = ", ".join(shipped_worlds())
            raise WorldError([f"{self._like}: there is no such world; name a file or one of {choice}"]) from None
        except OSError as error:
            raise WorldError([f"{self._like}: cannot be read ({error.strerror})"]) from None
        try:
            return patched(text, [{"op": "set", "where": [], "values": {"name": name}}])
        except EditError:  # a text that cannot be read is to be put right first
            return text


def _decoded(content: bytes, path: Path) -> str:
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise WorldError([f"{path}:{line}: is not UTF-8 text; save the file with UTF-8 encoding"]) from None


def _decoded_loosely(content: bytes | None) -> str:
    return content.decode("utf-8", errors="replace") if content else ""


def _stamp(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _with_breaks_of(old: str, text: str) -> str:
    """``text``, whose lines end in line feeds, with the line breaks and the byte order mark of ``old``."""
    mark = "\ufeff" if old.startswith("\ufeff") else ""
    breaks = _BREAK.findall(old)
    kinds = sorted(set(breaks), key=breaks.count)
    if kinds in ([], ["\n"]):
        return mark + text
    usual = kinds[-1]
    if len(kinds) == 1:
        return mark + text.replace("\n", usual)
    before, after = _BREAK.split(old.removeprefix("\ufeff")), text.split("\n")
    chosen = [usual] * len(after)
    for block in difflib.SequenceMatcher(None, before, after, autojunk=False).get_matching_blocks():
        for i in range(block.size):
            if block.a + i < len(breaks):
                chosen[block.b + i] = breaks[block.a + i]
    return mark + "".join(line + end for line, end in zip(after, [*chosen[: len(after) - 1], ""], strict=True))
