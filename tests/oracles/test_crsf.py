"""crsf-parser and plain arithmetic: frames that others built are read to their numbers, and ours by them.

crsf-parser knows channels, link statistics and the battery. The other frames are packed here by `struct`, as TBS' document
lists them.
"""

from __future__ import annotations

import random
import struct
from typing import Any

import pytest

from aces_bus import decode
from aces_bus.protocol import Record
from aces_protocols.crsf.spec import crsf
from tests.oracles.foreign import oracle

parser: Any = oracle("crsf_parser", "crsf-parser")
handling: Any = oracle("crsf_parser.handling", "crsf-parser")
payloads: Any = oracle("crsf_parser.payloads", "crsf-parser")

DRAWN = 1500


def frame(kind: int, payload: bytes, address: int = 0xC8) -> bytes:
    """A frame with the check that crsf-parser computes."""
    data = bytes([address, len(payload) + 2, kind]) + payload
    return data + bytes([handling.crsf_frame_crc(data + b"\0")])


def read(data: bytes) -> list[Record]:
    """Return all records, with a check that columns read the same."""
    scanner = crsf.scanner()
    records: list[Any] = [*scanner.feed(data), *scanner.close()]
    assert scanner.counts.decoded == len(data)
    for name, table in decode(data, crsf).items():
        mine = [record for record in records if type(record).__name__ == name]
        for column in table.names:
            if "." not in column:
                assert table[column].to_list() == [_plain(getattr(r, column)) for r in mine], (name, column)
    return records


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def theirs(data: bytes) -> list[Any]:
    """Return what crsf-parser reads, whole frames alone."""
    found: list[Any] = []

    def take(content: Any, status: Any) -> None:
        assert status is parser.PacketValidationStatus.VALID
        found.append(content.payload)

    parser.CRSFParser(take).parse_stream(bytearray(data))
    return found


def drawn_link(chance: random.Random) -> dict[str, Any]:
    """Return raw numbers of link statistics, by crsf-parser's names."""
    names = (
        "uplink_rssi_ant_1",
        "uplink_rssi_ant_2",
        "uplink_link_quality",
        "downlink_rssi",
        "downlink_link_quality",
    )
    return {
        **{name: chance.randrange(256) for name in names},
        **{name: chance.randrange(-128, 128) for name in ("uplink_snr", "downlink_snr")},
        "diversity_active_antenna": chance.randrange(2),
        "rf_mode": chance.randrange(3),
        "uplink_tx_power": chance.randrange(7),
    }


def link_of(record: Any) -> dict[str, Any]:
    """Return a record's numbers under crsf-parser's names."""
    return {
        "uplink_rssi_ant_1": -record.uplink_rssi_1,
        "uplink_rssi_ant_2": -record.uplink_rssi_2,
        "uplink_link_quality": record.uplink_quality,
        "uplink_snr": record.uplink_snr,
        "diversity_active_antenna": record.antenna,
        "rf_mode": record.profile,
        "uplink_tx_power": record.power,
        "downlink_rssi": -record.downlink_rssi,
        "downlink_link_quality": record.downlink_quality,
        "downlink_snr": record.downlink_snr,
    }


MODES = {"RF_4_FPS": "fps_4", "RF_50_FPS": "fps_50", "RF_150_FPS": "fps_150"}


def test_what_it_builds_is_read_to_the_same_numbers() -> None:
    """1,500 frames of each kind that crsf-parser builds are decoded to what they were built of, live and in columns."""
    chance, data = random.Random(1), b""
    wanted: list[tuple[str, Any]] = []
    for _ in range(DRAWN):
        battery = (
            chance.randrange(1 << 15),
            chance.randrange(1 << 15),
            chance.randrange(1 << 24),
            chance.randrange(256),
        )
        values = dict(zip(("voltage", "current", "capacity", "remaining"), battery, strict=True))
        data += bytes(handling.crsf_build_frame(payloads.PacketsTypes.BATTERY_SENSOR, values))
        wanted.append(("Battery", battery))
        channels = [chance.randrange(1 << 11) for _ in range(16)]
        # It lists the channels from the last one on.
        data += bytes(
            handling.crsf_build_frame(payloads.PacketsTypes.RC_CHANNELS_PACKED, {"channels": channels[::-1]})
        )
        wanted.append(("Channels", tuple(channels)))
        link = drawn_link(chance)
        data += bytes(handling.crsf_build_frame(payloads.PacketsTypes.LINK_STATISTICS, link))
        wanted.append(("LinkStatistics", link))
    records = read(data)
    assert len(records) == 3 * DRAWN
    raw = crsf.scanner(raw=True).feed(data)
    for record, (name, values) in zip(raw, wanted, strict=True):
        assert type(record).__name__ == name
        if name == "Battery":
            assert (record.voltage, record.current, record.used, record.remaining) == values
        elif name == "Channels":
            assert tuple(record.channels) == values
        else:
            mine = link_of(record) | {
                "uplink_rssi_ant_1": record.uplink_rssi_1,
                "uplink_rssi_ant_2": record.uplink_rssi_2,
                "downlink_rssi": record.downlink_rssi,
            }
            assert mine == values


def test_it_reads_what_we_build() -> None:
    """1,500 frames of each kind that our encoder builds from values in their units mean the same to crsf-parser."""
    chance, scanner = random.Random(2), crsf.scanner()
    for _ in range(DRAWN):
        volts, amperes = chance.randrange(1 << 15), chance.randrange(1 << 15)
        used, remaining = chance.randrange(1 << 24), chance.randrange(256)
        battery = crsf.encode(
            "Battery", voltage=volts / 10, current=amperes / 10, used=used, remaining=remaining
        )
        numbers = [chance.randrange(1 << 11) for _ in range(16)]
        pulses = [(number - 992) * 5 / 8 + 1500 for number in numbers]  # TICKS_TO_US of TBS' document
        channels = crsf.encode("Channels", channels=pulses)
        link = drawn_link(chance)
        (mine,) = scanner.feed(frame(0x14, payloads.payload_link_statistics.build(link)))
        again = crsf.encode(
            "LinkStatistics", **{name: getattr(mine, name) for name in crsf["LinkStatistics"].fields}
        )
        found = theirs(battery + channels + again)
        assert [found[0].voltage, found[0].current, found[0].capacity, found[0].remaining] == [
            volts,
            amperes,
            used,
            remaining,
        ]
        assert list(found[1].channels) == numbers[::-1]
        assert {name: int(found[2][name]) for name in link} == link
        assert mine.profile == MODES[str(found[2].rf_mode)]
        assert link_of(mine)["uplink_snr"] == found[2].uplink_snr


def test_frames_as_the_document_lists_them() -> None:
    """Thousands of frames packed by struct mean what TBS' formulas make of their numbers."""
    chance, data = random.Random(3), b""
    wanted: list[dict[str, Any]] = []
    for _ in range(DRAWN):
        lat, lon = (
            chance.randrange(-900_000_000, 900_000_000),
            chance.randrange(-1_800_000_000, 1_800_000_000),
        )
        speed, heading, height, count = (chance.randrange(n) for n in (1 << 16, 36_000, 1 << 16, 256))
        data += frame(0x02, struct.pack(">iiHHHB", lat, lon, speed, heading, height, count))
        wanted.append({
            "latitude": lat / 1e7, "longitude": lon / 1e7, "speed": speed / 10, "heading": heading / 100,
            "altitude": height - 1000, "satellites": count,
        })  # fmt: skip
        angles = [chance.randrange(-31_416, 31_417) for _ in range(3)]
        data += frame(0x1E, struct.pack(">hhh", *angles), 0xEA)
        wanted.append(dict(zip(("pitch", "roll", "yaw"), (angle / 1e4 for angle in angles), strict=True)))
        up = chance.randrange(-(1 << 15), 1 << 15)
        data += frame(0x07, struct.pack(">h", up))
        wanted.append({"speed": up / 100})
        packed, vertical = chance.randrange(1 << 16), chance.randrange(-128, 128)
        metres = (packed & 0x7FFF) if packed & 0x8000 else (packed - 10_000) / 10
        forms = [(">H", packed), (">Hb", packed, vertical), (">Hh", packed, up)]
        form, *numbers = chance.choice(forms)
        data += frame(0x09, struct.pack(str(form), *numbers))
        wanted.append({"altitude": metres} | ({"speed": up / 100} if form == ">Hh" else {}))
        turns = [chance.randrange(-(1 << 23), 1 << 23) for _ in range(chance.randrange(1, 20))]
        data += frame(0x0C, b"\x01" + b"".join(turn.to_bytes(3, "big", signed=True) for turn in turns))
        wanted.append({"source": 1, "speeds": pytest.approx(turns)})
    records = read(data)
    for record, values in zip(records, wanted, strict=True):
        for name, value in values.items():
            found = getattr(record, name)
            assert found == value if name == "speeds" else found == pytest.approx(value, abs=1e-9), (
                record,
                name,
            )


def test_a_captured_frame_and_a_command() -> None:
    """Betaflight's captured channels and proposal of 2 MBd are read to its numbers; a wrong inner check is not."""
    captured = bytes.fromhex("00 18 16 BD 08 9F F4 AE F7 BD EF 7D EF FB AD FD 45 2B 5A 01 00 00 00 00 00 6C")
    (channels,) = crsf.scanner(raw=True).feed(captured)
    assert list(channels.channels[:4]) == [189, 993, 978, 983]
    proposal = bytearray.fromhex("C8 0C 32 C8 EC 0A 70 01 00 1E 84 80 22 72")
    assert [r.baud for r in crsf.scanner().feed(bytes(proposal))] == [2_000_000]
    body = bytes(proposal[3:-2]) + b"\x23"
    scanner = crsf.scanner()
    assert scanner.feed(frame(0x32, body)) == []
    assert scanner.counts.decoded == 0


def test_names_of_devices_are_read_up_to_their_end() -> None:
    """A device's answer has its name, numbers and count of parameters; frames that are longer keep the rest."""
    body = b"\xea\xee" + b"ELRS\0" + struct.pack(">IIIBB", 0x454C5253, 1, 0x030501, 23, 0)
    (info,) = read(frame(0x29, body))
    assert (info.destination, info.origin, info.name, info.parameters) == (
        "handset",
        "transmitter",
        "ELRS",
        23,
    )
    (vario,) = read(frame(0x07, b"\x00\x64\x01\x02"))
    assert (vario.speed, vario.more) == (1.0, b"\x01\x02")
