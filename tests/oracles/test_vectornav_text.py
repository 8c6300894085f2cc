"""vectornav-vn200: our sentences mean to its client what they mean to us, and its commands are ours."""

from __future__ import annotations

import random
from collections import deque
from typing import Any

import pytest

from aces_bus import as_dict
from aces_protocols.vectornav_text.spec import ERRORS, OUTPUTS, vectornav_text
from tests.oracles.foreign import oracle

theirs: Any = oracle("vectornav", "vectornav-vn200")

#: Its readers of registers that the unit also sends by itself.
READERS = {
    "YPR": "read_yaw_pitch_roll",
    "QTN": "read_quaternion",
    "QMR": "read_quat_mag_accel_gyro",
    "MAG": "read_mag",
    "ACC": "read_accel",
    "GYR": "read_gyro",
    "MAR": "read_mag_accel_gyro",
    "YMR": "read_ypr_mag_accel_gyro",
    "IMU": "read_imu",
    "GPS": "read_gps",
    "GPE": "read_gps_ecef",
    "INS": "read_ins",
    "INE": "read_ins_ecef",
    "ISL": "read_ins_state_lla",
    "ISE": "read_ins_state_ecef",
    "DTV": "read_delta_theta_velocity",
    "YBA": "read_ypr_body_accel_gyro",
}


class Unit:
    """A serial port with our unit behind it: it keeps registers, and answers by our encoder."""

    is_open = True

    def __init__(self) -> None:
        self.registers: dict[int, list[str]] = {}
        self.asked: list[Any] = []
        self._lines: deque[bytes] = deque()

    def write(self, data: bytes) -> None:
        (command,) = vectornav_text.scanner().feed(data)
        self.asked.append(command)
        name = type(command).__name__
        if name != "ReadRegister":
            self._lines.append(data)
        elif command.register in self.registers:
            value, *more = self.registers[command.register]
            self._lines.append(vectornav_text.encode(name, register=command.register, value=value, more=more))
        else:
            self._lines.append(vectornav_text.encode("Error", code="invalid_register"))

    def readline(self) -> bytes:
        return self._lines.popleft()

    def close(self) -> None:
        """Do nothing: the test ends."""


@pytest.fixture
def unit() -> Unit:
    return Unit()


@pytest.fixture
def client(unit: Unit) -> Any:
    made = theirs.VN200("none")
    made._ser = unit
    return made


def drawn(name: str, dice: random.Random) -> dict[str, Any]:
    """Values of a sentence's fields."""
    values: dict[str, Any] = {}
    for field in OUTPUTS[name][2]:
        if field.name == "status":
            values["status"] = f"{dice.randrange(1 << 16):04X}"
        elif field.name in ("week", "fix", "satellites"):
            values[field.name] = dice.randrange(10)
        else:
            values[field.name] = round(dice.uniform(-90, 90), 3)
    return values


@pytest.mark.parametrize("name", READERS)
def test_registers_mean_the_same(name: str, unit: Unit, client: Any) -> None:
    """200 drawn sentences of each kind are the same numbers to it, as the register that has them, in its order."""
    dice = random.Random(name)
    register = OUTPUTS[name][0]
    for _ in range(200):
        values = drawn(name, dice)
        sentence = vectornav_text.encode(name, **values)
        (record,) = vectornav_text.scanner().feed(sentence)
        unit.registers[register] = sentence.decode()[7 : sentence.index(b"*")].split(",")
        found = list(getattr(client, READERS[name])().values())
        ours = as_dict(record)
        if "status" in ours:
            ours["status"] = int(ours["status"], 16)
        assert found == list(ours.values())
        assert len(found) == len(OUTPUTS[name][2])
    assert {command.register for command in unit.asked} == {register}


def test_errors_have_its_words(unit: Unit, client: Any) -> None:
    """A register that is not there, and every error that it can read: of ten to twelve it takes the letters for digits."""
    with pytest.raises(theirs.VN200Error, match="error 8: Invalid Register"):
        client.read_yaw()
    for name, code in ERRORS.items():
        if code.isdigit():
            said = theirs.VN200Error(int(code, 16))
            assert name.replace("_", " ") == str(said).split(": ")[1].lower()


def test_its_connection_is_ours(unit: Unit, client: Any) -> None:
    """It silences the unit when it connects, and lets it speak when it leaves."""
    client._send_command("VNASY,0")
    client.disconnect()
    assert [(type(c).__name__, c.on) for c in unit.asked] == [("SendByItself", "off"), ("SendByItself", "on")]
