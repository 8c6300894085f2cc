"""Packets that the last byte of their end alone closes, too: `end=(b"\\r\\n", b"\\n")`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from construct import Byte, GreedyBytes, Struct

from aces_bus import decode, make_column_scanner
from aces_bus.errors import FieldError
from aces_bus.protocol import Check, Crc, Protocol, Sum, Xor
from aces_bus.protocol.reference import Reference
from aces_protocols.nmea0183.spec import nmea0183

CHECKS = [None, Sum(2), Xor(text="*{:02X}"), Crc("CRC8-AUTOSAR"), Crc("CRC16-XMODEM", over=slice(0, -4))]


def lines(check: Check | None, sync: bytes = b"$") -> Protocol:
    """Lines that begin with a mark."""
    made = Protocol("lines", link="serial")
    packet = made.framing(
        sync=sync, header=Struct("kind" / Byte), end=(b"\r\n", b"\n"), max_size=24, check=check
    )
    packet("One", match={"kind": 0x41}, payload=Struct("rest" / GreedyBytes))
    packet("Other", match={"kind": 0x42}, payload=Struct("x" / Byte, "rest" / GreedyBytes))
    return made


def traffic(spec: Protocol, seed: int) -> bytes:
    """Packets closed by either end, some cut, some with a byte that is wrong, and bytes between."""
    drawn = np.random.default_rng(seed)
    parts: list[bytes] = []
    for _ in range(120):
        rest = bytes(drawn.choice(list(b"$AB\r0123"), drawn.integers(0, 6)).tolist())
        try:
            packet = bytes(spec.encode("One", rest=rest))
        except FieldError:  # its check is a line feed
            continue
        if drawn.integers(2):
            packet = packet[:-2] + b"\n"
        if not drawn.integers(4):
            at = int(drawn.integers(len(packet)))
            packet = (
                packet[:at]
                + bytes(drawn.choice(list(b"$\r\nA"), drawn.integers(0, 3)).tolist())
                + packet[at + 1 :]
            )
        parts.append(packet)
    return b"".join(parts)


@pytest.mark.parametrize("sync", [b"$", b"\r", b"\r\n"])
@pytest.mark.parametrize("check", CHECKS, ids=["bare", "sum", "xor", "crc", "long crc"])
def test_scanner_columns_and_reference_agree(check: Check | None, sync: bytes) -> None:
    """On any mixture of both ends, whatever the chunks; most packets are found."""
    spec = lines(check, sync)
    for seed in range(6):
        data = traffic(spec, seed)
        wanted = Reference([spec.variant()]).stream(data)
        found = [(item.offset, item.message) for item in wanted if item.message]
        for size in (1, 7, len(data)):
            scanner = spec.scanner()
            records = [r for at in range(0, len(data), size) for r in scanner.feed(data[at : at + size])]
            records += scanner.close()
            assert [(record.meta.offset, type(record).__name__) for record in records] == found
            assert scanner.counts.balance == 0
        columns = make_column_scanner([spec.variant()])
        columns.feed(data)
        columns.close()
        assert columns.counts.records == len(found)
        assert len(found) > 40


def test_a_line_feed_alone_reads_as_the_whole_end_and_is_never_written() -> None:
    """The record is the same; what is sent has the whole end; a field may have neither."""
    sentence = b"$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47"
    whole, short = (nmea0183.scanner().feed(sentence + end)[0] for end in (b"\r\n", b"\n"))
    assert repr(whole) == repr(short)
    assert (whole.meta.raw[-2:], short.meta.raw[-2:]) == (b"\r\n", b"7\n")
    assert bytes(lines(None).encode("One", rest=b"a")) == b"$Aa\r\n"
    for rest in (b"a\nb", b"a\r\nb"):
        with pytest.raises(FieldError, match="occur inside it"):
            lines(None).encode("One", rest=rest)


def test_exports_say_what_they_leave_out() -> None:
    """Wireshark's dissector looks for the whole end alone, and says so."""
    from aces_lab.exchange import print_dissector

    _, losses = print_dissector(nmea0183.variant())
    assert "packets that 0A alone closes are not found" in " ".join(map(str, losses))


def test_half_a_log_with_bare_line_feeds_is_read_as_the_same_records(tmp_path: Path) -> None:
    """A log whose carriage returns were lost by a program on its way gives the records of the whole one."""
    line = b"$GPGLL,4916.45,N,12311.12,W,225444,A,*1D\r\n"
    data = line * 500
    one, other = decode(data, nmea0183), decode(data.replace(b"\r\n", b"\n"), nmea0183)
    assert one.counts.records == other.counts.records == 500
