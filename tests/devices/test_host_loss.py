"""What devices do when their host is gone: every driver declares it, twins do it, and an end that holds believes it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from aces_bus.controller import controller
from aces_bus.device import Device, HostLoss, Robot, load_driver
from aces_bus.device.drivers import list_drivers
from aces_bus.errors import CallerError, DeviceError
from aces_bus.robot import VirtualRobot, parse_robot, run_virtual

RUNNING = Path(__file__).parents[2] / "docs" / "running.md"
PLACE = re.compile(r"(?<=<!-- host loss -->\n).*?(?=<!-- end -->)", re.DOTALL)
DRIVERS = sorted(list_drivers())
WORDS = {"goes on": "follows the last set-point", "unknown": "nobody knows", "brakes": "braked, may sink"}


def table() -> str:
    """The table of docs/running.md, of the declarations: drivers that declare the same share a row."""
    rows: dict[HostLoss, list[str]] = {}
    for name in DRIVERS:
        loss = load_driver(name).device.when_host_is_lost
        if loss.does != "nothing moves" or loss.after_s is not None:
            rows.setdefault(loss, []).append(name)
    lines = ["| driver | without its host | after | | source |", "|---|---|---|---|---|"]
    for loss, names in rows.items():
        after = "" if loss.after_s is None else f"{loss.after_s:g} s"
        does = WORDS.get(loss.does, loss.does)
        drivers = ", ".join(f"`{name}`" for name in names)
        lines.append(f"| {drivers} | {does} | {after} | {loss.detail} | {loss.source} |")
    return "\n".join(lines) + "\n"


def arm(body: str, *, link: str = "can", protocol: str, rate_hz: float = 100.0) -> Robot:
    """A robot of one bus."""
    text = f'name = "arm"\nrate_hz = {rate_hz}\n[buses]\nbus = {{ link = "{link}", protocol = "{protocol}" }}\n{body}'
    robot, problems = parse_robot(text)
    assert robot is not None, problems
    return robot


def left_alone(robot: Robot, seconds: float) -> Any:
    """The twin of a robot's device M after it was enabled and its host was gone for so long."""
    with VirtualRobot(robot, rate_hz=100) as virtual:
        virtual.advance(0.3)
        virtual.devices["M"].enable().wait(5)
        virtual.advance(0.3)
        for host in virtual.rig.hosts.values():
            host.close()
        virtual.advance(seconds)
        return virtual.simulation["M"]


@pytest.mark.parametrize("name", DRIVERS)
def test_every_driver_declares_what_its_device_does_without_its_host(name: str) -> None:
    """A driver that says nothing, or not who says so, is refused here."""
    device = load_driver(name).device
    assert device.when_host_is_lost is not Device.when_host_is_lost
    assert device.when_host_is_lost.source


def test_the_table_of_the_running_page_is_that_of_the_declarations() -> None:
    """The page says of each driver what its class declares."""
    found = PLACE.search(RUNNING.read_text())
    assert found is not None
    assert found[0] == table(), f"put this table into {RUNNING.name}:\n{table()}"


JOINT = ' }\n[joints]\nJ = { device = "M" }'
DAMIAO = (
    '[devices]\nM = { driver = "damiao", bus = "bus", model = "4310", credentials = { motor = 1 }' + JOINT
)
ROBSTRIDE = (
    '[devices]\nM = { driver = "robstride", bus = "bus", model = "RS04", credentials = { motor = 1 }%s'
    + JOINT
)
ODRIVE = '[devices]\nM = { driver = "odrive", bus = "bus", credentials = { node = 0 }%s' + JOINT
WATCHED = ', settings = { watchdog_s = 0.3, watchdog_endpoints = [402, 401], firmware = "%s" }'


def test_a_robstride_is_limp_when_its_host_is_gone() -> None:
    """`enable` sets its time-out, 0.1 s at 100 Hz; without a time-out it goes on."""
    robot = arm(ROBSTRIDE % "", protocol="robstride")
    assert left_alone(robot, 0.05).state == "run"
    assert left_alone(robot, 0.15).state == "reset"
    forever = arm(ROBSTRIDE % ", settings = { watchdog_s = 0 }", protocol="robstride")
    assert left_alone(forever, 10.0).state == "run"


def test_a_damiao_is_limp_when_its_host_is_gone() -> None:
    """`enable` sets its time-out; its status says why it is off."""
    assert left_alone(arm(DAMIAO, protocol="damiao"), 0.15).status == "lost_communication"


def test_an_odrive_with_a_watchdog_is_limp_when_its_host_is_gone() -> None:
    """`enable` writes the watchdog under the numbers of the firmware; without them it stays in closed loop."""
    twin = left_alone(arm(ODRIVE % (WATCHED % "0.6.10"), protocol="odrive"), 0.4)
    assert (twin.state, twin.errors) == ("idle", {"watchdog"})
    assert left_alone(arm(ODRIVE % "", protocol="odrive"), 10.0).state == "closed_loop"


def test_an_odrive_of_another_firmware_is_not_written_to() -> None:
    """Numbers of another firmware would be another parameter: it is not enabled."""
    robot = arm(ODRIVE % (WATCHED % "0.6.9"), protocol="odrive")
    with VirtualRobot(robot, rate_hz=100) as virtual:
        virtual.advance(0.3)
        with pytest.raises(
            DeviceError, match=r"M has firmware 0\.6\.10, and its endpoints are those of 0\.6\.9"
        ):
            virtual.devices["M"].enable().wait(5)
        assert virtual.simulation["M"].parameters == {}  # type: ignore[attr-defined]
    with pytest.raises(CallerError, match="watchdog_endpoints go with watchdog_s and firmware"):
        VirtualRobot(arm(ODRIVE % ", settings = { watchdog_endpoints = [1, 2] }", protocol="odrive"))


def test_an_odrive_that_is_stopped_needs_no_feeding() -> None:
    """The watchdog ends with the stop: it is enabled again without an error to be cleared."""
    robot = arm(ODRIVE % (WATCHED % "0.6.10"), protocol="odrive")
    with VirtualRobot(robot, rate_hz=100) as virtual:
        virtual.advance(0.3)
        for _ in range(2):
            virtual.devices["M"].enable().wait(5)
            virtual.advance(1.0)
            assert virtual.rig["J.position"].value == pytest.approx(0.0)
            virtual.devices["M"].disable().wait(5)
            virtual.advance(1.0)
        twin: Any = virtual.simulation["M"]
        assert (twin.errors, twin.watchdog_ns) == (set(), 0)


# ---------------------------------------------------------------------- an end that holds

MIXED = """
name = "mixed"
rate_hz = 100
[buses]
motors = { link = "can", protocol = "damiao" }
drives = { link = "can", protocol = "odrive" }
moteus = { link = "can", protocol = "moteus" }
servos = { link = "serial", protocol = "dynamixel" }
[devices]
D4 = { driver = "damiao", bus = "motors", model = "4310", credentials = { motor = 4 } }
O1 = { driver = "odrive", bus = "drives", credentials = { node = 1 } }
O2 = { driver = "odrive", bus = "drives", credentials = { node = 2 } }
M1 = { driver = "moteus", bus = "moteus", credentials = { id = 1 } }
S5 = { driver = "dynamixel", bus = "servos", model = "XM430-W350", credentials = { id = 5 } }
[joints]
wrist = { device = "D4", gains = { kp = 50, kd = 1 } }
elbow = { device = "O1" }
winch = { device = "O2", command = "speed", type = "continuous" }
base = { device = "M1" }
grip = { device = "S5", zero = 3.1416 }
"""


@controller(rate_hz=100, writes=["wrist", "elbow", "winch", "base", "grip"])
def move(t: float) -> dict[str, float]:
    """Everything a little; the winch turns."""
    return {**dict.fromkeys(("wrist", "elbow", "base", "grip"), 0.1 * t), "winch": 2.0}


def test_an_end_that_holds_leaves_only_what_holds() -> None:
    """A position that a drive goes on with and a servo that holds are left; all that would fall is named, then off."""
    robot, problems = parse_robot(MIXED)
    assert robot is not None, problems
    seen: list[tuple[str, str]] = []
    with run_virtual(robot, [move], at_end="hold") as run:
        run.do("enable")
        assert sorted(run.letting_go) == ["D4", "M1", "O2"]
        twins = run.world.twins

        def note(event: Any) -> None:
            if event.kind == "let go":
                seen.append((event.source, getattr(twins[event.source], "status", "")))

        run.handlers.append(note)
        ended = run.run(0.5)
        assert sorted(ended.held) == ["O1", "S5"]
        assert sorted(ended.let_go) == ["D4", "M1", "O2"]
        assert ended.let_go["M1"] == "brakes its joints, which may then sink, 0.1 s after its host is gone"
        assert ended.not_stopped == {}
        assert ("D4", "enabled") in seen  # before it is switched off
        assert twins["D4"].status == "disabled"
        assert twins["M1"].mode == "stopped"
        assert [twins[name].state for name in ("O1", "O2")] == ["closed_loop", "idle"]


def test_a_motor_without_stiffness_is_not_held() -> None:
    """A MIT motor whose stiffness is 0 gives way, whoever watches."""
    body = DAMIAO.replace(
        "credentials = { motor = 1 }", "credentials = { motor = 1 }, settings = { timeout_s = 0 }"
    )
    with VirtualRobot(arm(body, protocol="damiao"), rate_hz=100) as virtual:
        virtual.advance(0.3)
        virtual.devices["M"].enable().wait(5)
        virtual.advance(0.1)
        assert virtual.devices["M"].lets_go == "has no stiffness, and gives way"
        virtual.rig["J.kp"].set(50.0)
        virtual.advance(0.1)
        assert virtual.devices["M"].lets_go == ""


@pytest.mark.parametrize(
    ("loss", "text"),
    [
        (HostLoss("limp", "x", 0.1), "lets its joints go limp, 0.1 s after its host is gone"),
        (HostLoss("unknown", "x"), "does what nobody knows"),
    ],
)
def test_a_loss_is_said_in_words(loss: HostLoss, text: str) -> None:
    """The text goes behind "without this program it …"."""
    assert str(loss) == text


def test_a_driver_that_declares_nothing_holds_nothing() -> None:
    """What nobody knows is not called held, and counts as without a watchdog."""
    assert Device.when_host_is_lost.does == "unknown"
    assert Device.when_host_is_lost.lacks_watchdog
