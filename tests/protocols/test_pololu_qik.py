"""The spec of Pololu qik drivers, against worked examples; answers without a number."""

from __future__ import annotations

from typing import Any

import pytest

from aces_bus import Unknown
from aces_bus.errors import FieldError
from aces_bus.protocol.live.stream import StreamScanner
from aces_protocols.pololu_qik.records import (
    Coast,
    Configuration,
    ConfigurationSet,
    Errors,
    Firmware,
    GetConfiguration,
    GetError,
    GetFirmware,
    SetConfiguration,
    SetSpeed,
)
from aces_protocols.pololu_qik.spec import pololu_qik

#: Bytes, message, fields: the facts' three, and one of each kind.
WORKED: list[tuple[str, str, dict[str, Any]]] = [
    ("AA 01 0A 32", "SetSpeed", {"id": 1, "motor": 0, "reverse": 1, "high": 0, "speed": 50}),
    ("AA 02 0C 7F", "SetSpeed", {"id": 2, "motor": 1, "reverse": 0, "high": 0, "speed": 127}),
    ("AA 01 04 00 05 55 2A", "SetConfiguration", {"id": 1, "parameter": "device_id", "value": 5}),
    ("AA 09 0F 00", "SetSpeed", {"id": 9, "motor": 1, "reverse": 1, "high": 1, "speed": 0}),
    ("AA 7F 01", "GetFirmware", {"id": 127}),
    ("AA 00 02", "GetError", {"id": 0}),
    ("AA 01 03 02", "GetConfiguration", {"id": 1, "parameter": "shutdown_on_error"}),
    ("AA 01 07", "Coast", {"id": 1, "motor": 1}),
]


@pytest.mark.slow
@pytest.mark.parametrize(("text", "name", "fields"), WORKED)
def test_worked_examples(text: str, name: str, fields: dict[str, Any]) -> None:
    """Each is read and written as printed."""
    data = bytes.fromhex(text)
    (record,) = pololu_qik.scanner(direction="to device").feed(data)
    assert type(record).__name__ == name
    assert {key: getattr(record, key) for key in fields} == fields
    assert pololu_qik.encode(name, **fields) == data


def test_every_motor_command() -> None:
    """0x08 to 0x0F are motor, direction and range, bit by bit; 0x06 and 0x07 let go."""
    scanner = pololu_qik.scanner(direction="to device")
    for command in range(0x08, 0x10):
        (record,) = scanner.feed(bytes((0xAA, 1, command, 100)))
        assert isinstance(record, SetSpeed)
        assert (record.motor, record.reverse, record.high) == (
            command >> 2 & 1,
            command >> 1 & 1,
            command & 1,
        )
    for motor in (0, 1):
        (record,) = scanner.feed(bytes((0xAA, 1, 6 + motor)))
        assert isinstance(record, Coast)
        assert record.motor == motor


def test_an_argument_has_seven_bits() -> None:
    """A speed or number of 0x80 or more is not a command, and cannot be sent."""
    scanner = pololu_qik.scanner(direction="to device", include_unknown=True)
    found = [*scanner.feed(bytes.fromhex("AA 01 08 AA 05 00 00")), *scanner.close()]
    assert [one.reason for one in found] == ["unknown", "unknown", "skipped"]
    assert scanner.counts.decoded == 0
    for number, speed in ((128, 0), (1, 128)):
        with pytest.raises(FieldError):
            pololu_qik.encode("SetSpeed", id=number, motor=0, reverse=0, high=0, speed=speed)


def test_format_bytes_must_be_right() -> None:
    """SetConfiguration without 55 2A sets nothing."""
    scanner = pololu_qik.scanner(direction="to device")
    assert scanner.feed(bytes.fromhex("AA 01 04 00 05 55 2B")) == []
    assert scanner.counts.decoded == 0


def test_an_answer_is_its_requests() -> None:
    """One byte means what was asked, of whom it was asked; without a request it means nothing."""
    scanner = pololu_qik.scanner(direction="from device", include_unknown=True)
    asked: list[tuple[str, dict[str, Any], Any, str, Any, int]] = [
        ("GetFirmware", {}, Firmware, "version", "1", 0x31),
        ("GetConfiguration", {"parameter": "pwm"}, Configuration, "value", 0x31, 0x31),
        ("SetConfiguration", {"parameter": "pwm", "value": 9}, ConfigurationSet, "result", "bad_value", 2),
    ]
    for number, (name, fields, kind, field, value, byte) in enumerate(asked):
        scanner.sent(pololu_qik.encode(name, id=number, **fields))
        (record,) = scanner.feed(bytes((byte,)))
        assert isinstance(record, kind)
        assert (record.id, getattr(record, field)) == (number, value)
    (lost,) = scanner.feed(b"\x31")
    assert isinstance(lost, Unknown)
    assert lost.reason.startswith("unknown: needs request GetFirmware|GetError")


def test_error_bits() -> None:
    """Bits 3 to 7 have names, the others are kept."""
    scanner = pololu_qik.scanner(direction="from device")
    scanner.sent(pololu_qik.encode("GetError", id=4))
    (record,) = scanner.feed(b"\xc9")
    assert isinstance(record, Errors)
    assert record.errors == 0xC9
    assert list(record.errors) == ["overrun", "format", "timeout"]
    assert not record.errors.frame


def test_both_ways_on_one_line() -> None:
    """A recording of both ways pairs requests and answers, be an answer AA, which opens every command."""
    data = bytes.fromhex("AA 01 01 32  AA 01 03 03 AA  AA 02 02 00  AA 02 08 10")
    scanner = pololu_qik.scanner(direction="both", include_unknown=True)
    records = [*scanner.feed(data), *scanner.close()]
    kinds = [GetFirmware, Firmware, GetConfiguration, Configuration, GetError, Errors, SetSpeed]
    assert [isinstance(one, kind) for one, kind in zip(records, kinds, strict=True)] == [True] * len(kinds)
    assert records[3].value == 0xAA
    assert scanner.counts.decoded == len(data)


def test_a_command_that_never_ends_is_given_up() -> None:
    """After a pause longer than the gap the rest does not come; what follows is read."""
    scanner = pololu_qik.scanner(direction="to device")
    assert isinstance(scanner, StreamScanner)
    assert scanner.feed(b"\xaa\x01\x04\x00", 0.0) == []
    assert scanner.idle(0.2) == []
    (record,) = scanner.feed(bytes.fromhex("AA 01 04 01 01 55 2A"), 0.3)
    assert isinstance(record, SetConfiguration)
    assert record.parameter == "pwm"
