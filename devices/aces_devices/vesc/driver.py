"""VESC: one controller, one motor, by duty, current, speed or position; on CAN or at a serial line.

1. A controller has no state "enabled": it obeys every sender. Nothing is sent before `enable`, and nothing after the device
   has reported a fault or fallen silent, until it is enabled anew.
2. Set-points are repeated in each tick; the controller's own time-out (1 s from the factory) stops its motor without them.
3. On CAN each controller answers to a host number of its own: pieces of long answers have no sender, and would mix.
"""

from __future__ import annotations

from functools import partial
from math import degrees, tau
from operator import mul
from typing import Annotated, Any, ClassVar, Literal

import msgspec
from msgspec import Meta

from aces_bus.device import Device, Driver, HostLoss, Job, Poll, Steps, Ticket
from aces_bus.device.config import DeviceConfig
from aces_bus.device.host import Host
from aces_bus.device.host_loss import Outcome
from aces_bus.device.settings import described, settings_of
from aces_bus.device.signals import Signal
from aces_bus.errors import CallerError, DeviceError
from aces_bus.protocol import Record
from aces_protocols.vesc_uart.spec import mask_of

from ..scanning import scan_numbers
from .twin import VescTwin, VescUartTwin
from .wires import CanWire, SerialWire

#: The message and field of each kind of set-point.
SETS = {
    "duty": "SetDuty.duty",
    "current": "SetCurrent.current",
    "speed": "SetSpeed.speed",
    "position": "SetPosition.position",
}
#: The tachometer counts six a turn of the field (documentation/comm_can.md).
TACHOMETER = 6
#: Motor current that counts as none (A): measured currents are never quite 0.
STILL_A = 1.0
#: Between two packets of one stop, where they may be lost (ns).
STOP_AGAIN_NS = 20_000_000
#: What is asked for in each tick; with status messages only what they lack, and how often (s).
POLLED = (
    "fet_temperature",
    "motor_temperature",
    "motor_current",
    "input_current",
    "duty",
    "speed",
    "voltage",
)
FAULT_S = 0.2
#: How often it is asked for its version.
ASKED = 5


class VescUartSettings(msgspec.Struct, frozen=True, kw_only=True):
    """The driver's own keys in a robot file."""

    pole_pairs: Annotated[
        int, Meta(gt=0, le=100, description="pole pairs of the motor: turns of the field a turn (default 7)")
    ] = 7
    stop: Annotated[
        Literal["release", "brake"],
        Meta(description='what a stop does: "release" the motor (default), or "brake" it with brake_current'),
    ] = "release"
    brake_current: Annotated[float, Meta(gt=0, description="motor current of a brake, A (default 5)")] = 5.0


class VescSettings(VescUartSettings, frozen=True, kw_only=True):
    """On CAN there are some more."""

    host: (
        Annotated[
            int,
            Meta(
                ge=0,
                lt=255,
                description="the number it answers to, when absent its own with bit 7 turned over",
            ),
        ]
        | None
    ) = None
    values: Annotated[
        Literal["poll", "status"],
        Meta(
            description='"poll": ask for values in each tick (default); "status": it is configured to send them'
        ),
    ] = "poll"


class Vesc(Device):
    """Signals: velocity, position, current and duty of the joint; supply, temperatures and fault of the controller."""

    protocol = "vesc"
    settings: VescUartSettings
    streams = tuple(path.partition(".")[0] for path in SETS.values())
    actions: ClassVar = {
        "enable": "take set-points from now on; by position: hold where it is",
        "disable": "end set-points and stop",
        "brake": "end set-points, and brake with the setting brake_current until the controller's time-out",
        "firmware": "ask for version and hardware",
    }
    asking: ClassVar = ("firmware",)
    when_host_is_lost = HostLoss(
        "limp", "vedderb/bldc timeout.c; documentation/comm_can.md says 0.5 s", 1.0,
        "then with the configured brake current, 0 from the factory; the time-out is the controller's own setting",
    )  # fmt: skip

    # ------------------------------------------------------------------ declaration

    def setup(self) -> None:
        """Add signals of the motor and of the controller, and the polls."""
        settings = self.settings = self._connected()
        sends_status = isinstance(settings, VescSettings) and settings.values == "status"
        if len(self.joints) > 1:
            names = ", ".join(joint.name for joint in self.joints)
            raise CallerError(f"{self.name}: a VESC has one motor, and moves one joint, not {names}")
        joint = self.joint = self.joints[0] if self.joints else None
        self.command = "duty" if joint is None else joint.command
        self.direction = joint.direction if joint else 1
        self.ratio = (joint.ratio if joint else None) or 1.0
        if self.command == "position" and self.ratio != 1.0:
            raise CallerError(
                f"{self.name}: by position the encoder's angle is the joint's; a gear of {self.ratio:g} goes with"
                ' "speed", "current" or "duty"'
            )
        self.zero = (joint.zero or 0.0) if joint else 0.0
        self.takes_set_points = False
        self.alarms: frozenset[str] = frozenset()
        self.values: dict[str, float] = {}
        #: Firmware and hardware, when they were asked for.
        self.version = ""
        angle = "position" if self.command == "position" else "tachometer"
        self.asked = mask_of(*POLLED, angle, "fault")
        if sends_status:
            self.polls = (self._poll(mask_of("fault"), FAULT_S),)
        else:
            self.polls = (self._poll(self.asked, None),)
        self._signals(joint.name if joint else self.name, angle, 5 * FAULT_S if sends_status else None)

    def _connected(self) -> VescUartSettings:
        """Have a wire, and the settings that go with it; a serial line has one controller and no status messages."""
        self.wire: CanWire | SerialWire
        if self.host.port.link == "serial":
            self.wire = SerialWire()
            return settings_of(self.name, VescUartSettings, self.config.settings)
        settings = settings_of(self.name, VescSettings, self.config.settings)
        self.wire = CanWire(self.name, self.credentials, settings.host)
        return settings

    def _poll(self, mask: int, every_s: float | None) -> Poll:
        message, fields = self.wire.request("GetSelected", {"mask": mask})
        return Poll(message, self.wire.answers("GetSelected"), fields, every_s=every_s)

    def _signals(self, owner: str, angle: str, fault_age_s: float | None) -> None:
        joint, direction = self.joint, self.direction
        self.known: dict[str, tuple[Signal, Any]] = {}
        # The field's turns a minute at 1 rad/s of the joint; tachometer counts a rad.
        rpm = direction * 60 / tau * self.ratio * self.settings.pole_pairs
        counts = direction * TACHOMETER * self.settings.pole_pairs * self.ratio / tau
        received = self.wire.gives
        most = {
            "duty": joint.max_duty if joint else None,
            "current": joint.max_current if joint else None,
            "speed": joint.max_speed if joint else None,
        }.get(self.command)

        def add(
            name: str, field: str, to_si: Any = None, kind: str = "", from_si: Any = None, **more: Any
        ) -> None:
            if kind == self.command:
                more |= {"set": SETS[kind], "from_si": from_si}
                if kind != "position":
                    limit = 1.0 if kind == "duty" and most is None else most
                    more |= {"lower": None if limit is None else -limit, "upper": limit}
            made = self.add_signal(name, read_from=received, source="comm/commands.c", **more)
            self.known[field] = (made, to_si)

        signed = partial(mul, direction)
        own = {"owner": owner}
        is_angle = angle == "position"
        add(
            "position",
            angle,
            self._angle if is_angle else lambda count: count / counts,
            "position",
            self._degrees,
            unit="rad",
            lower=joint.lower if joint and is_angle else None,
            upper=joint.upper if joint and is_angle else None,
            doc="The encoder's angle." if is_angle else "How far it has turned since it was switched on.",
            **own,
        )
        add(
            "velocity",
            "speed",
            lambda v: v / rpm,
            "speed",
            lambda v: v * rpm,
            unit="rad/s",
            doc="Of the joint.",
            **own,
        )
        add("current", "motor_current", signed, "current", signed, unit="A", doc="Of the motor.", **own)
        add("duty", "duty", signed, "duty", signed, doc="Share of the supply, −1…1.", **own)
        self.is_enabled = self.add_signal(
            "enabled",
            owner=owner,
            read_from=received,
            doc="Whether set-points are taken; see the action enable.",
        )
        for name, field, unit, doc in (
            ("voltage", "voltage", "V", "Supply."),
            ("input_current", "input_current", "A", "From the supply."),
            ("temperature", "fet_temperature", "°C", "Of its transistors."),
            ("motor_temperature", "motor_temperature", "°C", "Of the motor, where it has a sensor."),
        ):
            add(name, field, unit=unit, doc=doc)
        answers = self.wire.answers("GetSelected")
        made = self.add_signal(
            "fault", read_from=answers, doc='What has stopped it; "none".', stale_s=fault_age_s
        )
        self.known["fault"] = (made, None)

    def _angle(self, angle: float) -> float:
        """Return the joint's angle (rad) of the encoder's (°), nearest to the middle of its limits."""
        joint = self.joint
        middle = (
            (joint.lower + joint.upper) / 2
            if joint and joint.lower is not None and joint.upper is not None
            else 0.0
        )
        found = self.direction * (angle / 360 * tau - self.zero)
        return (found - middle + tau / 2) % tau - tau / 2 + middle

    def _degrees(self, position: float) -> float:
        return degrees(self.direction * position + self.zero) % 360

    # ------------------------------------------------------------------ up

    def received(self, record: Record, instant: int) -> None:
        """Take status messages, and answers that are whole."""
        match type(record).__name__:
            case "Status":
                self._know(
                    {"speed": record.speed, "motor_current": record.current, "duty": record.duty}, instant
                )
            case "Status4":
                names = ("fet_temperature", "motor_temperature", "input_current", "position")
                self._know({name: getattr(record, name) for name in names}, instant)
            case "Status5":
                self._know({"tachometer": record.tachometer, "voltage": record.voltage}, instant)
            case _:
                answer, is_broken = self.wire.taken(record)
                if answer is not None:
                    self._answer(answer, instant)
                elif is_broken:
                    self.emit_event("malformed", "an answer in pieces is not whole, or its check is wrong")

    def _answer(self, answer: Record, instant: int) -> None:
        if type(answer).__name__ == "Firmware":
            self.version = f"{answer.major}.{answer.minor} on {answer.hardware}"
        if type(answer).__name__ != "Selected":
            return
        self._know({name: getattr(answer, name) for name in self.known}, instant)
        fault = str(answer.fault)
        before, self.alarms = self.alarms, frozenset() if fault == "none" else frozenset((fault,))
        self.emit_alarms(self.alarms, before)
        if self.alarms and self.takes_set_points:
            self._off()
        self.is_enabled.update(self.takes_set_points, instant)

    def _know(self, values: dict[str, Any], instant: int) -> None:
        self.values.update((name, value) for name, value in values.items() if value is not None)
        for name, (target, to_si) in self.known.items():
            value = values.get(name)
            if value is not None:
                target.update(value if to_si is None else to_si(value), instant)
        self.is_enabled.update(self.takes_set_points, instant)

    def no_reply(self, ticket: Ticket) -> None:
        """Note that a silent device may have rebooted and must be enabled anew."""
        if self.takes_set_points and self.misses >= self.silent_after:
            self._off()

    # ------------------------------------------------------------------ actions

    def _off(self) -> None:
        self.takes_set_points = False
        for message in self.streams:
            self.drop(message)

    def _ask(self, packet: str, *, retries: int = 2, confirms: bool = False, **fields: Any) -> Ticket:
        message, given = self.wire.request(packet, fields)
        inside: dict[str, Any] = dict(given)
        return self.ask(
            message, reply=self.wire.answers(packet), retries=retries, confirms=confirms, **inside
        )

    def enable(self) -> Job:
        """Take set-points. Fails with `DeviceError` when the controller reports a fault."""

        def steps(job: Job) -> Steps:
            self._off()
            yield self._ask("GetSelected", mask=self.asked)
            if self.alarms:
                raise DeviceError(f"{self.name} reports {', '.join(self.alarms)}")
            self.takes_set_points = self.is_driven = True
            if self.command == "position" and self.joint is not None:
                self.want("SetPosition", "position", self.values["position"] % 360)

        return self.lead("enable", steps)

    def disable(self) -> Job:
        """Stop, and see that it has."""

        def steps(job: Job) -> Steps:
            yield self.stop_motion()
            yield self.confirm_stopped()

        return self.job("disable", steps)

    def brake(self) -> Ticket:
        """End set-points and brake; when the controller's time-out is over, what that is configured for goes on."""
        self.end_led()
        self._off()
        return self.send_now("SetBrakeCurrent", current=self.settings.brake_current)

    def stop_motion(self) -> Ticket:
        """End set-points; the motor is free, or brakes (setting `stop`)."""
        if self.settings.stop == "brake":
            return self.brake()
        self.end_led()
        self._off()
        return self.send_now("SetCurrent", current=0.0)

    @property
    def stop_leaves(self) -> Outcome:
        """Free; with the setting `stop` = "brake", braked until the controller's time-out."""
        return "brakes" if self.settings.stop == "brake" else "limp"

    def confirm_stopped(self) -> Job:
        """Return whether no current drives it on: there is none, or it goes against the motion.

        A motor without a load takes hardly any, and no set-point is acknowledged. Where packets are lost it is sent again
        and again; the question is right behind it, asked once: a later answer says nothing of a lost stop.
        """

        def steps(job: Job) -> Steps:
            for _ in range(self.wire.stops):
                yield STOP_AGAIN_NS
                yield self.stop_motion()
            yield self._ask("GetSelected", retries=0, confirms=True, mask=self.asked)
            current, speed = self.values.get("motor_current", 0.0), self.values.get("speed", 0.0)
            if abs(current) > STILL_A and current * speed >= 0:
                raise DeviceError(f"its motor current is {current:g} A")

        return self.job("look whether it has stopped", steps)

    def firmware(self) -> Job:
        """Ask who it is: "6.5 on 60"."""

        def steps(job: Job) -> Steps:
            self.version = ""
            for _ in range(ASKED):  # on CAN the answer to a poll looks the same from outside
                yield self._ask("GetFirmware")
                if self.version:
                    return self.version
            raise DeviceError(f"{self.name} does not say its version")

        return self.job("firmware", steps)


#: How long each number is given to answer (s): a controller answers within 10 ms (comm/comm_can.c).
PATIENCE_S = 0.02
#: Who asks while controllers are looked for, where no controller is yet known to have that number.
SCANNER = 254


def _scan_line(host: Host, job: Job) -> Steps:
    """Ask for the version."""
    answer = yield from host.answers("vesc_uart", {}, "GetFirmware", reply="Firmware", timeout_s=0.1)
    return (
        []
        if answer is None
        else [DeviceConfig(name="VESC", driver="vesc_uart", bus=host.name, credentials={})]
    )


EXAMPLE = """
name = "vesc"
rate_hz = 20

[buses]
can = { link = "can", protocol = "vesc", bitrate = 500_000 }

[devices]
LEFT = { driver = "vesc", bus = "can", credentials = { id = 5 } }
MAST = { driver = "vesc", bus = "can", credentials = { id = 7 }, settings = { values = "status", stop = "brake" } }

[joints]
WHEEL_LEFT = { device = "LEFT", type = "continuous", command = "speed", gear = [1, 4], max_speed = 30 }
CAMERA = { device = "MAST", lower = -1.5, upper = 1.5, zero = 0.3, direction = -1, max_speed = 3 }
"""

driver = Driver(
    "vesc",
    device=Vesc,
    twin=VescTwin,
    example=EXAMPLE,
    doc="VESC motor controller on CAN: a motor by duty, current, speed or position.",
    source="vedderb/bldc comm/comm_can.c, comm/commands.c, timeout.c",
    # A ping changes nothing, and does not feed a time-out.
    scan=scan_numbers(
        "vesc",
        "VESC",
        "id",
        range(254),
        "Ping",
        reply="Pong",
        timeout_s=PATIENCE_S,
        retries=0,
        host=SCANNER,
        known=lambda pong: {} if str(pong.hardware) == "vesc" else None,
    ),
    settings=described(VescSettings),
)

UART_EXAMPLE = """
name = "vesc_uart"
rate_hz = 20

[buses]
left = { link = "serial", protocol = "vesc_uart", baud = 115_200 }
mast = { link = "serial", protocol = "vesc_uart", baud = 115_200 }

[devices]
LEFT = { driver = "vesc_uart", bus = "left" }
MAST = { driver = "vesc_uart", bus = "mast", settings = { stop = "brake" } }

[joints]
WHEEL_LEFT = { device = "LEFT", type = "continuous", command = "speed", gear = [1, 4], max_speed = 30 }
CAMERA = { device = "MAST", lower = -1.5, upper = 1.5, zero = 0.3, direction = -1, max_speed = 3 }
"""

uart_driver = Driver(
    "vesc_uart",
    device=Vesc,
    twin=VescUartTwin,
    speaks="vesc_uart",
    example=UART_EXAMPLE,
    doc="VESC motor controller at a serial line: a motor by duty, current, speed or position.",
    source="vedderb/bldc comm/packet.c, comm/commands.c, timeout.c",
    scan=_scan_line,
    settings=described(VescUartSettings),
)
