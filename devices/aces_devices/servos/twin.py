"""A simulated servo: its whole control table, what it answers and when.

1. The table is the truth: whatever is read or written goes through it, by address, as in the servo.
2. A refused instruction changes nothing, and its status says why.
3. Motion, load, temperature and alarms are computed on request (`measure`).
4. What a family of servos has otherwise is its class's data, and the few methods under "a family's own".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from random import Random
from struct import error as StructError
from typing import Any, ClassVar

from aces_bus.device import Twin, on
from aces_bus.device.settings import settings_of
from aces_bus.errors import CallerError
from aces_bus.protocol import Enumeration, Flags, Quantity, Record
from aces_bus.protocol.declare.registers import RegisterMap

from .driver import BROADCAST, ServoSettings
from .registers import RegisterCodec

PING, READ, WRITE = "Ping", "Read", "Write"
#: What a receiver tolerates of a wrong line speed (RX-28 manual).
TUNED = 0.03
#: Saturated for so long without moving, it is overloaded (ns). A choice.
OVERLOAD_NS = 500_000_000


class RegisterTable:
    """A register map's places: registers by name, those that have a byte by its address, and what each may be given."""

    def __init__(self, registers: RegisterMap) -> None:
        self.codecs = {name: RegisterCodec(registers, name) for name in registers}
        self.cells: dict[int, RegisterCodec] = {}
        self.limits: dict[str, tuple[int, int]] = {}
        for codec in self.codecs.values():
            self.cells.update(dict.fromkeys(range(codec.address, codec.address + codec.size), codec))
            self.limits[codec.name] = _limits(codec)
        self.size = max(self.cells) + 1


def _limits(codec: RegisterCodec) -> tuple[int, int]:
    """Return the least and greatest raw number that a register takes."""
    field: Any = codec.register.field
    bits = 8 * codec.size
    if isinstance(field, Quantity) and field.raw_range:
        low, high = field.raw_range
        return int(low), int(high)
    if isinstance(field, Enumeration):
        return 0, max(field.names.values())
    if isinstance(field, Flags):
        return 0, (1 << max(field.names.values()) + 1) - 1
    try:
        codec.pack(-1)
    except StructError:
        return 0, (1 << bits) - 1
    return -(1 << bits - 1), (1 << bits - 1) - 1


class ServoTwin(Twin):
    """One servo. `table` is its memory; `self["goal_position"]` a register's raw number."""

    places: RegisterTable
    #: The address from which registers are lost without power.
    ram_start: ClassVar[int]
    settings_type: ClassVar[type[ServoSettings]] = ServoSettings

    # ------------------------------------------------------------------ a family's own

    def make(self) -> None:
        """Make a servo as it is delivered, set as the robot's file says; called once, with an empty table."""
        raise NotImplementedError

    def begin(self) -> None:
        """Power up: registers that are lost without power have their defaults again."""
        #: Since when it pushes without moving (ns).
        self._pushing_since: int | None = None

    def apply(self) -> None:
        """Apply the registers to the motion."""
        raise NotImplementedError

    def measure(self) -> int:
        """Bring what is measured up to date; the servo's errors now, as a status has them."""
        raise NotImplementedError

    def wrong_value(self, name: str, value: int) -> str:
        """Return the name of what is wrong with a raw number that a register is to be given; empty: nothing."""
        low, high = self.places.limits[name]
        return "" if low <= value <= high else "range"

    def wrong_place(self, address: int, codec: RegisterCodec | None) -> str:
        """Return the name of what is wrong with writing to an address now; empty: nothing. A hole in the table has no
        codec.
        """
        return "range" if codec is not None and codec.register.access == "read" else ""

    def refused(self, why: str) -> Any:
        """Return a status's `error` for a refused instruction."""
        raise NotImplementedError

    def with_errors(self, refusal: Any, errors: int) -> Any:
        """Return a status's `error` from that and the servo's own errors."""
        raise NotImplementedError

    @property
    def last_count(self) -> int:
        """The last position of a turn, in counts of its shaft."""
        raise NotImplementedError

    def draw(self, dice: Random, share: float = 1.0) -> None:
        """Turn it to a position of its whole turn, which is its goal, too."""
        motion: Any = vars(self)["motion"]
        motion.settle(self.clock.now())
        middle = self.last_count / 2
        motion.at = float(round(middle + dice.uniform(-middle, middle) * share))
        self.begin()

    def power(self, on: bool) -> None:
        """See `Twin.power`: without power its motor is not driven."""
        motion: Any = vars(self)["motion"]
        if not on:
            motion.is_driven = False
            motion.apply(self.clock.now())
        super().power(on)

    # ------------------------------------------------------------------ alarms

    def alarms(
        self,
        bits: Mapping[str, int],
        *,
        pushes: bool,
        hottest: str,
        lowest: str,
        highest: str,
        supply: int,
        warmth: int,
    ) -> int:
        """Set temperature and supply, as the faults `hot` and `low_voltage` (°C, V) make them; the errors of both, and of a
        motor that `pushes` against something, by the numbers of their `bits`. The others are names of registers with limits.
        """
        faults = self.active_faults
        hot, low = faults.get("hot"), faults.get("low_voltage")
        warm = warmth if hot is None else self[hottest] + 5 if hot == 1 else round(hot)
        volts = supply if low is None else self[lowest] - 5 if low == 1 else round(low * 10)
        self["present_temperature"], self["present_voltage"] = warm & 0xFF, max(0, volts) & 0xFF
        now = self.clock.now()
        self._pushing_since = (
            (now if self._pushing_since is None else self._pushing_since) if pushes else None
        )
        is_overloaded = self._pushing_since is not None and now - self._pushing_since >= OVERLOAD_NS
        wrong = {
            "voltage": not self[lowest] <= self["present_voltage"] <= self[highest],
            "overheating": self["present_temperature"] > self[hottest],
            "overload": is_overloaded or "overload" in faults,
        }
        return sum(1 << bits[name] for name, holds in wrong.items() if holds)

    # ------------------------------------------------------------------ registers

    def setup(self) -> None:
        """Power up with the EEPROM's registers and the RAM's defaults."""
        if not hasattr(self, "table"):
            self.table = bytearray(self.places.size)
            self.settings = settings_of(self.name, self.settings_type, self.config.settings)
            self.make()
            self["id"] = self.credentials["id"]
        self._held: tuple[int, bytes] | None = None
        #: When it last spoke (ns).
        self.spoke_at = -(1 << 62)
        self.begin()

    def load_defaults(self, start: int, end: int) -> None:
        """Give the registers from `start` up to `end` their defaults, others 0."""
        self.table[start:end] = bytes(len(self.table[start:end]))
        for codec in self.places.codecs.values():
            if start <= codec.address < end and codec.register.default is not None:
                self[codec.name] = codec.register.default

    def __getitem__(self, name: str) -> int:
        codec = self.places.codecs[name]
        return codec.unpack_from(self.table, codec.address)[0]

    def __setitem__(self, name: str, value: int) -> None:
        codec = self.places.codecs[name]
        self.table[codec.address : codec.address + codec.size] = codec.pack(value)

    def load_table(self, table: bytes) -> None:
        """Be a servo whose whole control table was read as `table`. Raises `CallerError` for another size."""
        if len(table) != len(self.table):
            raise CallerError(f"{self.name}: a control table has {len(self.table)} bytes, not {len(table)}")
        self.table[:] = table
        self.twins.renumber(self, id=self["id"])
        self.apply()

    # ------------------------------------------------------------------ hearing and answering

    @property
    def baud(self) -> float:
        """The line speed that it is set to."""
        return float(self.places.codecs["baud_rate"].value(self["baud_rate"]))

    @property
    def is_tuned(self) -> bool:
        """True if the line runs at the servo's speed."""
        wanted = getattr(self.twins.port, "baud", None)
        return wanted is None or abs(self.baud - wanted) < TUNED * wanted

    def tune(self) -> None:
        """Be set to the line's speed, or the nearest there is."""
        codec = self.places.codecs["baud_rate"]
        wanted = getattr(self.twins.port, "baud", 1_000_000)
        low, high = self.places.limits["baud_rate"]
        self["baud_rate"] = min(
            range(low, min(high, 0xFE) + 1), key=lambda n: abs(float(codec.value(n)) - wanted)
        )

    def receive(self, record: Record, instant: int) -> None:
        """Receive a request if it was sent at the servo's line speed."""
        if self.is_tuned:
            super().receive(record, instant)

    @property
    def delay_ns(self) -> int:
        """Its pause before a status."""
        return 2_000 * self["return_delay"]

    def answer(
        self,
        request: Record | None,
        kind: str = WRITE,
        why: str = "",
        data: bytes = b"",
        *,
        errors: int | None = None,
        delay_ns: int | None = None,
    ) -> None:
        """Answer, if it answers such requests: broadcasts never, save Ping; others as the status return level says."""
        if request is not None and getattr(request, "id", None) == BROADCAST and kind != PING:
            return
        level = self["status_return_level"] + self.level_offset
        if kind == PING or level == 2 or (level == 1 and kind == READ):
            delay = self.delay_ns if delay_ns is None else delay_ns
            error = self.with_errors(self.refused(why), self.measure() if errors is None else errors)
            self.spoke_at = self.clock.now() + delay
            self.reply("Status", delay_ns=delay, error=error, parameters=data)

    def stretch(self, start: int, count: int) -> bytes | None:
        """Return what is in the table from `start` on, measured now; None: there is no such stretch."""
        if not count or start + count > len(self.table):
            return None
        return bytes(self.table[start : start + count])

    @on("Ping")
    def answer_ping(self, request: Record) -> None:
        """Answer a Ping; a broadcast is answered after the servos with lower numbers."""
        data, mine = self.identification(), self.credentials["id"]
        others = self.twins.members.values() if request.id == BROADCAST else ()
        before = [len(data) for other in others if other.credentials["id"] < mine]
        self.answer(request, PING, "", data, delay_ns=self.turn_ns(before))

    def identification(self) -> bytes:
        """Return the parameters of a Ping's status."""
        return b""

    @on("Read")
    def answer_read(self, request: Record) -> None:
        """Answer with a stretch of the table, or with the reason why it cannot be read."""
        self.answer_stretch(request, request.start, request.count)

    def answer_stretch(
        self, request: Record | None, start: int, count: int, delay_ns: int | None = None
    ) -> None:
        """Send a status with a stretch of the table; `request` is None if several servos were asked."""
        errors = self.measure()
        data = self.stretch(start, count)
        if data is None:
            self.answer(request, READ, self.no_stretch, errors=errors, delay_ns=delay_ns)
        else:
            self.answer(request, READ, "", data, errors=errors, delay_ns=delay_ns)

    #: As the driver's.
    level_offset: ClassVar[int] = 0
    #: The bytes of a status without parameters.
    status_bytes: ClassVar[int] = 6
    #: What is wrong with a stretch that is not in the table.
    no_stretch: ClassVar[str] = "range"

    def turn_ns(self, before: Sequence[int]) -> int:
        """Return how long it waits where others answer before it, with so many bytes of parameters each."""
        size = sum(before) + self.status_bytes * len(before)
        return (len(before) + 1) * self.delay_ns + (self.twins.port.wire_ns(bytes(size)) if size else 0)

    def answer_in_turn(self, areas: Sequence[tuple[int, int, int]]) -> None:
        """Answer in turn, where several servos were asked: (id, start, count) of each, in the order of their
        answers.
        """
        mine, before = self.credentials["id"], list[int]()
        for number, start, count in areas:
            if number == mine:
                self.answer_stretch(None, start, count, self.turn_ns(before))
                return
            before.append(count)

    @on("Write")
    def obey_write(self, request: Record) -> None:
        """Write, and acknowledge with the id, the speed and the level before the write."""
        why = self.wrong(request.start, request.data)
        self.answer(request, WRITE, why)
        if not why:
            self.put(request.start, request.data)

    @on("RegWrite")
    def hold_write(self, request: Record) -> None:
        """Hold a write back until Action."""
        why = self.wrong(request.start, request.data)
        if not why:
            self._held = (request.start, bytes(request.data))
        self.answer(request, WRITE, why)

    @on("Action")
    def act(self, request: Record) -> None:
        """Carry out the write that was held back."""
        held, self._held = self._held, None
        self.answer(request, WRITE, self.put(*held) if held is not None else "instruction")

    @on("SyncWrite")
    def obey_together(self, request: Record) -> None:
        """Obey the servo's own part of a joint write."""
        mine = self.credentials["id"]
        for servo in request.servos:
            if servo.id == mine:
                self.put(request.start, servo.data)

    @property
    def is_holding(self) -> bool:
        """True if a RegWrite waits for its Action."""
        return self._held is not None

    # ------------------------------------------------------------------ writing

    def wrong(self, start: int, data: bytes) -> str:
        """Return what is wrong with a write; empty: it may be done. Half a word is judged by the whole that it makes."""
        end = start + len(data)
        if not data or end > len(self.table):
            return self.no_stretch
        after = self.table[:]
        after[start:end] = data
        at = start
        while at < end:
            codec = self.places.cells.get(at)
            why = self.wrong_place(at, codec)
            if why:
                return why
            if codec is None:
                at += 1  # a hole
                continue
            why = self.wrong_value(codec.name, codec.unpack_from(after, codec.address)[0])
            if why:
                return why
            at = codec.address + codec.size
        return ""

    def put(self, start: int, data: bytes) -> str:
        """Write, if it may be; what is wrong with it otherwise."""
        why = self.wrong(start, data)
        if why:
            return why
        touched = range(start, start + len(data))
        self.before_write()
        self.table[start : start + len(data)] = data
        self.apply()
        self.after_write(touched)
        if self.places.codecs["id"].address in touched:
            self.twins.renumber(self, id=self["id"])
        return ""

    def before_write(self) -> None:
        """Bring the motion up to now, before the table changes."""

    def after_write(self, touched: range) -> None:
        """React to bytes that were written at these addresses."""

    # ------------------------------------------------------------------ misbehaving

    def fault(self, name: str, amount: float | None = None, *, on: bool = True) -> None:
        """Do what `Twin.fault` does; motion before it stays as it was."""
        self.before_write()
        super().fault(name, amount, on=on)
        self.apply()
