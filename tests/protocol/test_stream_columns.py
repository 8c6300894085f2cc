# What is held in memory is counted.
# pyright: reportPrivateUsage=false
"""Streams as columns: what the live scanner finds, all at once; and the parts that find, check and cut many packets."""

from __future__ import annotations

import random
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import contextmanager
from functools import lru_cache
from typing import Any, Literal
from unittest.mock import patch

import anycrc
import numpy as np
import pytest
from construct import Byte, Bytes, Const, GreedyBytes, GreedyRange, Int16ub, Int16ul, Int32ul, Struct, this
from hypothesis import given
from hypothesis import strategies as st

from aces_bus import make_column_scanner, make_scanner
from aces_bus.protocol import (
    Check,
    Counter,
    Crc,
    Extra,
    Fletcher,
    InvertedSum,
    Multiplexed,
    Protocol,
    Sum,
    Xor,
)
from aces_bus.protocol.columns import stream as stream_columns
from aces_bus.protocol.columns.checks import CrcColumns, done_alone
from aces_bus.protocol.columns.packets import Batch
from aces_bus.protocol.columns.scanner import RecordColumns
from aces_bus.protocol.columns.stream import StreamColumns
from aces_bus.protocol.columns.survey import Survey
from aces_bus.protocol.columns.table import MessageTable, cells_of, packet_rows
from aces_bus.protocol.live.stream import StreamScanner
from aces_bus.protocol.reference import Reference
from aces_protocols.minihubo_adc.spec import minihubo_adc
from aces_protocols.nmea0183.spec import nmea0183
from aces_protocols.robotis.spec import robotis
from aces_protocols.ubx.spec import ubx
from tests.specs.cases import STREAMS
from tests.specs.catalogue import SPECS

Way = Literal["to device", "from device", "both"]
#: What a line brings: bytes with their time, or None for silence.
Event = tuple[bytes | None, float | None]


def framed(sync: bytes, check: Check | None, name: str = "line", **more: Any) -> Protocol:
    """A protocol with one framing: sync, length, payload, check; messages of several kinds."""
    protocol = Protocol(name, link="serial")
    size = len(sync) + 2 + (check.size if check is not None else 0)
    packet = protocol.framing(
        sync=sync,
        header=Struct("length" / Byte, "kind" / Byte),
        size=this.length + size,
        max_size=more.pop("max_size", size + 255),
        check=check,
        **more,
    )
    packet("Pair", match={"kind": 1}, payload=Struct("a" / Int16ul, "b" / Byte))
    packet("Tail", match={"kind": 2}, payload=Struct("a" / Byte, "rest" / GreedyBytes))
    packet("Marked", match={"kind": 3}, payload=Struct(Const(0x55, Byte), "data" / Bytes(2)))
    packet("Plain", match={"kind": 3}, payload=Struct("code" / Byte, "x" / Byte), overrides="Marked")
    packet("Counted", match={"kind": 4}, payload=Struct("count" / Counter(Byte), "value" / Int32ul))
    packet("List", match={"kind": 5}, payload=Struct("many" / GreedyRange(Struct("v" / Byte))))
    return protocol


def numbered() -> Protocol:
    """A CRC that ends with bytes of the message, and a header of 16 bits that says which."""
    protocol = Protocol("numbered", link="serial")
    packet = protocol.framing(
        sync=b"\xfd",
        header=Struct("length" / Int16ub, "number" / Int16ul),
        size=2 * this.length + 7,
        max_size=300,
        check=Crc("CRC16-MODBUS", over=(slice(1, -2), Extra(), b"\x01"), order="big"),
    )
    packet("One", match={"number": 1}, check_extra=b"ab", payload=Struct("v" / Int16ul))
    packet("Two", match={"number": 0x1234}, check_extra=b"cd", payload=Struct("v" / Int16ul, "w" / Int16ub))
    return protocol


def chosen() -> Protocol:
    """A packet whose fields hang on a selector, without a check, with a sync byte that is frequent in data."""
    protocol = Protocol("chosen", link="serial")
    packet = protocol.framing(sync=b"\x00", header=Struct("length" / Byte), size=this.length + 2, max_size=12)
    packet(
        "Choice",
        payload=Struct(
            "which" / Byte,
            "wide" / Multiplexed("which", 1, Int32ul),
            "narrow" / Multiplexed("which", 2, Byte),
        ),
    )
    return protocol


def told() -> Protocol:
    """Messages told by a byte that short packets do not have, one of them by several values of a header."""
    protocol = Protocol("told", link="serial")
    packet = protocol.framing(
        sync=b"\x07", header=Struct("length" / Byte, "kind" / Byte), size=this.length + 3, max_size=20
    )
    for number in (1, 2):
        packet(f"Told{number}", match={"kind": 1}, payload=Struct("a" / Byte, Const(number, Byte)))
    packet("Many", match={"kind": (2, 4, 5)}, payload=Struct("a" / Byte, "rest" / GreedyBytes))
    packet("Other", match={"kind": 3}, payload=Struct("a" / Byte))
    own = Sum(field="sum", over=slice(2, 4))
    packet("Checked", match={"kind": 6}, check=own, payload=Struct("a" / Byte, "sum" / Byte))
    return protocol


CHECKS: tuple[Check | None, ...] = (
    None,
    Sum(),
    Sum(2),
    Sum(3, order="big"),
    Sum(8),
    InvertedSum(over=slice(0, -1)),
    InvertedSum(2, order="big"),
    Sum(negated=True),
    Sum(negated=True, over=slice(0, -1)),
    Sum(3, negated=True, order="big"),
    Sum(over=(slice(None, 3), b"\x07", slice(-3, -1))),
    Xor(),
    Xor(over=slice(1, -1)),
    Xor(over=(slice(4, -1), b"\x55")),
    Fletcher(),
    Fletcher(over=(slice(2, 4), b"\x09\x08", slice(4, -2))),
    Crc("CRC8-SMBUS"),
    Crc("CRC16-XMODEM", order="big"),
    Crc("CRC32-MEF", over=(slice(None, -4),)),
    Crc("CRC64-XZ"),
    Crc(width=12, poly=0x80F, over=(b"\x01\x02", slice(2, -2))),
)
PROTOCOLS: dict[str, Protocol] = {
    "robotis": robotis,
    "minihubo_adc": minihubo_adc,
    "nmea0183": nmea0183,
    "ubx": ubx,
    **{name: spec for name, spec in SPECS.items() if spec.link != "can"},
    **{f"check {n}": framed(b"\xa5\x5a", check, f"check{n}") for n, check in enumerate(CHECKS)},
    "one sync byte": framed(b"\x02", Sum(), "one_sync_byte", max_size=40),
    "not next": framed(b"\xff\xff", Xor(), "not_next", not_next=b"\xff\x00"),
    "numbered": numbered(),
    "chosen": chosen(),
    "told": told(),
}


@lru_cache
def packets(name: str) -> tuple[bytes, ...]:
    """Good packets of a protocol, and some that are whole and no message."""
    protocol = PROTOCOLS[name]
    found = [case.data for case in STREAMS if case.spec == name]
    found += [piece.data for case in STREAMS if case.spec == name for piece in case.before]
    found += [example.packet.data for message in protocol.declared for example in message.examples]
    rng = random.Random(1)
    for _ in range(0 if found else 40):
        framing = protocol.framings[0]
        if framing.affine is None:
            found.append(framing.sync + rng.choice((rng.randbytes(6), b"\xff\x00\x0f\xff\xff\x01")))
            continue
        head = bytearray(framing.sync)
        body = rng.randbytes(rng.choice((1, 2, 3, 4, 5, 6, 9, 30)))
        if name == "numbered":
            number = rng.choice((1, 1, 0x1234, 7))
            body = body[:2] if number == 1 else (body * 4)[:4]
            extra = {1: b"ab", 0x1234: b"cd"}.get(number, b"")
            packet = framing.sync + (len(body) // 2).to_bytes(2, "big") + number.to_bytes(2, "little") + body
            found.append(packet + framing.check.encode(packet[1:] + extra + b"\x01"))  # type: ignore[union-attr]
            continue
        if name == "chosen":
            body = bytes([rng.randrange(4)]) + body[:4]
            found.append(bytes([0, len(body)]) + body)
            continue
        if name == "told":
            body = body[: rng.choice((0, 1, 2, 2, 3))]
            body = body[:1] + bytes([rng.choice((1, 2))]) if len(body) == 2 else body
            kind = rng.choice((1, 1, 2, 3, 4, 5, 6))
            body = bytes([body[0], kind + body[0] & 0xFF]) if kind == 6 and body else body
            found.append(bytes([7, len(body), kind]) + body)
            continue
        if name == "robotis":
            head += bytes([rng.randrange(1, 255), len(body) + 2, rng.choice((0, 1, 2, 3, 0x83))])
        else:
            kind = rng.randrange(1, 7)
            body = {1: body[:3], 3: rng.choice((b"\x55", b"\x01")) + body[:2], 4: body[:5]}.get(kind, body)
            head += bytes([len(body), kind])
        packet = bytes(head) + body
        check = framing.check
        if check is not None:
            whole = packet + bytes(check.size)
            packet += check.encode(framing.check_covers(whole))
        found.append(packet)
    return tuple(found)


def piece(name: str, how: int, number: int) -> bytes:
    """Something that a line carries: good packets, damaged and cut ones, garbage, headers."""
    known = packets(name)
    packet = known[number % len(known)]
    number //= len(known)
    if how < 4:
        return packet
    if how == 4:
        return packet * (1 + number % 12)
    if how == 5:
        at, bit = number % len(packet), 1 << number % 7
        return packet[:at] + bytes([packet[at] ^ bit]) + packet[at + 1 :]
    if how == 6:
        return packet[: number % len(packet)]
    if how == 7:
        return number.to_bytes(8, "big")[-(number % 7) :]
    sync = b"".join(framing.sync for framing in PROTOCOLS[name].framings) or b"\x00"
    return bytes(sync[(number >> n) % len(sync)] for n in range(number % 6))


#: Which piece, and what it is made of: see `piece`.
PIECES = st.lists(st.tuples(st.integers(0, 8), st.integers(0, 1 << 40)), max_size=20)


def cut(data: bytes, sizes: Sequence[int], steps: Sequence[float | None], idle: int) -> list[Event]:
    """The bytes in pieces of these sizes, in turn, with rising times (None: none), silent after every `idle` pieces."""
    events: list[Event] = []
    at = number = 0
    now: float | None = None
    while at < len(data):
        step = steps[number % len(steps)]
        now = now if step is None else (now or 0.0) + step
        events.append((data[at : at + sizes[number % len(sizes)]], now))
        at += sizes[number % len(sizes)]
        number += 1
        if idle and number % idle == 0:
            events.append((None, now))
    return events


#: Sizes of pieces, times between them, silences.
CUTS = st.tuples(
    st.lists(st.integers(1, 900), min_size=1, max_size=4),
    st.lists(st.sampled_from((None, 0.0, 0.001, 0.3)), min_size=1, max_size=3),
    st.sampled_from((0, 0, 1, 3)),
)


def shown(tables: Iterable[MessageTable]) -> dict[tuple[str, str], dict[str, Any]]:
    """Everything that tables say, those of a message as one."""
    by_message: dict[tuple[str, str], list[MessageTable]] = {}
    for table in tables:
        by_message.setdefault((table.protocol, table.message), []).append(table)
    found: dict[tuple[str, str], dict[str, Any]] = {}
    for name, some in by_message.items():
        table = MessageTable.concat(some)
        assert table.size is not None
        found[name] = {
            "direction": table.direction,
            "doc": table.doc,
            "stream": table.is_stream,
            "kinds": table.kinds,
            "channel": [table.channels.names[number] for number in table.channel.tolist()],
            **{what: getattr(table, what).tolist() for what in ("time", "key", "row", "rx", "size")},
            **{f".{c.name}": (c.values.dtype, [repr(v) for v in c.to_list()]) for c in table.columns()},
        }
    return found


@contextmanager
def gathering(gather: int, piece: int, worth: int) -> Generator[None, None, None]:
    """With other limits of what is gathered, decided at once, and left to the live scanner."""
    with (
        patch.object(stream_columns, "GATHER", gather),
        patch.object(stream_columns, "PIECE", piece),
        patch.object(stream_columns, "WORTH", worth),
    ):
        yield


def played(feed: Callable[..., Any], idle: Callable[..., Any], events: Iterable[Event]) -> list[Any]:
    """What a scanner gives of a line's history."""
    out: list[Any] = []
    for data, time in events:
        out += idle(time) if data is None else feed(data, time)
    return out


def assert_same(
    protocol: Protocol, events: Sequence[Event], direction: Way, **options: bool
) -> StreamColumns:
    """Columns and the live scanner say the same of a line's history."""
    variants = [protocol.variant()]
    columns = make_column_scanner(variants, direction=direction, **options)
    assert isinstance(columns, StreamColumns)
    live = make_scanner(variants, direction=direction, include_unknown=True, raw=options.get("raw", False))
    assert isinstance(live, StreamScanner)
    records = RecordColumns(variants, direction=direction, **options, scanner=live)
    tables = played(columns.feed, columns.idle, events)
    items = played(live.feed, live.idle, events)
    assert columns.counts.balance == 0
    tables += columns.close()
    items += live.close()
    assert shown(tables) == shown(records.tables(items, None))
    assert columns.counts == live.counts
    return columns


@pytest.mark.parametrize("name", ["robotis", "minihubo_adc", "mavlink1", "ubx", "modbus_like", "chosen"])
@given(PIECES, CUTS, st.sampled_from(("both", "from device", "to device")), st.integers(0, 35))
def test_columns_are_what_the_live_scanner_finds(
    name: str, line: list[tuple[int, int]], cuts: Any, direction: Way, how: int
) -> None:
    """Values, offsets, instants, losses and counts are the same, however the stream is cut and gathered."""
    if not any(m.framing is not None for m in PROTOCOLS[name].variant().messages_for(direction)):
        direction = "both"
    stream = b"".join(piece(name, *one) for one in line)
    with gathering((1, 200, 1 << 16)[how % 3], (300, 1 << 20)[how // 3 % 2], (0, 100, 0)[how // 6 % 3]):
        assert_same(
            PROTOCOLS[name], cut(stream, *cuts), direction, include_unknown=how >= 18, raw=how % 5 == 0
        )


@pytest.mark.parametrize("name", PROTOCOLS)
def test_every_kind_of_framing_and_check(name: str) -> None:
    """A long mixture of good and bad packets, in one piece and in many: the same as live."""
    rng = random.Random(name)
    stream = b"".join(piece(name, rng.randrange(9), rng.randrange(1 << 40)) for _ in range(150))
    with gathering(1 << 16, 1000, 0):
        columns = assert_same(PROTOCOLS[name], [(stream, 1.5)], "both", include_unknown=True)
        assert_same(PROTOCOLS[name], cut(stream, (97, 800), (0.5, None), 0), "both", include_unknown=False)
    assert columns.counts.records > 5 or columns.reason
    assert columns.counts.total > columns.counts.decoded


@pytest.mark.parametrize(
    "check",
    [
        Sum(8),
        Sum(5, order="big"),
        Sum(7),
        InvertedSum(8, order="big"),
        InvertedSum(6),
        Sum(8, negated=True),
        Xor(),
    ],
    ids=lambda check: check.describe,
)
def test_wide_checks_are_those_of_the_reference(check: Check) -> None:
    """Sums of more than four bytes are verified in large chunks too, live and in columns."""
    protocol = framed(b"\xa5", check, "wide")
    framing = protocol.framings[0]
    stream = b""
    for number in range(120):
        packet = b"\xa5\x03\x01" + bytes([number, 2, 0xFF])
        end = check.encode(framing.check_covers(packet + bytes(check.size)))
        if number % 3 == 0:
            end = end[:-1] + bytes([end[-1] ^ 1]) if number % 2 else bytes([end[0] ^ 1]) + end[1:]
        stream += packet + end
    assert len(stream) > 768
    assert framing.max_size < 300
    live = make_scanner([protocol.variant()])
    found = [record.meta.offset for record in [*live.feed(stream), *live.close()]]
    truth = Reference([protocol.variant()]).stream(stream)
    assert found == [item.offset for item in truth if item.message is not None]
    assert len(found) == 80
    assert_same(protocol, [(stream, None)], "both", include_unknown=True)


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("cobs", "no sync bytes"),
        ("dynamixel2", "stuffed"),
        ("nmea0183", "packets do not say their size"),
        ("modbus_like", "several framings share the wire"),
        ("ubx", ""),
        ("mavlink1", ""),
        ("robotis", ""),
        ("minihubo_adc", ""),
        *((f"check {n}", "") for n in range(len(CHECKS))),
    ],
)
def test_what_is_searched_at_once(name: str, why: str) -> None:
    """Framings with sync bytes and a size are searched at once; the others go through the live scanner, which it says."""
    assert StreamColumns([PROTOCOLS[name].variant()], direction="both").reason == why


def test_a_check_of_its_own_kind_goes_through_the_live_scanner() -> None:
    """A check that computes something else is not taken for the one it is made of."""

    class Doubled(Sum):
        def compute(self, data: bytes) -> int:
            return super().compute(data + data)

        @property
        def describe(self) -> str:
            return "doubled sum"

    protocol = framed(b"\xa5\x5a", Crc("CRC8-SMBUS"), "plain_check")
    assert not StreamColumns([protocol.variant()]).reason
    own = Protocol("own_check", link="serial")
    own.framing(sync=b"\x01", size=4, check=Doubled())("Two", payload=Struct("v" / Int16ub))
    assert StreamColumns([own.variant()]).reason == "the check is a function of its own"


# ---------------------------------------------------------------------- gathering


def status(number: int, *parameters: int) -> bytes:
    body = bytes([number, len(parameters) + 2, 0, *parameters])
    return b"\xff\xff" + body + bytes([~sum(body) & 0xFF])


def test_small_pieces_are_gathered() -> None:
    """Tables come when enough is gathered, or when somebody asks; until then bytes are pending and nothing is missing."""
    scanner = make_column_scanner([robotis.variant()], direction="from device")
    assert isinstance(scanner, StreamColumns)
    packet = status(1, 2, 3)
    assert scanner.feed(packet) == scanner.feed(packet + b"\x00") == []
    assert (scanner.counts.total, scanner.counts.pending, scanner.counts.balance) == (17, 17, 0)
    (table,) = scanner.flush()
    assert table["id"].to_list() == [1, 1]
    assert table["parameters"].to_list() == [b"\x02\x03"] * 2
    assert (scanner.counts.decoded, scanner.counts.skipped, scanner.counts.pending) == (16, 1, 0)
    count = stream_columns.GATHER // len(packet)
    assert [len(t) for _ in range(count) for t in scanner.feed(packet)] == [count]
    assert scanner.close() == []


def test_waiting_costs_no_memory() -> None:
    """Feeding nothing, with the time of now, as a loop does that waits, keeps nothing, and later packets' times."""
    events: list[Event] = [(status(1)[:3], 1.0), *((b"", 2.0 + n) for n in range(50)), (status(1)[3:], 60.0)]
    scanner = assert_same(
        robotis, [*events, (b"", 61.0), (b"\xff\xff", None)], "from device", include_unknown=False
    )
    for now in range(1000):
        scanner.feed(b"" if now else b"\xff", float(now))
    assert len(scanner._marks) <= 3


def test_a_long_piece_gives_one_table_a_message() -> None:
    """However long a piece is, the packets of one message in it are one table, in the order of the stream."""
    scanner = make_column_scanner([robotis.variant()], direction="from device", include_unknown=True)
    packet = status(9, 1) + b"\x00"
    count = stream_columns.PIECE * 5 // 2 // len(packet)
    tables = scanner.feed(packet * count)
    assert [(table.message, len(table)) for table in tables] == [("Status", count), ("", count - 1)]
    assert tables[0].row.tolist() == list(range(0, count * len(packet), len(packet)))
    assert (tables[0]["error"].values == 0).all()
    assert len(tables[0]["parameters"].values) == count


def test_instants_are_those_of_the_piece_that_decided() -> None:
    """A packet has the time of the piece with its last byte; one behind a false header, of the piece that unmasked it."""
    first, false = status(1, 2, 3), b"\xff\xff\x02\x28"
    line = first + false + first + bytes(60)
    events: list[Event] = [(line[at : at + 5], at / 10) for at in range(0, len(line), 5)]
    columns = assert_same(robotis, events, "from device", include_unknown=False)
    assert columns.counts.records == 2
    scanner = make_column_scanner([robotis.variant()], direction="from device")
    assert isinstance(scanner, StreamColumns)
    tables = played(scanner.feed, scanner.idle, events) + scanner.flush()
    # The header at 8 promises 44 bytes, up to 52.
    assert tables[0].time.tolist() == [500_000_000, 5_000_000_000]


def test_our_own_request_is_heard_in_its_place() -> None:
    """What came before our transmission is decided before it; replies behind it are told by it."""
    scanner = make_column_scanner([PROTOCOLS["robotis"].variant()], direction="both")
    assert isinstance(scanner, StreamColumns)
    ping = robotis.encode("Ping", id=1)
    assert scanner.feed(status(1)) == []
    assert [t.message for t in scanner.sent(ping, 1.0)] == []
    scanner.feed(status(1), 1.1)
    assert [t.message for t in scanner.close()] == ["Status"]
    assert scanner.counts.reasons == {"unknown: needs request Ping|Read|Write|RegWrite|Action|Reset": 6}


def test_reset_forgets_everything() -> None:
    """After `reset` a scanner is as if just made."""
    scanner = make_column_scanner([robotis.variant()], direction="from device")
    assert isinstance(scanner, StreamColumns)
    scanner.feed(status(1)[:-1], 5.0)
    scanner.reset()
    assert scanner.counts.total == 0
    scanner.feed(status(2))
    (table,) = scanner.close()
    assert (table.row.tolist(), table["id"].to_list()) == ([0], [2])


@pytest.mark.parametrize("size", [4095, 4096, 4097, 20_000])
def test_a_long_run_of_losses_comes_in_pieces(size: int) -> None:
    """Losses are reported in the same pieces as live, also where a run goes on from one piece of the stream to the next."""
    line = b"\x01" + status(1) + bytes(size) + status(2) + b"\x05\xff\xff\x01\x00" + bytes(size) + status(3)
    for sizes in ((len(line),), (3000,), (4096, 1)):
        with gathering(1000, 1 << 20, 0):
            assert_same(robotis, cut(line, sizes, (None,), 0), "from device", include_unknown=True)


def test_long_packets_among_short_ones_keep_their_place() -> None:
    """Packets of one message that are decoded apart for their size stand in the order of the stream."""
    rng = random.Random(2)
    line = b"".join(
        status(number % 253, *rng.randbytes(200 if number % 1500 == 700 else 1)) for number in range(6000)
    )
    columns = assert_same(robotis, [(line, None)], "from device", include_unknown=False)
    assert columns.counts.records == 6000


@pytest.mark.parametrize("include_unknown", [False, True])
@pytest.mark.parametrize("pattern", [b"\xfe", b"\xfe\x00", bytes(range(256)), b"\xfe\xff\x01\x02\x03\x1e"])
def test_headers_without_end(pattern: bytes, include_unknown: bool) -> None:
    """A stream that is nothing but headers is decided in bounded time, as the live scanner decides it."""
    data = (pattern * 30_000)[:30_000]
    assert_same(SPECS["mavlink1"], [(data, None)], "both", include_unknown=include_unknown)


# ---------------------------------------------------------------------- parts


def test_every_crc_of_the_catalogue() -> None:
    """Runs of any length, even, odd and empty, and bytes added behind, give the numbers of the catalogue's CRC."""
    for name in sorted(anycrc.models):
        rng = random.Random(name)
        data = rng.randbytes(600)
        check = Crc(name)
        crc = CrcColumns(check)
        starts = np.array([rng.randrange(500) for _ in range(30)])
        for sizes in (np.array([rng.randrange(90) for _ in starts]), np.full(30, 7), np.full(30, 0)):
            register = crc.run(crc.begin(30), crc.words(np.frombuffer(data, np.uint8)), starts, sizes)
            register = crc.over(register, np.array([[7, 250]], np.uint8))
            pairs = zip(starts.tolist(), sizes.tolist(), strict=True)
            wanted = [check.compute(data[a : a + n] + b"\x07\xfa") for a, n in pairs]
            assert crc.end(register).tolist() == wanted, name


def test_the_longest_packets_are_done_alone() -> None:
    """A few long packets among many short ones do not make everybody wait for them."""
    sizes = np.array([20] * 1000 + [5000, 4000] + [20] * 10)
    assert sorted(done_alone(sizes).tolist()) == [1000, 1001]
    assert done_alone(np.full(1000, 20)).tolist() == []
    assert done_alone(np.zeros(0, np.int64)).tolist() == []


def test_long_packets_do_not_widen_the_rows_of_short_ones() -> None:
    """Packets stand in rows of about their own size, each once, in the order of the stream."""
    sizes = np.array([8] * 20_000 + [700] * 3 + [8] * 20_000 + [30] * 5)
    starts = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    data = random.Random(5).randbytes(int(sizes.sum()))
    batch = Batch(data, 0, starts, sizes, [None])
    made = batch.rows(np.arange(len(sizes)), 0)
    assert sum(rows.data.nbytes for _, rows in made) < 3 * len(data)
    assert sorted(index for which, _ in made for index in which.tolist()) == list(range(len(sizes)))
    for which, rows in made:
        for index, row in zip(which.tolist(), rows.data, strict=True):
            start, size = int(starts[index]), int(sizes[index])
            assert row[:size].tobytes() == data[start : start + size]
            assert not row[size:].any()


def test_cells_are_bytes() -> None:
    """Fields of bytes come out as Python's, cut to the packet's end or to their own size; none is empty bytes."""
    data = bytes(range(40))
    starts, sizes = np.array([0, 5, 20, 30]), np.array([5, 8, 3, 8])
    rows = packet_rows(data, starts, sizes, 8)
    assert cells_of(rows, sizes, 2, None, 1).tolist() == [data[2:4], data[7:12], b"", data[32:37]]
    assert cells_of(rows, sizes, 1, 2, 1).tolist() == [data[1:3], data[6:8], data[21:23], data[31:33]]
    assert cells_of(rows[:1], sizes[:1], 2, None, 1).tolist() == [data[2:4]]
    assert cells_of(rows[:0], sizes[:0], 2, None, 1).tolist() == []


def test_the_lowest_whole_packet_wins() -> None:
    """Packets that overlap are accepted in turn; an incomplete one stops the search only where none covers it."""
    protocol = Protocol("open_line", link="serial")
    protocol.framing(sync=b"\x10", header=Struct("length" / Byte), size=this.length, max_size=9)(
        "Any", payload=Struct("rest" / GreedyBytes)
    )
    survey = Survey(protocol.framings[0], None)
    #       0           3           6   7
    data = b"\x10\x06\x00\x10\x04\x00\x00\x10\x03\x10\x10\x09"
    decided = survey.decide(data, len(data))
    assert (decided.starts.tolist(), decided.sizes.tolist()) == ([0, 7], [6, 3])
    assert (decided.bad.tolist(), decided.stop) == ([], 10)
    # What promises more than there is holds nothing up while it stands inside a packet.
    inside = survey.decide(b"\x10\x05\x10\x09\x00\x10\x02", 7)
    assert (inside.starts.tolist(), inside.stop) == ([0, 5], 7)
    decided = survey.decide(b"\x10\x01" + data, len(data) + 2)
    assert (decided.bad.tolist(), decided.starts.tolist(), decided.stop) == ([0], [2, 9], 12)
