"""pynmeagps: it reads what our encoder and twin send to our values, and we read what it writes."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import pytest

from aces_bus import as_dict
from aces_bus.protocol import Record
from aces_bus.robot import VirtualRobot, parse_robot
from aces_devices.gnss.antenna import in_circle
from aces_devices.gnss.nmea0183 import driver
from aces_devices.gnss.sentences import SENTENCES, sentences
from aces_protocols.nmea0183.spec import nmea0183
from tests.oracles.foreign import oracle
from tests.oracles.terminals import twins_at_a_terminal

pynmeagps: Any = oracle("pynmeagps", "pynmeagps")

#: How long a busy machine may take to say something (s).
WAIT_S = 20.0

#: Our numbers and its attributes.
NUMBERS: dict[str, dict[str, str]] = {
    "GGA": {"satellites": "numSV", "hdop": "HDOP", "altitude": "alt", "separation": "sep", "age": "diffAge"},
    "RMC": {"speed": "spd", "course": "cog", "variation": "mv"},
    "GSA": {"satellite1": "svid_01", "satellite12": "svid_12", "pdop": "PDOP", "hdop": "HDOP", "vdop": "VDOP"},
    "GSV": {"messages": "numMsg", "number": "msgNum", "in_view": "numSV"},
    "VTG": {"course": "cogt", "course_magnetic": "cogm", "speed": "sogn", "speed_kmh": "sogk"},
    "GLL": {},
    "GNS": {"satellites": "numSV", "hdop": "HDOP", "altitude": "alt", "separation": "sep"},
    "GST": {
        "rms": "rangeRms", "major": "stdMajor", "minor": "stdMinor", "orientation": "orient", "lat_deviation": "stdLat",
        "lon_deviation": "stdLong", "alt_deviation": "stdAlt",
    },
    "ZDA": {"day": "day", "month": "month", "year": "year"},
    "HDT": {"heading": "headingT"},
    "HDM": {"heading": "headingM"},
    "HDG": {"heading": "headingM", "deviation": "deviation", "variation": "variation"},
    "ROT": {"rate": "rot"},
}  # fmt: skip
SIGNS = {"north": 1, "east": 1, "south": -1, "west": -1}


def number(value: Any) -> float | None:
    """Its empty fields are empty texts."""
    return None if value == "" else float(value)


def assert_same(record: Record, theirs: Any) -> None:
    """Every number, the place with its signs, and the time of day."""
    values, name = as_dict(record), type(record).__name__
    assert theirs.msgID == name
    assert theirs.talker == values["talker"]
    for ours, attribute in NUMBERS[name].items():
        wanted = number(getattr(theirs, attribute, ""))
        assert values[ours] == (None if wanted is None else pytest.approx(wanted, abs=1e-9)), (name, ours)
    if "lat" in values:
        for ours in ("lat", "lon"):
            value, sign = values[ours], values[f"{ours}_sign"]
            wanted = number(getattr(theirs, ours))
            assert (None if value is None else value * SIGNS[sign]) == (
                None if wanted is None else pytest.approx(wanted, abs=1e-8)
            )
    if values.get("time"):
        stated = theirs.time.strftime("%H%M%S.%f")
        assert (
            values["time"].ljust(len(stated), "0") if "." in values["time"] else values["time"] == stated[:6]
        )
        assert values["time"][:9] == stated[: len(values["time"][:9])]


def their_sentences(data: bytes) -> list[tuple[bytes, Any]]:
    return list(pynmeagps.NMEAReader(io.BytesIO(data)))


@pytest.mark.parametrize("name", NUMBERS)
def test_it_reads_our_worked_examples_alike(name: str) -> None:
    """Each worked example of the spec has the same values to it."""
    data = nmea0183[name].examples[0].packet.data
    assert_same(nmea0183.scanner().feed(data)[0], pynmeagps.NMEAReader.parse(data))


def test_it_reads_what_the_twin_sends() -> None:
    """Every sentence of a moving receiver, with a fix and without, is one to it, of the same values."""
    robot, _ = parse_robot(driver.example)
    assert robot is not None
    with VirtualRobot(robot) as world:
        twin: Any = world.twins["GNSS"]
        twin.feed = in_circle(20.0, 60.0)
        sent: list[bytes] = []

        def noted(packet: bytes) -> bool:
            sent.append(bytes(packet))
            return True

        twin.twins.port.send = noted
        world.advance(3.0)
        twin.fault("no_fix")
        world.advance(1.0)
        twin.fault("no_fix", on=False)
        twin.settings = twin.settings
        epoch = twin.epoch()
        sent += [nmea0183.encode(name, **fields) for name, fields in sentences(epoch, *SENTENCES)]
    data = b"".join(sent)
    theirs = their_sentences(data)
    records = nmea0183.scanner().feed(data)
    assert [raw for raw, _ in theirs] == [one.meta.raw for one in records]
    assert {type(one).__name__ for one in records} == set(SENTENCES)
    for record, (_, parsed) in zip(records, theirs, strict=True):
        assert_same(record, parsed)
    gsv = [parsed for _, parsed in theirs if parsed.msgID == "GSV"][-3:]
    assert [(one.msgNum, one.svid_01, one.cno_01) for one in gsv] == [(1, 2, 44), (2, 13, 33), (3, 24, 22)]


def test_its_reader_and_a_serial_port() -> None:
    """Through a pseudo-terminal, as from a receiver: sentence after sentence, whole and in their order."""
    serial = oracle("serial", "pyserial")
    robot, _ = parse_robot(driver.example.replace("rate_hz = 2", "rate_hz = 10"))
    assert robot is not None
    with twins_at_a_terminal(robot, "gnss") as made:
        port: Any = serial.Serial(made.port.path, 38_400, timeout=WAIT_S)
        try:
            reader = pynmeagps.NMEAReader(port)
            found = [reader.read()[1] for _ in range(16)]
        finally:
            port.close()
    names = [one.msgID for one in found if one is not None]
    start = names.index("GGA")
    assert names[start : start + 8] == ["GGA", "RMC", "GSA", "GSV", "GSV", "GSV", "GST", "VTG"]
    assert all(
        one.lat == pytest.approx(48, abs=1e-5)
        for one in found
        if one is not None and one.msgID in ("GGA", "RMC")
    )


def test_we_read_what_it_writes() -> None:
    """Sentences that it builds from values decode to these."""
    written = pynmeagps.NMEAMessage(
        "GN", "GGA", 0, time=pynmeagps.NMEAReader.parse(b"$GNZDA,103607.00,06,03,2021,00,00*7F\r\n").time, lat=-33.85,
        NS="S", lon=-70.65, EW="W", quality=4, numSV=17, HDOP=0.61, alt=543.2, altUnit="M", sep=28.1, sepUnit="M",
        diffAge=1.2, diffStation=120,
    )  # fmt: skip
    (record,) = nmea0183.scanner().feed(written.serialize())
    assert_same(record, written)
    values = as_dict(record)
    assert (values["quality"], values["lat_sign"], values["lon_sign"]) == ("rtk_fixed", "south", "west")
    heading = pynmeagps.NMEAMessage("HE", "HDT", 0, headingT=359.99, headingTu="T")
    assert as_dict(nmea0183.scanner().feed(heading.serialize())[0])["heading"] == 359.99


@pytest.mark.parametrize("file", ["nmea-gnss.txt", "nmea-lowercase-check.txt"])
def test_recordings_are_read_alike(file: str, shared_captures: Path) -> None:
    """Of the types that are declared here, every sentence that it reads, with the same values."""
    data = (shared_captures / "streams" / file).read_bytes()
    records = {one.meta.raw.rstrip(): one for one in nmea0183.scanner().feed(data)}
    theirs = {raw.rstrip(): parsed for raw, parsed in their_sentences(data) if parsed.msgID in NUMBERS}
    theirs = {raw: parsed for raw, parsed in theirs.items() if not raw.startswith(b"$P")}
    assert set(theirs) <= set(records)
    for raw, parsed in theirs.items():
        assert_same(records[raw], parsed)
