"""rplidar and pyrplidar: they read what our encoder builds to our values, and rplidar's client works with the twin.

1. Real time, where a client is at the line: only content and order are asserted.
2. A pseudo-terminal has no DTR; what the client does with it is left out.
"""

from __future__ import annotations

import math
import random
from itertools import islice
from typing import Any

import pytest
import serial

from aces_bus import decode
from aces_devices.laser import WALLS
from aces_devices.rplidar import EXAMPLE, driver
from aces_devices.rplidar.twin import NOISE, SERIAL
from aces_protocols.rplidar.spec import EXPRESS, rplidar
from tests.oracles.foreign import oracle
from tests.oracles.serial_lines import served_line
from tests.oracles.served import wait_until

kit: Any = oracle("rplidar", "rplidar")
protocol: Any = oracle("pyrplidar_protocol", "pyrplidar")
client: Any = oracle("pyrplidar", "pyrplidar")

DRAWN = 4000


def test_measurements_mean_the_same() -> None:
    """4,000 drawn measurements mean the same to rplidar, to pyrplidar, to our scanner and in columns."""
    chance, data, wanted = random.Random(1), b"", []
    for _ in range(DRAWN):
        turn, quality = chance.choice(["begins", "goes_on"]), chance.randrange(64)
        angle, distance = chance.randrange(1 << 15) / 64, chance.randrange(1 << 16) / 4
        packet = rplidar.encode("Measurement", turn=turn, quality=quality, angle=angle, distance=distance)
        assert kit._process_scan(packet) == (turn == "begins", quality, angle, distance)
        theirs = protocol.PyRPlidarMeasurement(packet)
        assert (theirs.start_flag, theirs.quality, theirs.angle, theirs.distance) == kit._process_scan(packet)
        data += packet
        wanted.append((turn, quality, angle, distance))
    records = rplidar.scanner(direction="from device").feed(data)
    assert [(r.turn, r.quality, r.angle, r.distance) for r in records] == wanted
    table = decode(data, rplidar, direction="from device")["Measurement"]
    assert table["angle"].to_list() == [angle for _, _, angle, _ in wanted]
    assert table["distance"].to_list() == [distance for _, _, _, distance in wanted]


def test_a_measurement_that_rplidar_refuses_is_none_of_ours() -> None:
    """Of all 65,536 first two bytes, those that rplidar takes for a measurement are those that we take."""
    taken = {
        bytes([first, second])
        for first in range(256)
        for second in range(256)
        if _is_taken(bytes([first, second, 0, 0, 0]))
    }
    message = rplidar["Measurement"]
    for first in range(256):
        for second in range(0, 256, 5):
            try:
                message.struct.parse(bytes([first, second, 0, 0, 0]))
            except Exception:
                assert bytes([first, second]) not in taken
            else:
                assert bytes([first, second]) in taken


def _is_taken(packet: bytes) -> bool:
    try:
        kit._process_scan(packet)
    except kit.RPLidarException:
        return False
    return True


def test_packets_of_an_express_scan_mean_the_same() -> None:
    """300 drawn packets of 32 distances mean the same to pyrplidar, their xor in its two halves, too."""
    chance, data, wanted = random.Random(2), b"", []
    for _ in range(300):
        angle, begins = chance.randrange(1 << 15), chance.randrange(2)
        distances = [chance.randrange(1 << 14) for _ in range(EXPRESS)]
        compensations = [chance.randrange(-32, 32) for _ in range(EXPRESS)]
        packet = rplidar.variant("express").encoder.encode(
            "ExpressMeasurements",
            angle=angle / 64,
            begins=begins,
            distances=distances,
            compensations=[c / 8 for c in compensations],
        )
        theirs = protocol.PyRPlidarScanCapsule(packet)
        assert (theirs.sync_byte1, theirs.sync_byte2) == (0xA, 0x5)
        assert theirs.start_angle_q6 == angle
        assert theirs.start_flag == bool(begins)
        assert theirs.checksum == _xor(packet[2:])
        assert [d for cabin in theirs.cabins for d in (cabin.distance1, cabin.distance2)] == distances
        # It leaves the six bits of a compensation unsigned; by SLAMTEC's table the highest one is the sign.
        found = [d for cabin in theirs.cabins for d in (cabin.d_theta1, cabin.d_theta2)]
        assert found == [c % 64 for c in compensations]
        data += packet
        wanted.append((angle / 64, begins, tuple(distances), tuple(c / 8 for c in compensations)))
    scanner = rplidar.scanner(dialect="express", direction="from device")
    # In pieces, and a false beginning first: all packets are found.
    records = [r for at in range(0, len(data), 1000) for r in scanner.feed((b"\xa5" + data)[at : at + 1000])]
    records += scanner.feed((b"\xa5" + data)[len(data) // 1000 * 1000 + 1000 :]) + scanner.close()
    assert [(r.angle, r.begins, r.distances, r.compensations) for r in records] == wanted


def _xor(data: bytes) -> int:
    number = 0
    for byte in data:
        number ^= byte
    return number


def test_requests_are_those_of_both() -> None:
    """Their requests are our bytes, with and without data."""
    for name, command in {
        "Stop": kit.STOP_BYTE, "Reset": kit.RESET_BYTE, "Scan": kit.SCAN_BYTE, "ForceScan": kit.FORCE_SCAN_BYTE,
        "GetInfo": kit.GET_INFO_BYTE, "GetHealth": kit.GET_HEALTH_BYTE, "GetSampleRate": protocol.RPLIDAR_CMD_GET_SAMPLERATE,
    }.items():  # fmt: skip
        assert rplidar.encode(name) == protocol.PyRPlidarCommand(command).raw_bytes
    express = protocol.PyRPlidarCommand(protocol.RPLIDAR_CMD_EXPRESS_SCAN, bytes([2, 0, 0, 0, 0])).raw_bytes
    assert rplidar.encode("ExpressScan", mode=2, flags=0, parameter=0) == express
    motor = protocol.PyRPlidarCommand(
        protocol.RPLIDAR_CMD_SET_MOTOR_PWM, (660).to_bytes(2, "little")
    ).raw_bytes
    assert rplidar.encode("SetMotor", duty=660) == motor
    answer = protocol.PyRPlidarSamplerate(rplidar.encode("SampleRate", standard=504, express=252)[7:])
    assert (answer.t_standard, answer.t_express) == (504, 252)
    for name, (length, mode, kind) in {"ScanStarted": (5, 1, 0x81), "ExpressStarted": (84, 1, 0x82)}.items():
        started = protocol.PyRPlidarResponse(rplidar.variant("express").encoder.encode(name))
        assert (started.data_length, started.send_mode, started.data_type) == (length, mode, kind)


def test_its_client_works_with_the_twin(monkeypatch: pytest.MonkeyPatch) -> None:
    """Information, health and whole rounds of measurements reach rplidar's client; the distances are the room's."""
    monkeypatch.setattr(serial.Serial, "setDTR", lambda self, value=True: None, raising=False)
    with served_line(EXAMPLE, driver) as line:
        lidar = kit.RPLidar(line.path, timeout=5)
        try:
            info = lidar.get_info()
            assert (info["model"], info["firmware"], info["serialnumber"]) == (
                24,
                (1, 29),
                SERIAL.hex().upper(),
            )
            assert lidar.get_health() == ("Good", 0)
            rounds = list(islice(lidar.iter_scans(max_buf_meas=False), 3))
        finally:
            lidar.stop()
            lidar.disconnect()
        assert all(len(points) > 300 for points in rounds[1:])
        walls = [min((abs(point[1] - at), point) for point in rounds[1])[1] for at in (90, 180, 270)]
        for (_, angle, distance), wall in zip(walls, (WALLS[1], WALLS[2], WALLS[3]), strict=True):
            off = math.radians(angle - round(angle / 90) * 90)
            assert distance / 1000 * math.cos(off) == pytest.approx(wall, abs=6 * NOISE)
        twin: Any = line.twins["LIDAR"]
        wait_until(lambda: not twin.is_scanning)
        assert twin.duty == kit.DEFAULT_MOTOR_PWM


def test_the_express_client_works_with_the_twin(monkeypatch: pytest.MonkeyPatch) -> None:
    """pyrplidar begins an express scan and puts its distances on the walls of the twin's room.

    It reads the six bits of a compensation unsigned, so that half of its angles are 8° beside ours.
    """
    monkeypatch.setattr(serial.Serial, "setDTR", lambda self, value=True: None, raising=False)
    monkeypatch.setattr(serial.Serial, "dtr", property(lambda self: True, lambda self, value: None))
    robot = EXAMPLE.replace('protocol = "rplidar"', 'protocol = "rplidar", dialect = "express"')
    with served_line(robot, driver) as line:
        lidar = client.PyRPlidar()
        try:
            lidar.connect(port=line.path, baudrate=115_200, timeout=5)
            points = list(islice(lidar.start_scan_express(0)(), 1600))
        finally:
            lidar.stop()
            lidar.disconnect()
        twin: Any = line.twins["LIDAR"]
        right, aside = 0, 0
        for point in points[:1500]:
            off, beside = (
                abs(point.distance / 1000 - twin.distance(math.radians(point.angle + more)))
                for more in (0, 8)
            )
            right += off < 0.08
            aside += off >= 0.08 > beside
        assert right + aside > 1450
        assert min(right, aside) > 300
        wait_until(lambda: not twin.is_scanning)
