"""Reading the bytes of small text files."""

from __future__ import annotations

import os
from pathlib import Path

from navsim.convert.errors import ConversionError

LARGEST_TEXT = 64 * 2**20
"""Bytes of a file that is read as text."""


def read_bytes(path: str | os.PathLike[str], largest: int = LARGEST_TEXT) -> bytes:
    """What a file holds.

    Raises:
        ConversionError: when it cannot be read, or is larger than ``largest`` bytes.
    """
    file = Path(path)
    try:
        if file.is_dir():
            raise ConversionError(str(path), 0, "is a directory; name a file in it")
        with file.open("rb") as stream:
            content = stream.read(largest + 1)
    except (OSError, ValueError) as error:
        if isinstance(error, ConversionError):
            raise
        reason = getattr(error, "strerror", None) or str(error)
        raise ConversionError(str(path), 0, f"cannot be read ({reason}); check the name") from None
    if len(content) > largest:
        raise ConversionError(str(path), 0, f"is larger than {largest // 2**20} MiB; split it")
    return content
