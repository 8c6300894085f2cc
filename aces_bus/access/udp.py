"""The original's UDP service: one port for each state; `GET`, `SET <number>`, `SMP`.

1. Loopback only unless another address is named; `SET` does nothing unless `allow_set`.
2. A datagram is junk until it is one of the three: longer than 128 bytes, another word, no number. Junk is counted and gets
   no answer, so that nothing can be reflected off this service but an answer shorter than 400 bytes to its own asker.
3. It never waits: sockets do not block, and an answer that the system does not take is counted and gone.

*Facts* (acesHubo, state/matlab.hpp): datagrams are ASCII; `GET` is answered by C's "%f" without a terminator, `SET` and
`SMP` ("one sample request downstream") by nothing; ports are arguments of each state, 2827 and up in the scripts.
*Choice*: an unknown or stale value is answered by `nan`, as "%f" writes it; the original answered its last one.
"""

from __future__ import annotations

import math
import re
import selectors
import socket
import threading
from collections.abc import Mapping, Sequence
from typing import Any, Self

from ..errors import CallerError, UnknownNameError
from ..runtime import VirtualClock
from ..runtime.clock import EventClock, Timer
from ..state.quantity import TimeSeries
from .inlet import AccessEvents, Inlet

#: The longest request.
LONGEST = 128
#: The first port of the original's scripts.
FIRST_PORT = 2827
#: Datagrams taken from one port before the next has its turn.
AT_ONCE = 32
#: How often ports are looked at in virtual time (ns), which does not wait for them.
POLL_NS = 5_000_000
NUMBER = re.compile(rb"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,4})?")


class UdpStates:
    """Serves states by UDP. `ports` is a port for each state, 0 for a free one; or names, from `first_port` on.

        with UdpStates(run.states, ["RHY", "LHY"], clock=run.clock) as service:
            print(service.ports)    # {'RHY': 2827, 'LHY': 2828}

    `gets`, `samples`, `sets` and `refused` count requests; `junk` what was none, `unanswered` answers that did not get out.
    Under a `VirtualClock` ports are looked at every 5 ms of its time, without a thread.
    """

    def __init__(
        self,
        states: Mapping[str, TimeSeries],
        ports: Mapping[str, int] | Sequence[str],
        *,
        clock: EventClock,
        address: str = "127.0.0.1",
        first_port: int = FIRST_PORT,
        allow_set: bool = False,
    ) -> None:
        if not isinstance(ports, Mapping):
            ports = {name: first_port + place for place, name in enumerate(ports)}
        for name, port in ports.items():
            if name not in states:
                raise UnknownNameError("state (a UDP port is for it)", name, states)
            if not 0 <= port <= 0xFFFF:
                raise CallerError(f"{name}: {port} is not a UDP port (0 to 65535)")
        fixed = [port for port in ports.values() if port]
        if len(set(fixed)) < len(fixed):
            raise CallerError("two states have one UDP port")
        self.states = {name: states[name] for name in ports}
        self.clock, self.address, self.allow_set = clock, address, allow_set
        self.events = AccessEvents()
        self.gets = self.samples = self.sets = self.junk = self.unanswered = 0
        self._asked = dict(ports)
        self._inlet = Inlet(clock, self.states, self.events, "udp", all_states=states)
        self._sockets: dict[str, socket.socket] = {}
        self._thread: threading.Thread | None = None
        self._timer: Timer | None = None
        self._wake: tuple[socket.socket, socket.socket] | None = None

    @property
    def ports(self) -> dict[str, int]:
        """The port of each state, once it is open."""
        return {name: sock.getsockname()[1] for name, sock in self._sockets.items()} or dict(self._asked)

    @property
    def refused(self) -> int:
        """Set-points that were not taken."""
        return self._inlet.refused

    def open(self) -> Self:
        """Listen. Raises `CallerError` for an address or port that cannot be had."""
        if self._sockets:
            return self
        for name, port in self._asked.items():
            try:
                kind = socket.AF_INET6 if ":" in self.address else socket.AF_INET
                one = socket.socket(kind, socket.SOCK_DGRAM)
                self._sockets[name] = one
                one.setblocking(False)
                one.bind((self.address, port))
            except OSError as error:
                self.close()
                raise CallerError(
                    f"{name}: UDP port {port} of {self.address} cannot be had: {error.strerror or error}"
                ) from error
        if isinstance(self.clock, VirtualClock):
            self._timer = self.clock.call_in(POLL_NS, self._look)
        else:
            self._wake = socket.socketpair()
            self._thread = threading.Thread(target=self._serve, name="udp states", daemon=True)
            self._thread.start()
        return self

    def close(self) -> None:
        """Listen no more; twice does nothing."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self._wake is not None:
            self._wake[1].close()
        if self._thread is not None:
            self._thread.join(5.0)
            self._thread = None
        if self._wake is not None:
            self._wake[0].close()
            self._wake = None
        for sock in self._sockets.values():
            sock.close()
        self._sockets = {}
        self._inlet.give_up()

    def __enter__(self) -> Self:
        return self.open()

    def __exit__(self, *_: object) -> None:
        self.close()

    # ------------------------------------------------------------------ serving

    def poll(self) -> int:
        """Answer what waits at the ports now; how many datagrams that were."""
        return sum(self._take(name, sock) for name, sock in self._sockets.items())

    def _look(self) -> None:
        self.poll()
        if isinstance(self.clock, VirtualClock) and self._timer is not None:
            self._timer = self.clock.call_in(POLL_NS, self._look)

    def _serve(self) -> None:
        assert self._wake is not None
        ended = self._wake[0]
        with selectors.DefaultSelector() as selector:
            selector.register(ended, selectors.EVENT_READ)
            for name, sock in self._sockets.items():
                selector.register(sock, selectors.EVENT_READ, name)
            while True:
                for key, _ in selector.select():
                    if key.fileobj is ended:
                        return
                    self._take(key.data, key.fileobj)  # type: ignore[arg-type]

    def _take(self, name: str, sock: socket.socket) -> int:
        for count in range(AT_ONCE):
            try:
                data, asker = sock.recvfrom(LONGEST + 1)
            except (BlockingIOError, InterruptedError):
                return count
            except (
                OSError
            ):  # an asker that is gone, as some systems tell; or a datagram longer than asked for
                self.junk += 1
                continue
            answer = self._answer(name, data)
            if answer is not None:
                try:
                    sock.sendto(answer, asker)
                except OSError:
                    self.unanswered += 1
        return AT_ONCE

    def _answer(self, name: str, data: bytes) -> bytes | None:
        text = b"" if len(data) > LONGEST else data.strip(b" \t\r\n\0")
        if text == b"GET":
            self.gets += 1
            return b"%f" % _value(self.states[name])
        if text == b"SMP":
            self.samples += 1
            self._inlet.ask(name)
            return None
        word, _, rest = text.partition(b" ")
        number = rest.strip()
        if word != b"SET" or NUMBER.fullmatch(number) is None:
            self.junk += 1
            return None
        self.sets += 1
        if self.allow_set:
            self._inlet.put({name: float(number)})
        return None


def _value(state: Any) -> float:
    """Return its newest value; NaN where that is not known."""
    try:
        value = float(state[0])
    except Exception:  # UNKNOWN, or a derived quantity's own
        return math.nan
    return value
