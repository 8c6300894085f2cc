"""A driver's own keys in a robot file, declared once: a struct whose fields have a type, a range, a text and a default.

    class FanSettings(msgspec.Struct, frozen=True, kw_only=True):
        every_s: Annotated[float, Meta(ge=0, description="how often it is asked (s, default 1)")] = 1.0

`Driver(settings=described(FanSettings))` lists them; `self.settings = settings_of(self.name, FanSettings, config.settings)`.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any, TypeVar, get_args

import msgspec
from msgspec.structs import FieldInfo, fields

from ..errors import CallerError, UnknownNameError
from ..protocol.record import FieldValue

S = TypeVar("S", bound=msgspec.Struct)


@cache
def _fields(kind: type[msgspec.Struct]) -> dict[str, FieldInfo]:
    return {field.name: field for field in fields(kind)}


def described(kind: type[msgspec.Struct]) -> dict[str, str]:
    """Return key → description, for `Driver.settings`."""
    return {name: _text(field.type) for name, field in _fields(kind).items()}


def _text(annotation: Any) -> str:
    own = (m.description for m in getattr(annotation, "__metadata__", ()) if isinstance(m, msgspec.Meta))
    return next(filter(None, [*own, *map(_text, get_args(annotation))]), "")


def settings_of(who: str, kind: type[S], given: Mapping[str, FieldValue]) -> S:
    """Return the settings of one device. Raises `UnknownNameError` for an unknown key, `CallerError` for a value that
    cannot be.
    """
    known = _fields(kind)
    values: dict[str, Any] = {}
    for key, value in given.items():
        if key not in known:
            raise UnknownNameError(f"setting of {who}", key, known)
        try:
            values[key] = msgspec.convert(value, known[key].type)
        except msgspec.ValidationError as error:
            text = _text(known[key].type)
            raise CallerError(f"{who}: the setting {key} = {value!r}: {error} ({text})") from None
    return kind(**values)
