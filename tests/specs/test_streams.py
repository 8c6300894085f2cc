"""The stream specs on worked examples: whole, byte by byte, with trailing bytes, corrupted, behind false headers."""

from __future__ import annotations

from functools import cache
from typing import Any

import pytest

from aces_bus import Unknown, as_dict, make_scanner
from aces_bus.protocol import Protocol
from aces_bus.protocol.live.stream import StreamScanner
from aces_bus.protocol.reference import Reference
from tests.specs.cases import STREAMS, Case
from tests.specs.catalogue import SPECS

each = pytest.mark.parametrize("case", STREAMS, ids=[case.key for case in STREAMS])


@cache
def made(spec: str) -> StreamScanner:
    scanner = SPECS[spec].scanner(direction="both", include_unknown=True)
    assert isinstance(scanner, StreamScanner)
    return scanner


def scanner_of(case: Case) -> StreamScanner:
    """A scanner as new that has seen what must be seen before."""
    scanner = made(case.spec)
    scanner.reset()
    prime(scanner, case)
    return scanner


def prime(scanner: StreamScanner, case: Case) -> None:
    for earlier in case.before:
        assert [type(r).__name__ for r in [*scanner.feed(earlier.data), *scanner.idle()]] == [earlier.message]


def ends_by_silence(protocol: Protocol) -> bool:
    return any(framing.is_silent for framing in protocol.framings)


def assert_fields(record: Any, case: Case) -> None:
    """The stated fields have the stated values; numbers to six digits, as sources round."""
    values = as_dict(record)
    for name, wanted in case.fields.items():
        assert values[name] == (pytest.approx(wanted, rel=1e-6) if is_number(wanted) else wanted), name


def is_number(value: Any) -> bool:
    return isinstance(value, float) or (
        isinstance(value, list) and all(isinstance(item, float) for item in value)
    )


@each
def test_a_whole_packet(case: Case) -> None:
    """One packet gives its record, with the stated values, and nothing else."""
    scanner = scanner_of(case)
    before = scanner.counts.total
    records = [*scanner.feed(case.data), *scanner.idle()]
    assert [type(record).__name__ for record in records] == [case.message]
    assert_fields(records[0], case)
    meta = records[0].meta
    assert (meta.offset, meta.size, meta.raw) == (before, len(case.data), case.data)
    assert scanner.counts.decoded == scanner.counts.total


@each
def test_the_same_bytes_come_back(case: Case) -> None:
    """Encoding a record's raw fields gives the packet it came from."""
    variant = SPECS[case.spec].variant()
    scanner = make_scanner([variant], direction="both", raw=True)
    assert isinstance(scanner, StreamScanner)
    prime(scanner, case)
    record = [*scanner.feed(case.data), *scanner.idle()][0]
    assert variant.encoder.build(variant[case.message], as_dict(record), raw=True) == case.data


@each
def test_the_same_values_come_back(case: Case) -> None:
    """Encoding a record's fields, in units and by name, gives the packet."""
    scanner = scanner_of(case)
    record = [*scanner.feed(case.data), *scanner.idle()][0]
    assert SPECS[case.spec].encode(case.message, **as_dict(record)) == case.data


@each
def test_byte_by_byte(case: Case) -> None:
    """However a packet is cut, its record is the same."""
    whole = scanner_of(case)
    wanted = [*whole.feed(case.data), *whole.idle()]
    pieces = scanner_of(case)
    found = [record for byte in case.data for record in pieces.feed(bytes([byte]))]
    found += pieces.idle()
    assert found == wanted


@each
def test_trailing_bytes_and_the_next_packet(case: Case) -> None:
    """Bytes behind a packet are not part of it, and the next packet is found behind them."""
    silent = ends_by_silence(SPECS[case.spec])
    scanner = scanner_of(case)
    found = [*scanner.feed(case.data), *(scanner.idle() if silent else [])]
    found += [*scanner.feed(b"\x00\x7f"), *(scanner.idle() if silent or case.before else [])]
    prime(scanner, case)
    found += [*scanner.feed(case.data), *scanner.idle(), *scanner.close()]
    names = [type(record).__name__ for record in found if not isinstance(record, Unknown)]
    assert names == [case.message, case.message]
    assert (scanner.counts.balance, scanner.counts.total - scanner.counts.decoded) == (0, 2)


@each
def test_one_wrong_byte(case: Case) -> None:
    """A packet with any one byte changed is lost and counted; the good one behind it is found, at its place."""
    protocol = SPECS[case.spec]
    for at in range(len(case.data)):
        wrong = bytearray(case.data)
        wrong[at] ^= 0x41
        scanner = scanner_of(case)
        start = scanner.counts.total
        found = scanner.feed(bytes(wrong))
        if ends_by_silence(protocol):
            found += scanner.idle()
        found += [*scanner.feed(case.data), *scanner.idle(), *scanner.close()]
        good = [record for record in found if not isinstance(record, Unknown)]
        assert [(r.meta.offset, r.meta.raw) for r in good] == [(start + len(wrong), case.data)], at
        assert scanner.counts.balance == 0
        assert scanner.counts.total - scanner.counts.decoded == len(wrong)


@each
def test_behind_a_false_header(case: Case) -> None:
    """The beginning of a packet that never comes costs nothing but itself."""
    protocol = SPECS[case.spec]
    for size in range(1, len(case.data)):
        scanner = scanner_of(case)
        start = scanner.counts.total
        found = scanner.feed(case.data[:size])
        if ends_by_silence(protocol):
            found += scanner.idle()
        found += [*scanner.feed(case.data), *scanner.idle(), *scanner.close()]
        good = [record for record in found if not isinstance(record, Unknown)]
        assert [(r.meta.offset, r.meta.raw) for r in good] == [(start + size, case.data)], size
        assert scanner.counts.balance == 0


@pytest.mark.parametrize("name", sorted({case.spec for case in STREAMS}))
def test_all_packets_in_one_stream_are_what_the_reference_finds(name: str) -> None:
    """Good, bad and half packets in a row: scanner and reference agree on every byte."""
    protocol = SPECS[name]
    stream = b""
    silences = []
    for number, case in enumerate(c for c in STREAMS if c.spec == name):
        wrong = bytearray(case.data)
        wrong[number % len(wrong)] ^= 0x20
        for piece in (
            *(b.data for b in case.before),
            case.data,
            bytes(wrong),
            case.data,
            case.data[: number + 1],
        ):
            stream += piece
            silences.append(len(stream))
    scanner = protocol.scanner(direction="both", include_unknown=True)
    assert isinstance(scanner, StreamScanner)
    found: list[Any] = []
    at = 0
    for silence in silences:
        found += [*scanner.feed(stream[at:silence]), *scanner.idle()]
        at = silence
    found += scanner.close()
    wanted = Reference([protocol.variant()], direction="both").stream(stream, idle_at=silences)
    assert [(r.meta.offset, r.meta.size, type(r).__name__) for r in found if not isinstance(r, Unknown)] == [
        (f.offset, f.size, f.message) for f in wanted if f.message is not None
    ]
    assert scanner.counts.balance == 0
    for reason in ("malformed", "skipped", "unknown", "pending"):
        lost = sum(f.size for f in wanted if f.message is None and f.reason.startswith(reason))
        assert getattr(scanner.counts, reason) == lost, reason
