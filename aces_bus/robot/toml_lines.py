"""At which line each key of a TOML file stands.

1. The text is valid TOML, or tomllib will say that it is not: this scan only finds keys, it judges nothing.
2. Whatever the text, the scan ends: each step goes forward, and what it does not understand ends it with what it has.

tomllib gives values and no places. A complaint about a value needs the place, so the keys are found once more: table
headers, keys and dotted keys, also inside inline tables; strings, arrays and comments are stepped over.
"""

from __future__ import annotations

import re
import tomllib
from bisect import bisect_right
from collections.abc import Iterable
from typing import Final

KeyPath = tuple[str, ...]
#: Tables within tables that are told apart; what lies deeper has the line of its table.
DEEPEST: Final = 8
#: Parts of a dotted key; tomllib needs minutes for some ten thousand.
LONGEST: Final = 200

_BLANK = re.compile(r"[ \t]*")
_GAP = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
_KEY = re.compile(r"""[A-Za-z0-9_-]+|"(?:[^"\\\n]|\\.)*"|'[^'\n]*'""")
_STRING = re.compile(r'"{3}(?:[^\\]|\\.)*?"{3,5}|\'{3}.*?\'{3,5}|"(?:[^"\\\n]|\\.)*"|\'[^\'\n]*\'', re.DOTALL)
_SCALAR = re.compile(r"[^,\]\}\n#\"'\[\{]+")


class KeyLines:
    """Lines of keys: `lines.of(("joints", "RHY", "gear"))`."""

    def __init__(self, text: str) -> None:
        self._text = text.replace("\r\n", "\n")
        self._starts = [0, *(found.end() for found in re.finditer("\n", self._text))]
        self._lines: dict[KeyPath, int] = {}
        #: The line of the first key that has too many parts.
        self.too_long: int | None = None
        try:
            self._scan()
        except _Puzzled:
            pass

    def of(self, path: Iterable[str]) -> int:
        """The line where `path` stands, or the innermost of its tables that has one; 1 for the file itself."""
        wanted = tuple(path)
        while wanted and wanted not in self._lines:
            wanted = wanted[:-1]
        return self._lines.get(wanted, 1)

    # ------------------------------------------------------------------ the scan

    def _scan(self) -> None:
        table: KeyPath = ()
        at = self._match(_GAP, 0)
        while at < len(self._text):
            if self._text[at] == "[":
                is_array = self._text.startswith("[[", at)
                table, at = self._key(at + 1 + is_array, ())
                at = self._expect("]", at)
                if is_array:
                    at = self._expect("]", at)
            else:
                path, at = self._key(at, table)
                at = self._value(self._expect("=", at), path)
            at = self._match(_GAP, at)

    def _key(self, at: int, table: KeyPath) -> tuple[KeyPath, int]:
        """A dotted key below `table`, noted with all its prefixes."""
        path, parts = table, 0
        while True:
            at = self._match(_BLANK, at)
            found = _KEY.match(self._text, at)
            if found is None:
                raise _Puzzled
            parts += 1
            if len(path) < DEEPEST:
                path = (*path, _plain(found[0]))
                self._lines.setdefault(path, bisect_right(self._starts, at))
            elif parts == LONGEST and self.too_long is None:
                self.too_long = bisect_right(self._starts, at)
            at = self._match(_BLANK, found.end())
            if not self._text.startswith(".", at):
                return path, at
            at += 1

    def _value(self, at: int, path: KeyPath) -> int:
        """Over a value; the keys of inline tables are noted."""
        open_brackets: list[tuple[str, KeyPath]] = []
        while True:
            at = self._match(_GAP, at) if open_brackets else self._match(_BLANK, at)
            if at >= len(self._text):
                return at
            character = self._text[at]
            if character in "[{":
                open_brackets.append((character, path))
                at += 1
                if character == "{":
                    path, at = self._inline_key(at, path)
                continue
            if open_brackets and character in "]}":
                path = open_brackets.pop()[1]
                at += 1
            elif open_brackets and character == ",":
                at += 1
                if open_brackets[-1][0] == "{":
                    path, at = self._inline_key(at, open_brackets[-1][1])
                continue
            else:
                found = _STRING.match(self._text, at) or _SCALAR.match(self._text, at)
                if found is None:
                    raise _Puzzled
                at = found.end()
            if not open_brackets:
                return at

    def _inline_key(self, at: int, table: KeyPath) -> tuple[KeyPath, int]:
        at = self._match(_GAP, at)
        if self._text.startswith("}", at):
            return table, at
        path, at = self._key(at, table)
        return path, self._expect("=", at)

    def _match(self, pattern: re.Pattern[str], at: int) -> int:
        found = pattern.match(self._text, at)
        assert found is not None  # both patterns match the empty text
        return found.end()

    def _expect(self, character: str, at: int) -> int:
        at = self._match(_BLANK, at)
        if not self._text.startswith(character, at):
            raise _Puzzled
        return at + 1


class _Puzzled(Exception):
    """The text is not what the scan takes it for."""


def _plain(key: str) -> str:
    """A key without its quotes."""
    if key[0] == '"':
        try:
            (plain,) = tomllib.loads(f"{key} = 0")
        except tomllib.TOMLDecodeError:  # an escape or a character that no key may have
            raise _Puzzled from None
        return str(plain)
    return key[1:-1] if key[0] == "'" else key
