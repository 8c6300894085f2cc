"""RX servos: units, the control table by name, what they answer, alarms, what survives power-off, scanning."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import pytest

from aces_bus.device import UNKNOWN, Job, Robot
from aces_bus.device.host import Host
from aces_bus.errors import CallerError, DeviceError, FieldError, NoReplyError, UnknownNameError
from aces_bus.robot import VirtualRobot, parse_robot
from aces_bus.robot.rig import simulate
from aces_bus.testing import driver_tests
from aces_devices.robotis_rx import driver
from aces_devices.robotis_rx.driver import STEP

test_driver = driver_tests(driver)

LINE = """
name = "line"
rate_hz = 50
[buses]
line = {{ link = "serial", protocol = "robotis", baud = {baud} }}
[devices]
{devices}
[joints]
{joints}
"""


def robot_of(*, servos: int = 2, baud: int = 1_000_000, joint: str = "", **settings: Any) -> Robot:
    """Servos S1, S2 … with joints J1, J2 …, each as in the worked example: zero 2.605, direction −1."""
    written = ", ".join(
        f"{k} = {str(v).lower() if isinstance(v, bool) else repr(v)}" for k, v in settings.items()
    )
    devices = "\n".join(
        f'S{n} = {{ driver = "robotis_rx", bus = "line", credentials = {{ id = {n} }}, settings = {{ {written} }} }}'
        for n in range(1, servos + 1)
    )
    joints = "\n".join(
        f'J{n} = {{ device = "S{n}", direction = -1, zero = 2.605{joint} }}' for n in range(1, servos + 1)
    )
    robot, problems = parse_robot(LINE.format(baud=baud, devices=devices, joints=joints))
    assert robot is not None, problems
    return robot


def made(robot: Robot | None = None, **options: Any) -> VirtualRobot:
    return VirtualRobot(
        robot or robot_of(health_s=0.1), rate_hz=50, load={"robotis_rx": driver}.__getitem__, **options
    )


# ---------------------------------------------------------------------- units and motion


@pytest.mark.parametrize(("angle", "counts"), [(0.5, 411), (0.0, 508), (-0.5, 606), (9.0, 0), (-9.0, 1023)])
def test_angles_become_counts_as_on_minihubo(angle: float, counts: int) -> None:
    """Zero 2.605, direction −1: cut to whole counts, clipped at the ends and never wrapped."""
    with made(robot_of(joint=", max_speed = 1000", health_s=0.1)) as robot:
        robot.advance(0.1)
        robot["J1.position"].set(angle)
        robot.advance(0.05)
        assert robot.twins["S1"]["goal_position"] == counts
        assert robot.events.count("limited", "S1") == (abs(angle) > 2.6)


@pytest.mark.parametrize("raw", [0, 1, 336, 508, 1022, 1023])
def test_a_position_that_was_read_is_the_same_goal(raw: int) -> None:
    """An angle that a count stands for gives that count again."""
    device = made().devices["S1"]
    assert device.counts((raw * STEP - 2.605) * -1) == raw


def test_a_joint_goes_where_it_is_told_at_the_speed_it_is_given() -> None:
    """Goal, speed limit, load and arrival, in SI."""
    with made(robot_of(servos=1, motion=True, health_s=0.1)) as robot:
        robot.advance(0.1)
        robot.devices["S1"].enable().wait()
        robot["J1.speed_limit"].set(0.5)
        robot["J1.position"].set(1.0)
        robot.advance(1.0)
        assert robot["J1.position"].value == pytest.approx(0.5, abs=0.03)
        assert robot["J1.velocity"].value == pytest.approx(0.5, abs=0.02)
        assert robot["J1.load"].value > 0
        assert robot["J1.moving"].value is True
        robot.advance(1.5)
        assert robot["J1.position"].value == pytest.approx(1.0, abs=2 * STEP)
        assert robot["J1.moving"].value is False
        assert robot["J1.velocity"].value == 0
        joint = robot.simulation.world.joints["J1"]
        assert joint.position(robot.clock.now()) == pytest.approx(1.0, abs=2 * STEP)


def test_without_torque_a_goal_moves_nothing() -> None:
    """Nothing is switched on by itself; `enable` holds the joint where it is, not where an old goal was."""
    with made() as robot:
        robot.advance(0.1)
        robot["J1.position"].set(1.0)
        robot.advance(0.5)
        assert robot["J1.position"].value == pytest.approx(0, abs=2 * STEP)
        robot.devices["S1"].enable().wait()
        robot.advance(0.5)
        assert robot["J1.position"].value == pytest.approx(0, abs=2 * STEP)
        assert robot["J1.enabled"].value is True


def test_endless_turn_is_driven_by_duty() -> None:
    """A continuous joint has a duty instead of a goal; its servo turns on and on."""
    robot_file = robot_of(servos=1, joint=', type = "continuous", command = "duty"', motion=True)
    with made(robot_file) as robot:
        robot.advance(0.1)
        robot.devices["S1"].enable().wait()
        robot["J1.duty"].set(0.5)
        robot.advance(1.0)
        assert robot.twins["S1"]["moving_speed"] == 0x400 | 512
        assert robot["J1.velocity"].value > 2
        assert robot["J1.position"].is_writable is False
        robot.devices["S1"].stop_motion().wait()
        robot.advance(1.0)
        assert robot["J1.velocity"].value == 0


@pytest.mark.parametrize("stop", ["hold", "release"])
def test_stopping_holds_or_releases(stop: str) -> None:
    """On its way, a joint is held where it is, or its torque goes off, as its settings say."""
    with made(robot_of(servos=1, stop=stop, health_s=0.1)) as robot:
        robot.devices["S1"].enable().wait()
        robot["J1.speed_limit"].set(0.5)
        robot["J1.position"].set(1.0)
        robot.advance(1.0)
        robot.rig.stop_motion().wait()
        robot.advance(1.0)
        assert robot["J1.position"].value == pytest.approx(0.5, abs=0.05)
        assert robot["J1.enabled"].value is (stop == "hold")


# ---------------------------------------------------------------------- registers by name


def test_registers_have_names_and_units() -> None:
    """Read one, read many at once, read the whole table of 50 bytes, write one."""
    with made() as robot:
        device, twin = robot.devices["S1"], robot.twins["S1"]
        assert device.read("present_temperature").wait() == 37
        assert device.read("present_voltage").wait() == pytest.approx(11.1)
        both = device.read("present_voltage", "present_temperature").wait()
        assert both == {"present_voltage": pytest.approx(11.1), "present_temperature": 37}
        table = device.read_all().wait()
        assert table["model_number"] == "RX-28"
        assert list(table)[-1] == "punch"
        assert len(table) == 32
        device.write("led", "on").wait()
        assert (twin["led"], device.cached("led")) == (1, "on")
        device.write("led", 0).wait()
        assert twin["led"] == 0
        assert device.read("return_delay").wait() == 500


def test_what_may_not_be_written_is_not_sent() -> None:
    """Read-only, out of range, unknown, EEPROM without confirmation, and what is locked."""
    with made() as robot:
        device, twin = robot.devices["S1"], robot.twins["S1"]
        robot.advance(0.2)
        requests = twin.requests
        with pytest.raises(CallerError, match="can only be read"):
            device.write("present_position", 1)
        with pytest.raises(FieldError, match="goal_position"):
            device.write("goal_position", 301)
        with pytest.raises(UnknownNameError, match="present_temperature"):
            device.read("present_temprature")
        with pytest.raises(CallerError, match="confirm=True"):
            device.write("return_delay", 100)
        assert twin.requests == requests
        device.write("return_delay", 100, confirm=True).wait()
        assert twin["return_delay"] == 50
        device.write("lock", "locked").wait()
        with pytest.raises(CallerError, match="locked"):
            device.write("return_delay", 200, confirm=True)
        with pytest.raises(CallerError, match="locked"):
            device.write("punch", 40)
        device.write("led", 1).wait()
        assert (twin["return_delay"], twin["led"]) == (50, 1)


def test_a_refused_write_names_the_reason() -> None:
    """A goal outside the servo's angle limits is refused by the servo, by name; nothing has changed."""
    with made() as robot:
        robot.twins["S1"]["ccw_angle_limit"] = 600
        before = robot.twins["S1"]["goal_position"]
        with pytest.raises(DeviceError, match="angle_limit"):
            robot.devices["S1"].write("goal_position", 900, raw=True).wait()
        assert robot.twins["S1"]["goal_position"] == before
        assert robot.events.count("alarm", "S1") == 1


def test_the_servos_own_limits_limit_the_joint() -> None:
    """Angle limits of the EEPROM, once read, clip set-points before they are sent."""
    robot = made(robot_of(servos=1, joint=", max_speed = 1000"))
    robot.twins["S1"]["cw_angle_limit"], robot.twins["S1"]["ccw_angle_limit"] = 400, 600
    with robot:
        robot.advance(0.2)
        robot.devices["S1"].enable().wait()
        robot["J1.position"].set(2.0)
        robot.advance(0.1)
        assert robot.twins["S1"]["goal_position"] == 400
        assert robot.events.count("limited", "S1") == 1
        assert robot.events.count("alarm") == 0


@pytest.mark.parametrize("level", [0, 1, 2])
def test_the_status_return_level_is_respected(level: int) -> None:
    """0: nothing but Ping is asked; 1: reads are, and writes are read back; 2: writes are acknowledged."""
    with made(robot_of(servos=1, status_return_level=level, health_s=0.1)) as robot:
        robot.advance(1.0)
        device = robot.devices["S1"]
        assert device.ping().wait() == []
        device.write("led", 1).wait()
        assert robot.twins["S1"]["led"] == 1
        assert robot.rig.hosts["line"].counts.missed == 0
        assert not device.is_silent
        assert (robot["J1.position"].value is UNKNOWN) == (level == 0)
        if level == 0:
            with pytest.raises(CallerError, match="no reads"):
                device.read("led")
        if level == 1:
            robot.twins["S1"]["lock"] = 1
            with pytest.raises(DeviceError, match="all the same"):
                device.write("punch", 40).wait()


def test_a_servo_that_is_not_there_is_told() -> None:
    """A request that nobody answers is repeated, then fails by name; nothing blocks."""
    with made() as robot:
        robot.twins["S1"].power(False)
        with pytest.raises(NoReplyError, match=r"S1: .*3 tries"):
            robot.devices["S1"].read("led").wait()
        assert robot.devices["S2"].read("led").wait() == "off"


# ---------------------------------------------------------------------- alarms and reboots


@pytest.mark.parametrize(
    ("fault", "name"), [("hot", "overheating"), ("low_voltage", "voltage"), ("overload", "overload")]
)
def test_a_fault_is_an_alarm_by_name_and_its_end_too(fault: str, name: str) -> None:
    """Error bits of any status raise an alarm once, and end it once."""
    with made() as robot:
        robot.advance(0.2)
        robot.twins["S1"].fault(fault)
        robot.advance(0.3)
        assert robot["S1.errors"].value == (name,)
        assert [event.detail for event in robot.events.of("alarm")] == [name]
        robot.twins["S1"].fault(fault, on=False)
        robot.advance(0.3)
        assert robot["S1.errors"].value == ()
        assert [event.detail for event in robot.events.of("alarm over")] == [name]


def test_a_jammed_joint_is_overloaded_and_let_go() -> None:
    """It pushes with all it may, reports an overload, and its shutdown mask switches torque off; this is not a reboot."""
    with made(robot_of(servos=1, motion=True, health_s=0.1)) as robot:
        robot.devices["S1"].enable().wait()
        robot.advance(0.3)
        robot.twins["S1"].fault("jam")
        robot["J1.position"].set(1.0)
        robot.advance(0.3)
        assert robot["J1.load"].value == pytest.approx(1.0)
        robot.advance(0.6)
        assert robot["J1.enabled"].value is False
        details = [event.detail for event in robot.events.of("alarm")]
        assert details[0] == "overload"
        assert robot.events.count("rebooted") == 0
        assert robot.twins["S1"].blinks is False  # the overload has gone with the torque


def test_a_reboot_is_noticed_by_what_was_lost() -> None:
    """Torque and speed that were set are at their defaults again: told as a reboot; set-points are not repeated."""
    with made() as robot:
        robot.devices["S1"].enable().wait()
        robot["J1.speed_limit"].set(1.0)
        robot["J1.position"].set(0.3)
        robot.advance(1.0)
        robot.twins["S1"].reboot()
        robot.advance(0.5)
        assert robot.events.count("rebooted", "S1") == 1
        assert "torque_enable" in robot.events.of("rebooted")[0].detail
        assert robot["J1.enabled"].value is False
        assert robot.devices["S1"].goals == {}
        assert robot.events.count("rebooted", "S2") == 0


def test_a_set_point_that_was_lost_is_sent_again() -> None:
    """What goes to many is not acknowledged: it is read back, and sent again until it has arrived."""
    with made() as robot:
        robot.advance(0.2)
        robot.twins["S1"].power(False)
        robot["J1.speed_limit"].set(1.0)
        robot.advance(0.03)
        robot.twins["S1"].is_powered = True
        assert robot.twins["S1"]["moving_speed"] == 0
        robot.advance(0.5)
        assert robot["J1.speed_limit"].value == pytest.approx(1.0, rel=0.01)


# ---------------------------------------------------------------------- id, speed, factory, scan


def test_a_new_id_is_used_at_once() -> None:
    """The servo answers to its new number, and is polled by it; a taken or impossible number is refused."""
    with made() as robot:
        robot.advance(0.1)
        device = robot.devices["S1"]
        with pytest.raises(CallerError, match="confirm"):
            device.set_id(9)
        with pytest.raises(CallerError, match="S2"):
            device.set_id(2, confirm=True)
        with pytest.raises(FieldError):
            device.set_id(254, confirm=True)
        robot.rig.hosts["line"].remove("S2")  # still there, and not in this program
        with pytest.raises(DeviceError, match="answers to id 2 already"):
            device.set_id(2, confirm=True).wait()
        assert robot.twins["S1"]["id"] == 1
        device.set_id(9, confirm=True).wait()
        assert robot.twins["S1"]["id"] == 9
        missed = robot.rig.hosts["line"].counts.missed
        robot.advance(0.5)
        assert robot["J1.position"].value is not UNKNOWN
        assert robot.rig.hosts["line"].counts.missed == missed


def test_another_speed_and_the_factorys_make_it_deaf_here() -> None:
    """Both need confirmation; afterwards it is on a line of another speed."""
    with made() as robot:
        robot.advance(0.1)
        one, two = robot.devices["S1"], robot.devices["S2"]
        with pytest.raises(CallerError, match="confirm"):
            two.factory_reset(confirm=False)
        one.set_baud(500_000, confirm=True).wait()
        two.factory_reset(confirm=True).wait()
        robot.advance(0.5)
        assert robot.twins["S1"]["baud_rate"] == 3
        assert (robot.twins["S2"]["baud_rate"], robot.twins["S2"]["id"]) == (34, 1)
        assert one.is_silent
        assert two.is_silent


def test_a_scan_finds_who_is_there() -> None:
    """Ids, models and who answers no reads; it tells how far it is; two with one id are named."""
    robot = made(robot_of(servos=3))
    robot.twins["S1"]["model_number"] = 64
    robot.twins["S2"]["status_return_level"] = 0
    with robot.simulation:
        (port,) = robot.ports("scan").values()
        host = Host(port, list(robot.rig.hosts["line"].variants.values()))
        host.open()
        scan = driver.scan
        assert scan is not None
        job = Job(robot.clock, "scan", lambda job: scan(host, job))
        robot.advance(1.0)
        assert 0 < job.progress < 1
        assert "found" in job.text
        found = job.wait(60)
    assert [(c.credentials["id"], c.model, c.settings) for c in found] == [
        (1, "RX-64", {}),
        (2, None, {"status_return_level": 0}),
        (3, "RX-28", {}),
    ]
    assert robot.clock.now() < 254 * 20e6


def test_a_scan_names_an_id_that_two_have() -> None:
    """Garbled answers are somebody's: the id is listed, and said to be twice there."""
    robot = made(robot_of(servos=2))
    twins = robot.simulation
    other = simulate(robot.robot, robot.ports("other"), load={"robotis_rx": driver}.__getitem__)
    other["S2"].power(False)
    other["S1"].fault("overload")
    scan = driver.scan
    assert scan is not None
    with twins, other:
        (port,) = robot.ports("scan").values()
        host = Host(port, list(robot.rig.hosts["line"].variants.values()))
        host.open()
        found = Job(robot.clock, "scan", lambda job: scan(host, job)).wait(60)
    assert [config.credentials["id"] for config in found] == [1, 2]
    assert "two servos with this id" in (found[0].doc or "")
    assert (found[1].doc, found[1].model) == (None, "RX-28")


def test_settings_that_cannot_be_are_refused() -> None:
    """A level that no servo has, a way of stopping that nobody knows."""
    with pytest.raises(CallerError, match="status_return_level = 3"):
        made(robot_of(status_return_level=3))
    with pytest.raises(CallerError, match="stop"):
        made(robot_of(stop="fast"))


def test_a_servo_that_is_another_model_is_told() -> None:
    """What the file says and what the servo says is compared once, at the start."""
    robot_file = robot_of(servos=1)
    config = msgspec.structs.replace(robot_file.devices["S1"], model="RX-10")
    robot = made(msgspec.structs.replace(robot_file, devices={"S1": config}))
    robot.twins["S1"]["model_number"] = 64
    with robot:
        robot.advance(0.2)
        assert "RX-64" in robot.events.of("alarm")[0].detail
    assert math.isclose(STEP, 300 / 1023 * math.pi / 180)
