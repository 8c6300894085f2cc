"""NekoRMD, unmodified, with our twins on a served bus: what it sets and reads; where it is wrong.

1. Real time, as it sleeps between request and answer: only content is asserted.
2. It compares the identifier of an answer with that of the request, as motors before V3 have it: here it is given both.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import can
import pytest

from aces_bus import Unknown
from aces_devices.rmdx.twin import RmdxTwin
from aces_protocols.rmdx.spec import rmdx
from tests.oracles.foreign import oracle
from tests.oracles.served import ServedTwins, served, wait_until

theirs: Any = oracle("NekoRMD.NekoRMD", "nekormd")

ROBOT = """
name = "arm"
[buses]
arm = { link = "can", protocol = "rmdx", dialect = "3", bitrate = 1_000_000 }
[devices]
M9 = { driver = "rmdx", bus = "arm", credentials = { id = 9 } }
"""


@pytest.fixture
def arm() -> Iterator[ServedTwins]:
    with served(ROBOT) as made:
        yield made


def client(bus: can.BusABC) -> Any:
    """A client of motor 9."""
    made = theirs.NekoRMD(0x249, theirs.MotorType.RMD8x_pro)
    made.io.identifier, made.io.bus = 0x149, bus
    return made


def test_it_drives_our_twin(arm: ServedTwins) -> None:
    """It reads gains and encoders that the twin has, moves it by speed and to angles, and stops it."""
    twin = arm.twins["M9"]
    assert isinstance(twin, RmdxTwin)
    arm.call(lambda: twin.gains.update(current_kp=85, speed_ki=25))
    with can.Bus(channel=arm.channel, interface="aces") as bus:
        motor = client(bus)
        gains = motor.telemetry.read_pid_params()
        assert gains == {
            "current_kp": 85, "current_ki": 100, "speed_kp": 100, "speed_ki": 25, "position_kp": 100, "position_ki": 100
        }  # fmt: skip
        assert motor.control.unfreeze().data[0] == 0x77
        assert motor.control.position.set_absolute_position(500, 4500).data[0] == 0xA4
        wait_until(lambda: abs(arm.call(lambda: twin.angle) - 45) < 1)
        assert motor.telemetry.get_absolute_encoder() == pytest.approx(45 / 360 * 65_536, abs=200)
        position, raw, offset = motor.telemetry.get_relative_encoder()
        assert position == pytest.approx(45 / 360 * 65_536, abs=200)
        assert (raw, offset) == (position, 0)
        assert motor.control.position.set_increment_position(500, -9000).data[0] == 0xA8
        wait_until(lambda: abs(arm.call(lambda: twin.angle) + 45) < 1)
        assert motor.control.position.set_single_turn_position(0x01, 500, 31_000).data[0] == 0xA6
        wait_until(lambda: abs(arm.call(lambda: twin.angle) + 50) < 1)
        assert motor.control.speed.set_speed(-90).data[0] == 0xA2
        wait_until(lambda: abs(arm.call(lambda: twin.measured()["speed"]) + 90) < 5)
        assert motor.control.Torque.test().data[0] == 0xA1
        assert motor.control.freeze().data[0] == 0x81
    records = rmdx.scanner(dialect="3", include_unknown=True).feed(arm.frames())
    assert [one for one in records if isinstance(one, Unknown)] == []
    sent = {type(one).__name__: one for one in records}
    assert (sent["SetPosition"].position, sent["SetPosition"].max_speed) == (45.0, 500)
    assert sent["Increment"].position == -90.0
    assert (sent["SetTurnPosition"].direction, sent["SetTurnPosition"].position) == (
        "counterclockwise",
        310.0,
    )
    assert sent["SetSpeed"].speed == -90.0
    assert sent["SetCurrent"].current == 1.0
    assert {
        "GetGains",
        "Gains",
        "GetEncoder",
        "Encoder",
        "TurnEncoder",
        "Stop",
        "StopDone",
        "ReleaseBrakeDone",
    } <= set(sent)


def test_where_it_is_wrong(arm: ServedTwins) -> None:
    """By the manual's tables: it looks for acceleration and power in bytes that are 0, puts the current where nothing is,
    and cuts the date of the software to 16 bits."""
    with can.Bus(channel=arm.channel, interface="aces") as bus:
        motor = client(bus)
        assert motor.telemetry.read_acceleration() == 0
        assert motor.telemetry.read_motor_power() == 0
        assert motor.telemetry.read_software_version() == 20_220_206 & 0xFFFF
        motor.control.Torque.set_current(1.5)
    records = rmdx.scanner(dialect="3").feed(arm.frames())
    found = {type(one).__name__: one for one in records}
    assert found["Acceleration"].acceleration == 10_000
    assert found["Version"].date == 20_220_206
    assert found["SetCurrent"].current == 0.0
    assert found["SetCurrent"].zero.hex() == "009600"
