"""ODrive's endpoint files: parameters by name, with the number and type that one firmware gives them.

*Facts*: ODriveResources `examples/can_restore_config.py`: `flat_endpoints.json` has `fw_version`, `hw_version` and
`endpoints`, name → `id`, `type`, and `access` ("r": read only); types are those of `TYPES`, others are functions.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import msgspec

from aces_bus.errors import CallerError, UnknownNameError

#: Types of parameters, as ODrive's endpoint files name them → struct's.
TYPES = {
    "bool": "?", "uint8": "B", "int8": "b", "uint16": "H", "int16": "h", "uint32": "I", "int32": "i", "uint64": "Q",
    "int64": "q", "float": "f",
}  # fmt: skip
#: The parameters of the watchdog, by name: its time (s), and whether it is on.
WATCHDOG = ("axis0.config.watchdog_timeout", "axis0.config.enable_watchdog")


class Endpoint(msgspec.Struct, frozen=True):
    """One parameter (or function) of a firmware."""

    id: Annotated[int, msgspec.Meta(ge=0, le=0xFFFF)]
    type: str
    access: str = "rw"


class Endpoints(msgspec.Struct, frozen=True):
    """The parameters of one firmware by name."""

    fw_version: str
    endpoints: Mapping[str, Endpoint]
    hw_version: str = ""

    def named(self, who: str, name: str) -> Endpoint:
        """Return a parameter by name. Raises `UnknownNameError`, and `CallerError` for a function."""
        found = self.endpoints.get(name)
        if found is None:
            raise UnknownNameError(f"endpoint of {who}, firmware {self.fw_version},", name, self.endpoints)
        if found.type not in TYPES:
            raise CallerError(f"{who}: {name} is a {found.type}, not a parameter")
        return found


def read_endpoints(who: str, path: str) -> Endpoints:
    """Read an endpoint file. Raises `CallerError` for a file that is none."""
    try:
        return msgspec.convert(json.loads(Path(path).read_text(encoding="utf-8")), Endpoints)
    except (OSError, ValueError) as error:
        raise CallerError(f"{who}: {path} is not an ODrive's flat_endpoints.json: {error}") from None


def endpoint_bytes(type: str, value: float) -> bytes:
    """Return a value in the bytes of its type, a key of `TYPES`. Raises `CallerError` for a value that does not fit."""
    code = f"<{TYPES[type]}"
    try:
        return struct.pack(code, value if code == "<f" else int(value))
    except (struct.error, OverflowError, ValueError):
        raise CallerError(f"{value!r} does not fit into {type}") from None


def endpoint_value(type: str, data: bytes) -> float | None:
    """Return the value of bytes of a type; None for too few."""
    code = f"<{TYPES[type]}"
    if len(data) < struct.calcsize(code):
        return None
    value: float = struct.unpack_from(code, data)[0]
    return value
