"""Pololu qik: two motors at a share of the supply; nothing is measured.

1. A set-point is a duty in the device's own steps: −127…127, in the 8-bit range −255…255. Its sign is the direction.
2. Set-points are repeated in each tick: a lost byte costs one tick, and the device's own time-out can watch over the host.
3. Answers are read only where the robot's file says that the device's transmit line is wired (`answers`).
4. No command is acknowledged, and none has a check: a stop is sent again and again for `STOPPING_NS`, whatever of it is
   lost. Where the device answers, it must say behind it that it has understood what it was sent.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from math import ceil
from operator import mul
from typing import Annotated, Any, ClassVar, Literal

import msgspec
from msgspec import Meta

from aces_bus.device import Device, Driver, HostLoss, Job, OutgoingMessage, Poll, Steps, Ticket, together
from aces_bus.device.coalesce import Setpoint
from aces_bus.device.config import DeviceConfig
from aces_bus.device.host import Host
from aces_bus.device.host_loss import Outcome
from aces_bus.device.settings import described, settings_of
from aces_bus.errors import CallerError, DeviceError
from aces_bus.protocol import Record
from aces_bus.protocol.record import FieldValue

from .twin import UNIT_S, QikTwin

#: Setting a parameter takes 4 ms (Pololu 0J25 5.c); without answers that time is left to the device (ns).
PAUSE_NS = 5_000_000
#: How often a stop is sent, and how long that takes in all (ns): longer than a disturbance usually is.
STOPS, STOPPING_NS = 5, 80_000_000
#: Errors after which a stop may not have been understood.
NOT_UNDERSTOOD = ("crc", "format", "frame", "overrun")
#: The serial time-out where the robot's file does not say: longer than any pause of a host that lives, shorter than a fall.
WATCHDOG_S = 1.0
PARAMETERS = ("device_id", "pwm", "shutdown_on_error", "serial_timeout")


def a_motor(wants: Sequence[Setpoint]) -> Iterable[OutgoingMessage]:
    """Send one command a motor: the device takes no two at once."""
    for want in wants:
        steps = round(want.value)
        size = abs(steps)
        yield OutgoingMessage(
            want.device,
            want.message,
            {
                "motor": int(want.path),
                "reverse": int(steps < 0),
                "high": int(size > 127),
                "speed": size - 128 if size > 127 else size,
            },
        )


def timeout_code(seconds: float) -> int:
    """Return the parameter for a serial time-out of at least so long: 0.262 s × x × 2ʸ, x 4 bits, y 3; 0 is none.

    Raises `CallerError` beyond what it can say, 8.38 min.

    >>> timeout_code(0), timeout_code(0.25), timeout_code(0.5), timeout_code(117)
    (0, 1, 2, 94)
    """
    if seconds <= 0:
        return 0
    units = ceil(seconds / UNIT_S - 1e-9)
    choices = [(x << y, y << 4 | x) for y in range(8) for x in range(1, 16) if x << y >= units]
    if not choices:
        raise CallerError(f"a serial time-out of {seconds:g} s is longer than the device can wait (503 s)")
    return min(choices)[1]


class QikSettings(msgspec.Struct, frozen=True, kw_only=True):
    """The driver's own keys in a robot file."""

    answers: Annotated[
        bool,
        Meta(
            description="true where the device's transmit line is wired: errors are asked for, settings read back"
        ),
    ] = False
    errors_every_s: Annotated[
        float, Meta(gt=0, description="how often errors are asked for (s), 0.5 when absent")
    ] = 0.5
    bits: Annotated[Literal[7, 8], Meta(description="7 (duty −127…127, when absent) or 8 (−255…255)")] = 7
    timeout_s: (
        Annotated[
            float,
            Meta(
                ge=0,
                description="the serial time-out that `enable` sets (s), 0: none; when absent 1, on buses with a rate",
            ),
        ]
        | None
    ) = None


class Qik(Device):
    """Signals: duty of each joint (set only); with answers, the device's errors."""

    protocol = "pololu_qik"
    rules: ClassVar = {"SetSpeed": a_motor}
    streams = ("SetSpeed",)
    actions: ClassVar = {
        "enable": "give the device the range and the time-out of the robot's file",
        "coast": "let both motors turn freely",
        "brake": "stop both motors",
        "firmware": "ask for the firmware's version",
        "configuration": "read all parameters",
        "set_timeout": "set the serial time-out: a number of seconds, 0 for none",
        "set_id": "give the device another number, and go on with that",
    }
    asking: ClassVar = ("firmware", "configuration")
    when_host_is_lost = HostLoss(
        "limp",
        "qik 2s9v1 User's Guide: serial timeout",
        1.0,
        "`enable` sets its serial time-out (`timeout_s`)",
    )

    def setup(self) -> None:
        """Add a duty for each joint, and the errors if the device answers."""
        settings = settings_of(self.name, QikSettings, self.config.settings)
        self.bits, self.answers = settings.bits, settings.answers
        # Without ticks nothing is repeated: a time-out would stop motors that are meant to run.
        usual = (
            max(WATCHDOG_S, 3 * settings.errors_every_s if self.answers else 0.0)
            if self.host.rate_hz
            else 0.0
        )
        self.timeout_s = usual if settings.timeout_s is None else settings.timeout_s
        self.errors: frozenset[str] = frozenset()
        self._was_asked = False
        #: How many set-points and stops it was given: what is left of a stop is not sent behind the next of them.
        self._given_count = 0
        most = 127 if self.bits == 7 else 255
        for joint in self.joints:
            if joint.channel > 1:
                raise CallerError(f"{self.name}: {joint.name} is channel {joint.channel}; a qik has 0 and 1")
            limit = min(joint.max_duty or most, most)
            self.add_signal(
                "duty",
                owner=joint.name,
                set=f"SetSpeed.{joint.channel}",
                from_si=partial(mul, joint.direction),
                lower=-limit,
                upper=limit,
                doc=f"share of the supply, in 1/{most}; its sign is the direction",
                source="acesHubo omnibot",
            )
        if self.answers:
            every = settings.errors_every_s
            self.polls = (Poll("GetError", reply="Errors", every_s=every, timeout_s=0.05),)
            self.add_signal(
                "errors",
                of="Errors.errors",
                to_si=int,
                stale_s=max(0.1, 5 * every),
                doc="error bits since the question before: 8 overrun, 16 frame, 32 crc, 64 format, 128 timeout",
                source="Pololu 0J25 5.b",
            )

    def received(self, record: Record, instant: int) -> None:
        """Tell errors when they come and when they have gone."""
        if type(record).__name__ != "Errors":
            return
        before, self.errors = self.errors, frozenset(record.errors)
        if not self._was_asked:  # nothing was sent before: that is not a fault of this bus
            self._was_asked, self.errors = True, self.errors - {"timeout"}
        self.emit_alarms(self.errors, before)

    # ------------------------------------------------------------------ actions

    def enable(self) -> Job:
        """Give the device its range and time-out: they outlive power-off, so what is right is left alone. With a time-out,
        an error of the device stops its motors.

        Fails with `DeviceError` when the device refuses. Without answers both are sent unseen.
        """
        wanted = {"pwm": int(self.bits == 8), "serial_timeout": timeout_code(self.timeout_s)}
        if self.timeout_s:
            wanted["shutdown_on_error"] = 1

        def steps(job: Job) -> Steps:
            for parameter, value in wanted.items():
                if self.answers:
                    present = yield self.ask("GetConfiguration", reply="Configuration", parameter=parameter)
                    low = present.value & 1 if parameter == "pwm" else present.value
                    if low == value:
                        continue
                    if parameter == "pwm":
                        value |= present.value & 2  # the frequency is not ours to choose
                yield self.set_parameter(parameter, value)

        return self.lead("enable", steps)

    def set_parameter(self, parameter: str, value: int) -> Job:
        """Set a parameter, for good. Fails with `DeviceError` when the device refuses it."""

        def steps(job: Job) -> Steps:
            fields: dict[str, Any] = {"parameter": parameter, "value": value}
            if not self.answers:
                ticket = self.send("SetConfiguration", **fields)
                yield ticket
                yield self.host.port.wire_ns(ticket.packet) + PAUSE_NS
                return None
            answer = yield self.ask("SetConfiguration", reply="ConfigurationSet", timeout_s=0.05, **fields)
            if answer.result != "ok":
                raise DeviceError(f"{self.name} does not take {value} for {parameter}: {answer.result}")
            return answer

        return self.job(f"set {parameter}", steps)

    def set_timeout(self, seconds: float) -> Job:
        """Set the serial time-out (s), 0 for none: without a command for so long the device reports an error, and stops
        its motors if its shutdown_on_error is 1. Raises `CallerError` when it is too long."""
        return self.set_parameter("serial_timeout", timeout_code(float(seconds)))

    def set_id(self, number: int) -> Job:
        """Give the device another number (0 to 127), and go on with that one. It must be alone with its number."""
        number = int(number)
        if not 0 <= number < 128:
            raise CallerError(f"{self.name}: a device number is 0 to 127, not {number}")

        def steps(job: Job) -> Steps:
            yield self.set_parameter("device_id", number)
            self.host.renumber(self, id=number)

        return self.job("set id", steps)

    def coast(self) -> Job:
        """Let both motors turn freely; set-points end."""
        return self._again_and_again("coast", partial(self._both, "Coast"))

    def brake(self) -> Job:
        """Stop both motors; set-points end."""
        return self._again_and_again("brake", self._brake)

    @property
    def host_loss(self) -> HostLoss:
        """As declared; without a time-out its motors go on."""
        if self.timeout_s:
            return replace(self.when_host_is_lost, after_s=self.timeout_s)
        return replace(self.when_host_is_lost, does="goes on", after_s=None, detail="it has no time-out here")

    @property
    def fed_within_s(self) -> float | None:
        """Its serial time-out, which any instruction feeds."""
        return self.timeout_s or None

    def stop_motion(self) -> Job:
        """Brake by speed 0."""
        return self.brake()

    @property
    def stop_leaves(self) -> Outcome:
        """Braked."""
        return "brakes"

    def confirm_stopped(self) -> Job | None:
        """Brake once more, and ask whether the device has understood; None where it does not answer."""
        if not self.answers:
            return None

        def steps(job: Job) -> Steps:
            left = -PAUSE_NS
            ticket: Ticket | None = None
            # Right behind the stop, and asked once: an answer much later says nothing of a stop that was lost.
            while ticket is None or ticket.sent_at - left > PAUSE_NS:
                yield self._brake()
                left = self.clock.now()
                ticket = self.ask("GetError", reply="Errors", timeout_s=0.05, retries=0, confirms=True)
                yield ticket
            record = ticket.result
            if wrong := [name for name in NOT_UNDERSTOOD if name in record.errors]:
                raise DeviceError(
                    f"{self.name} reports {', '.join(wrong)}: it may not have understood its stop"
                )

        return self.job("ask whether it has understood", steps)

    def want(self, message: str, path: str, value: FieldValue) -> None:
        """Do what `Device.want` does; it ends what is left of a stop."""
        self._given_count += 1
        super().want(message, path, value)

    def _brake(self) -> Job:
        return self._both("SetSpeed", reverse=0, high=0, speed=0)

    def _both(self, message: str, **fields: Any) -> Job:
        """Send a command to both motors, before all that waits."""
        tickets = [self.send_now(message, motor=motor, **fields) for motor in (0, 1)]
        return together(self.clock, f"{self.name} {message}", tickets)

    def _again_and_again(self, name: str, send: Callable[[], Job]) -> Job:
        self.drop("SetSpeed")
        self._given_count = mine = self._given_count + 1
        first = send()

        def steps(job: Job) -> Steps:
            yield first
            for _ in range(STOPS - 1):
                yield STOPPING_NS // (STOPS - 1)
                if self._given_count != mine:
                    return
                yield send()

        return self.job(name, steps)

    def firmware(self) -> Ticket:
        """Ask for the firmware's version: the record's `version`."""
        return self.ask("GetFirmware", reply="Firmware")

    def configuration(self) -> Job:
        """Read all parameters: the result is {name: value}."""

        def steps(job: Job) -> Steps:
            found: dict[str, int] = {}
            for number, parameter in enumerate(PARAMETERS):
                answer = yield self.ask("GetConfiguration", reply="Configuration", parameter=parameter)
                found[parameter] = answer.value
                job.progress = (number + 1) / len(PARAMETERS)
            return found

        return self.job("configuration", steps)


#: How long each number is given to answer, s: the next when an answer came later than this.
PATIENCE_S = (0.02, 0.15, 0.5)
#: After so long, ns, no answer to an earlier number is on its way.
LATE_NS = 100_000_000


def _scan(host: Host, job: Job) -> Steps:
    """Ask every number for the firmware's version. Devices without a transmit line are not found.

    An answer does not say whose it is: it counts when the same number answers again. When it does not, or when an answer
    comes that no question waits for, answers are late, and all numbers are asked anew, with more patience.

    Raises `DeviceError` when answers are late even with the most patience.
    """
    for patience_s in PATIENCE_S:
        found: list[int] = []
        before = _unasked(host)
        for number in range(128):
            job.progress, job.text = number / 128, f"number {number}, {len(found)} found"
            if (yield from _answers(host, number, patience_s)):
                yield LATE_NS
                if not (yield from _answers(host, number, patience_s)):
                    break
                found.append(number)
        else:
            yield LATE_NS
            if _unasked(host) == before:
                return [_config(host, number) for number in found]
    raise DeviceError(
        f"{host.name}: answers come later than {PATIENCE_S[-1]:g} s, or were not asked for: whose they are is unknown;"
        " is another program on this line?"
    )


def _config(host: Host, number: int) -> DeviceConfig:
    return DeviceConfig(
        name=f"QIK{number}",
        driver="pololu_qik",
        bus=host.name,
        credentials={"id": number},
        channels=2,
        settings={"answers": True},
    )


def _unasked(host: Host) -> int:
    """Return how many answers have come that no question waited for."""
    return host.unknown.total() + host.unknown_devices.total()


def _answers(host: Host, number: int, timeout_s: float) -> Steps:
    """Return whether a device answers to this number."""
    return host.answers(
        "pololu_qik", {"id": number}, "GetFirmware", reply="Firmware", timeout_s=timeout_s, retries=0
    )


EXAMPLE = """
name = "pololu_qik"
rate_hz = 20

[buses]
drives = { link = "serial", protocol = "pololu_qik", baud = 38_400 }

[devices]
QIK1 = { driver = "pololu_qik", bus = "drives", credentials = { id = 1 }, channels = 2, settings = { answers = true } }
QIK3 = { driver = "pololu_qik", bus = "drives", credentials = { id = 3 }, settings = { answers = true, bits = 8 } }
QIK5 = { driver = "pololu_qik", bus = "drives", credentials = { id = 5 }, channels = 2 }

[joints]
M1 = { device = "QIK1", channel = 0, type = "continuous", command = "duty", max_duty = 127 }
M2 = { device = "QIK1", channel = 1, type = "continuous", command = "duty", max_duty = 100, direction = -1 }
M3 = { device = "QIK3", channel = 0, type = "continuous", command = "duty", max_duty = 255 }
M4 = { device = "QIK5", channel = 1, type = "continuous", command = "duty" }
"""

driver = Driver(
    "pololu_qik",
    device=Qik,
    twin=QikTwin,
    example=EXAMPLE,
    doc="Pololu qik dual motor driver: two motors at a share of the supply.",
    source="acesHubo omnibot; Pololu 0J25 (Qik 2s9v1 User's Guide)",
    scan=_scan,
    settings=described(QikSettings),
)
