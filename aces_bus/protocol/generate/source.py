"""Text of Python, line by line: what the printers write into; and the names and values in it.

1. The printers decide nothing: the same plan gives the same text, byte for byte.
2. What is printed is meant to be read: one function a message, one line a field.
3. What a spec says in words enters only as a remark, on one line.
4. Every name in generated text comes from one `NameScope`: no two things can have the same, whatever a spec calls its own.
5. A spec's values enter generated text by name. Only what `literal` knows is printed: integers, finite floats of Python's
   own (which read back as what they are, and cost nothing as constants), bytes, and what is made of these.
"""

from __future__ import annotations

import builtins
import keyword
import linecache
import math
import re
from collections.abc import Collection, Mapping
from functools import lru_cache
from types import CodeType
from typing import Any

# ---------------------------------------------------------------------- compiling, for tracebacks and debuggers


def load_source(source: str, name: str, names: Mapping[str, Any]) -> dict[str, Any]:
    """Run printed source and give its namespace; `name` is what tracebacks call it."""
    name = comment_line(name)
    filename = f"<{name}>"
    linecache.cache[filename] = (len(source), None, source.splitlines(keepends=True), filename)
    # `__builtins__` comes along with exec; the text is ours, printed from a plan.
    namespace: dict[str, Any] = {"__name__": name, **names}
    exec(_compiled(source, filename), namespace)
    return namespace


@lru_cache(maxsize=512)
def _compiled(source: str, filename: str) -> CodeType:
    """Return the code of a source: a scanner more of one protocol prints what was compiled before."""
    return compile(source, filename, "exec")


# ---------------------------------------------------------------------- text


class SourceText:
    """Lines of Python with an indentation."""

    def __init__(self) -> None:
        self.printed: list[str] = []
        self.depth = 0

    def line(self, text: str = "") -> None:
        """Print one line at the present depth."""
        self.printed.append("    " * self.depth + text if text else "")

    def lines(self, *texts: str) -> None:
        """Print several lines."""
        for text in texts:
            self.line(text)

    def text(self) -> str:
        return "\n".join(self.printed) + "\n"


def comment_line(text: str) -> str:
    """Return the first line of a text, for a comment or a docstring: whatever could end one is escaped."""
    first = text.strip().split("\n", 1)[0].replace("\\", "\\\\").replace('"', "'")
    return "".join(char if char.isprintable() else char.encode("unicode_escape").decode() for char in first)


_PYTHON = frozenset([*keyword.kwlist, *keyword.softkwlist, *dir(builtins)])


class NameScope:
    """The names of a generated module, or (`inside` one) of a function in it.

    `bound` are the values that the module's text calls by name: they must be given to the text when it is run.
    """

    def __init__(self, taken: Collection[str] = (), *, inside: NameScope | None = None) -> None:
        self._taken = set(taken)
        self._module = inside
        self._shared: dict[tuple[str, str], str] = {}
        self.bound: dict[str, Any] = {} if inside is None else inside.bound

    def _has(self, name: str) -> bool:
        return name in self._taken or (name in _PYTHON if self._module is None else self._module._has(name))

    def new(self, wish: str, *, avoid: NameScope | None = None) -> str:
        """Return a name that nothing else has: `wish`, or with a number behind it; none of `avoid` either."""
        name, count = wish, 1
        while self._has(name) or (avoid is not None and avoid._has(name)):
            count += 1
            name = f"{wish}_{count}"
        self._taken.add(name)
        return name

    def shared(self, wish: str, content: str) -> tuple[str, bool]:
        """Return the module's name for what `content` says, and whether it is new: the same wish and content are one."""
        module = self._module if self._module is not None else self
        known = module._shared.get((wish, content))
        if known is not None:
            return known, False
        name = module.new(wish, avoid=self)
        module._shared[wish, content] = name
        return name, True

    def bind(self, wish: str, value: Any) -> tuple[str, bool]:
        """Give a value a name in the module; return the name, and whether it is new: the same wish and value are one."""
        module = self._module if self._module is not None else self
        count = 0
        while True:
            name, is_new = self.shared(wish, f"bound {count}")
            if is_new:
                module.bound[name] = value
            if is_new or _is_same(module.bound[name], value):
                return name, is_new
            count += 1


def _is_same(one: Any, other: Any) -> bool:
    """Return whether two values are one: 2 and 2.0 are not, nor are 0.0 and -0.0."""
    return one is other or (type(one) is type(other) and one == other and repr(one) == repr(other))


def is_plain(number: Any) -> bool:
    """Return whether a number of a spec may be printed: not infinity, not NaN, no type of a user's."""
    return type(number) is int or (type(number) is float and math.isfinite(number))


def literal(value: Any) -> str:
    """Return the text of a number, of bytes, or of a tuple, range or dict of such; raises `TypeError` for anything else."""
    if isinstance(value, bool) or value is None or is_plain(value):
        return repr(value)
    if isinstance(value, int):
        return repr(int(value))
    if isinstance(value, (bytes, bytearray)):
        return repr(bytes(value))
    if isinstance(value, range):
        return repr(value)
    if isinstance(value, tuple):
        return f"({', '.join(map(literal, value))}{',' if len(value) == 1 else ''})"
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{literal(key)}: {literal(item)}' for key, item in value.items())}}}"
    raise TypeError(f"{type(value).__name__} is not printed into generated code")


class FunctionSetup:
    """What printers of a function share: lines of the module ahead of it, for the values that it calls by name."""

    names: NameScope
    setup: list[str]

    def _table(self, name: str, value: str) -> str:
        """Return the module's name for what the text `value` makes; only our own words are in it."""
        found, is_new = self.names.shared(name, value)
        if is_new:
            self.setup.append(f"{found} = {value}")
        return found

    def _bound(self, name: str, value: object, shown: object = None) -> str:
        """Return the module's name for a value of the spec; a remark says what it is."""
        found, is_new = self.names.bind(name, value)
        if is_new:
            self.setup.append(f"# {found} = {comment_line(repr(value if shown is None else shown))}")
        return found

    def _spec_number(self, name: str, value: float) -> str:
        """Return a number of the spec: as it is where that can be printed, else by name."""
        return literal(value) if is_plain(value) else self._bound(name, value)


def compact(text: str) -> str:
    """Return a `struct` format with counts: `<hhh` as `<3h`."""
    return re.sub(r"(?<!\d)([a-zA-Z])\1+", lambda run: f"{len(run[0])}{run[1]}", text)
