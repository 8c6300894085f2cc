"""MAVLink dialect files (XML) as protocols: dialect `v2` has the packets of MAVLink 2, `v1` those of MAVLink 1.

A message that cannot be said costs itself, not the file; a meaning that cannot be said costs itself, not the field.

On the wire the fields of a message are sorted by the size of their type, the largest first; extensions follow as the file
has them, in MAVLink 2 alone. A CRC ends with one byte that is computed from names and types (CRC_EXTRA), so that who has
another definition of a message refuses its packets. In MAVLink 2 zeros at the end are cut, and a signature of 13 bytes
(link, 6 bytes of time in 10 µs since 2015, 6 of SHA-256) may follow; it is kept, at the end of `trailing`, and not
verified. There is also what a newer definition has behind the fields that are known.

Sources: ArduPilot/pymavlink `mavparse.py`, `mavgen_python.py`, `mavcrc.py`; mavlink/mavlink `common.xml`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any, Final

import construct as c

from aces_bus.errors import AcesError, CallerError
from aces_bus.protocol import Crc, CutZeros, Enumeration, Extra, Flags, Protocol, Quantity, Text, Trailer
from aces_bus.protocol.declare.fields import wire_number
from aces_bus.protocol.declare.framing import Framing
from aces_bus.protocol.declare.place import SourceLine
from aces_bus.protocol.exchange.import_dbc import protocol_name
from aces_bus.protocol.exchange.names import PythonNames
from aces_bus.protocol.exchange.problems import ImportedProtocol, ProblemText

from .mavlink_dialect import MOST_PAYLOAD, MOST_V1, MOST_V2, TYPES, Dialect, DialectField, DialectMessage

#: The field of what is behind the known ones, a signature among it; bytes of that, and the flag that announces it.
TRAILING: Final = "trailing"
SIGNATURE = Trailer(13, "incompat_flags", bit=0)

_SENTINEL = re.compile(r"(U?)INT(8|16|32|64)_(MAX|MIN)", re.ASCII)

#: Units that need a factor or another name; others stay as they are written.
_UNITS: dict[str, tuple[float, str]] = {
    "deg": (1, "°"),
    "cdeg": (0.01, "°"),
    "degE5": (1e-5, "°"),
    "degE7": (1e-7, "°"),
    "deg/2": (2, "°"),
    "deg/s": (1, "°/s"),
    "cdeg/s": (0.01, "°/s"),
    "ddeg/s": (0.1, "°/s"),
    "degC": (1, "°C"),
    "cdegC": (0.01, "°C"),
    "d%": (0.1, "%"),
    "c%": (0.01, "%"),
    "cA": (0.01, "A"),
    "cV": (0.01, "V"),
    "cs": (0.01, "s"),
    "ds": (0.1, "s"),
    "us": (1, "µs"),
    "dm": (0.1, "m"),
    "dam": (10, "m"),
    "dm/s": (0.1, "m/s"),
    "m/s*5": (0.2, "m/s"),
    "hJ": (100, "J"),
    "pix": (1, "px"),
    "m/s/s": (1, "m/s²"),
    "cm^2": (1, "cm²"),
    "cm^3": (1, "cm³"),
    "cm^3/min": (1, "cm³/min"),
}


def load_mavlink(path: str) -> ImportedProtocol:
    """Return the dialect file `path`, and what it includes, as a protocol. Raises `CallerError` when nothing of it can
    be read.
    """
    dialect = Dialect(path)
    dialect.read(Path(path), "")
    protocol = _Builder(dialect).build()
    if not protocol.declared:
        first = f"; first: {min(dialect.problems)}" if dialect.problems else ""
        raise CallerError(f"{path}: no message in it can be used{first}")
    return ImportedProtocol(protocol, tuple(sorted(dialect.problems)), dialect.count, path)


# ---------------------------------------------------------------------- the protocol


class _Builder:
    def __init__(self, dialect: Dialect) -> None:
        self.dialect = dialect
        path = dialect.path
        has_v1 = any(message.number <= MOST_V1 for message in dialect.messages)
        self.protocol = Protocol(
            protocol_name(path),
            link="serial",
            baud=57_600,
            dialects={"v2": "MAVLink 2", **({"v1": "MAVLink 1"} if has_v1 else {})},
            doc="a MAVLink dialect",
            source=path,
        )
        self.protocol.place = SourceLine(path, 1)
        self.crc = Crc("CRC16-MCRF4XX", over=(slice(1, -2), Extra()))
        sender = (
            "packet_sequence" / c.Default(c.Byte, 0) * "counts the packets of this sender",
            "system" / c.Byte * "the sender's system",
            "component" / c.Byte * "the sender's component",
        )
        self.v2 = self.protocol.framing(
            name="MAVLink 2",
            sync=b"\xfd",
            header=c.Struct(
                "packet_length" / c.Byte,
                "incompat_flags" / c.Default(c.Byte, 0) * "bit 0: signed, by the last 13 bytes of trailing",
                "compat_flags" / c.Default(c.Byte, 0),
                *sender,
                "message" / c.Int24ul,
            ),
            size=c.this.packet_length + 12,
            max_size=12 + MOST_PAYLOAD + SIGNATURE.size,
            gap=0.5,
            stuffing=CutZeros(),
            check=self.crc,
            trailer=SIGNATURE,
        )
        if has_v1:
            self.v1 = self.protocol.framing(
                name="MAVLink 1",
                sync=b"\xfe",
                header=c.Struct("packet_length" / c.Byte, *sender, "message" / c.Byte),
                size=c.this.packet_length + 8,
                max_size=8 + MOST_PAYLOAD,
                gap=0.5,
                check=self.crc,
            )
        for framing in self.protocol.framings:
            framing.place = self.protocol.place
        self.heads = {head.name for head in self.v2.heads if head.name}
        self.taken = set(PythonNames.TAKEN_BY_CODE)
        self._values: dict[tuple[str, ...], c.Construct] = {}

    def build(self) -> Protocol:
        numbers: dict[int, str] = {}
        for message in self.dialect.messages:
            try:
                if message.reason:
                    raise _LeftOut(message.reason)
                if message.number in numbers:
                    raise _LeftOut(f"{numbers[message.number]} has its number {message.number}")
                self._message(message)
                numbers[message.number] = message.name
            except (_LeftOut, AcesError) as reason:
                said = f"message {ProblemText.one_line(message.name)[:60]}: {ProblemText.of_error(reason)}: left out"
                self.dialect.problem(message.file, message.line, said)
        return self.protocol

    def _message(self, one: DialectMessage) -> None:
        fields = [*one.base, *one.extensions]
        size = sum(each.size * max(each.count, 1) for each in fields)
        if size > MOST_PAYLOAD:
            raise _LeftOut(f"{size} bytes of fields, and a packet has {MOST_PAYLOAD}")
        if not 0 <= one.number <= MOST_V2:
            raise _LeftOut(f"{one.number} is not a number of a message")
        name = PythonNames.unused(one.name, self.taken)
        names = {*self.heads, TRAILING, *PythonNames.TAKEN_BY_RECORDS}
        made = [self._field(one, each, names) for each in fields]
        trailing = "bytes behind the known fields; of a signed packet the last 13 are its signature"
        behind = TRAILING / c.Default(c.GreedyBytes, b"") * trailing
        self._declare(one, self.v2, "v2", name, c.Struct(*made, behind), incompat_flags=(0, 1))
        if one.number <= MOST_V1:
            self._declare(one, self.v1, "v1", name, c.Struct(*made[: len(one.base)]))

    def _declare(
        self, one: DialectMessage, framing: Framing, dialect: str, name: str, payload: c.Struct, **match: Any
    ) -> None:
        made = framing(
            name,
            match={"message": one.number, **match},
            dialect=dialect,
            check_extra=one.extra(self.crc),
            payload=payload,
            doc=ProblemText.clean("".join(one.text)),
            source=f"{one.file or Path(self.dialect.path).name}, {one.number}",
        )
        made.place = SourceLine(
            str(Path(self.dialect.path).with_name(one.file)) if one.file else self.dialect.path, one.line
        )

    def _field(self, message: DialectMessage, one: DialectField, taken: set[str]) -> c.Construct:
        name = PythonNames.unused(one.name, taken)
        if name != one.name:
            said = f"field {message.name}.{one.name} is called {name} here"
            self.dialect.problem(message.file, one.line, said, is_note=True)
        return c.Renamed(
            self._value(message, one), newname=name, newdocs=ProblemText.one_line("".join(one.text))
        )

    def _value(self, message: DialectMessage, one: DialectField) -> c.Construct:
        get = one.attributes.get
        if one.type == "char":
            return Text(max(one.count, 1))
        if get("version"):
            return c.Default(c.Byte, self.dialect.version)
        words = tuple(get(word, "") for word in ("enum", "display", "units", "multiplier", "invalid"))
        if one.type == "uint8_t" and one.count and not any(words):
            return c.Bytes(one.count)
        if words[0] in self.dialect.enums:
            words = (*words[:2], "", "", "")  # names and flags have no units
        key = (one.type, *words)
        if key not in self._values:
            self._values[key] = self._meant(message, one, *words)
        value = self._values[key]
        return c.Array(one.count, value) if one.count else value

    def _meant(
        self,
        message: DialectMessage,
        one: DialectField,
        enum: str,
        display: str,
        units: str,
        multiplier: str,
        invalid: str,
    ) -> c.Construct:
        """Return one number of a field, with its meaning."""
        number = TYPES[one.type]

        def note(reason: str) -> None:
            said = f"field {message.name}.{one.name}: {reason}"
            self.dialect.problem(message.file, one.line, said, is_note=True)

        wire = wire_number(number)
        assert wire is not None
        if enum:
            known = self.dialect.enums.get(enum)
            if known is None or wire.kind == "float":
                note(
                    f"its enumeration {ProblemText.one_line(enum)[:60]} "
                    + ("is not there" if known is None else "names a float")
                )
            elif known.is_bitmask or display == "bitmask":
                single = (
                    (name, value) for name, value in known.values if value > 0 and value.bit_count() == 1
                )
                bits = {name: value.bit_length() - 1 for name, value in single}
                return Flags(number, {name: bit for name, bit in bits.items() if bit < 8 * wire.size})
            else:
                low, high = wire.limits
                return Enumeration(number, {name: n for name, n in known.values if low <= n <= high})
        factor, unit = _UNITS.get(units, (1, ProblemText.clean(units)))
        try:
            scale = float(Fraction(multiplier.strip()) * Fraction(str(factor))) if multiplier else factor
        except (ValueError, ZeroDivisionError):
            note(f"its multiplier {ProblemText.one_line(multiplier)[:40]!r} is not a number")
            scale = factor
        try:
            unknown = _invalid(invalid, is_list=bool(one.count), is_float=wire.kind == "float")
        except ValueError:
            note(f"what it says of invalid values ({ProblemText.one_line(invalid)[:40]}) is only in its text")
            unknown = ()
        if wire.kind != "float" and any(not wire.limits[0] <= value <= wire.limits[1] for value in unknown):
            unknown = ()
        return (
            number
            if scale == 1 and not unit and not unknown
            else Quantity(number, unit=unit, scale=scale, unknown=unknown)
        )


class _LeftOut(Exception):
    """This message cannot be taken over; the argument says why."""


def _invalid(text: str, *, is_list: bool, is_float: bool) -> Sequence[float]:
    """Return the raw values of a number that mean unknown. Raises `ValueError` for what is not a number.

    Of a list an ordinary number such as 0 says something of the whole list (`[0]`), and is not taken for one of an item.
    """
    text = text.strip()
    if not text:
        return ()
    if is_list:
        text = text.removeprefix("[").removesuffix("]").removesuffix(":").strip()
    if found := _SENTINEL.fullmatch(text):
        width, is_signed = int(found[2]), not found[1]
        top = (1 << width - is_signed) - 1
        return (top if found[3] == "MAX" else -top - 1 if is_signed else 0,)
    if text.lower() == "nan":
        if not is_float:
            raise ValueError(text)
        return (float("nan"),)
    number = float(int(text, 0)) if re.fullmatch(r"[+-]?0[xX]\w+", text) else float(text)
    if is_list:
        return ()
    if not is_float and not number.is_integer():
        raise ValueError(text)
    return (number if is_float else int(number),)
