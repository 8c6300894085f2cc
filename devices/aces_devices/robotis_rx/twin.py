"""The simulated RX servo: its whole control table, what it answers and what it does.

1. The table is the truth: whatever is read or written goes through it, by address, as in the servo.
2. A refused instruction changes nothing, and its status says why.
3. Motion, load, temperature and alarms are computed on request.

Source: Robotis RX-28 manual; where it is silent, see the README's choices.
"""

from __future__ import annotations

from collections.abc import Mapping
from struct import Struct
from typing import Any, ClassVar, NamedTuple

from aces_bus.device import Twin, on
from aces_bus.device.settings import settings_of
from aces_bus.errors import CallerError
from aces_bus.protocol import Quantity
from aces_protocols.robotis.control_table import ERRORS, VOLT
from aces_protocols.robotis.spec import BROADCAST, control_table

from .driver import CLOCKWISE, STEP, TOP, ServoSettings, signed
from .motion import FREE, PER_SPEED, ShaftMotion

SIZE = 0x32
EEPROM = 0x18
MODELS = {"RX-10": 10, "RX-28": 28, "RX-64": 64}
#: What a servo of the recordings has: firmware 0x17, 11.1 V, 37 °C.
FIRMWARE, SUPPLY, WARMTH = 0x17, 111, 37
#: Saturated for so long without moving, it is overloaded (ns). A choice.
OVERLOAD_NS = 500_000_000
#: So long after its own status a servo answers nothing that it does not understand (ns): on a line with a second one of
#: its id, their statuses would answer each other for ever. A choice.
QUIET_NS = 3_000_000
#: While locked only these addresses stay writable (RX-28 manual).
UNLOCKED = range(0x18, 0x24)
PING, READ, WRITE = 1, 2, 3


RANGE = 1 << ERRORS["range"]


class TableRegister(NamedTuple):
    """One register in the table: where, how, which raw numbers it may be given."""

    name: str
    address: int
    codec: Struct
    least: int
    most: int
    can_write: bool


#: The greatest raw numbers of registers whose field says which there are, not up to where.
MOST = {
    "torque_enable": 1,
    "led": 1,
    "lock": 1,
    "status_return_level": 2,
    "alarm_led": 0x7F,
    "alarm_shutdown": 0x7F,
}


def _cells() -> dict[int, TableRegister]:
    """By address; a word has two."""
    found: dict[int, TableRegister] = {}
    for register in control_table.values():
        field: Any = register.field
        most = MOST.get(register.name, (1 << 8 * register.size) - 1)
        least, most = (isinstance(field, Quantity) and field.raw_range) or (0, most)
        codec = Struct("<H" if register.size == 2 else "B")
        cell = TableRegister(register.name, register.address, codec, least, most, register.access != "read")
        found.update(dict.fromkeys(range(cell.address, cell.address + codec.size), cell))
    return found


CELLS = _cells()
#: By name: where a register is, and how.
PLACES = {cell.name: (cell.address, cell.codec) for cell in CELLS.values()}


class RobotisRXTwin(Twin):
    """One servo. `table` is its memory; `self["goal_position"]` a register's raw number."""

    protocol: ClassVar[Any] = "robotis"
    faults: ClassVar[Mapping[str, str]] = {
        "hot": "is 5 °C above its highest temperature (or as hot as said, °C)",
        "low_voltage": "has 0.5 V less than its lowest voltage (or as much as said, V)",
        "jam": "cannot turn: where it should, it pushes until it is overloaded",
        "overload": "reports an overload",
    }

    def setup(self) -> None:
        """Power-up: what the EEPROM has, and the RAM's defaults."""
        if not hasattr(self, "table"):
            self.table = bytearray(SIZE)
            self.motion = ShaftMotion()
            self._factory()
            settings = settings_of(self.name, ServoSettings, self.config.settings)
            self["id"] = self.credentials["id"]
            self["baud_rate"] = self._baud_number()
            self["model_number"] = MODELS.get(self.config.model or "", 28)
            self["return_delay"] = round(settings.return_delay_us / 2)
            self["status_return_level"] = settings.status_return_level
            joint = self.joints[0] if self.joints else None
            if joint is not None:
                self.world.joints[joint.name] = self
                self._joint = (joint.direction, joint.zero or 0.0)
                self._step = STEP / (joint.ratio or 1.0)
                if joint.command == "duty" or joint.type == "continuous":
                    self["ccw_angle_limit"] = 0
                start = joint.direction * self.world.start_of(joint.name) + (joint.zero or 0.0)
                self.motion.at = max(0.0, min(float(TOP), start / self._step))
            else:
                self._joint, self._step = (1, 0.0), STEP
        self._ram()
        self.blinks = False
        self._held: tuple[int, bytes] | None = None
        self._pushing_since: int | None = None
        self._spoke_at = -QUIET_NS

    def _factory(self) -> None:
        for register in control_table.values():
            if register.address < EEPROM and register.default is not None:
                self[register.name] = register.default
        self["max_torque"] = TOP
        self["firmware_version"] = FIRMWARE

    def _ram(self) -> None:
        self.table[EEPROM:] = bytes(SIZE - EEPROM)
        for register in control_table.values():
            if register.address >= EEPROM and register.default is not None:
                self[register.name] = register.default
        self["torque_limit"] = self["max_torque"]
        self.motion.settle(self.clock.now())
        self["goal_position"] = min(TOP, round(self.motion.at))
        self._apply()

    def _baud_number(self) -> int:
        baud = getattr(self.twins.port, "baud", 1_000_000)
        return max(0, min(254, round(2_000_000 / baud) - 1))

    # ------------------------------------------------------------------ registers

    def __getitem__(self, name: str) -> int:
        address, codec = PLACES[name]
        return int(codec.unpack_from(self.table, address)[0])

    def __setitem__(self, name: str, value: int) -> None:
        address, codec = PLACES[name]
        codec.pack_into(self.table, address, value)

    def load_table(self, table: bytes) -> None:
        """Be a servo whose whole control table was read as `table` (50 bytes). Raises `CallerError` for another size."""
        if len(table) != SIZE:
            raise CallerError(f"{self.name}: a control table has {SIZE} bytes, not {len(table)}")
        self.table[:] = table
        self.motion.settle(self.clock.now())
        self.motion.at = float(self["present_position"])
        self._renumber()
        self._apply()

    def position(self, now: int) -> float:
        """The joint's angle (rad)."""
        direction, zero = self._joint
        return (self.motion.position(now) * self._step - zero) * direction

    @property
    def is_endless(self) -> bool:
        """Whether it turns without end: both angle limits are 0."""
        return not any(self.table[0x06:0x0A])

    def _apply(self) -> None:
        """What the registers mean for the motion, from now on."""
        motion = self.motion
        motion.settle(self.clock.now())
        motion.is_driven = bool(self["torque_enable"])
        motion.is_jammed = "jam" in self.active_faults
        motion.limit, motion.punch = min(TOP, self["torque_limit"]), self["punch"]
        motion.margin = (self["cw_compliance_margin"], self["ccw_compliance_margin"])
        motion.slope = (self["cw_compliance_slope"], self["ccw_compliance_slope"])
        speed = self["moving_speed"]
        motion.duty = signed(speed) / TOP if self.is_endless else None
        motion.speed = speed & TOP
        motion.goal = float(self["goal_position"])

    def _measure(self) -> int:
        """Bring what is measured up to date; the error bits that hold now."""
        now = self.clock.now()
        motion, faults = self.motion, self.active_faults
        if motion.is_jammed is not ("jam" in faults):
            self._apply()
        self["present_position"] = max(0, min(TOP, round(motion.position(now))))
        speed, drive = motion.speed_at(now), motion.drive_at(now)
        self["present_speed"] = _directed(min(FREE, round(abs(speed) / PER_SPEED)), speed)
        self["present_load"] = _directed(round(abs(drive) * TOP), drive)
        moves = motion.is_moving(now)
        self["moving"] = moves
        self["registered_instruction"] = self._held is not None
        hot, low = faults.get("hot"), faults.get("low_voltage")
        self["present_temperature"] = (
            WARMTH if hot is None else self["highest_temperature"] + 5 if hot == 1 else round(hot)
        ) & 0xFF
        self["present_voltage"] = (
            SUPPLY if low is None else self["lowest_voltage"] - 5 if low == 1 else round(low / VOLT)
        ) & 0xFF
        bits = 0
        if not self["lowest_voltage"] <= self["present_voltage"] <= self["highest_voltage"]:
            bits |= 1 << ERRORS["voltage"]
        if self["present_temperature"] > self["highest_temperature"]:
            bits |= 1 << ERRORS["overheating"]
        if motion.is_jammed and moves:
            if self._pushing_since is None:
                self._pushing_since = now
            if now - self._pushing_since >= OVERLOAD_NS:
                bits |= 1 << ERRORS["overload"]
        else:
            self._pushing_since = None
        if "overload" in faults:
            bits |= 1 << ERRORS["overload"]
        self.blinks = bool(bits & self["alarm_led"])
        if bits & self["alarm_shutdown"] and self["torque_enable"]:
            self["torque_enable"] = 0
            self._apply()
        return bits

    # ------------------------------------------------------------------ instructions

    def receive(self, record: Any, instant: int) -> None:
        """A request that it receives: one at its line speed."""
        if self._is_tuned:
            super().receive(record, instant)

    @property
    def _is_tuned(self) -> bool:
        """Whether the line runs at its speed (within 3 %, RX-28 manual)."""
        baud = getattr(self.twins.port, "baud", None)
        return baud is None or abs(2_000_000 / (self["baud_rate"] + 1) / baud - 1) < 0.03

    def _status(
        self, request: Any, kind: int, error: int = 0, data: bytes = b"", bits: int | None = None
    ) -> None:
        """Answer, if it answers such requests: broadcasts never, save Ping; others as the status return level says."""
        if request is not None and request.id == BROADCAST and kind != PING:
            return
        level = self["status_return_level"]
        if kind == PING or level == 2 or (level == 1 and kind == READ):
            delay = 2_000 * self["return_delay"]
            error |= self._measure() if bits is None else bits
            self._spoke_at = self.clock.now() + delay
            self.reply("Status", delay_ns=delay, error=error, parameters=data)

    @on("Ping")
    def _ping(self, request: Any) -> None:
        self._status(request, PING)

    @on("Read")
    def _read(self, request: Any) -> None:
        end = request.start + request.count
        if end > SIZE or not request.count:
            self._status(request, READ, RANGE)
            return
        bits = self._measure()
        self._status(request, READ, 0, bytes(self.table[request.start : end]), bits)

    @on("Write")
    def _write(self, request: Any) -> None:
        # As what it was when it was asked: with the id, the speed and the status return level before the write.
        error = self._wrong(request.start, request.data)
        self._status(request, WRITE, error)
        if not error:
            self._put(request.start, request.data)

    @on("RegWrite")
    def _hold(self, request: Any) -> None:
        error = self._wrong(request.start, request.data)
        if not error:
            self._held = (request.start, bytes(request.data))
        self._status(request, WRITE, error)

    @on("Action")
    def _act(self, request: Any) -> None:
        held, self._held = self._held, None
        self._status(request, WRITE, self._put(*held) if held is not None else 1 << ERRORS["instruction"])

    @on("Reset")
    def _reset(self, request: Any) -> None:
        self._status(request, WRITE)
        self._factory()
        self._ram()
        self._renumber()

    @on("SyncWrite")
    def _together(self, request: Any) -> None:
        mine = self.credentials["id"]
        for servo in request.servos:
            if servo.id == mine:
                self._put(request.start, servo.data)

    def not_understood(self, data: bytes, reason: str) -> None:
        """A packet with a wrong checksum, or with an instruction that does not exist: answered with that error."""
        if len(data) < 6 or data[2] != self.credentials["id"] or not self.is_powered or not self._is_tuned:
            return
        if self.clock.now() - self._spoke_at < QUIET_NS or not data[4]:
            return  # another servo's status, which has its error bits where an instruction has its code
        size = data[3] + 4
        if reason == "malformed: checksum" and 6 <= size <= len(data):
            if data[4] != PING:
                kind = READ if data[4] == READ else WRITE
                self._status(None, kind, 1 << ERRORS["checksum"])
        elif reason == "unknown" and size == len(data):
            self._status(None, WRITE, 1 << ERRORS["instruction"])

    # ------------------------------------------------------------------ writing

    def _wrong(self, start: int, data: bytes) -> int:
        """The error bits of a write: 0 when it may be done. Half a word is judged by the whole that it makes."""
        end = start + len(data)
        if not data or end > SIZE:
            return RANGE
        limits = self["cw_angle_limit"], self["ccw_angle_limit"]
        after = self.table[:]
        after[start:end] = data
        at = start
        while at < end:
            if self["lock"] and at not in UNLOCKED:
                return RANGE
            cell = CELLS.get(at)
            if cell is None:
                at += 1  # a hole
                continue
            (value,) = cell.codec.unpack_from(after, cell.address)
            most = CLOCKWISE | TOP if cell.name == "moving_speed" and self.is_endless else cell.most
            if not cell.can_write or not cell.least <= value <= most:
                return RANGE
            if cell.name == "goal_position" and not self.is_endless and not limits[0] <= value <= limits[1]:
                return 1 << ERRORS["angle_limit"]
            at = cell.address + cell.codec.size
        return 0

    def _put(self, start: int, data: bytes) -> int:
        error = self._wrong(start, data)
        if error:
            return error
        touched = range(start, start + len(data))
        self.motion.settle(self.clock.now())
        self.table[start : start + len(data)] = data
        self._apply()
        if 0x03 in touched:
            self._renumber()
        return 0

    def _renumber(self) -> None:
        self.twins.renumber(self, id=self["id"])

    # ------------------------------------------------------------------ misbehaving

    def fault(self, name: str, amount: float | None = None, *, on: bool = True) -> None:
        """As `Twin.fault`; motion before it stays as it was."""
        self.motion.settle(self.clock.now())
        super().fault(name, amount, on=on)
        self._apply()


def _directed(size: int, sign: float) -> int:
    return size | CLOCKWISE if sign < 0 and size else size
