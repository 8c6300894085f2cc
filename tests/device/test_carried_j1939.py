"""Packets of J1939: devices and twins send those to all by themselves, with pauses; those to one address do not leave."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

from aces_bus.device.carried_port import CarriedPort
from aces_bus.frames import message_to_frame
from aces_bus.hardware import ListeningNode
from aces_bus.robot import VirtualRobot
from tests.device.truck import FAULT, LOAD, robot_of_unit
from tests.specs.j1939_long import j1939_long


class QuietPort:
    """A port that notes what leaves."""

    link, name, half_duplex, clock = "can", "truck", False, None

    def __init__(self) -> None:
        self.left: list[Any] = []

    def send(self, packet: Any, age_ns: int = 0, **how: Any) -> bool:
        """Everything leaves."""
        self.left.append(packet)
        return True


def test_packets_to_one_address_do_not_leave_and_short_ones_do() -> None:
    """The reason is in the report."""
    below: Any = QuietPort()
    port = CarriedPort(below, [j1939_long.variant()], lambda key, data: True)
    said: list[tuple[str, str]] = []
    for size in (20, 8):
        messages = j1939_long.encode("Proprietary", priority=6, source=1, destination=5, data=bytes(size))
        packet = tuple(map(message_to_frame, messages))
        assert port.send(packet, report=lambda *fate: said.append(fate)) == (size == 8)
    assert [frame.arbitration_id for frame in below.left] == [0x18EF0501]
    why = "J1939 transport: a packet to one address takes a handshake, which devices do not keep"
    assert said == [("dropped", why)]
    assert port.failed == 1


def test_a_twin_says_a_packet_to_all() -> None:
    """Its frames are 50 ms apart, and the host's device has what it says."""
    with VirtualRobot(robot_of_unit(), load=LOAD, rate_hz=20) as robot:
        recorder = ListeningNode(robot.wires["line"])
        robot.advance(1.25)
        assert robot["A.lamps"].value == 7
    instants, frames = zip(*recorder.received, strict=True)
    assert [(frame.arbitration_id, frame.data[0]) for frame in frames] == [
        (0x18ECFF10, 32),
        *((0x1CEBFF10, number) for number in (1, 2, 3)),
    ]
    pauses_ns = [after - before for before, after in pairwise(instants)]
    # They are recorded at their ends, and stuff bits make some longer.
    assert all(abs(pause - 50_000_000) < 100_000 for pause in pauses_ns), pauses_ns


def test_a_device_says_packets_to_all_one_behind_the_other() -> None:
    """Two groups at once, of two priorities: data frames do not say which they are of, so the second waits."""
    with VirtualRobot(robot_of_unit(), load=LOAD, rate_hz=20) as robot:
        recorder = ListeningNode(robot.wires["line"])
        tickets = [
            robot.devices["A"].send("ActiveFaults", priority=priority, lamps=priority, faults=[FAULT] * 2)
            for priority in (6, 3)
        ]
        robot.advance(0.8)
        scanner = j1939_long.scanner(include_unknown=True)
        records = scanner.feed(list(recorder.frames()))
        assert [ticket.state for ticket in tickets] == ["done", "done"]
        assert [record.lamps for record in records] == [6, 3]
        assert (scanner.counts.decoded, scanner.counts.total) == (6, 6)
        assert robot.twins["A"].noted.lamps == 3


def test_a_device_says_why_a_packet_to_one_address_does_not_leave() -> None:
    """The ticket fails with the reason."""
    with VirtualRobot(robot_of_unit(), load=LOAD, rate_hz=20) as robot:
        ticket = robot.devices["A"].send("Proprietary", priority=6, destination=5, data=bytes(20))
        robot.advance(0.2)
        assert "takes a handshake, which devices do not keep" in str(ticket.error)
