"""The line of each key of a TOML file.

1. The text is valid TOML, or tomllib will say that it is not: this scan only finds keys, it judges nothing.
2. Whatever the text, the scan is one pass over its tokens, and each token is read once.

tomllib gives values and no places. A complaint about a value needs the place, so the keys are found once more: table
headers, keys and dotted keys, also inside inline tables; strings, arrays and comments are stepped over.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable
from contextlib import suppress
from typing import Final

KeyPath = tuple[str, ...]
#: Tables within tables that are distinguished; what lies deeper has the line of its table.
DEEPEST: Final = 8
#: Parts of a dotted key; tomllib needs minutes for some ten thousand.
LONGEST: Final = 200

# A string without its end is one token, too: nothing is read twice.
_TOKEN = re.compile(
    r"""(?P<string>"{3}(?:[^\\]|\\.)*?(?:"{3,5}|\Z)|'{3}.*?(?:'{3,5}|\Z)|"(?:[^"\\\n]|\\.)*"?|'[^'\n]*'?)
    |(?P<bare>[A-Za-z0-9_-]+)|(?P<comment>\#[^\n]*)|(?P<blank>[ \t\r]+)|.""",
    re.DOTALL | re.VERBOSE,
)


class KeyLines:
    """Lines of keys: `lines.of(("joints", "RHY", "gear"))`."""

    def __init__(self, text: str) -> None:
        self._lines: dict[KeyPath, int] = {}
        #: The line of the first key that has too many parts.
        self.too_long: int | None = None
        self._scan(text)

    def of(self, path: Iterable[str]) -> int:
        """Return the line of `path`, or of the innermost of its tables that has one; 1 for the file itself."""
        wanted = tuple(path)
        while wanted and wanted not in self._lines:
            wanted = wanted[:-1]
        return self._lines.get(wanted, 1)

    def _scan(self, text: str) -> None:
        line, parts, is_key, is_header = 1, 0, True, False
        table: KeyPath = ()
        path: KeyPath = ()
        #: The open brackets of a value, each with the key that its value belongs to.
        nested: list[tuple[str, KeyPath]] = []
        for found in _TOKEN.finditer(text.replace("\r\n", "\n")):
            token = found[0]
            if found.lastgroup in ("bare", "string"):
                if is_key:
                    parts += 1
                    if len(path) < DEEPEST:
                        path = (*path, _plain(token))
                        self._lines.setdefault(path, line)
                    if parts == LONGEST and self.too_long is None:
                        self.too_long = line
            elif token == "\n" and not nested:
                table = path if is_header else table
                path, parts, is_key, is_header = table, 0, True, False
            elif token == "=":
                is_key = False
            elif token in "[{" and is_key:
                path, parts, is_header = (), 0, True
            elif token in "[{":
                nested.append((token, path))
                parts, is_key = 0, token == "{"
            elif token in "]}" and nested:
                path, is_key = nested.pop()[1], False
            elif token == "," and nested and nested[-1][0] == "{":
                path, parts, is_key = nested[-1][1], 0, True
            line += token.count("\n")


def _plain(key: str) -> str:
    """Return a key without its quotes."""
    if key[0] == '"' and "\\" in key:
        with suppress(ValueError):  # an escape that no key may have: tomllib says so of the file
            (key,) = tomllib.loads(f"{key} = 0")
        return key
    return key.strip(key[0]) if key[0] in "\"'" else key
