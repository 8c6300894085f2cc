"""The gatekeeper of UDP datagrams.

1. The rules of `gate`. A datagram is whole or not there, and comes with its sender's address.
2. It binds to loopback unless another address is named: other machines are not listened to by accident.
"""

from __future__ import annotations

import socket

from ..errors import CallerError
from ..runtime.clock import Clock
from .gate import POLL_S, Gate, Received
from .queues import Report

Address = tuple[str, int]

#: The longest payload of a UDP datagram over IPv4.
MOST = 65_507
OUTBOX = 4096
#: Datagrams that a loop reads in one turn, at most.
BATCH = 64


class DatagramGate(Gate[bytes, tuple[bytes, Address], socket.socket]):
    """One UDP socket and its only owner.

    `bind` is (address, port) to receive at; port 0 takes a free one, which `address` then tells. `peer` is where `send`
    goes without an address; with `only_peer` datagrams of others are counted as bad input and not handed on.
    """

    items = unit = "datagrams"
    most = OUTBOX

    def __init__(
        self,
        bind: Address = ("127.0.0.1", 0),
        *,
        peer: Address | None = None,
        only_peer: bool = False,
        name: str = "",
        listen_only: bool = False,
        reopen: bool = True,
        clock: Clock | None = None,
    ) -> None:
        super().__init__(
            name or f"udp {bind[0]}:{bind[1]}", listen_only=listen_only, reopen=reopen, clock=clock
        )
        self.bind, self.peer, self.only_peer = bind, peer, only_peer
        if only_peer and peer is None:
            raise CallerError(f"{self.name}: only_peer needs a peer")

    def _opened(self) -> socket.socket:
        made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            made.bind(self.bind)
            made.settimeout(POLL_S)
        except BaseException:
            made.close()
            raise
        return made

    def _shut(self, bus: socket.socket) -> None:
        bus.close()

    @staticmethod
    def _describe(bus: socket.socket) -> str:
        return "{}:{}".format(*bus.getsockname())

    @property
    def address(self) -> Address:
        """Address that the gate receives at; raises `CallerError` while the gate is closed."""
        if self.state in ("new", "closed"):
            raise CallerError(f"{self.name}: this gate is not open")
        host, port = self._bus.getsockname()
        return str(host), int(port)

    def _file_of(self, bus: socket.socket) -> int | None:
        return bus.fileno()

    def _watched(self, bus: socket.socket) -> None:
        bus.setblocking(False)

    def _read_now(self) -> list[Received[bytes]]:
        found: list[Received[bytes]] = []
        while len(found) < BATCH:
            try:
                data, source = self._bus.recvfrom(65_536)
            except BlockingIOError:
                break
            except ConnectionError:  # what we sent reached no socket: some systems say so here
                continue
            self._take(data, source, found)
        return found

    def _take(self, data: bytes, source: Address, found: list[Received[bytes]]) -> None:
        """Add a datagram to what was found, if it may be there."""
        if self.only_peer and source != self.peer:
            self.counters.bad_input += 1
            self._emit("bad input", f"a datagram of {source[0]}:{source[1]}, who is not the peer")
            return
        self.counters.received += 1
        found.append(Received(data, self.clock.now(), source=source))

    def _receive(self) -> None:
        while not self._stopping.is_set():
            try:
                data, source = self._bus.recvfrom(65_536)
            except TimeoutError:
                continue
            except ConnectionError:  # what we sent reached no socket: some systems say so here
                continue
            except OSError as error:
                if self._stopping.is_set() or not self._lose(error):
                    return
                continue
            found: list[Received[bytes]] = []
            self._take(data, source, found)
            self._put(found)

    def send(
        self,
        data: bytes,
        to: Address | None = None,
        *,
        age_s: float | None = None,
        urgent: bool = False,
        topic: object = None,
        report: Report | None = None,
    ) -> bool:
        """Queue a datagram to `to`, by default to the peer. The options, and what it returns, are those of `CanGate.send`.

        Raises `CallerError` when this gate only listens, is not open, knows no address, or the datagram is too long.
        """
        self._check_may_send()
        address = to if to is not None else self.peer
        if address is None:
            raise CallerError(f"{self.name}: to whom? Give an address or a peer")
        if len(data) > MOST:
            raise CallerError(f"{self.name}: a datagram carries at most {MOST} bytes, not {len(data)}")
        return self._queue((bytes(data), address), 1, 0, age_s, urgent, topic, report)

    def _name_of(self, datagram: tuple[bytes, Address]) -> str:
        return "to {}:{}".format(*datagram[1])

    def _put_out(self, datagram: tuple[bytes, Address]) -> None:
        self._bus.sendto(*datagram)

    def _can_put_together(self) -> bool:
        return True

    def _put_together(self, datagrams: list[tuple[bytes, Address]]) -> tuple[int, Exception | None]:
        for number, (data, to) in enumerate(datagrams):
            try:
                self._bus.sendto(data, to)
            except BlockingIOError:
                return number, None
            except Exception as error:
                return number, error
        return len(datagrams), None
