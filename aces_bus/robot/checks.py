"""What is wrong with a robot although each of its keys is right alone: names, duplicates, numbers that cannot be.

1. Each check looks at all entries and adds to the list; none stops another.
2. What is not installed here (a driver, a protocol) is a warning: the file may be right on another machine. A name near
   an installed one is an error: it is a slip.
3. A number that is possible but looks like another unit's is a warning.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Collection, Mapping
from itertools import islice
from typing import Final, NamedTuple, get_args
from typing import Protocol as Interface

import msgspec

from ..controller.reactions import CONTROL_KINDS, WORDS
from ..device.config import Bus, DeviceConfig, Input, Joint, Robot, Sensor
from ..device.drivers import list_drivers
from ..device.events import Kind
from ..errors import AcesError, CallerError, UnknownNameError
from ..hardware.served.address import ServedAddress
from ..kinematics.bodies import BODIES, body_format
from ..protocol import Protocol
from ..protocol.files import list_protocols, load_protocol, python_file
from .keys import KEYS, character_of
from .physics import PHYSICS

#: Where a slip of the pen ends and another name begins (difflib's ratio).
SLIP: Final = 0.8
#: The same where another name may well be there: that of a controller.
NEAR: Final = 0.7
#: More names than are searched and sorted for one complaint.
MANY: Final = 300
#: All kinds of events that reactions may be declared for.
KINDS_OF_FAULTS: Final = tuple(
    kind
    for kind in (*get_args(Kind), *CONTROL_KINDS)
    if kind not in ("estop", "stop asked")  # they stop, whatever is declared
)


class Complain(Interface):
    """Takes a complaint about a key."""

    def __call__(self, path: tuple[str, ...], text: str, is_warning: bool = False) -> None: ...


def check(robot: Robot, written: Mapping[str, set[str]], complain: Complain) -> None:
    """Complain about all that is wrong between the entries.

    `written` has the names of all entries in the file, also of those too wrong to be in `robot`.
    """
    protocols = _check_buses(robot, complain)
    _check_devices(robot, written, protocols, complain)
    _check_joints(robot, written, complain)
    _check_sensors(robot, written, complain)
    _check_names(robot, complain)
    _check_reactions(robot, complain)
    _check_states(robot, complain)
    _check_rates(robot, complain)
    _check_body(robot, complain)
    for path, entry in robot.inputs.items():
        _check_input(path, entry, robot, protocols, complain)
    _check_reduced(robot, complain)
    _check_park(robot, complain)
    if robot.rate_hz is not None and robot.rate_hz > 20_000:
        complain(("rate_hz",), f"{robot.rate_hz:g} Hz is beyond what a bus can carry", True)


def _check_body(robot: Robot, complain: Complain) -> None:
    if robot.physics is not None:
        name = robot.physics.partition(":")[0]
        _check_installed(("physics",), "physics", name, PHYSICS.points(), complain)
    if robot.body is not None and body_format(robot.body) is None:
        _check_installed(("body",), "body", robot.body, BODIES.points(), complain)


# ---------------------------------------------------------------------- names


def near(name: str, known: Collection[str], cutoff: float = 0.6, many: int = MANY) -> str:
    """Return `; did you mean 'x'?`, or nothing. Very many names are not searched: that would take minutes."""
    if len(name) > 100 or len(known) > many:
        return ""
    found = difflib.get_close_matches(name, list(known), n=1, cutoff=cutoff)
    return f"; did you mean {found[0]!r}?" if found else ""


def _listed(known: Collection[str]) -> str:
    names = sorted(known) if len(known) <= MANY else list(islice(known, 13))
    return ", ".join(names[:12]) + (", …" if len(names) > 12 else "") if names else "none"


def _check_reference(
    path: tuple[str, ...], what: str, name: str, known: Collection[str], complain: Complain
) -> None:
    if name not in known:
        complain(path, f"no {what} named {name!r}{near(name, known)} (there are: {_listed(known)})")


def _check_installed(
    path: tuple[str, ...], what: str, name: str, known: Collection[str], complain: Complain
) -> None:
    """Complain when what an entry names is not installed."""
    if name in known:
        return
    slip = near(name, known, SLIP)
    if slip:
        complain(path, f"no {what} named {name!r}{slip} (installed: {_listed(known)})")
    else:
        complain(path, f"{what} {name!r} is not installed (installed: {_listed(known)})", True)


def _check_driver(path: tuple[str, ...], name: str, complain: Complain) -> None:
    """Complain when a driver is not installed. A known one is not searched for again: that takes milliseconds."""
    if name not in _drivers:
        _drivers.update(list_drivers())
        _check_installed(path, "driver", name, _drivers, complain)


_drivers: set[str] = set()


def _check_reactions(robot: Robot, complain: Complain) -> None:
    """Check reactions; functions and controllers of the program that runs are not known here."""
    for key, word in robot.reactions.items():
        path = ("reactions", key)
        kind, _, sources = key.partition("@")
        _check_reference(path, "kind of fault", kind, (*KINDS_OF_FAULTS, "*"), complain)
        if word == "park" and robot.park is None:
            complain(
                path, "the file names no pose to park in: park = { pose = { JOINT = 0.0 }, speed = 0.2 }"
            )
        known = (*robot.buses, *robot.devices)
        for source in sources.split(",") if sources else ():
            slip = "" if source.strip() in known else near(source.strip(), known, NEAR)
            if slip:
                complain(path, f"no bus or device named {source.strip()!r}{slip}")
        if word not in WORDS and not word.startswith("degrade:") and not word.isidentifier():
            complain(
                path,
                f"{word!r} is not a reaction (there are: {', '.join(WORDS)}, degrade:NAME, a function's name)",
            )


# ---------------------------------------------------------------------- buses


class _Spoken:
    """The installed protocols that a robot names, loaded once."""

    def __init__(self, complain: Complain) -> None:
        self._complain = complain
        self._loaded: dict[str, Protocol | None] = {}
        #: Of each protocol, the fields that identify a device.
        self.addresses: dict[str, dict[str, AddressRange]] = {}

    def get(self, name: str, path: tuple[str, ...]) -> Protocol | None:
        """Return the protocol, or None; what is wrong with it is said at the first place that names it."""
        if name not in self._loaded:
            self._loaded[name] = None
            if python_file(name)[0]:  # not run: said where the file was read
                return None
            try:
                self._loaded[name] = protocol = load_protocol(name)
                self.addresses[name] = addresses(protocol)
            except UnknownNameError:
                _check_installed(path, "protocol", name, list_protocols(), self._complain)
            except AcesError as error:
                self._complain(path, f"protocol {name!r} cannot be used: {error}", True)
        return self._loaded[name]


def _check_buses(robot: Robot, complain: Complain) -> _Spoken:
    protocols = _Spoken(complain)
    channels: dict[tuple[str, str], str] = {}
    for name, bus in robot.buses.items():
        path = ("buses", name)
        protocol = protocols.get(bus.protocol, (*path, "protocol"))
        if protocol is not None:
            if protocol.link != bus.link:
                complain((*path, "link"), f"{bus.protocol} is spoken on {protocol.link}, not on {bus.link}")
            _check_dialect((*path, "dialect"), protocol, bus.dialect, complain)
        for key, value, link in (
            ("bitrate", bus.bitrate, "can"),
            ("data_bitrate", bus.data_bitrate, "can"),
            ("baud", bus.baud, "serial"),
        ):
            if value is None:
                continue
            if bus.link != link:
                complain((*path, key), f"belongs to link = {link!r}; this bus has link = {bus.link!r}")
            elif key == "bitrate" and not 5_000 <= value <= 1_000_000:
                complain((*path, key), f"{value} bit/s is not a bit rate of CAN; 1 Mbit/s is 1_000_000", True)
            elif key == "data_bitrate" and protocol is not None and not protocol.has_fd:
                complain((*path, key), f"belongs to CAN FD, which {bus.protocol} does not use")
            elif key == "data_bitrate" and not (bus.bitrate or 0) <= value <= 8_000_000:
                complain(
                    (*path, key), f"{value} bit/s is not a data rate of CAN FD; 5 Mbit/s is 5_000_000", True
                )
            elif key == "baud" and value < 50:
                complain((*path, key), f"{value} baud is slower than any line; 1 Mbaud is 1_000_000", True)
        if bus.allow is not None:
            _check_allowed((*path, "allow"), bus, complain)
        if bus.channel is not None:
            _check_served((*path, "channel"), bus, complain)
            if (other := channels.setdefault((bus.link, bus.channel), name)) != name:
                complain((*path, "channel"), f"{bus.channel!r} is the channel of bus {other} already")
    return protocols


def _check_served(path: tuple[str, ...], bus: Bus, complain: Complain) -> None:
    """Complain about an address of a served bus that cannot be one, or stands where no served bus can be joined."""
    if bus.link != "can" or not ServedAddress.is_served(bus.channel):
        return
    if bus.interface not in (None, "aces"):
        complain(path, f"{bus.channel!r} is the address of a served bus; that is interface = 'aces', or none")
        return
    try:
        ServedAddress.parse(str(bus.channel))
    except CallerError as error:
        complain(path, str(error))


def _check_allowed(path: tuple[str, ...], bus: Bus, complain: Complain) -> None:
    from ..recordings.filters import parse_filter

    if bus.link != "can":
        complain(path, f"belongs to link = 'can'; this bus has link = {bus.link!r}")
        return
    try:
        allowed = parse_filter(*bus.allow or ())
    except CallerError as error:
        complain(path, str(error))
        return
    for text, entry in zip(allowed.texts, allowed.sets, strict=True):
        if entry.interface is not None:
            complain(path, f'{text!r}: expected id:mask, such as "010:7F0", without an interface in front')


def _check_dialect(
    path: tuple[str, ...], protocol: Protocol, dialect: str | None, complain: Complain
) -> None:
    if dialect is not None:
        _check_reference(path, f"dialect of {protocol.name}", dialect, protocol.dialects, complain)


# ---------------------------------------------------------------------- devices


def _check_devices(
    robot: Robot, written: Mapping[str, set[str]], protocols: _Spoken, complain: Complain
) -> None:
    warned: set[str] = set()
    claimed: dict[tuple[str, str, str, int], DeviceConfig] = {}
    alone: dict[tuple[str, str], DeviceConfig] = {}
    for name, device in robot.devices.items():
        path = ("devices", name)
        if device.driver not in warned:
            warned.add(device.driver)
            _check_driver((*path, "driver"), device.driver, complain)
        _check_reference((*path, "bus"), "bus", device.bus, written["buses"], complain)
        if device.bus not in robot.buses:
            continue
        spoken, dialect = robot.protocol_of(device)
        protocol = protocols.get(spoken, (*path, "protocol"))
        if protocol is not None:
            if device.protocol is not None and protocol.link != robot.buses[device.bus].link:
                complain(
                    (*path, "protocol"), f"{spoken} is spoken on {protocol.link}, not on this device's bus"
                )
            if device.dialect is not None:
                _check_dialect((*path, "dialect"), protocol, dialect, complain)
            _check_credentials(path, device, spoken, protocols.addresses[spoken], complain)
        if not device.credentials:
            if (other := alone.setdefault((device.bus, spoken), device)) is not device:
                complain(
                    (*path, "credentials"),
                    f"nothing tells it from device {other.name}, which speaks {spoken} on bus {device.bus} too",
                )
        for key, number in device.credentials.items():
            if (other := claimed.setdefault((device.bus, spoken, key, number), device)) is not device:
                # Credentials may refine one another, as the axis of a node does.
                shared = device.credentials.keys() & other.credentials.keys()
                is_other = any(device.credentials[name] != other.credentials[name] for name in shared)
                complain(
                    (*path, "credentials", key),
                    f"{key} {number:#04x} on bus {device.bus} is device {other.name} already: two devices would answer",
                    is_other,
                )
    whole = {name: device for name, device in robot.devices.items() if device.bus in robot.buses}
    robot = msgspec.structs.replace(robot, devices=whole)
    for spoken in robot.protocols:
        if (protocol := protocols.get(spoken, ())) is not None:
            _check_tables(robot, protocol, complain)


def _check_credentials(
    path: tuple[str, ...],
    device: DeviceConfig,
    protocol: str,
    known: Mapping[str, AddressRange],
    complain: Complain,
) -> None:
    if known and not device.credentials:
        complain(
            (*path, "credentials"),
            f"is missing: expected what identifies it on the bus, such as {{ {next(iter(known))} = 0x20 }}",
        )
    _check_numbers_of(path, device.credentials, protocol, known, complain)


def _check_numbers_of(
    path: tuple[str, ...],
    credentials: Mapping[str, int],
    protocol: str,
    known: Mapping[str, AddressRange],
    complain: Complain,
) -> None:
    for key, number in credentials.items():
        at = (*path, "credentials", key)
        if key not in known:
            complain(at, f"{protocol} has no field {key!r}{near(key, known)} (there are: {_listed(known)})")
        elif not known[key].holds(number):
            complain(at, f"{protocol} has no {key} {number:#04x} ({known[key]})")


class AddressRange(NamedTuple):
    """The numbers that a field which identifies a device may have: those of its captures, else all of its bytes."""

    captured: frozenset[int]
    largest: int
    broadcast: int | None

    def holds(self, number: int) -> bool:
        if number == self.broadcast:
            return False
        return number in self.captured if self.captured else number <= self.largest

    def __str__(self) -> str:
        low, high = (min(self.captured), max(self.captured)) if self.captured else (0, self.largest)
        everybody = f"; {self.broadcast:#04x} is everybody" if self.broadcast is not None else ""
        return f"{low:#04x}…{high:#04x}{everybody}"


def addresses(protocol: Protocol) -> dict[str, AddressRange]:
    """Return the fields of a protocol by which a device can be identified: captures, and fields of a packet's head."""
    captured: dict[str, set[int]] = {}
    largest: dict[str, int] = {}
    for message in protocol.declared:
        captures = list(message.identifier.captures)
        for head in message.heads:
            if head.pattern is not None:
                captures += head.pattern.captures
            elif head.name is not None and not head.is_text:  # letters are no device's number
                largest[head.name] = max(largest.get(head.name, 0), (1 << 8 * head.size) - 1)
        for capture in captures:
            captured.setdefault(capture.name, set()).update(capture.values)
    return {
        name: AddressRange(
            frozenset(captured.get(name, ())), largest.get(name, 0), protocol.broadcast.get(name)
        )
        for name in {**captured, **largest}
    }


def _check_tables(robot: Robot, protocol: Protocol, complain: Complain) -> None:
    """Check that a configuration table has one entry a number on all buses, and only entries that messages know."""
    entries: dict[tuple[str, int], tuple[DeviceConfig, int | str]] = {}
    known: dict[str, set[int | str]] = {}
    for tables in protocol.configurations.values():
        for table, shipped in tables.items():
            known.setdefault(table, set()).update(shipped.values())
    for message in protocol.declared:
        for condition in message.when:
            known.setdefault(condition.key, set()).update(condition.values)
    for device, table, number, entry in robot.entries(protocol):
        key = "channels" if device.kind is None else "kind"
        other, kind = entries.setdefault((table, number), (device, entry))
        if kind != entry:
            complain(
                ("devices", device.name, key),
                f"{number:#04x} is {entry!r} here and {kind!r} as {other.name}: {protocol.name} has one table of {table}",
            )
        if entry not in known.get(table, {entry}):
            names = ", ".join(sorted(map(repr, known[table])))
            complain(
                ("devices", device.name, key),
                f"{protocol.name} has no {table} {entry!r} (there are: {names})",
            )


# ---------------------------------------------------------------------- joints and sensors


def _check_joints(robot: Robot, written: Mapping[str, set[str]], complain: Complain) -> None:
    claimed: dict[tuple[str, int], str] = {}
    for name, joint in robot.joints.items():
        path = ("joints", name)
        _check_reference((*path, "device"), "device", joint.device, written["devices"], complain)
        device = robot.devices.get(joint.device)
        if joint.active:
            if (other := claimed.setdefault((joint.device, joint.channel), name)) != name:
                complain(
                    (*path, "channel"), f"channel {joint.channel} of {joint.device} is joint {other} already"
                )
            if device is not None and device.channels is not None and joint.channel >= device.channels:
                last = f"0…{device.channels - 1}" if device.channels else "none"
                complain(
                    (*path, "channel"), f"{joint.device} has no channel {joint.channel} (it has: {last})"
                )
        _check_numbers(path, joint, complain)


#: Key → what is plausible, and what a number beyond it looks like.
PLAUSIBLE: Final[Mapping[str, tuple[float, str]]] = {
    "zero": (12.6, "degrees; this is rad"),
    "lower": (12.6, "degrees; this is rad"),
    "upper": (12.6, "degrees; this is rad"),
    "nominal_speed": (100, "degrees a second; this is rad/s"),
    "max_speed": (100, "degrees a second; this is rad/s"),
    "max_current": (500, "mA; this is A"),
}


def _check_numbers(path: tuple[str, ...], joint: Joint, complain: Complain) -> None:
    for low, high in (
        ("lower", "upper"),
        ("nominal_speed", "max_speed"),
        ("nominal_acceleration", "max_acceleration"),
    ):
        one, other = getattr(joint, low), getattr(joint, high)
        if one is not None and other is not None and (one > other or (low == "lower" and one == other)):
            complain((*path, low), f"{one:g} is not below {high} = {other:g}")
    home = joint.home
    if home is not None and home.lower is not None and home.upper is not None and home.lower >= home.upper:
        complain((*path, "home", "lower"), f"{home.lower} is not below upper = {home.upper}")
    for key in ("lower", "upper"):
        if joint.type == "continuous" and getattr(joint, key) is not None:
            complain((*path, key), "a continuous joint turns without end, and has no limits")
    if joint.type != "prismatic":
        for key, (most, looks) in PLAUSIBLE.items():
            value = getattr(joint, key)
            if value is not None and abs(value) > most:
                complain((*path, key), f"{value:g} looks like {looks}", True)
    if joint.gear is not None and not 1e-4 <= joint.gear[1] / joint.gear[0] <= 1e4:
        complain((*path, "gear"), f"a gear of {joint.gear[0]:g} to {joint.gear[1]:g} teeth is none", True)
    if joint.encoder is not None and joint.encoder > 2**26:
        complain((*path, "encoder"), f"{joint.encoder} counts a turn are more than encoders have", True)


def _check_sensors(robot: Robot, written: Mapping[str, set[str]], complain: Complain) -> None:
    claimed: dict[tuple[str, str, int | None], str] = {}
    for name, sensor in robot.sensors.items():
        path = ("sensors", name)
        _check_reference((*path, "device"), "device", sensor.device, written["devices"], complain)
        if sensor.active:
            if (other := claimed.setdefault((sensor.device, sensor.kind, sensor.channel), name)) != name:
                complain((*path, "device"), f"the {sensor.kind} of {sensor.device} is sensor {other} already")
        if sensor.matrix is not None:
            sizes = {len(row) for row in sensor.matrix}
            if len(sizes) != 1 or 0 in sizes:
                complain((*path, "matrix"), "rows of a matrix are all of one length")
            elif sensor.signs is not None and len(sensor.signs) != len(sensor.matrix):
                complain(
                    (*path, "signs"), f"{len(sensor.signs)} signs for {len(sensor.matrix)} rows of matrix"
                )


def _check_states(robot: Robot, complain: Complain) -> None:
    """Check that a state belongs to a joint, sensor or device, and that each of its quantities is declared once."""
    parts: dict[str, Joint | Sensor] = {**robot.sensors, **robot.joints}
    owners = {alias: name for name, part in parts.items() for alias in part.aliases}
    owners |= {name: name for name in (*robot.devices, *parts)}
    declared: dict[str, str] = {}
    for name, state in robot.states.items():
        path = ("states", name)
        owner, _, rest = name.partition(".")
        _check_reference(path, "joint, sensor or device", owner, owners, complain)
        whole = f"{owners.get(owner, owner)}.{rest or 'position'}"
        if (other := declared.setdefault(whole, name)) != name:
            complain(path, f"is the state {other}, which is declared already")
        for first, second in (("estimator", "kalman"), ("history", "history_s")):
            if getattr(state, first) is not None and getattr(state, second) is not None:
                complain((*path, second), f"the state has {first} too; give {first} or {second}")


def _check_input(
    path: tuple[str, ...], entry: Input, robot: Robot, protocols: _Spoken, complain: Complain
) -> None:
    """Check that an input is of one of three kinds, exists, is in use, and says which value is clear."""
    kinds = [name for name in ("signal", "message", "key") if getattr(entry, name) is not None]
    if len(kinds) != 1:
        complain(path, f"expected one of signal, message and key, not {' and '.join(kinds) or 'none'}")
        return
    if entry.key is not None:
        _check_key(path, entry, complain)
        return
    if (entry.clear is None) == (entry.pressed is None):
        complain(
            path, "expected clear (the value at which nothing stands in the way) or pressed, one of both"
        )
    stated = entry.pressed if entry.clear is None else entry.clear
    if entry.bit is not None and stated not in (None, 0, 1):
        complain((*path, "clear" if entry.pressed is None else "pressed"), f"a bit is 0 or 1, not {stated!r}")
    if isinstance(stated, float) and not stated.is_integer():
        complain(path, f"{stated!r}: a number that is measured is seldom equal to one that is written", True)
    if entry.stale_after_s > 1:
        complain(
            (*path, "stale_after_s"), f"{entry.stale_after_s:g} s: so late a lost input is noticed", True
        )
    if entry.signal is not None:
        for key in ("bus", "protocol"):
            if getattr(entry, key) is not None:
                complain((*path, key), "belongs to message; a signal's device is on a bus")
        name = robot.input_device(entry.signal)
        owner, _, rest = entry.signal.partition(".")
        known = (*robot.devices, *robot.joints, *robot.sensors)
        if not name:
            _check_reference((*path, "signal"), "device, joint or sensor", owner, known, complain)
        elif not robot.devices[name].active:
            complain((*path, "signal"), f"{name} is inactive: this input would always count as pressed")
        if not rest and owner not in robot.joints:
            complain(
                (*path, "signal"), f"{entry.signal!r} is a device; expected one of its signals, DEVICE.SIGNAL"
            )
    else:
        _check_input_message(path, entry, robot, protocols, complain)


def _check_key(path: tuple[str, ...], entry: Input, complain: Complain) -> None:
    for name in ("bus", "protocol", "bit", "pressed"):
        if getattr(entry, name) is not None:
            complain((*path, name), "belongs to a signal or message; a key has key and clear")
    known = f"a character, {', '.join(KEYS)}"
    if character_of(entry.key or "") is None:
        complain((*path, "key"), f"no key {entry.key!r} (there are: {known})")
    if not isinstance(entry.clear, str) or character_of(entry.clear) is None:
        complain((*path, "clear"), f"expected the key that clears it again: {known}")
    elif character_of(entry.clear) == character_of(entry.key or ""):
        complain((*path, "clear"), f"{entry.clear!r} is the key that is pressed already")


def _check_input_message(
    path: tuple[str, ...], entry: Input, robot: Robot, protocols: _Spoken, complain: Complain
) -> None:
    """Check that message and field are the protocol's, and that credentials name the sender where several
    could send.
    """
    if entry.bus is None:
        complain((*path, "bus"), "is missing: expected the name of the bus that the message is on")
        return
    _check_reference((*path, "bus"), "bus", entry.bus, robot.buses, complain)
    if entry.bus not in robot.buses:
        return
    spoken = entry.protocol or robot.buses[entry.bus].protocol
    if not any(
        device.active and robot.protocol_of(device)[0] == spoken for device in robot.devices_on(entry.bus)
    ):
        complain(
            (*path, "bus"), f"no active device of bus {entry.bus} speaks {spoken}: nothing would be received"
        )
    protocol = protocols.get(spoken, (*path, "protocol" if entry.protocol else "bus"))
    if protocol is None:
        return
    name, _, field = str(entry.message).partition(".")
    messages = {message.name: message for message in protocol.declared}
    _check_reference((*path, "message"), f"message of {spoken}", name, messages, complain)
    if name not in messages:
        return
    if not field:
        complain((*path, "message"), f"{name!r} is a message; expected one of its fields, {name}.FIELD")
    captured = {capture.name for capture in messages[name].identifier.captures}
    for key in sorted(captured - entry.credentials.keys()):
        complain((*path, "credentials"), f"expected whose message it is: {{ {key} = 0x01 }}")
    _check_numbers_of(path, entry.credentials, spoken, protocols.addresses[spoken], complain)


def _check_park(robot: Robot, complain: Complain) -> None:
    """Check that a pose is of joints commanded by position, within their limits."""
    for name, angle in () if robot.park is None else robot.park.pose.items():
        path, joint = ("park", "pose", name), robot.joints.get(name)
        if joint is None:
            _check_reference(path, "joint", name, robot.joints, complain)
        elif joint.command != "position":
            complain(path, f"{name} is commanded by {joint.command}: it has no position to go to")
        elif (
            not (-math.inf if joint.lower is None else joint.lower)
            <= angle
            <= (math.inf if joint.upper is None else joint.upper)
        ):
            complain(path, f"{angle:g} is beyond the limits of {name}")


def _check_reduced(robot: Robot, complain: Complain) -> None:
    """Check that each joint of a reduced mode has a limit of speed to reduce."""
    if robot.reduced is None:
        return
    free = [
        name
        for name, joint in robot.joints.items()
        if joint.active
        and joint.command != "position"
        and joint.max_speed is None
        and joint.nominal_speed is None
    ]
    if free:
        complain(("reduced",), f"has no effect on {_listed(free)}: no max_speed is stated", True)


def _check_rates(robot: Robot, complain: Complain) -> None:
    """Check that no device is to be polled more often than its bus has ticks."""
    for name, device in robot.devices.items():
        bus = robot.buses.get(device.bus)
        tick = (bus.rate_hz if bus is not None else None) or robot.rate_hz
        if device.rate_hz is not None and tick is not None and device.rate_hz > tick:
            complain(
                ("devices", name, "rate_hz"),
                f"{device.rate_hz:g} Hz is more often than its bus ticks ({tick:g} Hz): rate_hz of bus {device.bus}",
            )


def _check_names(robot: Robot, complain: Complain) -> None:
    """Check that the robot's name can be printed, and that each name or alias means one joint or one sensor."""
    if not robot.name.isprintable():
        complain(("name",), "a name has no control characters")
    entries: tuple[tuple[str, Mapping[str, tuple[str, ...]]], ...] = (
        ("joints", {name: joint.aliases for name, joint in robot.joints.items()}),
        ("sensors", {name: sensor.aliases for name, sensor in robot.sensors.items()}),
    )
    for section, names in entries:
        owner = {name: name for name in names}
        for name, aliases in names.items():
            for alias in aliases:
                other = owner.setdefault(alias, name)
                if other != name or alias == name:
                    complain((section, name, "aliases"), f"{alias!r} is {section[:-1]} {other} already")
