"""Robotis RX-10, RX-28 and RX-64: one servo, one joint.

1. A goal is clipped to the servo's range, never wrapped; all goals go out in one SyncWrite a tick.
2. Nothing that survives power-off is written, and no torque is switched on, unless it is asked for.
3. A servo is asked only what its status return level lets it answer: at level 0 nothing but Ping.

Position is polled in every tick (`motion`: with speed and load), everything else of the RAM every `health_s`: that tells
temperature, voltage and errors, and whether the servo still knows what it was told.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

import msgspec
from msgspec import Meta

from aces_bus.device import Job, Poll, Signal, Steps
from aces_bus.device.register_device import RegisterDevice
from aces_bus.device.settings import settings_of
from aces_bus.device.station import shown
from aces_bus.errors import CallerError, DeviceError, NoReplyError
from aces_protocols.robotis.control_table import ANGLE, ERRORS, SPEED
from aces_protocols.robotis.spec import BROADCAST, control_table

#: rad a count: 300° are 1023 counts (RX-28 manual).
STEP = math.radians(ANGLE)
#: rad/s a count: 0.111 rpm (RX-28 manual).
SPEED_STEP = SPEED * math.tau / 60
TOP = 1023
#: Bit 10 of speed, load and drive: clockwise (RX-28 manual).
CLOCKWISE = 0x400
#: What is added before an angle is cut to whole counts: the angle of a count gives that count.
HAIR = 1e-6
#: The largest SyncWrite packet that an RX-28's receive buffer takes (RX-28 manual).
RECEIVE_BUFFER = 143
#: FF FF, id, length, instruction, start, size; checksum.
AROUND = 8
#: Error bits that say what is wrong with the request, not with the servo.
OF_REQUEST = frozenset(("angle_limit", "range", "checksum", "instruction"))
#: So many malformed answers in a row are no noise.
MALFORMED = 5
#: Names of the status return levels.
LEVELS = ("none", "read_only", "all")


class ServoSettings(msgspec.Struct, frozen=True, kw_only=True):
    """The driver's own keys in a robot file."""

    status_return_level: Annotated[
        Literal[0, 1, 2],
        Meta(
            description="what the servo answers: 0 Ping alone, 1 reads too, 2 everything (default 2; register 0x10)"
        ),
    ] = 2
    return_delay_us: Annotated[
        float,
        Meta(
            ge=0, description="how long it waits before it answers (default 500; register 0x05); for its twin"
        ),
    ] = 500
    timeout_s: Annotated[
        float,
        Meta(
            gt=0,
            description="how long an answer may take beyond the wire's time (default 0.02: adapters collect bytes)",
        ),
    ] = 0.02
    health_s: Annotated[
        float,
        Meta(
            gt=0,
            description="how often temperature, voltage, torque and the rest of the RAM are read (default 1)",
        ),
    ] = 1.0
    motion: Annotated[
        bool,
        Meta(description="true: speed and load are read with each position (default false: with the health)"),
    ] = False
    stop: Annotated[
        Literal["hold", "release"],
        Meta(
            description='what stop_motion does: "hold" the present position (default), or "release" the torque'
        ),
    ] = "hold"


def signed(raw: int) -> int:
    """Bits 0–9, negative when bit 10 says clockwise."""
    return -(raw & TOP) if raw & CLOCKWISE else raw & TOP


class RobotisRX(RegisterDevice):
    """One RX servo. Registers: `read("present_temperature")`, `write("led", 1)`, `read_all()`."""

    protocol: ClassVar[Any] = "robotis"
    registers = control_table
    reply = "Status"
    payload = "parameters"
    eeprom = range(0x18)
    together_bytes = RECEIVE_BUFFER
    together_overhead = AROUND
    streamed = frozenset(("goal_position",))
    remembers = frozenset(
        (
            "torque_enable",
            "led",
            "moving_speed",
            "torque_limit",
            "lock",
            "punch",
            *(f"{side}_compliance_{what}" for side in ("cw", "ccw") for what in ("margin", "slope")),
        )
    )
    actions: ClassVar[Mapping[str, str]] = {
        "enable": "hold the present position: goal there, then torque on",
        "disable": "switch the torque off",
        "stop_motion": "hold the present position, or release the torque (setting `stop`)",
        "ping": "ask whether it is there; the names of its errors",
        "read": "read a register, or all from it to `last`",
        "read_all": "read the whole control table",
        "write": "write a register; what survives power-off with confirm=true",
        "set_id": "give it another id, and see that it answers to it",
        "set_baud": "give it another line speed; it is deaf on this line from then on",
        "factory_reset": "everything as from the factory, id and line speed too",
    }
    asking: ClassVar = ("ping", "read", "read_all")

    # ------------------------------------------------------------------ declaration

    def setup(self) -> None:
        """Signals of the joint and of the servo, and what is polled."""
        settings = self.settings = settings_of(self.name, ServoSettings, self.config.settings)
        self.timeout_s, self.health_s = settings.timeout_s, settings.health_s
        self.errors: frozenset[str] = frozenset()
        #: The last errors that switch the torque off, since it was switched on.
        self.trips: frozenset[str] = frozenset()
        #: Malformed answers in a row where its answers should be.
        self.malformed_in_a_row = 0
        joint = self.joints[0] if self.joints else None
        self.direction = joint.direction if joint is not None else 1
        self.zero = (joint.zero or 0.0) if joint is not None else 0.0
        #: Turns of the servo a turn of the joint; what one step of the servo is of the joint's angle, and of its speed.
        ratio = (joint.ratio or 1.0) if joint is not None else 1.0
        self.step, self.speed_step = STEP / ratio, SPEED_STEP / ratio
        self.turns = joint is not None and (joint.command == "duty" or joint.type == "continuous")
        self._set_level(settings.status_return_level)
        self._signals(joint.name if joint is not None else self.name)
        if self.level == 0:
            self.polls = [Poll("Ping", "Status", every_s=self.health_s, timeout_s=self.timeout_s)]
        else:
            last = "present_load" if settings.motion else "present_position"
            self.polls = [
                self.poll("present_position", last),
                self.poll("torque_enable", "moving", every_s=self.health_s),
            ]

    def _set_level(self, level: int) -> None:
        self.level = level
        self.answers, self.acknowledges = level >= 1, level >= 2

    def _signals(self, owner: str) -> None:
        direction, zero, step, speed_step = self.direction, self.zero, self.step, self.speed_step
        slow = max(0.1, 5 * self.health_s)
        motion: dict[str, Any] = {"owner": owner}
        if not self.settings.motion:
            motion["stale_s"] = slow
        span = sorted((direction * (end - zero)) for end in (0.0, TOP * step))
        joint = self.joints[0] if self.joints else None
        if joint is not None:
            span[0] = span[0] if joint.lower is None else max(span[0], joint.lower)
            span[1] = span[1] if joint.upper is None else min(span[1], joint.upper)
        #: What the joint may do: within the servo's range and the robot file's limits; and the servo's own limits.
        self.span = (span[0], span[1])
        self.position = self.register_signal(
            "position",
            "present_position",
            to_si=lambda raw: (min(raw, TOP) * step - zero) * direction,
            set=None if self.turns else "goal_position",
            to_raw=self.counts,
            unit="rad",
            owner=owner,
            lower=None if self.turns else span[0],
            upper=None if self.turns else span[1],
            doc="Where the joint is; set: where it is to go.",
        )
        self.register_signal(
            "velocity",
            "present_speed",
            to_si=lambda raw: signed(raw) * speed_step * direction + 0.0,  # no -0
            unit="rad/s",
            doc="How fast the joint turns.",
            **motion,
        )
        self.register_signal(
            "load",
            "present_load",
            to_si=lambda raw: signed(raw) / TOP * direction + 0.0,
            doc="The drive as a share of the greatest torque, -1 to 1.",
            **motion,
        )
        rest: dict[str, Any] = {"owner": owner, "stale_s": slow}
        if self.turns:
            self.register_signal(
                "duty",
                "moving_speed",
                to_si=lambda raw: signed(raw) / TOP * direction + 0.0,
                set="moving_speed",
                to_raw=self.drive,
                lower=-1.0,
                upper=1.0,
                doc="Endless turn: the torque as a share of the greatest.",
                **rest,
            )
        else:
            self.register_signal(
                "speed_limit",
                "moving_speed",
                to_si=lambda raw: (raw & TOP) * speed_step,
                set="moving_speed",
                to_raw=lambda value: max(1, min(TOP, round(value / speed_step))) if value else 0,
                unit="rad/s",
                lower=0.0,
                upper=TOP * speed_step,
                doc="Speed on the way to a goal; 0: as fast as it can.",
                **rest,
            )
        self.register_signal(
            "enabled",
            "torque_enable",
            to_si=bool,
            doc="Whether the motor is driven; see the actions enable and disable.",
            **rest,
        )
        self.register_signal("moving", "moving", to_si=bool, doc="Whether it is on its way.", **rest)
        own: dict[str, Any] = {"stale_s": slow}
        self.register_signal("temperature", "present_temperature", unit="°C", doc="Inside the servo.", **own)
        self.register_signal(
            "voltage", "present_voltage", to_si=lambda raw: raw / 10, unit="V", doc="Supply.", **own
        )
        self.register_signal(
            "torque_limit",
            "torque_limit",
            to_si=lambda raw: raw / TOP,
            set="torque_limit",
            to_raw=lambda value: max(0, min(TOP, round(value * TOP))),
            lower=0.0,
            upper=1.0,
            doc="The greatest torque, as a share.",
            **own,
        )
        self.register_signal("led", "led", to_si=bool, doc="The lamp (set it as the register `led`).", **own)
        self._errors = self.add_signal("errors", doc="Names of the error bits of its last status.", **own)
        self.readable.add(self._errors.name)

    # ------------------------------------------------------------------ units

    def counts(self, position: float) -> int:
        """The goal of a joint position (rad): cut to whole counts as MiniHubo's software does, clipped to 0…1023."""
        return max(0, min(TOP, int((self.direction * position + self.zero) / self.step + HAIR)))

    def drive(self, duty: float) -> int:
        """The moving speed of a torque share in endless turn: magnitude, and bit 10 for clockwise."""
        size = min(TOP, round(abs(duty) * TOP))
        return size | CLOCKWISE if duty * self.direction < 0 and size else size

    # ------------------------------------------------------------------ up

    def heard(self, record: Any, instant: int) -> None:
        """Every status has the error bits."""
        if type(record).__name__ != "Status":
            return
        self.malformed_in_a_row = 0
        error: int = record.error
        now = frozenset(record.error) if error else frozenset[str]()
        self._errors.update(tuple(sorted(now)), instant)
        if now == self.errors:
            return
        for name in sorted(now - self.errors):
            if name == "checksum":
                self.tell_event("malformed", "the servo says that a request's checksum was wrong")
            else:
                self.tell_event("alarm", name)
        if trips := now & self._shutdown():
            self.trips = trips
        for name in sorted(self.errors - now - OF_REQUEST):
            self.tell_event("alarm over", name)
        self.errors = now

    def refusal(self, record: Any) -> str:
        """The error bits that are about the request."""
        return ", ".join(name for name in record.error if name in OF_REQUEST) if record.error else ""

    def changed(self, which: Mapping[str, tuple[int, int]]) -> None:
        """Torque that is off: by an alarm, or because the servo has rebooted and knows nothing any more."""
        if set(which) <= {"torque_enable", "torque_limit"} and self.trips:
            self.drop("goal_position")
            self.tell_event("alarm", f"torque is off: {', '.join(sorted(self.trips))}")
        else:
            super().changed(which)

    def _shutdown(self) -> frozenset[str]:
        """The errors that switch the torque off."""
        mask = self.cached("alarm_shutdown", raw=True)
        if mask is None:
            mask = self.codec("alarm_shutdown").register.default or 0
        return frozenset(name for name, bit in ERRORS.items() if mask >> bit & 1)

    def malformed(self, reason: str, instant: int) -> None:
        """Its answers are malformed again and again: noise does that now and then, two servos with one id each time."""
        self.malformed_in_a_row += 1
        if self.malformed_in_a_row % MALFORMED == 0:
            self.tell_event(
                "two devices",
                f"{self.malformed_in_a_row} malformed answers in a row: are there two servos with"
                f" {shown(self.credentials)}?",
            )

    def is_followed(self, signal: Signal) -> bool:
        """Not while the torque is off."""
        return self.cached("torque_enable", raw=True) != 0 and super().is_followed(signal)

    # ------------------------------------------------------------------ actions

    def start(self) -> Job | None:
        """Read what survives power-off: model, limits, what it answers."""
        if not self.answers:
            return None

        def steps(job: Job) -> Steps:
            try:
                table = yield self.read("model_number", "alarm_shutdown", raw=True)
            except NoReplyError:
                return None  # reported already; a servo that comes later is received without it
            self._learned(table)
            return table

        return self.job("start", steps)

    def _learned(self, table: Mapping[str, int]) -> None:
        model = self.codec("model_number").value(table["model_number"])
        if self.config.model is not None and model != self.config.model:
            self.tell_event("alarm", f"it is a {model}; the robot's file says {self.config.model}")
        level = table["status_return_level"]
        if level != self.level and 1 <= level < len(LEVELS):
            self._set_level(level)
        low, high = table["cw_angle_limit"], table["ccw_angle_limit"]
        if (low == high == 0) != self.turns:
            self.tell_event(
                "alarm",
                "it turns without end (both angle limits are 0), the joint does not"
                if not self.turns
                else f"the joint turns without end, its servo from count {low} to {high}: set both angle limits to 0",
            )
        elif not self.turns and low < high:
            ends = sorted(self.direction * (count * self.step - self.zero) for count in (low, high))
            self.epoch += 1
            self.position.lower = max(self.span[0], ends[0])
            self.position.upper = min(self.span[1], ends[1])

    def enable(self) -> Job:
        """Torque on, where the joint is: the goal is set to the present position first.

        A set-point that is given meanwhile stays. Where the torque is on already, nothing moves.
        """
        self.is_driven = True
        is_on = self.cached("torque_enable", raw=True) == 1 and not self.is_silent
        if not is_on:
            self.drop("goal_position")

        def steps(job: Job) -> Steps:
            if self.turns and not is_on:
                yield self.write("moving_speed", 0, raw=True)
            elif self.answers and not is_on:
                here = yield self.read("present_position", raw=True)
                if "goal_position" not in self.goals:
                    yield self.write("goal_position", min(here, TOP), raw=True)
            self.trips = frozenset()
            yield self.write("torque_enable", "on")

        return self.job("enable", steps)

    def disable(self) -> Job:
        """Torque off; set-points given so far are dropped."""
        self.drop("goal_position")
        return self.write("torque_enable", "off")

    def stop_motion(self) -> Job:
        """Hold the present position, or release the torque (setting `stop`); the joint's set-points are dropped."""
        self.drop("goal_position")
        if self.turns:
            return self.write("moving_speed", 0, raw=True)
        here = self.position.value
        if self.settings.stop == "release" or not isinstance(here, float):
            return self.write("torque_enable", "off")
        return self.write("goal_position", self.known["present_position"][0] & TOP, raw=True)

    def ping(self) -> Job:
        """Whether it is there, whatever its status return level: the names of its errors."""

        def steps(job: Job) -> Steps:
            return list((yield self._ask("Ping", None)).error)

        return self.job("ping", steps)

    def hold_back(self, name: str, value: Any) -> Job:
        """Write a register when `act` is called: RegWrite. Raises as `write`."""
        self.check_write(name)
        codec = self.codec(name)
        data = codec.pack(codec.raw(value))
        return self._obeyed("RegWrite", f"holding back {name} = {value!r}", start=codec.address, data=data)

    def act(self, *, everybody: bool = False) -> Any:
        """Carry out what was held back; `everybody`: in all servos at once, unanswered."""
        return self.tell("Action", id=BROADCAST) if everybody else self._obeyed("Action", "acting")

    def _obeyed(self, message: str, doing: str, **fields: Any) -> Job:
        def steps(job: Job) -> Steps:
            if not self.acknowledges:
                yield from self._told(message, **fields)
                return
            record = yield self._ask(message, None, **fields)
            self._raise_refusal(record, doing)

        return self.job(message, steps)

    # ------------------------------------------------------------------ what survives power-off

    def check_write(self, name: str, confirm: bool = False) -> None:
        """Raise `CallerError` for what can only be read, needs `confirm`, or is locked."""
        super().check_write(name, confirm)
        address = self.codec(name).address
        if self.cached("lock", raw=True) == 1 and not 0x18 <= address <= 0x23:
            raise CallerError(
                f"{self.name}: register {name} is locked until the servo is switched off; 0x18–0x23 can be written"
            )

    def set_id(self, number: int, *, confirm: bool = False) -> Job:
        """Give the servo another id (0…253), and see that it answers to it. The robot's file is not changed."""
        codec = self.codec("id")
        data = codec.pack(codec.raw(number))
        self.check_write("id", confirm)
        taken = [
            d.name for d in self.host.devices.values() if d is not self and d.credentials.get("id") == number
        ]
        if taken:
            raise CallerError(
                f"{self.name}: id {number} is {taken[0]}'s on this line: two servos would answer"
            )

        def steps(job: Job) -> Steps:
            if number == self.credentials["id"]:
                return
            yield from self._is_free(number)
            # Which of its two ids acknowledges is not stated: the new one is asked.
            yield from self._try("Write", start=codec.address, data=data)
            self.host.renumber(self, id=number)
            yield self._ask("Ping", None)
            self.known["id"] = (number, self.clock.now())

        return self.job(f"set id {number}", steps)

    def _is_free(self, number: int) -> Steps:
        """Steps that fail when a servo answers to an id."""
        if (
            yield from self.host.answers(
                "robotis", {"id": number}, "Ping", reply=self.reply, timeout_s=self.timeout_s
            )
        ):
            raise DeviceError(f"{self.name}: a servo answers to id {number} already: two would answer")

    def set_baud(self, baud: float, *, confirm: bool = False) -> Job:
        """Give the servo another line speed. It is deaf here from then on: open the line at that speed."""
        codec = self.codec("baud_rate")
        data = codec.pack(codec.raw(baud))
        self.check_write("baud_rate", confirm)
        return self._told_and_forgotten("set baud", "Write", start=codec.address, data=data)

    def factory_reset(self, *, confirm: bool) -> Job:
        """Everything as from the factory: id 1, 57 600 baud. It is another servo from then on: scan for it."""
        if not confirm:
            raise CallerError(
                f"{self.name}: a reset also forgets id and line speed; say confirm=True to do it"
            )
        return self._told_and_forgotten("factory reset", "Reset")

    def _told_and_forgotten(self, name: str, message: str, **fields: Any) -> Job:
        def steps(job: Job) -> Steps:
            yield from self._try(message, **fields)
            self.forget()

        return self.job(name, steps)

    def _try(self, message: str, **fields: Any) -> Steps:
        """Steps that send something once, and wait for an acknowledgement that may not come."""
        if not self.acknowledges:
            yield from self._told(message, **fields)
            return
        ticket = self.ask(message, reply=self.reply, timeout_s=self.timeout_s, retries=0, **fields)
        try:
            record = yield ticket
        except NoReplyError:
            return
        self._raise_refusal(record, message)
