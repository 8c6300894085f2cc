"""Ports: wires and gates look the same to the device floor."""

from __future__ import annotations

from typing import Any

import pytest

from aces_bus import Frame
from aces_bus.device import UNKNOWN
from aces_bus.errors import CallerError
from aces_bus.hardware import CanGate, DatagramGate, SimulatedBus
from aces_bus.hardware.ports import port_of
from aces_bus.robot import connect
from aces_bus.robot.rig import simulate
from aces_bus.runtime import VirtualClock
from aces_bus.runtime.loop import Loop
from tests.device.fan import ROBOT, drivers, robot_of


@pytest.mark.slow
def test_a_robot_on_real_gates() -> None:
    """Host and twins, each at a gate of its own, speak over python-can's bus in real time."""
    robot = robot_of(ROBOT)
    options = {"interface": "aces", "channel": "test-ports", "bitrate": 500_000}
    with Loop() as loop:
        twins = simulate(robot, {"line": port_of(CanGate(options), loop)}, load=drivers)
        rig = connect(robot, {"line": port_of(CanGate(options), loop)}, rate_hz=100, load=drivers)
        with twins, rig:
            assert loop.wait(lambda: rig["B.temperature"].value is not UNKNOWN, 5_000_000_000)
            rig["A.left"].set(100.0)
            rig["A.right"].set(100.0)
            assert loop.wait(
                lambda: rig["A.left"].value is not UNKNOWN and rig["A.left"].value > 99, 5_000_000_000
            )
        assert not loop.failures


def test_datagrams_answer_whoever_spoke() -> None:
    """A datagram port without a peer answers the last sender, and says so while there is none."""
    with Loop() as loop:
        server = DatagramGate(("127.0.0.1", 0))
        answering = port_of(server, loop)

        def answer(packet: bytes, now: int) -> None:
            answering.send(packet[::-1])

        answering.open(answer)
        assert not answering.send(b"to nobody")
        heard: list[bytes] = []
        asking = port_of(DatagramGate(peer=server.address), loop)
        asking.open(lambda packet, now: heard.append(packet))
        asking.send(b"abc")
        assert loop.wait(lambda: bool(heard), 5_000_000_000)
        assert heard == [b"cba"]
        asking.close()
        answering.close()


def test_what_a_packet_costs() -> None:
    """A frame costs at most 98 + 24 stuffed bits, ten of its end and the intermission (ISO 11898-1), at the wire's rate."""
    port: Any = port_of(SimulatedBus(VirtualClock(), bitrate=1_000_000))
    assert port.wire_ns(Frame(0x555, bytes.fromhex("5555555555555555"))) == 135_000


def test_what_is_no_bus_is_refused() -> None:
    """A gate needs a loop; anything else is not a bus."""
    with pytest.raises(CallerError, match="needs a Loop"):
        port_of(CanGate({"interface": "aces", "channel": "x"}))
    with pytest.raises(CallerError, match="neither a wire nor a gate"):
        port_of("can0")  # type: ignore[call-overload]
