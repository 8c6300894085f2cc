"""A servo's stop is the next thing on its line after what is being said: confirmed, and no goal of the servo behind it."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from aces_bus.device.stopping import stop_devices
from aces_bus.errors import DeviceError
from aces_bus.robot import VirtualRobot, parse_robot
from aces_devices.servos.driver import ServoDevice
from tests.interpreted import IS_COMPILED, WHY

COUNT = 12
#: Model, in a robot's file; settings at which it answers reads alone.
FAMILIES = {"dynamixel": "XL430-W250", "feetech": "STS3215", "robotis_rx": "RX-28"}
PROTOCOLS = {"dynamixel": "dynamixel", "feetech": "feetech", "robotis_rx": "robotis"}
#: Messages that write: one servo's register, those of many.
WRITE, TOGETHER = "Write", "SyncWrite"

Sent = list[tuple[str, str, dict[str, Any]]]


def twelve(family: str, settings: str = "", count: int = COUNT, others: str = "") -> VirtualRobot:
    devices = "\n".join(
        f'S{n} = {{ driver = "{family}", bus = "line", model = "{FAMILIES[family]}", credentials = {{ id = {n} }},'
        f" settings = {{ health_s = 0.2{settings} }} }}"
        for n in range(1, count + 1)
    )
    joints = "\n".join(
        f'J{n} = {{ device = "S{n}", zero = 2.6, max_speed = 1000 }}' for n in range(1, count + 1)
    )
    robot, problems = parse_robot(
        f'name = "line"\nrate_hz = 50\n[buses]\nline = {{ link = "serial", protocol = "{PROTOCOLS[family]}",'
        f" baud = 1_000_000 }}\n[devices]\n{devices}\n{others}\n[joints]\n{joints}"
    )
    assert robot is not None, problems
    return VirtualRobot(robot, rate_hz=50)


def noted(robot: VirtualRobot) -> Sent:
    """Devices, messages and fields that leave from now on, in their order."""
    if IS_COMPILED:
        pytest.skip(WHY)
    host: Any = robot.rig.hosts["line"]
    sent: Sent = []
    packet, transmit = host.packet, host.transmit
    fields_of: dict[bytes, dict[str, Any]] = {}

    def made(device: Any, message: str, fields: Any) -> Any:
        found = packet(device, message, fields)
        fields_of[found] = {**device.credentials, **fields}
        return found

    def left(found: Any, device: Any, message: str, *how: Any, **more: Any) -> bool:
        sent.append((device.name, message, fields_of.get(found, {})))
        return bool(transmit(found, device, message, *how, **more))

    host.packet, host.transmit = made, left
    return sent


def moving(robot: VirtualRobot) -> list[ServoDevice]:
    """All servos, on their way to a goal."""
    robot.advance(0.06)
    robot.rig.each("enable").wait()
    for number in range(1, len(robot.devices) + 1):
        robot[f"J{number}.position"].set(0.4)
    robot.advance(0.04)
    found = list(robot.devices.values())
    assert all(isinstance(one, ServoDevice) for one in found)
    return found


def goes_to(sent: Sent, number: int) -> list[int]:
    """Where in what was sent a servo's goal is among those of many."""
    return [
        place
        for place, (_, message, fields) in enumerate(sent)
        if message == TOGETHER and any(one["id"] == number for one in fields["servos"])
    ]


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("after_s", [0.0003, 0.0102])
def test_a_stop_is_next_whatever_waits(family: str, after_s: float) -> None:
    """Twelve servos follow goals and have requests queued: the stop leaves first, and no goal of its servo after it."""
    with twelve(family) as robot:
        servos = moving(robot)
        one = servos[4]
        for servo in servos:
            servo.read("present_temperature")
            servo.write("led" if "led" in servo.codecs else "torque_limit", 1, raw=True)
        asked = one.read("present_voltage")
        robot.advance(after_s)
        sent = noted(robot)
        stop = one.stop_motion()
        robot.advance(0.03)
        assert stop.state == "done"
        assert sent[0][:2] == ("S5", WRITE)
        assert sent[0][2]["start"] == one.codec("goal_position").address
        assert not goes_to(sent, 5)
        assert goes_to(sent, 4)
        assert asked.is_over
        robot.advance(0.1)
        twins: Any = robot.twins
        assert twins["S5"]["goal_position"] == one.known["goal_position"][0] != twins["S4"]["goal_position"]
        assert not robot.events.count("two devices")


@pytest.mark.parametrize("family", FAMILIES)
def test_all_stops_leave_before_all_else(family: str) -> None:
    """Twelve stops are the next twelve exchanges; one whose answer is lost is sent again behind the others' stops."""
    with twelve(family) as robot:
        servos = moving(robot)
        for servo in servos:
            servo.read("present_temperature")
        robot.twins["S3"].fault("silent")
        sent = noted(robot)
        stopping = stop_devices(robot.clock, "all", servos)
        robot.advance(0.03)
        robot.twins["S3"].fault("silent", on=False)
        robot.advance(0.05)
        assert stopping.state == "done"
        assert [(name, message) for name, message, _ in sent[: COUNT + 1]] == [
            *((f"S{n}", WRITE) for n in range(1, COUNT + 1)),
            ("S3", WRITE),
        ]
        assert not [message for _, message, _ in sent if message == TOGETHER]
        assert not any(one.is_driven for one in servos)


@pytest.mark.parametrize("family", FAMILIES)
def test_a_servo_that_does_not_confirm_is_named(family: str) -> None:
    """It is sent its stop again and again; the others have stopped long before."""
    with twelve(family, count=3) as robot:
        servos = moving(robot)
        robot.twins["S3"].fault("silent")
        stopping = stop_devices(robot.clock, "all", servos)
        robot.advance(0.05)
        assert [one.name for one in servos if one.is_driven] == ["S3"]
        with pytest.raises(DeviceError, match="NOT switched off: S3"):
            stopping.wait(3)


@pytest.mark.parametrize("family", FAMILIES)
def test_a_stop_without_acknowledgements_is_read_back(family: str) -> None:
    """Servos that answer reads alone: the stop leaves first, and counts when the goal is read back."""
    with twelve(family, ", status_return_level = 1", count=3) as robot:
        for twin in robot.twins.values():
            twin["status_return_level"] = 0 if family == "feetech" else 1
        servos = moving(robot)
        for servo in servos:
            servo.read("present_temperature")
        sent = noted(robot)
        stop = servos[1].stop_motion()
        robot.advance(0.03)
        assert sent[0][:2] == ("S2", WRITE)
        assert ("S2", "Read", servos[1].codec("goal_position").address) in [
            (name, message, fields.get("start")) for name, message, fields in sent
        ]
        assert stop.state == "done"
        assert not goes_to(sent, 2)


def test_a_packet_to_many_that_waits_is_made_without_the_stopped_servo() -> None:
    """Two packets a tick, for two registers: one stops while the first is on the wire, and is not in the second."""
    with twelve("feetech", count=6) as robot:
        moving(robot)
        sent = noted(robot)
        for number in range(1, 7):
            robot[f"J{number}.speed_limit"].set(1.0)
        for _ in range(1000):
            if any(message == TOGETHER for _, message, _ in sent):
                break
            robot.advance(1e-4)
        del sent[:-1]
        robot.devices["S5"].stop_motion()
        robot.advance(0.005)
        assert [(name, message) for name, message, _ in sent[:3]] == [
            ("S1", TOGETHER),
            ("S5", WRITE),
            ("S1", TOGETHER),
        ]
        assert len(goes_to(sent, 5)) == 1
        assert len(goes_to(sent, 6)) == 2


def test_set_points_are_of_the_last_tick() -> None:
    """On a line that is busy for several ticks set-points do not pile up: what leaves is what was given last."""
    with twelve("robotis_rx", count=2) as robot:
        first, _ = moving(robot)
        robot.twins["S2"].fault("silent")
        reads = [robot.devices["S2"].read("present_temperature") for _ in range(3)]
        robot.advance(0.001)
        sent = noted(robot)
        for number in range(10):
            robot["J1.position"].set(0.1 + 0.01 * number)
            robot.advance(0.02)
        assert all(one.is_over for one in reads)
        goals = [fields["servos"][0]["data"] for _, message, fields in sent if message == TOGETHER]
        assert 0 < len(goals) < 10
        assert goals[-1] == first.codec("goal_position").pack(first.counts(0.19))


def test_a_speed_does_not_come_back_after_a_stop() -> None:
    """A wheel obeys its stop and its answers are lost: the speed that was set is not taken for lost, and not sent again."""
    with twelve("feetech", count=1) as robot:
        speed = msgspec.structs.replace(robot.robot.joints["J1"], command="speed")
    wheel = msgspec.structs.replace(robot.robot, joints={"J1": speed})
    with VirtualRobot(wheel, rate_hz=50) as robot:
        twin: Any = robot.twins["S1"]
        twin["operating_mode"] = 1
        robot.advance(0.1)
        device: Any = robot.devices["S1"]
        device.enable().wait()
        twin.fault("silent")
        robot["J1.velocity"].set(1.0)
        robot.advance(0.025)
        assert twin["goal_speed"] > 0
        stop = device.stop_motion()
        robot.advance(0.2)
        assert stop.state == "failed"
        twin.fault("silent", on=False)
        robot.advance(0.5)
        assert twin["goal_speed"] == 0
