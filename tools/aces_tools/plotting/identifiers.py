"""CAN identifiers as they are typed: `2A0`, `0x2A0`, `18FEF100`, `can0:2A0`, `2A?,3*`.

1. Hexadecimal, as candump prints them; eight digits are 29 bits. Up to three are 11 bits, and 29 where no such one has 11.
2. A name is looked up among those that occur, and one that does not is refused with what is there.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from fnmatch import fnmatchcase
from typing import NamedTuple

from aces_bus.errors import CallerError

from ..reading.traffic import BusIdentifier

_TYPED = re.compile(r"(?:(?P<channel>[^:,]+):)?(?:0[xX])?(?P<digits>[0-9A-Fa-f*?]{1,8})")
#: Of those that are there, so many are named.
NAMED = 8


class IdentifierPattern(NamedTuple):
    """One of several as it was typed."""

    text: str
    channel: str | None
    digits: str

    def fits(self, identifier: BusIdentifier) -> bool:
        """Return whether it may mean this one."""
        if self.channel is not None and str(identifier.channel) != self.channel:
            return False
        if self.is_wild:
            return fnmatchcase(identifier.digits, self.digits)
        return identifier.number == int(self.digits, 16) and (identifier.is_extended or len(self.digits) < 8)

    @property
    def is_wild(self) -> bool:
        """True if the pattern may match several identifiers."""
        return "*" in self.digits or "?" in self.digits


def parse_identifiers(text: str) -> list[IdentifierPattern] | None:
    """Return the parts of a text, between commas; None where one cannot be an identifier."""
    found: list[IdentifierPattern] = []
    for part in text.split(","):
        typed = _TYPED.fullmatch(part.strip())
        if typed is None:
            return None
        found.append(IdentifierPattern(part.strip(), typed["channel"], typed["digits"].upper()))
    return found


def choose_identifiers(
    patterns: Sequence[IdentifierPattern], there: Sequence[BusIdentifier]
) -> list[BusIdentifier]:
    """Return those of `there` that are meant, in the order of the patterns. Raises `CallerError` for one that means none."""
    found: dict[BusIdentifier, None] = {}
    for pattern in patterns:
        fitting = [identifier for identifier in there if pattern.fits(identifier)]
        if not pattern.is_wild:
            usual = [
                identifier for identifier in fitting if identifier.is_extended == (len(pattern.digits) > 3)
            ]
            fitting = usual or fitting
        if not fitting:
            names = list(
                dict.fromkeys(
                    identifier.digits for identifier in sorted(there, key=lambda identifier: identifier[1:])
                )
            )
            shown = (
                f" (there are: {', '.join(names[:NAMED])}{', …' if len(names) > NAMED else ''})"
                if names
                else ""
            )
            raise CallerError(f"no frame has the identifier {pattern.text!r}{shown}")
        found |= dict.fromkeys(fitting)
    return list(found)
