"""Where in a spec something was written, for messages of the form `file:line: …`.

Messages and our own fields remember the line that made them. A plain construct cannot, so the line of a named field is
looked up in the source, by its name, inside the expression of its message; only when a message is wrong.
"""

from __future__ import annotations

import ast
import linecache
import os
import sys
from dataclasses import dataclass, field
from functools import lru_cache
from types import FrameType

_CORE = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))
_CONSTRUCT = f"{os.sep}construct{os.sep}"


@dataclass(frozen=True)
class SourceLine:
    """A line of a file."""

    file: str
    line: int
    #: Where this line led to, where that is another: the line of the helper function that it calls.
    inner: SourceLine | None = field(default=None, compare=False, repr=False)

    def __str__(self) -> str:
        shown = os.path.relpath(self.file)
        return f"{self.file if shown.startswith('..') else shown}:{self.line}"

    @property
    def stable(self) -> str:
        """The place as generated source names it: the same on every machine, from the outermost package."""
        top = os.path.dirname(self.file)
        while os.path.exists(os.path.join(top, "__init__.py")):
            top = os.path.dirname(top)
        return f"{self.file[len(top) :].lstrip(os.sep).replace(os.sep, '/')}:{self.line}"

    def of_field(self, name: str) -> SourceLine:
        """Return the line where field `name` is written in the expression that starts here; this place when not found."""
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
        if self.inner is not None and (found := self.inner.of_field(name)) != self.inner:
            return found
        return self


#: A function, or the body of a module: its file, first line and name.
Scope = tuple[str, int, str]


def caller(scope: Scope | None = None) -> SourceLine:
    """Return the innermost line outside the protocol core and construct: the spec's own line.

    With the `scope` of a protocol, the line there: where a helper function of the spec was called to declare a message, and
    fields are looked up in the helper.
    """
    frame = own = _own_frame()
    while scope is not None and _scope_of(frame) != scope and frame.f_back is not None:
        frame = frame.f_back
    inner = SourceLine(own.f_code.co_filename, own.f_lineno)
    if frame is own or _scope_of(frame) != scope:
        return inner
    return SourceLine(frame.f_code.co_filename, frame.f_lineno, inner)


def caller_scope() -> Scope:
    """Return the function or module whose line `caller` gives."""
    return _scope_of(_own_frame())


def _own_frame() -> FrameType:
    frame = sys._getframe(2)  # pyright: ignore[reportPrivateUsage]  # `inspect` reads files
    while frame.f_back is not None and _is_inside(frame.f_code.co_filename):
        frame = frame.f_back
    return frame


@lru_cache(maxsize=4096)
def _is_inside(file: str) -> bool:
    """Return whether a file is the protocol core's or construct's."""
    return file.startswith(_CORE) or _CONSTRUCT in file


def _scope_of(frame: FrameType) -> Scope:
    code = frame.f_code
    return code.co_filename, code.co_firstlineno, code.co_name
