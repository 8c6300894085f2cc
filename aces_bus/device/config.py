"""A robot as data: its buses, the devices on them, the joints and sensors of the devices.

1. Frozen, and checked where it is made (`load_robot`): who has a `Robot` need not ask again.
2. Unknown is None. A limit that is not stated is absent, never 0.
3. No vendor: names of drivers, protocols and kinds are strings, understood by those who bring them.

Units are SI: rad and rad/s for a revolute joint, m and m/s for a prismatic one. What only a board understands keeps the
board's unit and says so (counts, motor turns). The names of the fields are the keys of the file (see docs/robots.md);
a field's type says what may stand there, and describes it for complaints.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta
from msgspec.structs import replace

from ..errors import CallerError, UnknownNameError
from ..protocol import Protocol

# What may stand in a file; the description is what a complaint says is expected.
Text = Annotated[str, Meta(min_length=1, max_length=100_000, description="text in quotes")]
Name = Annotated[str, Meta(min_length=1, max_length=100, description="a name in quotes")]
Names = Annotated[
    tuple[Name, ...], Meta(max_length=100, description='a list of names, such as ["TSY", "HPY"]')
]
Whole = Annotated[int, Meta(ge=-(2**63), le=2**63 - 1, description="a whole number")]
Count = Annotated[int, Meta(ge=0, le=2**31, description="a whole number, 0 or more")]
Positive = Annotated[int, Meta(gt=0, le=2**31, description="a whole number above 0")]
Angle = Annotated[float, Meta(description="a number in rad (m for a prismatic joint)")]
Speed = Annotated[float, Meta(gt=0, description="a number above 0 in rad/s (m/s for a prismatic joint)")]
Acceleration = Annotated[
    float, Meta(gt=0, description="a number above 0 in rad/s² (m/s² for a prismatic joint)")
]
Number = Annotated[float, Meta(description="a number")]
Ratio = Annotated[float, Meta(gt=0, description="a number above 0")]
Error = Annotated[float, Meta(ge=0, description="a number in rad (m for a prismatic joint), or 0 for never")]
Gear = Annotated[
    tuple[Ratio, Ratio], Meta(description="two numbers above 0: [drive, driven], such as [10, 25]")
]
Sign = Annotated[Literal[-1, 1], Meta(description="1 or -1")]
Signs = Annotated[
    tuple[Sign, ...], Meta(min_length=1, max_length=16, description="a list of 1 and -1, one an axis")
]
Matrix = Annotated[
    tuple[tuple[float, ...], ...],
    Meta(min_length=1, max_length=16, description="rows of numbers, [[…], […]]"),
]
Value = Annotated[
    bool | int | float | Annotated[str, Meta(max_length=100)],
    Meta(description="true, false, a number or a text in quotes"),
]
Flag = Annotated[bool, Meta(description="true or false")]
Credentials = Annotated[
    dict[str, Count],
    Meta(min_length=1, description="what identifies it on the bus, such as { board = 0x20 }"),
]
Kind = Annotated[
    int | str | dict[str, int | str],
    Meta(description='an entry of the protocol\'s configuration tables, such as 3 or "hand"'),
]
Settings = Annotated[dict[str, Any], Meta(description="a table of the driver's own settings")]
Hertz = Annotated[float, Meta(gt=0, description="a number above 0 (Hz)")]
Seconds = Annotated[float, Meta(gt=0, description="a number above 0 (s)")]
Priority = Annotated[int, Meta(ge=1, le=99, description="a whole number from 1 to 99, the highest")]


class Bus(msgspec.Struct, frozen=True, kw_only=True):
    """One wire. `channel` and `interface` are python-can's, or a serial port, or HOST:PORT; a caller may change them."""

    name: str
    link: Annotated[Literal["can", "serial", "datagram"], Meta(description='"can", "serial" or "datagram"')]
    protocol: Name
    dialect: Name | None = None
    bitrate: Positive | None = None  # bit/s, CAN
    data_bitrate: Positive | None = None  # bit/s, of the data of CAN FD frames that switch
    baud: Positive | None = None  # serial
    half_duplex: Flag | None = None  # serial; None: as its protocol is
    interface: Text | None = None
    channel: Text | None = None
    allow: (
        Annotated[
            tuple[Name, ...],
            Meta(
                min_length=1, max_length=100, description='a list of candump\'s filters, such as ["010:7F0"]'
            ),
        ]
        | None
    ) = None  # CAN: what may be sent; None: all that its devices take
    rate_hz: Hertz | None = None  # its tick; None: the robot's
    priority: Priority | None = None
    doc: Text | None = None
    source: Text | None = None


class DeviceConfig(msgspec.Struct, frozen=True, kw_only=True):
    """One node: a board, a servo. `credentials` are fields of the protocol's messages with this node's values.

    None are needed where the protocol has no such fields: a board that is alone on its line.

    `kind` is its entry in the protocol's configuration tables, where that is not the number of its channels.
    """

    name: str
    driver: Name
    bus: Name
    credentials: Credentials = msgspec.field(default_factory=dict[str, int])
    channels: Count | None = None
    kind: Kind | None = None
    protocol: Name | None = None  # where it is not its bus's
    dialect: Name | None = None
    model: Text | None = None  # its maker's name for it
    active: Flag = True
    rate_hz: Hertz | None = None  # how often it is asked and given set-points; None: in each tick of its bus
    priority: Priority | None = None
    settings: Settings = msgspec.field(default_factory=dict[str, Any])
    doc: Text | None = None
    source: Text | None = None


#: The priority of a bus, and of a device among those of its bus, where the file states none.
BUSES = 50


def priority_of(config: Bus | DeviceConfig) -> int:
    """Return the stated priority, or `BUSES`."""
    return BUSES if config.priority is None else config.priority


class Gains(msgspec.Struct, frozen=True, kw_only=True):
    """Position gains, in the board's own numbers."""

    kp: Number | None = None
    ki: Number | None = None
    kd: Number | None = None


class Compliance(msgspec.Struct, frozen=True, kw_only=True):
    """Gains of compliant motion by duty: `kp` in %/rad, `kd` in %·s/rad, `max_pwm` in %."""

    kp: Number | None = None
    kd: Number | None = None
    max_pwm: Annotated[float, Meta(ge=0, le=100, description="a number from 0 to 100 (%)")] | None = None


class Input(msgspec.Struct, frozen=True, kw_only=True):
    """What is read before motion is allowed: a signal, a field of a message, or a key of the keyboard.

    `clear` is the value at which nothing stands in the way (of a key: the key that clears it), or `pressed` the one at
    which something does: of signals and messages exactly one of both. `bit` looks at one bit of a number. A value older
    than `stale_after_s`, or none, counts as pressed.
    """

    name: str = ""
    signal: Name | None = None  # "PLC.estop"
    bus: Name | None = None
    message: Name | None = None  # "Button.pressed", on `bus`
    protocol: Name | None = None  # of the message, where it is not the bus's
    credentials: Credentials = msgspec.field(default_factory=dict[str, int])
    key: Name | None = None
    bit: (
        Annotated[int, Meta(ge=0, le=63, description="a whole number from 0 (the lowest bit) to 63")] | None
    ) = None
    clear: Value | None = None
    pressed: Value | None = None
    stale_after_s: Seconds = 0.5
    doc: Text | None = None
    source: Text | None = None


class Reduced(msgspec.Struct, frozen=True, kw_only=True):
    """Reduced speed: `scale` times every speed limit, while `active`, or while `input` is not clear."""

    scale: Annotated[float, Meta(gt=0, le=1, description="a number above 0, up to 1")]
    active: Flag = False
    input: Input | None = None
    doc: Text | None = None
    source: Text | None = None


class Park(msgspec.Struct, frozen=True, kw_only=True):
    """Where to park: a `pose` (joint → rad, m), at `speed` (rad/s, m/s) at most.

    A joint is parked while it is `within` so far (rad, m) of its target.
    """

    pose: Annotated[
        Mapping[str, float],
        Meta(min_length=1, description="a table of joints and angles, such as { RHP = 0.0 }"),
    ]
    speed: Annotated[float, Meta(gt=0, description="a number above 0 (rad/s)")] = 0.2
    within: Annotated[float, Meta(gt=0, description="a number above 0 (rad)")] = 0.1
    doc: Text | None = None
    source: Text | None = None


class Home(msgspec.Struct, frozen=True, kw_only=True):
    """What the board knows of homing, in its own units; the calibration of one robot, not of a model.

    `offset`: counts from the switch to zero; `direction` of the search; `search_turns`: its end, in motor turns; `z_phase`:
    the encoder's index, counts; `power`: drive power of joints that home against a stop; `lower`, `upper`: the limits
    stored in the board, counts.
    """

    offset: Whole | None = None
    direction: Annotated[Literal["cw", "ccw"], Meta(description='"cw" or "ccw"')] | None = None
    search_turns: Count | None = None
    z_phase: Count | None = None
    power: Whole | None = None
    lower: Whole | None = None
    upper: Whole | None = None


class Joint(msgspec.Struct, frozen=True, kw_only=True):
    """One degree of freedom: channel `channel` (from 0) of `device`.

    raw = (direction × position + zero) × `counts_per_unit`. A gear or harmonic drive that is not stated is none. An inactive
    joint is listed, and claims no channel.
    """

    name: str
    device: Name
    channel: Count = 0
    type: Annotated[
        Literal["revolute", "prismatic", "continuous"],
        Meta(description='"revolute", "prismatic" or "continuous" (turns without end)'),
    ] = "revolute"
    command: Annotated[
        Literal["position", "speed", "current", "duty"],
        Meta(description='"position", "speed", "current" or "duty"'),
    ] = "position"
    gear: Gear | None = None  # teeth: drive, driven
    harmonic: Ratio | None = None
    encoder: Positive | None = None  # counts a turn of the motor
    direction: Sign = 1
    zero: Angle | None = None
    lower: Angle | None = None
    upper: Angle | None = None
    nominal_speed: Speed | None = None
    max_speed: Speed | None = None
    nominal_acceleration: Acceleration | None = None
    max_acceleration: Acceleration | None = None
    following_error: Error | None = None  # how far from where it was sent counts as not following; 0: never
    following_time_s: Ratio | None = None
    max_duty: Ratio | None = None  # the protocol's unit
    max_current: Ratio | None = None  # A
    gains: Gains | None = None
    compliance: Compliance | None = None
    home: Home | None = None
    brake: Input | None = None  # what says that its brake is as it has to be before it is enabled
    needs_homing: Flag = True  # whether a joint that its driver knows is not homed is refused set-points
    motor: Count | None = None  # the maker's number of the motor
    aliases: Names = ()
    active: Flag = True
    doc: Text | None = None
    source: Text | None = None

    @property
    def ratio(self) -> float | None:
        """Turns of the motor, or of a servo's shaft, a turn of the joint; None where neither gear nor harmonic is stated.

        driven ÷ drive × harmonic, each 1 where only the other is stated.
        """
        if self.gear is None and self.harmonic is None:
            return None
        drive, driven = self.gear or (1.0, 1.0)
        return driven / drive * (self.harmonic or 1.0)

    @property
    def counts_per_unit(self) -> float | None:
        """Encoder counts a rad (a revolute joint); None where ratio or encoder is unknown.

        driven ÷ drive × harmonic × encoder ÷ 2π (HuboCan; hubo-ach; acesHubo).
        """
        if self.ratio is None or self.encoder is None or self.type == "prismatic":
            return None
        return self.ratio * self.encoder / math.tau


class Sensor(msgspec.Struct, frozen=True, kw_only=True):
    """One sensor of a device, of some `kind` ("force_torque", "imu", "tilt", "analog"; open to others).

    `signs` turn its axes; `matrix` makes engineering units of its raw axes. Both are identities where absent.
    """

    name: str
    device: Name
    kind: Name
    model: Text | None = None  # its maker's name for it
    channel: Count | None = None
    signs: Signs | None = None
    matrix: Matrix | None = None
    aliases: Names = ()
    active: Flag = True
    doc: Text | None = None
    source: Text | None = None


class KalmanConfig(msgspec.Struct, frozen=True, kw_only=True):
    """A Kalman filter as a state's estimator; see `aces_bus.state.Kalman` for the units of both numbers."""

    measurement_std: Ratio
    process_density: Ratio
    model: Annotated[
        Literal["velocity", "acceleration"], Meta(description='"velocity" or "acceleration"')
    ] = "velocity"


class StateConfig(msgspec.Struct, frozen=True, kw_only=True):
    """What is kept and estimated of one state: `name` is a controller's name for it, "RHP", an alias or "RHP.velocity".

    `estimator` continues a line ("velocity"), a parabola ("acceleration") or the last value ("hold") beyond the samples;
    `period_s` is how often its device is asked for it, `history` how many samples are kept, `history_s` for how long.
    """

    name: str
    estimator: (
        Annotated[
            Literal["hold", "velocity", "acceleration"],
            Meta(description='"hold", "velocity" or "acceleration" (or a table kalman)'),
        ]
        | None
    ) = None
    kalman: KalmanConfig | None = None
    interpolation: (
        Annotated[
            Literal["hold", "linear", "cubic"] | Annotated[int, Meta(ge=0, le=9)],
            Meta(description='"hold", "linear", "cubic" or an order from 0 to 9'),
        ]
        | None
    ) = None
    history: Positive | None = None
    history_s: Seconds | None = None
    period_s: Seconds | None = None
    stale_after_s: Seconds | None = None
    doc: Text | None = None
    source: Text | None = None


class ControllerConfig(msgspec.Struct, frozen=True, kw_only=True):
    """Rate and priority of a controller or logger, by its name, instead of its own."""

    name: str
    rate_hz: Hertz | None = None
    priority: Priority | None = None
    doc: Text | None = None
    source: Text | None = None


class Robot(msgspec.Struct, frozen=True, kw_only=True):
    """A whole robot. Mappings keep the file's order; it is the order of joints in trajectories and tables."""

    name: Name
    doc: Text | None = None
    source: Text | None = None
    rate_hz: Hertz | None = None
    body: Text | None = None  # its kinematics: the name of an installed body, or a file
    physics: Text | None = None  # what its twins' motors move: NAME or NAME:FILE
    buses: Mapping[str, Bus]
    devices: Mapping[str, DeviceConfig]
    joints: Mapping[str, Joint]
    sensors: Mapping[str, Sensor]
    reactions: Annotated[
        Mapping[str, str],
        Meta(
            description='a table of what faults lead to, such as { silent = "hold", "alarm@FT_RF" = "degrade" }'
        ),
    ] = {}
    states: Mapping[str, StateConfig] = msgspec.field(default_factory=dict[str, StateConfig])
    controllers: Mapping[str, ControllerConfig] = msgspec.field(default_factory=dict[str, ControllerConfig])
    estop: Mapping[str, Input] = msgspec.field(default_factory=dict[str, Input])
    reduced: Reduced | None = None
    park: Park | None = None

    def __repr__(self) -> str:
        counts = {"bus": self.buses, "device": self.devices, "joint": self.joints, "sensor": self.sensors}
        there = (f"{len(of)} {what}{'es' if what == 'bus' else 's'}" for what, of in counts.items())
        return f"<robot {self.name}: {', '.join(there)}>"

    def _repr_html_(self) -> str:
        from ..plain_text import html_table

        def told(*limits: float | None) -> str:
            return " … ".join("" if limit is None else f"{limit:.4g}" for limit in limits)

        rows = [
            [joint.name, joint.device, joint.command, told(joint.lower, joint.upper), told(joint.max_speed)]
            for joint in self.joints.values()
        ]
        rows += [[sensor.name, sensor.device, sensor.kind, "", ""] for sensor in self.sensors.values()]
        head = ["joint or sensor", "device", "", "from … to (rad, m)", "fastest (per s)"]
        return html_table(f"{self.name}: {self.doc or ''}".rstrip(": "), head, rows)

    def joint(self, name: str) -> Joint:
        """Return the joint of this name or alias; raises `UnknownNameError`."""
        found = self.joints.get(name) or next((j for j in self.joints.values() if name in j.aliases), None)
        if found is None:
            raise UnknownNameError(f"joint of {self.name}", name, self.joints)
        return found

    def joints_of(self, device: str) -> tuple[Joint, ...]:
        """Return the joints of a device, by channel."""
        return tuple(sorted((j for j in self.joints.values() if j.device == device), key=lambda j: j.channel))

    def sensors_of(self, device: str) -> tuple[Sensor, ...]:
        """Return the sensors of a device."""
        return tuple(sensor for sensor in self.sensors.values() if sensor.device == device)

    @property
    def inputs(self) -> dict[tuple[str, ...], Input]:
        """All inputs that allow motion, by their place in the file: of e-stops, brakes and the reduced speed."""
        found: dict[tuple[str, ...], Input] = {("estop", name): entry for name, entry in self.estop.items()}
        for name, joint in self.joints.items():
            if joint.brake is not None and joint.active:
                found["joints", name, "brake"] = joint.brake
        if self.reduced is not None and self.reduced.input is not None:
            found["reduced", "input"] = self.reduced.input
        return found

    def input_device(self, name: str) -> str:
        """Return the device that gives a signal of this name; "" where no device, joint or sensor is called so."""
        owner = name.partition(".")[0]
        parts: tuple[Joint | Sensor, ...] = (*self.joints.values(), *self.sensors.values())
        found = next((part.device for part in parts if owner == part.name or owner in part.aliases), owner)
        return found if found in self.devices else ""

    def devices_on(self, bus: str) -> tuple[DeviceConfig, ...]:
        """Return the devices of a bus."""
        return tuple(device for device in self.devices.values() if device.bus == bus)

    def part(self, *names: str) -> Robot:
        """Return the robot with nothing active but these: names of buses, devices, joints (with their whole board) or
        sensors.

        What is inactive in the file stays so. Raises `UnknownNameError`.
        """
        there: set[str] = set()
        parts: tuple[Joint | Sensor, ...] = (*self.joints.values(), *self.sensors.values())
        for name in names:
            if name in self.buses:
                there |= {device.name for device in self.devices_on(name)}
                continue
            of = {part.device for part in parts if name == part.name or name in part.aliases}
            if name not in self.devices and not of:
                known = (*self.buses, *self.devices, *self.joints, *self.sensors)
                raise UnknownNameError(f"bus, device, joint or sensor of {self.name}", name, known)
            there |= of or {name}
        there |= _watched(self, there)
        replace = msgspec.structs.replace
        return replace(
            self,
            devices={
                k: replace(device, active=device.active and k in there) for k, device in self.devices.items()
            },
            joints={
                k: replace(joint, active=joint.active and joint.device in there)
                for k, joint in self.joints.items()
            },
            sensors={
                k: replace(sensor, active=sensor.active and sensor.device in there)
                for k, sensor in self.sensors.items()
            },
        )

    def protocol_of(self, device: DeviceConfig) -> tuple[str, str | None]:
        """Return protocol and dialect (None: the protocol's default) that a device speaks."""
        bus = self.buses[device.bus]
        if device.protocol is None or device.protocol == bus.protocol:
            return bus.protocol, device.dialect if device.dialect is not None else bus.dialect
        return device.protocol, device.dialect

    @property
    def protocols(self) -> dict[str, tuple[str | None, ...]]:
        """The protocols that its buses and devices speak, each with the dialects that are named for it."""
        spoken = [(bus.protocol, bus.dialect) for bus in self.buses.values()]
        spoken += [self.protocol_of(device) for device in self.devices.values()]
        found: dict[str, list[str | None]] = {}
        for protocol, dialect in spoken:
            known = found.setdefault(protocol, [])
            if dialect not in known:
                known.append(dialect)
        return {protocol: tuple(dialects) for protocol, dialects in found.items()}

    def dialect(self, protocol: str) -> str | None:
        """Return the dialect of a protocol on this robot; None: its default. Raises `CallerError` where there are
        several.
        """
        dialects = self.protocols.get(protocol, (None,))
        if len(dialects) > 1:
            named = ", ".join(dialect or "the default" for dialect in dialects)
            raise CallerError(f"{self.name} speaks {protocol} in several dialects ({named}); name one")
        return next(iter(dialects), None)

    def tables(self, protocol: Protocol) -> dict[str, dict[int, int | str]]:
        """Return the configuration tables of a protocol, as `protocol.variant(dialect, tables)` takes them.

        Each device that has a table's number among its credentials gives one entry: its `kind`, or its number of
        channels. Inactive devices too: what they send can be decoded. Raises `CallerError` when no bus speaks the protocol.
        """
        if protocol.name not in self.protocols:
            raise CallerError(
                f"robot {self.name} has nothing that speaks {protocol.name} (it speaks: {', '.join(self.protocols)})"
            )
        found: dict[str, dict[int, int | str]] = {table: {} for table, _ in tables_of(protocol)}
        for _, table, number, entry in self.entries(protocol):
            found[table][number] = entry
        return found

    def entries(self, protocol: Protocol) -> Iterator[tuple[DeviceConfig, str, int, int | str]]:
        """Yield device, table, number and entry of all that the devices say in a protocol's configuration tables."""
        tables = tables_of(protocol)
        for device in self.devices.values():
            if self.protocol_of(device)[0] != protocol.name:
                continue
            for table, credential in tables:
                number = device.credentials.get(credential)
                kind = device.kind.get(table) if isinstance(device.kind, dict) else device.kind
                entry = device.channels if kind is None else kind
                if number is not None and entry is not None:
                    yield device, table, number, entry


def _watched(robot: Robot, devices: Collection[str]) -> set[str]:
    """Return the devices that give the inputs without which these devices are not enabled."""
    found: set[str] = set()
    for (section, name, *_), entry in robot.inputs.items():
        if section == "joints" and robot.joints[name].device not in devices:
            continue
        if entry.signal is not None:
            found.add(robot.input_device(entry.signal))
        elif entry.bus is not None:  # its bus is there as long as one of its devices is
            on_bus = [device.name for device in robot.devices_on(entry.bus) if device.active]
            found.update(on_bus[:0] if found.union(devices).intersection(on_bus) else on_bus[:1])
    return found - {""}


def tables_of(protocol: Protocol) -> list[tuple[str, str]]:
    """Return the configuration tables that a protocol's messages depend on, each with the field that it maps."""
    found = {(condition.key, condition.capture): None for m in protocol.declared for condition in m.when}
    return list(found)


def alone(robot: Robot, name: str) -> Robot:
    """Return the robot with this device only: nothing is sent to others, but to those that give its e-stop inputs.

    Raises `UnknownNameError`.
    """
    if name not in robot.devices:
        raise UnknownNameError(f"device of {robot.name}", name, robot.devices)
    there = {name} | _watched(robot, {name})
    devices = {n: replace(c, active=c.active and n in there) for n, c in robot.devices.items()}
    return replace(robot, devices=devices)
