"""Packets of J1939 to one address: the handshake of RTS, CTS and acknowledgement, and the pauses of a broadcast.

1. can-j1939 keeps handshake and times; each frame of it leaves by our gate, whose limits hold.
2. Nothing leaves but what `send` was asked for: of what arrives, can-j1939 is shown only what answers the session under way.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from types import TracebackType
from typing import Any, Protocol, Self

from ..errors import AcesError, CallerError, DeviceError, NoReplyError
from ..frames import Frame, message_to_frame

_CONNECTION, _DATA = 0xEC, 0xEB
_RTS, _CTS, _END, _BAM, _ABORT = 16, 17, 19, 32, 255
_STEERING = (_CTS, _END, _ABORT)
#: Reasons of an abort (J1939-21, table 7).
_ABORTS = {1: "it is busy", 2: "it has no resources", 3: "it waited too long", 4: "it got a CTS during data"}
#: Parameter groups below this PDU format are sent to one address.
_BROADCAST = 0xF0
_EVERYBODY = 0xFF
#: Seconds between two looks at what can-j1939 does by itself.
_LOOK_S = 0.05


class FrameGate(Protocol):
    """What it sends over: a `CanGate`."""

    @property
    def name(self) -> str:
        """The bus's name, for messages."""
        ...

    def send(self, frame: Frame, /) -> bool:
        """Queue a frame."""
        ...

    def subscribe(self, *, filter: Any) -> Any:
        """An inbox of the frames that `filter` matches."""
        ...


class J1939Sender:
    """Sends packets of `J1939Transport` over a gate, one after the other; needs can-j1939 (`aces-bus[j1939]`).

        with CanGate({"interface": "socketcan", "channel": "can0"}) as gate, J1939Sender(gate) as sender:
            sender.send(truck.encode("Proprietary", priority=7, source=0xF9, destination=0, data=bytes(100)))

    It waits with threads of its own: for programs, not for a device of a robot.
    """

    def __init__(self, gate: FrameGate) -> None:
        try:
            import j1939
        except ImportError:
            raise CallerError("J1939Sender needs can-j1939: pip install 'aces-bus[j1939]'") from None
        self.gate = gate
        self._one = threading.Lock()
        self._left: list[Frame] = []
        self._opening = Frame(0)
        self._failure: AcesError | None = None
        self._sources: set[int] = set()
        self._unit: Any = j1939.ElectronicControlUnit(max_cmdt_packets=255, send_message=self._leave)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End can-j1939's thread; the gate stays open."""
        self._unit.stop()

    def send(self, frames: Sequence[Any], *, timeout_s: float = 30.0) -> None:
        """Send what `encode` gave: a frame, a broadcast, or a packet to one address, until that has acknowledged it.

        Raises `CallerError` for frames that are no packet, and what the gate raises; `NoReplyError` where the receiver says
        nothing, after the times of J1939-21 or `timeout_s`; `DeviceError` where it aborts.
        """
        given = [one if isinstance(one, Frame) else message_to_frame(one) for one in frames]
        if len(given) == 1 and (given[0].arbitration_id >> 16 & 0xFF) not in (_CONNECTION, _DATA):
            self.gate.send(given[0])
            return
        with self._one:
            self._send(given, timeout_s)

    def _send(self, frames: list[Frame], timeout_s: float) -> None:
        opening = frames[0] if frames else Frame(0)
        identifier, head = opening.arbitration_id, opening.data
        source, destination = identifier & 0xFF, identifier >> 8 & 0xFF
        if identifier >> 16 & 0xFF != _CONNECTION or len(head) < 8 or head[0] not in (_RTS, _BAM):
            raise CallerError("no packet of J1939Transport: give all frames that encode gave, in their order")
        data = b"".join(frame.data[1:] for frame in frames[1:])[: int.from_bytes(head[1:3], "little")]
        group = int.from_bytes(head[5:8], "little")
        pdu = group >> 8 & 0xFF
        self._left, self._failure, self._opening = [], None, opening
        if source not in self._sources:
            self._sources.add(source)
            self._unit.subscribe(_ignore, source)
        to = destination if pdu < _BROADCAST else group & 0xFF
        inbox = self.gate.subscribe(filter=_Answers(source, destination))
        try:
            if not self._unit.send_pgn(group >> 16 & 1, pdu, to, identifier >> 26 & 7, source, list(data)):
                raise DeviceError(
                    f"{self.gate.name}: a packet from {source} to {destination} is under way already"
                )
            for _ in range(max(1, round(timeout_s / _LOOK_S))):
                if self._is_through(
                    [item.content for item in inbox.get(_LOOK_S)], destination, len(frames) - 1
                ):
                    return
        finally:
            inbox.close()
        raise NoReplyError(f"{self.gate.name}: {destination} has not taken the packet after {timeout_s:g} s")

    def _is_through(self, arrived: Sequence[Frame], destination: int, count: int) -> bool:
        """Show can-j1939 what has arrived; whether the packet is acknowledged, or has been said to all."""
        for frame in arrived:
            self._unit.notify(frame.arbitration_id, bytearray(frame.data), frame.timestamp or 0.0)
            if frame.data[0] == _ABORT:
                why = _ABORTS.get(frame.data[1], f"reason {frame.data[1]}")
                raise DeviceError(f"{self.gate.name}: {destination} aborted the packet: {why}")
        if self._failure is not None:
            raise self._failure
        left = list(self._left)
        if any(frame.data[0] == _ABORT and not _is_data(frame) for frame in left):
            raise NoReplyError(
                f"{self.gate.name}: {destination} gave no clear-to-send, or no acknowledgement"
            )
        if destination == _EVERYBODY:
            return sum(map(_is_data, left)) >= count
        return any(frame.data[0] == _END for frame in arrived)

    def _leave(self, can_id: int, extended_id: bool, data: Any, fd_format: bool = False) -> None:
        """A frame of can-j1939, on its thread or ours; what the gate raises is kept for `send`."""
        frame = Frame(can_id, bytes(data), is_extended_id=extended_id)
        if frame.data[0] == _BAM and not _is_data(frame):
            frame = self._opening  # can-j1939 leaves the destination, everybody, in the number of the group
        try:
            self.gate.send(frame)
        except AcesError as error:
            self._failure = error
        else:
            self._left.append(frame)


class _Answers:
    """What answers a session: connection frames from its destination to its source that steer it."""

    def __init__(self, source: int, destination: int) -> None:
        self._low = _CONNECTION << 16 | source << 8 | destination

    def matches(self, content: Frame, /) -> bool:
        """Whether it is such a frame."""
        return (
            content.is_extended_id
            and content.arbitration_id & 0x3FF_FFFF == self._low
            and len(content.data) >= 8
            and content.data[0] in _STEERING
        )


def _is_data(frame: Frame) -> bool:
    return frame.arbitration_id >> 16 & 0xFF == _DATA


def _ignore(*_: Any) -> None:
    """can-j1939 takes what is sent to an address only where somebody wants to know."""


__all__ = ["J1939Sender"]
