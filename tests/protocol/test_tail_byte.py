"""Transfers of DroneCAN and Cyphal: their checks, toggles and numbers, and the zeros of CAN FD."""

from __future__ import annotations

from typing import Any

import pytest
from construct import GreedyBytes, Int32ul, Struct

from aces_bus import Frame, decode
from aces_bus.errors import FieldError, SpecError
from aces_bus.protocol import Protocol, Reserved, TailByte
from tests.specs.cyphal_like import cyphal_like
from tests.specs.dronecan_like import dronecan_like, signature

ESC = ["6FF2010000000083", "4E0043B05C50FB23", "D08843"]


def frames(identifier: int, *texts: str, **more: Any) -> list[Frame]:
    return [Frame(identifier, bytes.fromhex(text), is_extended_id=True, **more) for text in texts]


def fed(protocol: Protocol, given: list[Frame]) -> list[str]:
    """What each thing is that a scanner gives: the message, or the reason."""
    scanner = protocol.scanner(include_unknown=True)
    items: list[Any] = [*scanner.feed(given), *scanner.close()]
    assert scanner.counts.total == len(given)
    return [getattr(one, "reason", type(one).__name__) for one in items]


def test_what_is_wrong_with_a_transfer_is_said() -> None:
    """Its check, a toggle that is not due, a frame that is lost, frames of the other version."""
    esc = frames(0x10040A14, *ESC)
    assert fed(dronecan_like, esc) == ["EscStatus"]
    broken = frames(0x10040A14, ESC[0], "4F" + ESC[1][2:], ESC[2])
    assert fed(dronecan_like, broken) == ["malformed: checksum"] * 3
    assert fed(dronecan_like, [esc[0], esc[2]]) == ["malformed: frame 2 missing"] * 2
    assert fed(dronecan_like, esc[1:]) == ["malformed: no first frame"] * 2
    assert fed(dronecan_like, esc[:1]) == ["pending"]
    cyphal = frames(0x10040A14, "01020304050607A5")
    assert fed(dronecan_like, cyphal) == ["malformed: no frame of tail-byte transfer"]


def test_transfers_of_one_sender_are_told_apart_by_their_numbers() -> None:
    """Also when the end of one was lost, and frames of the next come."""
    encoder = dronecan_like.variant().encoder
    fields = {"voltage": 1.0, "current": 1.0, "temperature": 1.0, "rest": b"12345"}
    # Also of another priority, but not of another node.
    encoder.next("EscStatus", priority=1, node=2, errors=0, **fields)
    one, other = (encoder.next("EscStatus", priority=n, node=1, errors=n, **fields) for n in (1, 2))
    assert [bytes(frame.data)[-1] & 0x1F for frame in (*one, *other)] == [0, 0, 0, 1, 1, 1]
    assert fed(dronecan_like, [*one[:2], *other]) == ["EscStatus", "pending", "pending"]
    assert fed(dronecan_like, [one[0], other[0], one[1], other[1], other[2], one[2]]) == ["EscStatus"] * 2


def test_checks_hold_in_columns_too() -> None:
    """Whole tables at once: transfers whose check is wrong are lost with all their frames, and no other."""
    encoder = dronecan_like.variant().encoder
    fields = {"voltage": 1.0, "current": 1.0, "temperature": 1.0, "rest": b"12345"}
    given: list[Frame] = []
    for number in range(40):
        for place, frame in enumerate(
            encoder.next("EscStatus", priority=number % 8, node=9, errors=number, **fields)
        ):
            data = bytearray(frame.data)
            data[0] ^= place == 1 and number % 10 == 3
            given.append(Frame(frame.arbitration_id, bytes(data), is_extended_id=True))
    decoded = decode(given, dronecan_like)
    assert decoded["EscStatus"]["errors"].values.tolist() == [n for n in range(40) if n % 10 != 3]
    assert decoded.counts.reasons == {"malformed: checksum": 12}


def test_the_check_of_dronecan_knows_the_type() -> None:
    """The same bytes under the signature of another type are not transfer: both sides must have the same type."""
    other = Protocol("other", link="can")
    other.message(
        "Status",
        transport=TailByte(version=0),
        id=0x10040A14,
        extended=True,
        check_extra=signature(1),
        payload=Struct("data" / GreedyBytes),
    )
    assert fed(other, frames(0x10040A14, *ESC)) == ["malformed: checksum"] * 3
    assert fed(other, frames(0x10040A14, "0102C0")) == ["Status"]  # one frame has no check


def test_the_specifications_array_in_can_fd() -> None:
    """Cyphal specification 1.0, §4.2: 92 bytes behind their number, 14 zeros that fill the last frame, the check behind."""
    data = bytes([92, 0, *range(92)])
    sent = cyphal_like.encode(
        "LongArray", priority="nominal", reserved_bits=3, node=59, data=data + bytes(14)
    )
    assert [len(frame.data) for frame in sent] == [64, 48]
    assert bytes(sent[1].data).hex(" ").endswith("5a 5b" + 14 * " 00" + " bc 19 40")
    assert all(frame.is_fd for frame in sent)
    (record,) = cyphal_like.scanner().feed(sent)
    assert record.data == data + bytes(14)


def test_what_fills_no_frame_of_can_fd_is_refused() -> None:
    """A message of fixed length says what would; one of any length says it for its data."""
    protocol = Protocol("fd", link="can")
    transport = TailByte(version=1, fd=True)
    two = Struct("a" / Int32ul, "b" / Int32ul)
    with pytest.raises(
        SpecError, match=r"8 bytes, as Two has them, fill no frames .* 11 would: .* Reserved\(3\)"
    ):
        protocol.message("Two", transport=transport, id=1, extended=True, payload=two)
    filled = Struct("a" / Int32ul, "b" / Int32ul, "filling" / Reserved(3))
    protocol.message("Two", transport=transport, id=1, extended=True, payload=filled)
    (sent,) = protocol.encode("Two", a=1, b=2)
    assert len(sent.data) == 12
    with pytest.raises(FieldError, match="LongArray"):
        cyphal_like.encode("LongArray", priority="nominal", node=59, data=bytes(8))
    with pytest.raises(SpecError, match="version is 0"):
        TailByte(version=2)  # type: ignore[arg-type]
