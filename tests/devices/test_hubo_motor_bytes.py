"""Hubo's motor boards on the wire: every worked example of the facts, sent and received as bytes by driver and twin.

1. Bytes here are written out from the facts (hubo-can.md); none is built by the code under test.
"""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from functools import cache
from math import pi
from typing import Any

import msgspec
import pytest

from aces_bus import Frame, load_robot
from aces_bus.device import Robot
from aces_bus.device.config import DeviceConfig
from aces_bus.errors import FieldError
from aces_bus.hardware import ListeningNode
from aces_bus.protocol import Message
from aces_bus.robot import VirtualRobot, parse_robot
from aces_devices.hubo_motor import driver
from aces_devices.hubo_motor.axis import compliant_duty
from aces_devices.hubo_motor.driver import HuboMotor
from aces_devices.hubo_motor.shapes import SHAPES
from aces_protocols.hubo.spec import hubo


@cache
def made(text: str) -> Robot:
    robot, problems = parse_robot(text, "test.toml")
    assert robot is not None, problems
    return robot


def one_board(board: int, kind: int | str, dialect: str, joints: str = "", settings: str = "{}") -> Robot:
    channels = kind if isinstance(kind, int) else 3
    kinds = f"channels = {channels}" + (f', kind = "{kind}"' if isinstance(kind, str) else "")
    return made(
        f"""
name = "one"
[buses]
can = {{ link = "can", protocol = "hubo", dialect = "{dialect}" }}
[devices]
B = {{ driver = "hubo_motor", bus = "can", credentials = {{ board = {board} }}, {kinds}, settings = {settings} }}
[joints]
{joints}
"""
    )


class Bench:
    """One robot without a tick, its wire recorded."""

    def __init__(self, robot: VirtualRobot) -> None:
        self.robot = robot
        (wire,) = robot.wires.values()
        self.recorder = ListeningNode(wire)

    @property
    def device(self) -> HuboMotor:
        found = self.robot.devices["B"]
        assert isinstance(found, HuboMotor)
        return found

    @property
    def twin(self) -> Any:
        return self.robot.twins["B"]

    def sent(self) -> list[str]:
        """What stood on the wire since the last look."""
        self.robot.advance(0.02)
        told = [f"{f.arbitration_id:03X}#{f.data.hex(' ').upper()}" for f in self.recorder.frames()]
        self.recorder.received.clear()
        return told


@contextmanager
def bench(robot: Robot) -> Generator[Bench]:
    with VirtualRobot(robot, load=lambda _: driver) as virtual:
        yield Bench(virtual)


Board = tuple[int, int | str, str]


def examples() -> dict[Board, list[tuple[Message, Any]]]:
    """The worked examples of the spec that are about motor boards, by number, kind and dialect of a board that has them."""
    found: dict[Board, list[tuple[Message, Any]]] = {}
    for message in hubo.declared:
        kinds = next((c.values for c in message.when if c.key == "channels"), None)
        for example in message.examples:
            board = example.fields.get("board")
            if not isinstance(board, int) or board >= 0x30 or board == 0x0E:
                continue
            for dialect, kind in SHAPES:
                if (not message.dialects or dialect in message.dialects) and (kinds is None or kind in kinds):
                    found.setdefault((board, kind, dialect), []).append((message, example))
                    break
    for pairs in found.values():  # what changes the number comes last
        pairs.sort(key=lambda pair: pair[0].name == "SetBoardNumber")
    return found


EXAMPLES = examples()


def same(value: Any, wanted: Any) -> bool:
    """Whether a record's value is what an example says."""
    if isinstance(wanted, dict):
        return all(same(getattr(value, name), part) for name, part in wanted.items())
    if isinstance(wanted, list) and isinstance(value, int):
        return bool(set(value) == set(wanted))  # type: ignore[call-overload]
    if isinstance(wanted, (list, tuple)):
        return len(value) == len(wanted) and all(same(a, b) for a, b in zip(value, wanted, strict=True))
    if isinstance(wanted, float):
        return bool(value == pytest.approx(wanted))
    return bool(value == wanted)


def play(b: Bench, message: Message, example: Any) -> tuple[list[str], list[Any]]:
    """Have the one end send an example: what stood on the wire, and what the other end read."""
    fields = {name: value for name, value in example.fields.items() if name != "board"}
    host = b.robot.rig.hosts["can"]
    end: Any = b.twin if message.direction == "to device" else b.device
    heard: list[Any] = []
    receive = end.receive

    def note(record: Any, instant: int) -> None:
        heard.append(record)
        receive(record, instant)

    if example.request is not None:
        request = Frame(example.request.identifier or 0, example.request.data)
        host.port.send(request)
        host.scanner.sent(request)
        b.sent()
    end.__dict__["receive"] = note
    if message.direction == "to device":
        b.device.send(message.name, **fields)
    else:
        for ask in (b.device.shape.status, *b.device.shape.encoders):
            if ask is not None and message.name in ask.reply and example.request is None:
                b.device.send(ask.message, **ask.fields)
                b.sent()
        try:
            frame = b.twin.twins.packet(b.twin, message.name, fields)
        except FieldError:  # an example may leave fields out
            frame = Frame(example.packet.identifier or 0, example.packet.data)
        b.twin.send_raw(frame)
    wire = b.sent()
    end.__dict__.pop("receive")
    return wire, heard


@pytest.mark.parametrize("board", EXAMPLES, ids=lambda board: f"{board[2]}-{board[1]}-{board[0]:#04x}")
def test_worked_examples_are_sent_and_received(board: Board) -> None:
    """What the sheet prints is what the sender puts on the wire, and the other end reads the same fields from it."""
    with bench(one_board(*board)) as b:
        b.twin.fault("silent")
        for message, example in EXAMPLES[board]:
            wire, heard = play(b, message, example)
            data = example.packet.data.hex(" ").upper()
            assert f"{example.packet.identifier:03X}#{data}" in wire, message.name
            assert [type(record).__name__ for record in heard] == [message.name]
            for name, value in example.fields.items():
                assert same(getattr(heard[0], name), value), (message.name, name, heard[0])


def test_the_examples_are_there() -> None:
    """All messages of motor boards have one: a missing list would pass unseen."""
    told = {message.name for pairs in EXAMPLES.values() for message, _ in pairs}
    known = {
        m
        for shape in SHAPES.values()
        for ask in (shape.status, shape.current, *shape.encoders)
        if ask
        for m in ask.reply
    }
    known |= {
        m for shape in SHAPES.values() for m in (shape.reference, shape.pwm, shape.pwm_off, shape.home) if m
    }
    assert known <= told


#: Speeds that lead no set-point: each leaves as it was set.
FAST = "max_speed = 1000"
LIMB = f"""
RHY = {{ device = "B", channel = 0, gear = [10, 25], harmonic = 100, encoder = 4000, {FAST}, lower = -1.92, upper = 1.92 }}
RHR = {{ device = "B", channel = 1, gear = [324, 1024], harmonic = 160, encoder = 4000, lower = -0.52, {FAST} }}
"""
HIP = f'RHP = {{ device = "B", channel = 0, gear = [16, 20], harmonic = 160, encoder = 4000, {FAST} }}'


def enabled(b: Bench) -> None:
    b.robot.advance(0.9)
    b.robot.rig.each("enable").wait()
    b.sent()


def test_references_of_two_motors_are_one_frame() -> None:
    """RHY +0.2 rad and RHR −0.05 rad are 010#56 7C 00 E0 3E 80: truncated, sign and magnitude (facts, section 9)."""
    with bench(one_board(0, 2, "D12", LIMB)) as b:
        enabled(b)
        b.robot["RHY.position"].set(0.2)
        b.robot["RHR.position"].set(-0.05)
        assert set(b.sent()) == {"010#56 7C 00 E0 3E 80"}


def test_a_board_of_one_motor_repeats_its_reference() -> None:
    """RHP −0.1 rad is 011#BC 31 80 BC 31 80 (facts, section 9)."""
    with bench(one_board(1, 1, "D12", HIP)) as b:
        enabled(b)
        b.robot["RHP.position"].set(-0.1)
        assert set(b.sent()) == {"011#BC 31 80 BC 31 80"}


@pytest.mark.parametrize(
    ("count", "data"),
    [
        (0, "00 00 00"),
        (1, "01 00 00"),
        (-1, "01 00 80"),
        (12732, "BC 31 00"),
        (-12732, "BC 31 80"),
        (123456, "40 E2 01"),
        (-123456, "40 E2 81"),
        (8388607, "FF FF 7F"),
        (-8388607, "FF FF FF"),
    ],
)
def test_counts_of_a_reference(count: int, data: str) -> None:
    """Sign and magnitude of 24 bits (facts, section 3)."""
    with bench(one_board(1, 1, "D12", HIP)) as b:
        enabled(b)
        b.device.give(b.device.axes[0], count)
        assert b.sent() == [f"011#{data} {data}"]
        assert b.twin.channels[0].reference == count


@pytest.mark.parametrize(("position", "code"), [(0.0, 2047), (0.5, 2373), (-0.5, 1721)])
def test_a_neck_with_the_old_scale(position: float, code: int) -> None:
    """hubo-ach divides a servo's turn by 4095: 0 is 2047, +0.5 rad 2373, −0.5 rad 1721 (facts, section 4)."""
    neck = "\n".join(
        f"{name} = {{ device = 'B', channel = {n}, gear = [1, 1], harmonic = 1, encoder = 4096, zero = {pi}, {FAST} }}"
        for n, name in enumerate(("NKY", "NK1", "NK2"))
    )
    with bench(
        one_board(0x22, "neck", "D12", neck, "{ neck_counts = 4095, filter = 40 }")
    ) as b:  # not of angles
        enabled(b)
        for name in ("NKY", "NK1", "NK2"):
            b.robot[f"{name}.position"].set(position)
        low_high = f"{code & 0xFF:02X} {code >> 8:02X}"
        assert b.sent()[-1] == f"032#{low_high} {low_high} {low_high}"


FINGERS = "\n".join(
    f'RF{n + 1} = {{ device = "B", channel = {n}, gear = [1, 1], harmonic = 256, encoder = 128, command = "duty" }}'
    for n in range(5)
)


def test_fingers_of_d12_are_driven_in_percent() -> None:
    """0, +25, −25, +100 and −100 % are 00 19 99 64 E4 (facts, sections 3 and 5.5)."""
    with bench(one_board(0x24, 5, "D12", FINGERS)) as b:
        enabled(b)
        for number, duty in enumerate((0, 25, -25, 100, -100)):
            b.robot[f"RF{number + 1}.duty"].set(duty)
        assert b.sent()[-1] == "001#24 0D 01 00 19 99 64 E4"


def test_fingers_of_d08_are_driven_in_five_bits() -> None:
    """+4, −4, +15, −15 and 0 are 04 14 0F 1F 00; off is the genuine "right hand off" (facts, sections 0, 3, 5.5)."""
    with bench(one_board(0x24, 5, "D08", FINGERS.replace('"duty"', '"duty", max_duty = 15'))) as b:
        enabled(b)
        for number, duty in enumerate((4, -4, 15, -15, 0)):
            b.robot[f"RF{number + 1}.duty"].set(duty)
        assert b.sent()[-1] == "001#24 0D 01 04 14 0F 1F 00"
        b.device.stop_motion()
        assert b.sent() == ["001#24 0D 00 00 00 00 00 00"]


@pytest.mark.parametrize(
    ("duty", "data"),
    [(5.0, "00 32"), (-5.0, "01 32"), (30.0, "10 2C"), (-30.0, "11 2C"), (100.0, "30 E8"), (-100.0, "31 E8")],
)
def test_fine_duties(duty: float, data: str) -> None:
    """The examples of section 5.5, as the board is told them: a joint is driven up by a negative duty (clockwise)."""
    with bench(one_board(0, 2, "D12", LIMB.replace("lower", 'command = "duty", lower'))) as b:
        enabled(b)
        b.robot["RHY.duty"].set(-duty)
        commands = [frame for frame in b.sent() if frame.startswith("001#00 0D")]  # beside polls and answers
        assert commands[-1] == f"001#00 0D 03 {data} 00 00"
        assert b.robot["RHY.duty"].value == -duty


@pytest.mark.parametrize(
    ("error", "velocity", "gains", "duty"),
    [
        (0.05, 0.0, (80, 0, 8), -40),  # −(10·80·0.05)
        (0.0337, 0.0, (80, 0, 8), -26),  # 26.96 is cut
        (-0.0337, 0.0, (80, 0, 8), 26),
        (0.0337, 0.13, (80, 3, 8), -23),  # 26 − 3: 3.9 is cut by itself
        (1.0, 0.0, (80, 0, 8), -80),  # 8 % at most
        (10.0, 0.0, (80, 0, 200), -1000),
    ],
)
def test_compliant_duties_are_truncated_term_by_term(
    error: float, velocity: float, gains: tuple[float, float, float], duty: int
) -> None:
    """duty = −(10 Kp (ref − pos) − 10 Kd vel), each term cut toward zero, limited to 10 maxPWM (facts, 11.3)."""
    assert compliant_duty(error, velocity, *gains) == duty


#: Section 5.2: the genuine frames of acesHubo's config.ops.
NAME_INFO = """
00 01 0A 0A 0A 84 45 FD|01 01 0A 0A 00 01 00 0A|02 01 0A 14 00 B3 00 0C|03 01 0A 0A 0A A6 A7 DA|04 01 0A 0A 0A 05 76 B0
05 01 0A 0A 00 33 00 0C|06 01 0A 14 00 E8 00 0B|07 01 0A 0A 0A B3 95 60|08 01 0A 0F 05 D2 D8 5A|09 01 0A 05 14 A2 20 C4
0A 01 0A 14 05 CD 49 43|0B 01 0A 05 14 29 1E 97|20 01 0A 0A 0A 0A 00|21 01 0A 0A 05 05 00|22 01 0A 05 05 05 00
23 01 0A 0A 00 9F 00 0A|24 01 0A|25 01 0A
"""


def hubo2(*only: str) -> Robot:
    """The Hubo 2 with its neck, without its sensors; of its joints those that are named, with their boards."""
    from importlib.resources import files

    robot = load_robot(str(files("aces_devices") / "robots" / "hubo2.toml"))

    named = {robot.joints[joint].device for joint in only}

    def kept(device: DeviceConfig) -> DeviceConfig:
        is_wanted = device.driver == "hubo_motor" and (not only or device.name in named)
        return msgspec.structs.replace(device, active=is_wanted)

    devices = {name: kept(device) for name, device in robot.devices.items()}
    joints = {
        name: msgspec.structs.replace(joint, active=devices[joint.device].active)
        for name, joint in robot.joints.items()
    }
    return msgspec.structs.replace(robot, devices=devices, joints=joints)


def test_hubo_2_is_introduced_as_it_was() -> None:
    """Enabling the Hubo 2 sends each board the NameInfo frame that acesHubo sent the robot, and its gains."""
    with VirtualRobot(hubo2(), load=lambda _: driver) as robot:
        recorders = [ListeningNode(wire) for wire in robot.wires.values()]
        robot.advance(0.9)
        robot.rig.each("enable").wait()
        told = {
            frame.data.hex(" ").upper()
            for recorder in recorders
            for frame in recorder.frames()
            if frame.arbitration_id == 1
        }
    wanted = set[str]()
    for line in NAME_INFO.strip().splitlines():
        wanted |= set(line.split("|"))
    assert {frame for frame in told if frame[3:5] == "01"} == wanted
    assert "00 07 C8 00 00 00 F4 01" in told  # section 5.6
    assert {"00 0B 01", "00 0E"} <= told


def test_home_searches_of_hubo_2_are_what_the_robot_was_sent() -> None:
    """Offsets go out high byte first, RWY's with its high bits cut off, as acesHubo sent them (facts, section 5.3)."""
    with VirtualRobot(hubo2("RHY", "REB", "RWY", "RHR"), load=lambda _: driver) as robot:
        recorders = [ListeningNode(wire) for wire in robot.wires.values()]
        jobs = [robot.rig.device(joint).home(joint) for joint in ("RHY", "REB", "RWY")]  # type: ignore[attr-defined]
        for job in jobs:
            job.wait(60)
        jobs = [robot.rig.device("RHR").home("RHR")]  # type: ignore[attr-defined]
        jobs[0].wait(60)
        told = {f.data.hex(" ").upper() for r in recorders for f in r.frames() if f.arbitration_id == 1}
    assert {
        "00 11 11 48 A8 00 00 08",
        "00 11 20 00 00 3A 98 00",
        "09 11 20 00 00 38 80 10",
        "20 11 11 19 40 32 32",
    } <= told


@pytest.mark.parametrize(
    ("board", "kind", "joints", "joint", "frame"),
    [
        (5, 1, HIP, "RHP", "05 11 12 00 00 00 00 00"),
        (0, 2, LIMB, "RHR", "00 11 22 00 00 00 00 00"),
        (0, 2, LIMB, None, "00 11 F2 00 00 00 00 00"),
    ],
)
def test_home_searches_of_d12(board: int, kind: int, joints: str, joint: str | None, frame: str) -> None:
    """The settings are the board's own: channel + 1, or F for all (facts, section 5.4)."""
    with bench(one_board(board, kind, "D12", joints)) as b:
        b.device.home(joint)
        assert f"001#{frame}" in b.sent()


def test_limits_are_written_as_even_counts() -> None:
    """−169999 and 170001 in home tables mean −170000 and 170000, enabled: bit 0 is the flag (facts, section 8)."""
    with bench(one_board(0x23, 1, "D12", HIP)) as b:
        counts = b.device.axes[0].counts
        b.device.set_limits(lower=-169999.5 / counts, upper=170001.5 / counts).wait()
        assert b.sent() == ["001#23 50 03 F2 67 FD FF", "001#23 56 03 10 98 02 00"]


def test_disabling_is_control_off_then_drivers_off() -> None:
    """0x0F, then 0x0B with 0 (facts, section 5.6)."""
    with bench(one_board(0, 2, "D12", LIMB)) as b:
        enabled(b)
        b.device.disable().wait()
        assert b.sent() == ["001#00 0F", "001#00 0B 00"]


def test_enabling_sends_the_present_position_before_it_switches() -> None:
    """Reference first, then the FET switch, then control on (facts, sections 5.6 and 11)."""
    with bench(one_board(0, 2, "D12", LIMB)) as b:
        b.robot.advance(0.9)
        b.device.enable().wait()
        sent = [
            frame for frame in b.sent() if not frame.startswith(("060", "150")) and frame[-2:] not in ("02",)
        ]
        assert sent == ["001#00 03 00", "010#00 00 00 00 00 00", "001#00 0B 01", "001#00 0E"]
