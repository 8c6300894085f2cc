"""The twin of a CiA 402 drive: a local node of `canopen` with the drive's dictionary, and axes that move.

1. `canopen` answers SDO and NMT and repeats heartbeats; block transfers are ours (`sdo_server`), and so are PDOs: its local
   node takes no RPDO (canopen 2.4).
2. What canopen sends is read by the spec and leaves as that message: so the twin misbehaves as all twins do.
3. It begins as a drive does: a boot-up message, pre-operational, "switch on disabled".
4. It watches over the nodes that object 1016 names, each from its first heartbeat on (CiA 301).
"""

from __future__ import annotations

from typing import Any, ClassVar

from aces_bus import Frame
from aces_bus.device import Twin
from aces_bus.device.settings import settings_of
from aces_bus.protocol import make_scanner
from aces_bus.protocol.record import as_dict
from aces_bus.runtime import Timer

from ..canopen_node.pdo import RECEIVED, SENT, PdoLayout, layouts, offset_of
from .dictionary import dictionary_of
from .model import HOST_GONE, HOT, OVER_VOLTAGE, REGISTERS, AxisModel
from .units import DriveSettings, units_of
from .watchdog import CONSUMER

#: From power to the boot-up message (ns).
BOOT_NS = 1_000_000
RESETS = ("reset_node", "reset_communication")


class Cia402Twin(Twin):
    """A drive: state machine, profile and cyclic modes, homing, limits, emergencies, PDOs at SYNC or on a timer."""

    protocol = "canopen"
    faults: ClassVar = {
        "jammed": "the joint is blocked: a following error when it is to move",
        "over_voltage": "too high a voltage inside: a fault, until it is gone and acknowledged",
        "hot": "warns of its temperature",
        "no_home": "homing does not find its switch",
        "no_heartbeat": "sends no heartbeat",
        "refuses": "refuses every SDO transfer (abort 08000022)",
        "no_pdo": "sends no PDOs",
    }
    network: Any = None
    #: By node: when its heartbeat is missed.
    _watched: dict[int, Timer]

    def setup(self) -> None:
        """The node and its axes, as just switched on."""
        import canopen

        from ..canopen_node.network import StationNetwork
        from ..canopen_node.sdo_server import BlockSdoServer

        if self.network is not None:
            self.network.stop()
        settings = settings_of(self.name, DriveSettings, self.config.settings)
        number = self.credentials["node"]
        self.dictionary = dictionary_of(settings.eds, number)
        self._scanner = make_scanner([self.variant], direction="from device")
        self.network = network = StationNetwork(self.clock, self._put)
        node: Any = canopen.LocalNode(number, self.dictionary)
        node.sdo = BlockSdoServer(0x600 + number, 0x580 + number, node)
        self.node = node
        network[number] = node
        node.add_read_callback(self._read)
        node.add_write_callback(self._written)
        now = self.clock.now()
        self.axes: dict[int, AxisModel] = {}
        for joint in self.joints:
            offset = 0x800 * joint.channel
            units = units_of(self.name, joint, settings)
            old = self.world.joints.get(joint.name)
            made = AxisModel(joint, units, self._numbers(offset), now, self._emergency)
            # Switched off, it stays where it was.
            place = old.position(now) if isinstance(old, AxisModel) else self.world.start_of(joint.name)
            if place:
                made.motor.q = place
                made.demand = made.goal = made.motor.q * units.per_rad + units.zero
            self.axes[offset] = self.world.joints[joint.name] = made
        self.inputs: dict[int, PdoLayout] = {}
        self.outputs: dict[int, PdoLayout] = {}
        self._pending: dict[int, bytes] = {}
        self._syncs = 0
        self._timers_of_pdos: list[Any] = []
        self._end_watch()
        self._apply_faults()
        self.clock.call_in(BOOT_NS, lambda: self._boot(network))

    def _numbers(self, offset: int) -> dict[int, int]:
        """The numbers of an axis in the dictionary."""
        found: dict[int, int] = {}
        for index, entry in self.dictionary.items():
            if index < 0x6000 or offset_of(index) != offset:
                continue
            members = [entry] if hasattr(entry, "data_type") else entry.values()
            for one in members:
                value = one.value if one.value is not None else one.default
                if isinstance(value, int):
                    key = index - offset if one is entry else (index - offset) << 8 | one.subindex
                    found[key] = value
        return found

    def _boot(self, network: Any) -> None:
        if network is self.network and self.is_powered:
            self.node.nmt.state = "INITIALISING"  # says so
            self.node.nmt.state = "PRE-OPERATIONAL"

    # ------------------------------------------------------------------ hearing

    def heard(self, record: Any, instant: int) -> None:
        """All messages of the spec."""
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

    def _nmt(self, record: Any) -> None:
        if record.command in RESETS:
            self.setup()
            return
        self.node.nmt.on_command(0, bytearray(record.meta.raw), 0.0)
        self._end_timers_of_pdos()
        if self.node.nmt.state == "OPERATIONAL":
            self.inputs, self.outputs = self._layouts(RECEIVED), self._layouts(SENT)
            self._repeat()

    def overheard(self, record: Any, instant: int) -> bool:
        """The heartbeat of a node that it may watch over."""
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
        """How long it waits for a node's heartbeat (ms), in none or one entry of object 1016."""
        if CONSUMER not in self.dictionary:
            return []
        entries = [self._number(CONSUMER, n) for n in range(1, self._number(CONSUMER, 0) + 1)]
        return [entry & 0xFFFF for entry in entries if entry >> 16 & 0xFF == node and entry & 0xFFFF][:1]

    def _lost(self, node: int) -> None:
        """A node that it watches over is gone: what object 6007 says; PDOs are ignored from now on (1029 is 0)."""
        self._watched.pop(node, None)
        if not self._waits_for(node):  # it was told not to watch any more
            return
        now = self.clock.now()
        for axis in self.axes.values():
            axis.advance(now)
            axis.lost_connection()
        self._emergency(HOST_GONE, REGISTERS[HOST_GONE])
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
        """The PDOs as the dictionary has them now."""

        def value(index: int, subindex: int) -> int | None:
            known = self.dictionary.get_variable(index, subindex)
            return None if known is None else self._number(index, subindex)

        return layouts(self.name, self.dictionary, self.node.id, side, value)

    def _number(self, index: int, subindex: int) -> int:
        return int.from_bytes(self.node.get_data(index, subindex), "little")

    def _process(self, number: int, data: bytes, now: int) -> None:
        """An RPDO: at once, or at the next SYNC."""
        layout = self.inputs.get(number)
        if layout is None:
            return
        if len(data) < layout.size:
            self._emergency(0x8210, 0x11)  # PDO not processed: its length
        elif layout.is_synchronous:
            self._pending[number] = data
        else:
            self._take(layout, data, now)

    def _take(self, layout: PdoLayout, data: bytes, now: int) -> None:
        word = int.from_bytes(data, "little")
        # Targets before the controlword: a rising bit 4 takes what came with it.
        for place in sorted(layout.places, key=lambda one: one.index - offset_of(one.index) == 0x6040):
            offset = offset_of(place.index)
            axis = self.axes.get(offset)
            if axis is not None and not place.subindex:
                axis.written(place.index - offset, place.take(word), now)

    def _sync(self, now: int) -> None:
        self._syncs += 1
        for number, data in sorted(self._pending.items(), reverse=True):
            self._take(self.inputs[number], data, now)
        self._pending.clear()
        for number, layout in self.outputs.items():
            if layout.is_synchronous and self._syncs % max(1, layout.kind) == 0:
                self._send_pdo(number, layout, now)

    def _repeat(self) -> None:
        """PDOs that go out by themselves: on a timer, which here is also how soon a change is seen."""
        from ..canopen_node.network import Periodic

        for number, layout in self.outputs.items():
            if layout.is_synchronous or not layout.event_ms:
                continue

            def send(_: bytes, number: int = number, layout: PdoLayout = layout) -> None:
                self._send_pdo(number, layout, self.clock.now())

            self._timers_of_pdos.append(Periodic(self.clock, layout.event_ms / 1000, send, b""))

    def _send_pdo(self, number: int, layout: PdoLayout, now: int) -> None:
        if "no_pdo" in self.active_faults:
            return
        word = 0
        for place in layout.places:
            offset = offset_of(place.index)
            axis = self.axes.get(offset)
            value = None if axis is None or place.subindex else axis.read(place.index - offset, now)
            if value is None:
                value = self._number(place.index, place.subindex)
            word = place.put(word, value)
        self.reply(f"Tpdo{number}", data=word.to_bytes(layout.size, "little"))

    # ------------------------------------------------------------------ the dictionary

    def _read(self, index: int, subindex: int, od: Any) -> Any:
        """What the axes know better than the dictionary."""
        if index == 0x1001:
            return self._register()
        offset = offset_of(index)
        axis = self.axes.get(offset)
        return (
            None
            if axis is None or subindex or index < 0x6000
            else axis.read(index - offset, self.clock.now())
        )

    def _written(self, index: int, subindex: int, od: Any, data: bytes) -> None:
        offset = offset_of(index)
        axis = self.axes.get(offset)
        if axis is None or index < 0x6000:
            return
        value = od.decode_raw(bytes(data))
        if isinstance(value, int):
            own = index - offset
            axis.written(own if not subindex else own << 8 | subindex, value, self.clock.now())

    def _register(self) -> int:
        found = 0
        for axis in self.axes.values():
            for code in (*axis.causes, *((axis.error,) if axis.error else ())):
                found |= REGISTERS.get(code, 1)
        return found

    # ------------------------------------------------------------------ saying

    def _put(self, identifier: int, data: bytes) -> None:
        """What canopen sends."""
        if not self.is_powered or ("no_heartbeat" in self.active_faults and identifier & 0x780 == 0x700):
            return
        for record in self._scanner.feed([Frame(identifier, data)]):
            fields = as_dict(record)
            fields.pop("node", None)
            self.reply(type(record).__name__, **fields)

    def _emergency(self, code: int, register: int) -> None:
        if self.node.nmt.state in ("OPERATIONAL", "PRE-OPERATIONAL"):
            self.node.emcy.send(code, register)

    # ------------------------------------------------------------------ misbehaving

    def fault(self, name: str, amount: float | None = None, *, on: bool = True) -> None:
        """As `Twin.fault`; what the axes must know is passed on to them."""
        super().fault(name, amount, on=on)
        self._apply_faults()

    def _apply_faults(self) -> None:
        faults = self.active_faults
        now = self.clock.now()
        for axis in self.axes.values():
            axis.advance(now)
            axis.motor.jammed = "jammed" in faults
            axis.cannot_home = "no_home" in faults
            axis.cause(OVER_VOLTAGE, "over_voltage" in faults)
            if ("hot" in faults) != axis.is_hot:
                axis.is_hot = "hot" in faults
                self._emergency(*((HOT, REGISTERS[HOT]) if axis.is_hot else (0, 0)))

    def power(self, on: bool) -> None:
        """Switch it off, or on again."""
        if not on:
            self.network.stop()
            for axis in self.axes.values():
                axis.advance(self.clock.now())
                axis.state = "not ready to switch on"
            self._end_timers_of_pdos()
            self._end_watch()
        super().power(on)

    def stop(self) -> None:
        """End what repeats."""
        super().stop()
        self.network.stop()
        self._end_timers_of_pdos()
        self._end_watch()
