"""Sessions of J1939: what opens, carries and ends them, and what is wrong with them."""

from __future__ import annotations

from typing import Any

import pytest

from aces_bus import Frame
from aces_bus.errors import FieldError, SpecError
from aces_bus.protocol import IdField, J1939Transport, Protocol
from aces_bus.testing import Scene
from tests.laws.drawn import ORACLE
from tests.specs.j1939_long import j1939_long

#: The vehicle's number, said to all; ten bytes for F9.
VIN = [
    "1CECFF00#20120003FFECFE00",
    "1CEBFF00#0131584B44443439",
    "1CEBFF00#025830414A313233",
    "1CEBFF00#033435362AFFFFFF",
]
TEN = ["1CECF900#100A0002FF00EF00", "1CEBF900#0101020304050607", "1CEBF900#0208090AFFFFFFFF"]


def frames(*texts: str, times: tuple[float, ...] = ()) -> list[Frame]:
    found = []
    for number, text in enumerate(texts):
        identifier, _, data = text.partition("#")
        time = times[number] if times else None
        found.append(Frame(int(identifier, 16), bytes.fromhex(data), time, is_extended_id=True))
    return found


def fed(*texts: str, times: tuple[float, ...] = ()) -> list[str]:
    """What each thing is that a scanner gives: the message, or the reason."""
    given = frames(*texts, times=times)
    ORACLE(j1939_long.variant(), None, Scene(tuple(given)))
    scanner = j1939_long.scanner(include_unknown=True)
    items: list[Any] = [*scanner.feed(given), *scanner.close()]
    assert scanner.counts.total == len(texts)
    return [getattr(one, "reason", type(one).__name__).removeprefix("malformed: ") for one in items]


def test_sessions_of_one_sender_side_by_side() -> None:
    """To all, to one, and one the other way, frame by frame in turn; steering is counted apart."""
    back = [text.replace("F900", "00F9") for text in TEN]
    steering = ["1CEC00F9#110201FFFF00EF00", "1CEC00F9#130A0002FF00EF00"]
    in_turn = [
        VIN[0],
        TEN[0],
        back[0],
        steering[0],
        VIN[1],
        TEN[1],
        back[1],
        TEN[2],
        VIN[2],
        back[2],
        steering[1],
        VIN[3],
    ]
    assert fed(*in_turn) == [
        "control: clear to send",
        "Proprietary",
        "Proprietary",
        "control: end of message",
        "VehicleIdentification",
    ]


def test_data_may_come_again_and_late() -> None:
    """A receiver that missed a frame asks for it anew, with those behind it: the packet is whole, the others repeated."""
    assert fed(TEN[0], TEN[2], TEN[1]) == ["Proprietary"]
    assert fed(TEN[0], TEN[1], TEN[1], TEN[2]) == ["repeated", "Proprietary"]
    assert fed(*TEN, times=(0.0, 1.2, 2.4)) == ["Proprietary"]


def test_a_broadcast_has_one_order_and_t1() -> None:
    """Nobody asks for its frames again: after two losses, frames of two broadcasts do not become one packet."""
    assert fed(VIN[0], *VIN[2:], VIN[1]) == ["frame 2 of 4 missing"] * 2 + ["no first frame"] * 2
    assert fed(VIN[0], VIN[1], VIN[1], *VIN[2:]) == ["repeated", "VehicleIdentification"]
    assert fed(*VIN, times=(0.0, 0.7, 1.4, 2.1)) == ["VehicleIdentification"]
    assert fed(*VIN, times=(0.0, 0.2, 0.4, 1.2)) == ["timed out"] * 3 + ["no first frame"]


def test_what_a_session_lacks_is_said() -> None:
    """Frames that are lost, late, begun anew, or contradict what was announced."""
    assert fed(*VIN[:2], VIN[3], *VIN) == ["frame 3 of 4 missing"] * 3 + ["VehicleIdentification"]
    assert fed(TEN[0], TEN[2], *TEN) == ["frame 2 of 3 missing"] * 2 + ["Proprietary"]
    assert fed(*VIN[:2], *VIN) == ["restarted"] * 2 + ["VehicleIdentification"]
    assert fed(*VIN, times=(0.0, 0.1, 1.4, 1.5)) == ["timed out"] * 2 + ["no first frame"] * 2
    assert fed(*VIN[:3]) == ["pending"] * 3
    assert fed(*TEN[1:]) == ["no first frame"] * 2
    assert fed("1CECFF00#2012000400ECFE00") == ["length"]  # 18 bytes are three frames
    assert fed("1CECFF00#2008000200ECFE00") == ["length"]  # 8 bytes are not a packet
    assert fed("1CECFF00#1012000300ECFE00") == ["no frame of J1939 transport"]  # a request to everybody
    assert fed("1CECFF00#20120003") == ["length"]
    assert fed(TEN[0], "1CEBF900#0331584B44443439") == ["frame 4 of 3 beyond its end"] * 2
    assert fed(VIN[0].replace("ECFE", "EBFE"), *VIN[1:]) == ["unknown"] * 4  # a group that no message has


def test_an_abort_ends_the_packet_of_either_way() -> None:
    """Of the receiver mostly, of the sender where that has one under way; one without a packet is counted, too."""
    for way in ("00F9", "F900"):
        abort = f"1CEC{way}#FF03FFFFFF00EF00"
        assert fed(*TEN[:2], abort, abort) == ["aborted"] * 2 + ["control: abort, timed out"] * 2


def test_frames_of_a_packet() -> None:
    """Up to 8 bytes are a frame with the group's own identifier; what opens a session has the packet's priority."""
    (short,) = j1939_long.encode("Proprietary", priority=3, source=1, destination=2, data=b"12345678")
    assert (short.arbitration_id, bytes(short.data)) == (0x0CEF0201, b"12345678")
    opening, *data = j1939_long.encode(
        "Proprietary", priority=3, source=1, destination=0xFF, data=b"123456789"
    )
    assert (opening.arbitration_id, bytes(opening.data).hex()) == (0x0CECFF01, "20090002ff00ef00")
    assert [(one.arbitration_id, bytes(one.data)) for one in data] == [
        (0x1CEBFF01, b"\x011234567"),
        (0x1CEBFF01, b"\x0289\xff\xff\xff\xff\xff"),
    ]
    with pytest.raises(FieldError, match="Proprietary: 1786 bytes"):
        j1939_long.encode("Proprietary", priority=3, source=1, destination=2, data=bytes(1786))


def test_frames_of_the_transport_are_no_messages() -> None:
    """Whichever is declared first: the frames that carry packets cannot be a message, too."""
    text = r"0xecff01 of 'Connection' .* by which J1939 transport carries 'Long'"
    connection = IdField("priority", range(8)) << 26 | 0xECFF01
    first = Protocol("first", link="can")
    first.message("Long", transport=J1939Transport(), id=0x18FEEC00, extended=True)
    with pytest.raises(SpecError, match=text):
        first.message("Connection", id=connection, extended=True)
    second = Protocol("second", link="can")
    second.message("Connection", id=connection, extended=True)
    with pytest.raises(SpecError, match=text):
        second.message("Long", transport=J1939Transport(), id=0x18FEEC00, extended=True)
