"""A serial line as a simulation: bytes take their time, noise hits them, two who speak at once garble each other.

1. Time is the clock's; the same clock, calls and seed give the same line, bit for bit.
2. Every byte that a node sends arrives at every other node, late by its own time on the wire, or is counted as lost.

A byte is ten bits at the line's speed (a start bit, eight, a stop bit). On a full-duplex line each way is its own; on a
half-duplex one (RS-485, the Dynamixel bus) all share a wire: bytes that overlap in time are garbled for everybody, and a
node that echoes hears itself.

**Not modelled**: clock tolerance, receivers that lose step inside a byte, drivers that are slow to let go of the wire.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from ..errors import CallerError
from ..runtime import VirtualClock

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
    """One end of a line; made by `SerialWire.attach`. `received` is called with each byte and its end's instant (ns)."""

    def __init__(
        self, wire: SerialWire, name: str, received: Callable[[bytes, int], None] | None, *, echo: bool
    ) -> None:
        self.wire, self.name, self.received, self.echo = wire, name, received, echo
        self.is_connected = True
        #: When the last byte that was given to send has left.
        self.free_at = 0
        #: Bytes of this node that met others on the wire.
        self.collisions = 0

    def send(self, data: bytes) -> int:
        """Put bytes behind those that are still leaving; the instant (ns) at which the last one has left."""
        wire = self.wire
        start = max(wire.clock.now(), self.free_at)
        for byte in data:
            end = start + wire.byte_ns
            wire.carry(self, byte, start, end)
            start = end
        self.free_at = start
        return start

    def send_break(self, duration_ns: int | None = None) -> None:
        """Hold the line low, by default for two bytes: others read a single zero, and know it for a break by its length."""
        wire = self.wire
        start = max(wire.clock.now(), self.free_at)
        end = start + (duration_ns if duration_ns is not None else 2 * wire.byte_ns)
        wire.carry(self, 0, start, end)
        self.free_at = end

    @property
    def pending(self) -> int:
        """How many bytes have not left yet."""
        left = self.free_at - self.wire.clock.now()
        return 0 if left <= 0 else -(-left // self.wire.byte_ns)


@dataclass
class _Flying:
    """A byte on the wire."""

    node: SerialNode
    byte: int
    start: int
    end: int
    is_garbled: bool = False


class SerialWire:
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
        self._noise = noise
        self._random = random.Random(noise.seed if noise is not None else 0)
        self._flying: list[_Flying] = []
        self.bytes = self.garbled = self.flipped = self.dropped = self.inserted = 0

    def attach(
        self,
        name: str = "",
        received: Callable[[bytes, int], None] | None = None,
        *,
        echo: bool | None = None,
    ) -> SerialNode:
        """A new node. `echo`: it hears itself; None: on a half-duplex line."""
        node = SerialNode(
            self,
            name or f"node{len(self.nodes)}",
            received,
            echo=self.half_duplex if echo is None else echo,
        )
        self.nodes.append(node)
        return node

    def carry(self, node: SerialNode, byte: int, start: int, end: int) -> None:
        """A byte goes on the wire from `start` to `end` (ns)."""
        flying = _Flying(node, byte, start, end)
        if self.half_duplex:
            now = self.clock.now()
            self._flying = [other for other in self._flying if other.end > now]
            for other in self._flying:
                if other.node is not node and other.start < end and start < other.end:
                    for one in (flying, other):
                        if not one.is_garbled:
                            one.is_garbled = True
                            one.node.collisions += 1
            self._flying.append(flying)
        self.clock.call_at(end, partial(self._arrive, flying))

    def _arrive(self, flying: _Flying) -> None:
        self.bytes += 1
        sender = flying.node
        if not sender.is_connected:
            return
        byte = flying.byte
        if flying.is_garbled:
            self.garbled += 1
            byte = self._garbled(flying)
        for data in self._after_noise(byte):
            for node in self.nodes:
                if node.received is None or not node.is_connected or (node is sender and not node.echo):
                    continue
                node.received(data, flying.end)

    def _garbled(self, flying: _Flying) -> int:
        """What is read where several drive the wire: a dominant zero of either, and bits out of step."""
        byte = flying.byte
        for other in self._flying:
            if other.node is not flying.node and other.start < flying.end and flying.start < other.end:
                shift = abs(other.start - flying.start) * BITS // self.byte_ns
                byte &= (other.byte << shift | (1 << shift) - 1) & 0xFF
        return byte

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
