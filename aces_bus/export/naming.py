"""What the dataset of a message is called.

1. No two datasets have names that differ in case alone: file systems and SQLite may not tell them apart.
2. A name is a file name on every system: letters, digits, `_`, `-` and dots, not too long.

A dataset is named like its message; where several protocols have a message of that name, `protocol.Message`. What was
not decoded is `_lost`, and of a second kind of link `_lost.2`.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence

from ..protocol.declare.protocol import Variant

LOST = "_lost"
LONGEST = 120
_ODD = re.compile(r"[^\w.-]", re.ASCII)
#: What Windows takes for devices, whatever the suffix.
_DEVICES = re.compile(r"(?i)(con|prn|aux|nul|com\d|lpt\d)(\..*)?")


class Naming:
    """Names of datasets, each given once."""

    def __init__(self, variants: Sequence[Variant] = (), *, reserved: Collection[str] = ()) -> None:
        self._owners: dict[str, set[str]] = {}
        for variant in variants:
            for name in variant.messages:
                self._owners.setdefault(name.casefold(), set()).add(variant.name)
        self._taken = {name.casefold() for name in reserved}

    def name(self, protocol: str, message: str) -> str:
        """The name for a new dataset."""
        if not message:
            return unique_name(LOST, self._taken)
        owners = self._owners.setdefault(message.casefold(), set())
        owners.add(protocol)
        wanted = safe_name(f"{protocol}.{message}" if len(owners) > 1 else message)
        return unique_name(f"{wanted}_" if wanted.casefold() == LOST else wanted, self._taken)


def unique_name(wanted: str, taken: set[str]) -> str:
    """The name, with a number behind it where it is taken already (case does not count); it is taken then."""
    name, number = wanted, 2
    while name.casefold() in taken:
        name = f"{wanted}.{number}"
        number += 1
    taken.add(name.casefold())
    return name


def safe_name(name: str) -> str:
    """A name that every file system takes."""
    name = _ODD.sub("_", name)[:LONGEST].strip(".") or "_"
    return f"_{name}" if _DEVICES.fullmatch(name) else name
