"""Devices and twins whose messages take several frames: asked and answered with flow control, in virtual time."""

from __future__ import annotations

import pytest

from aces_bus.frames import Frame
from aces_bus.hardware import ListeningNode
from aces_bus.robot import VirtualRobot, connect
from tests.device.ecu import LOAD, robot_of_ecu


def car() -> VirtualRobot:
    return VirtualRobot(robot_of_ecu(), load=LOAD, rate_hz=20)


def say(robot: VirtualRobot, frame: Frame) -> None:
    """Another node sends a frame."""
    port = robot.ports("other")["line"]
    port.open(lambda word, instant: None)
    port.send(frame)


def test_a_long_answer_is_polled() -> None:
    """The twin sends its first frame, waits for the host's flow control, and goes on; the signal has the value."""
    with car() as robot:
        recorder = ListeningNode(robot.wires["line"])
        robot.advance(0.2)
        assert robot["A.speed"].value == 7
        frames = [(f.arbitration_id, f.data[:1].hex()) for f in recorder.frames()][:8]
        assert frames[:3] == [(0x7E1, "03"), (0x7E9, "10"), (0x7E1, "30")]
        assert [first for _, first in frames[3:8]] == ["21", "22", "23", "24", "25"]


def test_a_long_message_is_written() -> None:
    """The host waits for the twin's flow control; the ticket ends with the answer."""
    with car() as robot:
        ticket = robot.devices["A"].ask(
            "Write", reply="Written", timeout_s=0.5, what=2, data=bytes(range(200))
        )
        robot.advance(0.5)
        assert ticket.result is not None, (ticket.state, ticket.error)
        assert ticket.result.what == 2
        assert robot.twins["A"].written == bytes(range(200))


def test_without_flow_control_it_fails_and_says_so() -> None:
    """Nobody lets it go on: the packet is given up after its time-out, and the ticket says why."""
    with car() as robot:
        robot.twins["A"].power(False)
        recorder = ListeningNode(robot.wires["line"])
        ticket = robot.devices["A"].tell("Write", what=2, data=bytes(40))
        robot.advance(2.0)
        assert "no go-ahead in time" in str(ticket.error)
        firsts = [f for f in recorder.frames() if f.data[:1] == b"\x10"]
        assert len(firsts) == 1


def consecutive(recorder: ListeningNode) -> int:
    """How many frames of a packet to the ECU came."""
    return sum(f.arbitration_id == 0x7E1 and f.data[0] >> 4 in (1, 2) for f in recorder.frames())


@pytest.mark.parametrize(
    ("control", "sent"),
    [("30 02 00", 3), ("30 00 0A", 6), ("32 00 00", 1), ("31 00 00", 1)],
    ids=["two frames", "all", "no room", "wait"],
)
def test_flow_control_is_obeyed(control: str, sent: int) -> None:
    """So many frames as the receiver allows, with the time between them that it wants; overflow ends the packet."""
    with car() as robot:
        robot.twins["A"].power(False)
        recorder = ListeningNode(robot.wires["line"])
        robot.devices["A"].tell("Write", what=2, data=bytes(38))
        robot.advance(0.01)
        say(robot, Frame(0x7E9, bytes.fromhex(control)))
        robot.advance(0.025)
        early = consecutive(recorder)
        robot.advance(0.5)
        late = consecutive(recorder)
        assert late == sent
        assert (early < late) is control.endswith("0A")


def test_a_passive_host_answers_nothing() -> None:
    """Who only listens gives no go-ahead."""
    with car() as robot:
        robot.rig.close()
        looker = connect(robot.robot, robot.ports("looker"), rate_hz=20, passive=True, load=LOAD)
        looker.open()
        recorder = ListeningNode(robot.wires["line"])
        say(robot, Frame(0x7E9, bytes.fromhex("10 24 62 00 01 00 07 00")))
        robot.advance(0.5)
        assert not [f for f in recorder.frames() if f.arbitration_id == 0x7E1]
