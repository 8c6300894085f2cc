"""Answers whose bytes do not say what they are: the request says it, how long they are, and what their check covers."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import pytest
from construct import Byte, Const, Int16ub, Int32ub, Struct

from aces_bus.errors import FieldError, SpecError
from aces_bus.protocol import Crc, Protocol, Quantity, RequestBytes, Slip, Text
from aces_bus.protocol.lint import check_protocol
from aces_bus.testing import law_tests

ADDRESSES = range(0x80, 0x88)
OVER = (RequestBytes(), slice(None, -2))


@cache
def claw() -> Protocol:
    """Answers of three lengths and of text, with a CRC over the request and themselves, and a bare byte."""
    made = Protocol("claw", link="serial", source="drawn after RoboClaw's packet serial")
    head = Struct("address" / Byte, "command" / Byte)
    known = {"address": ADDRESSES}
    ask = made.framing(name="ask", header=head, match={**known, "command": (16, 21, 24)}, size=2)
    check = Crc("CRC16-XMODEM", order="big")
    drive = made.framing(name="drive", header=head, match={**known, "command": (35,)}, size=6, check=check)
    covering = Crc("CRC16-XMODEM", order="big", over=OVER)
    behind = Crc("CRC16-XMODEM", order="big", over=OVER, after_end=True)
    get_count = ask("GetCount", direction="to device", match={"command": 16})
    get_version = ask("GetVersion", direction="to device", match={"command": 21})
    get_volts = ask("GetVolts", direction="to device", match={"command": 24})
    duty = drive("Drive", direction="to device", payload=Struct("duty" / Int16ub))

    made.framing(name="count", size=7, check=covering)(
        "Count",
        direction="from device",
        reply_to=get_count.where(address=ADDRESSES),
        payload=Struct("count" / Int32ub, "status" / Byte),
    )
    made.framing(name="volts", size=4, check=covering)(
        "Volts",
        direction="from device",
        reply_to=get_volts.where(address=ADDRESSES),
        payload=Struct("volts" / Quantity(Int16ub, scale=0.1, unit="V")),
    )
    made.framing(name="text", end=b"\n\0", max_size=50, check=behind)(
        "Version",
        direction="from device",
        reply_to=get_version.where(address=ADDRESSES),
        payload=Struct("text" / Text()),
    )
    made.framing(name="done", size=1)(
        "Done",
        direction="from device",
        reply_to=duty.where(address=ADDRESSES),
        payload=Struct(Const(b"\xff")),
    )
    return made


test_answers_obey_the_laws = law_tests(claw(), examples=4)


def told(given: Sequence[object]) -> list[str]:
    """Name records, and unknown bytes by their reason."""
    return [getattr(item, "reason", type(item).__name__) for item in given]


def test_a_check_covers_the_request() -> None:
    """The CRC of address, command and data in one run, worked by hand: 80 10, 0000002A 00."""
    whole = Crc("CRC16-XMODEM").compute(bytes.fromhex("80 10 00 00 00 2A 00"))
    found = claw().encode("Count", address=0x80, count=42, status=0)
    assert found == bytes.fromhex("00 00 00 2A 00") + whole.to_bytes(2, "big")


def test_an_awaited_answer_is_there_with_its_last_byte() -> None:
    """No silence is waited for: each answer is complete when the request's length is reached and the check holds."""
    made = claw()
    scanner = made.scanner(direction="from device")
    for address in ADDRESSES:
        answers: tuple[tuple[str, str, dict[str, Any]], ...] = (
            ("GetCount", "Count", {"count": 7 * address, "status": 1}),
            ("GetVersion", "Version", {"text": f"unit {address:X}"}),
            ("GetVolts", "Volts", {"volts": 12.5}),
        )
        for ask, answer, fields in answers:
            packet = made.encode(answer, address=address, **fields)
            scanner.sent(made.encode(ask, address=address))
            for byte in packet[:-1]:
                assert scanner.feed(bytes([byte])) == []
            (record,) = scanner.feed(packet[-1:])
            assert {name: getattr(record, name) for name in fields} == fields
            assert record.address == address
        scanner.sent(made.encode("Drive", address=address, duty=5))
        (done,) = scanner.feed(b"\xff")
        assert done.address == address


def test_an_answer_to_another_device_is_refused() -> None:
    """The same bytes behind a request to another address fail the check."""
    made = claw()
    scanner = made.scanner(direction="from device", include_unknown=True)
    scanner.sent(made.encode("GetVolts", address=0x81))
    given = scanner.feed(made.encode("Volts", address=0x80, volts=12.0))
    assert set(told([*given, *scanner.idle()])) == {"malformed: checksum", "malformed: incomplete"}


def test_a_newer_request_ends_the_wait_for_an_older_one() -> None:
    """What was asked last is awaited: a lost answer of seven bytes does not hold back four, and what comes late is lost."""
    made = claw()
    scanner = made.scanner(direction="from device", include_unknown=True)
    scanner.sent(made.encode("GetCount", address=0x80))
    scanner.sent(made.encode("GetVolts", address=0x80))
    assert told(scanner.feed(made.encode("Volts", address=0x80, volts=1.0))) == ["Volts"]
    late = scanner.feed(made.encode("Count", address=0x80, count=1, status=0))
    assert {reason.partition(" GetCount")[0] for reason in told(late)} == {"unknown: needs request"}


def test_a_line_with_both_directions_is_read() -> None:
    """Requests and answers of eight devices in one recording, also where a device did not answer."""
    made = claw()
    scanner = made.scanner(direction="both", include_unknown=True)
    line = b""
    for address in ADDRESSES:
        line += made.encode("GetCount", address=address)
        line += made.encode(
            "Count", address=address, count=0x80100000, status=0x80
        )  # begins as a request does
        line += made.encode("GetVersion", address=address)  # nobody answers
        line += made.encode("Drive", address=address, duty=1) + b"\xff"
    names = told([*scanner.feed(line), *scanner.close()])
    assert names == ["GetCount", "Count", "GetVersion", "Drive", "Done"] * 8


def test_what_a_check_over_the_request_needs() -> None:
    """One request, all of whose fields the record has; no stuffing; an end for a check behind it."""
    made = Protocol("wrong", link="serial")
    head = Struct("address" / Byte, "command" / Byte)
    ask = made.framing(name="ask", header=head, match={"command": (1,)}, size=2)("Ask", direction="to device")
    check = Crc("CRC16-XMODEM", over=OVER)
    answer = made.framing(name="answer", size=4, check=check)
    for hangs_on in ({}, {"reply_to": ask}, {"after": ask.where(address=range(256))}):
        with pytest.raises(SpecError, match=r"covers its request, which its record must say"):
            answer("Answer", direction="from device", payload=Struct("x" / Int16ub), **hangs_on)
    with pytest.raises(SpecError, match="does not go with stuffing"):
        made.framing(end=b"\xc0", stuffing=Slip(), max_size=9, check=check)
    with pytest.raises(SpecError, match="behind the end"):
        made.framing(size=4, check=Crc("CRC16-XMODEM", after_end=True))
    with pytest.raises(FieldError, match="no value given for address"):
        claw().encode("Volts", volts=1.0)


def test_a_framing_that_holds_back_others_is_found() -> None:
    """Without marks and without requests its packets may begin anywhere; with requests they do not."""
    made = Protocol("held", link="serial")
    made.framing(name="marked", sync=b"$", size=3)("Marked", payload=Struct("x" / Int16ub))
    made.framing(name="bare", size=4)("Bare", overrides="Marked", payload=Struct("x" / Int32ub))
    (found,) = [finding for finding in check_protocol(made) if finding.rule == "waits"]
    assert "any byte may begin its packets" in found.text
    assert [finding for finding in check_protocol(claw()) if finding.rule == "waits"] == []


def test_exports_say_what_they_leave_out() -> None:
    """C leaves such answers out, a dissector does not verify their checks; tables of people say what is covered."""
    from aces_lab.exchange import print_c_source, print_dissector, print_markdown

    variant = claw().variant()
    left_out = {loss.message: loss.reason for loss in print_c_source(variant).losses}
    assert {"Count", "Volts", "Version"} <= set(left_out)
    _, losses = print_dissector(variant)
    assert sum("the check over the request" in str(loss) for loss in losses) == 3
    page = print_markdown(variant)
    assert "CRC16-XMODEM over request and packet, behind the end" in page


def test_a_newer_request_does_not_make_an_old_answer_another() -> None:
    """A bare acknowledgement that comes late is not the beginning of the answer that is awaited now."""
    made = claw()
    scanner = made.scanner(direction="from device", include_unknown=True)
    scanner.sent(made.encode("Drive", address=0x80, duty=1))
    scanner.sent(made.encode("GetVolts", address=0x80))
    given = scanner.feed(b"\xff" + made.encode("Volts", address=0x80, volts=3.0))
    assert told(given) == ["malformed: checksum", "Volts"]
