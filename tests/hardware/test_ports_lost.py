# A port's way of sending is tested without a port.
# pyright: reportPrivateUsage=false
"""What a port does with packets while its bus is lost."""

from __future__ import annotations

from typing import Any

from aces_bus.errors import CallerError
from aces_bus.hardware.ports import _sender
from aces_bus.runtime import VirtualClock


class Gate:
    """A gate that can be lost, or full."""

    state = "open"
    is_full = False

    def __init__(self) -> None:
        self.sent: list[Any] = []

    def send(self, packet: Any, *, report: Any, **how: Any) -> bool:
        if self.is_full:
            raise CallerError("4096 frames wait to be sent")
        self.sent.append(packet)
        if report is not None:
            report("sent", "")
        return True


def test_packets_do_not_wait_for_a_lost_bus() -> None:
    """While a bus is lost, or too much waits, a packet is refused: sent later, it would move a robot. Stops wait."""
    gate: Any = Gate()
    clock: Any = VirtualClock()
    give = _sender(gate, clock)
    fates: list[str] = []

    def send(packet: str, *, urgent: bool = False) -> bool:
        return give(packet, urgent=urgent, report=lambda fate, why: fates.append(fate))

    assert send("a")
    gate.state = "lost"
    assert not send("b")
    assert send("stop", urgent=True)
    gate.state = "open"
    gate.is_full = True
    assert not send("c")
    gate.is_full = False
    assert send("d")
    assert gate.sent == ["a", "stop", "d"]
    assert fates == []  # what became of them is told on the clock's thread
    clock.advance(1)
    assert fates == ["sent"] * 3
