"""A network of datagrams as a simulation: whole, late by a fixed time, or lost by chance.

1. Time is the clock's; the same clock, calls and seed give the same network.
2. What is lost is counted.
"""

from __future__ import annotations

import random
from collections.abc import Callable

from ...runtime import VirtualClock

#: A datagram of the local network arrives about this late (ns).
DELAY_NS = 100_000


class DatagramNode:
    """One socket; made by `SimulatedDatagrams.attach`. What it sends reaches all others."""

    def __init__(
        self, wire: SimulatedDatagrams, name: str, received: Callable[[bytes, int], None] | None
    ) -> None:
        self.wire, self.name, self.received = wire, name, received

    def send(self, data: bytes) -> None:
        """Send a datagram."""
        self.wire.carry(self, data)


class SimulatedDatagrams:
    """Who is attached hears all others. `drop` is the chance from 0 to 1 that a datagram is lost; see `lost`."""

    def __init__(
        self, clock: VirtualClock, *, delay_ns: int = DELAY_NS, drop: float = 0.0, seed: int = 0
    ) -> None:
        self.clock, self.delay_ns, self.drop = clock, delay_ns, drop
        self._random = random.Random(seed)
        self.nodes: list[DatagramNode] = []
        self.sent = self.lost = 0

    def attach(self, name: str = "", received: Callable[[bytes, int], None] | None = None) -> DatagramNode:
        """Attach a new node."""
        node = DatagramNode(self, name or f"node{len(self.nodes)}", received)
        self.nodes.append(node)
        return node

    def carry(self, sender: DatagramNode, data: bytes) -> None:
        """Carry a datagram to all nodes but its sender."""
        self.sent += 1
        if self.drop and self._random.random() < self.drop:
            self.lost += 1
            return

        def arrive() -> None:
            for node in self.nodes:
                if node is not sender and node.received is not None:
                    node.received(data, self.clock.now())

        self.clock.post(self.clock.now() + self.delay_ns, arrive)
