"""A node that watches over its host: without the host's heartbeat it goes into its fault reaction, or to safe outputs.

1. It watches while it may move: enabling it, or its first output, begins that, and a stop that is confirmed ends it: an
   orderly end is not a fault.
2. One heartbeat a bus, whatever the number of nodes, sent by the thread of the buses: a host that hangs sends none.
3. Only where the node's file has object 1016; a drive that says that it would do nothing (6007 is 0) is set to a fault.

An entry of object 1016 is `node << 16 | ms`; a node watches from that node's first heartbeat on (CiA 301).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from aces_bus.device import Steps
from aces_bus.errors import AcesError, CallerError, DeviceError

from .sdo import SdoRefused

if TYPE_CHECKING:
    from .node import CanopenNode

CONSUMER = 0x1016
#: What a drive does when its connection is lost, object 6007: nothing; go into fault.
NO_ACTION, FAULT = 0, 1
#: So many heartbeats go into the time that a node waits.
BEATS = 4


class Watchdog:
    """One node's watch over the host; `reactions` are its objects that say what it does without (6007 of each axis)."""

    def __init__(
        self, device: CanopenNode, wait_ms: int, host_node: int, reactions: Sequence[int] = ()
    ) -> None:
        self.device, self.wait_ms, self.host_node, self.reactions = device, wait_ms, host_node, reactions
        #: The entry of object 1016 that is ours while it watches; None: it does not.
        self.entry: int | None = None
        self._beats = False
        if host_node == device.credentials["node"]:
            raise CallerError(
                f"{device.name}: host_node = {host_node} is the node's own number; give another"
            )

    @property
    def is_possible(self) -> bool:
        """True if the watchdog is wanted, and the node's file has the object."""
        return bool(self.wait_ms) and self.device.dictionary.get_variable(CONSUMER, 1) is not None

    def begin(self) -> Steps:
        """Have the node watch. Fails with `DeviceError` where all its entries watch others."""
        if not self.is_possible or self.entry is not None:
            return
        device = self.device
        entry = yield from self._free()
        for index in self.reactions:
            yield from self._react(index)
        yield device.sdo.download(
            CONSUMER, entry, (self.host_node << 16 | self.wait_ms).to_bytes(4, "little")
        )
        self.entry = entry
        if not self._beats:
            self._beats = True
            self._beat()

    def end(self) -> Steps:
        """Have it watch no more, for it is stopped."""
        entry = self.entry
        if entry is None:
            return
        try:
            yield self.device.sdo.download(CONSUMER, entry, (self.host_node << 16).to_bytes(4, "little"))
        except AcesError:
            return  # heartbeats go on as long as there is a host; then it is a fault of a node that is off
        self.entry = None

    def forget(self) -> None:
        """Note that the node has booted, and does not watch the host any more."""
        self.entry = None

    def _free(self) -> Steps:
        """Return the entry that is ours already, or the first that is free."""
        sdo = self.device.sdo
        count: bytes = yield sdo.upload(CONSUMER, 0)
        free: int | None = None
        for number in range(1, count[0] + 1):
            data: bytes = yield sdo.upload(CONSUMER, number)
            node, wait_ms = data[2], int.from_bytes(data[:2], "little")
            if node == self.host_node:
                return number
            if free is None and not (node and wait_ms):
                free = number
        if free is None:
            raise DeviceError(
                f"{self.device.name}: it cannot watch over the host: all {count[0]} entries of object 1016 watch other"
                " nodes; clear one, or watchdog_ms = 0 does without"
            )
        return free

    def _react(self, index: int) -> Steps:
        """Return whether the drive does something when the host is gone; else it is to."""
        device = self.device
        if device.dictionary.get_variable(index, 0) is None:
            return
        try:
            data: bytes = yield device.sdo.upload(index, 0)
            if int.from_bytes(data, "little", signed=True) == NO_ACTION:
                yield device.sdo.download(index, 0, FAULT.to_bytes(2, "little"))
        except SdoRefused as error:
            raise DeviceError(
                f"{device.name}: {error}; watchdog_ms = 0 does without its watch over the host"
            ) from error

    def _beat(self) -> None:
        """Have the first of the bus's nodes that watch this number send the heartbeat for all of them."""
        device = self.device
        if self.entry is None:
            self._beats = False
            return
        mates = (getattr(node, "watchdog", None) for node in device.host.devices.values())
        watching = [mate for mate in mates if isinstance(mate, Watchdog) and mate.entry is not None]
        leader = next(watchdog for watchdog in watching if watchdog.host_node == self.host_node)
        if leader is self and device.host.is_open:
            device.send("Heartbeat", node=self.host_node, state="operational", toggle=0)
        wait_ms = min(watchdog.wait_ms for watchdog in watching)
        device.clock.call_in(wait_ms * 1_000_000 // BEATS, self._beat)
