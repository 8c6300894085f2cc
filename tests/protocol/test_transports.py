"""Transports: messages in several frames, as they are declared, sent, put together and lost."""

from __future__ import annotations

from typing import Any

import pytest
from construct import Byte, Const, GreedyBytes, Int16ub, Struct

from aces_bus import Frame, Unknown, make_scanner
from aces_bus.errors import FieldError, SpecError
from aces_bus.protocol import FastPacket, IdField, IsoTp, Protocol, Transport
from aces_bus.protocol.reference import Reference

#: Parts of `python-can-isotp` 2's own tests and docs, or sent by it (ids 7E0 and 7E8 unless said).
SENT: list[tuple[str, dict[str, Any], int, bytes, list[str]]] = [
    ("single", {}, 0x7E0, bytes.fromhex("22F190"), ["03 22 F1 90"]),
    ("padded", {"pad": 0xCC}, 0x7E0, bytes.fromhex("3E00"), ["02 3E 00 CC CC CC CC CC"]),
    (
        "three frames",
        {},
        0x7E0,
        bytes(range(20)),
        ["10 14 00 01 02 03 04 05", "21 06 07 08 09 0A 0B 0C", "22 0D 0E 0F 10 11 12 13"],
    ),
    (
        "extended",
        {"addressing": "extended"},
        0x600,
        bytes([0x55, *range(8)]),
        ["55 10 08 00 01 02 03 04", "55 21 05 06 07"],
    ),
    (
        "mixed",
        {"addressing": "mixed", "extended": True},
        0x18CE10F1,
        bytes.fromhex("99 10 03"),
        ["99 02 10 03"],
    ),
    (
        "FD, twelve bytes",
        {"fd": True},
        0x7E0,
        bytes(range(12)),
        ["00 0C 00 01 02 03 04 05 06 07 08 09 0A 0B CC CC"],
    ),
    ("FD, ten bytes", {"fd": True}, 0x7E0, bytes(range(10)), ["00 0A 00 01 02 03 04 05 06 07 08 09"]),
]


def isotp(number: int = 0x7E0, **more: Any) -> Protocol:
    """A protocol whose one message is any packet."""
    protocol = Protocol("packets", link="can")
    extended = more.get("extended", False)
    protocol.message(
        "Packet", transport=IsoTp(**more), id=number, extended=extended, payload=Struct("data" / GreedyBytes)
    )
    return protocol


def feed(protocol: Protocol, frames: list[Frame], *, close: bool = True) -> tuple[list[Any], Any]:
    """Everything that a scanner gives, which the reference says too, and its counts."""
    scanner = protocol.scanner(include_unknown=True)
    given = scanner.feed(frames)
    reference = Reference([protocol.variant()])
    truth = reference.frames(frames)
    if close:
        given += scanner.close()
        truth += reference.end()
    assert [(type(g).__name__, "") if not isinstance(g, Unknown) else ("None", g.reason) for g in given] == [
        (str(t.message), t.reason) for t in truth
    ]
    assert scanner.counts.balance == 0
    assert scanner.counts.total == len(frames)
    return given, scanner.counts


def frames_of(number: int, *texts: str, times: tuple[float, ...] | None = None, **more: Any) -> list[Frame]:
    """Frames of one identifier."""
    given = times or (None,) * len(texts)
    return [
        Frame(number, bytes.fromhex(text), time, is_extended_id=number > 0x7FF, **more)
        for text, time in zip(texts, given, strict=True)
    ]


@pytest.mark.parametrize(
    ("settings", "number", "data", "texts"), [one[1:] for one in SENT], ids=[one[0] for one in SENT]
)
def test_iso_tp_frames_are_those_of_others(
    settings: dict[str, Any], number: int, data: bytes, texts: list[str]
) -> None:
    """What we send is what python-can-isotp sends, byte for byte, and what it sends we put together."""
    protocol = isotp(number, **settings)
    sent = protocol.encode("Packet", data=data)
    assert [bytes(frame.data).hex(" ").upper() for frame in sent] == texts
    assert {frame.arbitration_id for frame in sent} == {number}
    given, counts = feed(protocol, frames_of(number, *texts, is_fd=settings.get("fd", False)))
    assert [record.data for record in given] == [data]
    assert (counts.records, counts.decoded) == (1, len(texts))


def test_long_first_frames() -> None:
    """A packet of more than 4095 bytes has its size in four bytes; `max_size` says that it may be so long."""
    protocol = isotp(max_size=6000)
    sent = protocol.encode("Packet", data=bytes(5000))
    assert bytes(sent[0].data).hex(" ") == "10 00 00 00 13 88 00 00"
    given, _ = feed(protocol, sent)
    assert [len(record.data) for record in given] == [5000]
    given, _ = feed(isotp(), sent[:2])
    assert [one.reason for one in given] == ["malformed: too long", "malformed: no first frame"]
    with pytest.raises(FieldError, match="Packet: 5000 bytes of data"):
        isotp().encode("Packet", data=bytes(5000))


def test_flow_control_is_counted_and_no_message() -> None:
    """Flow control is a bin of its own, whoever sends it."""
    protocol = Protocol("pair", link="can")
    uds = IsoTp(to_device=0x7E0, from_device=0x7E8)
    protocol.message("Ask", transport=uds, direction="to device", payload=Struct("data" / GreedyBytes))
    first, *rest = protocol.encode("Ask", data=bytes(20))
    given, counts = feed(protocol, [first, *frames_of(0x7E8, "30 00 00"), *rest])
    assert [type(one).__name__ for one in given] == ["Unknown", "Ask"]
    assert given[0].reason == "control: flow control"
    assert (counts.control, counts.decoded) == (1, 3)


def test_a_record_knows_its_frames_and_their_times() -> None:
    """A record has the time of the last frame and of the first, the packet's bytes and those of each frame."""
    frames = frames_of(0x7E0, *SENT[2][4], times=(1.0, 1.25, 1.5))
    (record,), _ = feed(isotp(), frames)
    meta = record.meta
    assert (meta.first_time, meta.time, meta.raw) == (1.0, 1.5, bytes(range(20)))
    assert meta.frames == tuple(frame.data for frame in frames)


@pytest.mark.parametrize(
    ("texts", "reasons"),
    [
        ([0, 2], ["frame 2 of 3 missing"] * 2),
        ([0, 1], ["pending"] * 2),
        ([1, 2], ["no first frame"] * 2),
        ([0, 1, 0, 1, 2], ["restarted", "restarted", ""]),
        ([0, 1, 1, 2], ["repeated", ""]),
        ([0, 0, 1, 2], ["restarted", ""]),
        ([0, 2, 1], ["frame 2 of 3 missing"] * 2 + ["no first frame"]),
        ([0, 1, 2, 2], ["", "no first frame"]),
    ],
)
def test_what_a_packet_lacks_is_said(texts: list[int], reasons: list[str]) -> None:
    """Lost, repeated, reordered frames: each is in one bin, with the reason."""
    given, _ = feed(isotp(), frames_of(0x7E0, *(SENT[2][4][one] for one in texts)))
    assert [
        one.reason.removeprefix("malformed: ") if isinstance(one, Unknown) else "" for one in given
    ] == reasons


def test_time_outs() -> None:
    """A frame that comes too late ends the packet before; without times there is none. Silence says it, too."""
    texts = SENT[2][4]
    given, _ = feed(isotp(), frames_of(0x7E0, *texts, times=(0.0, 1.0, 2.5)))
    assert [one.reason for one in given] == ["malformed: timed out"] * 2 + ["malformed: no first frame"]
    given, _ = feed(isotp(timeout_s=2.0), frames_of(0x7E0, *texts, times=(0.0, 1.0, 2.5)))
    assert len(given) == 1
    scanner: Any = isotp().scanner(include_unknown=True)
    scanner.feed(frames_of(0x7E0, *texts[:2], times=(0.0, 1.0)))
    assert scanner.idle(1.5) == []
    assert scanner.counts.pending == 2
    assert [one.reason for one in scanner.idle(2.5)] == ["malformed: timed out"] * 2
    assert (scanner.counts.pending, scanner.counts.malformed) == (0, 2)


def test_senders_do_not_disturb_one_another() -> None:
    """Packets of several identifiers, addresses and channels are under way at the same time."""
    protocol = Protocol("several", link="can")
    who = IdField("who", range(4))
    protocol.message(
        "Packet",
        transport=IsoTp(addressing="extended"),
        id=0x600 + who,
        payload=Struct("to" / Byte, "data" / GreedyBytes),
    )
    senders = [
        [
            Frame(f.arbitration_id, bytes(f.data), channel=channel)
            for f in protocol.encode("Packet", who=number, to=to, data=bytes([number, to] * 12))
        ]
        for number in range(4)
        for to in (1, 2)
        for channel in ("can0", "can1")
    ]
    frames = [frame for together in zip(*senders, strict=True) for frame in together]
    given, counts = feed(protocol, frames)
    assert sorted((one.who, one.to, one.meta.channel) for one in given) == [
        (number, to, channel) for number in range(4) for to in (1, 2) for channel in ("can0", "can1")
    ]
    assert counts.malformed == 0


def test_memory_is_bounded() -> None:
    """More packets than declared senders: the oldest one is given up."""
    protocol = Protocol("many", link="can")
    who = IdField("who", range(8))
    protocol.message(
        "Packet", transport=IsoTp(senders=3), id=0x600 + who, payload=Struct("data" / GreedyBytes)
    )
    firsts = [protocol.encode("Packet", who=number, data=bytes(20))[0] for number in range(8)]
    given, counts = feed(protocol, firsts)
    assert [one.reason for one in given] == ["malformed: too many senders at once"] * 5 + ["pending"] * 3
    assert counts.pending == 3


def test_fast_packets_in_any_order() -> None:
    """Frames of a fast packet come in any order behind the first; several sequences of one sender stay apart."""
    protocol = Protocol("boat", link="can")
    protocol.message(
        "Packet", transport=FastPacket(), id=0x0DF80505, extended=True, payload=Struct("data" / GreedyBytes)
    )
    encoder = protocol.variant().encoder
    one, other = (encoder.next("Packet", data=bytes([k] * 20)) for k in (1, 2))
    assert [bytes(frame.data)[0] for frame in (*one, *other)] == [0x00, 0x01, 0x02, 0x20, 0x21, 0x22]
    frames = [one[0], other[0], one[2], other[1], one[1], other[2]]
    given, _ = feed(protocol, frames)
    assert [record.data[0] for record in given] == [1, 2]
    given, _ = feed(protocol, [one[0], one[2], one[0], one[1], one[2]])
    assert [getattr(record, "reason", "") for record in given] == ["malformed: frame 2 of 3 missing"] * 2 + [
        ""
    ]


def test_a_protocol_may_have_frames_and_packets() -> None:
    """Identifiers decide: an error of the spec where a transport would take another message's frames."""
    protocol = Protocol("both", link="can")
    protocol.message("Plain", id=0x123, payload=Struct("a" / Byte))
    protocol.message("Long", transport=IsoTp(), id=0x124, payload=Struct("a" / GreedyBytes))
    frames = [protocol.encode("Plain", a=1), *protocol.encode("Long", a=bytes(20))]
    given, _ = feed(protocol, [frames[1], frames[0], *frames[2:]])
    assert [type(one).__name__ for one in given] == ["Plain", "Long"]
    with pytest.raises(SpecError, match="identifier 0x124 of 'Other' is a frame, and of 'Long'"):
        protocol.message("Other", id=0x124, payload=Struct("a" / Byte))
    with pytest.raises(SpecError, match="fd, remote and any_format are of frames"):
        protocol.message("Fd", transport=IsoTp(), id=0x125, fd=True)
    with pytest.raises(
        SpecError,
        match="length 5000 does not go with TooLong: its fields take 1… bytes, and packets of ISO-TP have 4095",
    ):
        protocol.message(
            "TooLong", transport=IsoTp(), id=0x125, payload=Struct("a" / GreedyBytes), length=5000
        )


def test_protocols_share_a_wire() -> None:
    """Two protocols with one transport: both decide about its packets, the first one first."""
    names = ("first", "second")
    protocols = [Protocol(name, link="can") for name in names]
    for number, protocol in enumerate(protocols):
        protocol.message(
            "Packet", transport=FastPacket(), id=0x0DF80505, extended=True,
            payload=Struct("kind" / Const(number, Byte), "data" / GreedyBytes),
        )  # fmt: skip
    scanner = make_scanner([protocol.variant() for protocol in protocols])
    given = scanner.feed([f for protocol in protocols for f in protocol.encode("Packet", data=bytes(20))])
    assert [record.meta.protocol for record in given] == ["first", "second"]


def test_a_request_in_several_frames() -> None:
    """A reply without its request is unknown; with it, sent or received in frames of a transport, it is found."""
    protocol = Protocol("asked", link="can")
    uds = IsoTp(to_device=0x7E0, from_device=0x7E8)
    ask = protocol.message(
        "Ask", transport=uds, direction="to device", payload=Struct("what" / Int16ub, "more" / GreedyBytes)
    )
    for name, what in (("Speeds", 1), ("Names", 2)):
        protocol.message(
            name,
            transport=uds,
            direction="from device",
            reply_to=ask.where(what=what),
            payload=Struct("data" / GreedyBytes),
        )
    question, answer = (
        protocol.encode("Ask", what=2, more=bytes(12)),
        protocol.encode("Names", what=2, data=bytes(12)),
    )
    given, _ = feed(protocol, answer)
    assert {one.reason for one in given} == {"unknown: needs request Ask"}
    given, _ = feed(protocol, [*question, *answer])
    assert [type(one).__name__ for one in given] == ["Ask", "Names"]
    scanner = protocol.scanner(direction="from device")
    for frame in question:
        scanner.sent(frame)
    assert [type(one).__name__ for one in scanner.feed(answer)] == ["Names"]


def test_a_transport_of_ones_own() -> None:
    """A table of frame kinds is a transport: here the last byte says first, last and which, as CAN sensors often do."""
    first, last, number = Transport.Number(-1, 0x80), Transport.Number(-1, 0x40), Transport.Number(-1, 0x3F)
    own = Transport(
        max_size=100,
        kinds=(
            Transport.Kind("single", "whole", ((first, 1), (last, 1)), head=0, tail=1),
            Transport.Kind("first", "first", ((first, 1),), head=0, tail=1),
            Transport.Kind("next", "next", ((first, 0),), head=0, tail=1, number=number, last=last),
        ),
        modulo=64,
    )
    protocol = Protocol("own", link="can")
    protocol.message("Packet", transport=own, id=0x100, payload=Struct("data" / GreedyBytes))
    for size in (0, 1, 7, 8, 14, 15, 100):
        data = bytes(range(size))
        sent = protocol.encode("Packet", data=data)
        given, _ = feed(protocol, sent)
        assert [record.data for record in given] == [data]
        if len(sent) > 2:
            given, _ = feed(protocol, [sent[0], *sent[2:]])
            assert given[0].reason == "malformed: frame 2 missing"
