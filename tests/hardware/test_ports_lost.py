"""What a port does with words while its bus is lost."""

from __future__ import annotations

from typing import Any

from aces_bus.errors import CallerError
from aces_bus.hardware.ports import _sender


class Gate:
    """A gate that can be lost, or full."""

    state = "open"
    is_full = False

    def __init__(self) -> None:
        self.sent: list[Any] = []

    def send(self, word: Any) -> None:
        if self.is_full:
            raise CallerError("4096 frames wait to be sent")
        self.sent.append(word)


def test_words_do_not_wait_for_a_lost_bus() -> None:
    """While a bus is lost, or too much waits, a word is refused: sent later, an old set-point would move a robot."""
    gate: Any = Gate()
    send = _sender(gate)
    assert send("a")
    gate.state = "lost"
    assert not send("b")
    gate.state = "open"
    gate.is_full = True
    assert not send("c")
    gate.is_full = False
    assert send("d")
    assert gate.sent == ["a", "d"]
