"""Fields written as characters between separators (NMEA 0183).

1. The raw value of such a field is its text, so that nothing is lost: `08` and `8` are the same number, not the same text.
2. An empty field is None; a text that is not of the field's form makes the message not match, in raw mode too.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from decimal import Decimal
from math import inf
from typing import Any, BinaryIO

from construct import Construct, Container, GreedyBytes, ListContainer, ValidationError, stream_read_entire

from ...errors import FieldError, SpecError
from ..record import FieldValue
from .fields import Field, is_raw, plain_number
from .place import caller


class AsciiField(Field):
    """A field of a `Delimited`: `form` is the regular expression that its text must match."""

    form = r".*"
    unit = ""

    def __init__(self, *, unit: str = "", doc: str = "") -> None:
        super().__init__(GreedyBytes)
        self.unit = unit
        self.docs = doc
        self._form = re.compile(self.form, re.DOTALL)

    def _decode(self, obj: Any, context: Any, path: str) -> Any:
        text = obj.decode("latin-1")
        if not self.accepts(text):
            raise ValidationError(f"{text!r} is not of its form", path=path)
        return text if is_raw(context) else self.to_physical(text)

    def _encode(self, obj: FieldValue, context: Container, path: str) -> FieldValue:
        text = obj if is_raw(context) else "" if obj is None else self.to_raw(obj, path)
        if not isinstance(text, str) or not self.accepts(text):
            raise FieldError(f"{path}: {obj!r} cannot be written here")
        return text.encode("latin-1")

    def accepts(self, text: str) -> bool:
        return not text or self._form.fullmatch(text) is not None

    def to_physical(self, raw: str) -> Any:
        return raw or None

    def to_raw(self, value: Any, path: str = "") -> Any:
        return str(value)


class AsciiText(AsciiField):
    """A text of any characters."""


class AsciiNumber(AsciiField):
    """A decimal number, with `digits` decimals when we write it."""

    form = r"[+-]?(?:[0-9]{1,30}(?:\.[0-9]{0,30})?|\.[0-9]{1,30})"

    def __init__(self, *, digits: int | None = None, unit: str = "", doc: str = "") -> None:
        super().__init__(unit=unit, doc=doc)
        self.digits = digits

    def to_physical(self, raw: str) -> Any:
        return float(raw) if raw else None

    def to_raw(self, value: Any, path: str = "") -> Any:
        number = plain_number(value)
        if number is None or not abs(number) < inf:
            raise FieldError(f"{path}: {value!r} is not a number that characters say")
        return (
            format(Decimal(repr(float(number))), "f") if self.digits is None else f"{number:.{self.digits}f}"
        )


class AsciiInteger(AsciiField):
    """A decimal integer, with at least `digits` digits when we write it."""

    form = r"[+-]?[0-9]{1,30}"

    def __init__(self, *, digits: int = 1, unit: str = "", doc: str = "") -> None:
        super().__init__(unit=unit, doc=doc)
        self.digits = digits

    def to_physical(self, raw: str) -> Any:
        return int(raw) if raw else None

    def to_raw(self, value: Any, path: str = "") -> Any:
        number = plain_number(value)
        if not isinstance(number, int):
            raise FieldError(f"{path}: {value!r} is not an integer")
        return f"{number:0{self.digits}d}"


def degrees(text: str | bytes) -> float:
    """Convert `4807.038` (degrees and minutes run together) to degrees."""
    number = float(text)
    whole = number // 100
    return whole + (number - 100 * whole) / 60


class AsciiDegrees(AsciiField):
    """Degrees and minutes run together, `4807.038` for 48° 7.038′, as degrees."""

    form = r"[0-9]{3,5}(?:\.[0-9]{0,30})?"

    def __init__(self, *, width: int, digits: int = 4, doc: str = "") -> None:
        super().__init__(unit="°", doc=doc)
        self.width, self.digits = width, digits

    def to_physical(self, raw: str) -> Any:
        return degrees(raw) if raw else None

    def to_raw(self, value: Any, path: str = "") -> Any:
        number = plain_number(value)
        if number is None or not 0 <= number <= 180:
            raise FieldError(f"{path}: {value!r} is outside 0…180°")
        whole, rest = divmod(round(number * 60, self.digits), 60)
        width = 3 + self.digits if self.digits else 2
        return f"{int(whole):0{self.width}d}{rest:0{width}.{self.digits}f}"


class AsciiEnumeration(AsciiField):
    """Characters with names; characters without one are shown as they are."""

    def __init__(self, names: Mapping[str, str], *, doc: str = "") -> None:
        super().__init__(doc=doc)
        self.names = dict(names)
        self.values = {text: name for name, text in self.names.items()}
        if len(self.values) != len(self.names):
            raise SpecError(f"{self.place}: two names for one text")

    def to_physical(self, raw: str) -> Any:
        return self.values.get(raw, raw) if raw else None

    def to_raw(self, value: Any, path: str = "") -> Any:
        return self.names.get(value, value)


class Delimited(Construct):
    """Fields between separators: `Delimited(",", "time" / AsciiText(), …)`.

    `lead` says that there is a separator before the first field. The last `optional` fields may be missing altogether
    (None). With `more=True` fields beyond the last are kept, as texts, in the field `more`.
    """

    def __init__(
        self, separator: str, *fields: Construct, lead: bool = False, optional: int = 0, more: bool = False
    ) -> None:
        super().__init__()
        self.place = caller()
        if not separator.isascii() or not separator:
            raise SpecError(f"{self.place}: a separator is ASCII characters, not {separator!r}")
        self.separator = separator.encode("ascii")
        self.fields = list(fields)
        self.lead = lead
        self.least = len(fields) - optional
        self.more = more
        for field in fields:
            if not field.name or not isinstance(field.subcon, AsciiField):
                raise SpecError(f"{self.place}: a Delimited takes named ASCII fields, not {field!r}")
        if self.least < 1:
            raise SpecError(f"{self.place}: at least one field of a Delimited is not optional")
        self.least_size = len(self.separator) * (self.least - 1 + lead)

    def _parse(self, stream: BinaryIO, context: Container, path: str) -> Container:
        data: bytes = stream_read_entire(stream, path)
        if self.lead:
            if not data.startswith(self.separator):
                raise ValidationError("no separator before the first field", path=path)
            data = data[len(self.separator) :]
        parts = data.split(self.separator)
        if len(parts) < self.least or (len(parts) > len(self.fields) and not self.more):
            raise ValidationError(f"{len(parts)} fields", path=path)
        values = Container()
        for index, field in enumerate(self.fields):
            where = f"{path} -> {field.name}"
            values[field.name] = (
                field.subcon._decode(parts[index], context, where) if index < len(parts) else None
            )
        if self.more:
            values["more"] = ListContainer(part.decode("latin-1") for part in parts[len(self.fields) :])
        return values

    def _build(self, obj: Any, stream: BinaryIO, context: Container, path: str) -> Any:
        parts: list[bytes] = []
        # Trailing optional fields without a value are left out; in raw mode "" is a field that is there and empty.
        count = len(self.fields)
        while count > self.least and obj.get(self.fields[count - 1].name) is None and not obj.get("more"):
            count -= 1
        for field in self.fields[:count]:
            value = obj[field.name]
            if value is None and is_raw(context):
                value = ""
            part = field.subcon._encode(value, context, f"{path} -> {field.name}")
            if self.separator in part:
                raise FieldError(f"{path} -> {field.name}: {value!r} has a separator in it")
            parts.append(part)
        if self.more:
            parts += [text.encode("latin-1") for text in obj.get("more") or ()]
        stream.write((self.separator if self.lead else b"") + self.separator.join(parts))
        return obj

    def _sizeof(self, context: Container, path: str) -> int:
        from construct import SizeofError

        raise SizeofError("depends on the values", path=path)
