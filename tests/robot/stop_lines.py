"""Three devices of one kind that move, on serial lines in virtual time, and what lines do to them: for drawn schedules."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cache, partial
from math import radians
from random import Random
from typing import Any, NamedTuple

from aces_bus.controller import Controller
from aces_bus.controller.reactions import Reaction
from aces_bus.device import Robot
from aces_bus.errors import DeviceError
from aces_bus.hardware import Noise
from aces_bus.robot import Ended, Runner, parse_robot, run_virtual
from aces_bus.robot.checks import KINDS_OF_FAULTS
from aces_bus.robot.rig import simulate

MS = 1_000_000
NAMES = ("D1", "D2", "D3")
#: Where servos of joints that are commanded by position have their zero (rad).
ZERO = 2.6
#: How far a servo may go on behind its stop: as far as it was from where it was last seen (rad).
BRAKING = 0.6


class Kind(NamedTuple):
    """One kind of device: its devices, and whether a twin still does what it was set to."""

    protocol: str
    driver: str
    settings: tuple[str, str, str]
    is_on: Callable[[Any, float], bool]
    #: Until when healthy devices are confirmed beside a faulty one (ns).
    healthy_ns: int
    baud: int = 1_000_000
    model: str = ""
    joint: str = f"zero = {ZERO}, lower = -1.2, upper = 1.2"
    amplitude: float = 1.0
    #: Each device on a line of its own.
    is_alone: bool = False
    #: Without a check, or without an acknowledgement, what noise makes of a stop may be another command.
    is_checked: bool = True


def goes_on(count: float) -> Callable[[Any, float], bool]:
    """Whether a servo with so many degrees a count goes to anywhere but where it was at its stop."""
    step = radians(count)
    return lambda twin, here: bool(
        twin["torque_enable"] and abs(twin["goal_position"] * step - ZERO - here) > BRAKING
    )


def turns(register: str) -> Callable[[Any, float], bool]:
    """Whether a servo that follows speeds has one."""
    return lambda twin, here: bool(twin["torque_enable"] and twin[register])


SERVO = ("health_s = 0.2", "health_s = 0.2, motion = true", "health_s = 0.2, stop = 'release'")
WHEEL = ("health_s = 0.2", "health_s = 0.2, motion = true", "health_s = 0.2, status_return_level = 1")
READ_ONLY = tuple(f"health_s = 0.2, status_return_level = {level}" for level in (1, 1, 2))
TURNS = 'type = "continuous", command = "{}"'
#: A Modbus drive: two registers of which both stop it.
DRIVE = (
    "every_s = 0.05, timeout_s = 0.05, stop = { go = 0, speed = 0 }, registers = {"
    ' temperature = { address = 10, type = "s16" },'
    ' speed = { address = 11, type = "s16", access = "read-write" },'
    ' go = { address = 3, type = "bit", table = "coil", access = "read-write" } }'
)

KINDS: Mapping[str, Kind] = {
    "dynamixel": Kind("dynamixel", "dynamixel", SERVO, goes_on(0.088), 150 * MS, model="XL430-W250"),
    "dynamixel wheels": Kind(
        "dynamixel",
        "dynamixel",
        WHEEL,
        turns("goal_velocity"),
        150 * MS,
        model="XL430-W250",
        joint=TURNS.format("speed"),
    ),
    "rx": Kind("robotis", "robotis_rx", SERVO, goes_on(0.29), 150 * MS, model="RX-28"),
    "rx that answers reads alone": Kind(
        "robotis",
        "robotis_rx",
        (READ_ONLY[0], READ_ONLY[1], READ_ONLY[2]),
        goes_on(0.29),
        150 * MS,
        model="RX-28",
    ),
    "feetech": Kind("feetech", "feetech", SERVO, goes_on(0.088), 150 * MS, model="STS3215"),
    "feetech wheels": Kind(
        "feetech",
        "feetech",
        WHEEL,
        turns("goal_speed"),
        150 * MS,
        model="STS3215",
        joint=TURNS.format("speed"),
    ),
    "modbus": Kind(
        "modbus",
        "modbus",
        (DRIVE, DRIVE, DRIVE),
        lambda twin, here: bool(twin.take("go") or twin.take("speed")),
        800 * MS,
        baud=115_200,
        joint="",
        amplitude=50.0,
    ),
    "qik": Kind(
        "pololu_qik",
        "pololu_qik",
        (
            "answers = true, timeout_s = 8",
            "answers = true, timeout_s = 8, bits = 8",
            "answers = true, timeout_s = 0",
        ),
        lambda twin, here: any(wheel.duty for wheel in twin.wheels),
        300 * MS,
        baud=38_400,
        joint=TURNS.format("duty"),
        amplitude=60.0,
        is_checked=False,
    ),
    "roboclaw": Kind(
        "roboclaw",
        "roboclaw",
        ("timeout_s = 8", "timeout_s = 8", "timeout_s = 0"),
        lambda twin, here: any(twin.duty.values()),
        300 * MS,
        baud=460_800,
        joint=TURNS.format("duty"),
        amplitude=0.5,
    ),
    "vesc": Kind(
        "vesc_uart",
        "vesc_uart",
        ("", "", 'stop = "brake"'),
        lambda twin, here: bool(twin.model.given and twin.model.mode not in ("free", "brake")),
        150 * MS,
        baud=115_200,
        joint=TURNS.format("speed") + ", max_speed = 30",
        amplitude=8.0,
        is_alone=True,
        is_checked=False,
    ),
}

#: What devices of a protocol are known by, and the number before the first.
CREDENTIALS = {"modbus": ("unit", 0), "roboclaw": ("address", 0x7F)}


@cache
def robot_of(name: str) -> Robot:
    """Three devices of this kind."""
    kind = KINDS[name]
    lines = [
        'name = "line"\nrate_hz = 50\n[buses]\n',
        *(
            f'L{n} = {{ link = "serial", protocol = "{kind.protocol}", baud = {kind.baud} }}\n'
            for n in ((1, 2, 3) if kind.is_alone else (1,))
        ),
        "[devices]\n",
    ]
    for n, settings in enumerate(kind.settings, 1):
        more = f', model = "{kind.model}"' if kind.model else ""
        if not kind.is_alone:
            credential, first = CREDENTIALS.get(kind.protocol, ("id", 0))
            more += f", credentials = {{ {credential} = {first + n} }}"
        bus = f"L{n}" if kind.is_alone else "L1"
        lines.append(
            f'D{n} = {{ driver = "{kind.driver}", bus = "{bus}"{more}, settings = {{ {settings} }} }}\n'
        )
    lines.append("[joints]\n")
    if kind.joint:
        lines += [f'J{n} = {{ device = "D{n}", {kind.joint} }}\n' for n in (1, 2, 3)]
    found, problems = parse_robot("".join(lines))
    assert found is not None, problems
    return found


class Swing(Controller):
    """Has all of them move, to and fro."""

    def __init__(self, kind: Kind) -> None:
        self.kind = kind
        self.names = (
            [f"J{n}" for n in (1, 2, 3)]
            if kind.joint
            else [f"{d}.{r}" for d in NAMES for r in ("speed", "go")]
        )
        super().__init__("swing", rate_hz=50, writes=self.names)

    def step(self, now_ns: int) -> Mapping[str, float]:
        size = self.kind.amplitude if now_ns // (150 * MS) % 2 else -self.kind.amplitude
        if self.kind.joint:
            return dict.fromkeys(self.names, size)
        return {name: size + now_ns // (100 * MS) % 7 if name.endswith("speed") else 1 for name in self.names}


#: An instant (ms), what happens then, to which device or its line, and how much of it.
Act = tuple[int, str, int, Any]


class Stopped(NamedTuple):
    """How a schedule ended: the run, who is still on or may be, as two were seen to answer as one, and when each device was
    confirmed (ns after the first stop).
    """

    ended: Ended
    still_on: set[str]
    took_ns: int
    confirmed_ns: dict[str, int]


class Lines:
    """A run of devices of one kind, and all that can happen to it."""

    def __init__(self, name: str, reactions: Mapping[str, str]) -> None:
        self.kind = KINDS[name]
        self.run: Runner = run_virtual(
            robot_of(name),
            [Swing(self.kind)],
            rate_hz=50,
            reactions=Reaction.parse(reactions, kinds=KINDS_OF_FAULTS),
        )
        self.clock, self.twins = self.run.clock, self.run.world.twins
        self._confirmed: dict[str, int] = {}
        for twin in self.twins.values():
            if "wheels" in name:
                twin["operating_mode"] = 1

    def carry_out(self, what: str, number: int, how: Any) -> None:
        """Let something of a schedule happen."""
        line = "L1" if not self.kind.is_alone else f"L{number}"
        wire: Any = self.run.world.wires[line]
        host: Any = self.run.rig.hosts[line].port
        twin = self.twins[f"D{number}"]
        match what:
            case "noise":
                rates, ms = how
                wire.noise = Noise(seed=number, **rates)
                if ms is not None:
                    self.clock.call_in(ms * MS, partial(setattr, wire, "noise", None))
            case "babble":
                self._babble(wire.attach("babbler", None), Random(how), self.clock.now() + 50 * MS)
            case "second":
                self._second(f"D{number}")
            case "split":
                host.node.whole = False
            case "gathered":
                self._gather(host.node, how * MS)
            case "cable":
                host.node.is_connected = False
                if how is not None:
                    self.clock.call_in(how * MS, partial(setattr, host.node, "is_connected", True))
            case "power":
                twin.power(how)
            case "reboot":
                twin.reboot()
            case _:
                twin.fault(what, how)

    def _babble(self, node: Any, random: Random, until: int) -> None:
        """Bytes without a meaning, some of them the beginnings of packets."""
        size = random.randrange(1, 40)
        end: int = node.send(bytes((0xFF,)) * size if random.random() < 0.3 else random.randbytes(size))
        if end < until:
            self.clock.call_at(end + random.randrange(2 * MS), partial(self._babble, node, random, until))

    def _second(self, name: str) -> None:
        """A second device of this number is plugged in."""
        world = self.run.world
        second = simulate(world.robot, world.ports("second"), seed=1)
        for bus in second.buses.values():
            for other in [one for one in bus.members if one != name]:
                bus.remove(other)
        second.open()

    def _gather(self, node: Any, latency_ns: int) -> None:
        """The host's adapter hands over what it has received every so often, as those at USB do."""
        received, held = node.received, bytearray()

        def hand_over() -> None:
            data = bytes(held)
            held.clear()
            received(data, self.clock.now())

        def hold(data: bytes, instant: int) -> None:
            if not held:
                self.clock.call_in(latency_ns, hand_over)
            held.extend(data)

        node.received = hold

    def stop_after(self, schedule: list[Act], seconds: float) -> Stopped:
        """Let the schedule happen, then stop."""
        run, clock = self.run, self.clock
        run.open()
        with suppress(DeviceError):
            run.do("enable")
        for at_ms, *act in schedule:
            clock.call_in(at_ms * MS, partial(self.carry_out, *act))
        run.start()
        run.world.clock.advance(round(seconds * 1e9))
        began = clock.now()
        joints = next(iter(self.twins.values())).world.joints
        here = {f"D{n}": joints[f"J{n}"].position(began) if f"J{n}" in joints else 0.0 for n in (1, 2, 3)}
        still_on = {name for name, device in run.rig.devices.items() if device.is_double}

        def look() -> None:  # before the twins are switched off
            for name, twin in self.twins.items():
                if twin.is_powered and self.kind.is_on(twin, here[name]):
                    still_on.add(name)
            self._note_confirmed(began)

        run.after.insert(0, look)
        self._watch(began)
        ended = run.stop()
        return Stopped(ended, still_on, clock.now() - began, self._confirmed)

    def _watch(self, began: int) -> None:
        self._note_confirmed(began)
        if len(self._confirmed) < len(NAMES):
            self.clock.call_in(MS, partial(self._watch, began))

    def _note_confirmed(self, began: int) -> None:
        for name, device in self.run.rig.devices.items():
            if not device.is_driven:
                self._confirmed.setdefault(name, self.clock.now() - began)
