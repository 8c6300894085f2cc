"""A stop ends what is under way: nothing that was begun before it switches a device on behind it."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import msgspec
import pytest

from aces_bus.device.stopping import stop_devices
from aces_bus.robot import VirtualRobot, parse_robot

#: Of drivers whose `enable` takes several steps: the device of their example, and what releases it.
DEVICES = [
    ("vesc", "driver", "MAST", ""),
    ("vesc", "uart_driver", "MAST", ""),
    ("moteus", "driver", "", ""),
    ("dynamixel", "driver", "", "release"),
    ("feetech", "driver", "", "release"),
    ("robotis_rx", "driver", "", "release"),
]


def of_example(module: str, name: str) -> VirtualRobot:
    robot, problems = parse_robot(getattr(import_module(f"aces_devices.{module}"), name).example)
    assert robot is not None, problems
    return VirtualRobot(robot, rate_hz=50)


@pytest.mark.parametrize("after_s", [0.0, 0.001, 0.004])
@pytest.mark.parametrize(("module", "name", "device", "stop"), DEVICES)
def test_a_device_is_not_enabled_behind_a_stop(
    module: str, name: str, device: str, stop: str, after_s: float
) -> None:
    """Whenever the stop comes while it is being enabled; enabled anew, it goes on."""
    with of_example(module, name) as robot:
        robot.advance(1.0)
        found: Any = robot.devices[device] if device else next(iter(robot.devices.values()))
        if stop:
            found.settings = msgspec.structs.replace(found.settings, stop=stop)
        job = found.enable()
        robot.advance(after_s)
        stop_devices(robot.clock, "all", robot.devices.values()).wait(5)
        robot.advance(0.5)
        assert job.is_over
        assert not found.is_driven
        assert not (found.cached("torque_enable", raw=True) if stop else found.takes_set_points)
        found.enable().wait()
