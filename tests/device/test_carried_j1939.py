"""Packets of J1939 take a handshake, or pauses, that devices do not keep: they do not leave, and their sender knows."""

from __future__ import annotations

from typing import Any

from aces_bus.device.carried_port import CarriedPort
from aces_bus.frames import message_to_frame
from tests.specs.j1939_long import j1939_long


class QuietPort:
    """A port that notes what leaves."""

    link, name, half_duplex, clock = "can", "truck", False, None

    def __init__(self) -> None:
        self.left: list[Any] = []

    def send(self, word: Any, age_ns: int = 0, **how: Any) -> bool:
        """Everything leaves."""
        self.left.append(word)
        return True


def test_long_packets_do_not_leave_and_short_ones_do() -> None:
    """To one and to all; the reason is in the report."""
    below: Any = QuietPort()
    port = CarriedPort(below, [j1939_long.variant()], lambda key, data: True)
    said: list[tuple[str, str]] = []
    for size, destination in ((20, 5), (20, 0xFF), (8, 5)):
        words = j1939_long.encode(
            "Proprietary", priority=6, source=1, destination=destination, data=bytes(size)
        )
        word = tuple(map(message_to_frame, words))
        assert port.send(word, report=lambda *fate: said.append(fate)) == (size == 8)
    assert [frame.arbitration_id for frame in below.left] == [0x18EF0501]
    assert (
        said
        == [("dropped", "J1939 transport: it takes pauses, or a handshake, that devices do not keep")] * 2
    )
    assert port.failed == 2
