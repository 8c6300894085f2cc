"""Stuffing, terminators and silence: the small specs, and worked examples of the stuffings themselves."""

from __future__ import annotations

from typing import Any

import pytest

from aces_bus import Unknown, as_dict, decode
from aces_bus.errors import FieldError
from aces_bus.protocol import Cobs, Insert, Protocol, Slip
from aces_bus.protocol.declare.stuffing import Stuffing
from aces_bus.protocol.live.stream import StreamScanner
from aces_bus.protocol.reference import Reference
from aces_protocols.nmea0183.spec import nmea0183
from tests.specs.cobs import cobs
from tests.specs.dynamixel2 import dynamixel2
from tests.specs.modbus_like import modbus_like
from tests.specs.slip import slip

DYNAMIXEL = Insert(b"\xff\xff\xfd", b"\xfd")


@pytest.mark.parametrize(
    ("stuffing", "data", "wire"),
    [
        (Cobs(), "", "01"),
        (Cobs(), "00", "0101"),
        (Cobs(), "0000", "010101"),
        (Cobs(), "11220033", "0311220233"),
        (Cobs(), "11223344", "0511223344"),
        (Cobs(), bytes(range(1, 255)).hex(), "ff" + bytes(range(1, 255)).hex()),
        (Cobs(), bytes(range(1, 256)).hex(), "ff" + bytes(range(1, 255)).hex() + "02ff"),
        (Cobs(), bytes(range(2, 256)).hex() + "00", "ff" + bytes(range(2, 256)).hex() + "0101"),
        (Slip(), "01c0db02", "01dbdcdbdd02"),
        (Slip(), "dbdc", "dbdddc"),
        (Slip(), "c0", "dbdc"),
        (DYNAMIXEL, "fffffd00", "fffffdfd00"),
        (DYNAMIXEL, "fffffdfd", "fffffdfdfd"),
        (DYNAMIXEL, "fffffffd", "fffffffdfd"),
        (DYNAMIXEL, "fffd", "fffd"),
    ],
)
def test_stuffing(stuffing: Stuffing, data: str, wire: str) -> None:
    """Worked examples of the cobs and sliplib packages and of the e-manual, both ways."""
    assert stuffing.stuff(bytes.fromhex(data)).hex() == wire
    assert stuffing.unstuff(bytes.fromhex(wire)).hex() == data


@pytest.mark.parametrize(
    ("stuffing", "wire"),
    [
        (Slip(), "dbdb"),
        (Slip(), "01db"),
        (Slip(), "db00"),
        (Cobs(), "05112233"),
        (Cobs(), "0300"),
        (DYNAMIXEL, "fffffd00"),
    ],
)
def test_what_nobody_has_stuffed_is_refused(stuffing: Stuffing, wire: str) -> None:
    """A violation is not read as something else."""
    with pytest.raises(ValueError, match=r"SLIP|COBS|stuffing"):
        stuffing.unstuff(bytes.fromhex(wire))


def read(protocol: Protocol, *pieces: bytes, silent: bool = False) -> tuple[list[Any], StreamScanner]:
    """What a scanner and the reference find in pieces (between silences); they must agree."""
    scanner = protocol.scanner(direction="both", include_unknown=True)
    assert isinstance(scanner, StreamScanner)
    found: list[Any] = []
    ends = []
    for piece in pieces:
        found += scanner.feed(piece)
        if silent:
            found += scanner.idle()
        ends.append(scanner.counts.total)
    found += scanner.close()
    data = b"".join(pieces)
    wanted = Reference([protocol.variant()], direction="both").stream(data, idle_at=ends if silent else ())
    records = [r for r in found if not isinstance(r, Unknown)]
    assert [(r.meta.offset, r.meta.size, r.meta.message) for r in records] == [
        (f.offset, f.size, f.message) for f in wanted if f.message
    ]
    assert scanner.counts.balance == 0
    return records, scanner


SAMPLE: dict[str, Any] = {"time": 0xC0DB, "accel": [1.0, -1.0, 0.5]}


def test_slip_packets_may_be_opened_by_their_mark() -> None:
    """`C0 a C0 C0 b C0` and `a C0 b C0` hold the same two packets; the empty one between marks is nothing."""
    sample, log = slip.encode("Sample", **SAMPLE), slip.encode("Log", text="hello À")
    for stream in (b"\xc0" + sample + b"\xc0" + log, sample + log):
        records, scanner = read(slip, stream)
        assert [as_dict(r) for r in records] == [SAMPLE, {"text": "hello À"}]
        assert scanner.counts.skipped == len(stream) - len(sample) - len(log)
    assert b"\xc0" not in sample[:-1]


def test_slip_after_a_violation() -> None:
    """A packet with a wrong escape, or cut short, is lost; the next one is not."""
    sample = slip.encode("Sample", **SAMPLE)
    for wrong in (b"\x01\xdb\xdb\xc0", sample[:-4] + b"\xc0", sample[:6]):
        records, scanner = read(slip, wrong + b"\xc0" + sample)
        assert [as_dict(r) for r in records] == [SAMPLE]
        assert scanner.counts.decoded == len(sample)


@pytest.mark.parametrize("count", [0, 1, 2, 100, 124, 125, 126, 127, 250])
def test_cobs_blocks_of_any_length(count: int) -> None:
    """Packets around the block size of 254 survive, with and without zeros."""
    for values in (list(range(count)), [0] * count, [0xFFFF] * count):
        packet = cobs.encode("Block", sequence=count, start=0, values=values)
        assert packet.index(0) == len(packet) - 1
        records, _ = read(cobs, packet[-3:], packet + packet)
        assert [list(r.values) for r in records] == [values, values]


def test_dynamixel_stuffing_counts_in_the_length() -> None:
    """The length on the wire is the stuffed one, the CRC covers the stuffed bytes, the record holds the data."""
    for data in (
        b"\xff\xff\xfd",
        b"\xff\xff\xfd" * 5,
        b"\xff\xff\xff\xfd\xff\xff\xfd\xfd",
        bytes(range(256)),
    ):
        packet = dynamixel2.encode("Write", id=1, start=0xFFFF, data=data)
        assert int.from_bytes(packet[5:7], "little") == len(packet) - 7
        records, _ = read(dynamixel2, packet[4:], packet, packet)
        assert [r.data for r in records] == [data, data]
        assert [r.start for r in records] == [0xFFFF, 0xFFFF]


def test_registers_are_written_through_the_stuffing() -> None:
    """The register map makes the packet of the e-manual's goal position."""
    packet = dynamixel2.register_map
    assert packet is not None
    assert (
        packet.write(1, {"goal_position": 45.0}).hex(" ").upper()
        == "FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89"
    )
    assert packet.read(1, "present_position").hex(" ").upper() == "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15"


def test_modbus_packets_end_by_silence_only() -> None:
    """Without silence nothing is decided; two packets without silence between them are one wrong one."""
    read_ = modbus_like.encode("Read", unit=9, function=3, start=180, count=6)
    scanner = modbus_like.scanner(direction="to device", include_unknown=True)
    assert isinstance(scanner, StreamScanner)
    assert scanner.feed(read_) == []
    assert scanner.counts.pending == len(read_)
    assert [type(r).__name__ for r in scanner.idle()] == ["Read"]
    records, scanner = read(modbus_like, read_ + read_, read_, silent=True)
    assert [r.meta.offset for r in records] == [
        8,
        16,
    ]  # the rule: a wrong packet costs a byte, the rest is read again
    assert scanner.counts.malformed == 8


def test_an_answer_means_what_its_request_asked() -> None:
    """The same twelve bytes are forces or plain registers."""
    ask = modbus_like.encode("Read", unit=9, function=3, start=180, count=6)
    other = modbus_like.encode("Read", unit=9, function=3, start=410, count=6)
    answer = bytes.fromhex("09030C03E8FF0613880064FFEC0005F5B9")
    records, _ = read(modbus_like, ask, answer, other, answer, answer, silent=True)
    assert [r.meta.message for r in records] == ["Read", "ReadForceTorque", "Read", "ReadAnswer"]


def test_a_stream_and_packets_share_a_line() -> None:
    """The sensor's own stream needs no silence; polling between its packets does."""
    forces = modbus_like.encode("ForceTorque", force=[1, 2, 3], torque=[0.1, 0.2, 0.3])
    ask = modbus_like.encode("Write", unit=9, start=410, value=0x200)
    records, scanner = read(modbus_like, forces * 3, ask, forces, silent=True)
    assert [r.meta.message for r in records] == [*["ForceTorque"] * 3, "Write", "ForceTorque"]
    assert scanner.counts.decoded == scanner.counts.total


@pytest.mark.parametrize(
    ("text", "message", "fields"),
    [
        ("$GPGLL,4916.45,N,12311.12,W,225444,A*31", "GLL", {"mode": None, "more": []}),
        ("$GPGLL,,,,,,V*06", "GLL", {"lat": None, "time": None, "status": "void"}),
        ("$GPHDT,,*4F", "HDT", {"heading": None, "heading_mark": None}),
        ("$GPHDT,1,T,new,fields*47", "HDT", {"heading": 1.0, "more": ["new", "fields"]}),
        ("$GPZDA,160012.71,11,03,2004,-1,00*7D", "ZDA", {"day": 11, "year": 2004, "zone_hours": -1}),
        (
            "$GPGST,172814.0,0.006,0.023,0.020,273.6,0.023,0.020,0.031*6A",
            "GST",
            {"rms": 0.006, "orientation": 273.6},
        ),
    ],
)
def test_sentences_of_any_length(text: str, message: str, fields: dict[str, Any]) -> None:
    """Empty fields are None, missing optional ones too, and new ones are kept."""
    records, _ = read(nmea0183, text.encode() + b"\r\n")
    assert [r.meta.message for r in records] == [message]
    values = as_dict(records[0])
    assert {name: values[name] for name in fields} == fields


def test_hexadecimal_digits_are_read_in_either_case() -> None:
    """A check in lower or upper case is the same number, however sentences are cut; it is written in upper case."""
    zda, gst = (
        "$GNZDA,103607.00,06,03,2021,00,00",
        "$GPGST,172814.0,0.006,0.023,0.020,273.6,0.023,0.020,0.031",
    )
    for first, second in (("7f", "6a"), ("7F", "6a"), ("7F", "6A")):
        data = f"{zda}*{first}\r\n{gst}*{second}\r\n".encode()
        records, scanner = read(nmea0183, data)
        assert [record.meta.message for record in records] == ["ZDA", "GST"]
        assert (scanner.counts.decoded, scanner.counts.total) == (len(data), len(data))
        reference = Reference([nmea0183.variant()]).stream(data)
        assert [found.message for found in reference] == ["ZDA", "GST"]
        tables = decode(data, nmea0183)
        assert [len(tables[name]) for name in ("ZDA", "GST")] == [1, 1]
        pieces = nmea0183.scanner()
        assert [r.meta.message for byte in data for r in pieces.feed(bytes([byte]))] == ["ZDA", "GST"]
    fields = as_dict(read(nmea0183, f"{zda}*7f\r\n".encode())[0][0])
    written = nmea0183.encode("ZDA", **fields)
    assert written.endswith(b"*7F\r\n")


def test_sentences_with_a_broken_end_do_not_run_together() -> None:
    """A sentence may hold no `$`: where an end was lost, the next sentence is read all the same; a line feed is an end."""
    one = b"$GPHDT,274.07,T*03\r\n"
    data = one[:-2] + b"\n" + one[:-2] + b"\r" + one[:-2] + one
    records, scanner = read(nmea0183, data)
    assert [(r.heading, r.meta.offset) for r in records] == [(274.07, 0), (274.07, len(data) - len(one))]
    lost = "malformed: a byte that no packet has"
    assert scanner.counts.reasons == {lost: 2, "skipped": 2 * (len(one) - 3) + 1}
    pieces = nmea0183.scanner(include_unknown=True)
    assert isinstance(pieces, StreamScanner)
    for byte in data:
        pieces.feed(bytes([byte]))
    assert (pieces.counts.reasons, pieces.counts.decoded) == (
        scanner.counts.reasons,
        2 * len(one) - 1,
    )
    found = [item.message for item in Reference([nmea0183.variant()]).stream(data) if item.message]
    assert found == ["HDT", "HDT"]
    assert len(decode(data, nmea0183)["HDT"]) == 2
    with pytest.raises(FieldError, match="HDT: no packet may have one of the bytes 24 inside it"):
        nmea0183.encode("HDT", talker="GP", heading=1.0, heading_mark="$", more=[])


@pytest.mark.parametrize(
    "text",
    [
        "$GPHDT,274.07,T*04",
        "$GPHDT,274.07,T",
        "$GPHDT,27 4,T*0A",
        "$GPXYZ,1*51",
        "$PUBX,00*33",
        "$GPHDT*4F",
        "$",
    ],
)
def test_sentences_that_are_none(text: str) -> None:
    """A wrong or absent check, a number that is none, a type nobody declared: lost, and the next sentence is found."""
    good = b"$GPHDT,274.07,T*03\r\n"
    records, scanner = read(nmea0183, text.encode() + b"\r\n" + good)
    assert [r.heading for r in records] == [274.07]
    assert scanner.counts.decoded == len(good)
