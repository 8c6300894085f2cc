"""Dynamixel X series: position, extended position, velocity, current and PWM modes.

1. What a joint is commanded by decides the mode that its servo must be in. The mode survives power-off, so the driver does
   not change it by itself: `enable` fails and says how to (`set_mode`).
2. Torque is switched on with the servo's own watchdog: without an instruction for `watchdog_s` it stops by itself.
3. Currents are in A where the robot's file names the model; without it they are not known.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any, ClassVar, Literal

from msgspec import Meta

from aces_bus.device import HostLoss, Job, Steps
from aces_bus.device.config import Joint
from aces_bus.device.signals import Signal
from aces_bus.errors import CallerError, DeviceError, NoReplyError
from aces_bus.protocol import Record
from aces_protocols.dynamixel.control_table import ACCELERATION, ANGLE, HARDWARE_ERRORS, SPEED, WATCHDOG_ERROR
from aces_protocols.dynamixel.models import MODEL_NAMES
from aces_protocols.dynamixel.spec import control_table

from ..servos.driver import ACTIONS, ServoDevice, ServoSettings
from ..servos.registers import RegisterSpan

TURN = 4096
#: Counts that a goal in extended position mode may have either way: 256 turns (ROBOTIS e-manual).
FAR = 1_048_575
#: PWM of the greatest duty.
PWM = 885
#: rad/s² a count of acceleration: 214.577 rpm/min.
ACCELERATION_STEP = ACCELERATION * math.tau / 3600
#: A count of the watchdog (s).
WATCHDOG_S = 0.02
#: The speed limit (counts) of a model that is not known.
SPEED_LIMIT = 1023
#: The parameters of a Ping's status: model (2 bytes), firmware.
PINGED = 3
#: The mode that a joint's command needs; positions have several.
MODE_OF = {"speed": "velocity", "current": "current", "duty": "pwm"}


class DynamixelSettings(ServoSettings, frozen=True, kw_only=True):
    """The driver's own keys in a robot file."""

    mode: Annotated[
        Literal["position", "extended_position", "current_based_position"] | None,
        Meta(
            description='how positions are followed: "position" (default), "extended_position" (several turns; default of'
            ' a joint that turns without end) or "current_based_position"'
        ),
    ] = None
    watchdog_s: Annotated[
        float,
        Meta(
            ge=0,
            le=127 * WATCHDOG_S,
            description="without an instruction for this time the servo stops by itself (default 0.5, in steps of 0.02;"
            " 0: never)",
        ),
    ] = 0.5


def mode_of(joint: Joint | None, settings: DynamixelSettings) -> str:
    """Return the operating mode that a joint needs its servo in."""
    if joint is None or joint.command == "position":
        turns = joint is not None and joint.type == "continuous"
        return settings.mode or ("extended_position" if turns else "position")
    return MODE_OF[joint.command]


class Dynamixel(ServoDevice):
    """One X-series servo."""

    protocol = "dynamixel"
    settings_type = DynamixelSettings
    settings: DynamixelSettings
    registers = control_table
    eeprom = range(64)
    together_bytes = 1024
    together_overhead = 14
    together_read = "SyncRead"
    streamed = frozenset(("goal_position", "goal_velocity", "goal_current", "goal_pwm"))
    remembers = frozenset(
        ("torque_enable", "led", "bus_watchdog", "profile_velocity", "profile_acceleration")
    )
    motion_span = ("present_pwm", "present_position")
    health_span = ("torque_enable", "present_temperature")
    start_span = ("model_number", "status_return_level")
    goals_by_command: Mapping[str, str] = {
        "position": "goal_position",
        "speed": "goal_velocity",
        "current": "goal_current",
        "duty": "goal_pwm",
    }
    speed_register = "present_velocity"
    mode_register = "operating_mode"
    shutdown_register = "shutdown"
    error_bits = HARDWARE_ERRORS
    of_request = frozenset(("crc",))
    reset = ("FactoryReset", {"keep": "nothing"})
    when_host_is_lost = HostLoss(
        "holds", "ROBOTIS e-manual, X series: Bus Watchdog (98)", 0.5,
        "with torque on; by current or duty it goes limp. `enable` sets its bus watchdog (`watchdog_s`)",
    )  # fmt: skip
    count_rad = math.radians(ANGLE)
    speed_count_rad_s = SPEED * math.tau / 60
    actions: ClassVar[Mapping[str, str]] = {
        **ACTIONS,
        "set_mode": "have it in the mode that its joint is commanded by; with confirm=true",
        "reboot": "restart it: torque off, errors cleared",
    }

    # ------------------------------------------------------------------ declaration

    def setup(self) -> None:
        """Set up what every servo has, and the model."""
        self.model = MODEL_NAMES.get(self.config.model or "")
        self._asks_why = False
        #: Whether a goal would switch its torque on (`drive_mode`).
        self.is_woken_by_goals = False
        #: Whether its watchdog has stopped it: it takes no goals until it is enabled anew.
        self.is_cut_off = False
        super().setup()
        if self.command == "current" and (self.model is None or self.model.current_step_a is None):
            why = "the robot's file does not say its model" if self.model is None else "its model has none"
            raise CallerError(f"{self.name}: a joint cannot be commanded by current: {why}")
        self._span_ping()

    def _span_ping(self) -> None:
        """Declare the values in the answer to a Ping: model and firmware."""
        span = RegisterSpan(0, PINGED, ())
        span.codecs = (0, self.codec("model_number")), (2, self.codec("firmware_version"))
        self._spans[self.host.packet(self, "Ping", {})] = span

    def renumbered(self) -> None:
        """Forget its Ping, too, which is another now."""
        super().renumbered()
        self._span_ping()

    def wanted_mode(self) -> str:
        """Return the mode that the joint's command needs."""
        return mode_of(self.joints[0] if self.joints else None, self.settings)

    def range_counts(self) -> tuple[int, int]:
        """Return one turn, or 256 turns either way."""
        return (0, TURN - 1) if self.mode == "position" else (-FAR, FAR)

    def speed_limit_counts(self) -> int:
        """Return the model's; the servo's own, once that is read, may be less."""
        return SPEED_LIMIT if self.model is None else self.model.velocity_limit

    def declare_more(self, owner: str, motion: Mapping[str, Any], health: Mapping[str, Any]) -> None:
        """Declare duty, current or load, limits of speed and acceleration."""
        direction, speed_step = self.direction, self.speed_step
        sets = self.command == "duty"
        self.duty = self.register_signal(
            "duty",
            "present_pwm",
            to_si=lambda raw: raw / PWM * direction + 0.0,
            set="goal_pwm" if sets else None,
            to_raw=lambda value: round(value * PWM * direction),
            lower=-1.0 if sets else None,
            upper=1.0 if sets else None,
            doc="The share of the supply that drives the motor, -1 to 1.",
            **motion,
        )
        if self.model is not None and self.model.current_step_a is not None:
            self._declare_current(self.model.current_step_a, self.model.current_limit, motion)
        elif self.model is not None:
            self.register_signal(
                "load",
                "present_current",
                to_si=lambda raw: raw / 1000 * direction + 0.0,
                doc="The load as a share of the greatest torque, -1 to 1.",
                **motion,
            )
        if self.command == "position":
            self.register_signal(
                "speed_limit",
                "profile_velocity",
                to_si=lambda raw: raw * speed_step,
                set="profile_velocity",
                to_raw=lambda value: max(1, round(value / speed_step)) if value else 0,
                unit="rad/s",
                lower=0.0,
                upper=self.speed_limit_counts() * speed_step,
                doc="Speed on the way to a goal; 0: as fast as it can.",
                **health,
            )
        if self.command in ("position", "speed"):
            step = ACCELERATION_STEP * self.step / self.count_rad
            self.register_signal(
                "acceleration_limit",
                "profile_acceleration",
                to_si=lambda raw: raw * step,
                set="profile_acceleration",
                to_raw=lambda value: max(1, round(value / step)) if value else 0,
                unit="rad/s²",
                lower=0.0,
                upper=0x7FFF * step,
                doc="Acceleration on the way; 0: as much as it can.",
                **health,
            )

    def _declare_current(self, step: float, limit: int, motion: Mapping[str, Any]) -> None:
        direction, joint = self.direction, self.joints[0] if self.joints else None
        sets = self.command == "current"
        most = limit * step
        if joint is not None and joint.max_current is not None:
            most = min(most, joint.max_current)
        self.current = self.register_signal(
            "current",
            "present_current",
            to_si=lambda raw: raw * step * direction + 0.0,
            set="goal_current" if sets else None,
            to_raw=lambda value: round(value * direction / step),
            unit="A",
            lower=-most if sets else None,
            upper=most if sets else None,
            doc="The motor's current.",
            **motion,
        )

    # ------------------------------------------------------------------ up

    def learned(self, table: Mapping[str, int]) -> None:
        """Limit the joint to the servo's own limits."""
        drive_mode = self.codec("drive_mode").value(table["drive_mode"])
        self.is_woken_by_goals = bool(drive_mode.torque_on_by_goal)
        if self.is_woken_by_goals:
            self.emit_event(
                "alarm", "a goal would switch its torque on (drive_mode): none is taken before it is enabled"
            )
        if drive_mode.time_based_profile:
            self.emit_event(
                "alarm", "its profiles are times (drive_mode): speed and acceleration limits mean nothing"
            )
        if self.mode == "position":
            self.limit_to(table["min_position_limit"], table["max_position_limit"])
        for signal, most in (
            (self["velocity"], table["velocity_limit"] * self.speed_step),
            (self.duty, table["pwm_limit"] / PWM),
        ):
            _narrow(signal, most)
        if self.command == "current" and self.model is not None and self.model.current_step_a is not None:
            _narrow(self.current, table["current_limit"] * self.model.current_step_a)

    def errors_of(self, record: Record) -> frozenset[str] | None:
        """Return the servo's errors; a status only says that there are some, the register `hardware_error`
        says which.
        """
        known = self.known.get("hardware_error")
        if not record.error.alert:
            self._asks_why = False
            if known is not None and known[0]:
                del self.known["hardware_error"]  # that was before
            return frozenset()
        if known is not None and known[0]:
            return frozenset(self.codec("hardware_error").value(known[0]))
        if not self._asks_why and self.answers:
            self._asks_why = True
            self.read("hardware_error")
        return None

    def refusal(self, record: Record) -> str:
        """Return what is wrong with the request, by name."""
        code = record.error.code
        return "" if code == "none" else str(code)

    def changed(self, which: Mapping[str, tuple[int, int]]) -> None:
        """Look whether its watchdog has stopped it."""
        if which.get("bus_watchdog", (0, 0))[1] == WATCHDOG_ERROR:
            self.is_cut_off = True
            self.drop(self.goal)
            text = "bus watchdog: it had no instruction for too long, and has stopped; enable it anew"
            self.emit_event("alarm", text)
        else:
            super().changed(which)

    def takes(self, signal: Signal) -> bool | None:
        """Return False for what `want` drops."""
        return False if self._takes_no_goals else super().takes(signal)

    @property
    def _takes_no_goals(self) -> bool:
        """After its watchdog has stopped it, and where a goal would switch the torque on."""
        is_off = self.cached("torque_enable", raw=True) != 1
        return self.is_cut_off or (self.is_woken_by_goals and is_off)

    def want(self, message: str, path: str, value: Any) -> None:
        """Do what `RegisterDevice.want` does; a goal that it does not take now is reported, and not kept for later."""
        if path == self.goal and self._takes_no_goals:
            self.emit_event("not sent", f"{path} = {value}: it is not enabled")
        else:
            super().want(message, path, value)

    @property
    def host_loss(self) -> HostLoss:
        """As declared; without a position or speed to hold its motor has no torque, without a watchdog it goes on."""
        loss, wait_s = self.when_host_is_lost, self.settings.watchdog_s
        if not wait_s:
            return replace(loss, does="goes on", after_s=None, detail="watchdog_s = 0 in the robot's file")
        holds = self.command in ("position", "speed")
        return replace(loss, does="holds" if holds else "limp", after_s=wait_s)

    @property
    def fed_within_s(self) -> float | None:
        """Its bus watchdog, which any instruction feeds."""
        return self.settings.watchdog_s or None

    # ------------------------------------------------------------------ actions

    def before_torque(self) -> Steps:
        """Yield steps that check the mode, clear the watchdog and set it."""
        yield from super().before_torque()
        yield self.write("bus_watchdog", 0, raw=True)
        self.is_cut_off = False
        if self.settings.watchdog_s:
            yield self.write("bus_watchdog", max(1, round(self.settings.watchdog_s / WATCHDOG_S)), raw=True)

    def stop_motion(self) -> Job:
        """Do what `ServoDevice.stop_motion` does; a servo that its watchdog has stopped takes no goal, and has stopped."""
        stopping = super().stop_motion()

        def steps(job: Job) -> Steps:
            try:
                yield stopping
            except NoReplyError:
                raise
            except DeviceError:
                if not self.answers or (yield self.read("bus_watchdog", raw=True)) != WATCHDOG_ERROR:
                    raise

        return self.job("stop", steps)

    def reboot(self) -> Job:
        """Restart it: its torque is off then, its errors are cleared, and it knows no goals."""

        def steps(job: Job) -> Steps:
            yield self.obeyed("Reboot", "restarting")
            self.forget()

        return self.job("reboot", steps)

    def check_write(self, name: str, confirm: bool = False) -> None:
        """Do what `RegisterDevice.check_write` does; what survives power-off is written without torque only."""
        super().check_write(name, confirm)
        if self.codec(name).address in self.eeprom and self.cached("torque_enable", raw=True) == 1:
            raise CallerError(
                f"{self.name}: register {name} can only be written with the torque off: disable it first"
            )


def _narrow(signal: Signal, most: float) -> None:
    """Limit what is set to ±`most`, where it is set at all."""
    if signal.upper is not None and most < signal.upper:
        signal.lower, signal.upper = -most, most
