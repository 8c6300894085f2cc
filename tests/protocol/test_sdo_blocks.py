"""Block transfers of CANopen's service data: what they carry, what is lost on the wire and on the way to who listens."""

from __future__ import annotations

from binascii import crc_hqx
from collections.abc import Sequence
from random import Random
from typing import Any

import pytest

from aces_bus import Frame
from aces_bus.errors import FieldError
from aces_bus.testing import Scene
from tests.laws.drawn import ACCOUNTING, CHUNKING, NO_FALSE_ACCEPT, ORACLE
from tests.specs.sdo_like import sdo_like

#: A client writes ten bytes to object 1008 of node 5 in one block, and reads them.
WRITE = [
    "605#C60810000A000000",
    "585#A40810007F000000",
    "605#0161626364656667",
    "605#8268696A00000000",
    "585#A2027F0000000000",
    "605#D12AA30000000000",
]
DONE = "585#A100000000000000"
READ = [
    "585#C60810000A000000",
    "605#A300000000000000",
    "585#0161626364656667",
    "585#8268696A00000000",
    "605#A2027F0000000000",
    "585#D12AA30000000000",
]
ASKED, READ_DONE = "605#A40810007F000000", "605#A100000000000000"
#: A segment that is, elsewhere, an expedited write of four bytes.
LIKE_A_WRITE = "605#2317100001020304"


def frames(*texts: str, times: tuple[float, ...] = ()) -> list[Frame]:
    found = []
    for number, text in enumerate(texts):
        identifier, _, data = text.partition("#")
        found.append(Frame(int(identifier, 16), bytes.fromhex(data), times[number] if times else None))
    return found


def fed(*texts: str, times: tuple[float, ...] = ()) -> list[str]:
    """What each thing is that a scanner gives, which reference and columns say, too: the message, or the reason."""
    given = frames(*texts, times=times)
    for law in (ORACLE, CHUNKING, ACCOUNTING):
        law(sdo_like.variant(), None, Scene(tuple(given)), cuts=range(1, len(given)))
    scanner = sdo_like.scanner(include_unknown=True)
    items: list[Any] = [*scanner.feed(given), *scanner.close()]
    return [getattr(one, "reason", type(one).__name__).removeprefix("malformed: ") for one in items]


@pytest.mark.slow
def test_a_conversation_is_one_record_each_way() -> None:
    """What begins, carries, takes and ends it are its frames; the receiver's last frame is counted apart."""
    assert fed(*WRITE, DONE) == ["WriteBlocks", "control: block transfer over"]
    assert fed(ASKED, *READ, READ_DONE) == ["ReadBlocks", "ObjectInBlocks", "control: block transfer over"]
    (record,) = sdo_like.scanner().feed(frames(*WRITE, times=tuple(0.1 * n for n in range(6))))
    assert (record.node, record.checked, record.index, record.data) == (5, 1, 0x1008, b"abcdefghij")
    assert (record.meta.identifier, record.meta.first_time, record.meta.time) == (0x605, 0.0, 0.5)
    assert len(record.meta.frames) == 6


def test_segments_look_like_other_frames_and_are_none() -> None:
    """Segment 35 is like an expedited write, segment 65 of the end like a last frame: the conversation decides."""
    data = bytes(range(200)) * 3
    for size in (35 * 7, 64 * 7, 65 * 7, 69 * 7 - 3, 7 * 127, 7 * 127 + 1):
        piece = (data * 2)[:size]
        protocol_frames = sdo_like.encode(
            "WriteBlocks", node=9, checked=1, sized=0, index=1, subindex=2, data=piece[:396]
        )
        (record,) = sdo_like.scanner(include_unknown=True).feed(protocol_frames)
        assert record.data == piece[:396]
    many = sdo_like.encode("ObjectInBlocks", node=9, checked=0, sized=1, index=1, subindex=2, data=data[:396])
    assert any(bytes(frame.data)[0] == 0x23 for frame in many)
    with pytest.raises(FieldError, match="400"):
        sdo_like.encode("ObjectInBlocks", node=9, checked=0, sized=1, index=1, subindex=2, data=bytes(397))


def test_what_the_receiver_has_not_taken_comes_again() -> None:
    """It took the first of four segments: the other three are sent anew, as segments 1 to 3 behind it."""
    again = ["605#0168696A6B6C6D6E", "605#026F707172737475", "605#8376000000000000"]
    begun = [
        "605#C608100016000000",
        WRITE[1],
        WRITE[2],
        "605#0268696A6B6C6D6E",
        "605#036F707172737475",
        "605#8476000000000000",
    ]
    text = b"abcdefghijklmnopqrstuv"
    end = f"605#D9{crc_hqx(text, 0).to_bytes(2, 'little').hex()}0000000000"
    told = [*begun, "585#A2017F0000000000", *again, "585#A2037F0000000000", end]
    assert fed(*told) == ["WriteBlocks"]
    (record,) = sdo_like.scanner().feed(frames(*told))
    assert (record.data, len(record.meta.frames)) == (text, len(told))
    # What was not taken need not have been seen, nor be right.
    assert fed(*told[:3], *told[5:]) == ["WriteBlocks"]
    nothing = [*told[:6], "585#A2007F0000000000", *told[2:6], "585#A2047F0000000000", end]
    assert fed(*nothing) == ["WriteBlocks"]


def test_what_a_transfer_lacks_is_said_and_its_frames_are_no_messages() -> None:
    """From the fault to the transfer's end, whatever its frames look like."""
    rest = [LIKE_A_WRITE, *WRITE[4:], DONE]
    lost = ["no first frame"] * 3 + ["control: block transfer over"]
    assert fed(*WRITE[:2], *WRITE[3:5], *rest) == ["frame 2 of 4 missing"] * 4 + lost
    assert fed(*WRITE[:4], "605#0141424344454647", *rest) == ["frame 2 of 4 twice"] * 5 + lost
    assert fed(*WRITE[:4], WRITE[1], *rest) == ["restarted"] * 5 + lost
    assert fed(*WRITE[:4], WRITE[5], DONE) == ["acknowledgement missing"] * 5 + [lost[-1]]
    assert fed(*WRITE[:5], DONE) == ["frame 4 of 4 missing"] * 5 + [lost[-1]]
    assert fed(*WRITE[:2], DONE) == ["frame 2 of 4 missing"] * 2 + [lost[-1]]
    assert fed("605#C0", *WRITE[1:5], *rest)[1:] == ["no first frame"] * 7 + [lost[-1]]
    assert fed("605#C608100091010000", *WRITE[1:5], *rest) == ["too long"] + ["no first frame"] * 7 + [
        lost[-1]
    ]
    refused = "605#C608100091010000"
    assert fed(*WRITE[:5], refused) == ["restarted"] * 5 + ["too long"]
    assert fed(*WRITE[:2], *WRITE[3:5], refused) == ["frame 2 of 4 missing"] * 4 + ["too long"]
    assert fed(*WRITE[:2], refused, *WRITE[1:5]) == ["restarted"] * 2 + ["too long"] + ["no first frame"] * 4
    assert fed(WRITE[0].replace("0A", "0B"), *WRITE[1:], LIKE_A_WRITE, DONE) == ["length"] * 6 + lost[-2:]
    assert fed(*WRITE[:5], WRITE[5].replace("2AA3", "2BA3")) == ["checksum"] * 6
    assert fed(*WRITE[:3]) == ["pending"] * 3


@pytest.mark.slow
def test_who_begins_anew_has_given_up() -> None:
    """The sender with its first frame, before there are segments; the receiver with any other request."""
    assert fed(*WRITE[:2], *WRITE) == ["restarted"] * 2 + ["WriteBlocks"]
    assert fed(*READ[:3], ASKED, *READ) == ["restarted"] * 3 + ["ReadBlocks", "ObjectInBlocks"]
    assert fed(*READ[:3], "605#4008100000000000") == ["restarted"] * 3 + ["Read"]
    assert fed(*READ[:3], "605#2108100010000000", *WRITE) == ["restarted"] * 4 + ["WriteBlocks"]
    assert fed(*WRITE[:5], "605#4008100000000000") == ["restarted"] * 5 + ["Read"]


def test_an_abort_of_either_ends_it_and_is_a_message() -> None:
    """Also of one that is lost already."""
    client, node = "605#8008100000000405", "585#8008100022000008"
    assert fed(*WRITE[:3], client, LIKE_A_WRITE) == ["aborted"] * 3 + ["Abort", "WriteShort"]
    assert fed(*WRITE[:3], node) == ["aborted"] * 3 + ["Refused"]
    assert fed(*READ[:3], client) == ["aborted"] * 3 + ["Abort"]
    assert fed(*WRITE[:2], *WRITE[3:5], node, LIKE_A_WRITE) == ["frame 2 of 4 missing"] * 4 + [
        "Refused",
        "WriteShort",
    ]


def test_frames_that_come_twice_and_late() -> None:
    """Each frame but the first and the last may come twice; silence ends the packet."""
    for place in range(1, 5):
        assert fed(*WRITE[: place + 1], *WRITE[place:]) == ["repeated", "WriteBlocks"]
    late = (0.0, 0.1, 0.2, 1.4, 1.5, 1.6)
    assert fed(*WRITE, times=late) == ["timed out"] * 3 + ["unknown", "no first frame", "no first frame"]
    assert fed(*WRITE[:3], LIKE_A_WRITE, times=(0.0, 0.1, 0.2, 1.4)) == ["timed out"] * 3 + ["WriteShort"]


def test_a_crc_of_0_is_not_checked() -> None:
    """CANopenNode sends 0 where the client has not asked for a CRC, and says that it knows them."""
    assert fed(*READ[:5], "585#D100000000000000") == ["ObjectInBlocks"]
    assert fed(READ[0].replace("C6", "C2"), *READ[1:5], "585#D112340000000000") == ["ObjectInBlocks"]


def talk(source: Random, node: int) -> list[Frame]:
    """A transfer as its two ends have it on a bus that loses frames: a receiver that misses a segment asks for it again."""
    is_upload = source.random() < 0.5
    data = source.randbytes(source.choice((0, 1, 7, 8, 60, 150)))
    name = "ObjectInBlocks" if is_upload else "WriteBlocks"
    whole = sdo_like.encode(
        name, node=node, checked=1, sized=source.randrange(2), index=1, subindex=0, data=data
    )
    found = [Frame(one.arbitration_id, bytes(one.data)) for one in whole]
    first, ready, end, back = found[0], found[1], found[-1], found[1].arbitration_id
    pieces = [one.data for one in found[2:-1] if one.arbitration_id != back]
    out, at = [first, ready], 0
    while at < len(pieces):
        size = source.choice((1, 3, 5, 127))
        block = pieces[at : at + size]
        missed = source.randrange(len(block)) if source.random() < 0.3 else len(block)
        for number, piece in enumerate(block):
            last = 0x80 if at + number + 1 == len(pieces) else 0
            if number != missed or source.random() < 0.5:
                out.append(Frame(first.arbitration_id, bytes([last | number + 1]) + piece[1:]))
        out.append(Frame(back, bytes([0xA2, missed, size]).ljust(8, b"\0")))
        at += missed
    return [*out, end, Frame(back, b"\xa1".ljust(8, b"\0"))]


def shaken(source: Random, given: Sequence[Frame]) -> list[Frame]:
    """The same with something lost, doubled or moved."""
    out = list(given)
    for _ in range(source.randrange(4)):
        at = source.randrange(len(out))
        how = source.randrange(3)
        if how == 0 and len(out) > 1:
            del out[at]
        elif how == 1:
            out.insert(source.randrange(at, len(out) + 1), out[at])
        else:
            out.insert(source.randrange(len(out)), out.pop(at))
    return out


@pytest.mark.parametrize("seed", range(20))
def test_scanner_reference_and_columns_agree_on_what_goes_wrong(seed: int) -> None:
    """Conversations of several nodes side by side, with frames lost, doubled and moved, and cut anywhere."""
    source = Random(seed)
    running = [shaken(source, talk(source, node) + talk(source, node)) for node in (1, 2, 127)]
    frames: list[Frame] = []
    time = 0.0
    while running:
        mine = source.choice(running)
        time += source.choice((0.0, 0.001, 0.001, 0.001, 0.02, 1.1 if source.random() < 0.1 else 0.0))
        channel = "can0" if mine[0].arbitration_id & 0x7F == 2 else None
        one = mine.pop(0)
        frames.append(Frame(one.arbitration_id, one.data, round(time, 6), channel))
        running = [one for one in running if one]
    cuts = sorted(source.sample(range(1, len(frames)), 4))
    for law in (ORACLE, CHUNKING, ACCOUNTING, NO_FALSE_ACCEPT):
        law(sdo_like.variant(), None, Scene(tuple(frames)), cuts=cuts)


def test_whatever_is_lost_nothing_false_is_read() -> None:
    """Where the beginning of a transfer was seen, its record is what was sent, or there is none."""
    for seed in range(150):
        source = Random(seed)
        given = talk(source, 5)
        truth = {record.data for record in sdo_like.scanner().feed(given)}
        assert len(truth) == 1
        found = sdo_like.scanner().feed([given[0], *shaken(source, given[1:])])
        assert {record.data for record in found} <= truth
