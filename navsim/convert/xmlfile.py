"""XML files from strangers: plain elements with their lines; no entities, no document types, no bottomless nesting.

The standard library's expat does the parsing. A document type is refused where it begins, before any entity can be
declared, so nothing is ever expanded or fetched.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator
from xml.parsers import expat
from xml.sax.saxutils import escape

from navsim.convert.errors import ConversionError
from navsim.convert.textfile import read_bytes
from navsim.errors import counted

DEEPEST_NESTING = 100
"""Elements inside one another."""
MOST_ELEMENTS = 200_000
"""Of one file, and of all that one world includes, counted as often as they are included."""
LONGEST_TAG = 4_096
"""Bytes of an element's begin, attributes included."""
LONGEST_WORDS = 1_000
"""Characters of an element that holds a name."""
_ENDLESS_TAG = re.compile(rb"<[^<>!?][^<>]{%d}" % LONGEST_TAG)
LARGEST_NUMBER = 1e9
"""Numbers beyond it are taken for slips of the pen."""


class Element:
    """One element, with the file and line where it begins."""

    __slots__ = ("attributes", "children", "count", "file", "line", "tag", "text")

    def __init__(self, tag: str, attributes: dict[str, str], file: str, line: int) -> None:
        self.tag, self.attributes, self.file, self.line = tag, attributes, file, line
        self.count = 0
        """Of a root: how many elements its file has, each attribute counted as one."""
        self.text = ""
        self.children: list[Element] = []

    @property
    def name(self) -> str:
        """Its ``name`` attribute, or its tag if it has none."""
        return self.attributes.get("name") or self.tag

    def all(self, *tags: str) -> Iterator[Element]:
        """Its children with one of these tags, in order."""
        return (child for child in self.children if child.tag in tags)

    def first(self, tag: str) -> Element | None:
        """Its first child with this tag."""
        return next(self.all(tag), None)

    def child(self, tag: str) -> Element:
        """Its first child with this tag.

        Raises:
            ConversionError: when there is none.
        """
        found = self.first(tag)
        if found is None:
            raise self.error(f"<{self.tag}> lacks <{tag}>; add it")
        return found

    def words(self, tag: str, default: str = "") -> str:
        """The text of its first child with this tag.

        Raises:
            ConversionError: when it is longer than any name.
        """
        found = self.first(tag)
        if found is None:
            return default
        if len(found.text) > LONGEST_WORDS:
            raise found.error(f"<{tag}> is longer than {LONGEST_WORDS} characters; shorten it")
        return found.text.strip()

    def numbers(self, count: int) -> list[float]:
        """Its text as ``count`` numbers.

        Raises:
            ConversionError: when it is anything else.
        """
        return self.numbers_in(self.text, count)

    def numbers_in(self, text: str, count: int, where: str = "") -> list[float]:
        """``count`` numbers in a text of this element, such as an attribute's."""
        words = text.split()
        what = where or f"<{self.tag}>"
        if len(words) != count:
            wanted = counted(count, "number")
            raise self.error(f"{what} must hold {wanted}, not {_shown(text)}")
        values = []
        for word in words:
            try:
                value = float(word)
            except ValueError:
                raise self.error(f"{what} must hold numbers, not {_shown(word)}") from None
            if not math.isfinite(value) or abs(value) > LARGEST_NUMBER:
                raise self.error(f"{what} must hold finite numbers up to {LARGEST_NUMBER:g}, not {_shown(word)}")
            values.append(value)
        return values

    def number(self, tag: str, default: float | None = None) -> float:
        """The number in its first child with this tag."""
        found = self.first(tag)
        if found is None and default is not None:
            return default
        return (found or self.child(tag)).numbers(1)[0]

    def length(self, tag: str) -> float:
        """The positive number in its first child with this tag, metres."""
        value = self.number(tag)
        if value <= 0.0:
            raise self.child(tag).error(f"<{tag}> must be greater than 0, not {value:g}")
        return value

    def flag(self, tag: str, default: bool = False) -> bool:
        """The truth value in its first child with this tag."""
        found = self.first(tag)
        return default if found is None else found.truth(found.text)

    def truth(self, text: str) -> bool:
        """A truth value in a text of this element."""
        word = text.strip().lower()
        if word in ("1", "true"):
            return True
        if word in ("0", "false"):
            return False
        raise self.error(f"<{self.tag}> must be true or false, not {_shown(text)}")

    def error(self, text: str) -> ConversionError:
        """What is wrong with this element, to be raised."""
        return ConversionError(self.file, self.line, text)


def read_xml(path: str | os.PathLike[str]) -> Element:
    """The root element of an XML file.

    Raises:
        ConversionError: when it cannot be read, is not XML, or holds what no honest file of this kind does.
    """
    content, file = read_bytes(path), str(path)
    parser = expat.ParserCreate()
    parser.buffer_text = True
    open_elements: list[Element] = []
    open_texts: list[list[str]] = []
    roots: list[Element] = []
    count = 0

    def begin(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count
        element = Element(tag, attributes, file, parser.CurrentLineNumber)
        count += 1 + len(attributes)
        if count > MOST_ELEMENTS:
            raise element.error(f"holds more than {MOST_ELEMENTS} elements and attributes; split it")
        if len(open_elements) >= DEEPEST_NESTING:
            raise element.error(f"elements are nested more than {DEEPEST_NESTING} deep; flatten them")
        (open_elements[-1].children if open_elements else roots).append(element)
        open_elements.append(element)
        open_texts.append([])

    def end(tag: str) -> None:
        open_elements.pop().text = "".join(open_texts.pop())

    def characters(text: str) -> None:
        open_texts[-1].append(text)

    def doctype(*_: object) -> None:
        line = parser.CurrentLineNumber
        raise ConversionError(file, line, "holds a document type (<!DOCTYPE …>), which is not read; remove it")

    parser.StartElementHandler, parser.EndElementHandler = begin, end
    parser.CharacterDataHandler, parser.StartDoctypeDeclHandler = characters, doctype
    # Expat reads a tag as a whole before it tells of any of its attributes.
    endless = _ENDLESS_TAG.search(content)
    if endless is not None:
        line = content.count(b"\n", 0, endless.start()) + 1
        raise ConversionError(file, line, f"a tag is longer than {LONGEST_TAG} bytes; leave attributes out")
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        reason = expat.ErrorString(error.code)
        raise ConversionError(file, error.lineno, f"not XML: {reason}; check the tags before this place") from None
    except (LookupError, ValueError) as error:  # an encoding that Python does not know, or has no table for
        if isinstance(error, ConversionError):
            raise
        raise ConversionError(file, 1, f"cannot be decoded ({error}); save it with UTF-8 encoding") from None
    roots[0].count = count
    return roots[0]


class XmlWriter:
    """Indented XML, element by element."""

    def __init__(self) -> None:
        self.lines = ['<?xml version="1.0" encoding="utf-8"?>']
        self._open: list[str] = []

    def open(self, tag: str, **attributes: object) -> None:
        """Begins an element that holds others."""
        self.lines.append(f"{self._indent}<{tag}{_attributes(attributes)}>")
        self._open.append(tag)

    def close(self, count: int = 1) -> None:
        """Ends the innermost ``count`` elements."""
        for _ in range(count):
            tag = self._open.pop()
            self.lines.append(f"{self._indent}</{tag}>")

    def leaf(self, tag: str, text: object = None, **attributes: object) -> None:
        """An element that holds a text, or nothing."""
        begin = f"{self._indent}<{tag}{_attributes(attributes)}"
        self.lines.append(f"{begin}/>" if text is None else f"{begin}>{escape(_legal(str(text)))}</{tag}>")

    def comment(self, text: str) -> None:
        """A remark for whoever reads the file."""
        self.lines.append(f"{self._indent}<!-- {_legal(text).replace('--', '- -')} -->")

    @property
    def text(self) -> str:
        """The whole document."""
        return "\n".join(self.lines) + "\n"

    @property
    def _indent(self) -> str:
        return "  " * len(self._open)


def _attributes(attributes: dict[str, object]) -> str:
    quotes = {'"': "&quot;", "\n": "&#10;", "\t": "&#9;"}
    return "".join(f' {key}="{escape(_legal(str(value)), quotes)}"' for key, value in attributes.items())


def _legal(text: str) -> str:
    """``text`` without what XML 1.0 has no way to hold."""
    return "".join(
        c if c in "\t\n" or " " <= c <= "\ud7ff" or "\ue000" <= c <= "\ufffd" or c >= "\U00010000" else "�"
        for c in text
    )


def number(value: float) -> str:
    """A number in ten digits: millimetres' thousandths in a world of ten kilometres.

    >>> number(0.1 + 0.2), number(-0.0)
    ('0.3', '0')
    """
    return f"{value + 0.0:.10g}" if value else "0"


def numbers(*values: float) -> str:
    """Numbers with blanks between them."""
    return " ".join(number(value) for value in values)


def _shown(text: str) -> str:
    text = " ".join(text.split())
    return f"'{text[:40]}…'" if len(text) > 40 else f"'{text}'"
