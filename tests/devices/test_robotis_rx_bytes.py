"""RX servos as bytes: every worked example of the manual goes over the wire both ways, and recordings are repeated."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus import open_recording
from aces_bus.robot import VirtualRobot, parse_robot
from aces_devices.robotis_rx import driver
from aces_devices.robotis_rx.driver import STEP
from aces_protocols.robotis.spec import BROADCAST


class Line:
    """Servos on a line without ticks, and what each end says."""

    def __init__(self, *ids: int, baud: int = 1_000_000, joints: str = "") -> None:
        devices = "\n".join(
            f'S{n} = {{ driver = "robotis_rx", bus = "line", credentials = {{ id = {n} }} }}' for n in ids
        )
        text = f"""
            name = "line"
            [buses]
            line = {{ link = "serial", protocol = "robotis", baud = {baud} }}
            [devices]
            {devices}
            [joints]
            {joints}
        """
        robot, problems = parse_robot(text)
        assert robot is not None, problems
        self.robot = VirtualRobot(robot, load={"robotis_rx": driver}.__getitem__).open()
        self.robot.advance(0.5)  # the table is read once at the start
        self.devices, self.twins = self.robot.devices, self.robot.twins
        self.host = self.robot.rig.hosts["line"]
        self.asked, self.answered = bytearray(), bytearray()
        self._tap(self.host, self.asked)
        self._tap(self.robot.simulation.buses["line"], self.answered)

    def _tap(self, station: Any, said: bytearray) -> None:
        """Note what a station says, where it says it: at its port."""
        send: Callable[..., bool] = station.port.send

        def noted(packet: bytes, *how: Any, **more: Any) -> bool:
            said.extend(packet)
            return send(packet, *how, **more)

        station.port.send = noted

    def said(self) -> tuple[str, str]:
        """What was asked and what was answered since, as the manual prints it."""
        self.robot.advance(0.1)
        both = self.asked.hex(" ").upper(), self.answered.hex(" ").upper()
        self.asked.clear()
        self.answered.clear()
        return both


def test_the_examples_of_one_servo() -> None:
    """Ping, read, write, whole table, alarms: request and answer, byte by byte."""
    line = Line(1)
    device, twin = line.devices["S1"], line.twins["S1"]
    ok = "FF FF 01 02 00 FC"
    assert device.ping().wait() == []
    assert line.said() == ("FF FF 01 02 01 FB", ok)
    device.write("led", 1).wait()
    assert line.said() == ("FF FF 01 04 03 19 01 DD", ok)
    device.write("goal_position", 502, raw=True).wait()
    assert line.said() == ("FF FF 01 05 03 1E F6 01 E1", ok)
    twin.fault("hot", 32)
    assert device.read("present_temperature").wait() == 32
    assert line.said() == ("FF FF 01 04 02 2B 01 CC", "FF FF 01 03 00 20 DB")
    table = device.read_all(raw=True).wait()
    asked, answered = line.said()
    assert asked == "FF FF 01 04 02 00 32 C6"
    assert bytes.fromhex(answered)[5:-1] == bytes(twin.table)
    assert table["goal_position"] == 502
    twin.fault("hot")
    twin.fault("overload")
    assert set(device.ping().wait()) == {"overheating", "overload"}
    assert line.said()[1] == "FF FF 01 02 24 D8"


def test_the_examples_of_many() -> None:
    """One SyncWrite for two servos; RegWrite to one and Action to all; an id given by broadcast, unanswered."""
    line = Line(71, 96, joints="\n".join(f'J{n} = {{ device = "S{n}", max_speed = 1000 }}' for n in (71, 96)))
    for number, goal in ((71, 528), (96, 512)):
        line.devices[f"S{number}"]["position"].set(goal * STEP)
    line.robot.advance(0.1)
    line.said()  # asked where they are: what they do next depends on that
    for number, goal in ((71, 528), (96, 512)):
        line.devices[f"S{number}"]["position"].set(goal * STEP)
    asked, answered = line.said()
    assert {one.strip() for one in asked.split("FF FF ")[1:]} == {"FE 0A 83 1E 02 47 10 02 60 00 02 99"}
    assert answered == ""
    assert (line.twins["S71"]["goal_position"], line.twins["S96"]["goal_position"]) == (528, 512)

    line = Line(0)
    device, twin = line.devices["S0"], line.twins["S0"]
    device.hold_back("goal_position", 0).wait()
    assert line.said() == ("FF FF 00 05 04 1E 00 00 D8", "FF FF 00 02 00 FD")
    assert device.read("registered_instruction").wait() == 1
    assert twin["goal_position"] != 0
    line.said()
    device.act(everybody=True)
    assert line.said() == ("FF FF FE 02 05 FA", "")
    assert twin["goal_position"] == 0
    device.send("Write", id=BROADCAST, start=3, data=b"\x01")
    assert line.said() == ("FF FF FE 04 03 03 01 F6", "")
    assert twin["id"] == 1


def test_the_joint_of_the_example() -> None:
    """Zero 2.605 rad and direction −1 are in the set-point that stands on the wire: +0.5 rad is 019B."""
    text = """
        name = "joint"
        [buses]
        line = { link = "serial", protocol = "robotis" }
        [devices]
        S71 = { driver = "robotis_rx", bus = "line", credentials = { id = 71 } }
        [joints]
        RSR = { device = "S71", zero = 2.605, direction = -1, max_speed = 1000 }
    """
    robot, _ = parse_robot(text)
    assert robot is not None
    with VirtualRobot(robot, load={"robotis_rx": driver}.__getitem__) as virtual:
        virtual.advance(0.1)
        heard = bytearray()
        virtual.wires["line"].attach("ear", lambda data, now: heard.extend(data))
        virtual["RSR.position"].set(0.5)
        virtual.advance(0.1)
        # Behind the question where it is.
        assert bytes(heard[:-1])[-10:].hex(" ") == "ff ff fe 07 83 1e 02 47 9b 01"


def test_checksums_that_the_manual_prints_wrongly() -> None:
    """Its worked checksum is DC, not DD: the servo refuses what is printed. An answer that ends in FD is malformed here."""
    line = Line(1)
    twin = line.twins["S1"]
    printed, right = bytes.fromhex("FF FF 01 05 03 0C 64 AA DD"), bytes.fromhex("FF FF 01 05 03 0C 64 AA DC")
    line.host.port.send(printed)
    assert line.said()[1] == "FF FF 01 02 10 EC"
    assert (twin["lowest_voltage"], twin["highest_voltage"]) == (60, 240)
    line.host.port.send(right)
    assert line.said()[1] == "FF FF 01 02 00 FC"
    assert (twin["lowest_voltage"], twin["highest_voltage"]) == (0x64, 0xAA)
    line.robot.simulation.buses["line"].port.send(bytes.fromhex("FF FF 01 02 00 FD"))
    line.robot.advance(0.1)
    assert line.host.unknown["malformed: checksum"] == 1


@pytest.mark.parametrize(
    ("request_", "answer"),
    [
        ("FF FF 01 02 01 FC", ""),  # a Ping with a wrong checksum is not answered
        ("FF FF 01 04 02 2B 01 CD", "FF FF 01 02 10 EC"),  # a Read is: checksum
        ("FF FF 01 02 07 F5", "FF FF 01 02 40 BC"),  # no such instruction
        ("FF FF 01 02 05 F7", "FF FF 01 02 40 BC"),  # Action, and nothing was held back
        ("FF FF 01 04 02 2B 0A C3", "FF FF 01 02 08 F4"),  # a Read beyond the table: range
        ("FF FF 01 04 03 19 02 DC", "FF FF 01 02 08 F4"),  # LED 2
        ("FF FF 01 04 03 2B 20 AC", "FF FF 01 02 08 F4"),  # present temperature can only be read
        ("FF FF 01 04 03 25 01 D1", "FF FF 01 02 08 F4"),  # nor its upper half
        ("FF FF 01 04 03 1F 03 D5", "FF FF 01 02 02 FA"),  # the upper half of a goal: 768 and what was there
        ("FF FF 01 05 03 1E 90 03 45", "FF FF 01 02 02 FA"),  # a goal beyond the angle limit
        ("FF FF FE 02 01 FE", "FF FF 01 02 00 FC"),  # a Ping to everybody is answered
        ("FF FF FE 04 02 2B 01 CF", ""),  # a Read to everybody is not
        ("FF FF 02 04 02 2B 01 CB", ""),  # another servo's
    ],
)
def test_what_a_servo_answers(request_: str, answer: str) -> None:
    """Each error bit, and who is not answered."""
    line = Line(1)
    line.twins["S1"]["ccw_angle_limit"] = 700
    line.host.port.send(bytes.fromhex(request_))
    assert line.said()[1] == answer


@given(st.lists(st.binary(min_size=1, max_size=300), max_size=4), st.booleans())
def test_no_bytes_stop_a_line(pieces: list[bytes], framed: bool) -> None:
    """Whatever stands on the line, from either side, driver and twin go on."""
    line = Line(1)
    for piece in pieces:
        if framed:
            body = bytes((1, min(len(piece), 250) + 1)) + piece[:250]
            piece = b"\xff\xff" + body + bytes((~sum(body) & 0xFF,))
        line.host.port.send(piece)
        line.robot.simulation.buses["line"].port.send(piece)
        line.robot.advance(0.1)
    twin = line.twins["S1"]
    assert len(twin.table) == 50
    assert twin["goal_position"] <= 1023


@pytest.mark.parametrize("level", [0, 1, 2])
def test_what_a_servo_answers_at_each_level(level: int) -> None:
    """Ping always, Read from level 1, all else at level 2."""
    line = Line(1)
    line.twins["S1"]["status_return_level"] = level
    answers: list[bool] = []
    for request in (
        "FF FF 01 02 01 FB",
        "FF FF 01 04 02 2B 01 CC",
        "FF FF 01 04 03 19 01 DD",
        "FF FF 01 05 04 1E 00 01 D6",
        "FF FF 01 02 05 F7",
        "FF FF 01 02 06 F6",
    ):
        line.host.port.send(bytes.fromhex(request))
        answers.append(bool(line.said()[1]))
    assert answers == [True, level >= 1, *(level == 2,) * 4]


def test_the_return_delay_is_kept() -> None:
    """From the end of a request to the begin of its answer: register 0x05, in steps of 2 µs."""
    line = Line(1)
    device = line.devices["S1"]
    for number in (0, 1, 250, 254):
        line.twins["S1"]["return_delay"] = number
        ticket = device.ask("Ping", reply="Status")
        ticket.wait()
        assert ticket.latency_ns == 12 * 10_000 + number * 2_000


def test_what_survives_power_off() -> None:
    """EEPROM stays, RAM is at its defaults, the torque limit is the greatest torque, and the lock is open."""
    line = Line(1)
    device, twin = line.devices["S1"], line.twins["S1"]
    device.write("max_torque", 800, raw=True, confirm=True).wait()
    device.write("punch", 100).wait()
    device.write("lock", 1).wait()
    line.said()
    line.host.port.send(bytes.fromhex("FF FF 01 04 03 05 00 F2"))  # return delay 0, locked
    assert line.said()[1] == "FF FF 01 02 08 F4"
    twin.reboot()
    assert (twin["max_torque"], twin["torque_limit"], twin["punch"], twin["lock"]) == (800, 800, 32, 0)
    assert (twin["return_delay"], twin["id"], twin["torque_enable"]) == (250, 1, 0)


# ---------------------------------------------------------------------- recordings


def _bytes(file: Path) -> bytes:
    with open_recording(str(file), link="serial") as capture:
        return b"".join(bytes(chunk.data) for chunk in capture)


@pytest.mark.shared
def test_a_recorded_table_is_answered_byte_by_byte(shared_captures: Path) -> None:
    """A twin with the recorded servo's table says what the servo said; the driver asks as the vendor's program did."""
    folder = shared_captures / "robotis"
    status = (folder / "ctrl_tbl_read.from-servo.bin").read_bytes()
    line = Line(1, baud=57_600)
    line.twins["S1"].load_table(status[5:55])
    line.devices["S1"].read_all().wait()
    line.robot.advance(0.3)
    table = line.devices["S1"].read_all().wait()
    line.robot.advance(0.3)
    assert bytes(line.asked) == (folder / "ctrl_tbl_read.to-servo.bin").read_bytes()
    assert bytes(line.answered) == status
    assert (table["model_number"], table["present_temperature"]) == ("RX-10", 37)
    assert table["present_voltage"] == pytest.approx(11.1)


@pytest.mark.shared
def test_a_recorded_session_is_repeated(shared_captures: Path) -> None:
    """The goals of the recording, given to the driver, are its bytes; the twin's answers are the servo's."""
    folder = shared_captures / "robotis"
    asked = _bytes(folder / "positioning.to-servo.dxconf.txt")
    line = Line(1)
    for goal in (502, 297, 737, 1023, 512, 205, 819, 512, 256, 512, 768, 338):
        line.devices["S1"].write("goal_position", goal, raw=True).wait()
    assert bytes(line.asked) == asked
    assert bytes(line.answered) == (folder / "positioning.from-servo.bin").read_bytes()
