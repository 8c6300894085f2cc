"""One end of a simulated serial line as a TCP port of this machine, where the system has no pseudo-terminals."""

from __future__ import annotations

import select
import socket
import threading
import time

from .serial_line import SimulatedSerialLine


class TcpPort:
    """One end of a simulated line at a TCP port of this machine: `path` is what `serial.serial_for_url` takes."""

    def __init__(self, wire: SimulatedSerialLine) -> None:
        self.wire, self.lock = wire, threading.RLock()
        self._server = socket.create_server(("127.0.0.1", 0))
        self.path = f"socket://127.0.0.1:{self._server.getsockname()[1]}"
        self._peer: socket.socket | None = None
        self.node = wire.attach("tcp", self._received, echo=False, whole=True)
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._run, name=self.path, daemon=True)
        self._thread.start()

    def _received(self, data: bytes, instant: int) -> None:
        try:
            if self._peer is not None:
                self._peer.sendall(data)
        except OSError:
            self._hang_up()

    def _hang_up(self) -> None:
        if self._peer is not None:
            self._peer.close()
        self._peer = None

    def _run(self) -> None:
        while not self._is_over.is_set():
            waits = [self._server, *([] if self._peer is None else [self._peer])]
            ready, _, _ = select.select(waits, [], [], 0.002)
            data = b""
            with self.lock:
                self.wire.clock.sleep_until(time.monotonic_ns())
                if self._server in ready:
                    self._hang_up()
                    self._peer = self._server.accept()[0]
                elif self._peer is not None and self._peer in ready:
                    try:
                        data = self._peer.recv(4096)
                    except OSError:
                        pass
                    self.node.send(data) if data else self._hang_up()

    def close(self) -> None:
        """Take the port away."""
        self._is_over.set()
        self._thread.join(5.0)
        self._hang_up()
        self._server.close()
