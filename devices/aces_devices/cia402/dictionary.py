"""The object dictionary of a drive: of the file that a robot names, else of our own drive."""

from __future__ import annotations

from typing import Any

from ..canopen_node.dictionary import OwnFile, read_dictionary

OWN = OwnFile(
    "aces_devices.cia402",
    "drive.eds",
    (0x6041,),
    "has no statusword (object 6041): not a drive of CiA 402",
)


def dictionary_of(path: str | None, node: int) -> Any:
    """Return the dictionary of a drive's file (None: our own drive's). Raises `CallerError` for a file that is none."""
    return read_dictionary(path, node, OWN)
