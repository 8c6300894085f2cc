"""A servo as a table of registers on a half-duplex line: one servo, one joint, of any maker.

1. A goal is clipped to the servo's range, never wrapped; all goals go out in one SyncWrite a tick.
2. Nothing that survives power-off is written, and no torque is switched on, unless it is asked for.
3. A servo is asked only what its status return level lets it answer: at level 0 nothing but Ping.
4. What a family of servos has otherwise is its class's data, and the few methods under "a family's own".

Position is polled in every tick (`motion`: with speed and load), the rest of the RAM every `health_s`: that gives
temperature, voltage and errors, and whether the servo still has what it was given.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

import msgspec
from msgspec import Meta

from aces_bus.device import Job, Poll, Steps
from aces_bus.device.host_loss import Outcome
from aces_bus.device.settings import settings_of
from aces_bus.device.signals import Signal
from aces_bus.device.station import credential_text
from aces_bus.errors import CallerError, DeviceError, NoReplyError
from aces_bus.protocol import Record
from aces_bus.protocol.record import FieldValue

from .registers import RegisterDevice

#: What addresses all servos of a line.
BROADCAST = 0xFE
#: So many malformed answers in a row are not noise.
MALFORMED = 5
#: Names of the status return levels.
LEVELS = ("none", "read_only", "all")
#: How a joint's `command` is called in messages.
COMMANDS = {"position": "positions", "speed": "speeds", "current": "currents", "duty": "duties"}


class ServoSettings(msgspec.Struct, frozen=True, kw_only=True):
    """The driver's own keys in a robot file."""

    status_return_level: Annotated[
        Literal[0, 1, 2],
        Meta(
            description="what the servo answers: 0 Ping alone, 1 reads too, 2 everything (default 2; a register)"
        ),
    ] = 2
    return_delay_us: Annotated[
        float,
        Meta(ge=0, description="how long it waits before it answers (default 500; a register); for its twin"),
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


ACTIONS: Mapping[str, str] = {
    "enable": "hold the present position: goal there, then torque on",
    "disable": "switch the torque off",
    "ping": "ask whether it is there; the names of its errors",
    "read": "read a register, or all from it to `last`",
    "read_all": "read the whole control table",
    "write": "write a register; what survives power-off with confirm=true",
    "set_id": "give it another id, and see that it answers to it",
    "set_baud": "give it another line speed; it is deaf on this line from then on",
    "factory_reset": "everything as from the factory, id and line speed too",
}


class ServoDevice(RegisterDevice):
    """One servo. Registers: `read("present_temperature")`, `write("led", 1)`, `read_all()`."""

    reply = "Status"
    payload = "parameters"
    settings_type: ClassVar[type[ServoSettings]] = ServoSettings
    #: Registers, first and last: read in each tick, that with the setting `motion`, and every `health_s`.
    position_span: ClassVar[tuple[str, str]] = ("present_position", "present_position")
    motion_span: ClassVar[tuple[str, str]] = ("present_position", "present_load")
    health_span: tuple[str, str] = ("torque_enable", "moving")
    #: What survives power-off and is read at the start.
    start_span: tuple[str, str]
    #: The register of set-points by what a joint is commanded by; a family has those that it lists.
    goals_by_command: Mapping[str, str] = {"position": "goal_position"}
    speed_register: ClassVar[str] = "present_speed"
    #: Which errors switch the torque off: the register with their mask, and the bit of each.
    shutdown_register: ClassVar[str] = "alarm_shutdown"
    error_bits: ClassVar[Mapping[str, int]] = {}
    #: Errors that say what is wrong with the request, not with the servo.
    of_request: ClassVar[frozenset[str]] = frozenset()
    #: The message of a factory reset, and its fields.
    reset: ClassVar[tuple[str, Mapping[str, FieldValue]]] = ("Reset", {})
    #: rad a count, and rad/s a count of speed, of the servo's own shaft.
    count_rad: float
    speed_count_rad_s: float
    #: The register of the mode that decides what goals it follows, where there is one.
    mode_register: str = ""
    #: What the register `status_return_level` is less than the level: the lowest one may be that reads are answered.
    level_offset: ClassVar[int] = 0
    actions: ClassVar[Mapping[str, str]] = ACTIONS
    asking: ClassVar = ("ping", "read", "read_all")

    # ------------------------------------------------------------------ a family's own

    def command_of_joint(self) -> str:
        """Return what its joint is commanded by: position, speed, current or duty."""
        return self.joints[0].command if self.joints else "position"

    @abstractmethod
    def range_counts(self) -> tuple[int, int]:
        """Return the least and greatest counts that a goal may have."""

    def signed(self, raw: int) -> int:
        """Return a raw number of position or speed as counts with a sign."""
        return raw

    def at_count(self, raw: int) -> int:
        """Return the count at which a present position (raw) is."""
        return self.signed(raw)

    def unsigned(self, count: int) -> int:
        """Return signed counts as a register holds them: the inverse of `signed`."""
        return count

    def counts(self, position: float) -> int:
        """Return the goal of a joint position (rad), clipped to the servo's range."""
        low, high = self.range_counts()
        return max(low, min(high, round((self.direction * position + self.zero) / self.step)))

    def declare_more(self, owner: str, motion: Mapping[str, Any], health: Mapping[str, Any]) -> None:
        """Declare signals beyond those that all servos have; the options are those of what is read with each."""

    def wanted_mode(self) -> str:
        """Return the mode that the joint needs its servo in, where it has modes."""
        return ""

    def unlock(self) -> Steps:
        """Yield steps that must precede a write that survives power-off."""
        yield from ()

    def lock(self) -> Steps:
        """Yield steps that follow a write that survives power-off."""
        yield from ()

    def learned(self, table: Mapping[str, int]) -> None:
        """Take the registers that survive power-off: raw numbers by name."""

    def before_torque(self) -> Steps:
        """Yield steps that must succeed before a servo gets a goal and torque: it must be in the mode of its joint."""
        if self.mode_register and self.answers:
            mode = yield self.read(self.mode_register)
            if mode != self.mode:
                raise DeviceError(f"{self.name}: {self._other_mode(mode)}")

    def errors_of(self, record: Record) -> frozenset[str] | None:
        """Return the names of the errors in a status; None: it does not say."""
        return frozenset(record.error) if record.error else frozenset()

    # ------------------------------------------------------------------ declaration

    def setup(self) -> None:
        """Add signals of the joint and of the servo, and the polls."""
        settings = self.settings = settings_of(self.name, self.settings_type, self.config.settings)
        self.timeout_s, self.health_s = settings.timeout_s, settings.health_s
        self.errors: frozenset[str] = frozenset()
        #: The last errors that switch the torque off, since it was switched on.
        self.trips: frozenset[str] = frozenset()
        #: Malformed answers in a row where its answers should be.
        self.malformed_in_a_row = 0
        joint = self.joints[0] if self.joints else None
        self.direction = joint.direction if joint is not None else 1
        self.zero = (joint.zero or 0.0) if joint is not None else 0.0
        #: Turns of the servo a turn of the joint; what one count of the servo is of the joint's angle, and of its speed.
        ratio = (joint.ratio or 1.0) if joint is not None else 1.0
        self.step, self.speed_step = self.count_rad / ratio, self.speed_count_rad_s / ratio
        self.command = self.command_of_joint()
        if self.command not in self.goals_by_command:
            known = ", ".join(COMMANDS[name] for name in self.goals_by_command)
            raise CallerError(f"{self.name}: it takes {known}, not {COMMANDS[self.command]}")
        #: The register of the joint's set-points.
        self.goal = self.goals_by_command[self.command]
        #: The mode that the joint needs.
        self.mode = self.wanted_mode()
        self._set_level(max(settings.status_return_level, self.level_offset))
        self._declare_signals(joint.name if joint is not None else self.name)
        if self.level == 0:
            self.polls = [Poll("Ping", "Status", every_s=self.health_s, timeout_s=self.timeout_s)]
        else:
            self.polls = [
                self.poll(*(self.motion_span if settings.motion else self.position_span)),
                self.poll(*self.health_span, every_s=self.health_s),
            ]

    def _set_level(self, level: int) -> None:
        self.level = level
        self.answers, self.acknowledges = level >= 1, level >= 2

    def span_rad(self, low: int, high: int) -> tuple[float, float]:
        """Return the joint's angles (rad) at two counts, the lesser first."""
        ends = sorted(self.direction * (count * self.step - self.zero) for count in (low, high))
        return ends[0], ends[1]

    def _declare_signals(self, owner: str) -> None:
        direction, zero, step, speed_step = self.direction, self.zero, self.step, self.speed_step
        health: dict[str, Any] = {"owner": owner, "stale_s": max(0.1, 5 * self.health_s)}
        motion: dict[str, Any] = {"owner": owner} if self.settings.motion else health
        joint = self.joints[0] if self.joints else None
        low, high = self.range_counts()
        span = list(self.span_rad(low, high))
        if joint is not None:
            span[0] = span[0] if joint.lower is None else max(span[0], joint.lower)
            span[1] = span[1] if joint.upper is None else min(span[1], joint.upper)
        #: What the joint may do: within the servo's range and the robot file's limits.
        self.span = (span[0], span[1])
        by_position = self.command == "position"
        self.position = self.register_signal(
            "position",
            "present_position",
            to_si=lambda raw: (self.at_count(raw) * step - zero) * direction,
            set="goal_position" if by_position else None,
            to_raw=lambda value: self.unsigned(self.counts(value)),
            unit="rad",
            owner=owner,
            lower=span[0] if by_position else None,
            upper=span[1] if by_position else None,
            doc="Where the joint is; set: where it is to go." if by_position else "Where the joint is.",
        )
        by_speed = self.command == "speed"
        most = self.speed_limit_counts() * speed_step if by_speed else None
        self.register_signal(
            "velocity",
            self.speed_register,
            to_si=lambda raw: self.signed(raw) * speed_step * direction + 0.0,  # no -0
            set=self.goal if by_speed else None,
            to_raw=lambda value: self.unsigned(round(value * direction / speed_step)),
            lower=None if most is None else -most,
            upper=most,
            unit="rad/s",
            doc="How fast the joint turns; set: how fast it is to turn."
            if by_speed
            else "How fast the joint turns.",
            **motion,
        )
        self.declare_more(owner, motion, health)
        self.register_signal(
            "enabled",
            "torque_enable",
            to_si=bool,
            doc="Whether the motor is driven; see the actions enable and disable.",
            **health,
        )
        self.register_signal("moving", "moving", to_si=bool, doc="Whether it is on its way.", **health)
        own: dict[str, Any] = {"stale_s": health["stale_s"]}
        self.register_signal("temperature", "present_temperature", unit="°C", doc="Inside the servo.", **own)
        self.register_signal(
            "voltage", "present_voltage", to_si=lambda raw: raw / 10, unit="V", doc="Supply.", **own
        )
        if "led" in self.codecs:
            self.register_signal(
                "led", "led", to_si=bool, doc="The lamp (set it as the register `led`).", **own
            )
        self._errors = self.add_signal("errors", doc="Names of the servo's errors.", **own)
        self.readable.add(self._errors.name)

    def speed_limit_counts(self) -> int:
        """Return the greatest goal of a joint that is commanded by speed, in counts."""
        raise NotImplementedError

    def declare_torque_limit(self, most: int) -> None:
        """Declare the signal `torque_limit`, a share of `most`."""
        self.register_signal(
            "torque_limit",
            "torque_limit",
            to_si=lambda raw: raw / most,
            set="torque_limit",
            to_raw=lambda value: max(0, min(most, round(value * most))),
            lower=0.0,
            upper=1.0,
            doc="The greatest torque, as a share.",
            stale_s=max(0.1, 5 * self.health_s),
        )

    # ------------------------------------------------------------------ up

    def received(self, record: Record, instant: int) -> None:
        """Take the errors of a status: every status has some, or says that there are none."""
        if type(record).__name__ != "Status":
            return
        self.malformed_in_a_row = 0
        now = self.errors_of(record)
        if now is not None:
            self.note_errors(now, instant)

    def note_errors(self, now: frozenset[str], instant: int) -> None:
        """Take the servo's present errors, and report those that are new or over."""
        self._errors.update(tuple(sorted(now)), instant)
        if now == self.errors:
            return
        for name in sorted(now - self.errors):
            if name in ("checksum", "crc"):
                self.emit_event("garbled", "the servo says that a request's checksum was wrong")
            else:
                self.emit_event("alarm", name)
        if trips := now & self._shutdown():
            self.trips = trips
        for name in sorted(self.errors - now - self.of_request):
            self.emit_event("alarm over", name)
        self.errors = now

    def refusal(self, record: Record) -> str:
        """Return the errors that are about the request."""
        return ", ".join(name for name in record.error if name in self.of_request) if record.error else ""

    def changed(self, which: Mapping[str, tuple[int, int]]) -> None:
        """React to torque that is off: by an alarm, or because the servo has rebooted."""
        if set(which) <= {"torque_enable", "torque_limit"} and self.trips:
            self.drop(self.goal)
            self.emit_event("alarm", f"torque is off: {', '.join(sorted(self.trips))}")
        else:
            super().changed(which)

    def _shutdown(self) -> frozenset[str]:
        """Return the errors that switch the torque off."""
        mask = self.cached(self.shutdown_register, raw=True)
        if mask is None:
            mask = self.codec(self.shutdown_register).register.default or 0
        return frozenset(name for name, bit in self.error_bits.items() if mask >> bit & 1)

    def malformed(self, reason: str, instant: int) -> None:
        """Count malformed answers: noise makes one now and then, two servos with one id each time."""
        self.malformed_in_a_row += 1
        if self.malformed_in_a_row % MALFORMED == 0:
            self.report_double(
                f"{self.malformed_in_a_row} malformed answers in a row: are there two servos with"
                f" {credential_text(self.credentials)}?",
            )

    def is_followed(self, signal: Signal) -> bool:
        """Return False while the torque is off."""
        return self.cached("torque_enable", raw=True) != 0 and super().is_followed(signal)

    # ------------------------------------------------------------------ actions

    def start(self) -> Job | None:
        """Read what survives power-off: model, limits, what it answers."""
        if not self.answers:
            return None

        def steps(job: Job) -> Steps:
            try:
                table = yield self.read(*self.start_span, raw=True)
            except NoReplyError:
                return None  # reported already; a servo that comes later is received without it
            model = self.codec("model_number").value(table["model_number"])
            if self.config.model is not None and model != self.config.model:
                self.emit_event("alarm", f"it is a {model}; the robot's file says {self.config.model}")
            level = table["status_return_level"] + self.level_offset
            if level != self.level and 1 <= level < len(LEVELS):
                self._set_level(level)
            if self.mode_register:
                mode = self.codec(self.mode_register).value(table[self.mode_register])
                if mode != self.mode:
                    self.emit_event("alarm", self._other_mode(mode))
            self.learned(table)
            return table

        return self.job("start", steps)

    def _other_mode(self, mode: Any) -> str:
        return (
            f"it is in the mode {mode}, and its joint needs {self.mode}:"
            f" aces device {self.name} set_mode confirm=true"
        )

    def set_mode(self, *, confirm: bool) -> Job:
        """Have the servo in the mode that its joint is commanded by; its torque must be off."""
        return self.write(self.mode_register, self.mode, confirm=confirm)

    def limit_to(self, low: int, high: int) -> None:
        """Limit the joint to what the servo's own limits allow, in counts."""
        if self.command == "position" and low < high:
            ends = self.span_rad(low, high)
            self.epoch += 1
            self.position.lower = max(self.span[0], ends[0])
            self.position.upper = min(self.span[1], ends[1])

    def enable(self) -> Job:
        """Switch torque on where the joint is: the goal is set to the present position first, or to no speed.

        A set-point that is given meanwhile stays. Where the torque is on already, nothing moves.
        """
        self.is_driven = True
        is_on = self.cached("torque_enable", raw=True) == 1 and not self.is_silent
        if not is_on:
            self.drop(self.goal)

        def steps(job: Job) -> Steps:
            yield from self.before_torque()
            if self.command != "position" and not is_on:
                yield self.write(self.goal, 0, raw=True)
            elif self.answers and not is_on:
                here = yield self.read("present_position", raw=True)
                if self.goal not in self.goals:
                    yield self.write(self.goal, self.goal_at(here), raw=True)
            self.trips = frozenset()
            yield self.write("torque_enable", "on")

        return self.lead("enable", steps)

    def goal_at(self, here: int) -> int:
        """Return the goal that holds a present position, both raw."""
        return here

    def disable(self) -> Job:
        """Switch torque off; drop set-points given so far."""
        self.end_led()
        self.drop(self.goal)
        return self.write_now("torque_enable", 0)

    def stop_motion(self) -> Job:
        """Hold the present position, or release the torque (setting `stop`); the joint's set-points are dropped."""
        here = self.position.value
        is_held = self.stop_leaves == "holds"
        if is_held and self.command == "position" and self.position.instant is None and self.answers:
            return self._hold_unread()
        if self.command == "position" and not (is_held and isinstance(here, float)):
            return self.disable()
        self.end_led()
        self.drop(self.goal)
        goal = self.goal_at(self.known["present_position"][0]) if self.command == "position" else 0
        return self.write_now(self.goal, goal)

    def _hold_unread(self) -> Job:
        """Ask where the joint is, which is not known yet, and hold it there; release it where there is no answer."""
        self.end_led()
        self.drop(self.goal)
        asked = self.read("present_position", raw=True)

        def steps(job: Job) -> Steps:
            try:
                here = yield asked
                yield self.write_now(self.goal, self.goal_at(here))
            except NoReplyError:
                yield self.write_now("torque_enable", 0)

        return self.job("stop", steps)

    @property
    def stop_leaves(self) -> Outcome:
        """Held by the goal where it is, or by no speed; without torque, or without current, it is free."""
        if self.command == "position" and self.settings.stop == "release":
            return "limp"
        return "holds" if self.command in ("position", "speed") else "limp"

    def ping(self) -> Job:
        """Return whether it is there, whatever its status return level: the names of its errors."""

        def steps(job: Job) -> Steps:
            record = yield self._ask("Ping", None)
            errors = self.errors_of(record)
            return sorted(self.errors if errors is None else errors)

        return self.job("ping", steps)

    def hold_back(self, name: str, value: FieldValue) -> Job:
        """Write a register when `act` is called: RegWrite. Raises as `write`."""
        self.check_write(name)
        codec = self.codec(name)
        data = codec.pack(codec.raw(value))
        return self.obeyed("RegWrite", f"holding back {name} = {value!r}", start=codec.address, data=data)

    def act(self, *, everybody: bool = False) -> Any:
        """Carry out what was held back; `everybody`: in all servos at once, unanswered."""
        return self.send("Action", id=BROADCAST) if everybody else self.obeyed("Action", "acting")

    def obeyed(self, message: str, doing: str, **fields: FieldValue) -> Job:
        """Send an instruction; the job is over when it was acknowledged, where the servo does that."""

        def steps(job: Job) -> Steps:
            if not self.acknowledges:
                yield from self._unanswered(message, **fields)
                return
            record = yield self._ask(message, None, **fields)
            self._raise_refusal(record, doing)

        return self.job(message, steps)

    # ------------------------------------------------------------------ what survives power-off

    def set_id(self, number: int, *, confirm: bool = False) -> Job:
        """Give the servo another id, and see that it answers to it. The robot's file is not changed."""
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
            yield from self.unlock()
            # Which of its two ids acknowledges is not stated: the new one is asked.
            yield from self._try("Write", start=codec.address, data=data)
            self.host.renumber(self, id=number)
            yield self._ask("Ping", None)
            yield from self.lock()
            self.known["id"] = (number, self.clock.now())

        return self.job(f"set id {number}", steps)

    def _is_free(self, number: int) -> Steps:
        """Yield steps that fail if a servo answers to an id."""
        if (
            yield from self.host.answers(
                self.variant.name, {"id": number}, "Ping", reply=self.reply, timeout_s=self.timeout_s
            )
        ):
            raise DeviceError(f"{self.name}: a servo answers to id {number} already: two would answer")

    def set_baud(self, baud: float, *, confirm: bool = False) -> Job:
        """Give the servo another line speed. It is deaf here from then on: open the line at that speed."""
        codec = self.codec("baud_rate")
        data = codec.pack(codec.raw(baud))
        self.check_write("baud_rate", confirm)

        def steps(job: Job) -> Steps:
            yield from self.unlock()
            yield self._sent_and_forgotten("set baud", "Write", start=codec.address, data=data)

        return self.job("set baud", steps)

    def factory_reset(self, *, confirm: bool) -> Job:
        """Reset everything to the factory's, id and line speed too. It is another servo from then on: scan for it."""
        if not confirm:
            raise CallerError(
                f"{self.name}: a reset also forgets id and line speed; say confirm=True to do it"
            )
        message, fields = self.reset
        return self._sent_and_forgotten("factory reset", message, **fields)

    def _sent_and_forgotten(self, name: str, message: str, **fields: FieldValue) -> Job:
        def steps(job: Job) -> Steps:
            yield from self._try(message, **fields)
            self.forget()

        return self.job(name, steps)

    def _try(self, message: str, **fields: Any) -> Steps:
        """Yield steps that send a request once, and wait for an acknowledgement that may not come."""
        if not self.acknowledges:
            yield from self._unanswered(message, **fields)
            return
        ticket = self.ask(message, reply=self.reply, timeout_s=self.timeout_s, retries=0, **fields)
        try:
            record = yield ticket
        except NoReplyError:
            return
        self._raise_refusal(record, message)
