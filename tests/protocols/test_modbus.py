"""Modbus RTU: how long packets are, who asked, and what silence ends."""

from __future__ import annotations

from typing import Any

import pytest

from aces_bus import as_dict
from aces_bus.errors import SpecError
from aces_bus.protocol import Protocol
from aces_bus.protocol.live.stream import StreamScanner
from aces_bus.protocol.reference import Reference
from aces_protocols.modbus.spec import GAP, modbus

READ = bytes.fromhex("09 03 00 B4 00 06 84 A6")
FORCES = bytes.fromhex("09 03 0C 03 E8 FF 06 13 88 00 64 FF EC 00 05 F5 B9")


def scanner_of(direction: Any = "both", **options: Any) -> StreamScanner:
    scanner = modbus.scanner(direction=direction, include_unknown=True, **options)
    assert isinstance(scanner, StreamScanner)
    return scanner


def names(records: Any) -> list[str]:
    return [type(record).__name__ for record in records]


def test_no_silence_is_needed_where_the_function_says_the_length() -> None:
    """A recording without times: requests and answers one behind the other, whole or byte by byte."""
    data = (READ + FORCES) * 3 + bytes.fromhex(
        "09 10 01 9A 00 01 02 02 00 CD CA 09 10 01 9A 00 01 21 52 09 83 02 41 33"
    )
    wanted = [*["ReadRegisters", "Registers"] * 3, "WriteRegisters", "RegistersWritten", "Refusal"]
    whole, pieces = scanner_of(), scanner_of()
    assert names([*whole.feed(data), *whole.close()]) == wanted
    assert whole.counts.decoded == len(data)
    found = [record for byte in data for record in pieces.feed(bytes([byte]))] + pieces.close()
    assert names(found) == wanted
    assert [one.message for one in Reference([modbus.variant()], direction="both").stream(data)] == wanted


def test_an_answer_nobody_asked_for_has_no_addresses() -> None:
    """The same bytes with their request, without it, a second time, and for another unit."""
    scanner = scanner_of("from device")
    assert names(scanner.feed(FORCES)) == ["UnaskedRegisters"]
    scanner.sent(READ)
    first, second = scanner.feed(FORCES + FORCES)
    assert (as_dict(first)["start"], as_dict(first)["count"]) == (180, 6)
    assert names([second]) == ["UnaskedRegisters"]
    assert not hasattr(second, "start")
    scanner.sent(modbus.encode("ReadRegisters", unit=8, function=3, start=180, count=6))
    scanner.sent(modbus.encode("ReadRegisters", unit=9, function=4, start=180, count=6))
    assert names(scanner.feed(FORCES)) == ["UnaskedRegisters"]


def test_other_functions_end_by_silence() -> None:
    """Of a function of a device's own nobody knows the length: its packet is whole when the line is silent."""
    scanner = scanner_of("to device")
    asked = modbus.encode("Other", unit=1, function=65, data=b"\x01\x02\x03")
    assert scanner.feed(asked, 1.0) == []
    assert scanner.idle(1.0 + GAP / 2) == []
    assert [as_dict(one) for one in scanner.idle(1.0 + 2 * GAP)] == [
        {"unit": 1, "function": 65, "data": b"\x01\x02\x03"}
    ]


def test_half_a_packet_does_not_hold_up_the_next_one() -> None:
    """Noise that looks like a long packet ends with the silence behind it."""
    scanner = scanner_of("from device")
    scanner.sent(READ)
    assert scanner.feed(b"\x09\x03\xf0\x01") == []
    scanner.idle()
    assert names(scanner.feed(FORCES)) == ["Registers"]


def test_the_stream_of_the_force_sensor_shares_the_line() -> None:
    """Between answers, told by its own head and check."""
    forces = modbus["ForceTorque"].examples[0].packet.data
    scanner = scanner_of("from device")
    scanner.sent(READ)
    assert names(scanner.feed(forces + FORCES + forces)) == ["ForceTorque", "Registers", "ForceTorque"]


def test_a_framing_matches_where_nothing_marks_the_beginning() -> None:
    """`match=` of a framing is refused behind sync bytes, for fields that are not there, for numbers that are not byte."""
    from construct import Byte, Int16ub, Struct

    wire = Protocol("wire", link="serial")
    head = Struct("unit" / Byte, "function" / Byte, "wide" / Int16ub)
    for given, message in (
        ({"sync": b"\xaa", "match": {"function": {1}}}, "for packets without sync bytes"),
        ({"match": {"funktion": {1}}}, r"not 'funktion' \(there are: unit, function\)"),
        ({"match": {"wide": {1}}}, "one-byte fields of the header, not 'wide'"),
        ({"match": {"function": {256}}}, "numbers from 0 to 255"),
        ({"match": {"function": set()}}, "numbers from 0 to 255"),
    ):
        with pytest.raises(SpecError, match=message):
            wire.framing(header=head, size=8, **given)
