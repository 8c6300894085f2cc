"""Where in a spec something was written, for messages of the form `file:line: …`.

Messages and our own fields remember the line that made them. A plain construct cannot, so the line of a named field is
looked up in the source, by its name, inside the expression of its message; only when a message is wrong.
"""

from __future__ import annotations

import ast
import linecache
import os
import sys
from dataclasses import dataclass
from pathlib import Path

_CORE = str(Path(__file__).resolve().parents[1])


@dataclass(frozen=True)
class SourceLine:
    """A line of a file."""

    file: str
    line: int

    def __str__(self) -> str:
        shown = os.path.relpath(self.file)
        return f"{self.file if shown.startswith('..') else shown}:{self.line}"

    @property
    def stable(self) -> str:
        """The place as generated source names it: the same on every machine, from the outermost package."""
        path = Path(self.file)
        top = path.parent
        while (top / "__init__.py").exists():
            top = top.parent
        return f"{path.relative_to(top).as_posix()}:{self.line}"

    def of_field(self, name: str) -> SourceLine:
        """The line where field `name` is written in the expression that starts here; this place when not found."""
        source = "".join(linecache.getlines(self.file))
        try:
            tree = ast.parse(source)
        except SyntaxError:
            return self
        calls = [
            n
            for n in ast.walk(tree)
            if isinstance(n, ast.Call) and n.lineno <= self.line <= (n.end_lineno or 0)
        ]
        calls.sort(key=lambda n: (n.end_lineno or 0) - n.lineno, reverse=True)
        starts = [n for n in calls if n.lineno == self.line] or calls
        for call in starts:
            for node in ast.walk(call):
                if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Div):
                    if isinstance(node.left, ast.Constant) and node.left.value == name:
                        return SourceLine(self.file, node.lineno)
        return self


def caller() -> SourceLine:
    """The innermost line outside the protocol core and construct: the spec's own line."""
    frame = sys._getframe(1)  # pyright: ignore[reportPrivateUsage]  # `inspect` reads files
    while frame.f_back is not None:
        name = frame.f_code.co_filename
        inside = name.startswith(_CORE) or f"{os.sep}construct{os.sep}" in name
        if not inside:
            break
        frame = frame.f_back
    return SourceLine(frame.f_code.co_filename, frame.f_lineno)
