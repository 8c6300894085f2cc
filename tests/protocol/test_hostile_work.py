# The judge is tested without a scanner.
# pyright: reportPrivateUsage=false
"""What a scanner does with input made to cost it most: counted in bytes that checks and unstuffing read."""

from __future__ import annotations

import random
from typing import Any

import pytest
from construct import Byte, GreedyBytes, Int16ul, Struct, this

from aces_bus.protocol import Check, Cobs, Crc, Fletcher, Protocol, Slip, Sum, Xor
from aces_bus.protocol.declare.checks import Sums
from aces_bus.protocol.declare.framing import Framing
from aces_bus.protocol.live.candidates import CobsSegment, Overlaps, Segments, SlipSegment
from aces_bus.protocol.live.stream import StreamScanner, _judge
from aces_bus.testing import Scene, laws
from tests.laws.drawn import ORACLE

MAX = 4096
#: What each kind of stuffing is made of, and its mark.
KINDS: dict[str, tuple[Any, bytes, bytes]] = {
    "slip": (Slip, b"\xc0", b"\xdb\xdc\xdd\xc0\x01"),
    "cobs": (Cobs, b"\0", b"\x01\x02\x03\x04\xff\0"),
}


def stuffed(kind: str, check: Any, max_size: int = MAX) -> tuple[Protocol, Framing]:
    protocol = Protocol(kind, link="serial")
    make, mark, _ = KINDS[kind]
    framing = protocol.framing(
        header=Struct("kind" / Byte), end=mark, stuffing=make(), check=check, max_size=max_size, gap=0.1
    )
    framing("Any", payload=Struct("data" / GreedyBytes))
    return protocol, framing


def fed(protocol: Protocol, data: bytes) -> StreamScanner:
    scanner = protocol.scanner()
    assert isinstance(scanner, StreamScanner)
    scanner.feed(data)
    scanner.close()
    return scanner


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("check", [None, Sum(), Crc("CRC16-MCRF4XX")], ids=["bare", "sum", "crc"])
def test_segments_say_what_the_framing_says(kind: str, check: Any) -> None:
    """Every candidate of a stream gets the reference's verdict, end and reason, also when it is asked again."""
    protocol, framing = stuffed(kind, check, 600)
    _, mark, alphabet = KINDS[kind]
    dice = random.Random(kind)
    judge = _judge(framing, None)
    for turn in range(60):
        data = bytes(dice.choices(alphabet, k=dice.randrange(60)))
        if turn % 3 == 1:
            made = b"".join(
                protocol.encode("Any", kind=1, data=bytes(dice.choices(alphabet, k=20))) for _ in "ab"
            )
            at = dice.randrange(len(made))
            data = made[:at] + data[:1] + made[at + 1 :]
        elif turn % 3 == 2:
            full = (b"\xff" + b"\x07" * 254) * dice.randrange(3)
            data += full + bytes(dice.choices(alphabet.replace(mark, b""), k=90)) + mark
        segments = Segments(framing, None)
        for start in [*range(len(data)), *range(0, len(data), 7)]:
            assert segments(data, start, True) == judge(data, start, True), (data.hex(), start)


@pytest.mark.parametrize("check", [Sum(), Crc("CRC32-ISO-HDLC")], ids=["sum", "crc"])
@pytest.mark.parametrize(
    ("kind", "unit"),
    [
        ("slip", b"\xdb\xdc"),
        ("slip", b"\x01"),
        ("slip", b"\xdb\x01"),
        ("cobs", b"\x01"),
        ("cobs", b"\x03\x02"),
        ("cobs", b"\xff" + b"\x01" * 254),
        ("cobs", bytes(range(1, 255))),
    ],
)
def test_what_is_between_two_marks_is_unstuffed_once(kind: str, unit: bytes, check: Any) -> None:
    """Not once for each byte that a packet may begin with; checks read no more than a packet a candidate."""
    protocol, _ = stuffed(kind, check)
    data = ((unit * MAX)[:2000] + KINDS[kind][1]) * 2
    scanner = fed(protocol, data)
    assert scanner.unstuff_work <= 3 * len(data) + MAX
    assert scanner.check_work <= 2000 * len(data)
    laws.bounded(protocol.variant(), None, Scene(data))


CHECKS = {
    "two runs": Sum(2, over=[slice(1, 3), slice(4, -2)]),
    "runs in another order": Fletcher(over=[slice(3, -2), slice(0, 3)]),
    "a run and a constant": Xor(over=[slice(0, 2), b"ab", slice(3, -1)]),
}


@pytest.mark.parametrize("name", CHECKS)
def test_sums_over_several_runs_read_a_byte_twice_at_most(name: str) -> None:
    """A stream of headers that all promise a long packet costs what its length is, for whatever is summed."""
    protocol = Protocol("runs", link="serial")
    check = CHECKS[name]
    framing = protocol.framing(
        sync=b"\xaa",
        header=Struct("length" / Int16ul),
        size=this.length + 3 + check.size,
        max_size=MAX,
        check=check,
        gap=0.1,
    )
    framing("Any", payload=Struct("data" / GreedyBytes))
    good = protocol.encode("Any", data=bytes(range(200)))
    data = b"\xaa\xf0\x0f" * 4000 + good + b"\xaa\xf0\x0f" * 4000
    scanner = fed(protocol, data)
    assert scanner.counts.records == 1
    assert scanner.check_work <= 2 * len(data)
    laws.bounded(protocol.variant(), None, Scene(data), (700, 5000, 12100))
    ORACLE(protocol.variant(), None, Scene(data[11_900:12_400]), (50, 120, 310))


def test_sums_of_sentences_read_a_byte_twice_at_most() -> None:
    """A line of nothing but beginnings is summed once for all of them."""
    protocol = Protocol("lines", link="serial")
    framing = protocol.framing(sync=b"$", end=b"\r\n", check=Xor(text="*{:02X}"), max_size=MAX, gap=0.1)
    framing("Any", payload=Struct("data" / GreedyBytes))
    good = protocol.encode("Any", data=b"GPGGA,1")
    data = (b"$" * 3000 + b"*FF\r\n" + good) * 2
    scanner = fed(protocol, data)
    assert scanner.counts.records == 2
    assert scanner.check_work <= 2 * len(data)
    laws.bounded(protocol.variant(), None, Scene(data))


VALID: dict[str, dict[str, Any]] = {
    "slip": {"end": b"\xc0", "stuffing": Slip(), "check": Sum()},
    "cobs": {"end": b"\0", "stuffing": Cobs(), "check": Crc("CRC32-ISO-HDLC")},
    "sentences": {"sync": b"$", "end": b"\r\n", "check": Xor(text="*{:02X}")},
    "two runs": {"sync": b"\xaa", "size": this.kind + 4, "check": CHECKS["two runs"]},
}


@pytest.mark.parametrize("name", VALID)
def test_valid_packets_pay_nothing_for_hostile_ones(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is there for candidates that overlap is not asked, and a packet is unstuffed once, however it is cut."""
    protocol = Protocol("valid", link="serial")
    framing = protocol.framing(header=Struct("kind" / Byte), max_size=300, gap=0.1, **VALID[name])
    framing("Any", payload=Struct("data" / GreedyBytes))
    kind: dict[str, Any] = {} if name == "two runs" else {"kind": 65}
    data = b"".join(protocol.encode("Any", **kind, data=b"%03dabc" % number) for number in range(100))

    def unwanted(*args: Any, **more: Any) -> Any:
        raise AssertionError("asked for a valid packet")

    for owner, method in (
        (Overlaps, "__call__"),
        (SlipSegment, "suffix"),
        (CobsSegment, "suffix"),
        (Sums, "fail"),
        (Check, "same"),
        (Framing, "strays"),
    ):
        monkeypatch.setattr(owner, method, unwanted)
    unstuffed: list[bytes] = []
    for stuffing in (Slip, Cobs):

        def unstuff(self: Any, wire: bytes, plain: Any = stuffing.unstuff) -> Any:
            unstuffed.append(wire)
            return plain(self, wire)

        monkeypatch.setattr(stuffing, "unstuff", unstuff)
    scanner = protocol.scanner()
    assert isinstance(scanner, StreamScanner)
    records = [record for at in range(0, len(data), 64) for record in scanner.feed(data[at : at + 64])]
    assert [record.data for record in records] == [b"%03dabc" % number for number in range(100)]
    assert len(unstuffed) == (100 if name in ("slip", "cobs") else 0)
    assert protocol.scanner().feed(data) == records
