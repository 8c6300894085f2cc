"""Sentences and packets of receivers: what newcomers meet first, and the recordings of two peer libraries."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from aces_bus import Unknown, as_dict, make_scanner
from aces_bus.protocol import Record
from aces_protocols.nmea0183.spec import nmea0183
from aces_protocols.ubx.spec import ubx

GGA = b"$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\r\n"


def test_sentences_are_read() -> None:
    """Degrees out of degrees and minutes, empty fields unknown, sentences of no known type lost with their reason."""
    scanner = nmea0183.scanner(include_unknown=True)
    fix, *lost = scanner.feed(GGA + b"$GPXXX,1*52\r\n$GPHDT,274.07,T*04\r\n") + scanner.close()
    assert isinstance(fix, Record)
    values = as_dict(fix)
    assert (values["lat"], values["altitude"]) == (pytest.approx(48.1173), 545.4)
    assert (values["quality"], values["satellites"], values["age"], values["more"]) == ("gps", 8, None, [])
    assert {one.kind for one in lost} == {"unknown", "malformed", "skipped"}
    assert scanner.counts.balance == 0


def test_a_sentence_is_written() -> None:
    """What a receiver sends can be sent: address, separators and check are derived."""
    sent = nmea0183.encode("HDT", talker="GP", heading=274.07, heading_mark="T", more=[])
    assert sent == b"$GPHDT,274.07,T*03\r\n"


def test_packets_and_sentences_share_a_line() -> None:
    """A u-blox receiver sends both: one scanner gives each byte one owner."""
    pvt = ubx["NavPvt"].examples[0].packet.data
    scanner = make_scanner([ubx.variant(), nmea0183.variant()], direction="from device")
    data = GGA + pvt + GGA + pvt
    assert [type(one).__name__ for one in scanner.feed(data)] == ["GGA", "NavPvt", "GGA", "NavPvt"]
    assert scanner.counts.decoded == len(data)


def test_recorded_packets(shared_captures: Path) -> None:
    """28 packets of navigation, one of each kind: those that are declared are read, every byte is accounted for."""
    data = (shared_captures / "streams" / "ubx-nav.bin").read_bytes()
    scanner = ubx.scanner(direction="from device", include_unknown=True)
    found = [*scanner.feed(data), *scanner.close()]
    records = Counter(type(one).__name__ for one in found if not isinstance(one, Unknown))
    assert records == dict.fromkeys(
        ("NavPvt", "NavSat", "NavStatus", "NavPosLlh", "NavDop", "NavVelNed", "NavTimeUtc"), 1
    )
    assert sum(isinstance(one, Unknown) and one.kind == "unknown" for one in found) == 21
    assert scanner.counts.balance == 0
    assert scanner.counts.malformed == scanner.counts.skipped == 0
    assert all(
        ubx.encode(type(one).__name__, **as_dict(one)) == one.meta.raw
        for one in found
        if not isinstance(one, Unknown)
    )


@pytest.mark.parametrize(
    ("file", "others", "read"),
    [("nmea-gnss.txt", 30, 26), ("nmea-maritime.txt", 15, 0), ("nmea-lowercase-check.txt", 2, 3)],
)
def test_recorded_sentences(file: str, others: int, read: int, shared_captures: Path) -> None:
    """Those of known types are read, the others are whole and of none, but for one of 600 characters; no byte is lost."""
    data = (shared_captures / "streams" / file).read_bytes()
    scanner = nmea0183.scanner(include_unknown=True)
    found = [*scanner.feed(data), *scanner.close()]
    records = [one for one in found if not isinstance(one, Unknown)]
    assert len(records) == read
    assert sum(one.kind == "unknown" for one in found if isinstance(one, Unknown)) == others
    assert scanner.counts.balance == 0
