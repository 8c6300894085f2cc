"""ODrive on CAN: an axis that is set by position, velocity or torque.

1. Heartbeat and encoder estimates come by themselves; current, voltage, temperature and torque are asked for by
   remote frames.
2. It is on while its heartbeat says closed loop. A heartbeat comes every 100 ms: so late it is known what an axis has done.
3. Set-points are repeated in each tick: each feeds the axis' own watchdog, which `enable` sets where the robot's file says
   under which numbers this firmware has it, and which is off otherwise.

Units: revolutions of the motor in the drive, rad of the joint here (`JointScale`). Sources: see the spec.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import tau
from typing import Annotated, ClassVar, Literal

import msgspec
from msgspec import Meta

from aces_bus.device import Driver, HostLoss, Job, Poll, SingleMotor, Steps, Ticket
from aces_bus.device.settings import described, settings_of
from aces_bus.device.ticket import Awaited
from aces_bus.errors import CallerError, DeviceError, UnknownNameError
from aces_bus.protocol import Record
from aces_bus.protocol.record import FieldValue

from ..scanning import scan_numbers
from .endpoints import TYPES, WATCHDOG, Endpoint, endpoint_bytes, endpoint_value, read_endpoints
from .twin import OdriveTwin

#: A heartbeat comes every 100 ms; so long it is waited for (s).
HEARTBEAT_S = 0.35
#: How long a write may take to be confirmed (firmware 0.6.11; ODriveResources can_restore_config.py), ns.
CONFIRMATION_NS = 10_000_000
#: An answer to another question than the last is asked for again, so often.
ANOTHERS = 3
#: The longest calibration of a drive: a choice (s).
CALIBRATION_S = 60.0
#: Mode → the message of its set-points, and its input mode when it is ramped.
TARGETS: Mapping[str, tuple[str, str]] = {
    "position": ("SetInputPosition", "trapezoid"),
    "velocity": ("SetInputVelocity", "velocity_ramp"),
    "torque": ("SetInputTorque", "torque_ramp"),
}
#: What is not fed forward.
_FORWARD: Mapping[str, dict[str, float]] = {
    "SetInputPosition": {"velocity": 0.0, "torque": 0.0},
    "SetInputVelocity": {"torque": 0.0},
}
#: What `read_errors` asks for, by dialect.
_ERRORS: Mapping[str, tuple[str, ...]] = {
    "0.5": ("MotorError", "EncoderError", "ControllerError"),
    "0.6": ("Errors",),
}
#: Actions that came with firmware 0.6.
NEW = frozenset(("version", "read", "write", "save"))
#: What `calibrate` can do: the procedures of an axis, of which most turn the motor.
PROCEDURES = (
    *(
        "full_calibration",
        "motor_calibration",
        "index_search",
        "offset_calibration",
        "hall_polarity_calibration",
    ),
    *(
        "hall_phase_calibration",
        "anticogging_calibration",
        "harmonic_calibration",
        "harmonic_commutation_calibration",
    ),
)


class OdriveSettings(msgspec.Struct, frozen=True, kw_only=True):
    """The driver's own keys in a robot file."""

    mode: Annotated[
        Literal["position", "velocity", "torque"] | None,
        Meta(description="what is set; when absent what the joint's command says (current: torque)"),
    ] = None
    ramped: Annotated[
        bool,
        Meta(
            description="true: the drive ramps set-points (trapezoid, velocity ramp, torque ramp), not so when absent"
        ),
    ] = False
    estimates: Annotated[
        Literal["cyclic", "asked"],
        Meta(
            description='"asked": position is asked for in each tick, where the drive does not send it by itself'
        ),
    ] = "cyclic"
    health_s: Annotated[
        float,
        Meta(gt=0, description="how often current, voltage and the like are asked for (s), 0.2 when absent"),
    ] = 0.2
    watchdog_s: (
        Annotated[
            float,
            Meta(
                gt=0,
                description="the axis' own watchdog (s): with watchdog_endpoints `enable` sets it, without them it is set in"
                " the drive already (config.watchdog_timeout, config.enable_watchdog); none when absent",
            ),
        ]
        | None
    ) = None
    watchdog_endpoints: (
        Annotated[
            tuple[int, int],
            Meta(
                description="numbers of config.watchdog_timeout and config.enable_watchdog in the endpoint file of firmware"
                " 0.6, which the key firmware names"
            ),
        ]
        | None
    ) = None
    endpoints: (
        Annotated[
            str,
            Meta(
                description="flat_endpoints.json of the drive's firmware 0.6: parameters are read and written by name, and"
                " `enable` sets the watchdog"
            ),
        ]
        | None
    ) = None
    firmware: (
        Annotated[
            str,
            Meta(
                pattern=r"^\d+\.\d+\.\d+$", description='the firmware of watchdog_endpoints, such as "0.6.10"'
            ),
        ]
        | None
    ) = None


class Odrive(SingleMotor):
    """One axis. Signals: position, velocity, torque, current; of the axis: state, errors, voltage, temperatures."""

    protocol = "odrive"
    when_host_is_lost = HostLoss(
        "goes on", "ODrive documentation, axis.config.enable_watchdog; can-protocol.rst",
        detail="its watchdog is off from the factory; with `watchdog_s` it disarms, and is limp",
    )  # fmt: skip
    streams = tuple(message for message, _ in TARGETS.values())
    modes: ClassVar = {mode: {mode: f"{message}.{mode}"} for mode, (message, _) in TARGETS.items()}
    usual_modes: ClassVar = {"position": "position", "speed": "velocity", "current": "torque"}
    actions: ClassVar = {
        **SingleMotor.motor_actions,
        "clear_errors": "clear all errors; the axis stays off",
        "read_errors": "ask for the error registers",
        "estop": "disarm, with an error that has to be cleared",
        "calibrate": "full calibration, or another procedure=: the motor beeps and turns, both ways",
        "set_zero": "the present position is 0 of the joint, until it is switched off",
        "set_gains": "gains, in the drive's units: position= velocity= integrator=",
        "reboot": "boot anew",
        "version": "ask for the versions",
        "read": "read a parameter: endpoint= its name (setting endpoints), or its number with type=",
        "write": "write a parameter: endpoint= value= confirm=true, and type= with a number",
        "save": "store the configuration and boot anew; confirm=true",
    }
    asking: ClassVar = ("read_errors", "version", "read")

    def setup(self) -> None:
        """Add the signals of the axis, and its polls."""
        settings = self.settings = settings_of(self.name, OdriveSettings, self.config.settings)
        self.declare(1 / tau, settings.mode)
        self.is_new = self.variant.dialect == "0.6"
        if settings.watchdog_endpoints is not None and not (
            settings.watchdog_s and settings.firmware and self.is_new
        ):
            raise CallerError(
                f"{self.name}: watchdog_endpoints go with watchdog_s and firmware, on firmware 0.6: another firmware has"
                " another parameter at these numbers"
            )
        if settings.endpoints is not None and not self.is_new:
            raise CallerError(f"{self.name}: endpoints are of firmware 0.6; this is {self.variant.dialect}")
        self._endpoints = (
            None if settings.endpoints is None else read_endpoints(self.name, settings.endpoints)
        )
        self._firmware = self._endpoints.fw_version if self._endpoints is not None else settings.firmware
        #: Whether the drive has the firmware of the endpoint file; asked once, and again after it was silent.
        self._is_known = False
        #: Numbers of the watchdog's time and switch, where they are known.
        self._watchdog = settings.watchdog_endpoints
        if self._watchdog is None and self._endpoints is not None and settings.watchdog_s:
            timeout, is_on = (self._endpoints.named(self.name, name).id for name in WATCHDOG)
            self._watchdog = (timeout, is_on)
        #: The result of the last procedure (firmware 0.6).
        self.result = "success"
        #: Whether it was told to watch over its host, and has not been stopped since.
        self._watches = False
        if not self.is_new:
            actions: Mapping[str, str] = type(self).actions
            self.actions = {name: text for name, text in actions.items() if name not in NEW}  # type: ignore[misc]
        #: How many heartbeats were received.
        self.beats = 0
        joint, scale, slow = self.joint, self.scale, max(0.5, 5 * settings.health_s)
        speed = joint.max_speed if joint is not None else None
        self.add_motor_signal(
            "position", unit="rad", of="EncoderEstimates.position", to_si=scale.angle, from_si=scale.raw_angle,
            lower=joint.lower if joint is not None else None, upper=joint.upper if joint is not None else None,
            doc="where the joint is", source="CAN Simple 0x09, 0x0C",
        )  # fmt: skip
        self.add_motor_signal(
            "velocity", unit="rad/s", of="EncoderEstimates.velocity", to_si=scale.speed, from_si=scale.raw_speed,
            lower=None if speed is None else -speed, upper=speed, doc="how fast it turns", source="CAN Simple 0x09, 0x0D",
        )  # fmt: skip
        self.add_motor_signal(
            "torque", unit="N·m", of="Torques.estimate" if self.is_new else None, to_si=scale.torque,
            from_si=scale.raw_torque, stale_s=slow, doc="torque; firmware 0.5 does not report it",
            source="CAN Simple 0x1C, 0x0E",
        )  # fmt: skip
        asked = ["Iq", "BusVoltageCurrent"]
        self.add_signal(
            "current",
            owner=self.owner,
            unit="A",
            of="Iq.measured",
            stale_s=slow,
            doc="the motor's",
            source="CAN Simple 0x14",
        )
        self.add_signal(
            "voltage",
            unit="V",
            of="BusVoltageCurrent.voltage",
            stale_s=slow,
            doc="supply",
            source="CAN Simple 0x17",
        )
        if self.is_new:
            asked += ["Temperature", "Torques"]
            for name, field in (("temperature", "inverter"), ("motor_temperature", "motor")):
                self.add_signal(
                    name,
                    unit="°C",
                    of=f"Temperature.{field}",
                    stale_s=slow,
                    doc=f"of the {field}",
                    source="CAN Simple 0x15",
                )
        self.add_signal(
            "state", of="Heartbeat.state", to_si=str, stale_s=0.5, doc="of the axis", source="CAN Simple 0x01"
        )
        self.add_signal(
            "errors", of="Heartbeat.error", to_si=lambda error: tuple(sorted(error)), stale_s=0.5,
            doc="names of the error bits", source="CAN Simple 0x01",
        )  # fmt: skip
        self.polls = [Poll(f"Get{name}", name, every_s=settings.health_s) for name in asked]
        if settings.estimates == "asked":
            self.polls = [Poll("GetEncoderEstimates", "EncoderEstimates"), *self.polls]

    def received(self, record: Record, instant: int) -> None:
        """Take from a heartbeat whether the axis is on, and its errors."""
        if type(record).__name__ == "Heartbeat":
            self.beats += 1
            self.result = str(record.result) if self.is_new else self.result
            faults = set(record.error)
            if not self.is_new:
                parts = {"motor": record.motor, "encoder": record.encoder, "controller": record.controller}
                faults |= {f"{part}_failed" for part, flags in parts.items() if flags.error}
            self.shows(record.state == "closed_loop", faults)

    # ------------------------------------------------------------------ switching

    def bring_up(self, job: Job) -> Steps:
        """Yield steps that set limits and mode, and a set-point at the present place, before the loop is closed."""
        job.text = "heartbeat"
        yield self.ask_state()
        joint, (message, ramp) = self.joint, TARGETS[self.mode]
        if joint is not None and joint.max_speed is not None and joint.max_current is not None:
            velocity = abs(self.scale.raw_speed(joint.max_speed))
            yield self.send("SetLimits", velocity=velocity, current=joint.max_current)
        yield self.send(
            "SetControllerModes", control=self.mode, input=ramp if self.settings.ramped else "passthrough"
        )
        yield self.send(message, **_FORWARD.get(message, {}), **{self.mode: self._present()})
        yield from self._watch_over_host()
        job.progress, job.text = 0.5, "closed loop"
        yield self.send("SetAxisState", state="closed_loop")

    @property
    def host_loss(self) -> HostLoss:
        """As declared; with a watchdog it disarms."""
        loss, wait_s = self.when_host_is_lost, self.settings.watchdog_s
        if wait_s is None:
            return loss
        how = "`enable` sets it" if self._watchdog else "as the robot's file says"
        return replace(loss, does="limp", after_s=wait_s, detail=how)

    @property
    def fed_within_s(self) -> float | None:
        """Its watchdog, which any command feeds."""
        return self.settings.watchdog_s

    def _watch_over_host(self) -> Steps:
        """Set the axis' own watchdog where its numbers are known, and see that it is set."""
        wanted = self.settings.watchdog_s
        if self._watchdog is None or wanted is None:
            return
        yield from self._check_firmware()
        timeout, is_on = self._watchdog
        yield self._written(timeout, "float", wanted)
        self._watches = True
        yield self._written(is_on, "bool", True)
        wait_s, is_set = (yield from self._value(timeout, "float")), (yield from self._value(is_on, "bool"))
        if abs(wait_s - wanted) > 1e-3 * wanted or not is_set:
            raise DeviceError(f"{self.name}: its watchdog is not set: it says {wait_s:g} s, on: {is_set}")

    def _check_firmware(self) -> Steps:
        """See that numbers are those of its firmware. Raise `DeviceError` for another one, whose numbers are others."""
        if self._is_known:
            return
        version = yield self.version()
        found = f"{version.major}.{version.minor}.{version.revision}"
        if found != self._firmware:
            raise DeviceError(
                f"{self.name} has firmware {found}, and its endpoints are those of {self._firmware}: take the endpoint file"
                f" of {found}"
            )
        self._is_known = True

    def forget(self) -> None:
        """See `SingleMotor.forget`; its firmware may be another one then."""
        super().forget()
        self._is_known = False

    def stay(self) -> None:
        """Hold the present position; no velocity, no torque."""
        self.want(TARGETS[self.mode][0], self.mode, self._present())

    def _present(self) -> float:
        if self.mode != "position":
            return 0.0
        here = self.signals[f"{self.owner}.position"].value
        if not isinstance(here, float):
            raise DeviceError(
                f'{self.name}: it does not say where it is: set its encoder_msg_rate_ms, or the setting estimates = "asked"'
            )
        return self.scale.raw_angle(here)

    def completed(self, message: str, fields: dict[str, FieldValue]) -> dict[str, FieldValue]:
        """Complete a command: nothing is fed forward."""
        return {**_FORWARD.get(message, {}), **fields}

    def switch_off(self) -> Ticket:
        """Switch to idle; the watchdog ends, for nothing feeds an axis that is off."""
        ticket = self.send_now("SetAxisState", state="idle")
        if self._watches and self._watchdog is not None:
            self._watches = False
            self._written(self._watchdog[1], "bool", False)
        return ticket

    def ask_state(self) -> Awaited:
        """Wait for the next heartbeat but one: the next may have been made before."""
        before = self.beats
        return self.until(lambda: self.beats >= before + 2, HEARTBEAT_S, lambda: "no heartbeat comes")

    # ------------------------------------------------------------------ actions

    def clear_errors(self) -> Ticket:
        """Clear all errors of the drive."""
        return self.send("ClearErrors", **({"identify": 0} if self.is_new else {}))

    def read_errors(self) -> Job:
        """Ask for the error registers: name → value, in firmware 0.6 names of bits."""

        def steps(job: Job) -> Steps:
            found: dict[str, FieldValue] = {}
            for name in _ERRORS[str(self.variant.dialect)]:
                record = yield self.ask(f"Get{name}", reply=name)
                if self.is_new:
                    found = {"active": list(record.active), "disarm_reason": list(record.disarm_reason)}
                else:
                    found[name] = record.error
            return found

        return self.job("read errors", steps)

    def estop(self) -> Ticket:
        """Disarm the axis with an error; set-points end."""
        self.end_led()
        self.end_set_points()
        return self.send_now("Estop")

    def calibrate(self, procedure: str = "full_calibration") -> Job:
        """Calibrate; the motor moves. Fails with `DeviceError` when it does not succeed. Raises `UnknownNameError`."""
        if procedure not in PROCEDURES:
            raise UnknownNameError(f"procedure of {self.name}", procedure, PROCEDURES)
        self.is_driven = True

        def steps(job: Job) -> Steps:
            yield self.ask_state()
            self.check_off("it can be calibrated")
            yield self.send("SetAxisState", state=procedure)
            yield self.ask_state()
            state = self.signals[f"{self.name}.state"]
            yield self.until(lambda: state.last == "idle", CALIBRATION_S, lambda: "calibration does not end")
            if self.faults or self.result != "success":
                why = ", ".join(sorted(self.faults)) or self.result
                raise DeviceError(f"{self.name}: {procedure} failed: {why}")

        return self.lead("calibrate", steps)

    def set_zero(self) -> Job:
        """Make the present position the joint's 0. Fails while the axis is on."""

        def steps(job: Job) -> Steps:
            yield self.ask_state()
            self.check_off("zero can be set")
            if self.is_new:
                yield self.send("SetAbsolutePosition", position=self.scale.raw_angle(0.0))
            else:  # counts of an encoder whose resolution is not reported on CAN
                if self.scale.zero:
                    raise CallerError(
                        f"{self.name}: firmware 0.5 takes 0 only, and {self.owner} has zero = {self.scale.zero:g}"
                    )
                yield self.send("SetLinearCount", count=0)
            self.epoch += 1

        return self.job("set zero", steps)

    def set_gains(
        self, position: float | None = None, velocity: float | None = None, integrator: float | None = None
    ) -> Job:
        """Set gains of the controllers, in the drive's units: (rev/s)/rev; N·m/(rev/s) and N·m/rev, which go
        together.

        Raises `CallerError` for one of the two without the other.
        """
        if (velocity is None) != (integrator is None):
            raise CallerError(f"{self.name}: velocity and integrator are set together")

        def steps(job: Job) -> Steps:
            if position is not None:
                yield self.send("SetPositionGain", gain=float(position))
            if velocity is not None and integrator is not None:
                yield self.send("SetVelocityGains", gain=float(velocity), integrator=float(integrator))

        return self.job("set gains", steps)

    def version(self) -> Ticket:
        """Ask for the versions of hardware and firmware."""
        return self.ask("GetVersion", reply="Version")

    def _endpoint(self, endpoint: int | str, type: str) -> Endpoint:
        """Return a parameter by its name in the endpoint file, or by number and type. Raises `CallerError`."""
        if isinstance(endpoint, str) and not endpoint.isdigit():
            if self._endpoints is None:
                raise CallerError(
                    f"{self.name}: {endpoint} is a name: say settings endpoints = the flat_endpoints.json of its firmware"
                )
            return self._endpoints.named(self.name, endpoint)
        type = type or "float"
        if type not in TYPES:
            raise CallerError(f"{self.name}: no type {type!r} (there are: {', '.join(TYPES)})")
        return Endpoint(int(endpoint), type)

    def read(self, endpoint: int | str, type: str = "") -> Job:
        """Read a parameter by name (setting `endpoints`), or by its number in this firmware's endpoint file and its type.

        Fails with `DeviceError`, also where the drive has another firmware than the file. Raises `CallerError`.
        """
        found = self._endpoint(endpoint, type)

        def steps(job: Job) -> Steps:
            if isinstance(endpoint, str) and not endpoint.isdigit():
                yield from self._check_firmware()
            return (yield from self._value(found.id, found.type))

        return self.job(f"read {endpoint}", steps)

    def write(self, endpoint: int | str, value: float, confirm: bool, type: str = "") -> Job:
        """Write a parameter, until it boots anew, and see that it is written; arguments as of `read`.

        Fails with `DeviceError` when the drive has another value then. Raises `CallerError`.
        """
        if confirm is not True:
            raise CallerError(
                f"{self.name}: say confirm=True; a parameter can move the motor, or change its limits"
            )
        found = self._endpoint(endpoint, type)
        if "w" not in found.access:
            raise CallerError(f"{self.name}: {endpoint} can only be read")
        given = endpoint_value(found.type, endpoint_bytes(found.type, value))

        def steps(job: Job) -> Steps:
            if isinstance(endpoint, str) and not endpoint.isdigit():
                yield from self._check_firmware()
            yield self._written(found.id, found.type, value)
            yield CONFIRMATION_NS
            now = yield from self._value(found.id, found.type)
            if now != given and not (now != now and given != given):
                raise DeviceError(f"{self.name}: {endpoint} was written {given}, and is {now}")

        return self.job(f"write {endpoint}", steps)

    def _written(self, number: int, type: str, value: float) -> Ticket:
        return self.send("RxSdo", opcode="write", endpoint=number, value=endpoint_bytes(type, value))

    def _value(self, number: int, type: str) -> Steps:
        for _ in range(ANOTHERS):
            record = yield self.ask("RxSdo", reply="TxSdo", opcode="read", endpoint=number)
            if record.opcode == 0 and record.endpoint == number:  # else it confirms a write, or answers late
                value = endpoint_value(type, record.value)
                if value is None:
                    raise DeviceError(f"{self.name}: endpoint {number} is no {type}: it answered {record}")
                return value
        raise DeviceError(f"{self.name}: asked for endpoint {number}, it answers others")

    def reboot(self) -> Ticket:
        """Boot anew: it is off then, and has forgotten what was not saved."""
        return self._boot("reboot")

    def save(self, confirm: bool) -> Ticket:
        """Store the configuration, which boots it anew."""
        if confirm is not True:
            raise CallerError(f"{self.name}: say confirm=True; what was set so far outlives power-off then")
        return self._boot("save")

    def _boot(self, action: str) -> Ticket:
        self.end_led()
        self.end_set_points()
        return self.send("Reboot", **({"action": action} if self.is_new else {}))


#: Both firmwares, a joint a mode; only the first sends its position by itself.
EXAMPLE = """
name = "odrive"
rate_hz = 20

[buses]
new = { link = "can", protocol = "odrive", bitrate = 250_000 }
old = { link = "can", protocol = "odrive", dialect = "0.5", bitrate = 250_000 }

[devices]
AXIS0 = { driver = "odrive", bus = "new", credentials = { node = 0 } }
AXIS1 = { driver = "odrive", bus = "new", credentials = { node = 1 }, settings = { estimates = "asked" } }
AXIS5 = { driver = "odrive", bus = "old", credentials = { node = 5 }, settings = { estimates = "asked" } }

[joints]
HIP = { device = "AXIS0", gear = [1, 8], direction = -1, zero = 0.2, lower = -1, upper = 1, max_speed = 6, max_current = 9 }
WINCH = { device = "AXIS1", command = "current" }
WHEEL = { device = "AXIS5", type = "continuous", command = "speed", max_speed = 20 }
"""

driver = Driver(
    "odrive",
    device=Odrive,
    twin=OdriveTwin,
    example=EXAMPLE,
    doc="ODrive motor controller on CAN: position, velocity or torque of an axis.",
    source="ODrive can-protocol.rst, can_simple.cpp; ODriveArduino; ODriveResources",
    # Where it is: 63 remote frames, twice 30 ms each.
    scan=scan_numbers(
        "odrive",
        "ODRIVE",
        "node",
        range(0x3F),
        "GetEncoderEstimates",
        reply="EncoderEstimates",
        timeout_s=0.03,
    ),
    settings=described(OdriveSettings),
)
