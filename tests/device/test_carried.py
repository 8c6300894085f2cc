"""Devices and twins whose messages take several frames: asked and answered with flow control, in virtual time."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import pytest
from construct import Byte, Const, GreedyBytes, Struct

from aces_bus import Frame, load_protocol
from aces_bus.device import Device, Driver, PacketSender, Twin, on
from aces_bus.errors import CallerError, NoReplyError
from aces_bus.hardware import ListeningNode
from aces_bus.protocol import IdField, IsoTp, Protocol, Transport
from aces_bus.robot import VirtualRobot, connect, parse_robot
from tests.device.ecu import LOAD, robot_of_ecu


def car() -> VirtualRobot:
    return VirtualRobot(robot_of_ecu(), load=LOAD, rate_hz=20)


def say(robot: VirtualRobot, frame: Frame) -> None:
    """Another node sends a frame."""
    port = robot.ports("other")["line"]
    port.open(lambda packet, instant: None)
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
        ticket = robot.devices["A"].send("Write", what=2, data=bytes(40))
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
        robot.devices["A"].send("Write", what=2, data=bytes(38))
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


def behind_one_identifier() -> VirtualRobot:
    """Two units that are asked by one identifier, and told apart by the address in its frames."""
    units = Protocol("units", link="can")
    Unit = IdField("unit", range(0x10, 0x20))
    carrier = IsoTp(
        addressing="extended",
        to_device=0x6F1,
        device_address=Unit,
        from_device=0x600 + Unit,
        tester_address=0xF1,
    )
    write = units.message(
        "Write",
        transport=carrier,
        direction="to device",
        prefix=Struct("unit" / Byte, "service" / Byte),
        match={"service": 0x2E},
        payload=Struct("data" / GreedyBytes),
    )
    units.message(
        "Written",
        transport=carrier,
        direction="from device",
        reply_to=write,
        payload=Struct(Const(b"\xf1\x6e"), "data" / GreedyBytes),
    )

    class UnitDevice(Device):
        """Only asked."""

        protocol = units

    class UnitTwin(Twin):
        """Answers with what was written."""

        protocol = units

        @on("Write")
        def write(self, request: Any) -> None:
            self.reply("Written", data=request.data[::-1])

    text = """
    name = "car"
    [buses]
    line = { link = "can", protocol = "units" }
    [devices]
    A = { driver = "unit", bus = "line", credentials = { unit = 0x12 } }
    B = { driver = "unit", bus = "line", credentials = { unit = 0x18 } }
    """
    robot, problems = parse_robot(text)
    assert robot is not None, problems
    driver = Driver("unit", UnitDevice, UnitTwin, text, doc="a unit", source="invented for tests")
    return VirtualRobot(robot, load={"unit": driver}.__getitem__, rate_hz=20)


def test_extended_addresses_have_flow_control() -> None:
    """Long packets both ways at once: each go-ahead has the address of who is let go on, and steers no other's packet."""
    with behind_one_identifier() as robot:
        recorder = ListeningNode(robot.wires["line"])
        sent = {"A": bytes(range(40)), "B": bytes(range(100, 140))}
        asked = {
            name: robot.devices[name].ask("Write", reply="Written", timeout_s=1.0, data=data)
            for name, data in sent.items()
        }
        robot.advance(1.0)
        for name, ticket in asked.items():
            assert ticket.result is not None, ticket.error
            assert ticket.result.data == sent[name][::-1]
        steering = [(f.arbitration_id, f.data[0]) for f in recorder.frames() if f.data[1:2] == b"\x30"]
        assert sorted(steering) == [(0x612, 0xF1), (0x618, 0xF1), (0x6F1, 0x12), (0x6F1, 0x18)]


def test_a_go_ahead_of_another_unit_is_none() -> None:
    """A packet to A does not go on because B says so."""
    with behind_one_identifier() as robot:
        robot.twins["A"].power(False)
        robot.twins["B"].power(False)
        ticket = robot.devices["A"].send("Write", data=bytes(40))
        robot.advance(0.1)
        recorder = ListeningNode(robot.wires["line"])
        say(robot, Frame(0x618, bytes.fromhex("F1 30 00 00")))
        robot.advance(0.1)
        assert [f.arbitration_id for f in recorder.frames()] == [0x618]
        robot.advance(2.0)
        assert "no go-ahead in time" in str(ticket.error)


@dataclass(frozen=True)
class InFours(Transport):
    """Pieces of seven bytes, at most four behind a go-ahead; all of them are acknowledged, or only let go on."""

    is_thanked: bool = True
    modulo: int = field(default=128, init=False)
    kinds: tuple[Any, ...] = field(
        default=(
            Transport.Kind(
                "first",
                "opening",
                ((Transport.Number(0), 0x80),),
                head=3,
                size=Transport.Number(1, size=2),
                least=6,
            ),
            Transport.Kind("control", "go on", ((Transport.Number(0), 0x81),)),
            Transport.Kind("control", "thanks", ((Transport.Number(0), 0x82),)),
            Transport.Kind(
                "single",
                "short",
                ((Transport.Number(0), 0x83),),
                head=2,
                size=Transport.Number(1),
                least=1,
                most=5,
            ),
            Transport.Kind("next", "piece", number=Transport.Number(0)),
        ),
        init=False,
    )

    def go_ahead(self, key: int, data: bytes, start: int = 1, frames: int = 0) -> tuple[int, bytes] | None:
        return (key ^ 1, bytes([0x81, start, min(frames or 4, 4)])) if data[0] == 0x80 else None

    def acknowledgement(self, key: int, data: bytes) -> tuple[int, bytes] | None:
        return (key ^ 1, b"\x82") if self.is_thanked and data[0] == 0x80 else None

    def steering(self, key: int, data: bytes) -> Any:
        if data[0] == 0x81:
            return Transport.Steering("on", key ^ 1, frames=data[2], start=data[1])
        return Transport.Steering("done", key ^ 1) if data[0] == 0x82 else None


@pytest.mark.parametrize("is_thanked", [True, False])
def test_a_transport_of_ones_own_has_a_handshake(is_thanked: bool) -> None:
    """Blocks of four, asked for one behind the other, both ways; with an acknowledgement, or without."""
    own = Protocol("own", link="can")
    carrier = InFours(is_thanked=is_thanked, timeout_s=0.1)
    for name, number, direction in (("Put", 0x240, "to device"), ("Got", 0x241, "from device")):
        own.message(
            name,
            transport=carrier,
            id=number,
            direction="to device" if direction == "to device" else "from device",
            payload=Struct("data" / GreedyBytes),
        )

    class OwnDevice(Device):
        """Only asked."""

        protocol = own

    class OwnTwin(Twin):
        """Gives back what was put."""

        protocol = own

        @on("Put")
        def put(self, request: Any) -> None:
            self.reply("Got", data=request.data[::-1])

    text = """
    name = "own"
    [buses]
    line = { link = "can", protocol = "own" }
    [devices]
    A = { driver = "own", bus = "line" }
    """
    robot, problems = parse_robot(text)
    assert robot is not None, problems
    driver = Driver("own", OwnDevice, OwnTwin, text, doc="its own", source="invented for tests")
    with VirtualRobot(robot, load={"own": driver}.__getitem__) as made:
        recorder = ListeningNode(made.wires["line"])
        data = bytes(range(65))
        ticket = made.devices["A"].ask("Put", reply="Got", timeout_s=1.0, data=data)
        made.advance(0.5)
        assert ticket.result is not None, ticket.error
        assert ticket.result.data == data[::-1]
        first = [f.data[0] for f in recorder.frames() if f.arbitration_id == 0x240 or f.data[0] >= 0x80]
        expected = [0x80, 0x81, 1, 2, 3, 4, 0x81, 5, 6, 7, 8, 0x81, 9, *([0x82] * is_thanked), 0x80]
        assert first[: len(expected)] == expected
        # A go-ahead that does not come: the packet is given up on both sides.
        made.twins["A"].power(False)
        lost = made.devices["A"].send("Put", data=data)
        made.advance(0.5)
        assert "gave no go-ahead in time" in str(lost.error)


class PickyGate:
    """A gate that is open, and refuses its first frame."""

    name = "picky"

    def __init__(self) -> None:
        self.taken: list[Frame] = []
        self.refused = 0

    def listen(self, take: Any) -> Any:
        self.take = take
        return SimpleNamespace(stop=lambda: None)

    def send(self, frame: Frame, *, priority: int, report: Any) -> bool:
        if not self.refused:
            self.refused += 1
            raise CallerError("picky: not this one")
        self.taken.append(frame)
        if report is not None:
            report("sent", "")
        return True


def test_a_refusal_is_of_one_packet() -> None:
    """What the gate refuses raises; the next packet is sent as if that had not been."""
    gate = PickyGate()
    uds = load_protocol("uds")
    frames = uds.encode("TesterPresent", ecu=0, none=0, suppress=0)
    with PacketSender(gate, [uds.variant()]) as sender:
        with pytest.raises(CallerError, match="not this one"):
            sender.send(frames)
        sender.send(frames)
    assert len(gate.taken) == 1


def test_a_packet_that_is_given_up_does_not_go_on() -> None:
    """A go-ahead that comes after the sender's patience is over leads to nothing; the next packet leaves."""
    gate = PickyGate()
    gate.refused = 1
    uds = load_protocol("uds")
    go_on = SimpleNamespace(content=Frame(0x7E8, bytes.fromhex("300000")), host_ns=0)
    with PacketSender(gate, [uds.variant()]) as sender:
        with pytest.raises(NoReplyError, match=r"was not sent: it has not left after 0\.05 s"):
            sender.send(uds.encode("WriteData", ecu=0, identifier=0x110, data=bytes(40)), timeout_s=0.05)
        gate.take([go_on])
        sender.send(uds.encode("TesterPresent", ecu=0, none=0, suppress=0))
    assert [frame.data[:1].hex() for frame in gate.taken] == ["10", "02"]
