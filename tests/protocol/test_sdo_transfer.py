"""Service data of CANopen in segments: what opens, carries and ends a transfer, and what is wrong with one."""

from __future__ import annotations

from typing import Any

import pytest
from construct import GreedyBytes, Struct

from aces_bus import Frame
from aces_bus.errors import FieldError, SpecError
from aces_bus.protocol import Protocol, SdoTransfer
from aces_bus.testing import Scene
from tests.laws.drawn import ORACLE
from tests.specs.sdo_like import sdo_like

#: A node writes sixteen bytes to object 1008, and reads them.
WRITE = ["605#2108100010000000", "605#0061626364656667", "605#1068696A6B6C6D6E", "605#0B6F700000000000"]
TAKEN = ["585#6008100000000000", "585#2000000000000000", "585#3000000000000000", "585#2000000000000000"]
READ = [text.replace("605#21", "585#41").replace("605", "585") for text in WRITE]
ASKED = ["605#4008100000000000", "605#6000000000000000", "605#7000000000000000", "605#6000000000000000"]
REFUSED, GIVEN_UP = "585#8008100022000008", "605#8008100000000405"


def frames(*texts: str, times: tuple[float, ...] = ()) -> list[Frame]:
    found = []
    for number, text in enumerate(texts):
        identifier, _, data = text.partition("#")
        found.append(Frame(int(identifier, 16), bytes.fromhex(data), times[number] if times else None))
    return found


def fed(*texts: str, times: tuple[float, ...] = ()) -> list[str]:
    """What each thing is that a scanner gives: the message, or the reason."""
    given = frames(*texts, times=times)
    ORACLE(sdo_like.variant(), None, Scene(tuple(given)))
    scanner = sdo_like.scanner(include_unknown=True)
    items: list[Any] = [*scanner.feed(given), *scanner.close()]
    assert scanner.counts.total == len(texts)
    return [getattr(one, "reason", type(one).__name__).removeprefix("malformed: ") for one in items]


def test_a_conversation_is_one_record_each_way() -> None:
    """Segments and what asks for them or takes them, in turn: a record of the data, the others counted apart."""
    written = [text for pair in zip(WRITE, TAKEN, strict=True) for text in pair]
    assert fed(*written) == ["Written", *["control: segment taken"] * 2, "Write", "control: segment taken"]
    read = [text for pair in zip(ASKED, READ, strict=True) for text in pair]
    assert fed(*read) == ["Read", *["control: segment request"] * 3, "Object"]
    scanner = sdo_like.scanner()
    record = scanner.feed(frames(*WRITE, times=(0.0, 0.1, 0.2, 0.3)))[0]
    assert (record.node, record.index, record.subindex, record.data) == (5, 0x1008, 0, b"abcdefghijklmnop")
    assert (record.meta.identifier, record.meta.first_time, record.meta.time) == (0x605, 0.0, 0.3)
    assert len(record.meta.frames) == 4


def test_nodes_side_by_side() -> None:
    """Transfers of two nodes and of both directions, frame by frame in turn."""
    other = [text.replace("605", "606") for text in WRITE]
    in_turn = [text for three in zip(WRITE, other, READ, strict=True) for text in three]
    assert fed(*in_turn) == ["Write", "Write", "Object"]


def test_what_a_transfer_lacks_is_said() -> None:
    """Segments that are lost, doubled, late, short, or behind nothing; a toggle tells one of two."""
    assert fed(WRITE[0], *WRITE[2:]) == ["frame 2 of 4 missing"] * 2 + ["no first frame"]
    assert fed(WRITE[0], WRITE[1], WRITE[1], *WRITE[2:]) == ["repeated", "Write"]
    assert fed(*WRITE[:2], *WRITE) == ["restarted"] * 2 + ["Write"]
    assert fed(*WRITE, times=(0.0, 0.1, 1.2, 1.3)) == ["timed out"] * 2 + ["no first frame"] * 2
    assert fed(*WRITE[:3]) == ["pending"] * 3
    assert fed(*WRITE[:2], "605#1268696A6B6C6D00") == ["frame 3 of 4 is short"] * 3
    assert (
        fed(WRITE[0], WRITE[3]) == ["frame 2 of 4 is short"] * 2
    )  # two are lost: the last one comes too early
    assert fed("605#2108100091010000") == ["too long"]
    # Three bytes, and a segment of seven that is not the last; sixteen, and a third segment of seven.
    assert fed("605#2108100003000000", WRITE[1]) == ["frame 2 of 2 is too long"] * 2
    assert fed(*WRITE[:3], WRITE[1]) == ["frame 4 of 4 is too long"] * 4
    assert fed("605#2108100007000000", WRITE[1]) == ["Write"]
    assert fed("605#21081000100000") == ["length"]
    assert fed("605#E000000000000000") == ["no frame of SDO transfer"]


def test_an_abort_ends_the_transfer_and_is_a_message() -> None:
    """Of either end, whoever has the data; without a transfer it is a message, too."""
    for data in (WRITE, READ):
        assert fed(*data[:2], REFUSED) == ["aborted", "aborted", "Refused"]
        assert fed(*data[:2], GIVEN_UP, data[2]) == ["aborted", "aborted", "Abort", "no first frame"]
    assert fed(REFUSED) == ["Refused"]
    assert sdo_like.scanner().feed(frames(REFUSED))[0].code == 0x08000022


def test_sizes_need_not_be_given() -> None:
    """Without a size the last segment says that it is the last; so it does for no bytes at all."""
    for size in (0, 1, 7, 8, 300):
        data = bytes(place & 0xFF for place in range(size))
        for sized in (0, 1):
            sent = sdo_like.encode("Write", node=9, sized=sized, index=0x2000, subindex=3, data=data)
            assert len(sent) == 1 + max(1, -(-size // 7))
            (record,) = sdo_like.scanner().feed(sent)
            assert (record.sized, record.data) == (sized, data)
    with pytest.raises(FieldError, match="400"):
        sdo_like.encode("Write", node=9, sized=1, index=0x2000, subindex=3, data=bytes(397))


def test_frames_of_the_transport_are_no_messages() -> None:
    """What carries packets cannot be a message of one frame, too."""
    protocol = Protocol("mixed", link="can")
    protocol.message("Long", transport=SdoTransfer(), id=0x605, payload=Struct("data" / GreedyBytes))
    with pytest.raises(SpecError, match="by which SDO transfer carries 'Long'"):
        protocol.message("Segment", id=0x585)
