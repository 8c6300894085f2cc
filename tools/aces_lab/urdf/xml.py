"""XML of strangers as a small tree, read within bounds.

1. A document type is refused, so that no entity is ever defined, expanded or fetched.
2. Size, depth and the number of elements are bounded; a file that is not a regular file is not opened.
3. Every element knows its line.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NoReturn
from xml.parsers import expat

from aces_bus.errors import CallerError
from aces_bus.plain_text import printable

#: Bytes of a file. The largest of the public models that the tests read has 211 kB.
LARGEST: Final = 8 * 2**20
#: Elements within one another, and in a file.
DEEPEST: Final = 32
MOST: Final = 100_000


@dataclass
class Element:
    """An element: its tag, attributes, line (from 1) and children; text between tags is not kept."""

    tag: str
    attributes: dict[str, str]
    file: str
    line: int
    children: list[Element] = field(default_factory=list["Element"])

    def all(self, tag: str) -> list[Element]:
        """Return the children with a tag."""
        return [child for child in self.children if child.tag == tag]

    def child(self, tag: str) -> Element | None:
        """Return the first child with a tag."""
        return next((child for child in self.children if child.tag == tag), None)

    def fail(self, text: str) -> NoReturn:
        """Raise `CallerError` with file and line."""
        raise CallerError(f"{self.file}:{self.line}: <{printable(self.tag)[:60]}>: {text}")


def read_file(path: str) -> bytes:
    """Return the bytes of a regular file of at most `LARGEST` bytes; raises `CallerError`."""
    try:
        if not Path(path).is_file():
            raise CallerError(f"{path}: not a file" if Path(path).exists() else f"{path}: no such file")
        with open(path, "rb") as stream:
            data = stream.read(LARGEST + 1)
    except (OSError, ValueError) as error:
        raise CallerError(f"{path}: {getattr(error, 'strerror', None) or error}") from error
    return data


def parse_xml(data: bytes, file: str) -> Element:
    """Return the outermost element. Raises `CallerError` with file and line."""
    if len(data) > LARGEST:
        raise CallerError(f"{file}: larger than a description may be ({LARGEST >> 20} MiB)")
    parser = expat.ParserCreate()
    open_elements: list[Element] = []
    top: list[Element] = []
    count = 0

    def begin(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        element = Element(tag, attributes, file, parser.CurrentLineNumber)
        if len(open_elements) >= DEEPEST or count > MOST:
            element.fail(f"more than {DEEPEST} elements within one another, or {MOST} in all")
        (open_elements[-1].children if open_elements else top).append(element)
        open_elements.append(element)

    def refuse(*_: object) -> NoReturn:
        raise CallerError(
            f"{file}:{parser.CurrentLineNumber}: a document type (<!DOCTYPE>) is refused: it may define entities;"
            " remove it"
        )

    parser.StartElementHandler = begin
    parser.EndElementHandler = lambda tag: open_elements.pop()
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        text = expat.ErrorString(error.code)
        raise CallerError(f"{file}:{error.lineno}: not XML that can be read: {text}") from error
    except (LookupError, ValueError) as error:  # an encoding that does not exist
        raise CallerError(f"{file}: not XML that can be read: {error}") from error
    return top[0]
