"""Text of Python, line by line: what the printers write into.

1. The printers decide nothing: the same plan gives the same text, byte for byte.
2. What is printed is meant to be read: one function a message, one line a field.
3. User objects (constructs, tables of enumerations) enter by name, never by repr.
"""

from __future__ import annotations


class Source:
    """Lines of Python with an indentation."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.depth = 0

    def line(self, text: str = "") -> None:
        self.lines.append("    " * self.depth + text if text else "")

    def text(self) -> str:
        return "\n".join(self.lines) + "\n"


def first_line(doc: str) -> str:
    return doc.strip().split("\n", 1)[0].replace("\\", "\\\\").replace('"', "'")
