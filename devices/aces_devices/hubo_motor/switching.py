"""Switching a board: enable, disable, modes, gains, sounds, compliance.

1. Before anything is switched on, the set-points are where the joints are (hubo-ach), and have been sent.
2. Enabling is over when the board's status says so, where it has one.

Enable: D08 NameInfo and gains, then as D12: reference = present position, FET switch 0x0B, control on 0x0E. Disable: 0x0F,
then 0x0B with 0 (facts, 5.6). Hands of five fingers take no control on and off (hubo-ach); theirs is a duty of 0.

Compliance (hubo-ach; D12, one and two channels): the host closes the position loop itself, softly, by duties. Each encoder
reply gives one duty of both channels; no reference is sent meanwhile. Duty (0.1 %) =
−(10 Kp (ref − pos) − 10 Kd vel + 10 pwm), limited to 10 maxPWM: the Kp term, the Kd term and the sum are each truncated
toward zero, as hubo-ach does. Kp is in %/rad. Back to rigid: reference = position, control on, then a filter of length 400
until |error| is at most 0.0075 rad.
"""

from __future__ import annotations

from typing import Any, Literal

from aces_bus.device import Job, Steps, Ticket
from aces_bus.errors import CallerError

from .board import ARRIVED, MotorAxis, MotorBoard, unsigned

#: Between two requests that one board is sent by a job (ns).
PAUSE_NS = 2_000_000


#: The filter's length on the way back to rigid (hubo-ach).
RIGID_FILTER = 400


def compliant_duty(
    error: float, velocity: float, kp: float, kd: float, max_pwm: float, pwm: float = 0.0
) -> int:
    """Return the duty in 0.1 %, as it goes out: `error` = reference − position (rad), `velocity` in rad/s.

    >>> compliant_duty(0.1, 0.0, 80, 0, 8)
    -80
    >>> compliant_duty(0.033, 0.0, 80, 0, 8)
    -26
    """
    effort = int(int(10 * kp * error) - int(10 * kd * velocity) + 10 * pwm)
    most = min(1000, int(10 * max_pwm))
    return -max(-most, min(most, effort))


class Switching(MotorBoard):
    """Enable, disable, gains, modes."""

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
        """D08: NameInfo, where the robot's file knows its numbers, and position gains."""
        fields = self._name_info()
        if fields is not None:
            yield self.ask(self.shape.name_info or "", reply="NameInfoReply", **fields)
        for axis in self.axes:
            if axis.joint is not None and axis.joint.gains is not None:
                yield from self._gain_tickets(axis, None, None, None, False)

    def _name_info(self) -> dict[str, Any] | None:
        period = self.settings.period_ms
        homes = [axis.joint.home if axis.joint is not None else None for axis in self.axes]
        if period is None:
            return None
        if self.kind == 5:
            return {"period": int(period)}
        turns = [0 if home is None or home.search_turns is None else home.search_turns for home in homes]
        if self.kind == 3:
            known = all(home is not None and home.search_turns is not None for home in homes)
            return {"period": int(period), "limit": turns} if known else None
        phases = [0 if home is None or home.z_phase is None else home.z_phase for home in homes]
        if any(
            a.joint is not None and (h is None or h.z_phase is None)
            for a, h in zip(self.axes, homes, strict=True)
        ):
            return None
        # A one-channel board has places for two.
        return {"period": int(period), "limit": [*turns, 0][:2], "z_phase": [*phases, 0][:2]}

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
        """Control off, then drivers off; set-points are forgotten."""

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
        """Position gains (or those of the torque loop) in the board's numbers; what is None is the robot file's, else 0.

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
        """Non-complementary switching lets a motor wheel freely (D12)."""
        self.only_d12("the switching mode")
        return self.send("SwitchingMode", mode="non_complementary" if free_wheeling else "complementary")

    def beep(self, seconds: float = 0.3) -> Ticket:
        """Beep, in steps of 0.1 s up to 25.5 s (D12)."""
        self.only_d12("a beeper")
        if not 0 <= seconds <= 25.5:
            raise CallerError(f"{self.name}: a beep takes 0 to 25.5 s, not {seconds}")
        return self.send("Beep", time=round(seconds, 1))

    def alarm(self, sound: int = 0) -> Ticket:
        """Sound 1 to 4; 0 is silence (D12)."""
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
        """One step: the duties of all channels from what the encoders just said."""
        given: list[tuple[str, Any]] = []
        for axis in self.axes:
            joint = axis.joint
            if joint is None or joint.compliance is None or axis.count is None or axis.reference is None:
                given.append((f"duty.{axis.channel}", 0))
                continue
            gains = joint.compliance
            velocity = axis.velocity.last if axis.velocity is not None else 0.0
            duty = compliant_duty(
                (axis.reference - axis.count) / axis.counts,
                axis.direction * (velocity or 0.0),
                gains.kp or 0.0,
                gains.kd or 0.0,
                gains.max_pwm or 0.0,
            )
            given.append((f"duty.{axis.channel}", duty / 10))
            if axis.duty is not None:
                axis.duty.update(-duty / 10 * axis.direction, instant)
        for path, value in given:
            self._paths.setdefault("PwmFine", {})[path] = None
            self.want_raw("PwmFine", path, value)
