"""Text of Python, line by line: what the printers write into.

1. The printers decide nothing: the same plan gives the same text, byte for byte.
2. What is printed is meant to be read: one function a message, one line a field.
3. What a spec says in words enters only as a remark, on one line; its values enter by name (see `names`).
"""

from __future__ import annotations


class SourceText:
    """Lines of Python with an indentation."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.depth = 0

    def line(self, text: str = "") -> None:
        self.lines.append("    " * self.depth + text if text else "")

    def text(self) -> str:
        return "\n".join(self.lines) + "\n"


def comment_line(text: str) -> str:
    """The first line of somebody's text, for a remark or a docstring: whatever could end one is spelt out."""
    first = text.strip().split("\n", 1)[0].replace("\\", "\\\\").replace('"', "'")
    return "".join(char if char.isprintable() else char.encode("unicode_escape").decode() for char in first)
