"""The gatekeeper of a serial line: ports, `socket://`, `rfc2217://`, ptys; RS-485 with its echo and its turnaround.

1. The rules of `gate`. Bytes are handed over as they come, with the time they were read; nothing here finds packets.
2. On a half-duplex line nothing is sent while another speaks: after bytes were received, `turnaround` must pass.
3. What a half-duplex adapter hears of itself is taken out, byte by byte; what differs is a collision, and is reported.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

from ..errors import CallerError
from ..runtime.clock import Clock
from .gate import POLL_S, Gate, Received
from .queues import Report

if TYPE_CHECKING:
    import serial

#: Bytes that wait to be sent, at most.
OUTBOX = 1 << 20
#: Bytes that are read at once.
BLOCK = 4096
#: So many answers that are not an echo, and the adapter has none.
ENOUGH = 2
#: Seconds after which an echo that did not come is given up.
ECHO_S = 0.5


class SerialGate(Gate[bytes, bytes, "serial.Serial"]):
    """One serial line and its only owner.

    with SerialGate("/dev/ttyUSB0", baud=57_600, half_duplex=True) as gate:
        inbox = gate.subscribe()
        gate.send(packet)
        for item in inbox.get(1.0):
            records += scanner.feed(item.content, item.host_ns / 1e9)

    `url` is what pyserial opens: a port, `socket://host:port`, `rfc2217://…`, `loop://`. `baud` in bit/s. `half_duplex`: one
    pair of wires for both ways; `echo` says whether the adapter hears itself (None: on a half-duplex line that is found out
    with what is received first, and `echo` says it from then on; else it does not). `turnaround` is the
    silence, in seconds, that must lie between what others say and what is sent. `keep_own` also hands own bytes to readers.
    """

    items, unit = "pieces", "bytes"
    most = OUTBOX

    def __init__(
        self,
        url: str,
        *,
        baud: int = 115_200,
        name: str = "",
        listen_only: bool = False,
        reopen: bool = True,
        half_duplex: bool = False,
        echo: bool | None = None,
        turnaround: float = 0.0,
        keep_own: bool = False,
        clock: Clock | None = None,
        **options: Any,
    ) -> None:
        super().__init__(name or url, listen_only=listen_only, reopen=reopen, clock=clock)
        if baud <= 0:
            raise CallerError(f"{self.name}: a line speed of {baud} baud")
        self.url, self.baud = url, baud
        self.half_duplex = half_duplex
        self.echo = half_duplex if echo is None else echo
        #: Whether the adapter receives what it sends shows in what is received first; what was received of that so far.
        self._is_unsure = half_duplex and echo is None
        self._held = bytearray()
        self._others = 0
        self.turnaround_ns = round(turnaround * 1e9)
        self.keep_own = keep_own
        self._options = options
        self._echo_due = bytearray()
        self._echo_until = 0
        #: On a loop: what the port has not taken yet of a packet.
        self._rest = b""
        self._received_at = 0

    def _opened(self) -> serial.Serial:
        import serial

        port: serial.Serial = serial.serial_for_url(
            self.url, baudrate=self.baud, timeout=POLL_S, write_timeout=5.0, **self._options
        )
        self._echo_due.clear()
        self._held.clear()
        self._rest = b""
        return port

    def _shut(self, bus: serial.Serial) -> None:
        bus.close()

    @staticmethod
    def _describe(bus: serial.Serial) -> str:
        return f"{bus.name} at {bus.baudrate} baud" if getattr(bus, "name", None) else ""

    # ------------------------------------------------------------------ receiving

    def _receive(self) -> None:
        while not self._stopping.is_set():
            try:
                data = self._bus.read(1)
                if data and (more := self._bus.in_waiting):
                    data += self._bus.read(min(more, BLOCK))
            except (
                Exception
            ) as error:  # SerialException, OSError, TypeError of a port that was closed under us
                if self._stopping.is_set() or not self._lose(error):
                    return
                continue
            if data:
                self._hear(data)

    def _file_of(self, bus: serial.Serial) -> int | None:
        number = getattr(
            bus, "fd", None
        )  # a port of this system: others (`rfc2217://`) have no file, or do not say all
        if not isinstance(number, int):
            return None
        self._number = number
        return number

    def _read_now(self) -> list[Received[bytes]]:
        try:
            data = os.read(self._number, BLOCK)
        except BlockingIOError:
            return []
        if not data:
            raise EOFError("the port has something to read, and it is nothing: it is gone")
        self._hear(data)
        return []

    def _hear(self, data: bytes) -> None:
        now = self.clock.now()
        own = 0
        if self._is_unsure and self._echo_due:
            data = self._find_out(data, now)
        elif self._echo_due:
            own = self._take_echo(data, now)
        if own:
            self.counters.echoes += own
            data = data[own:]
        if data:
            self._received_at = now
            self.counters.received += len(data)
            self._put([Received(data, now)])

    def _find_out(self, data: bytes, now: int) -> bytes:
        """Return whether these bytes are our own, coming back; what of them is others'."""
        with self._guard:
            due = self._echo_due
            data = bytes(self._held) + data
            self._held.clear()
            if now > self._echo_until:  # too late to tell anything
                due.clear()
                return data
            both = min(len(data), len(due))
            is_own = data[:both] == bytes(due[:both])
            if is_own and len(data) < len(due):
                self._held += data
                return b""
            due.clear()
            if is_own:
                self._is_unsure = False
                self.counters.echoes += both
                return data[both:]
            self._others += 1  # one may be a collision
            if self._others == ENOUGH:
                self._is_unsure = self.echo = False
            return data

    def _take_echo(self, data: bytes, now: int) -> int:
        """Compare these bytes with those that were sent; return how many are our own, coming back."""
        with self._guard:
            due = self._echo_due
            if now > self._echo_until:
                due.clear()
                return 0
            same = 0
            for got, said in zip(data, due, strict=False):
                if got != said:
                    break
                same += 1
            if same < min(len(data), len(due)):
                self._emit(
                    "bad input",
                    f"a collision: {data[same]:#04x} was received where {due[same]:#04x} was sent",
                )
                self.counters.bad_input += 1
                due.clear()
                return same
            del due[:same]
            return same

    # ------------------------------------------------------------------ sending

    def send(
        self,
        data: bytes,
        *,
        age_s: float | None = None,
        urgent: bool = False,
        topic: object = None,
        report: Report | None = None,
    ) -> bool:
        """Queue bytes, which are sent together. The options, and what it returns, are those of `CanGate.send`.

        Raises `CallerError` when this gate only listens, is not open, or too much waits.
        """
        if not data:
            self._check_may_send()
            return True
        return self._queue(bytes(data), len(data), 0, age_s, urgent, topic, report)

    def _leaves_at(self) -> int:
        """Return when it may leave: on a half-duplex line others must have been silent for long enough."""
        return self._received_at + self.turnaround_ns if self.turnaround_ns else 0

    def _name_of(self, packet: bytes) -> str:
        return f"{len(packet)} bytes"

    def _put_out(self, packet: bytes) -> None:
        self._expect_echo(packet)
        self._bus.write(packet)
        if self.keep_own:
            self._put([Received(packet, self.clock.now(), True)])

    def _expect_echo(self, packet: bytes) -> None:
        if self.echo:
            with self._guard:
                if len(self._echo_due) > OUTBOX:
                    self._echo_due.clear()  # nothing is received at all
                self._echo_due += packet
                bits = 10 * (len(self._echo_due) + len(packet))
                self._echo_until = self.clock.now() + bits * 1_000_000_000 // self.baud + round(ECHO_S * 1e9)

    def _can_put_together(self) -> bool:
        return True

    def _put_together(self, packets: list[bytes]) -> tuple[int, Exception | None]:
        """Count a packet that the port took in part as taken; its rest goes first."""
        for number, packet in enumerate(packets):
            try:
                if not self._push():
                    return number, None
                self._rest = packet[os.write(self._number, packet) :]
                self._expect_echo(packet)
            except BlockingIOError:
                return number, None
            except OSError as error:
                return number, error
            if self.keep_own:
                self._put([Received(packet, self.clock.now(), True)])
        return len(packets), None

    def _push(self) -> bool:
        if self._rest:
            try:
                self._rest = self._rest[os.write(self._number, self._rest) :]
            except BlockingIOError:
                pass
            except OSError:  # it is gone, as reading says
                self._rest = b""
        return not self._rest

    def _still_held(self) -> int:
        try:
            self._push()
            waiting: int = self._bus.out_waiting
            return len(self._rest) + waiting
        except Exception:  # `socket://` has no such number, and a port that is gone has none either
            return 0
