"""Tables of values in TOML: registers (modbus), identifiers (uds). What is common to them: numbers, and where tables are.

1. A table says everything: nothing is guessed of a type, an order, a scale or whether something may be written.
2. A value is raw × `scale` + `offset`, in `unit`; what is sent is rounded to the nearest, and never cut off: it fits, or is
   refused.
"""

from __future__ import annotations

import struct
import tomllib
from collections.abc import Mapping
from importlib.resources.abc import Traversable
from pathlib import Path
from random import Random
from typing import Any

from aces_bus.errors import CallerError, UnknownNameError

#: Types → how struct writes them with the high byte first.
NUMBERS = {
    "u8": "B", "s8": "b", "u16": "H", "s16": "h", "u32": "I", "s32": "i", "u64": "Q", "s64": "q",
    "float": "f", "double": "d",
}  # fmt: skip


def value_of(data: bytes, type: str, scale: float, offset: float) -> Any:
    """Return the value of a number, the high byte first; of "text", without what fills it up; of "bytes", in hexadecimal.

    >>> value_of(b"\\xff\\x83", "s16", 0.5, 1), value_of(b"oven\\0\\0", "text", 1, 0)
    (-61.5, 'oven')
    """
    if type not in NUMBERS:
        return data.decode("latin-1").rstrip("\0 ") if type == "text" else data.hex(" ").upper()
    (number,) = struct.unpack(f">{NUMBERS[type]}", data)
    return number if scale == 1 and offset == 0 else number * scale + offset


def data_of(what: str, value: Any, type: str, size: int, scale: float, offset: float, unit: str) -> bytes:
    """Return the bytes of a value. Raises `CallerError`, which names `what`, for one that does not fit."""
    try:
        if type == "text":
            data = str(value).encode("latin-1").ljust(size, b"\0")
        elif type == "bytes":
            data = bytes.fromhex(value) if isinstance(value, str) else bytes(value)
        else:
            code = NUMBERS[type]
            number = (value - offset) / scale
            data = struct.pack(f">{code}", number if code in "fd" else round(number))
        if len(data) != size:
            raise ValueError
    except (struct.error, OverflowError, ValueError, TypeError):
        raise CallerError(f"{what}: {value!r} {unit} does not fit into {type}") from None
    return data


def drawn_bytes(dice: Random, type: str, size: int, share: float = 1.0) -> bytes:
    """Return the bytes of a drawn number, from the middle `share` of its type's range; of a text, letters.

    A float is within a million.
    """
    code = NUMBERS.get(type)
    if code is None:
        return bytes(dice.choice(b"abcdefghijklmnopqrstuvwxyz") for _ in range(size))
    if code in "fd":
        return struct.pack(f">{code}", dice.uniform(-1e6, 1e6) * share)
    whole = 1 << 8 * struct.calcsize(code)
    middle = 0 if code.islower() else whole // 2
    number = middle + int(dice.uniform(-0.5, 0.5) * share * whole)
    low = -(whole // 2) if code.islower() else 0
    return struct.pack(f">{code}", max(low, min(low + whole - 1, number)))


def entries_of(
    who: str, what: str, table: str | None, own: Mapping[str, Any], folder: Traversable | None = None
) -> dict[str, Any]:
    """Return the entries of a table that ships in `folder` or of a TOML file with [`what`], and a device's own, which
    go before.

    Raises `CallerError`, `UnknownNameError`.
    """
    return {**(_read_table(who, what, table, folder) if table else {}), **own}


def _read_table(who: str, what: str, table: str, folder: Traversable | None) -> Mapping[str, Any]:
    try:
        if table.endswith(".toml"):
            read = tomllib.loads(Path(table).read_text(encoding="utf-8"))
        else:
            shipped = {
                item.name.removesuffix(".toml"): item
                for item in (folder.iterdir() if folder is not None else ())
                if item.name.endswith(".toml")
            }
            if table not in shipped:
                raise UnknownNameError(
                    f"table of {what} ({who}; a file of your own ends in .toml)", table, shipped
                )
            read = tomllib.loads(shipped[table].read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise CallerError(f"{who}: the table {table} cannot be read: {error}") from None
    found = read.get(what)
    if not isinstance(found, dict):
        raise CallerError(f"{who}: {table} has no [{what}]")
    return found
