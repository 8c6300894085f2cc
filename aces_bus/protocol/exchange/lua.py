"""Data as Lua literals.

1. Text becomes a quoted literal of printable ASCII, whatever it is: nothing of it can end the literal.
2. None in a table with names is left out; in a list it is `nil`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

#: Columns of a line before a table is broken over several.
WIDTH = 110
# fmt: off
_NAMES = frozenset((
    "and", "break", "do", "else", "elseif", "end", "false", "for", "function", "goto", "if", "in", "local", "nil", "not",
    "or", "repeat", "return", "then", "true", "until", "while",
))
# fmt: on


def lua_string(text: str | bytes) -> str:
    """A string literal; characters beyond ASCII as their UTF-8 bytes."""
    data = text.encode("utf-8", "surrogatepass") if isinstance(text, str) else text
    out = []
    for byte in data:
        plain = 0x20 <= byte < 0x7F and byte not in b'"\\'
        out.append(chr(byte) if plain else f"\\{byte:03d}")
    return '"' + "".join(out) + '"'


def lua_literal(value: Any, indent: int = 0) -> str:
    """A value as a Lua expression: tables over several lines where they are long."""
    flat = _flat(value)
    if len(flat) + indent <= WIDTH or not isinstance(value, (Mapping, Sequence)) or isinstance(value, str):
        return flat
    pad = "  " * (indent // 2 + 1)
    lines = []
    if isinstance(value, Mapping):
        for key, one in value.items():
            if one is not None:
                lines.append(f"{pad}{_key(key)} = {lua_literal(one, indent + 2)},")
    else:
        lines = [f"{pad}{lua_literal(one, indent + 2)}," for one in value]
    return "\n".join(["{", *lines, "  " * (indent // 2) + "}"])


def _flat(value: Any) -> str:
    if value is None:
        return "nil"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return repr(value)
    if isinstance(value, (str, bytes)):
        return lua_string(value)
    if isinstance(value, Mapping):
        inner = ", ".join(f"{_key(key)} = {_flat(one)}" for key, one in value.items() if one is not None)
    else:
        inner = ", ".join(_flat(one) for one in value)
    return f"{{ {inner} }}" if inner else "{}"


def _key(key: Any) -> str:
    if isinstance(key, str) and key.isascii() and key.isidentifier() and key not in _NAMES:
        return key
    return f"[{_flat(key)}]"


__all__ = ["lua_literal", "lua_string"]
