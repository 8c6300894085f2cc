"""A robot written as TOML, one line an entry: what `aces robot import` and `aces discover` print.

1. Read again, the text gives an equal robot. What is unknown is not written.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from datetime import date, time
from typing import Any, Final

import msgspec
from msgspec.structs import fields

from ..device.config import Robot

_BARE: Final = re.compile(r"[A-Za-z0-9_-]+")
_ESCAPED: Final = {"\\": "\\\\", '"': '\\"', "\n": "\\n", "\t": "\\t", "\r": "\\r", "\b": "\\b", "\f": "\\f"}


def print_robot(robot: Robot, notes: Iterable[str] = ()) -> str:
    """The robot's TOML file; `notes` become comments at its head."""
    lines = [f"# {note}".rstrip() for note in notes]
    lines += [
        f"{name} = {_value(value)}"
        for name, value in _stated(robot).items()
        if name not in ("buses", "devices", "joints", "sensors")
    ]
    sections: tuple[tuple[str, Mapping[str, msgspec.Struct]], ...] = (
        ("buses", robot.buses),
        ("devices", robot.devices),
        ("joints", robot.joints),
        ("sensors", robot.sensors),
    )
    for section, entries in sections:
        if entries:
            lines += ["", f"[{section}]"]
            lines += [f"{_key(name)} = {_value(entry, ('name',))}" for name, entry in entries.items()]
    return "\n".join(lines) + "\n"


def _stated(struct: msgspec.Struct) -> dict[str, Any]:
    """The fields of a struct that are known and not what they are by default; a joint's channel always."""
    stated: dict[str, Any] = {}
    for field in fields(type(struct)):
        value = getattr(struct, field.name)
        if field.required or field.name == "channel" or value != field.default:
            if value is not None and value != {}:
                stated[field.name] = value
    return stated


def _value(value: Any, without: tuple[str, ...] = ()) -> str:
    if isinstance(value, msgspec.Struct):
        value = {name: one for name, one in _stated(value).items() if name not in without}
        return _table(
            {name: _hex(one) if name == "credentials" else _value(one) for name, one in value.items()}
        )
    if isinstance(value, Mapping):
        return _table({name: _value(one) for name, one in value.items()})
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, float) and value.is_integer() and abs(value) < 1e15:
        return str(int(value))
    return value.isoformat() if isinstance(value, (date, time)) else repr(value)


def _hex(credentials: Mapping[str, int]) -> str:
    return _table({name: f"0x{number:02X}" for name, number in credentials.items()})


def _table(values: Mapping[str, str]) -> str:
    return (
        f"{{ {', '.join(f'{_key(name)} = {value}' for name, value in values.items())} }}" if values else "{}"
    )


def _key(name: str) -> str:
    return name if _BARE.fullmatch(name) else _text(name)


def _text(text: str) -> str:
    escaped = "".join(_ESCAPED.get(c) or (c if c.isprintable() else f"\\U{ord(c):08X}") for c in text)
    return f'"{escaped}"'
