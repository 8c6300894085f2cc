"""ECUs by OBD-II, and their twins."""

from __future__ import annotations

from typing import Any

import pytest

from aces_bus.device import UNKNOWN
from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.robot import VirtualRobot, parse_robot
from aces_bus.testing import driver_tests
from aces_devices.obd2 import driver
from aces_devices.obd2.twin import Obd2Twin

test_obd2 = driver_tests(driver)


def car(settings: str = "") -> VirtualRobot:
    """An engine's ECU, in virtual time."""
    robot, problems = parse_robot(f"""
name = "car"
rate_hz = 20
[buses]
can = {{ link = "can", protocol = "obd2", bitrate = 500_000 }}
[devices.ENGINE]
driver = "obd2"
bus = "can"
credentials = {{ ecu = 0 }}
{settings}
""")
    assert robot is not None, problems
    return VirtualRobot(robot, rate_hz=20)


def test_values_are_in_si() -> None:
    """3000 rpm are 314.16 rad/s; a value that the ECU has not is unknown, and the others come all the same."""
    with car(
        'settings = { values = ["engine_speed", "coolant_temperature", "air_flow", "fuel_pressure"] }'
    ) as robot:
        twin = robot.twins["ENGINE"]
        assert isinstance(twin, Obd2Twin)
        twin.ecu.values |= {"engine_speed": 3000, "air_flow": 10, "coolant_temperature": -40}
        robot.advance(1.0)
        assert robot["ENGINE.engine_speed"].value == pytest.approx(314.159, abs=1e-3)
        assert robot["ENGINE.coolant_temperature"].value == pytest.approx(233.15)
        assert robot["ENGINE.air_flow"].value == pytest.approx(0.01)
        assert robot["ENGINE.fuel_pressure"].value is UNKNOWN


def test_codes_come_and_are_cleared() -> None:
    """A misfire is stored and lights the lamp; clearing leaves what is permanent."""
    with car('settings = { values = ["monitor_status"] }') as robot:
        engine: Any = robot.devices["ENGINE"]
        robot.twins["ENGINE"].fault("misfire")
        robot.advance(1.0)
        assert (robot["ENGINE.codes"].value, robot["ENGINE.lamp"].value) == (2, True)
        assert engine.stored_codes().wait() == ["P0301", "P0302"]
        assert engine.vin().wait() == "1D4GP00R55B123456"
        robot.twins["ENGINE"].fault("misfire", on=False)
        engine.ask("ClearCodes", reply="CodesCleared").wait()
        robot.advance(1.0)
        assert (robot["ENGINE.codes"].value, robot["ENGINE.lamp"].value) == (0, False)
        assert (engine.stored_codes().wait(), engine.permanent_codes().wait()) == ([], ["P0301"])


def test_a_request_to_all_is_answered_by_each() -> None:
    """Both ECUs of the example answer 0x7DF with their own number."""
    robot, problems = parse_robot(driver.example)
    assert robot is not None, problems
    with VirtualRobot(robot) as both:
        asked = both.devices["ENGINE"].ask("ReadInfoAll", reply="Vin", what="vin")
        other = both.devices["GEARBOX"].ask("ReadInfoAll", reply="Vin", what="vin")
        assert (asked.wait().ecu, other.wait().ecu) == (0, 1)


@pytest.mark.parametrize("values", ["[]", str(["throttle"] * 7).replace("'", '"')])
def test_values_are_one_to_six(values: str) -> None:
    """More do not go into one request."""
    with (
        pytest.raises(CallerError, match="one request asks for 1 to 6"),
        car(f"settings = {{ values = {values} }}"),
    ):
        pass


def test_unknown_values_are_refused_by_name() -> None:
    """The error lists what there is."""
    with pytest.raises(UnknownNameError, match="coolant_temperature"), car('settings = { values = ["rpm"] }'):
        pass
