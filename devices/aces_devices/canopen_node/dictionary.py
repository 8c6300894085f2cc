"""Object dictionaries: of the file that a robot names, else of our own device.

1. `canopen` reads EDS and DCF; it is imported here, when the first device is made.
2. A file is read once a node: its defaults may contain the node's number.
"""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from aces_bus.errors import CallerError
from aces_bus.robot.checks import near

if TYPE_CHECKING:
    from canopen import ObjectDictionary

#: The largest file that is read, and the largest numbers in it that canopen counts up to.
LARGEST = 4 << 20
COUNTS = {"nrofentries": 254, "compactsubobj": 254, "lines": 10_000}
_COUNT = re.compile(r"(?im)^[ \t]*(NrOfEntries|CompactSubObj|Lines)[ \t]*=[ \t]*(\w{1,40})")


@dataclass(frozen=True)
class OwnFile:
    """Our own device's file, in a package; `lacks` says what a file is not that has none of the objects `needs`."""

    package: str
    name: str
    needs: tuple[int, ...]
    lacks: str


@cache
def read_dictionary(path: str | None, node: int, own: OwnFile) -> Any:
    """Read canopen's object dictionary of an EDS or DCF file (None: our own device's) for a node.

    Raises `CallerError` for a file that is not there or is none. Shared: it must not be changed.
    """
    from canopen.objectdictionary import eds

    read: Any = eds.import_eds

    try:
        if path is None:
            text = (files(own.package) / own.name).read_text("utf-8")
        else:
            with Path(path).open("rb") as stream:
                text = stream.read(LARGEST + 1).decode("utf-8", "replace")
            if len(text) > LARGEST:
                raise CallerError(f"{path}: larger than an EDS file may be ({LARGEST >> 20} MB)")
    except OSError as error:
        raise CallerError(
            f"{path}: {error.strerror or error}; a robot's file names it from its own folder"
        ) from error
    for name, value in _COUNT.findall(text):
        if (value.isdecimal() and int(value) > COUNTS[name.lower()]) or len(value) > 10:
            raise CallerError(f"{path}: {name} = {value} is more than a device has")
    source = io.StringIO(text)
    source.name = path or own.name
    try:
        found = read(source, node)
    except Exception as error:  # whatever the library lets through on a file that is none
        raise CallerError(f"{path}: not an EDS or DCF file that canopen can read: {error}") from error
    if not any(index in found for index in own.needs):
        raise CallerError(f"{path}: {own.lacks}")
    return found


def object_of(dictionary: ObjectDictionary, name: str | int) -> tuple[int, int, Any]:
    """Return index, subindex and canopen's variable (None where the file has none) of "6064", "0x6099:1" or
    an object's name.

    Raises `CallerError` for what is neither a number nor in the file.
    """
    if isinstance(name, int):
        index, subindex = name, 0
    else:
        head, _, tail = name.partition(":")
        try:
            index, subindex = int(head, 16), int(tail, 0) if tail else 0
        except ValueError:
            found = _named(dictionary).get(name.strip().lower())
            if found is None:
                names = _named(dictionary)
                hint = near(name.lower(), names, 0.5, many=len(names))
                raise CallerError(
                    f"{name!r} is not an object: write its index, as 6064 or 6099:1 (hexadecimal), or its name{hint}"
                ) from None
            return found.index, found.subindex, found
    if not 0 <= index <= 0xFFFF or not 0 <= subindex <= 0xFF:
        raise CallerError(f"{name!r}: an index has four hexadecimal digits, a subindex is 0 to 255")
    return index, subindex, dictionary.get_variable(index, subindex)


def _named(dictionary: ObjectDictionary) -> Mapping[str, Any]:
    """Return variables by name in small letters; a record's members as "record.member", and by their own name."""
    found: dict[str, Any] = {}
    members: dict[str, Any] = {}
    for entry in dictionary.values():
        if hasattr(entry, "data_type"):
            found[entry.name.lower()] = entry
            continue
        for member in entry.values():
            found[member.name.lower()] = member
            members[member.name.rpartition(".")[2].lower()] = member
    return {**members, **found}
