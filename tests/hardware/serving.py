"""Servers, messages and waiting for tests of served buses."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any

import can
import pytest

from aces_bus.hardware.served.channel import ServedChannel
from aces_bus.hardware.served.remote import ServedBus
from aces_bus.hardware.served.server import BusServer

#: How long anything may take here, in seconds; reached only when something is broken.
PATIENCE = 60.0

Open = Callable[..., ServedBus]

#: For modules whose every test makes a server.
with_unix_sockets = [
    pytest.mark.skipif(not hasattr(socket, "AF_UNIX"), reason="no Unix sockets on this system"),
    pytest.mark.usefixtures("runtime"),
]


def serve(*channels: ServedChannel, **more: Any) -> BusServer:
    """A server of these channels; by default one at 1 Mbit/s."""
    return BusServer(channels or [ServedChannel(bitrate=1_000_000)], **more)


def message(identifier: int, data: bytes = b"", **more: Any) -> can.Message:
    more.setdefault("is_extended_id", False)
    return can.Message(arbitration_id=identifier, data=data, **more)


def received(bus: can.BusABC, count: int = 1) -> list[can.Message]:
    """The next messages; fails when they do not come."""
    found = []
    for _ in range(count):
        got = bus.recv(PATIENCE)
        assert got is not None
        found.append(got)
    return found


@contextmanager
def sending(bus: can.BusABC, message: can.Message, period_s: float) -> Generator[None]:
    """A thread that sends the message again and again, and has ended with the block: unlike `send_periodic`'s."""
    stop = threading.Event()

    def send() -> None:
        while not stop.wait(period_s):
            bus.send(message)

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def until(condition: Callable[[], bool]) -> None:
    """Ask until it holds."""
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end
        threading.Event().wait(0.002)
