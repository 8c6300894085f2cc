"""What the tests of live commands share: a node on a virtual bus, and work that begins once the command listens."""

from __future__ import annotations

import itertools
import os
import signal
import threading
from collections.abc import Callable
from typing import Any

import can
import pytest

from aces_tools.bus_arg import ChosenBus

WAIT_S = 60.0
posix = pytest.mark.skipif(os.name != "posix", reason="pseudo-terminals, signals and pipes of a Unix system")
_numbers = itertools.count()


class Node:
    """Another node of a virtual bus without physics: what it sends is there at once, what comes it keeps."""

    def __init__(self, *, fd: bool = False) -> None:
        self.channel = f"test{next(_numbers)}"
        self.bus = can.Bus(interface="aces", channel=self.channel, physics=False, fd=fd)
        self.options = ["-i", "aces", "-c", self.channel, "--bus-kwargs", "physics=false"]
        if fd:
            self.options.append("--fd")

    def send(self, identifier: int, data: str = "", **more: Any) -> None:
        """Send a frame; the data in hexadecimal."""
        more = {"is_extended_id": identifier > 0x7FF, "check": True, **more}
        self.bus.send(can.Message(arbitration_id=identifier, data=bytes.fromhex(data), **more))

    def walk(self) -> None:
        """Send five frames; to the protocol `arm`: two decoded, one malformed, one unknown, one decoded."""
        self.send(0x060, "0A000000F6FFFFFF")
        self.send(0x300, "02090064000080BF")
        self.send(0x060, "0102")
        self.send(0x7FE, "DEADBEEF")
        self.send(0x061, "0B000000F5FFFFFF")

    def received(self, timeout: float = 0.0) -> list[can.Message]:
        """What has come; with a timeout, at least one is waited for."""
        found: list[can.Message] = []
        while (message := self.bus.recv(timeout if not found else 0)) is not None:
            found.append(message)
        return found

    def close(self) -> None:
        self.bus.shutdown()


class Opened:
    """Set once a command has opened its bus; `then` runs work on a thread of its own after that."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.event = threading.Event()
        #: The gates that were started.
        self.gates: list[Any] = []
        self.threads: list[threading.Thread] = []
        self.count = 1
        original = ChosenBus.start

        def start(bus: ChosenBus, gate: Any) -> None:
            original(bus, gate)
            self.gates.append(gate)
            if len(self.gates) >= self.count:
                self.event.set()

        monkeypatch.setattr(ChosenBus, "start", start)

    def wait_for(self, count: int) -> None:
        """Take so many buses as what has to be open."""
        self.count = count

    def then(self, work: Callable[[], object]) -> None:
        """Do this once the bus is open."""

        def wait() -> None:
            assert self.event.wait(WAIT_S)
            work()

        thread = threading.Thread(target=wait, daemon=True)
        self.threads.append(thread)
        thread.start()

    def join(self) -> None:
        for thread in self.threads:
            thread.join(WAIT_S)


def interrupt() -> None:
    """Ctrl-C."""
    os.kill(os.getpid(), signal.SIGINT)
