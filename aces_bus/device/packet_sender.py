"""Packets of several frames over a gate, as their receivers allow: for programs that send a message now and then.

1. Handshakes and pauses are `CarriedPort`'s, on a loop of its own; frames leave by the gate, whose limits hold.
2. Nothing leaves but what `send` was asked for, and go-aheads for packets that are said to be ours.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from functools import partial
from types import TracebackType
from typing import Any, Literal, Self

from ..errors import AcesError, CallerError, DeviceError, NoReplyError
from ..frames import Frame
from ..protocol import Variant
from ..runtime.loop import Loop
from .carried_port import CarriedPort
from .port import Left


def _of_others(key: int, data: bytes) -> bool:
    return False


class PacketSender:
    """Sends the frames of messages over a `CanGate` that is open; a packet waits for its receiver's go-aheads, and obeys.

        with CanGate({"interface": "socketcan", "channel": "can0"}) as gate, PacketSender(gate, [uds.variant()]) as sender:
            sender.send(uds.encode("WriteData", ecu=0, identifier=0x123, data=bytes(100)))

    Senders of packets of whose first frame `is_ours(key, data)` holds are let go on, too (`aces_bus.frames.key_of`).
    """

    def __init__(
        self, gate: Any, variants: Sequence[Variant], is_ours: Callable[[int, bytes], bool] = _of_others
    ) -> None:
        self.gate = gate
        self._loop = Loop(f"{gate.name} packets").start()
        self._below = _StartedGate(gate, self._loop)
        self._port = CarriedPort(self._below, variants, is_ours)
        self._loop.call(lambda: self._port.open(lambda packet, instant: None))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End its thread; the gate stays open."""
        self._loop.call(self._port.close)
        self._loop.stop()

    def send(self, frames: Sequence[Frame], *, timeout_s: float = 30.0) -> None:
        """Send what `encode` gave, until all of it has left, and is acknowledged where the transport has that.

        Raises what the gate raises; `CallerError` for frames that are not a packet; `NoReplyError` if the receiver gives no
        go-ahead or acknowledgement in time, `DeviceError` where it cannot take the packet.
        """
        packet = tuple(frames)
        if not packet or not self._port.may_begin(packet):
            raise CallerError("no packet: give all frames that encode gave, in their order")
        over = threading.Event()
        fates: list[tuple[str, str]] = []

        def left(fate: str, why: str) -> None:
            fates.append((fate, why))
            over.set()

        self._below.refusal = None
        taken = self._loop.call(partial(self._port.send, packet, report=left))
        if taken and not over.wait(timeout_s):
            why = f"it has not left after {timeout_s:g} s"
            self._loop.call(
                partial(self._port.cancel, packet, why)
            )  # or it would go on; it may have left just now
        if self._below.refusal is not None:
            raise self._below.refusal
        fate, why = fates[0] if fates else ("dropped", "the bus does not take it")
        if fate != "sent":
            kind = NoReplyError if fate == "expired" else DeviceError
            raise kind(f"{self.gate.name}: the packet was not sent: {why or fate}")


class _StartedGate:
    """A gate that runs already, as a port of a loop."""

    link: Literal["can"] = "can"
    half_duplex = False

    def __init__(self, gate: Any, loop: Loop) -> None:
        self.gate, self.clock, self.name = gate, loop, str(gate.name)
        self._listener: Any = None
        self.refusal: AcesError | None = None

    def open(self, received: Callable[[Any, int], Any]) -> None:
        """Hand over what the gate receives, on the loop."""

        def take(items: list[Any]) -> None:
            self.clock.call_soon(lambda: [received(item.content, item.host_ns) for item in items])

        self._listener = self.gate.listen(take)

    def on_event(self, handler: Callable[[str, str], object]) -> None:
        """Do nothing: events belong to the gate's owner."""

    def send(
        self,
        packet: Any,
        age_ns: int = 0,
        *,
        urgent: bool = False,
        topic: object = None,
        report: Left | None = None,
    ) -> bool:
        """Queue a frame, behind all that were queued before; False, and why in `refusal`, where the gate refuses it."""

        def left(fate: str, why: str) -> None:
            if report is not None:
                self.clock.call_soon(partial(report, fate, why))

        try:
            return bool(self.gate.send(packet, priority=0, report=left))
        except AcesError as error:
            self.refusal = error
            return False

    def wire_ns(self, packet: Any) -> int:
        """Raise: nothing is budgeted here."""
        return 0

    def close(self) -> None:
        """Hand over no more."""
        if self._listener is not None:
            self._listener.stop()


__all__ = ["PacketSender"]
