"""A serial line as a simulation: bytes take their time, noise hits them, two who speak at once garble each other.

1. Time is the clock's; the same clock, calls and seed give the same line, bit for bit.
2. Every byte that a node sends arrives at every other node, late by its own time on the wire, or is counted as lost.
   Nodes that allow it are given whole chunks at once, at the end of their last byte: the same bytes, the same collisions.

A byte is ten bits at the line's speed (a start bit, eight, a stop bit). On a full-duplex line each way is its own; on a
half-duplex one (RS-485, the Dynamixel bus) all share a wire: bytes that overlap in time are garbled for everybody, and a
node that echoes hears itself.

**Not modelled**: clock tolerance, receivers that lose step inside a byte, drivers that are slow to let go of the wire.

`PtyPort` is a pseudo-terminal onto a line, which foreign programs open like any port. They block in real time, so the line
is paced: virtual time follows this machine's clock, on one thread that ends with `close`. At another speed than the line's
they are not understood, and counted."""

from __future__ import annotations

import os
import random
import select
import struct
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Self

from ...errors import CallerError
from ...runtime import VirtualClock

#: Start, eight data, stop.
BITS = 10
#: A break is the line low for longer than a byte: what it is read as.
BREAK = b"\x00"


@dataclass(frozen=True)
class Noise:
    """Chances from 0 to 1, for each byte: `flip` one of its bits, `drop` it (a framing error), `insert` one before it."""

    seed: int = 0
    flip: float = 0.0
    drop: float = 0.0
    insert: float = 0.0


class SerialNode:
    """One end of a line; made by `SimulatedSerialLine.attach`.

    `received` is called with bytes and the instant (ns) of their end.
    """

    def __init__(
        self,
        wire: SimulatedSerialLine,
        name: str,
        received: Callable[[bytes, int], None] | None,
        *,
        echo: bool,
        whole: bool,
    ) -> None:
        self.wire, self.name, self.received, self.echo, self.whole = wire, name, received, echo, whole
        self._is_connected = True
        #: When the last byte that was given to send has left.
        self.free_at = 0
        #: Bytes of this node that met others on the wire.
        self.collisions = 0

    @property
    def is_connected(self) -> bool:
        """True if the node is plugged in; otherwise bytes that it sends are lost, and it receives none."""
        return self._is_connected

    @is_connected.setter
    def is_connected(self, on: bool) -> None:
        self.wire.catch_up()  # what has left and what was received until now
        self._is_connected = on

    def send(self, data: bytes) -> int:
        """Put bytes behind those that are still leaving; the instant (ns) at which the last one has left."""
        if not data:
            return max(self.wire.clock.now(), self.free_at)
        return self._send(bytes(data), self.wire.byte_ns)

    def send_break(self, duration_ns: int | None = None) -> None:
        """Hold the line low, by default for two bytes: others read a single zero, and know it for a break by its length."""
        self._send(BREAK, duration_ns if duration_ns is not None else 2 * self.wire.byte_ns)

    def _send(self, data: bytes, byte_ns: int) -> int:
        chunk = _Chunk(self, data, max(self.wire.clock.now(), self.free_at), byte_ns)
        self.free_at = chunk.end
        self.wire.carry(chunk)
        return chunk.end

    @property
    def pending(self) -> int:
        """Number of bytes that have not left yet."""
        left = self.free_at - self.wire.clock.now()
        return 0 if left <= 0 else -(-left // self.wire.byte_ns)


class _Chunk:
    """Bytes that one node sends without a gap."""

    __slots__ = ("byte_ns", "data", "done", "end", "garbled", "is_split", "node", "others", "start")

    def __init__(self, node: SerialNode, data: bytes, start: int, byte_ns: int) -> None:
        self.node, self.data, self.start, self.byte_ns = node, data, start, byte_ns
        self.end = start + len(data) * byte_ns
        #: How many bytes have arrived; whether they do so one by one.
        self.done = 0
        self.is_split = False
        #: Who else was on the wire meanwhile, and which bytes met theirs.
        self.others: list[_Chunk] = []
        self.garbled: set[int] = set()

    def meets(self, other: _Chunk) -> range:
        """Return which bytes are on the wire while the other chunk is."""
        first = max(0, (other.start - self.start) // self.byte_ns)
        return range(first, min(len(self.data), -(-(other.end - self.start) // self.byte_ns)))

    def arrived(self, number: int) -> int:
        """Return what is read of a byte where several drive the wire: a dominant zero of either, and bits out of step."""
        byte = self.data[number]
        start = self.start + number * self.byte_ns
        alone = _Chunk(self.node, self.data[number : number + 1], start, self.byte_ns)
        for other in self.others:
            for index in other.meets(alone):
                shift = abs(other.start + index * other.byte_ns - start) * BITS // self.node.wire.byte_ns
                byte &= (other.data[index] << shift | (1 << shift) - 1) & 0xFF
        return byte


def _collide(first: _Chunk, other: _Chunk) -> None:
    """Garble the bytes of two chunks that are on the wire at once."""
    for mine, theirs in ((first, other), (other, first)):
        mine.others.append(theirs)
        fresh = set(mine.meets(theirs)) - mine.garbled
        mine.garbled |= fresh
        mine.node.collisions += len(fresh)


class SimulatedSerialLine:
    """A line between two or more nodes. `baud` in bit/s.

    `bytes` and `garbled` count what was carried and what collided; `flipped`, `dropped` and `inserted` what noise did.
    """

    def __init__(
        self, clock: VirtualClock, *, baud: int, half_duplex: bool = False, noise: Noise | None = None
    ) -> None:
        if not 50 <= baud <= 20_000_000:
            raise CallerError(f"a line speed of {baud} baud; lines have 50 to 20,000,000")
        self.clock, self.baud, self.half_duplex = clock, baud, half_duplex
        self.byte_ns = round(BITS * 1_000_000_000 / baud)
        self.nodes: list[SerialNode] = []
        self.noise = noise
        self._flying: list[_Chunk] = []
        self.bytes = self.garbled = self.flipped = self.dropped = self.inserted = 0

    def attach(
        self,
        name: str = "",
        received: Callable[[bytes, int], None] | None = None,
        *,
        echo: bool | None = None,
        whole: bool = False,
    ) -> SerialNode:
        """Attach a new node. `echo`: it hears itself; None: on a half-duplex line.

        `whole`: it may be given all bytes of one `send` together, at their end, as adapters do; otherwise byte by byte. That
        is what happens on a line without noise whose nodes all agree to it, and it is much cheaper.
        """
        node = SerialNode(
            self,
            name or f"node{len(self.nodes)}",
            received,
            echo=self.half_duplex if echo is None else echo,
            whole=whole,
        )
        self.catch_up()  # it was not there for what has passed
        self.nodes.append(node)
        return node

    @property
    def noise(self) -> Noise | None:
        """Noise on bytes from now on; setting it draws anew from its seed."""
        return self._noise

    @noise.setter
    def noise(self, noise: Noise | None) -> None:
        self._noise = noise
        self._random = random.Random(noise.seed if noise is not None else 0)

    @property
    def free_at(self) -> int:
        """When all that was given to its nodes has left (ns)."""
        return max((node.free_at for node in self.nodes), default=0)

    def carry(self, chunk: _Chunk) -> None:
        """Put bytes on the wire, which others may occupy on a half-duplex line."""
        now = self.clock.now()
        flying = self._flying = [other for other in self._flying if other.end > now]
        whole = self._noise is None and all(node.whole for node in self.nodes)
        for other in flying:
            if other.node is not chunk.node and other.start < chunk.end and chunk.start < other.end:
                if self.half_duplex:
                    _collide(chunk, other)
                elif len(self.nodes) == 2:
                    continue  # no node receives both
                whole = False
                self._split(other)
        flying.append(chunk)
        if whole:
            self.clock.post(chunk.end, partial(self._arrive, chunk))
        else:
            self._split(chunk)

    def _split(self, chunk: _Chunk) -> None:
        """Let a chunk arrive byte by byte from now on: others' bytes come between its own."""
        if chunk.is_split:
            return
        chunk.is_split = True
        self._arrive(chunk)
        arrive = partial(self._arrive, chunk)
        for number in range(chunk.done + 1, len(chunk.data) + 1):
            self.clock.post(chunk.start + number * chunk.byte_ns, arrive)

    def catch_up(self) -> None:
        """Hand over what has arrived by now of the chunks that would be handed over as a whole later."""
        for chunk in list(self._flying):
            self._arrive(chunk)

    def _arrive(self, chunk: _Chunk) -> None:
        """Hand over the bytes whose end has come."""
        first = chunk.done
        last = min(len(chunk.data), (self.clock.now() - chunk.start) // chunk.byte_ns)
        if first >= last:
            return
        chunk.done = last
        self.bytes += last - first
        if not chunk.node.is_connected:
            return
        data = chunk.data if last - first == len(chunk.data) else chunk.data[first:last]
        if chunk.garbled:
            hit = [number for number in chunk.garbled if first <= number < last]
            self.garbled += len(hit)
            changed = bytearray(data)
            for number in hit:
                changed[number - first] = chunk.arrived(number)
            data = bytes(changed)
        ends = range(chunk.start + (first + 1) * chunk.byte_ns, chunk.end + 1, chunk.byte_ns)
        if self._noise is None:
            self._hand_over(chunk.node, data, ends)
            return
        for byte, end in zip(data, ends, strict=False):
            for noisy in self._after_noise(byte):
                self._hand_over(chunk.node, noisy, (end,))

    def _hand_over(self, sender: SerialNode, data: bytes, ends: Sequence[int]) -> None:
        """Give bytes, and when each of them ended, to all nodes that hear them."""
        for node in tuple(self.nodes):
            if node.received is None or not node.is_connected or (node is sender and not node.echo):
                continue
            if node.whole or len(data) == 1:
                node.received(data, ends[len(data) - 1])
            else:
                for byte, end in zip(data, ends, strict=False):
                    node.received(bytes((byte,)), end)

    def _after_noise(self, byte: int) -> tuple[bytes, ...]:
        noise = self._noise
        if noise is None:
            return (bytes((byte,)),)
        draw = self._random
        out: list[bytes] = []
        if noise.insert and draw.random() < noise.insert:
            self.inserted += 1
            out.append(bytes((draw.randrange(256),)))
        if noise.drop and draw.random() < noise.drop:
            self.dropped += 1
            return tuple(out)
        if noise.flip and draw.random() < noise.flip:
            self.flipped += 1
            byte ^= 1 << draw.randrange(8)
        out.append(bytes((byte,)))
        return tuple(out)


#: Seconds after which time is moved on though nothing came and nothing was to happen.
STEP_S = 0.002
#: How far a receiver's speed may be off: ten bits, of which the last is sampled in its middle.
TUNED = 0.03
#: Linux's TCGETS2, and the size of what it fills: four words, a line discipline, 19 characters, both speeds (asm-generic).
_TCGETS2, _TERMIOS2 = 0x802C542A, struct.Struct("=4I20x2I")


def terminal_speed(file: int) -> int | None:
    """Return the speed that a program has given a terminal (bit/s); None where the system does not say."""
    try:
        import fcntl

        return int(_TERMIOS2.unpack(fcntl.ioctl(file, _TCGETS2, bytes(_TERMIOS2.size)))[-1])
    except (ImportError, OSError):
        return None


class PtyPort:
    """One end of a `SimulatedSerialLine` as a port: `path` is what programs open.

    with PtyPort(wire) as port: subprocess.run(["tool", port.path])

    Everything else on the wire runs on this object's thread; use `with port.lock:` to touch it from another. `whole`: the
    bytes of a packet arrive together, as by USB.
    """

    def __init__(self, wire: SimulatedSerialLine, name: str = "pty", *, whole: bool = False) -> None:
        try:
            import termios
            import tty
        except ImportError as error:  # Windows
            raise CallerError("pseudo-terminals are not to be had on this system") from error
        self.wire = wire
        self.lock = threading.RLock()
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        settings = termios.tcgetattr(self._slave)
        settings[4:6] = [termios.B50] * 2  # of who never sets a speed; nobody means it
        termios.tcsetattr(self._slave, termios.TCSANOW, settings)
        self._untouched = terminal_speed(self._slave)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)
        #: Bytes that the program did not read in time, and those that it sent at another speed than the line's.
        self.dropped = self.mistuned = 0
        self.node: SerialNode = wire.attach(name, self._received, echo=False, whole=whole)
        self._began = time.monotonic_ns() - wire.clock.now()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"{name} {self.path}", daemon=True)
        self._thread.start()

    def _received(self, data: bytes, instant: int) -> None:
        try:
            os.write(self._master, data)
        except BlockingIOError:
            self.dropped += len(data)
        except OSError:
            self._stopping.set()

    def _run(self) -> None:
        while not self._stopping.is_set():
            ready, _, _ = select.select([self._master], [], [], self._pause_s())
            data = b""
            if ready:
                try:
                    data = os.read(self._master, 4096)
                except BlockingIOError:
                    pass
                except OSError:
                    break
            with self.lock:
                clock = self.wire.clock
                clock.sleep_until(time.monotonic_ns() - self._began)
                if data and self.is_tuned:
                    self.node.send(data)
                else:
                    self.mistuned += len(data)

    @property
    def is_tuned(self) -> bool:
        """True if the program has left the terminal's speed alone, or set it to the line's."""
        speed = terminal_speed(self._slave)
        return speed == self._untouched or abs((speed or 0) - self.wire.baud) <= TUNED * self.wire.baud

    def _pause_s(self) -> float:
        """Return how long to wait for bytes: until something happens on the wire."""
        with self.lock:
            event = self.wire.clock.next_event
        if event is None:
            return STEP_S
        return min(STEP_S, max(0.0, (event - time.monotonic_ns() + self._began) / 1e9))

    def close(self) -> None:
        """Take the port away."""
        self._stopping.set()
        if threading.current_thread() is not self._thread:
            self._thread.join(5.0)
        for end in (self._master, self._slave):
            try:
                os.close(end)
            except OSError:
                pass

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
