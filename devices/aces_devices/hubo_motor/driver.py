"""The driver `hubo_motor`: one board of 1, 2, 3 or 5 motors.

Which messages a board of a kind and dialect is sent is in `shapes`, what a channel knows in `axis`, what is stored in a
board in `parameters`.

1. References go out in each tick, one frame a board, and only while the board is enabled and no hold-off runs: 0.8 s after
   the start, 3 s after a home command (hubo-ach). A set-point that will not be sent is reported ("not sent"), never kept.
2. A board that forgot its settings (home flag lost, control off without an error) gets nothing more until it is
   enabled again.
3. Before anything is switched on, the set-points are where the joints are (hubo-ach), and have been sent. Enabling is over
   when the board's status says so, where it has one.
4. Home commands are sent, then watched: progress, success, failure by status, by a stop, or by time. No board of the bus is
   sent references for 3 s after a home command, and the board itself none while it searches.
5. A board lists only the actions that its kind and dialect have; what can lose a board or its calibration wants
   `confirm=True`.
6. Parameters and currents come on one identifier, and only the open request tells them apart: while parameters are read,
   currents are not asked for. Halves that the board cuts across blocks are put together here.

Enable: D08 NameInfo and gains, then as D12: reference = present position, FET switch 0x0B, control on 0x0E. Disable: 0x0F,
then 0x0B with 0 (facts, 5.6). Hands of five fingers take no control on and off (hubo-ach); theirs is a duty of 0.

Compliance (hubo-ach; D12, one and two channels): the host closes the position loop itself, softly, by duties. Each encoder
reply gives one duty of both channels; no reference is sent meanwhile. Duty (0.1 %) =
−(10 Kp (ref − pos) − 10 Kd vel + 10 pwm), limited to 10 maxPWM: the Kp term, the Kd term and the sum are each truncated
toward zero, as hubo-ach does. Kp is in %/rad. Back to rigid: reference = position, control on, then a filter of length 400
until |error| is at most 0.0075 rad.

Homing of D12: the settings are stored in the board (0x11 with bit 1). Success: home flag 6 (2 for wrist rolls), |position|
at most 0.0075 rad (hubo-ach). Boards of three and more channels have no home flag: there a joint that has moved or met its
switch, then rests near zero, is homed. Homing of D08: offset and direction are sent, the status byte says 5 (done) or
10 (failed), masked with 0x0F; each joint is tried 2 times, arms 3 times (acesHubo).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from math import pi, tau
from typing import Any, ClassVar, Literal

import msgspec

from aces_bus.device import HostLoss, Job, MotorDevice, Poll, Steps, Ticket
from aces_bus.device.config import Joint
from aces_bus.device.settings import settings_of
from aces_bus.device.signals import Signal
from aces_bus.device.ticket import Awaited
from aces_bus.errors import CallerError, DeviceError, NoReplyError
from aces_bus.protocol import Record
from aces_protocols.hubo.spec import hubo

from .axis import (
    ARRIVED,
    HOMED,
    MotorAxis,
    compliant_duties,
    home_fields,
    home_of,
    home_power,
    name_info,
    search_state,
    unsigned,
    why_not_home,
)
from .parameters import (
    BOARD_BLOCKS,
    CHANNEL_BLOCKS,
    OF_BOARD,
    WRITES,
    BoardParameters,
    ChannelParameters,
    channel_parameters,
    selector,
)
from .shapes import BoardSettings, shape_of

#: Status bits that are not an error.
_SWITCHES = ("driver_on", "control_on", "current_mode", "limit_switch")
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


#: Between two requests that one board is sent by a job (ns).
PAUSE_NS = 2_000_000


#: The filter's length on the way back to rigid (hubo-ach).
RIGID_FILTER = 400
#: Between two looks at a search (ns).
LOOK_NS = 50_000_000
#: A joint without a home flag must have rested for so long (ns).
REST_NS = 300_000_000
#: A reply may take so long (s): hubo-ach waits 180 ms.
READ_TIMEOUT_S = 0.18
#: Parameter → the command that writes it.
_COMMAND_OF = {name: message for message, names in WRITES.items() for name in names}
#: Defaults of what cannot be read back.
_USUAL: Mapping[str, Any] = {"homing_duty": 30, "temperature_warning": 80}

_ALWAYS = {
    "enable": "follow set-points, from where the joints are",
    "disable": "control off, drivers off",
}
_GAINS = {"set_gains": "position gains of a joint, kp= ki= kd=, or torque=True"}
_HOME = {"home": "search the home of a joint, or of all; it moves"}
_ZERO = {"zero_encoder": "make the present position the encoder's zero"}
_MODE = {"set_control_mode": "position, current or torque, hybrid"}
_D12 = {
    "clear_errors": "clear error bits; also sets the encoder to zero",
    "parameters": "read all that is stored in the board",
    "set_parameters": "write stored parameters of a joint or the board, name=value",
    "set_limits": "the board's own position limits, lower= upper= (rad)",
    "override_gains": "scale the gains of the first two motors, in %",
    "switching_mode": "free_wheeling=True: the motor turns freely",
    "beep": "beep for some seconds",
    "alarm": "alarm sound 1 to 4; 0 is silence",
    "initialise": "load the board's defaults, confirm=True; its calibration is lost",
    "set_board_number": "give the board another number, confirm=True",
}
_INFO = {"board_info": "ask the board what it is; sets its period"}
_COMPLIANCE = {"set_compliance": "let the joints give way (on), or be rigid again (off)"}


class HuboMotor(MotorDevice[MotorAxis]):
    """One motor board."""

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

    asking = ("parameters",)
    axes: list[MotorAxis]

    def setup(self) -> None:
        """Add signals of the joints, polls of the board."""
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
        self.actions = self._possible_actions()  # type: ignore[misc]

    def _possible_actions(self) -> dict[str, str]:
        shape = self.shape
        actions = dict(_ALWAYS)
        if shape.gains:
            actions |= _GAINS | _MODE
        if shape.home is not None:
            actions |= _HOME
        if shape.encoders and self.kind != "neck":
            actions |= _ZERO
        if self.dialect == "D12" and self.kind != "neck":
            actions |= _D12
        if self.knows_name():
            actions |= _INFO
        soft = [axis.joint.compliance is not None for axis in self.axes if axis.joint is not None]
        if (
            self.dialect == "D12"
            and self.kind in (1, 2)
            and soft
            and all(soft)
            and self.set_message == "Reference"
        ):
            actions |= _COMPLIANCE
        return actions

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
        """Return soft limits (rad): the file's, and never beyond what the reference's field holds."""
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

    def received(self, record: Record, instant: int) -> None:
        """Take a record of this board."""
        take = self._receivers.get(type(record).__name__)
        if take is not None:
            take(record, instant)

    def _encoder_receiver(self, axes: list[MotorAxis]) -> Callable[[Any, int], None]:
        is_neck = self.kind == "neck"

        def take(record: Record, instant: int) -> None:
            homing = self.homing
            for axis, count in zip(axes, record.position, strict=False):
                if is_neck:
                    count = round((count + pi) * 4096 / tau)
                axis.received(count, instant, not homing or axis.channel not in homing)
            if self.comply is not None:
                self.comply(instant)

        return take

    def _receive_status(self, record: Record, instant: int) -> None:
        """Take switches, home flags and errors of D12."""
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

    def _receive_search(self, record: Record, instant: int) -> None:
        """Take home searches of D08."""
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
        """Return (old × (n − 1) + new) ÷ n, as hubo-ach; whole counts, the last one exactly."""
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

    # ------------------------------------------------------------------ switching

    def enable(self) -> Job:
        """Follow set-points from now on, beginning where the joints are. Waits for a hold-off to end."""
        self.end_led("enable")
        self.is_driven = True
        return self.lead("enable", self._enabling)

    def _enabling(self, job: Job) -> Steps:
        shape = self.shape
        if self._held_until > self.clock.now():
            job.text = "hold-off"
            yield self._held_until - self.clock.now()
        self.quiet()
        if shape.name_info is not None:
            yield from self.initial_steps()
        job.progress, job.text = 0.3, "position"
        yield from self.reading_positions()
        message = self.set_message
        self.takes_set_points = True
        if message is not None:
            for axis in self.axes:
                if axis.joint is not None:
                    self.give(axis, self.present(axis))
            yield self.tick_ns()
        job.progress, job.text = 0.6, "switches"
        if self.kind == "hand":
            yield self.send("ControlMode", mode=self.hand_mode)
        if shape.has_driver_switch:
            yield self.send("DriverSwitch", state="on")
        if shape.has_switches:
            yield self.send("ControlOn")
        if shape.reports_drive and shape.status is not None:
            yield from self._seeing_enabled(job)
        self.is_enabled = True

    def present(self, axis: MotorAxis) -> float:
        """Return the set-point at which a channel stays where it is."""
        if self.set_message == self.shape.pwm:
            return 0
        if self.is_pushed(axis.channel):
            return 0.0 if self.hand_mode == "hybrid" else 0
        if self.kind == "neck":
            return self.neck_angle(axis)(axis.to_rad(axis.count or 0))
        return axis.count or 0

    def tick_ns(self) -> int:
        """Return the time until the next tick has surely sent what was given (ns)."""
        rate = self.host.rate_hz
        return PAUSE_NS if rate is None else round(1e9 / rate) + PAUSE_NS

    def reading_positions(self) -> Steps:
        """Ask for the encoders, whatever is known of them."""
        for ask in self.shape.encoders:
            yield self.ask(ask.message, reply=ask.reply, **ask.fields)

    def _seeing_enabled(self, job: Job) -> Steps:
        assert self.shape.status is not None
        off: list[str] = []
        for _ in range(10):
            yield 2 * PAUSE_NS
            yield self.ask("SendStatus", reply=self.shape.status.reply)
            off = [axis.name for axis in self.axes if axis.signals and not axis.shown("enabled")]
            if not off:
                return
        why = [f"{a.name} {', '.join(a.shown('errors'))}" for a in self.axes if a.shown("errors")]
        self.quiet()
        raise self.fail(f"{', '.join(off)} cannot be enabled" + (f" ({'; '.join(why)})" if why else ""))

    def initial_steps(self) -> Steps:
        """Yield the first steps of D08: NameInfo, where the robot's file knows its numbers, and position gains."""
        fields = self._name_info()
        if fields is not None:
            yield self.ask(self.shape.name_info or "", reply="NameInfoReply", **fields)
        for axis in self.axes:
            if axis.joint is not None and axis.joint.gains is not None:
                yield from self._gain_tickets(axis, None, None, None, False)

    def _name_info(self) -> dict[str, Any] | None:
        return name_info(self.kind, self.settings.period_ms, self.axes)

    def board_info(self) -> Ticket:
        """Ask the board what it is; the answer (period, and what else it says) is the ticket's result.

        The question also sets the board's period, from `period_ms` or the host's rate; in D08 also search limits and
        index counts, which the robot's file must know. Raises `CallerError` where it does not.
        """
        if self.shape.name_info is None:
            rate = self.host.rate_hz
            usual = 5 if rate is None else max(1, min(255, round(1000 / rate)))
            period = int(self.settings.period_ms or usual)
            return self.ask("GetBoardInfo", reply="BoardInfo", period=period)
        fields = self._name_info()
        if fields is None:
            raise CallerError(
                f"{self.name}: NameInfo needs period_ms, and search_turns and z_phase of its joints"
            )
        return self.ask(self.shape.name_info, reply="NameInfoReply", **fields)

    def knows_name(self) -> bool:
        """Return whether `board_info` can be asked."""
        return self._name_info() is not None if self.shape.name_info is not None else self.kind != "neck"

    def disable(self) -> Job:
        """Switch control off, then drivers; forget set-points."""

        def steps(job: Job) -> Steps:
            stopped = self.stop_motion()
            if stopped is not None:
                yield stopped
            yield PAUSE_NS
            if self.shape.has_driver_switch:
                yield self.send("DriverSwitch", state="off")

        return self.job("disable", steps)

    def stop_motion(self) -> Ticket | None:
        """Send no set-points any more, and control off (duty off for boards without that), at once."""
        self.end_led()
        self.homing = set()
        was_compliant = self.comply is not None
        self.quiet()
        shape = self.shape
        ticket: Ticket | None = None
        if was_compliant or self.set_message == shape.pwm:
            ticket = self._pwm_off()
        if shape.has_switches:
            ticket = self.send_now("ControlOff")
        return ticket

    def confirm_stopped(self) -> Job | None:
        """Ask the board's status, where it has that of its drives."""
        status = self.shape.status
        if status is None or not self.shape.reports_drive or not self.shape.has_switches:
            return None
        return self.confirm_off(
            lambda: self.ask("SendStatus", reply=status.reply),
            lambda: [axis.name for axis in self.axes if axis.is_on is not False],
        )

    def _pwm_off(self) -> Ticket | None:
        shape = self.shape
        if shape.pwm_off is None:
            return None
        zeros = [0] * (2 if shape.channels == 1 else shape.channels)
        fields: dict[str, Any] = {"mode": "off", "duty": zeros}
        if not shape.pwm_signed or shape.pwm_off == "Pwm":
            fields.update(unsigned(zeros, shape.directions))
        return self.send_now(shape.pwm_off, **fields)

    # ------------------------------------------------------------------ gains and modes

    def set_gains(
        self,
        joint: str | None = None,
        *,
        kp: int | None = None,
        ki: int | None = None,
        kd: int | None = None,
        torque: bool = False,
    ) -> Job:
        """Set position gains (or those of the torque loop) in the board's numbers; None takes the robot
        file's, else 0.

        The job's result is how many commands were sent. Raises `UnknownNameError` for a joint that is not here.
        """
        axes = self.axes_of(joint)

        def steps(job: Job) -> Steps:
            sent: list[Ticket] = []
            for axis in axes:
                sent += self._gain_tickets(axis, kp, ki, kd, torque)
                yield PAUSE_NS
            return len(sent)

        return self.job("set gains", steps)

    def _gain_tickets(
        self, axis: MotorAxis, kp: int | None, ki: int | None, kd: int | None, torque: bool
    ) -> list[Ticket]:
        messages = self.shape.torque_gains if torque else self.shape.gains
        own = axis.joint.gains if axis.joint is not None and not torque else None
        given = (kp, ki, kd)
        stored = (None, None, None) if own is None else (own.kp, own.ki, own.kd)
        if not messages or all(value is None for value in (*given, *stored)):
            return []
        numbers = [int((b or 0) if a is None else a) for a, b in zip(given, stored, strict=True)]
        return [self.send(messages[axis.channel], kp=numbers[0], ki=numbers[1], kd=numbers[2])]

    def set_control_mode(self, mode: Literal["position", "torque", "current", "hybrid"]) -> Ticket:
        """Set what references mean: position; current (D12) or torque (D08); hybrid: wrist position and finger
        current.
        """
        known = ("position", "torque") if self.dialect != "D12" else ("position", "current", "hybrid")
        if mode not in known:
            raise CallerError(f"{self.name} has the control modes {', '.join(known)}, not {mode!r}")
        if self.kind == "hand":
            self._change_hand(mode)
        self.control_mode = mode
        return self.send("ControlMode" if self.dialect == "D12" else "ControlModeD08", mode=mode)

    def _change_hand(self, mode: str) -> None:
        """Send a hand's set-points as currents or, in mode `position`, as positions: another message."""
        other = "ReferenceHandPosition" if mode == "position" else "ReferenceHand"
        old = self.set_message
        if old == other or old is None:
            return
        given = self._given.get(old, {})
        self._paths.setdefault(other, dict(self._paths[old]))
        self.set_message = other
        self.drop(old)
        for path, value in given.items():
            if self.takes_set_points:
                self.want_raw(other, path, value if path == "position" else 0)

    def override_gains(self, first: int, second: int, seconds: float = 0.0) -> Ticket:
        """Scale the gains of channels 0 and 1, in %, within so much time (D12; hubo-ach never tried it)."""
        self.only_d12("a gain override")
        return self.send("GainOverride", gain=[first, second], time=round(1000 * seconds))

    def switching_mode(self, *, free_wheeling: bool) -> Ticket:
        """Let a motor wheel freely or not, by non-complementary switching (D12)."""
        self.only_d12("the switching mode")
        return self.send("SwitchingMode", mode="non_complementary" if free_wheeling else "complementary")

    def beep(self, seconds: float = 0.3) -> Ticket:
        """Beep, in steps of 0.1 s up to 25.5 s (D12)."""
        self.only_d12("a beeper")
        if not 0 <= seconds <= 25.5:
            raise CallerError(f"{self.name}: a beep takes 0 to 25.5 s, not {seconds}")
        return self.send("Beep", time=round(seconds, 1))

    def alarm(self, sound: int = 0) -> Ticket:
        """Sound alarm 1 to 4; 0 is silence (D12)."""
        self.only_d12("an alarm")
        if sound not in range(5):
            raise CallerError(f"{self.name}: alarm sounds are 0 to 4, not {sound}")
        return self.send("Alarm", sound="off" if sound == 0 else f"sound_{sound}")

    def only_d12(self, what: str) -> None:
        """Raise `CallerError` on a board of the older firmware."""
        if self.dialect != "D12" or self.kind == "neck":
            raise CallerError(
                f"{self.name} speaks {self.dialect} and is of kind {self.kind}: it has not got {what}"
            )

    # ------------------------------------------------------------------ compliance

    def set_compliance(self, on: bool = True) -> Job:
        """Let the joints of this board give way, around the positions they are set to; off: rigid again.

        Each joint needs `compliance` gains in the robot's file; the board must be enabled. Raises `CallerError` otherwise.
        """
        if self.dialect != "D12" or self.kind not in (1, 2) or self.set_message != "Reference":
            raise CallerError(f"{self.name} (kind {self.kind}, {self.dialect}) has no compliant motion")
        without = [a.name for a in self.axes if a.joint is not None and a.joint.compliance is None]
        if on and without:
            raise CallerError(f"{self.name}: {', '.join(without)} needs compliance = {{ kp, kd, max_pwm }}")
        return self.job("compliance", self._softening if on else self._stiffening)

    def _softening(self, job: Job) -> Steps:
        if not self.is_enabled:
            raise self.fail("enable it first")
        yield self.send("SwitchingMode", mode="non_complementary")
        self.comply = self._comply
        self._filtering = False
        for axis in self.axes:
            if axis.goal is not None:  # a filter was on its way there
                axis.reference, axis.goal = round(axis.goal), None
        self.drop("Reference")

    def _stiffening(self, job: Job) -> Steps:
        if self.comply is None:
            return
        self.comply = None
        self.drop("PwmFine")
        goals = {axis.channel: axis.reference for axis in self.axes}
        for axis in self.axes:
            if axis.joint is not None:
                self.give(axis, axis.count or 0)
                if axis.duty is not None:
                    axis.duty.update(0.0, self.clock.now())
        yield self.tick_ns()
        yield self.send("SwitchingMode", mode="complementary")
        yield self.send("ControlOn")
        length, self.filter_length = self.filter_length, RIGID_FILTER
        for axis in self.axes:
            goal = goals[axis.channel]
            if axis.joint is not None and goal is not None:
                axis.goal = float(goal)
                self._filtering = True
        while self._filtering and self.takes_set_points:
            yield self.tick_ns()
            far = [axis for axis in self.axes if axis.goal is not None and not self._is_near(axis)]
            if not far:
                break
        self.filter_length = length
        for axis in self.axes:
            if axis.goal is not None and self.takes_set_points:
                self.give(axis, round(axis.goal))

    @staticmethod
    def _is_near(axis: MotorAxis) -> bool:
        return axis.count is not None and abs((axis.goal or 0) - axis.count) * abs(axis.scale) <= ARRIVED

    def _comply(self, instant: int) -> None:
        """Take one step of compliance: set the duties of all channels from the encoders' answer."""
        paths = self._paths.setdefault("PwmFine", {})
        for axis, duty in zip(self.axes, compliant_duties(self.axes, instant), strict=True):
            path = f"duty.{axis.channel}"
            paths[path] = None
            self.want_raw("PwmFine", path, duty)

    # ------------------------------------------------------------------ homing

    def home(self, joint: str | None = None) -> Job:
        """Search the home of one joint, or of all of this board. It moves, whether enabled or not.

        The job's `progress` says how far it is; it fails with a `DeviceError` that says why. Its result are the names of
        the joints that were homed. Raises `UnknownNameError` for a joint that is not here, `CallerError` for a board that
        cannot home or a robot file without the joint's home (D08).
        """
        message = self.shape.home
        if message is None:
            raise CallerError(f"{self.name} (kind {self.kind}) has no home search")
        if self.homing:
            raise CallerError(f"{self.name}: a home search is under way")
        axes = self.axes_of(joint)
        self.is_driven = True
        if message == "Home":
            return self._start(axes, lambda job: self._home_d12(job, axes, joint is None))
        if message == "Home5D08":
            fields: dict[str, Any] = {"power": [home_power(self.name, axes)] * 5}
            return self._start(axes, lambda job: self._home_blind(job, axes, message, fields))
        if self.shape.channels == 3:
            axes = [self._only_switch(joint)]
        for axis in axes:
            home_of(self.name, axis)
        return self._start(axes, lambda job: self._home_d08(job, axes))

    def _start(self, axes: list[MotorAxis], steps: Any) -> Job:
        self.homing = {axis.channel for axis in axes}
        search = self.lead("home", steps)
        search.then(self._search_is_over)  # also where it was refused, or ended before its first step
        return search

    def _search_is_over(self, search: Awaited) -> None:
        self.homing = set()

    def _announce(self) -> None:
        """Hold off references on this bus while a home command goes out (hubo-ach)."""
        duration = self.settings.hold_home_s
        for device in self.host.devices.values():
            if isinstance(device, HuboMotor):
                device.hold_off(duration)

    def _timeout(self) -> int:
        return round(self.settings.home_timeout_s * 1e9)

    def _arrived(self, axes: list[MotorAxis]) -> None:
        """Make set-points zero."""
        self.epoch += 1
        for axis in axes:
            if self.takes_set_points and axis.joint is not None and self.follows:
                self.give(axis, axis.to_counts(0.0))

    # ------------------------------------------------------------------ D12

    def _home_d12(self, job: Job, axes: list[MotorAxis], whole: bool) -> Steps:
        if self.shape.has_driver_switch and not self.is_enabled:
            yield self.send("DriverSwitch", state="on")
        began = self.clock.now()
        for axis in axes[:1] if whole else axes:
            self._announce()
            yield self.send("Home", motor="all" if whole else f"motor_{axis.channel + 1}")
        if self.kind == "hand":
            for _ in range(2):
                yield self.send("ControlMode", mode=self.hand_mode)
        first = {axis.channel: axis.count for axis in axes}
        moved: set[int] = set()
        waiting, rested = list(axes), dict.fromkeys((axis.channel for axis in axes), began)
        status = self.shape.status
        assert status is not None
        while waiting:
            yield LOOK_NS
            now = self.clock.now()
            yield self.ask("SendStatus", reply=status.reply)
            yield from self.reading_positions()
            for axis in list(waiting):
                if axis.count != first[axis.channel]:
                    moved.add(axis.channel)
                    rested[axis.channel] = now
                    first[axis.channel] = axis.count
                if "limit_switch" in (axis.shown("status") or ()):
                    moved.add(axis.channel)
                near = axis.count is not None and abs(axis.to_rad(axis.count)) <= ARRIVED
                if self.shape.has_home_flag:
                    over = near and bool(axis.shown("homed"))
                else:
                    over = near and axis.channel in moved and now - rested[axis.channel] >= REST_NS
                if over:
                    waiting.remove(axis)
            job.progress = max(1 - len(waiting) / len(axes), min(0.9, (now - began) / self._timeout()))
            job.text = f"searching {', '.join(axis.name for axis in waiting)}" if waiting else "home"
            if waiting and now - began >= self._timeout():
                raise self.fail(f"no home within {self._timeout() / 1e9:g} s: {why_not_home(waiting)}")
            self._keep_off(now)
        self._arrived(axes)
        return [axis.name for axis in axes]

    def _keep_off(self, now: int) -> None:
        """Keep a board's own references away while it searches."""
        if self._held_until < now + 4 * LOOK_NS:
            self.hold_off(4 * LOOK_NS / 1e9)

    # ------------------------------------------------------------------ D08

    def _only_switch(self, joint: str | None) -> MotorAxis:
        """Return the one motor of three that has a limit switch."""
        axis = self.axes[0]
        if joint is not None and self.axes_of(joint) != [axis]:
            raise CallerError(f"{self.name}: only {axis.name} has a limit switch; it homes the board")
        return axis

    def tries(self) -> int:
        """Return how often a joint's search is tried: 3 for arms and wrists, 2 for legs and waist (acesHubo)."""
        arm = self.credentials["board"] in (0x08, 0x09, 0x0A, 0x0B, 0x20, 0x21, 0x22)
        return int(self.settings.home_tries or (3 if arm else 2))

    def _home_d08(self, job: Job, axes: list[MotorAxis]) -> Steps:
        if not self.is_enabled:
            yield self.send("DriverSwitch", state="on")
            yield self.send("ControlOn")
        status = self.shape.status
        assert status is not None
        assert self.shape.home is not None
        for done, axis in enumerate(axes):
            tries = self.tries()
            for attempt in range(1, tries + 1):
                job.text = f"searching {axis.name}, try {attempt} of {tries}"
                self._announce()
                began = self.clock.now()
                yield self.send(self.shape.home, **home_fields(self.name, axis, self.shape.channels))
                state = "searching"
                while state == "searching":
                    yield LOOK_NS
                    record = yield self.ask("SendStatus", reply=status.reply)
                    state = search_state(record.motor[axis.channel])
                    passed = self.clock.now() - began
                    job.progress = (done + min(0.9, passed / self._timeout())) / len(axes)
                    if passed >= self._timeout():
                        state = "failed"
                    self._keep_off(self.clock.now())
                if state == "done":
                    break
            else:
                raise self.fail(f"{axis.name} found no home in {tries} tries")
            self._arrived([axis])
        yield from self.reading_positions()
        return [axis.name for axis in axes]

    def _home_blind(self, job: Job, axes: list[MotorAxis], message: str, fields: dict[str, Any]) -> Steps:
        """Drive fingers of D08 against their stop; no status says when they are there."""
        self._announce()
        yield self.send(message, **fields)
        yield round(self.settings.hold_home_s * 1e9)
        return [axis.name for axis in axes]

    # ------------------------------------------------------------------ zeros and errors

    def zero_encoder(self, joint: str | None = None) -> Job:
        """Make the present position of a joint, or of all, the encoder's zero. Errors are cleared too (D12)."""
        axes = self.axes_of(joint)
        if self.kind == "neck" or not self.shape.encoders:
            raise CallerError(f"{self.name} (kind {self.kind}) has no encoder to set to zero")

        def steps(job: Job) -> Steps:
            self.homing = {axis.channel for axis in axes}
            try:
                number = axes[0].channel
                if self.dialect == "D12":
                    yield self.send("EncoderZero", channel="all" if joint is None else f"channel_{number}")
                else:
                    yield self.send("EncoderZeroD08", motor="all" if joint is None else f"motor_{number + 1}")
                # The old set-points mean other places now.
                self.epoch += 1
                for axis in axes:
                    if (
                        self.takes_set_points
                        and axis.joint is not None
                        and self.set_message == self.shape.reference
                    ):
                        self.give(axis, 0)
                yield 2 * PAUSE_NS
                yield from self.reading_positions()
            finally:
                self.homing = set()

        return self.job("zero encoder", steps)

    def clear_errors(self, joint: str | None = None, *, zero: bool = False) -> Job:
        """Clear error bits (D12). The command sets the encoder to zero too, so a joint that is not at zero needs `zero`.

        The job fails with a `DeviceError` when the joint is farther than 0.0075 rad from zero and `zero` is False.
        """
        self.only_d12_errors()
        axes = self.axes_of(joint)

        def steps(job: Job) -> Steps:
            yield from self.reading_positions()
            away = [
                a
                for a in axes
                if a.joint is not None and a.count is not None and abs(a.to_rad(a.count)) > ARRIVED
            ]
            if away and not zero:
                names = ", ".join(f"{a.name} at {a.to_rad(a.count or 0):.4f} rad" for a in away)
                raise self.fail(
                    f"clearing errors sets encoders to zero, and {names}; home it, or say zero=True"
                )
            yield self.zero_encoder(joint)

        return self.job("clear errors", steps)

    def only_d12_errors(self) -> None:
        """Raise `CallerError` on a board whose errors cannot be cleared."""
        if self.dialect != "D12" or self.shape.status is None:
            raise CallerError(
                f"{self.name} speaks {self.dialect} and is of kind {self.kind}: it reports no errors"
            )

    # ------------------------------------------------------------------ what is stored in the board

    def parameters(self) -> Job:
        """Read all that the board has stored; the job's result is a `BoardParameters` (D12)."""
        self.only_d12("parameters that can be read")
        axes = self.axes_of(None)

        def steps(job: Job) -> Steps:
            whole = len(CHANNEL_BLOCKS) * len(axes) + len(BOARD_BLOCKS)
            channels: dict[str, ChannelParameters] = {}
            for number, axis in enumerate(axes):
                blocks: dict[int, Any] = {}
                for block in CHANNEL_BLOCKS:
                    asked = selector(axis.channel, block)
                    blocks[block] = yield from self._block(asked, f"Parameters{block}")
                    job.progress = (number * len(CHANNEL_BLOCKS) + block) / whole
                channels[axis.name] = channel_parameters(blocks)
            found: dict[str, Any] = {}
            for block, names in BOARD_BLOCKS.items():
                record = yield from self._block(block, f"Parameters{block}")
                found |= {name: getattr(record, name) for name in names}
            return BoardParameters(channels=channels, **found)

        return self.job("parameters", steps)

    def _block(self, number: int, name: str) -> Steps:
        """Read one block, with no request for currents open beside it."""
        for attempt in range(3):
            self.host.postpone(self, "SendCurrent", 2 * READ_TIMEOUT_S)
            while any(ticket.message == "SendCurrent" for ticket in self.awaiting):
                yield PAUSE_NS
            try:
                # Once a try: a repeated request could meet the late answer to the first.
                record = yield self.ask(
                    "GetParameters", reply=name, selector=number, timeout_s=READ_TIMEOUT_S, retries=0
                )
            except NoReplyError:
                if attempt == 2:
                    raise
            else:
                return record

    # ------------------------------------------------------------------ writing

    def set_parameters(self, joint: str | None = None, **values: Any) -> Job:
        """Write parameters of a joint or of the board, by the names of `ChannelParameters` and `BoardParameters`.

        Also `homing_duty` (%) and `temperature_warning` (°C), which cannot be read back. A command writes several
        parameters at once: those that were not given are read first and written as they are. Gains: `set_gains`; limits:
        `set_limits`. Raises `CallerError` for a name that cannot be written, or a channel's without `joint`.
        """
        self.only_d12("parameters that can be written")
        axis = None if joint is None else self.axes_of(joint)[0]
        commands: dict[str, dict[str, Any]] = {}
        for name, value in values.items():
            if name not in _COMMAND_OF:
                raise CallerError(f"{self.name}: cannot write {name!r}; there are {', '.join(_COMMAND_OF)}")
            if axis is None and _COMMAND_OF[name] not in OF_BOARD:
                raise CallerError(f"{self.name}: {name} is a joint's; say which")
            commands.setdefault(_COMMAND_OF[name], {})[name] = value

        def steps(job: Job) -> Steps:
            for message, given in commands.items():
                known = dict(_USUAL)
                if WRITES[message].keys() - given.keys() - known.keys():
                    known |= yield from self._known(axis)
                fields = {field: given.get(name, known.get(name)) for name, field in WRITES[message].items()}
                if axis is not None and message not in OF_BOARD:
                    fields["channel"] = axis.channel
                yield self.send(message, **fields)
                yield PAUSE_NS

        return self.job("set parameters", steps)

    def _known(self, axis: MotorAxis | None) -> Steps:
        """Return what is stored now, by our names."""
        stored: BoardParameters = yield self.parameters()
        known = msgspec.structs.asdict(stored)
        return known if axis is None else known | msgspec.structs.asdict(stored.channels[axis.name])

    def set_limits(
        self,
        joint: str | None = None,
        *,
        lower: float | None = None,
        upper: float | None = None,
        enabled: bool = True,
    ) -> Job:
        """Set position limits (rad) that the board itself keeps; None takes the robot file's, and leaves an
        unknown limit as it is.

        The stored word's bit 0 is the enable flag, so limits are even counts (RoboWorld2018).
        """
        self.only_d12("limits of its own")
        axes = self.axes_of(joint)

        def steps(job: Job) -> Steps:
            for axis in axes:
                own = axis.joint
                ends = [
                    lower if lower is not None or own is None else own.lower,
                    upper if upper is not None or own is None else own.upper,
                ]
                if axis.direction < 0:
                    ends.reverse()
                for message, end in zip(("LowerLimit", "UpperLimit"), ends, strict=True):
                    if end is not None:
                        options = ["enable", "update"] if enabled else ["update"]
                        count = int(axis.to_counts(end) / 2) * 2
                        yield self.send(message, channel=axis.channel, options=options, limit=count)
                        yield PAUSE_NS

        return self.job("set limits", steps)

    # ------------------------------------------------------------------ dangerous

    def initialise(self, confirm: bool) -> Ticket:
        """Load the board's default parameters (0xFA): gains, offsets and limits of this robot are lost (D12)."""
        self.only_d12("defaults")
        self._confirmed(confirm, "its gains, home offsets and limits will be lost")
        self.quiet()
        return self.send("InitBoard")

    def set_board_number(self, number: int, confirm: bool, period_ms: int = 5) -> Ticket:
        """Give the board another number (0xF0); this device talks to that one from then on (D12)."""
        self.only_d12("a number that can be changed")
        if number not in range(0x30):
            raise CallerError(f"{self.name}: motor boards have the numbers 0x00 to 0x2f, not {number:#04x}")
        table = self.variant.tables.get("channels", {})
        if table.get(number) != self.kind:
            raise CallerError(
                f"{self.name}: the robot's file must list board {number:#04x} (inactive) with kind {self.kind}, or its"
                " answers will not be understood"
            )
        self._confirmed(confirm, "two boards with one number cannot be distinguished again")
        self.quiet()
        ticket = self.send("SetBoardNumber", number=number, period=period_ms)
        self.host.renumber(self, board=number)
        return ticket

    def _confirmed(self, confirm: bool, why: str) -> None:
        if confirm is not True:
            raise CallerError(f"{self.name}: say confirm=True; {why}")
