"""A pseudo-terminal onto a simulated serial line: foreign programs open it like any port.

1. Foreign programs block in real time, so the line is paced: virtual time follows this machine's clock.
2. One thread moves bytes and time; it ends with `close`, and then the port is gone, as if unplugged.
"""

from __future__ import annotations

import os
import select
import threading
import time
from typing import Self

from ...errors import CallerError
from .serial_line import SerialNode, SimulatedSerialLine

#: Seconds after which time is moved on though nothing came.
STEP_S = 0.002


class PtyPort:
    """One end of a `SimulatedSerialLine` as a port: `path` is what programs open.

    with PtyPort(wire) as port: subprocess.run(["tool", port.path])

    Everything else on the wire runs on this object's thread; use `with port.lock:` to touch it from another.
    """

    def __init__(self, wire: SimulatedSerialLine, name: str = "pty") -> None:
        try:
            import tty
        except ImportError as error:  # Windows
            raise CallerError("pseudo-terminals are not to be had on this system") from error
        self.wire = wire
        self.lock = threading.RLock()
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)
        #: Bytes that the program did not read in time.
        self.dropped = 0
        self.node: SerialNode = wire.attach(name, self._received, echo=False)
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
            ready, _, _ = select.select([self._master], [], [], STEP_S)
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
                if data:
                    self.node.send(data)

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
