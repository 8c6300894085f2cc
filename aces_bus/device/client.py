"""Requests and replies on a bare bus: one program, one device's protocol, no driver.

    bus = can.Bus("can0", interface="socketcan")
    hubo = Client(bus, "hubo", configuration="hubo2plus")
    print(hubo.ask("SendStatus", board=0))

1. A reply is a message that the spec declares to be one (`reply_to`), with the request's values of what both capture.
   What was received before the request is none.
2. What comes in between is kept for `listen`, up to a bound.
3. Messages of a transport are sent and received where they are one frame: a client sends no flow control.
4. For whole robots there are drivers and a `Host`: they poll, watch and stop. A client does what it is called for.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import AsyncGenerator, Iterator
from typing import Any

from ..errors import CallerError, NoReplyError
from ..protocol import Protocol, Record, Variant
from ..protocol.declare.protocol import Configuration
from ..protocol.files import load_protocol
from ..protocol.live.scanner import make_scanner
from .port import Packet

#: Records that wait for `listen`; the oldest go first.
KEPT = 10_000
#: Bytes that are read of a serial port at once, at most.
PIECE = 4096


class Client:
    """Sends messages on `bus` and waits for replies; for one thread.

    `bus` is an open python-can bus or pyserial port; `protocol` a protocol or an installed one's name. Raises `CallerError`
    for a bus that is neither.
    """

    def __init__(
        self,
        bus: Any,
        protocol: Protocol | str,
        *,
        dialect: str | None = None,
        configuration: str | Configuration | None = None,
    ) -> None:
        protocol = load_protocol(protocol) if isinstance(protocol, str) else protocol
        wanted = ("send", "recv") if protocol.link == "can" else ("write", "read")
        if not all(hasattr(bus, name) for name in wanted):
            kind = "a python-can bus" if protocol.link == "can" else "a pyserial port"
            raise CallerError(
                f"{protocol.name} is spoken on {protocol.link}: a client needs {kind}, not {bus!r}"
            )
        self.variant: Variant = protocol.variant(dialect, configuration)
        self.bus = bus
        self._scanner: Any = make_scanner([self.variant], direction="from device")
        #: Reads our own requests, as a reply must have their values.
        self._requests: Any = make_scanner([self.variant], direction="to device")
        self._kept: deque[Record] = deque(maxlen=KEPT)

    def send(self, message: str, **fields: Any) -> None:
        """Send a message; `fields` in the sheet's units. Raises what `Encoder.encode` and the bus raise."""
        self._send(self.variant.encoder.encode(message, **fields))

    def _send(self, packet: Any) -> None:
        if isinstance(packet, list):  # a packet of a transport
            if len(packet) > 1:
                raise CallerError(
                    f"{self.variant.name}: this message takes {len(packet)} frames, and a client keeps no handshake;"
                    " a device on a host does, or aces send"
                )
            (packet,) = packet
        self._scanner.sent(packet)
        if self.variant.link == "can":
            from ..python_can import frame_to_message

            self.bus.send(frame_to_message(packet))
        else:
            self.bus.write(packet)

    def ask(self, message: str, *, timeout: float = 1.0, reply: str | None = None, **fields: Any) -> Record:
        """Send a message and give its reply, which comes within `timeout` s.

        `reply` names it where the spec does not say what the reply is. Raises `NoReplyError` when none came, and
        `CallerError` when no message is known to be one.
        """
        known = self.variant.messages
        answers = {
            name
            for name, known_field in known.items()
            if (
                name == reply
                if reply is not None
                else any(r.message.name == message for r in known_field.reply_to)
            )
        }
        if not answers:
            which = (
                f"no message named {reply!r}" if reply is not None else f"no reply to {message} in the spec"
            )
            raise CallerError(f"{self.variant.name}: {which}; say which it is: reply=… (or send, and listen)")
        packet = self.variant.encoder.encode(message, **fields)
        self._requests.reset()
        asked = next(iter(self._requests.feed([packet] if self._is_one_frame(packet) else packet)), None)
        self._keep_waiting()
        self._send(packet)
        ends = time.monotonic() + timeout
        while (left := ends - time.monotonic()) > 0:
            records = self._received(left)
            for place, record in enumerate(records):
                if type(record).__name__ in answers and self._agrees(record, asked):
                    self._kept.extend(records[place + 1 :])
                    return record
                self._kept.append(record)
        wanted = ", ".join(sorted(answers))
        raise NoReplyError(
            f"{message} was not answered within {timeout:g} s ({wanted}); is the device on the bus?"
        )

    def listen(self, timeout: float = 1.0) -> Iterator[Record]:
        """Yield records as they arrive, first the kept ones, until none has arrived for `timeout` s."""
        while True:
            while self._kept:
                yield self._kept.popleft()
            self._kept.extend(self._received(timeout))
            if not self._kept:
                return

    def __aiter__(self) -> AsyncGenerator[Record, None]:
        """Yield records in an asyncio program as they come, first the kept ones; nothing else reads the bus meanwhile.

        The bus is free again when the iteration is closed (`contextlib.aclosing`), or its loop ends.
        """
        from .asyncio_face import read_in_asyncio

        return read_in_asyncio(self._kept_or_received)

    def _kept_or_received(self, timeout: float) -> list[Record]:
        if self._kept:
            return [self._kept.popleft() for _ in range(len(self._kept))]
        return self._received(timeout)

    def _is_one_frame(self, packet: Packet) -> bool:
        return self.variant.link == "can" and not isinstance(packet, list)

    def _keep_waiting(self) -> None:
        """Keep what has come already."""
        if self.variant.link == "can":
            while (frame := self.bus.recv(0)) is not None:
                self._kept.extend(self._scanner.feed([frame]))
        else:
            while waiting := self.bus.in_waiting:
                self._kept.extend(self._scanner.feed(self.bus.read(min(waiting, PIECE))))

    def _received(self, timeout: float) -> list[Record]:
        """Return what comes next, within `timeout` s; an empty list when nothing does."""
        ends = time.monotonic() + timeout
        while (left := ends - time.monotonic()) > 0:
            if self.variant.link == "can":
                frame = self.bus.recv(left)
                traffic = [] if frame is None else [frame]
            else:
                self.bus.timeout = left
                traffic = self.bus.read(min(max(1, self.bus.in_waiting), PIECE))
            if traffic and (records := self._scanner.feed(traffic)):
                return list(records)
        return []

    def _agrees(self, record: Record, asked: Record | None) -> bool:
        """Return whether a record has the request's values of what both have outside their payload: board, servo,
        register.
        """
        if asked is None:
            return True
        messages = self.variant.messages
        shared = messages[type(record).__name__].outer_names & messages[type(asked).__name__].outer_names
        fields = shared & set(record.__struct_fields__) & set(asked.__struct_fields__)
        return all(getattr(record, name) == getattr(asked, name) for name in fields)


__all__ = ["Client"]
