"""A device that falls silent is noticed within a stated time, however it is read."""

from __future__ import annotations

import pytest

from aces_bus.device import Device, load_driver
from aces_bus.device.drivers import list_drivers
from aces_bus.robot import VirtualRobot, parse_robot

#: Devices that answer nothing: whether they are there cannot be known.
ANSWER_NOTHING = {"VIA_RSP", "VIA_LSR", "QIK5"}
#: Seconds for which a driver asks nothing after a missed answer, which could still come.
PAUSE_S = {"modbus": 0.5}
#: Seconds of a node's heartbeat, three of which are missed (CANopen).
HEARTBEAT_S = 0.5


def stated_s(device: Device, count: int) -> float:
    """How long the running page gives a device: its period, and three misses of what takes longest; on a line in turn."""
    if device.sends_every_s is not None:
        return device.silent_after * device.sends_every_s + 0.2
    tick = 1 / (device.host.rate_hz or 100)
    if not device.all_polls:
        return 3.1 * HEARTBEAT_S
    turns = count if device.host.asks_one_by_one else 1
    slowest = (
        max(poll.timeout_s for poll in device.all_polls)
        + tick
        + PAUSE_S.get(device.variant.protocol.name, 0.0)
    )
    return (
        min(poll.every_s or tick for poll in device.all_polls) + turns * (device.silent_after + 2) * slowest
    )


@pytest.mark.parametrize("name", [one for one in sorted(list_drivers()) if load_driver(one).virtual])
def test_silence_is_noticed_in_time(name: str) -> None:
    """Each device of each driver's example, its power cut: the event comes within its time."""
    robot, problems = parse_robot(load_driver(name).example)
    assert robot is not None, problems
    with VirtualRobot(robot, rate_hz=robot.rate_hz or 100) as virtual:
        virtual.advance(3.0)
        cut = virtual.clock.now()
        for twin in virtual.twins.values():
            twin.power(False)
        virtual.advance(4.0)
        noticed = {
            one.device: (one.instant - cut) / 1e9
            for one in reversed(virtual.events.of("silent"))
            if one.instant > cut
        }
        for device in virtual.devices.values():
            if device.name not in ANSWER_NOTHING:
                assert noticed[device.name] <= stated_s(device, len(robot.devices_on(device.host.name)))


def test_a_device_that_sends_by_itself_is_back_when_it_sends_again() -> None:
    """A receiver that nobody asks: silent after three of its periods, and said when it is back."""
    robot, problems = parse_robot(load_driver("ubx").example)
    assert robot is not None, problems
    with VirtualRobot(robot, rate_hz=20) as virtual:
        virtual.advance(2.0)
        (device,) = virtual.devices.values()
        assert device.sends_every_s is not None
        assert virtual.events.count("silent") == 0
        virtual.twins[device.name].power(False)
        virtual.advance(1.0)
        assert virtual.events.of("silent")[0].detail.endswith(f"it sends every {device.sends_every_s:g} s")
        virtual.twins[device.name].power(True)
        virtual.advance(2.0)
        assert virtual.events.count("answers") == 1
        assert not device.is_silent
