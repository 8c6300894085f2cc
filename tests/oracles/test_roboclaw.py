"""tcr-roboclaw (Basicmicro's library, packaged), unmodified: its packets, and our twins on a pseudo-terminal.

1. Real time: only content and order are asserted.
"""

from __future__ import annotations

from typing import Any

import pytest

from aces_bus import Unknown
from aces_devices.roboclaw import driver
from aces_protocols.roboclaw.spec import ADDRESSES, FULL_DUTY, roboclaw
from tests.oracles.foreign import oracle
from tests.oracles.serial_lines import served_line

kit: Any = oracle("tcr_roboclaw", "tcr-roboclaw")

#: Its method, what it is called with, and our message with its fields; counts and speeds are as they are written.
WRITTEN: tuple[tuple[str, tuple[float, ...], str, dict[str, Any]], ...] = (
    ("ForwardM1", (64,), "ForwardM1", {"speed": 64}),
    ("BackwardM1", (127,), "BackwardM1", {"speed": 127}),
    ("ForwardM2", (1,), "ForwardM2", {"speed": 1}),
    ("BackwardM2", (0,), "BackwardM2", {"speed": 0}),
    ("ForwardBackwardM1", (96,), "BothWaysM1", {"speed": 96}),
    ("ForwardBackwardM2", (32,), "BothWaysM2", {"speed": 32}),
    ("MixedForward", (5,), "MixedForward", {"speed": 5}),
    ("MixedBackward", (6,), "MixedBackward", {"speed": 6}),
    ("MixedTurnRight", (7,), "MixedRight", {"speed": 7}),
    ("MixedTurnLeft", (8,), "MixedLeft", {"speed": 8}),
    ("MixedForwardBackward", (9,), "MixedBothWays", {"speed": 9}),
    ("MixedLeftRight", (10,), "MixedTurn", {"speed": 10}),
    ("SetSerialTimeout", (15,), "SetSerialTimeout", {"timeout": 1.5}),
    ("ResetEncoders", (), "ResetEncoders", {}),
    ("SetEncM1", (-7,), "SetEncoderM1", {"position": -7}),
    ("SetEncM2", (70000,), "SetEncoderM2", {"position": 70000}),
    (
        "SetM1VelocityPID",
        (1.5, 0.25, 0.125, 44000),
        "SetSpeedGainsM1",
        {"p": 1.5, "i": 0.25, "d": 0.125, "full_speed": 44000},
    ),
    (
        "SetM2VelocityPID",
        (2, 0, 4, 9),
        "SetSpeedGainsM2",
        {"p": 2.0, "i": 0.0, "d": 4.0, "full_speed": 9},
    ),
    ("DutyM1", (-16384,), "DriveDutyM1", {"duty": -16384 / FULL_DUTY}),
    ("DutyM2", (32767,), "DriveDutyM2", {"duty": 1.0}),
    ("DutyM1M2", (1, -1), "DriveDuties", {"m1": 1 / FULL_DUTY, "m2": -1 / FULL_DUTY}),
    ("SpeedM1", (-5,), "DriveSpeedM1", {"speed": -5}),
    ("SpeedM2", (12000,), "DriveSpeedM2", {"speed": 12000}),
    ("SpeedM1M2", (1, -2), "DriveSpeeds", {"m1": 1, "m2": -2}),
    ("SpeedAccelM1", (3, -4), "RampSpeedM1", {"acceleration": 3, "speed": -4}),
    ("SpeedAccelM2", (5, 6), "RampSpeedM2", {"acceleration": 5, "speed": 6}),
    ("SpeedAccelM1M2", (7, 8, -9), "RampSpeeds", {"acceleration": 7, "m1": 8, "m2": -9}),
    ("BuffSpeedDistanceM1", (-10, 11, 1), "GoDistanceM1", {"speed": -10, "distance": 11, "at_once": 1}),
    ("BuffSpeedDistanceM2", (12, 13, 0), "GoDistanceM2", {"speed": 12, "distance": 13, "at_once": 0}),
    (
        "BuffSpeedAccelDistanceM1",
        (1, -2, 3, 1),
        "RampDistanceM1",
        {"acceleration": 1, "speed": -2, "distance": 3, "at_once": 1},
    ),
    (
        "BuffSpeedAccelDistanceM2",
        (4, 5, 6, 0),
        "RampDistanceM2",
        {"acceleration": 4, "speed": 5, "distance": 6, "at_once": 0},
    ),
    ("SetMainVoltages", (60, 340), "SetMainVoltageLimits", {"lowest": 6.0, "highest": 34.0}),
    ("SetLogicVoltages", (55, 120), "SetLogicVoltageLimits", {"lowest": 5.5, "highest": 12.0}),
    (
        "SetM1PositionPID",
        (2, 0.5, 8, 100, 5, -1000, 1000),
        "SetPositionGainsM1",
        {"p": 2.0, "i": 0.5, "d": 8.0, "most_integral": 100, "deadzone": 5, "lowest": -1000, "highest": 1000},
    ),
    (
        "BuffSpeedAccelDeccelPositionM1",
        (1, 2, 3, -4, 1),
        "RampToM1",
        {"acceleration": 1, "speed": 2, "deceleration": 3, "position": -4, "at_once": 1},
    ),
    (
        "BuffSpeedAccelDeccelPositionM2",
        (5, 6, 7, 8, 0),
        "RampToM2",
        {"acceleration": 5, "speed": 6, "deceleration": 7, "position": 8, "at_once": 0},
    ),
    ("SetM1DefaultAccel", (655359,), "SetDutyAccelerationM1", {"acceleration": 655359}),
    ("SetM2DefaultAccel", (1,), "SetDutyAccelerationM2", {"acceleration": 1}),
    ("SetM1DefaultSpeed", (32767,), "SetDefaultSpeedM1", {"speed": 1.0}),
    ("SetM2DefaultSpeed", (0,), "SetDefaultSpeedM2", {"speed": 0.0}),
    ("SetDeadBand", (25, 50), "SetDeadband", {"backward": 2.5, "forward": 5.0}),
    ("SetM1EncoderMode", (0x81,), "SetEncoderModeM1", {"mode": 0x81}),
    ("SetM2EncoderMode", (0x20,), "SetEncoderModeM2", {"mode": 0x20}),
    ("SetSpeedErrorLimits", (1, 2), "SetSpeedErrorLimits", {"m1": 1, "m2": 2}),
    ("SetPositionErrorLimits", (3, 4), "SetPositionErrorLimits", {"m1": 3, "m2": 4}),
    ("BuffPositionM1", (-5, 1), "GoToM1", {"position": -5, "at_once": 1}),
    ("BuffPositionM2", (6, 0), "GoToM2", {"position": 6, "at_once": 0}),
    ("BuffPositionM1M2", (7, -8, 1), "GoBothTo", {"m1": 7, "m2": -8, "at_once": 1}),
    ("BuffSpeedPositionM1", (9, -10, 1), "GoWithSpeedToM1", {"speed": 9, "position": -10, "at_once": 1}),
    ("BuffSpeedPositionM2", (11, 12, 0), "GoWithSpeedToM2", {"speed": 11, "position": 12, "at_once": 0}),
    (
        "SetM2PositionPID",
        (1, 0, 4, 9, 8, 7, 6),
        "SetPositionGainsM2",
        {"p": 1.0, "i": 0.0, "d": 4.0, "most_integral": 9, "deadzone": 8, "lowest": 7, "highest": 6},
    ),
    (
        "BuffSpeedDistanceM1M2",
        (-1, 2, 3, 4, 1),
        "GoDistances",
        {"speed_m1": -1, "distance_m1": 2, "speed_m2": 3, "distance_m2": 4, "at_once": 1},
    ),
    (
        "BuffSpeedAccelDistanceM1M2",
        (9, 1, 2, -3, 4, 0),
        "RampDistances",
        {"acceleration": 9, "speed_m1": 1, "distance_m1": 2, "speed_m2": -3, "distance_m2": 4, "at_once": 0},
    ),
    (
        "IndepSpeedAccelM1M2",
        (1, -2, 3, 4),
        "RampSpeedsApart",
        {"acceleration_m1": 1, "speed_m1": -2, "acceleration_m2": 3, "speed_m2": 4},
    ),
    (
        "BuffIndepSpeedAccelDistanceM1M2",
        (1, 2, 3, 4, -5, 6, 1),
        "RampDistancesApart",
        {
            "acceleration_m1": 1,
            "speed_m1": 2,
            "distance_m1": 3,
            "acceleration_m2": 4,
            "speed_m2": -5,
            "distance_m2": 6,
            "at_once": 1,
        },
    ),
    ("DutyAccelM1", (1000, -2), "RampDutyM1", {"duty": -2 / FULL_DUTY, "acceleration": 1000}),
    ("DutyAccelM2", (655359, 32767), "RampDutyM2", {"duty": 1.0, "acceleration": 655359}),
    (
        "DutyAccelM1M2",
        (1, -2, 3, 4),
        "RampDuties",
        {
            "acceleration_m1": 1,
            "duty_m1": -2 / FULL_DUTY,
            "acceleration_m2": 3,
            "duty_m2": 4 / FULL_DUTY,
        },
    ),
    (
        "BuffSpeedAccelDeccelPositionM1M2",
        (1, 2, 3, -4, 5, 6, 7, 8, 1),
        "RampBothTo",
        {
            "acceleration_m1": 1,
            "speed_m1": 2,
            "deceleration_m1": 3,
            "position_m1": -4,
            "acceleration_m2": 5,
            "speed_m2": 6,
            "deceleration_m2": 7,
            "position_m2": 8,
            "at_once": 1,
        },
    ),
    ("SetM1MaxCurrent", (1500,), "SetCurrentLimitM1", {"highest": 15.0}),
    ("SetM2MaxCurrent", (1,), "SetCurrentLimitM2", {"highest": 0.01}),
)


class _Line:
    """A port that acknowledges each packet, and keeps what was written."""

    def __init__(self) -> None:
        self.data = b""

    def write(self, data: bytes) -> None:
        self.data += data

    def read(self, size: int) -> bytes:
        return b"\xff"[:size]

    def flushInput(self) -> None:
        pass


@pytest.mark.parametrize(("method", "given", "message", "fields"), WRITTEN, ids=[row[0] for row in WRITTEN])
def test_what_it_writes_is_our_message(
    method: str, given: tuple[float, ...], message: str, fields: dict[str, Any]
) -> None:
    """Each packet that it writes is read as that message with these values, and built again as the same bytes."""
    client = kit.Roboclaw("nowhere", 38_400, address=0x83)
    client._port = line = _Line()
    assert getattr(client, method)(*given)
    (record,) = roboclaw.scanner(direction="to device", include_unknown=True).feed(line.data)
    assert type(record).__name__ == message
    assert record.address == 0x83
    found = {name: getattr(record, name) for name in fields}
    assert found == pytest.approx(fields) if "mode" not in fields else int(found["mode"]) == fields["mode"]
    assert roboclaw.encode(message, address=0x83, **found) == line.data


EIGHT = """
name = "eight"
[buses]
line = { link = "serial", protocol = "roboclaw", baud = 460_800 }
[devices]
""" + "\n".join(
    f'RC{address:X} = {{ driver = "roboclaw", bus = "line", credentials = {{ address = {address} }} }}'
    for address in ADDRESSES
)


def test_it_drives_eight_controllers_on_one_line() -> None:
    """Each of its packets is one of our messages, and it understands each of our answers, whichever controller gives it."""
    with served_line(EIGHT, driver) as line:
        client = kit.Roboclaw(line.path, 460_800, timeout=10.0)  # its own is 10 ms
        client.open()
        try:
            for address in ADDRESSES:
                client.address = address
                assert client.ReadVersion() == (1, "USB Roboclaw 2x7a v4.2.4\n")
                assert client.SetEncM1(-address)
                assert client.SetEncM2(1000 + address)
                assert client.SetSerialTimeout(address - 0x70)
            for address in reversed(ADDRESSES):
                client.address = address
                assert client.ReadEncM1() == (1, -address, 0)
                assert client.GetEncoderCounters()[2] & 0xFFFFFFFF == 1000 + address
                assert client.ReadSerialTimeout() == (1, address - 0x70)
                assert client.ReadMainBatteryVoltage() == (1, 240)
                assert client.ReadLogicBatteryVoltage() == (1, 50)
                assert client.ReadTemp() == (1, 251)
                assert client.ReadError() == (1, 0)
                assert client.ReadCurrents() == (1, 0, 0)
                assert client.ReadBufferLengths() == (1, 0x80, 0x80)
                assert client.SetM1VelocityPID(2, 0.5, 0.25, address)
                assert client.ReadM1VelocityPID() == [1, 2.0, 0.5, 0.25, address]
                assert client.DutyM1M2(address, -address)
                assert client.ReadPWMs() == (1, address, -address)
                assert client.SpeedM1(1000 * (address - 0x7F))
                assert client.DutyM1M2(0, 0)
                assert client.ReadPWMs() == (1, 0, 0)
        finally:
            client._port.close()
        found = line.records()
        assert [record for record in found if isinstance(record, Unknown)] == []
        names = {type(record).__name__ for record in found}
        assert {
            "GetVersion",
            "Version",
            "EncoderM1",
            "DriveDuties",
            "Done",
            "Duties",
            "SpeedGainsM1",
        } <= names
        assert {record.address for record in found} == set(ADDRESSES)
