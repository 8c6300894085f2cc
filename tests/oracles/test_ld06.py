"""lds2d: it reads what our encoder builds to our values, its commands are our bytes, and it scans the room of our twin."""

from __future__ import annotations

import math
import random
import time
from typing import Any

import pytest

from aces_bus import decode
from aces_devices.laser import WALLS, distance_in_room
from aces_devices.ld06 import EXAMPLE, driver
from aces_protocols.ld06.spec import POINTS, ld06
from tests.oracles.foreign import oracle
from tests.oracles.serial_lines import served_line

lds2d: Any = oracle("lds2d", "lds2d")
theirs: Any = oracle("lds2d.drivers.ldrobot_ld14p", "lds2d")
crc: Any = oracle("lds2d.crc", "lds2d")

DRAWN = 1000


def test_packets_mean_the_same() -> None:
    """1,000 drawn packets, 12,000 points, mean the same to lds2d, to our scanner and in columns; its check holds."""
    chance, data, wanted = random.Random(1), b"", []
    for _ in range(DRAWN):
        points = [
            {"distance": chance.randrange(1 << 16), "intensity": chance.randrange(256)} for _ in range(POINTS)
        ]
        speed, first, span = chance.randrange(720, 4680), chance.randrange(36_000), chance.randrange(1, 2000)
        packet = ld06.encode(
            "Measurements",
            speed=speed,
            start_angle=first / 100,
            end_angle=(first + span) % 36_000 / 100,
            time=chance.randrange(30_000),
            points=points,
        )
        assert crc.crc8(packet[:-1]) == packet[-1]
        rounds_hz, found = theirs.parse_packet(packet)
        assert rounds_hz == pytest.approx(speed / 360)
        assert [(p.dist_mm, p.quality) for p in found] == [(p["distance"], p["intensity"]) for p in points]
        assert found[0].angle_deg == pytest.approx(first / 100)
        assert found[-1].angle_deg % 360 == pytest.approx((first + span) % 36_000 / 100, abs=1e-6)
        data += packet
        wanted.append((speed, first / 100, [p["distance"] for p in points]))
    records = ld06.scanner(direction="from device").feed(data)
    assert [(r.speed, [p.distance for p in r.points]) for r in records] == [
        (speed, distances) for speed, _, distances in wanted
    ]
    assert [r.start_angle for r in records] == pytest.approx([angle for _, angle, _ in wanted])
    table = decode(data, ld06, direction="from device")["Measurements"]
    assert table["points.11.distance"].to_list() == [distances[-1] for _, _, distances in wanted]


def test_its_commands_are_ours() -> None:
    """What lds2d sends to the motor is what our encoder builds."""
    assert ld06.encode("Start") == theirs.build_command(0xA0)
    assert ld06.encode("Stop") == theirs.build_command(0xA1)
    assert ld06.encode("SetSpeed", speed=2160) == theirs.build_command(0xA2, (2160).to_bytes(2, "little"))


@pytest.mark.slow
def test_it_scans_the_twins_room() -> None:
    """Each of its points is on a wall; its commands stop the motor and turn it at another speed."""
    with served_line(EXAMPLE, driver) as line, lds2d.Lidar.open("LD06", line.path) as lidar:
        scans = lidar.scans()
        next(scans)
        scan = next(scans)
        assert scan.scan_freq_hz == pytest.approx(10)
        assert len(scan.valid_points) == pytest.approx(450, abs=15)
        for point in scan.valid_points:
            wall = distance_in_room(WALLS, math.radians(point.angle_deg))
            assert point.dist_mm / 1000 == pytest.approx(wall, abs=0.05)
        twin: Any = line.twins["LIDAR"]
        lidar.stop()
        lidar.set_scan_freq(5)
        end = time.monotonic() + 30
        while (twin.is_turning or twin.rounds_hz != 5) and time.monotonic() < end:
            time.sleep(0.01)
        assert (twin.is_turning, twin.rounds_hz) == (False, 5)
