"""Files that are there as a whole or not at all."""

from __future__ import annotations

import errno
import os
import re
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

TEMPORARY = re.compile(r"\.(?P<target>.+)\.[a-z0-9_]{8}")
"""Names of the files that ``atomic_write`` leaves where the process is killed meanwhile; ``target`` had been meant."""


@contextmanager
def atomic_write(path: str | os.PathLike[str], mode: str = "w") -> Iterator[IO[Any]]:
    """A file that takes ``path``'s place when it is complete and on the disk, and leaves no trace when it is not.

    Directories that are missing are made. What a link points to is replaced, and the link stays; a file that is
    replaced hands its permissions on. What is no file, such as ``/dev/stdout`` or a pipe, is written to as it is.

    Args:
        path: of the file.
        mode: ``"w"``, UTF-8 with the line ends that are written, or ``"wb"``.

    Raises:
        OSError: if it cannot be written, or is read-only; what was there is as it was.
    """
    encoding, newline = (None, None) if "b" in mode else ("utf-8", "")
    place = Path(path)
    if place.exists() and not place.is_file() and not place.is_dir():  # where /dev/stdout leads to may have no path
        with place.open(mode, encoding=encoding, newline=newline) as file:
            yield file
        return
    if place.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if place.is_file() and not os.access(place, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
    target = Path(path).resolve()
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):  # whose words speak of the file, not of what is in its way
        above = (*Path(path).parents, *target.parents)  # the latter where a link leads elsewhere
        blocking = next(parent for parent in above if parent.exists() and not parent.is_dir())
        raise NotADirectoryError(errno.ENOTDIR, "is a file where a directory is needed", str(blocking)) from None
    try:
        handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
    except OSError as error:
        error.filename = str(path)  # not the temporary file's, which nobody has asked for
        raise
    try:
        with os.fdopen(handle, mode, encoding=encoding, newline=newline) as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.chmod(name, _permissions(target))  # mkstemp makes files that only their owner can read
        os.replace(name, target)
        flush_to_disk(target.parent)
    except BaseException as error:
        Path(name).unlink(missing_ok=True)
        if isinstance(error, OSError) and error.errno is not None and error.filename is None:  # such as of a full disk
            error.filename = str(path)
        raise


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Writes a whole file, as ``atomic_write`` does."""
    with atomic_write(path) as file:
        file.write(text)


def flush_to_disk(path: Path) -> None:
    """Has the system write a file's content, or a directory's list of names, to the disk, and waits for it."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _permissions(path: Path) -> int:
    """Those of the file at ``path``, or those that a new one gets."""
    try:
        return stat.S_IMODE(path.stat().st_mode)
    except FileNotFoundError:
        mask = os.umask(0)
        os.umask(mask)
        return 0o666 & ~mask
