"""What all parts of the driver share: a board's channels, what is heard of them, what they are to be told.

1. What is sent and heard by which kind of board stands in `shapes`; what one channel is, in `axis`.
2. References go out in each tick, one frame a board, and only while the board is enabled and no hold-off runs: 0.8 s after
   the start, 3 s after a home command (hubo-ach). A set-point that nobody will send is told ("not sent"), never kept.
3. A board that forgot what it was told (home flag lost, control off without an error) gets nothing more until it is
   enabled again.
4. Switching is in `switching`, homing in `homing`, what is stored in a board in `storage`, compliance in `compliance`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any, ClassVar

from aces_bus.device import Device, Poll
from aces_bus.device.coalesce import Setpoint
from aces_bus.errors import CallerError, DeviceError, UnknownNameError
from aces_protocols.hubo.spec import hubo

from .axis import MotorAxis, joints_by_channel
from .settings import Settings
from .shapes import SHAPES, Shape

#: Status bits that are no error.
_SWITCHES = ("driver_on", "control_on", "current_mode", "limit_switch")
#: Home flags that say that a joint is homed: 6, and 2 of a wrist roll (hubo-ach).
HOMED = ("homed", "wrist_roll_homed")


class BoardCore(Device):
    """What all parts of the driver share: the channels, what is heard of them, what they are to be told."""

    protocol = hubo
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

    shape: Shape
    axes: list[MotorAxis]

    def setup(self) -> None:
        """Signals of the joints, polls of the board."""
        dialect = self.variant.dialect or "D12"
        kind = self.config.kind if isinstance(self.config.kind, (int, str)) else self.config.channels
        found = SHAPES.get((dialect, kind)) if kind is not None else None
        if found is None:
            raise UnknownNameError(
                f"kind of Hubo motor board of {dialect} ({self.name})",
                str(kind),
                [str(k) for d, k in SHAPES if d == dialect],
            )
        self.dialect, self.kind, self.shape = dialect, kind, found
        self.settings = Settings(self.name, self.config.settings)
        self.axes = joints_by_channel(self.joints, found.channels, self.name)
        beyond = [joint.name for joint in self.joints if joint.channel >= found.channels]
        if beyond:
            raise CallerError(f"{self.name} has {found.channels} channels; {', '.join(beyond)} is beyond")
        self._by_path = {f"duty.{axis.channel}": axis for axis in self.axes}
        self._by_path.update(zip(found.references, self.axes, strict=False))
        #: Whether set-points go out; whether the board was enabled and nothing has been heard against it.
        self.is_streaming = self.is_enabled = False
        self.is_compliant = False
        #: Channels whose home search or new zero is under way.
        self.homing: set[int] = set()
        self.is_triggered = self.settings.trigger
        self.filter_length = int(self.settings.known("filter"))
        self._awaited: dict[str, int] = {}
        self._filtering = False
        self._held_until = 0
        #: The message of set-points while enabled: positions, or duties for boards whose joints are commanded so.
        self.set_message: str | None = self._declare_signals()
        self._hearers: dict[str, Callable[[Any, int], None]] = {}
        self._declare_polls()

    def _declare_signals(self) -> str | None:
        """Each joint's signals; the message that sets them."""
        shape = self.shape
        commands = {axis.joint.command for axis in self.axes if axis.joint is not None}
        by_duty = "duty" in commands or (shape.reference is None and shape.pwm is not None)
        for axis in self.axes:
            pushes = axis.channel < len(shape.references) and shape.references[axis.channel].startswith(
                "finger"
            )
            if axis.joint is not None and axis.joint.command not in (
                "duty",
                "current" if pushes else "position",
            ):
                if not (pushes and axis.joint.command == "position"):
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
        for axis in self.axes:
            path = ""
            if message is not None:
                path = f"duty.{axis.channel}" if by_duty else shape.references[axis.channel]
                self._paths.setdefault(message, {})[path] = None
            if axis.joint is not None:
                self._declare_axis(axis, None if by_duty else message, message if by_duty else None, path)
        if shape.current is not None and shape.current_unit and shape.channels < 5:
            self.board_temperature = self.add_signal(
                "temperature",
                unit="°C",
                of=[f"{reply}.temperature" for reply in shape.current.reply],
                stale_s=self._slow("current_s"),
                doc="the board's; hubo-ach calls this byte to be checked",
                source="hubo-ach",
            )
        if shape.status is not None and "StatusD08" in shape.status.reply:
            self.add_signal(
                "board_state",
                of="StatusD08.board_state",
                stale_s=self._slow("status_s"),
                doc="first byte of the status, of unknown meaning",
                source="acesHubo",
            )
        return message

    def _slow(self, key: str) -> float:
        return max(0.1, 5 * self.settings.known(key))

    def _declare_axis(self, axis: MotorAxis, reference: str | None, pwm: str | None, path: str) -> None:
        shape, joint = self.shape, axis.joint
        assert joint is not None
        owner = joint.name
        knows_counts = joint.counts_per_unit is not None
        if reference is not None and not knows_counts and path.startswith("position"):
            raise CallerError(f"{self.name}: {owner} needs gear, harmonic and encoder to follow positions")
        by_position = reference is not None and path.startswith("position")
        rate = self.host.rate_hz
        fresh = self.stale_s if rate is None else max(self.stale_s, 5 / rate)
        if shape.encoders and knows_counts:
            lower, upper = self._limits(axis)
            axis.position = self.add_signal(
                "position",
                owner=owner,
                unit="rad",
                set=f"{reference}.{path}" if by_position else None,
                from_si=self._neck(axis) if self.kind == "neck" else axis.to_counts,
                lower=lower if by_position else None,
                upper=upper if by_position else None,
                stale_s=fresh,
                doc="encoder; set: where the board is to go",
                source="hubo-ach; HuboCan; acesHubo",
            )
            axis.velocity = self.add_signal(
                "velocity",
                owner=owner,
                unit="rad/s",
                stale_s=fresh,
                doc="from two encoder positions and their instants",
            )
            self.readable.update((axis.position.name, axis.velocity.name))
        if pwm is not None:
            most = min(joint.max_duty or shape.largest_duty, shape.largest_duty)
            sign = shape.positive * (axis.direction if shape.reference is not None else 1)
            whole = shape.pwm != "PwmFine"
            axis.duty = self.add_signal(
                "duty",
                owner=owner,
                unit=shape.duty_unit,
                set=f"{pwm}.{path}",
                from_si=(lambda v: sign * int(v)) if whole else (lambda v: sign * int(10 * v) / 10),
                lower=-most,
                upper=most,
                doc="open-loop PWM as last set; boards do not report it",
            )
        elif self.kind in (1, 2) and self.dialect == "D12" and joint.compliance is not None:
            axis.duty = self.add_signal("duty", owner=owner, unit="%", doc="PWM as last sent while compliant")
        if axis.duty is not None:
            axis.duty.stale_after_ns = None
        fed = reference is not None and path.startswith("finger")
        if shape.current is not None:
            axis.current = self.add_signal(
                "current",
                owner=owner,
                unit=shape.current_unit,
                of=[f"{reply}.current.{axis.channel}" for reply in shape.current.reply],
                set=f"{reference}.{path}" if fed else None,
                lower=-(joint.max_current or 0.1) if fed else None,
                upper=(joint.max_current or 0.1) if fed else None,
                stale_s=self._slow("current_s"),
                doc="magnitude" if shape.current_unit else "unit unknown",
                source="hubo-ach" if shape.current_unit else "X1; X2",
            )
        if shape.status is not None:
            self._declare_status(axis, owner)

    def _declare_status(self, axis: MotorAxis, owner: str) -> None:
        stale = self._slow("status_s")
        shape = self.shape
        if shape.reports_drive:
            axis.status = self.add_signal(
                "status", owner=owner, stale_s=stale, doc="names of all bits that are set"
            )
            axis.errors = self.add_signal(
                "errors", owner=owner, stale_s=stale, doc="names of the error bits that are set"
            )
            axis.enabled = self.add_signal(
                "enabled", owner=owner, stale_s=stale, doc="driver and control are on"
            )
            self.readable.update(s.name for s in (axis.status, axis.errors, axis.enabled))
            if shape.has_home_flag:
                axis.home = self.add_signal(
                    "home", owner=owner, stale_s=stale, doc="the home flag: 6 (homed), or a code"
                )
                axis.homed = self.add_signal("homed", owner=owner, stale_s=stale, doc="the home flag says so")
                self.readable.update(s.name for s in (axis.home, axis.homed))
        elif axis.channel < (3 if self.dialect == "D08X" else 2) and shape.channels < 5:
            axis.status = self.add_signal(
                "status", owner=owner, stale_s=stale, doc="home search: origin, limit switch, encoder"
            )
            axis.homed = self.add_signal(
                "homed", owner=owner, stale_s=stale, doc="the home search ended well"
            )
            self.readable.update(s.name for s in (axis.status, axis.homed))

    def _limits(self, axis: MotorAxis) -> tuple[float, float]:
        """Soft limits (rad): the file's, and never beyond what the reference's field holds."""
        most = 2 ** (self.shape.position_bits - 1) - 1
        if self.kind in (1, 2, "hand"):
            most = 2**23 - 1
        ends = sorted((axis.to_rad(-most), axis.to_rad(most)))
        if self.kind == "neck":
            ends = sorted((axis.to_rad(0), axis.to_rad(4095)))
        joint = axis.joint
        assert joint is not None
        lower = ends[0] if joint.lower is None else max(ends[0], joint.lower)
        upper = ends[1] if joint.upper is None else min(ends[1], joint.upper)
        return lower, upper

    def _neck(self, axis: MotorAxis) -> Callable[[float], float]:
        """A neck's reference in the spec's rad: whole steps of 4096 a turn, or of hubo-ach's 4095."""
        from math import pi, tau

        per_turn = int(self.settings.known("neck_counts"))

        def code(position: float) -> float:
            steps = int((axis.direction * position + axis.zero) / tau * per_turn)
            return max(0, min(4095, steps)) * tau / 4096 - pi

        return code

    def _declare_polls(self) -> None:
        shape, polls = self.shape, list[Poll]()
        for ask in shape.encoders:
            polls.append(Poll(ask.message, ask.reply, ask.fields))
            axes = self.axes[ask.first :]
            hear = self._neck_hearer(axes) if self.kind == "neck" else self._encoder_hearer(axes)
            self._hearers.update(dict.fromkeys(ask.reply, hear))
        if shape.status is not None:
            polls.append(
                Poll(
                    "SendStatus",
                    shape.status.reply,
                    every_s=self.settings.known("status_s"),
                    timeout_s=0.05,
                )
            )
            hear = self._hear_status if shape.reports_drive else self._hear_search
            self._hearers.update(dict.fromkeys(shape.status.reply, hear))
        if shape.current is not None:
            polls.append(
                Poll(
                    "SendCurrent",
                    shape.current.reply,
                    every_s=self.settings.known("current_s"),
                    timeout_s=0.05,
                )
            )
        self.polls = polls

    def start(self) -> None:
        """The start's hold-off begins."""
        self.hold_off(self.settings.known("hold_start_s"))

    def axis(self, joint: str | None) -> MotorAxis | None:
        """The axis of a joint by name, alias or channel number; None for None. Raises `UnknownNameError`."""
        if joint is None:
            return None
        for axis in self.axes:
            own = axis.joint
            if own is not None and (joint == own.name or joint in own.aliases):
                return axis
            if joint in (str(axis.channel), axis.name):
                return axis
        raise UnknownNameError(f"joint of {self.name}", joint, [axis.name for axis in self.axes])

    def chosen(self, joint: str | None) -> list[MotorAxis]:
        """The axes that an action is for: one, or all that have a joint (all, where none has one)."""
        axis = self.axis(joint)
        if axis is not None:
            return [axis]
        return [axis for axis in self.axes if axis.joint is not None] or self.axes

    # ------------------------------------------------------------------ up

    def heard(self, record: Any, instant: int) -> None:
        """A record of this board."""
        hear = self._hearers.get(type(record).__name__)
        if hear is not None:
            hear(record, instant)

    def _encoder_hearer(self, axes: list[MotorAxis]) -> Callable[[Any, int], None]:
        def hear(record: Any, instant: int) -> None:
            homing = self.homing
            for axis, count in zip(axes, record.position, strict=False):
                axis.heard(count, instant, not homing or axis.channel not in homing)
            if self.is_compliant:
                self.comply(instant)

        return hear

    def _neck_hearer(self, axes: list[MotorAxis]) -> Callable[[Any, int], None]:
        from math import pi, tau

        def hear(record: Any, instant: int) -> None:
            for axis, angle in zip(axes, record.position, strict=False):
                axis.heard(round((angle + pi) * 4096 / tau), instant, True)

        return hear

    def _hear_status(self, record: Any, instant: int) -> None:
        """Switches, home flags and errors of D12."""
        news: list[str] = []
        gone: list[str] = []
        on = True
        wrong = False
        lost: list[str] = []
        for axis, motor in zip(self.axes, record.motor, strict=False):
            if self.shape.has_home_flag:
                drive, errors, home = motor.drive, motor.errors, motor.home
                homed = home in HOMED
                if axis.was_homed and not homed and axis.channel not in self.homing:
                    lost.append(axis.name)
                axis.was_homed = homed
                names = (*drive, *errors)
                if axis.home is not None and axis.homed is not None:
                    axis.home.update(home, instant)
                    axis.homed.update(homed, instant)
            else:
                drive, names = motor, tuple(motor)
            if axis.joint is None:
                continue
            bad = tuple(name for name in names if name not in _SWITCHES)
            is_on = "driver_on" in drive and (not self.shape.has_switches or "control_on" in drive)
            on = on and is_on
            if axis.status is not None and axis.errors is not None and axis.enabled is not None:
                before = axis.errors.last or ()
                axis.status.update(names, instant)
                axis.enabled.update(is_on, instant)
                axis.errors.update(bad, instant)
                if bad != before:
                    news += [f"{axis.name}: {name}" for name in bad if name not in before]
                    gone += [f"{axis.name}: {name}" for name in before if name not in bad]
            wrong = wrong or bool(bad)
        if news:
            self.tell_event("alarm", ", ".join(news))
        if gone:
            self.tell_event("alarm over", ", ".join(gone))
        if lost:
            self.rebooted(f"{', '.join(lost)} lost its home")
        elif self.is_enabled and not on and not self.homing:
            if wrong:
                self.quiet()
                self.tell_event("alarm", "the board has switched itself off")
            else:
                self.rebooted("drivers or control are off, and nobody switched them")

    def _hear_search(self, record: Any, instant: int) -> None:
        """Home searches of D08."""
        lost: list[str] = []
        for axis, motor in zip(self.axes, record.motor, strict=False):
            homed = search_state(motor) == "done"
            if axis.was_homed and not homed and axis.channel not in self.homing:
                lost.append(axis.name)
            axis.was_homed = homed
            if axis.status is not None and axis.homed is not None:
                names = (
                    ("origin", motor.origin),
                    ("limit_switch", motor.limit_switch),
                    ("encoder", motor.encoder),
                )
                axis.status.update(
                    tuple(f"{name}_{value}" for name, value in names if value != "none"), instant
                )
                axis.homed.update(homed, instant)
        if lost:
            self.rebooted(f"{', '.join(lost)} lost its home")

    def rebooted(self, detail: str) -> None:
        """The board has forgotten what it was told: nothing moves until it is enabled again."""
        self.quiet()
        for axis in self.axes:
            axis.forget()
        super().rebooted(detail)

    # ------------------------------------------------------------------ down

    def want(self, message: str, path: str, value: Any) -> None:
        """A set-point: kept for the next tick while enabled, else told as not sent."""
        if not self.is_streaming:
            self.tell_event("not sent", f"{self.name} is not enabled: {message}.{path} = {value}")
            return
        axis = self._axis_at(path)
        axis.reference = value
        axis.goal = None
        if self.is_compliant:
            return  # the set-point is what the duties are made from
        if self.filter_length > 1 and path.startswith("position"):
            axis.goal, axis.reference = float(value), self._given.get(message, {}).get(path, value)
            self._filtering = True
            return
        if axis.duty is not None and message == self.shape.pwm:
            axis.duty.update(self._duty_of(axis, value), self.clock.now())
        if self.is_triggered:
            self._awaited[path] = value
            if len(self._awaited) < len(self.joints):
                return
            for known, waiting in self._awaited.items():
                super().want(message, known, waiting)
            self._awaited.clear()
            return
        super().want(message, path, value)

    def want_raw(self, message: str, path: str, value: Any) -> None:
        """A field for the next tick, as it is."""
        super().want(message, path, value)

    def _duty_of(self, axis: MotorAxis, value: float) -> float:
        shape = self.shape
        return value * shape.positive * (axis.direction if shape.reference is not None else 1)

    def _axis_at(self, path: str) -> MotorAxis:
        return self._by_path[path]

    def give(self, axis: MotorAxis, value: Any) -> None:
        """A set-point past filter, trigger and compliance."""
        message = self.set_message
        if message is None:
            return
        path = f"duty.{axis.channel}" if message == self.shape.pwm else self.shape.references[axis.channel]
        axis.reference, axis.goal = value, None
        super().want(message, path, value)

    def wants(self, now: int) -> list[Setpoint]:
        """What is to be sent in this tick; filters move on."""
        if self._filtering:
            self._filter()
        return super().wants(now)

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
        """What a channel without a joint is sent: where it is; no duty."""
        if path.startswith("duty"):
            return 0
        if path.startswith("finger"):
            return 0.0
        axis = self._axis_at(path)
        if axis.joint is not None:
            return None
        return axis.count

    def completed(self, message: str, fields: dict[str, Any]) -> dict[str, Any]:
        """A one-channel board repeats its reference; duties without a sign get their direction; the mode."""
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
        """No references for a while; a hold-off that lasts longer goes on."""
        until = self.clock.now() + round(duration_s * 1e9)
        if until > self._held_until:
            self._held_until = until
            if self.set_message is not None and self.follows:
                self.hold(self.set_message, duration_s)

    @property
    def follows(self) -> bool:
        """Whether its set-points are references, not duties."""
        return self.set_message is not None and self.set_message != self.shape.pwm

    @property
    def hand_mode(self) -> str:
        """What a DRC-Hubo hand's fingers are given: currents (hybrid), or positions."""
        return "position" if self.set_message == "ReferenceHandPosition" else "hybrid"

    def quiet(self) -> None:
        """No set-points any more."""
        self.is_streaming = self.is_enabled = self.is_compliant = self._filtering = False
        for message in (self.set_message, self.shape.pwm):
            if message is not None:
                self.drop(message)
        self._awaited.clear()
        for axis in self.axes:
            axis.reference = axis.goal = None
            if axis.duty is not None:
                axis.duty.update(0.0, self.clock.now())

    def fail(self, text: str) -> DeviceError:
        """An error of this board."""
        return DeviceError(f"{self.host.name} {self.name}: {text}")

    def comply(self, instant: int) -> None:
        """One step of compliant motion; see `compliance`."""
        raise NotImplementedError


def search_state(motor: Any) -> str:
    """How a home search of D08 stands: "failed" before "done" before "searching", as acesHubo looks at it."""
    if motor.origin == "fail" or motor.limit_switch == "fail":
        return "failed"
    return "done" if motor.origin == "ok" and motor.limit_switch == "ok" else "searching"


def unsigned(duties: Any, directions: tuple[str, str]) -> dict[str, Any]:
    """Duties as magnitudes with a direction each."""
    return {
        "direction": [directions[value < 0] for value in duties],
        "duty": [abs(value) for value in duties],
    }
