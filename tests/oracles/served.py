"""Twins on a served bus, in real time, for foreign programs that take a python-can bus: `interface="aces"`, `channel=…`."""

from __future__ import annotations

import tempfile
import threading
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import can

from aces_bus.device import Robot, Twin
from aces_bus.hardware import CanGate
from aces_bus.hardware.ports import port_of
from aces_bus.hardware.served.channel import ServedChannel
from aces_bus.hardware.served.server import BusServer
from aces_bus.robot import parse_robot
from aces_bus.robot.rig import simulate
from aces_bus.runtime.loop import Loop

T = TypeVar("T")
#: A limit that a machine twenty times slower keeps, too (s).
PATIENCE_S = 30.0


class ServedTwins(NamedTuple):
    """The one bus of a robot: its channel, its twins, what calls a function on their thread, the frames since it
    was last asked."""

    channel: str
    twins: dict[str, Twin]
    call: Callable[[Callable[[], Any]], Any]
    frames: Callable[[], list[can.Message]]


@contextmanager
def served(text: str) -> Generator[ServedTwins]:
    """The twins of a robot (TOML) of one CAN bus."""
    robot, problems = parse_robot(text)
    assert isinstance(robot, Robot), problems
    ((name, bus),) = robot.buses.items()
    with tempfile.TemporaryDirectory(prefix="aces") as folder:
        channel = ServedChannel(name, bitrate=bus.bitrate or 1_000_000)
        server = BusServer([channel], unix=str(Path(folder) / "bus"), tcp=None, socketcand=None)
        thread = threading.Thread(target=server.serve, daemon=True)
        thread.start()
        address = server.addresses[name][0]
        try:
            with can.Bus(channel=address, interface="aces") as listener, Loop("twins") as loop:
                port = port_of(CanGate({"interface": "aces", "channel": address}), loop)
                with simulate(robot, {name: port}) as simulation:
                    yield ServedTwins(address, simulation.twins, loop.call, lambda: list(received(listener)))
        finally:
            server.stop()
            thread.join(PATIENCE_S)


@contextmanager
def port_on(channel: dict[str, Any]) -> Generator[Any]:
    """A port of ours at a bus of python-can, in real time; its callbacks run on a thread of its own."""
    with Loop("ours") as loop:
        yield port_of(CanGate(channel, name="ours"), loop)


def received(listener: can.BusABC) -> Iterator[can.Message]:
    """What has come."""
    while (message := listener.recv(0.2)) is not None:
        yield message


def wait_until(is_so: Callable[[], T]) -> T:
    """Let time pass until something is so; fails after `PATIENCE_S`."""
    end = time.monotonic() + PATIENCE_S
    while not (found := is_so()):
        assert time.monotonic() < end, "it does not become so"
        time.sleep(0.01)
    return found
