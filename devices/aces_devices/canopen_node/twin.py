"""The twin of a CANopen node: a local node of `canopen` with the node's dictionary.

1. `canopen` answers SDO and NMT and repeats heartbeats; block transfers are ours (`sdo_server`), and so are PDOs: its local
   node takes no RPDO (canopen 2.4).
2. What canopen sends is read by the spec and leaves as that message: so the twin misbehaves as all twins do.
3. It watches over the nodes that object 1016 names, each from its first heartbeat on (CiA 301).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from aces_bus import Frame, as_dict, make_scanner
from aces_bus.device import Twin
from aces_bus.protocol import Record
from aces_bus.runtime.clock import Timer

from .pdo import RECEIVED, SENT, PdoEntry, PdoLayout, layouts
from .watchdog import CONSUMER

if TYPE_CHECKING:
    from canopen import ObjectDictionary

#: From power to the boot-up message (ns).
BOOT_NS = 1_000_000
RESETS = ("reset_node", "reset_communication")
#: Emergency: no heartbeat of the host; its error register (object 1001).
HOST_GONE, HOST_GONE_REGISTER = 0x8130, 0x11
#: Emergency: a PDO was not processed for its length.
PDO_SHORT = 0x8210


class CanopenTwin(Twin):
    """NMT, SDO, heartbeat, PDOs at SYNC or on a timer, the watch over the host. A kind of node says what its objects do."""

    protocol = "canopen"
    faults: ClassVar = {
        "no_heartbeat": "sends no heartbeat",
        "refuses": "refuses every SDO transfer (abort 08000022)",
        "no_pdo": "sends no PDOs",
    }
    network: Any = None
    #: By node: when its heartbeat is missed.
    _watched: dict[int, Timer]

    # ------------------------------------------------------------------ for kinds of nodes

    def take_object(self, index: int, subindex: int, value: int, now: int) -> None:
        """Take a number that was written in a PDO or over SDO."""

    def object_value(self, index: int, subindex: int, now: int) -> Any:
        """Return what an object says now; None: what the dictionary has."""
        return None

    def lost_host(self, now: int) -> None:
        """React to the loss of the host's heartbeat."""

    def changed_state(self, state: str, now: int) -> None:
        """React to a state that network management has set, as canopen calls it."""

    def in_order(self, places: Sequence[PdoEntry]) -> Iterable[PdoEntry]:
        """Return the objects of a PDO in the order in which they are taken."""
        return places

    # ------------------------------------------------------------------ its node

    def add_node(self, dictionary: ObjectDictionary) -> None:
        """Create the node as if just switched on; call this in `setup`. Its boot-up message follows."""
        import canopen

        from .network import StationNetwork
        from .sdo_server import BlockSdoServer

        if self.network is not None:
            self.network.stop()
        number = self.credentials["node"]
        self.dictionary = dictionary
        self._scanner = make_scanner([self.variant], direction="from device")
        self.network = network = StationNetwork(self.clock, self._put)
        node: Any = canopen.LocalNode(number, dictionary)
        node.sdo = BlockSdoServer(0x600 + number, 0x580 + number, node)
        self.node = node
        network[number] = node
        node.add_read_callback(self._read)
        node.add_write_callback(self._written)
        self.inputs: dict[int, PdoLayout] = {}
        self.outputs: dict[int, PdoLayout] = {}
        self._pending: dict[int, bytes] = {}
        self._syncs = 0
        self._timers_of_pdos: list[Any] = []
        self._end_watch()
        self.clock.call_in(BOOT_NS, lambda: self._boot(network))

    def _boot(self, network: Any) -> None:
        if network is self.network and self.is_powered:
            self.node.nmt.state = "INITIALISING"  # says so
            self.node.nmt.state = "PRE-OPERATIONAL"

    # ------------------------------------------------------------------ hearing

    def received(self, record: Record, instant: int) -> None:
        """Take all messages of the spec."""
        name = type(record).__name__
        state = self.node.nmt.state
        if name in ("Sync", "SyncCounter"):
            if state == "OPERATIONAL":
                self._sync(instant)
        elif name.startswith("Rpdo"):
            if state == "OPERATIONAL":
                self._process(int(name[-1]), record.data, instant)
        elif name == "Nmt":
            self._nmt(record)
        elif name.startswith("Sdo") and state != "STOPPED":
            if "refuses" in self.active_faults and name != "SdoAbort":
                index, subindex = getattr(record, "index", 0), getattr(record, "subindex", 0)
                self.reply("SdoAborted", index=index, subindex=subindex, code="device_state")
                return
            self.network.notify(record.meta.identifier, bytearray(record.meta.raw), instant / 1e9)

    def _nmt(self, record: Record) -> None:
        if record.command in RESETS:
            self.setup()
            return
        self.node.nmt.on_command(0, bytearray(record.meta.raw), 0.0)
        self._end_timers_of_pdos()
        if self.node.nmt.state == "OPERATIONAL":
            self.inputs, self.outputs = self._layouts(RECEIVED), self._layouts(SENT)
            self._repeat()
        self.changed_state(self.node.nmt.state, self.clock.now())

    def received_by_others(self, record: Record, instant: int) -> bool:
        """Return the heartbeat of a node that it may watch over."""
        if type(record).__name__ != "Heartbeat":
            return False
        node = record.node
        timer = self._watched.pop(node, None)
        if timer is not None:
            timer.cancel()
        if self.is_powered:
            for wait_ms in self._waits_for(node):
                self._watched[node] = self.clock.call_in(wait_ms * 1_000_000, lambda: self._lost(node))
        return True

    def _waits_for(self, node: int) -> list[int]:
        """Return how long it waits for a node's heartbeat (ms), in none or one entry of object 1016."""
        if CONSUMER not in self.dictionary:
            return []
        entries = [self.number(CONSUMER, n) for n in range(1, self.number(CONSUMER, 0) + 1)]
        return [entry & 0xFFFF for entry in entries if entry >> 16 & 0xFF == node and entry & 0xFFFF][:1]

    def _lost(self, node: int) -> None:
        """React to the loss of a watched node as the kind of node does; ignore PDOs from now on (1029 is 0)."""
        self._watched.pop(node, None)
        if not self._waits_for(node):  # its consumer entry was cleared
            return
        self.lost_host(self.clock.now())
        self.send_emergency(HOST_GONE, HOST_GONE_REGISTER)
        if self.node.nmt.state == "OPERATIONAL":
            self._end_timers_of_pdos()
            self.node.nmt.state = "PRE-OPERATIONAL"

    def _end_watch(self) -> None:
        for timer in getattr(self, "_watched", {}).values():
            timer.cancel()
        self._watched = {}

    def _end_timers_of_pdos(self) -> None:
        for timer in self._timers_of_pdos:
            timer.stop()
        self._timers_of_pdos.clear()

    def _layouts(self, side: tuple[int, int, int]) -> dict[int, PdoLayout]:
        """Return the PDOs as the dictionary has them now."""

        def value(index: int, subindex: int) -> int | None:
            known = self.dictionary.get_variable(index, subindex)
            return None if known is None else self.number(index, subindex)

        return layouts(self.name, self.dictionary, self.node.id, side, value)

    def number(self, index: int, subindex: int) -> int:
        """Return an object's number, as SDO reads it."""
        return int.from_bytes(self.node.get_data(index, subindex), "little")

    def _process(self, number: int, data: bytes, now: int) -> None:
        """Process an RPDO, at once or at the next SYNC."""
        layout = self.inputs.get(number)
        if layout is None:
            return
        if len(data) < layout.size:
            self.send_emergency(PDO_SHORT, HOST_GONE_REGISTER)
        elif layout.is_synchronous:
            self._pending[number] = data
        else:
            self._take(layout, data, now)

    def _sync(self, now: int) -> None:
        self._syncs += 1
        for number, data in sorted(self._pending.items(), reverse=True):
            self._take(self.inputs[number], data, now)
        self._pending.clear()
        for number, layout in self.outputs.items():
            if layout.is_synchronous and self._syncs % max(1, layout.kind) == 0:
                self.send_pdo(number, layout, now)

    def _repeat(self) -> None:
        """Send PDOs that go out by themselves: on a timer, which also decides how soon a change is seen."""
        from .network import Periodic

        for number, layout in self.outputs.items():
            if layout.is_synchronous or not layout.event_ms:
                continue

            def send(_: bytes, number: int = number, layout: PdoLayout = layout) -> None:
                self.send_pdo(number, layout, self.clock.now())

            self._timers_of_pdos.append(Periodic(self.clock, layout.event_ms / 1000, send, b""))

    def _take(self, layout: PdoLayout, data: bytes, now: int) -> None:
        word = int.from_bytes(data, "little")
        for place in self.in_order(layout.places):
            self.take_object(place.index, place.subindex, place.take(word), now)

    def send_pdo(self, number: int, layout: PdoLayout, now: int) -> None:
        """Send a PDO as its objects are now."""
        if "no_pdo" in self.active_faults:
            return
        word = 0
        for place in layout.places:
            value = self.object_value(place.index, place.subindex, now)
            if value is None:
                value = self.number(place.index, place.subindex)
            word = place.put(word, value)
        self.reply(f"Tpdo{number}", data=word.to_bytes(layout.size, "little"))

    # ------------------------------------------------------------------ the dictionary

    def _read(self, index: int, subindex: int, od: Any) -> Any:
        """Return what the node knows better than the dictionary."""
        return self.object_value(index, subindex, self.clock.now())

    def _written(self, index: int, subindex: int, od: Any, data: bytes) -> None:
        value = od.decode_raw(bytes(data))
        if isinstance(value, int):
            self.take_object(index, subindex, value, self.clock.now())

    # ------------------------------------------------------------------ saying

    def _put(self, identifier: int, data: bytes) -> None:
        """Send a frame that canopen has made."""
        if not self.is_powered or ("no_heartbeat" in self.active_faults and identifier & 0x780 == 0x700):
            return
        for record in self._scanner.feed([Frame(identifier, data)]):
            fields = as_dict(record)
            fields.pop("node", None)
            self.reply(type(record).__name__, **fields)

    def send_emergency(self, code: int, register: int) -> None:
        """Say that there is an error; code 0: that it is over."""
        if self.node.nmt.state in ("OPERATIONAL", "PRE-OPERATIONAL"):
            self.node.emcy.send(code, register)

    # ------------------------------------------------------------------ off

    def power(self, on: bool) -> None:
        """Switch it off, or on again."""
        if not on:
            self._end()
        super().power(on)

    def stop(self) -> None:
        """End what repeats."""
        super().stop()
        self._end()

    def _end(self) -> None:
        self.network.stop()
        self._end_timers_of_pdos()
        self._end_watch()
