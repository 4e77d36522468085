"""How a file of another format is refused: in one sentence that names file, line, what is wrong there, and a remedy."""

from __future__ import annotations


class ConversionError(ValueError):
    """A file that cannot be read, or a world that cannot be written.

    Args:
        file: the file's name.
        line: where in it, counted from 1; 0 for the file as a whole.
        text: what is wrong and what to do about it.
    """

    def __init__(self, file: str, line: int, text: str) -> None:
        place = f"{file}:{line}" if line else file
        super().__init__(f"{place}: {text}")
