"""What a stream scanner does at the edges of a stream: silence, the end, two protocols on one wire."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest
from construct import (
    Array,
    Byte,
    Const,
    Default,
    GreedyBytes,
    GreedyRange,
    Int16ub,
    PascalString,
    Rebuild,
    Struct,
    len_,
    this,
)

from aces_bus import Frame, Unknown, decode, make_column_scanner, make_scanner
from aces_bus.errors import CallerError, FieldError
from aces_bus.protocol import Counter, Crc, IdField, InvertedSum, Protocol
from aces_bus.protocol.live.stream import StreamScanner
from aces_bus.protocol.reference import Reference
from aces_protocols.robotis.spec import robotis


def servo(gap: float | None = 0.1) -> Protocol:
    """FF FF id length … inverted sum."""
    protocol = Protocol("servo", link="serial")
    packet = protocol.framing(
        sync=b"\xff\xff",
        not_next=b"\xff",
        header=Struct("id" / Byte, "length" / Byte),
        size=this.length + 4,
        max_size=259,
        gap=gap,
        check=InvertedSum(),
    )
    packet("Status", payload=Struct("error" / Byte, "parameters" / GreedyBytes))
    return protocol


def gauge() -> Protocol:
    """AA, two bytes, CRC-8."""
    protocol = Protocol("gauge", link="serial")
    packet = protocol.framing(sync=b"\xaa", size=4, check=Crc("CRC8-SMBUS"))
    packet("Level", payload=Struct("level" / Int16ub))
    return protocol


#: A status of servo 1 that holds two bytes, and the same cut short by a header that promises 200 bytes.
STATUS = bytes.fromhex("FFFF01040020 00DA")
FALSE_HEADER = b"\xff\xff\x02\xc8"


def names(records: Sequence[object]) -> list[str]:
    return [r.reason if isinstance(r, Unknown) else type(r).__name__ for r in records]


def test_a_false_header_holds_a_good_reply_until_silence() -> None:
    """A header with a long length makes the scanner wait; when the line falls silent, the reply behind it is found."""
    scanner = servo().scanner(include_unknown=True)
    assert scanner.feed(FALSE_HEADER + STATUS) == []
    assert scanner.counts.pending == len(FALSE_HEADER + STATUS)
    assert names(scanner.idle()) == ["malformed: incomplete", "skipped", "Status"]
    assert scanner.counts.pending == 0
    assert scanner.counts.balance == 0


def test_silence_shorter_than_the_gap_decides_nothing() -> None:
    """With the time of now, a packet keeps its declared gap before it is given up."""
    scanner = StreamScanner([servo(gap=0.1).variant()])
    scanner.feed(STATUS[:5], time=10.0)
    assert scanner.idle(10.05) == []
    assert names(scanner.feed(STATUS[5:], time=10.06)) == ["Status"]
    scanner.feed(STATUS[:5], time=20.0)
    scanner.idle(20.2)
    assert names(scanner.feed(STATUS[5:], time=20.3)) == []
    assert scanner.counts.malformed == 1


def test_the_end_finds_what_stands_behind_a_false_header() -> None:
    """At the end of a capture a header that promised too much gives way to the packets behind it."""
    scanner = servo().scanner(include_unknown=True)
    scanner.feed(FALSE_HEADER + STATUS + STATUS[:3])
    assert names(scanner.close()) == ["malformed: incomplete", "skipped", "Status", "pending"]
    assert (scanner.counts.decoded, scanner.counts.pending, scanner.counts.balance) == (len(STATUS), 3, 0)


def test_a_packet_cut_off_by_the_end_is_pending() -> None:
    """The last bytes of a capture that end in the middle of a packet are neither skipped nor malformed."""
    scanner = servo().scanner()
    scanner.feed(STATUS + STATUS[:-1])
    scanner.close()
    assert str(scanner.counts) == "total=15 decoded=8 pending=7 records=1"


def test_two_protocols_share_one_wire() -> None:
    """Each byte has one owner, the first protocol that finds a whole packet there."""
    level = gauge().encode("Level", level=770)
    scanner = make_scanner([servo().variant(), gauge().variant()], include_unknown=True)
    records = scanner.feed(STATUS + level + b"\x00" + level + STATUS)
    assert names(records) == ["Status", "Level", "skipped", "Level", "Status"]
    assert [r.meta.protocol for r in records] == ["servo", "gauge", None, "gauge", "servo"]
    assert scanner.counts.balance == 0


def test_the_first_protocol_wins_what_both_claim() -> None:
    """When two protocols accept the same bytes, the order in which they were given decides."""

    def plain(name: str) -> Protocol:
        protocol = Protocol(name, link="serial")
        protocol.framing(sync=b"\x55", size=3)(name.title(), payload=Struct("value" / Int16ub))
        return protocol

    one, other = plain("one").variant(), plain("other").variant()
    assert names(make_scanner([one, other]).feed(b"\x55\x00\x01")) == ["One"]
    assert names(make_scanner([other, one]).feed(b"\x55\x00\x01")) == ["Other"]


def test_a_packet_without_a_message_is_left_to_the_next_protocol() -> None:
    """A valid framing without a message claims its bytes only when no other protocol has a message there."""

    def numbered(name: str, opcode: int) -> Protocol:
        protocol = Protocol(name, link="serial")
        packet = protocol.framing(
            sync=b"\x55", header=Struct("length" / Byte), size=this.length + 2, max_size=20
        )
        packet(name.title(), payload=Struct(Const(opcode, Byte), "rest" / GreedyBytes))
        return protocol

    variants = [numbered("one", 1).variant(), numbered("two", 2).variant()]
    scanner = make_scanner(variants, include_unknown=True)
    data = b"\x55\x02\x02\xbb" + b"\x55\x02\x01\xaa" + b"\x55\x02\x03\xcc"
    assert names(scanner.feed(data)) == ["Two", "One", "unknown"]


def test_links_of_several_kinds_do_not_mix() -> None:
    """A CAN protocol and a serial one cannot share a scanner; the message names both."""
    can = Protocol("frames", link="can")
    can.message("M", id=1)
    with pytest.raises(CallerError, match=r"servo \(serial\), frames \(can\)"):
        make_scanner([servo().variant(), can.variant()])


def test_garbage_costs_no_memory() -> None:
    """A long run of bytes that begin no packet is reported in pieces, the same however it was fed."""
    data = bytes(100_000)
    whole, pieces = servo().scanner(include_unknown=True), servo().scanner(include_unknown=True)
    first = whole.feed(data) + whole.close()
    second = [r for at in range(0, len(data), 777) for r in pieces.feed(data[at : at + 777])] + pieces.close()
    assert [(r.meta.offset, r.meta.size) for r in first] == [(r.meta.offset, r.meta.size) for r in second]
    assert max(r.meta.size or 0 for r in first) <= 4096
    assert isinstance(pieces, StreamScanner)
    assert pieces.buffered == 0


def test_a_reply_that_its_bytes_tell_uses_up_its_request() -> None:
    """Otherwise the request would stay open, and a later frame that fits it would be taken for its reply."""
    protocol = Protocol("pair", link="can")
    ask = protocol.message("Ask", id=0x10, direction="to device", payload=Struct("what" / Byte))
    protocol.message("Short", id=0x20, direction="from device", reply_to=ask, payload=Struct("value" / Byte))
    for number in (1, 2):
        protocol.message(
            f"Long{number}",
            id=0x20,
            direction="from device",
            reply_to=ask.where(what=number),
            payload=Struct("value" / Int16ub),
        )
    asked, short, long = Frame(0x10, b"\x01"), Frame(0x20, b"\x05"), Frame(0x20, b"\x00\x05")
    assert names(protocol.scanner(include_unknown=True).feed([asked, long])) == ["Ask", "Long1"]
    stray = protocol.scanner(include_unknown=True).feed([asked, short, long])
    assert names(stray) == ["Ask", "Short", "unknown: needs request Ask"]
    assert [f.message for f in Reference([protocol.variant()]).frames([asked, short, long])] == [
        "Ask",
        "Short",
        None,
    ]


def test_a_datagram_is_not_continued_by_the_next() -> None:
    """A packet cut off by the end of its datagram is lost alone: the next datagram stands for itself."""
    scanner = StreamScanner([servo().variant()], include_unknown=True)
    assert names(scanner.datagram(STATUS[:-1])) == ["malformed: incomplete", "skipped"]
    assert names(scanner.datagram(STATUS + STATUS)) == ["Status", "Status"]
    assert scanner.counts.pending == 0
    assert scanner.counts.balance == 0


def test_rolling_counters_of_a_stream_say_what_is_missing() -> None:
    """As on CAN: live and in columns, whatever the chunks."""
    ticks = Protocol("ticks", link="serial")
    packet = ticks.framing(sync=b"\xaa", size=4, check=InvertedSum())
    packet("Tick", payload=Struct("count" / Counter(Byte), "value" / Byte))
    data = b"".join(ticks.encode("Tick", count=count, value=1) for count in (250, 251, 254, 0, 1, 1))
    scanner = ticks.scanner()
    for at in range(0, len(data), 5):
        scanner.feed(data[at : at + 5])
    columns = make_column_scanner([ticks.variant()])
    columns.feed(data)
    columns.close()
    assert scanner.counts.missed == columns.counts.missed == 2 + 1 + 255


def counted_header() -> Protocol:
    """A counter in the header, which counts the packets of each sender, whatever their messages."""
    made = Protocol("counted_header", link="serial")
    packet = made.framing(
        sync=b"\xaa",
        header=Struct("address" / Byte, "kind" / Byte, "count" / Counter(Byte, 16)),
        size=6,
        check=InvertedSum(),
    )
    address = IdField("address", range(1, 9))
    for kind, name in ((1, "Angle"), (2, "Speed")):
        packet(name, match={"kind": kind, "address": address}, payload=Struct("value" / Byte))
    return made


def test_a_counter_in_the_header_counts_packets_of_all_messages() -> None:
    """It is one more in each packet of a device, whichever message that is: live, in columns, and when sending."""
    made = counted_header()
    sent = [
        ("Angle", 1, 14),
        ("Speed", 1, 15),
        ("Angle", 2, 3),
        ("Angle", 1, 0),
        ("Speed", 1, 4),
        ("Speed", 2, 5),
    ]
    data = b"".join(made.encode(name, address=who, count=count, value=1) for name, who, count in sent)
    scanner, columns = made.scanner(), make_column_scanner([made.variant()])
    for byte in data:
        scanner.feed(bytes([byte]))
    columns.feed(data)
    columns.close()
    assert scanner.counts.missed == columns.counts.missed == 3 + 1
    encoder = made.variant().encoder
    packets = [encoder.next(name, address=who, value=1) for name, who, _ in 9 * sent]
    again = made.scanner()
    counts = [record.count for packet in packets for record in again.feed(packet) if record.address == 1]
    assert counts == [number % 16 for number in range(36)]
    assert again.counts.missed == 0


def test_packets_of_a_multiple_are_filled_up_and_others_are_malformed() -> None:
    """Live in pieces and in strides, in columns and by the reference; the padding is a field of the record."""
    made = Protocol("padded", link="serial")
    header = Struct("kind" / Byte, "length" / Byte)
    packet = made.framing(
        sync=b"\xaa", header=header, size=this.length + 0, multiple=4, max_size=64, check=InvertedSum()
    )
    fields = ("text" / PascalString(Byte, "ascii"), "padding" / Default(GreedyBytes, b""))
    packet("Line", match={"kind": 1}, payload=Struct(*fields))
    sizes = [len(made.encode("Line", text="x" * size)) for size in range(12)]
    assert sizes == [8, 8, 8, 8, 12, 12, 12, 12, 16, 16, 16, 16]
    odd = bytes([0xAA, 1, 7, 2, 0x61, 0x62])
    odd += bytes([~sum(odd[1:]) & 0xFF])
    data = (made.encode("Line", text="abcde") + odd) * 400
    wanted = [
        (item.offset, item.message) for item in Reference([made.variant()]).stream(data) if item.message
    ]
    assert len(wanted) == 400
    scanner, records = made.scanner(), list[Any]()
    for size in (5, 3000):
        scanner = made.scanner()
        records = [r for at in range(0, len(data), size) for r in scanner.feed(data[at : at + size])]
        assert [(record.meta.offset, "Line") for record in records] == wanted
        assert scanner.counts.reasons["malformed: length"] == 400
    assert records[0].padding == b"\0\0"
    columns = make_column_scanner([made.variant()])
    columns.feed(data)
    columns.close()
    assert columns.counts.records == 400
    assert columns.counts.reasons == scanner.counts.reasons


def test_a_packet_that_nothing_fills_up_is_refused_when_it_is_made() -> None:
    """Zeros that no field takes would make a packet that is not read, or other values of its last field."""
    made = Protocol("padded", link="serial")
    header = Struct("kind" / Byte, "length" / Byte)
    packet = made.framing(sync=b"\xaa", header=header, size=this.length + 0, multiple=4, max_size=64)
    counted = ("count" / Rebuild(Byte, len_(this.values)), "values" / Array(this.count, Byte))
    packet("Counted", match={"kind": 1}, payload=Struct(*counted))
    packet("Rest", match={"kind": 2}, payload=Struct("values" / GreedyRange(Byte)))
    packet("Data", match={"kind": 3}, payload=Struct("data" / GreedyBytes))
    packet("Filled", match={"kind": 4}, payload=Struct(*counted, "padding" / Default(GreedyBytes, b"")))
    whole: dict[str, dict[str, Any]] = {
        "Counted": {"values": [1, 2, 3, 4]},
        "Rest": {"values": [1]},
        "Data": {"data": bytes(5)},
        "Filled": {"values": [7]},
    }
    for name, fields in whole.items():
        (record,) = made.scanner().feed(made.encode(name, **fields))
        assert [bytes(getattr(record, field)) for field in fields] == [*map(bytes, fields.values())]
    odd: dict[str, dict[str, Any]] = {
        "Counted": {"values": [1, 2, 3]},
        "Rest": {"values": [1, 2]},
        "Data": {"data": b"xy"},
        "Filled": {"values": [7], "padding": b"\0"},
    }
    assert len(made.encode("Filled", **odd.pop("Filled"))) == 8
    for name, fields in odd.items():
        with pytest.raises(
            FieldError, match=f"^{name}: .* a packet of .* multiple of 4: give [123] more, or end"
        ):
            made.encode(name, **fields)


def test_directions_are_said_in_either_words() -> None:
    """The command line's short words mean the same in Python, and a word that says no direction is refused everywhere."""
    from aces_lab.exchange import print_dissector

    reply = bytes.fromhex("FFFF01020AF2")
    for long, short in (("from device", "from"), ("to device", "to"), ("both", "both")):
        given: tuple[Any, ...] = (long, short)
        names = [
            [type(one).__name__ for one in robotis.scanner(direction=word).feed(reply)] for word in given
        ]
        assert names[0] == names[1]
        assert len({decode(reply, robotis, direction=word).counts.records for word in given}) == 1
    bogus: Any = "bogus"
    variant = robotis.variant()
    for refuses in (
        lambda: robotis.scanner(direction=bogus),
        lambda: decode(b"", robotis, direction=bogus),
        lambda: StreamScanner([variant], direction=bogus),
        lambda: Reference([variant], direction=bogus),
        lambda: variant.messages_for(bogus),
        lambda: print_dissector(variant, direction=bogus),
    ):
        with pytest.raises(CallerError, match="'bogus' is not a direction: write 'to device'"):
            refuses()
