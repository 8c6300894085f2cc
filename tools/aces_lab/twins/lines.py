"""Where a bench's twins stand, and how programs reach them: a virtual CAN bus, a served one, a pseudo-terminal, a TCP port.

1. No real interface: every way in is of this machine and of this process's making.
2. Twins are touched inside `call` only: no thread moves their time then.
3. What is closed leaves no thread, file or socket.
"""

from __future__ import annotations

import itertools
import os
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import TypeVar

from aces_bus import Frame
from aces_bus.device.config import Bus
from aces_bus.device.port import Port
from aces_bus.errors import CallerError
from aces_bus.hardware import CanGate, virtual_clock
from aces_bus.hardware.ports import port_of
from aces_bus.hardware.served.channel import ServedChannel
from aces_bus.hardware.served.server import BusServer
from aces_bus.hardware.simulated.backend import AcesBus
from aces_bus.hardware.simulated.frame_time import frame_bits
from aces_bus.hardware.simulated.serial_line import PtyPort, SimulatedSerialLine
from aces_bus.hardware.simulated.tcp_port import TcpPort
from aces_bus.protocol import Protocol
from aces_bus.protocol.record import PlainValue
from aces_bus.robot.buses import wire_of
from aces_bus.runtime import VirtualClock
from aces_bus.runtime.loop import Loop

T = TypeVar("T")
#: CAN FD's data bit rate where a robot's file states none (bit/s): moteus' and most adapters' default.
FD_RATE = 5_000_000
_numbers = itertools.count(1)


class Line:
    """One bus of a bench. `keywords` are what `can.Bus` takes, `channel` its channel; `port` is a terminal's path or a URL
    of pyserial: the one of them that the bus does not have is empty.
    """

    keywords: Mapping[str, PlainValue] = {}
    channel = ""
    path = ""
    #: The speed of a serial line (bit/s).
    baud = 0
    #: The twins' end, and the clock of its instants.
    port: Port

    def __init__(self, bus: Bus) -> None:
        self.name, self.link = bus.name, bus.link
        self._stack = ExitStack()

    def call(self, action: Callable[[], T]) -> T:
        """Return what `action()` returns, called when nothing else touches the twins."""
        raise NotImplementedError

    def complaint(self) -> str:
        """Return what a program did wrong with this bus, in a sentence; empty: nothing."""
        return ""

    def go_bus_off(self) -> None:
        """Have the controllers of all programs on it go bus-off. Raises `CallerError` where that cannot be."""
        raise CallerError(f"{self.name}: bus-off is a state of CAN controllers within this process")

    def close(self) -> None:
        """Take it away."""
        self._stack.close()


class CanLine(Line):
    """A virtual bus within this process: its time moves with whoever sends and receives, so it has no thread."""

    def __init__(self, bus: Bus, protocol: Protocol, *, fd: bool, clock: VirtualClock | None = None) -> None:
        super().__init__(bus)
        self.channel = f"twin{next(_numbers)}"
        is_fd = fd or protocol.has_fd
        self.keywords = {"interface": "aces", "channel": self.channel, **({"fd": True} if is_fd else {})}
        if clock is not None:
            self._stack.enter_context(virtual_clock(self.channel, clock=clock))
        self._holder = AcesBus(
            self.channel,
            bitrate=bus.bitrate or protocol.bitrate or 1_000_000,
            data_bitrate=(bus.data_bitrate or FD_RATE) if is_fd else None,
            fd=is_fd,
            listen_only=True,
            rx_queue_size=1,
        )
        self._stack.callback(self._holder.shutdown)
        for is_extended in (False, True):  # tables that the first frame would wait for
            frame_bits(Frame(arbitration_id=0x123, data=bytes(8), is_extended_id=is_extended, is_fd=is_fd))
        self._own = {self._holder.node}
        self.port = port_of(self._holder.node.wire, name=bus.name)

    def call(self, action: Callable[[], T]) -> T:
        """Return what `action()` returns, called while the wire stands still."""
        return self._holder.call(action)

    def go_bus_off(self) -> None:
        """Have the controllers of all programs on it go bus-off, as 32 errors in a row do."""
        twins = getattr(self.port, "node", None)
        for node in tuple(self._holder.node.wire.nodes):
            if node not in self._own and node is not twins:
                node.transmit_errors, node.state = 256, "bus-off"
                node.emit("bus-off")
        self._holder.node.wire.changed()


class ServedLine(Line):
    """A bus that other processes join by its address, in real time."""

    def __init__(self, bus: Bus, protocol: Protocol, *, fd: bool) -> None:
        super().__init__(bus)
        is_fd = fd or protocol.has_fd
        folder = tempfile.mkdtemp(prefix="aces")
        self._stack.callback(shutil.rmtree, folder, ignore_errors=True)
        channel = ServedChannel(
            bus.name,
            bitrate=bus.bitrate or protocol.bitrate or 1_000_000,
            data_bitrate=(bus.data_bitrate or FD_RATE) if is_fd else None,
            fd=is_fd,
        )
        server = BusServer([channel], unix=str(Path(folder) / "bus"), tcp=None, socketcand=None)
        thread = threading.Thread(target=server.serve, name=f"bus {bus.name}", daemon=True)
        thread.start()
        self._stack.callback(thread.join, 5.0)
        self._stack.callback(server.stop)
        self.channel = server.addresses[bus.name][0]
        self.keywords = {"interface": "aces", "channel": self.channel, **({"fd": True} if is_fd else {})}
        self._loop = self._stack.enter_context(Loop(f"twins on {bus.name}"))
        self.port = port_of(CanGate(dict(self.keywords), name=bus.name), self._loop)

    def call(self, action: Callable[[], T]) -> T:
        """Return what `action()` returns, called on the twins' thread."""
        return self._loop.call(action)


class SerialLine(Line):
    """A serial line with a pseudo-terminal as its other end, or a TCP port where the system has none."""

    def __init__(self, bus: Bus, protocol: Protocol, *, whole: bool = True, tcp: bool = False) -> None:
        super().__init__(bus)
        wire = wire_of(bus, protocol, VirtualClock(time.monotonic_ns()))
        assert isinstance(wire, SimulatedSerialLine)
        self.wire, self.baud = wire, wire.baud
        self._end: PtyPort | TcpPort
        self.port = port_of(wire, name=bus.name)
        has_terminals = hasattr(os, "openpty") and not tcp
        self._end = PtyPort(wire, whole=whole) if has_terminals else TcpPort(wire)
        self._stack.callback(self._end.close)
        self.path = self._end.path

    def call(self, action: Callable[[], T]) -> T:
        """Return what `action()` returns, called while the line stands still."""
        with self._end.lock:
            self.wire.clock.sleep_until(time.monotonic_ns())
            return action()

    def complaint(self) -> str:
        """Return how many bytes came at another speed than the line's."""
        count = getattr(self._end, "mistuned", 0)
        return (
            f"{count} bytes came at another speed than the line's, {self.baud} bit/s: give the program this one,"
            " or the twin another: baud=…"
            if count
            else ""
        )


def line_of(
    bus: Bus,
    protocol: Protocol,
    *,
    shared: bool = False,
    fd: bool = False,
    tcp: bool = False,
    clock: VirtualClock | None = None,
) -> Line:
    """Return the line of a robot's bus. Raises `CallerError` for what it cannot be."""
    if bus.link == "datagram":
        raise CallerError(f"bus {bus.name} is of datagrams: `aces sim` has its twins at a UDP port")
    if clock is not None and (bus.link != "can" or shared):
        raise CallerError(
            f"bus {bus.name}: virtual time is for a CAN bus within this process; other programs and terminals wait in real"
            " time"
        )
    if bus.link == "serial":
        return SerialLine(bus, protocol, tcp=tcp)
    return ServedLine(bus, protocol, fd=fd) if shared else CanLine(bus, protocol, fd=fd, clock=clock)


__all__ = ["CanLine", "Line", "SerialLine", "ServedLine", "line_of"]
