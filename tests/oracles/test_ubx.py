"""pyubx2: it reads what our encoder and twin send to our values, and we read what it writes."""

from __future__ import annotations

import io
from math import degrees
from pathlib import Path
from typing import Any

import pytest

from aces_bus import as_dict
from aces_bus.protocol import Record
from aces_bus.robot import VirtualRobot, parse_robot
from aces_devices.gnss.antenna import in_circle
from aces_devices.gnss.ubx import MESSAGES, driver
from aces_protocols.ubx.spec import ubx
from tests.oracles.foreign import oracle
from tests.oracles.terminals import twins_at_a_terminal

pyubx2: Any = oracle("pyubx2", "pyubx2")

#: How long a busy machine may take to say something (s).
WAIT_S = 20.0

#: Our fields and its attributes, where both have the same number in the same unit.
SAME: dict[str, dict[str, str]] = {
    "NavPvt": {
        "itow": "iTOW", "year": "year", "month": "month", "day": "day", "hour": "hour", "minute": "min", "second": "second",
        "time_accuracy": "tAcc", "nano": "nano", "satellites": "numSV", "lon": "lon", "lat": "lat", "height": "height",
        "height_msl": "hMSL", "horizontal_accuracy": "hAcc", "vertical_accuracy": "vAcc", "velocity_north": "velN",
        "velocity_east": "velE", "velocity_down": "velD", "ground_speed": "gSpeed", "heading_of_motion": "headMot",
        "speed_accuracy": "sAcc", "heading_accuracy": "headAcc", "pdop": "pDOP", "heading_of_vehicle": "headVeh",
        "magnetic_declination": "magDec", "magnetic_accuracy": "magAcc", "flags.fix_ok": "gnssFixOk",
        "flags.differential": "diffSoln", "flags3.invalid_position": "invalidLlh",
    },
    "NavPosLlh": {
        "lon": "lon", "lat": "lat", "height": "height", "height_msl": "hMSL", "horizontal_accuracy": "hAcc",
        "vertical_accuracy": "vAcc",
    },
    "NavVelNed": {
        "velocity.0": "velN", "velocity.1": "velE", "velocity.2": "velD", "speed": "speed", "ground_speed": "gSpeed",
        "heading_of_motion": "heading", "speed_accuracy": "sAcc", "heading_accuracy": "cAcc",
    },
    "NavDop": {name: name[0] + "DOP" for name in ("gdop", "pdop", "tdop", "vdop", "hdop", "ndop", "edop")},
    "NavTimeUtc": {"time_accuracy": "tAcc", "nano": "nano", "year": "year", "second": "sec", "valid.utc": "validUTC"},
    "NavStatus": {"time_to_first_fix": "ttff", "uptime": "msss", "flags2.power_save": "psmState"},
    "NavSat": {
        "count": "numSvs", "satellites.0.satellite": "svId_01", "satellites.0.signal": "cno_01",
        "satellites.0.elevation": "elev_01", "satellites.0.azimuth": "azim_01", "satellites.0.residual": "prRes_01",
        "satellites.0.state.quality": "qualityInd_01", "satellites.0.state.used": "svUsed_01",
    },
    "CfgRate": {"period": "measRate", "measurements": "navRate"},
    "Ack": {"acked_group": "clsID", "acked_number": "msgID"},
    "Nak": {"acked_group": "clsID", "acked_number": "msgID"},
}  # fmt: skip


def inside(values: Any, path: str) -> Any:
    for name in path.split("."):
        values = values[int(name)] if name.isdigit() else values[name]
    return values


def assert_same(record: Record, theirs: Any) -> None:
    """Every number that both have is the same."""
    values = as_dict(record)
    for ours, name in SAME[type(record).__name__].items():
        assert inside(values, ours) == pytest.approx(getattr(theirs, name), abs=1e-9), (
            type(record).__name__,
            ours,
        )


def their_packets(data: bytes) -> list[tuple[bytes, Any]]:
    return list(pyubx2.UBXReader(io.BytesIO(data), protfilter=pyubx2.UBX_PROTOCOL))


def test_it_reads_what_the_twin_sends_and_the_twin_what_it_asks() -> None:
    """Its own polls and settings are answered; every packet of the twin is one to it, with the antenna's values."""
    robot, _ = parse_robot(driver.example)
    assert robot is not None
    message = pyubx2.UBXMessage
    with VirtualRobot(robot) as world:
        twin: Any = world.twins["GNSS"]
        twin.feed = in_circle(20.0, 60.0)
        sent: list[bytes] = []
        port = twin.twins.port
        send = port.send

        def noted(packet: bytes) -> bool:
            sent.append(packet)
            return bool(send(packet))

        port.send = noted
        world.advance(0.1)
        line = world.rig.hosts["gnss"].port
        asked = ["NAV-PVT", "NAV-STATUS", "NAV-SAT", "NAV-DOP", "NAV-POSLLH", "NAV-VELNED", "NAV-TIMEUTC"]
        questions = [message("NAV", name, pyubx2.POLL) for name in asked]
        questions += [
            message("MON", "MON-VER", pyubx2.POLL),
            message("CFG", "CFG-RATE", pyubx2.POLL),
            message("CFG", "CFG-RATE", pyubx2.SET, measRate=100, navRate=1, timeRef=0),
            message("CFG", "CFG-MSG", pyubx2.SET, msgClass=1, msgID=0x35, rateUART1=1),
            message("CFG", "CFG-MSG", pyubx2.SET, msgClass=0xF0, msgID=0, rateUART1=1),
            message("CFG", "CFG-MSG", pyubx2.POLL, msgClass=1, msgID=7),
            message("CFG", "CFG-NAV5", pyubx2.POLL),
        ]
        for question in questions:
            line.send(question.serialize())
            world.advance(0.06)
        world.advance(0.5)
        assert (twin.period_ms, twin.rates) == (100, {(1, 7): 1, (1, 0x35): 1, (0xF0, 0): 1})
    stream = b"".join(sent)
    theirs = their_packets(stream)
    ours = ubx.scanner(direction="from device").feed(stream)
    assert [raw for raw, _ in theirs] == [one.meta.raw for one in ours]
    assert {*(name for name, _ in MESSAGES.values()), "MonVer", "CfgRate", "CfgMsg", "Ack", "Nak"} == {
        type(one).__name__ for one in ours
    }
    for record, (_, parsed) in zip(ours, theirs, strict=True):
        if type(record).__name__ in SAME:
            assert_same(record, parsed)
    version = next(parsed for _, parsed in theirs if parsed.identity == "MON-VER")
    assert version.swVersion.startswith(b"EXT CORE 1.00 (aces)")
    assert version.extension_01.startswith(b"PROTVER=27.00")
    pvt = [parsed for _, parsed in theirs if parsed.identity == "NAV-PVT"][-1]
    north, east = twin.origin.metres(pvt.lat * 3.141592653589793 / 180, pvt.lon * 3.141592653589793 / 180)
    assert (north * north + east * east) ** 0.5 == pytest.approx(20, abs=0.15)
    assert degrees(twin.origin.latitude) == pytest.approx(pvt.lat, abs=0.001)
    assert any(sentence.startswith(b"$GNGGA,") for sentence in sent)


def test_its_reader_and_a_serial_port() -> None:
    """Through a pseudo-terminal, as from a receiver: it reads solutions, has sentences sent, asks for versions."""
    serial = oracle("serial", "pyserial")
    message = pyubx2.UBXMessage
    robot, _ = parse_robot(driver.example.replace("rate_hz = 5", "rate_hz = 10"))
    assert robot is not None
    with twins_at_a_terminal(robot, "gnss") as made:
        port: Any = serial.Serial(made.port.path, 38_400, timeout=WAIT_S)
        try:
            reader = pyubx2.UBXReader(port, protfilter=pyubx2.UBX_PROTOCOL | pyubx2.NMEA_PROTOCOL)

            def read(identity: str) -> Any:
                """The next message of this name; others pass."""
                for _ in range(200):
                    _, found = reader.read()
                    if found is not None and found.identity == identity:
                        return found
                raise AssertionError(f"no {identity} came")

            first, second = read("NAV-PVT"), read("NAV-PVT")
            assert (second.iTOW - first.iTOW) % 100 == 0
            assert (second.year, second.month, second.day, second.hour) == (2024, 3, 15, 10)
            assert (second.lat, second.lon, second.fixType) == (
                pytest.approx(48, abs=1e-5),
                pytest.approx(11, abs=1e-5),
                3,
            )
            port.write(message("CFG", "CFG-MSG", pyubx2.SET, msgClass=0xF0, msgID=0, rateUART1=1).serialize())
            assert read("ACK-ACK").clsID == 6
            sentence = read("GNGGA")
            assert (sentence.lat, sentence.lon) == (pytest.approx(48, abs=1e-5), pytest.approx(11, abs=1e-5))
            port.write(message("MON", "MON-VER", pyubx2.POLL).serialize())
            assert read("MON-VER").hwVersion.startswith(b"00190000")
            port.write(message("CFG", "CFG-MSG", pyubx2.SET, msgClass=0x66, msgID=0, rateUART1=1).serialize())
            assert read("ACK-NAK").msgID == 1
        finally:
            port.close()


@pytest.mark.parametrize("name", SAME)
def test_it_reads_our_worked_examples_alike(name: str) -> None:
    """Each worked example of the spec has the same values to it."""
    for example in ubx[name].examples:
        (record,) = ubx.scanner(direction="from device").feed(example.packet.data)
        mode = pyubx2.SET if name.startswith("Cfg") else pyubx2.GET
        assert_same(record, pyubx2.UBXReader.parse(example.packet.data, msgmode=mode))


def test_we_read_what_it_writes() -> None:
    """Packets that it builds from values decode to these; its truncation of scaled numbers is its own."""
    pvt = pyubx2.UBXMessage(
        "NAV", "NAV-PVT", pyubx2.GET, iTOW=1000, year=2031, month=12, day=31, hour=23, min=59, second=60, nano=-5, fixType=4,
        gnssFixOk=1, carrSoln=2, numSV=31, lon=-179.9999999, lat=-89.5, height=-1000, hMSL=-2000, velN=-1, velE=2, velD=-3,
        headMot=270.0, pDOP=1.5, validDate=1, fullyResolved=1, lastCorrectionAge=9, magDec=-4.25,
    )  # fmt: skip
    (record,) = ubx.scanner(direction="from device").feed(pvt.serialize())
    assert_same(record, pyubx2.UBXReader.parse(pvt.serialize()))
    values = as_dict(record)
    assert (values["fix"], values["valid"], values["flags"]["carrier"]) == (
        "gnss_and_dead_reckoning",
        5,
        "fixed",
    )
    assert values["flags3"]["correction_age"] == 9
    nak = pyubx2.UBXMessage("ACK", "ACK-NAK", pyubx2.GET, clsID=6, msgID=0x8A)
    assert as_dict(ubx.scanner(direction="from device").feed(nak.serialize())[0]) == {
        "acked_group": 6,
        "acked_number": 0x8A,
    }


@pytest.mark.parametrize("file", ["ubx-nav.bin", "ubx-mon.bin", "ubx-rxm.bin"])
def test_recordings_are_cut_and_read_alike(file: str, shared_captures: Path) -> None:
    """The same packets at the same places; of those that are declared here, the same values."""
    data = (shared_captures / "streams" / file).read_bytes()
    theirs = their_packets(data)
    scanner = ubx.scanner(direction="from device", include_unknown=True)
    found: list[Any] = [*scanner.feed(data), *scanner.close()]
    assert [raw for raw, _ in theirs] == [one.meta.raw for one in found]
    read = 0
    for record, (_, parsed) in zip(found, theirs, strict=True):
        if type(record).__name__ in SAME:
            assert_same(record, parsed)
            read += 1
    assert read == (7 if file == "ubx-nav.bin" else 0)
