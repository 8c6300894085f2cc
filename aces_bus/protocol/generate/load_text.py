"""Compiles printed source, so that it shows in tracebacks and steps in a debugger like any file.

1. Nothing but text printed from a plan is ever compiled here.
"""

from __future__ import annotations

import linecache
from collections.abc import Mapping
from functools import lru_cache
from types import CodeType
from typing import Any

from .source import comment_line


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
