"""Specs written from the README and the tutorial alone. Short, clean, and every law holds."""

from __future__ import annotations

import json
import runpy
from collections import Counter
from functools import cache
from pathlib import Path

import pytest
from hypothesis import settings

from aces_bus import Unknown, as_dict, decode
from aces_bus.protocol import Protocol
from aces_bus.protocol.lint import check_protocol
from aces_bus.testing import Fuzzer
from tests.tools.conftest import Aces
from tests.tools.conftest import aces as aces

FOLDER = Path(__file__).resolve().parents[2] / "examples"
STREAMS = ["mip.py", "tlv_sensor.py"]
SPECS = [*STREAMS, "fast_packet_device.py"]
GGA = b"$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\r\n"
#: A ping, its answer, and a packet of sensor data (mip_sdk's parser accepts them).
PING, PONG = bytes.fromhex("75650102 0201 E0C6"), bytes.fromhex("75650104 04F10100 D56A")


@cache
def spec(name: str) -> Protocol:
    protocol = runpy.run_path(str(FOLDER / name))[name.removesuffix(".py")]
    assert isinstance(protocol, Protocol)
    return protocol


@pytest.mark.parametrize("name", SPECS)
def test_a_newcomers_spec_is_short_and_clean(name: str) -> None:
    """Under 100 lines; `aces spec check` has nothing against it, and its worked examples hold."""
    assert len((FOLDER / name).read_text(encoding="utf-8").splitlines()) < 100
    assert [one for one in check_protocol(spec(name)) if one.level != "note"] == []
    examples = [len(message.examples) for message in spec(name).declared]
    assert sum(examples) >= len(examples) - 1


@pytest.mark.slow
@pytest.mark.parametrize("name", SPECS)
def test_all_laws_hold(name: str) -> None:
    """Every message is reached, and no law fails."""
    fuzzer = Fuzzer([spec(name)], seed=183)
    assert fuzzer.run(10 * settings().max_examples) == []
    assert fuzzer.coverage.never() == []


def test_requests_and_answers_are_told_apart() -> None:
    """A ping looks like an answer with an unknown field: the direction says which it is."""
    mip = spec("mip.py")
    assert [type(one).__name__ for one in mip.scanner(direction="both").feed(PING + PONG)] == [
        "Ping",
        "Answer",
    ]
    (answer,) = mip.scanner(direction="from device").feed(PONG)
    assert as_dict(answer) == {
        "set": "base",
        "fields": [{"kind": "ack", "data": {"command": 1, "code": "ok"}, "reason": None}],
    }


def test_fields_of_unknown_kinds_are_kept() -> None:
    """A kind that nobody knows stays bytes, and is sent again as it came."""
    mip = spec("mip.py")
    fields = [
        {"kind": "gyro", "data": [0.5, 0, -1], "reason": None},
        {"kind": 0x99, "data": b"\x01\x02", "reason": "unknown"},
    ]
    packet = mip.encode("Sensors", fields=fields)
    (record,) = mip.scanner(direction="from device").feed(packet)
    assert as_dict(record) == {"fields": fields}


@pytest.mark.slow
def test_a_recording_of_an_inertial_unit(shared_captures: Path) -> None:
    """Every packet of a real unit is read, every field in it accounted for, and built again byte for byte."""
    mip = spec("mip.py")
    data = (shared_captures / "streams" / "mip-imu.part.bin").read_bytes()
    scanner = mip.scanner(direction="from device", include_unknown=True)
    found = [*scanner.feed(data), *scanner.close()]
    records = [one for one in found if not isinstance(one, Unknown)]
    assert Counter(type(one).__name__ for one in records) == {"Sensors": 1208, "Estimate": 119, "Answer": 1}
    assert len(data) - sum(len(one.meta.raw) for one in records) == 24
    items = [item for one in records for item in one.fields]
    assert {item.reason for item in items} <= {None, "unknown"}
    assert all(mip.encode(type(one).__name__, **as_dict(one)) == one.meta.raw for one in records)
    table = decode(data, mip, direction="from device")["Sensors"]
    accel = [one.fields for one in records if type(one).__name__ == "Sensors"]
    firsts = [next((item.data[2] for item in fields if item.kind == "accel"), None) for fields in accel]
    assert table["fields.accel.2"].to_list() == firsts
    assert sum(value is not None for value in firsts) == 755


@pytest.mark.parametrize("name", STREAMS)
def test_the_tools_take_them(name: str, tmp_path: Path, aces: Aces) -> None:
    """Decoded, explained and exported from the file, as a user would."""
    capture = tmp_path / "session.bin"
    capture.write_bytes(PONG if name == "mip.py" else spec(name).encode("History", hours=[]))
    decoded = aces(
        "decode", capture, "-p", FOLDER / name, "--direction", "from", "--format", "jsonl", "--strict"
    )
    assert decoded.status == 0, decoded.err
    assert json.loads(decoded.out)["message"] in {"Answer", "History"}
    explained = aces("spec", "explain", FOLDER / name, capture, "--direction", "from")
    assert explained.status == 0
    for form in ("markdown", "wireshark"):
        assert aces("spec", "export", FOLDER / name, "--format", form).status == 0
    assert aces("protocols", FOLDER / name).status == 0


def test_a_text_is_explained_field_by_field(tmp_path: Path, aces: Aces) -> None:
    """Between separators each byte has its field, and each field is read at the separator that ends it."""
    capture = tmp_path / "session.bin"
    capture.write_bytes(GGA)
    lines = aces("spec", "explain", "nmea0183", capture).out.splitlines()
    assert "  14  lat, 8 bytes: 34 38 30 37 2E 30 33 38" in lines
    assert "  22  2C  separator        lat = 48.1173 °" in lines
    assert "  61  2C  separator        age = None" in lines
    assert any(line.endswith("check") for line in lines)
    listed = aces("protocols", "nmea0183").out
    assert "type='GGA'" in listed
