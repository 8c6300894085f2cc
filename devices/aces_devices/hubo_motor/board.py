"""A motor board as the driver knows it: its channels, what is received of them, what they are to be sent.

1. What is sent and received by which kind of board is in `shapes`.
2. References go out in each tick, one frame a board, and only while the board is enabled and no hold-off runs: 0.8 s after
   the start, 3 s after a home command (hubo-ach). A set-point that will not be sent is reported ("not sent"), never kept.
3. A board that forgot its settings (home flag lost, control off without an error) gets nothing more until it is
   enabled again.
4. raw = (direction × position + zero) × counts_per_unit, truncated toward zero as the programs that drove the robots do;
   the way back is exact. Velocity is (new − old) ÷ (instants' difference): real time stamps, not the nominal period.
5. Switching and compliance are in `switching`, homing in `homing`, what is stored in a board in `driver`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from math import pi, tau
from typing import Any, ClassVar

from aces_bus.compiling import mypyc_attr
from aces_bus.device import HostLoss, Joint, MotorDevice, Poll, Signal
from aces_bus.device.settings import settings_of
from aces_bus.errors import CallerError, DeviceError
from aces_protocols.hubo.spec import hubo

from .shapes import BoardSettings, shape_of

#: Status bits that are no error.
_SWITCHES = ("driver_on", "control_on", "current_mode", "limit_switch")
#: Home flags that say that a joint is homed: 6, and 2 of a wrist roll (hubo-ach).
HOMED = ("homed", "wrist_roll_homed")
#: When a joint that is homed, or becomes stiff again, has arrived (rad; hubo-ach).
ARRIVED = 0.0075
#: Signals of a status, by what the status of a board says: name → what it is.
_DRIVE_STATUS: Mapping[str, str] = {
    "status": "names of all bits that are set",
    "errors": "names of the error bits that are set",
    "enabled": "driver and control are on",
}
_HOME_STATUS: Mapping[str, str] = {
    "home": "the home flag: 6 (homed), or a code",
    "homed": "the home flag says so",
}
_SEARCH_STATUS: Mapping[str, str] = {
    "status": "home search: origin, limit switch, encoder",
    "homed": "the home search ended well",
}


@mypyc_attr(allow_interpreted_subclasses=True)
class MotorAxis:
    """A channel. `joint` None: the robot's file has none; the channel only has a place in its board's frames."""

    __slots__ = (
        "channel",
        "count",
        "counts",
        "direction",
        "duty",
        "goal",
        "instant",
        "is_on",
        "joint",
        "name",
        "position",
        "reference",
        "scale",
        "signals",
        "velocity",
        "was_homed",
        "zero",
    )

    def __init__(self, channel: int, joint: Joint | None, name: str) -> None:
        self.channel, self.joint, self.name = channel, joint, name
        counts = joint.counts_per_unit if joint is not None else None
        self.counts: float = counts if counts is not None else 1.0
        self.direction: int = joint.direction if joint is not None else 1
        self.zero: float = (joint.zero or 0.0) if joint is not None else 0.0
        #: rad a count, with the sign of the direction.
        self.scale = self.direction / self.counts
        #: The last encoder count, and when it was received (ns).
        self.count: int | None = None
        self.instant = 0
        #: The set-point in counts (of a neck rad, of a finger A), and where a filter is to bring it (None: no filter).
        self.reference: Any = None
        self.goal: float | None = None
        #: Whether it was homed by the last status.
        self.was_homed = False
        #: Whether the last status had its drive on; None: there was none.
        self.is_on: bool | None = None
        #: What the status says.
        self.signals: dict[str, Signal] = {}
        self.position: Signal | None = None
        self.velocity: Signal | None = None
        self.duty: Signal | None = None

    def to_counts(self, position: float) -> int:
        """Return the counts of a position (rad), truncated toward zero."""
        return int((self.direction * position + self.zero) * self.counts)

    def to_rad(self, count: float) -> float:
        """Position (rad) of an encoder count."""
        return count * self.scale - self.zero * self.direction

    def received(self, count: int, instant: int, moves: bool) -> None:
        """Update position and velocity from an encoder `count`; `moves` is False while a zero is set: no movement."""
        position, velocity, scale = self.position, self.velocity, self.scale
        if position is not None:
            position.update(count * scale - self.zero * self.direction, instant)
            old, passed = self.count, instant - self.instant
            if velocity is not None and old is not None and passed > 0 and moves:
                velocity.update((count - old) * scale * 1e9 / passed, instant)
        self.count, self.instant = count, instant

    def forget(self) -> None:
        """Forget count, reference and home: the board has lost them."""
        self.count = self.reference = self.goal = None
        self.was_homed = False

    def show(self, name: str, value: Any, instant: int) -> None:
        """Update the signal `name`, if the axis has it."""
        found = self.signals.get(name)
        if found is not None:
            found.update(value, instant)

    def shown(self, name: str) -> Any:
        """Return the value of a signal; None where there is none of this name."""
        found = self.signals.get(name)
        return None if found is None else found.value


@mypyc_attr(allow_interpreted_subclasses=True)
class MotorBoard(MotorDevice[MotorAxis]):
    """One board, without what can be done with it."""

    protocol: ClassVar = hubo
    when_host_is_lost = HostLoss(
        "goes on",
        "hubo-ach and Hubo's manuals state no time-out",
        detail="its joints stay at the last reference",
    )
    streams: ClassVar[Collection[str]] = (
        "Reference",
        "Reference3D08",
        "ReferenceHand",
        "ReferenceHandPosition",
        "ReferenceNeck",
        "PwmFine",
        "Pwm3",
        "PwmFingers",
        "PwmD08",
        "Pwm3D08",
        "PwmFingersD08",
    )

    axes: list[MotorAxis]

    def setup(self) -> None:
        """Signals of the joints, polls of the board."""
        self.dialect, self.kind, self.shape = shape_of(self)
        self.settings = settings_of(self.name, BoardSettings, self.config.settings)
        found, joints = self.shape, {joint.channel: joint for joint in self.joints}
        self.axes = [
            MotorAxis(n, joints.get(n), joints[n].name if n in joints else f"{self.name}.{n}")
            for n in range(found.channels)
        ]
        beyond = [joint.name for joint in self.joints if joint.channel >= found.channels]
        if beyond:
            raise CallerError(f"{self.name} has {found.channels} channels; {', '.join(beyond)} is beyond")
        self._by_path = {f"duty.{axis.channel}": axis for axis in self.axes}
        self._by_path.update(zip(found.references, self.axes, strict=False))
        #: Whether set-points go out; whether the board was enabled and nothing has contradicted it.
        self.takes_set_points = self.is_enabled = False
        #: What makes duties of positions while the board is compliant; None: it is rigid.
        self.comply: Callable[[int], None] | None = None
        #: Channels whose home search or new zero is under way.
        self.homing: set[int] = set()
        self.is_triggered = self.settings.trigger
        # A neck's servo takes angles, which a filter of counts would round; without ticks it would come to a stand.
        is_filtered = self.kind != "neck" and self.host.rate_hz is not None
        self.filter_length = int(self.settings.filter) if is_filtered else 1
        self._awaited: dict[str, int] = {}
        self._filtering = False
        #: What references mean; see `set_control_mode`.
        self.control_mode = "position"
        self._held_until = 0
        #: The message of set-points while enabled: positions, or duties for boards whose joints are commanded so.
        self.set_message: str | None = self._declare_signals()
        self._receivers: dict[str, Callable[[Any, int], None]] = {}
        self._declare_polls()

    def _declare_signals(self) -> str | None:
        """Return each joint's signals; the message that sets them."""
        shape = self.shape
        commands = {axis.joint.command for axis in self.axes if axis.joint is not None}
        by_duty = "duty" in commands or (shape.reference is None and shape.pwm is not None)
        for axis in self.axes:
            pushes = self.is_pushed(axis.channel)
            able = {"duty", "position", "current"} if pushes else {"duty", "position"}
            if axis.joint is not None and axis.joint.command not in able:
                raise CallerError(
                    f"{self.name} cannot be given a {axis.joint.command} for {axis.name}: motors here take"
                    f" {'currents' if pushes else 'positions'} or duties"
                )
        if by_duty and commands - {"duty", "position"}:
            raise CallerError(f"{self.name}: a board is driven by duty or by references, not by both at once")
        if "duty" in commands and "position" in commands and shape.reference is not None:
            raise CallerError(
                f"{self.name}: its joints are driven by duty or by position, not by both at once"
            )
        message = shape.pwm if by_duty else shape.reference
        slow_s = max(0.1, 5 * self.settings.current_s)
        for axis in self.axes:
            path = ""
            if message is not None:
                path = self.path_of(axis, message)
                self._paths.setdefault(message, {})[path] = None
            if axis.joint is not None:
                if not by_duty and message is not None and path.startswith("position"):
                    self._declare_position(axis, axis.joint, f"{message}.{path}")
                else:
                    self._declare_position(axis, axis.joint, None)
                self._declare_duty(axis, axis.joint, f"{message}.{path}" if by_duty else None)
                if shape.current is not None:
                    pushed = not by_duty and path.startswith("finger")
                    most = axis.joint.max_current or 0.1
                    self.add_signal(
                        "current",
                        owner=axis.name,
                        unit=shape.current_unit,
                        of=[f"{reply}.current.{axis.channel}" for reply in shape.current.reply],
                        set=f"{message}.{path}" if pushed else None,
                        lower=-most if pushed else None,
                        upper=most if pushed else None,
                        stale_s=slow_s,
                        doc="magnitude" if shape.current_unit else "unit unknown",
                        source="hubo-ach" if shape.current_unit else "X1; X2",
                    )
                self._declare_status(axis)
        if shape.current is not None and shape.current_unit and shape.channels < 5:
            self.add_signal(
                "temperature",
                unit="°C",
                of=[f"{reply}.temperature" for reply in shape.current.reply],
                stale_s=slow_s,
                doc="the board's; hubo-ach calls this byte to be checked",
                source="hubo-ach",
            )
        if shape.status is not None and "StatusD08" in shape.status.reply:
            self.add_signal(
                "board_state",
                of="StatusD08.board_state",
                stale_s=max(0.1, 5 * self.settings.status_s),
                doc="first byte of the status, of unknown meaning",
                source="acesHubo",
            )
        return message

    def is_pushed(self, channel: int) -> bool:
        """Return whether what a channel is given is a current."""
        references = self.shape.references
        return channel < len(references) and references[channel].startswith("finger")

    def path_of(self, axis: MotorAxis, message: str) -> str:
        """Return where a channel's set-point is in a message."""
        return f"duty.{axis.channel}" if message == self.shape.pwm else self.shape.references[axis.channel]

    def _declare_position(self, axis: MotorAxis, joint: Joint, target: str | None) -> None:
        shape, knows_counts = self.shape, joint.counts_per_unit is not None
        if target is not None and not knows_counts:
            raise CallerError(
                f"{self.name}: {joint.name} needs gear or harmonic, and encoder, to follow positions"
            )
        if not shape.encoders or not knows_counts:
            return
        lower, upper = self._limits(axis, joint) if target is not None else (None, None)
        rate = self.host.rate_hz
        fresh = self.stale_s if rate is None else max(self.stale_s, 5 / rate)
        encoders = shape.encoder_reply(axis.channel)
        axis.position = self.add_signal(
            "position",
            owner=joint.name,
            unit="rad",
            set=target,
            from_si=self.neck_angle(axis) if self.kind == "neck" else axis.to_counts,
            lower=lower,
            upper=upper,
            stale_s=fresh,
            read_from=encoders,
            doc="encoder; set: where the board is to go",
            source="hubo-ach; HuboCan; acesHubo",
        )
        axis.velocity = self.add_signal(
            "velocity",
            owner=joint.name,
            unit="rad/s",
            stale_s=fresh,
            read_from=encoders,
            doc="from two encoder positions and their instants",
        )

    def _declare_duty(self, axis: MotorAxis, joint: Joint, target: str | None) -> None:
        shape = self.shape
        if target is not None:
            most = min(joint.max_duty or shape.largest_duty, shape.largest_duty)
            sign, steps = self._duty_sign(axis), 10 if shape.pwm == "PwmFine" else 1
            axis.duty = self.add_signal(
                "duty",
                owner=joint.name,
                unit=shape.duty_unit,
                set=target,
                from_si=lambda v: sign * int(v) if steps == 1 else sign * int(steps * v) / steps,
                lower=-most,
                upper=most,
                doc="open-loop PWM as last set; boards do not report it",
            )
        elif self.kind in (1, 2) and self.dialect == "D12" and joint.compliance is not None:
            axis.duty = self.add_signal(
                "duty", owner=joint.name, unit="%", doc="PWM as last sent while compliant"
            )
        if axis.duty is not None:
            axis.duty.stale_after_ns = None

    def _declare_status(self, axis: MotorAxis) -> None:
        shape = self.shape
        meanings: Mapping[str, str] = {}
        if shape.status is not None and shape.reports_drive:
            meanings = {**_DRIVE_STATUS, **(_HOME_STATUS if shape.has_home_flag else {})}
        elif (
            shape.status is not None
            and axis.channel < (3 if self.dialect == "D08X" else 2)
            and shape.channels < 5
        ):
            meanings = _SEARCH_STATUS
        stale_s = max(0.1, 5 * self.settings.status_s)
        replies = shape.status.reply if shape.status is not None else ()
        for name, doc in meanings.items():
            axis.signals[name] = self.add_signal(
                name, owner=axis.name, stale_s=stale_s, doc=doc, read_from=replies
            )

    def _limits(self, axis: MotorAxis, joint: Joint) -> tuple[float, float]:
        """Soft limits (rad): the file's, and never beyond what the reference's field holds."""
        most = 2 ** (self.shape.position_bits - 1) - 1
        if self.kind in (1, 2, "hand"):
            most = 2**23 - 1
        span = (0, 4095) if self.kind == "neck" else (-most, most)
        ends = sorted(map(axis.to_rad, span))
        lower = ends[0] if joint.lower is None else max(ends[0], joint.lower)
        upper = ends[1] if joint.upper is None else min(ends[1], joint.upper)
        return lower, upper

    def neck_angle(self, axis: MotorAxis) -> Callable[[float], float]:
        """Return a neck's reference in the spec's rad: whole steps of 4096 a turn, or of hubo-ach's 4095."""
        per_turn = int(self.settings.neck_counts)

        def code(position: float) -> float:
            steps = int((axis.direction * position + axis.zero) / tau * per_turn)
            return max(0, min(4095, steps)) * tau / 4096 - pi

        return code

    def _declare_polls(self) -> None:
        shape, polls = self.shape, list[Poll]()
        for ask in shape.encoders:
            polls.append(Poll(ask.message, ask.reply, ask.fields))
            self._receivers.update(dict.fromkeys(ask.reply, self._encoder_receiver(self.axes[ask.first :])))
        for slow, every_s in (
            (shape.status, self.settings.status_s),
            (shape.current, self.settings.current_s),
        ):
            if slow is not None:
                polls.append(Poll(slow.message, slow.reply, every_s=every_s))
        if shape.status is not None:
            take = self._receive_status if shape.reports_drive else self._receive_search
            self._receivers.update(dict.fromkeys(shape.status.reply, take))
        self.polls = polls

    def start(self) -> None:
        """Begin the hold-off of a start."""
        self.hold_off(self.settings.hold_start_s)

    # ------------------------------------------------------------------ up

    def received(self, record: Any, instant: int) -> None:
        """Take a record of this board."""
        take = self._receivers.get(type(record).__name__)
        if take is not None:
            take(record, instant)

    def _encoder_receiver(self, axes: list[MotorAxis]) -> Callable[[Any, int], None]:
        is_neck = self.kind == "neck"

        def take(record: Any, instant: int) -> None:
            homing = self.homing
            for axis, count in zip(axes, record.position, strict=False):
                if is_neck:
                    count = round((count + pi) * 4096 / tau)
                axis.received(count, instant, not homing or axis.channel not in homing)
            if self.comply is not None:
                self.comply(instant)

        return take

    def _receive_status(self, record: Any, instant: int) -> None:
        """Switches, home flags and errors of D12."""
        news: list[str] = []
        gone: list[str] = []
        lost: list[str] = []
        on, wrong = True, False
        for axis, motor in zip(self.axes, record.motor, strict=False):
            if self.shape.has_home_flag:
                drive, names = motor.drive, (*motor.drive, *motor.errors)
                lost += self._home_lost(axis, motor.home in HOMED)
                axis.show("home", motor.home, instant)
                axis.show("homed", axis.was_homed, instant)
            else:
                drive, names = motor, tuple(motor)
            axis.is_on = is_on = "driver_on" in drive and (
                not self.shape.has_switches or "control_on" in drive
            )
            if axis.joint is None:
                continue
            bad = tuple(name for name in names if name not in _SWITCHES)
            on, wrong = on and is_on, wrong or bool(bad)
            before = axis.signals["errors"].last or ()
            for name, value in (("status", names), ("enabled", is_on), ("errors", bad)):
                axis.signals[name].update(value, instant)
            news += [f"{axis.name}: {name}" for name in bad if name not in before]
            gone += [f"{axis.name}: {name}" for name in before if name not in bad]
        if news:
            self.emit_event("alarm", ", ".join(news))
        if gone:
            self.emit_event("alarm over", ", ".join(gone))
        if lost:
            self.rebooted(f"{', '.join(lost)} lost its home")
        elif self.is_enabled and not on and not self.homing:
            if wrong:
                self.quiet()
                self.emit_event("alarm", "the board has switched itself off")
            else:
                self.rebooted("drivers or control went off without a command")

    def _receive_search(self, record: Any, instant: int) -> None:
        """Home searches of D08."""
        lost: list[str] = []
        for axis, motor in zip(self.axes, record.motor, strict=False):
            lost += self._home_lost(axis, search_state(motor) == "done")
            parts = ("origin", "limit_switch", "encoder")
            meanings = tuple(
                f"{part}_{getattr(motor, part)}" for part in parts if getattr(motor, part) != "none"
            )
            axis.show("status", meanings, instant)
            axis.show("homed", axis.was_homed, instant)
        if lost:
            self.rebooted(f"{', '.join(lost)} lost its home")

    def _home_lost(self, axis: MotorAxis, is_homed: bool) -> list[str]:
        """Note whether a channel is homed; its name where it no longer is."""
        is_lost = axis.was_homed and not is_homed and axis.channel not in self.homing
        axis.was_homed = is_homed
        return [axis.name] if is_lost else []

    def rebooted(self, detail: str) -> None:
        """Note that the board has lost its settings: nothing moves until it is enabled again."""
        self.quiet()
        for axis in self.axes:
            axis.forget()
        super().rebooted(detail)

    # ------------------------------------------------------------------ down

    def want(self, message: str, path: str, value: Any) -> None:
        """Keep a set-point for the next tick while the board is enabled; otherwise report it as not sent."""
        if not self.takes_set_points:
            super().want(message, path, value)  # which reports it
            return
        axis = self._by_path[path]
        axis.reference, axis.goal = value, None
        if self.comply is not None:
            return  # the set-point is what the duties are made from
        if self.filter_length > 1 and path.startswith("position"):
            axis.goal, axis.reference = float(value), self._given.get(message, {}).get(path, value)
            self._filtering = True
            return
        if axis.duty is not None and message == self.shape.pwm:
            axis.duty.update(value * self._duty_sign(axis), self.clock.now())
        if self.is_triggered:
            self._awaited[path] = value
            if len(self._awaited) < len(self.joints):
                return
            for known, waiting in self._awaited.items():
                super().want(message, known, waiting)
            self._awaited.clear()
            return
        super().want(message, path, value)

    def is_followed(self, signal: Signal) -> bool:
        """Return False while it is compliant, searches its home, or takes references for currents."""
        return (
            self.comply is None
            and not self.homing
            and self.control_mode in ("position", "hybrid")
            and super().is_followed(signal)
        )

    def want_raw(self, message: str, path: str, value: Any) -> None:
        """Set a field for the next tick, unfiltered."""
        super().want(message, path, value)

    def _duty_sign(self, axis: MotorAxis) -> int:
        """Return the sign on the wire of a duty that drives a joint upwards."""
        return self.shape.positive * (axis.direction if self.shape.reference is not None else 1)

    def give(self, axis: MotorAxis, value: Any) -> None:
        """Pass a set-point on behind filter, trigger and compliance."""
        message = self.set_message
        if message is None:
            return
        axis.reference, axis.goal = value, None
        super().want(message, self.path_of(axis, message), value)

    def due_messages(self, now: int) -> list[str]:
        """Return what is to be sent in this tick; filters move on."""
        if self._filtering:
            self._filter()
        return super().due_messages(now)

    def _filter(self) -> None:
        """(old × (n − 1) + new) ÷ n, as hubo-ach; whole counts, the last one exactly."""
        length = self.filter_length
        busy = False
        for axis in self.axes:
            goal, old = axis.goal, axis.reference
            if goal is None or old is None:
                continue
            new = (old * (length - 1) + goal) / length
            step = int(new) if abs(goal - new) > 1 else round(goal)
            if step == old:
                step += (goal > old) - (goal < old)
            self.give(axis, step)
            if step != goal:
                axis.goal = goal
                busy = True
        self._filtering = busy

    def default_of(self, message: str, path: str) -> Any:
        """Return what a channel without a joint is sent: where it is; no duty."""
        if path.startswith("duty"):
            return 0
        if path.startswith("finger"):
            return 0.0
        axis = self._by_path[path]
        return None if axis.joint is not None else axis.count

    def completed(self, message: str, fields: dict[str, Any]) -> dict[str, Any]:
        """Return a one-channel board repeats its reference; duties without a sign get their direction; the mode."""
        shape = self.shape
        if message == "Reference":
            if shape.channels == 1:
                fields["position"] = fields["position"] * 2
        elif message == shape.pwm:
            duties = fields["duty"]
            if shape.pwm == "PwmFine" and shape.channels == 1:
                duties = fields["duty"] = [*duties, 0]
            if shape.pwm_mode is not None:
                fields["mode"] = shape.pwm_mode
            if not shape.pwm_signed:
                fields.update(unsigned(duties, shape.directions))
        return fields

    def hold_off(self, duration_s: float) -> None:
        """Send no references for a while; a hold-off that lasts longer goes on."""
        until = self.clock.now() + round(duration_s * 1e9)
        if until > self._held_until:
            self._held_until = until
            if self.set_message is not None and self.follows:
                self.hold(self.set_message, duration_s)

    @property
    def follows(self) -> bool:
        """True if set-points are references, not duties."""
        return self.set_message is not None and self.set_message != self.shape.pwm

    @property
    def hand_mode(self) -> str:
        """Mode of a DRC-Hubo hand's fingers: `hybrid` (currents) or `position`."""
        return "position" if self.set_message == "ReferenceHandPosition" else "hybrid"

    def quiet(self) -> None:
        """Send no set-points any more."""
        self.takes_set_points = self.is_enabled = self._filtering = False
        self.comply = None
        for message in (self.set_message, self.shape.pwm):
            if message is not None:
                self.drop(message)
        self._awaited.clear()
        for axis in self.axes:
            axis.reference = axis.goal = None
            if axis.duty is not None:
                axis.duty.update(0.0, self.clock.now())

    def fail(self, text: str) -> DeviceError:
        """Return an error of this board."""
        return DeviceError(f"{self.host.name} {self.name}: {text}")


def search_state(motor: Any) -> str:
    """Return how far a home search of D08 is: "failed" before "done" before "searching", as acesHubo looks at it."""
    if motor.origin == "fail" or motor.limit_switch == "fail":
        return "failed"
    return "done" if motor.origin == "ok" and motor.limit_switch == "ok" else "searching"


def unsigned(duties: Any, directions: tuple[str, str]) -> dict[str, Any]:
    """Duties as magnitudes with a direction each."""
    return {
        "direction": [directions[value < 0] for value in duties],
        "duty": [abs(value) for value in duties],
    }
