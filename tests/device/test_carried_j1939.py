"""Packets of J1939 to all: devices and twins send them with pauses."""

from __future__ import annotations

from itertools import pairwise

from aces_bus.hardware import ListeningNode
from aces_bus.robot import VirtualRobot
from tests.device.truck import FAULT, LOAD, robot_of_unit
from tests.specs.j1939_long import j1939_long


def test_a_twin_says_a_packet_to_all() -> None:
    """50 ms are between the end of one frame and the next one, and the host's device has what it says."""
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
    # They are recorded at their ends: a frame of 29 bits and 8 bytes takes 131 to 160 bits.
    assert all(50_524_000 <= pause <= 50_640_000 for pause in pauses_ns), pauses_ns


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
