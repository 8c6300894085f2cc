"""Drawn schedules of faults and commands, in virtual time: a stop is done, or the run says who has not stopped.

Whatever happens before and meanwhile. And no set-point that a board is sent is beyond its joint's limits; and after an
e-stop nothing that moves or enables is sent until somebody enables anew.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from functools import cache, partial
from math import inf
from typing import Any, Literal

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from aces_bus import load_robot, make_scanner
from aces_bus.controller import ControlEvent, Controller
from aces_bus.controller.reactions import Reaction
from aces_bus.controller.trip import Action
from aces_bus.device import Robot
from aces_bus.device.config import Bus, DeviceConfig, Input
from aces_bus.errors import CallerError
from aces_bus.hardware import ListeningNode
from aces_bus.robot import Runner, VirtualRobot, run_virtual
from aces_bus.robot.checks import KINDS_OF_FAULTS
from aces_bus.robot.rig import bus_variants
from aces_devices.hubo_motor.channel import HOMED
from tests.robot.walking import second_of

MS = 1_000_000
JOINTS = ("RKN", "RAP", "RAR")
#: A stop is repeated for 1.5 s; the attempt that is under way then may take 0.5 s, and its confirmation as long.
WITHIN_NS = 2_600 * MS
IS_LONG = settings().max_examples > 100
EXAMPLES = 5 * settings().max_examples if IS_LONG else 24


@cache
def lower_leg() -> Robot:
    """Knee and ankle: two boards."""
    return load_robot("hubo2plus").part(*JOINTS)


class Drawn(Controller):
    """Gives what the schedule has it give."""

    def __init__(self) -> None:
        super().__init__("drawn", rate_hz=100, writes=JOINTS)
        self.what: Any = 0.2

    def step(self, now_ns: int) -> Mapping[str, float]:
        match self.what:
            case "raise":
                raise ZeroDivisionError
            case "nothing":
                return {}
            case "swing":
                return dict.fromkeys(JOINTS, 3.0 if now_ns // (50 * MS) % 2 else -3.0)
            case "nan" | "inf":
                return dict.fromkeys(JOINTS, float(self.what))
            case _:
                return dict.fromkeys(JOINTS, self.what)


#: An instant (ms) and what happens then: its kind, and what of it.
Act = tuple[int, str, Any]


def carry_out(run: Runner, drawn: Drawn, kind: str, what: Any) -> None:
    """Let something of a schedule happen."""
    node: Any = run.rig.hosts["lower"].port.node  # type: ignore[attr-defined]
    match kind, what:
        case "gives", _:
            drawn.what = what
        case "cable", is_in:
            node.is_connected = is_in
        case "bus-off", away_s:
            node.restart_ns = None
            for _ in range(40):
                node.count_errors(8, 0, None)
            run.clock.call_in(round(away_s * 1e9), node.restart)
        case "do", "release":
            with suppress(CallerError):  # an e-stop is pressed
                run.release("drawn")
        case "do", "flood":
            for _ in range(3_000):
                run.supervisors[0].handle(ControlEvent("alarm", run.clock.now(), "JMC2"))
        case "do", action if run.seconds:  # not behind the back of a run that is ending
            with suppress(CallerError):  # refused now: a search for home is under way
                run.rig.each(action)
        case "trip", action:
            run.supervisors[0].guard.trip("by hand", action)
        case "twin", (name, fault, is_on):
            misbehave(run.world.twins[name], fault, is_on)
        case "estop", what:
            press(run.world.twins["IO"], what)
        case "second", (name, hears_ms):
            second = second_of(run.world, name)
            run.clock.call_in(hears_ms * MS, lambda: second.fault("can_error"))
        case _:
            pass


def press(io: Any, what: str) -> None:
    """Press the e-stop, clear it, or have its module say nothing."""
    if what in ("pressed", "clear"):
        io.put("di1", what == "clear")
    else:
        io.power(what == "power on")


def misbehave(twin: Any, fault: str, is_on: bool) -> None:
    """One of a twin's faults, or its power, or ears that take no command to switch."""
    if fault == "power":
        twin.power(is_on)
    elif fault == "reboot":
        twin.reboot()
    elif fault == "deaf":
        for channel in twin.channels:
            channel.switch = (lambda now, **_: None) if is_on else type(channel).switch.__get__(channel)
    else:
        twin.fault(fault, on=is_on)


FAULTS = (
    "silent",
    "loses",
    "late",
    "twice",
    "short",
    "wrong_number",
    "wrong_check",
    "power",
    "reboot",
    "deaf",
)
GIVEN = ("raise", "nothing", "swing", "text", None, "nan", "inf", 1e300)
HAPPENS: st.SearchStrategy[tuple[str, Any]] = st.one_of(
    st.tuples(
        st.just("twin"),
        st.tuples(st.sampled_from(["JMC2", "JMC3"]), st.sampled_from(FAULTS), st.booleans()),
    ),
    st.tuples(
        st.just("second"), st.tuples(st.sampled_from(["JMC2", "JMC3"]), st.sampled_from([10, 60, 400]))
    ),
    st.tuples(st.just("bus-off"), st.sampled_from([0.01, 0.2, 1.0, 60.0])),
    st.tuples(st.just("cable"), st.booleans()),
    st.tuples(st.just("gives"), st.one_of(st.floats(-4, 4), st.sampled_from(GIVEN))),
    st.tuples(st.just("do"), st.sampled_from(["release", "flood", "enable", "disable", "home"])),
    st.tuples(st.just("trip"), st.sampled_from(["hold", "disable", "zero duty"])),
)
SCHEDULES: st.SearchStrategy[list[Act]] = st.lists(
    st.builds(lambda at_ms, happens: (at_ms, *happens), st.integers(0, 500), HAPPENS), max_size=6
)
REACTIONS = st.dictionaries(
    st.sampled_from(["*", "silent", "raised", "dead-man", "bus-off", "error-passive", "no reply", "alarm"]),
    st.sampled_from(["ignore", "degrade:worse", "hold", "disable"]),
    max_size=4,
)


class Watcher:
    """Reads all references on the bus, and compares them with the joints' limits."""

    def __init__(self, world: VirtualRobot) -> None:
        robot = world.robot
        self.recorder = ListeningNode(world.wires["lower"])
        self.scanner = make_scanner(bus_variants(robot, "lower"), include_unknown=True)
        self.limits: dict[tuple[int, int], tuple[float, float]] = {}
        for device in world.rig.devices.values():
            for axis in getattr(device, "axes", ()):
                if axis.joint is not None:
                    ends = sorted(axis.to_counts(end) for end in (axis.joint.lower, axis.joint.upper))
                    self.limits[device.credentials["board"], axis.channel] = (ends[0] - 1, ends[1] + 1)

    def beyond(self) -> list[str]:
        """Every reference that is beyond its joint's limits, and further out than the joint has been."""
        found: list[str] = []
        for record in self.scanner.feed(list(self.recorder.frames())):
            name = type(record).__name__
            for channel, count in enumerate(record.position if name in ("Reference", "Encoder") else ()):
                low, high = self.limits.get((record.board, channel), (-inf, inf))
                if name == "Encoder":
                    self.limits[record.board, channel] = (min(low, count), max(high, count))
                elif not low <= count <= high:
                    found.append(f"{record.board}.{channel}: {count} is not in {low} … {high}")
        return found


@pytest.mark.slow
@settings(max_examples=EXAMPLES)
@given(
    schedule=SCHEDULES,
    seconds=st.sampled_from([0.1, 0.3, 0.6]),
    reactions=REACTIONS,
    on_trip=st.sampled_from(["disable", "hold"]),
    hold_s=st.sampled_from([None, 0.1]),
)
def test_after_a_stop_all_is_off_or_named(
    schedule: list[Act], seconds: float, reactions: dict[str, str], on_trip: Action, hold_s: float | None
) -> None:
    """Every board is off within the stated time, or the run says that it is not; no reference is beyond the limits.

    Of two boards that were seen to answer as one, one may be on and not receive any more.
    """
    drawn = Drawn()
    declared = Reaction.parse(reactions, kinds=KINDS_OF_FAULTS)
    run = run_virtual(lower_leg(), [drawn], rate_hz=100, reactions=declared, on_trip=on_trip, hold_s=hold_s)
    watcher = Watcher(run.world)
    run.open()
    run.do("enable")
    for at_ms, kind, what in schedule:
        run.clock.call_in(at_ms * MS, partial(carry_out, run, drawn, kind, what))
    run.start()
    run.world.clock.advance(round(seconds * 1e9))
    stopped_at = run.clock.now()
    doubles = {name for name, device in run.rig.devices.items() if device.is_double and device.joints}
    ended = run.stop()
    assert run.clock.now() - stopped_at <= WITHIN_NS
    still_on = {
        name
        for name, twin in run.world.twins.items()
        if twin.is_powered and any(channel.control_on for channel in twin.channels)
    }
    assert still_on | doubles <= set(ended.not_stopped)
    assert watcher.beyond() == []


#: What an e-stop input may do: be pressed, or lose its module.
PRESSED = ("pressed", "power off")
#: What moves or enables a board of Hubo's.
MOVING = frozenset(("Reference", "ControlOn", "Home", "Pwm"))
#: A stop leaves this long (ns) after its input was received, at the latest; what is on the wire then has left before.
AT_ONCE = 2 * MS
ESTOPS: st.SearchStrategy[tuple[str, Any]] = st.tuples(
    st.just("estop"), st.sampled_from(["pressed", "pressed", "clear", "clear", "power off", "power on"])
)
ESTOP_SCHEDULES: st.SearchStrategy[list[Act]] = st.lists(
    st.builds(lambda at_ms, happens: (at_ms, *happens), st.integers(0, 500), ESTOPS | HAPPENS),
    min_size=1,
    max_size=8,
)


@cache
def leg_with_estop() -> Robot:
    """Knee and ankle, with an e-stop on a module of its own bus."""
    leg = lower_leg()
    io = Bus(name="io", link="can", protocol="canopen", bitrate=1_000_000)
    module = DeviceConfig(
        name="IO", driver="cia401", bus="io", credentials={"node": 17}, settings={"every_s": 0.03}
    )
    return replace(
        leg,
        buses={**leg.buses, "io": io},
        devices={**leg.devices, "IO": module},
        estop={"panel": Input(name="panel", signal="IO.di1", clear=True, stale_after_s=0.1)},
    )


def begun_with_estop(drawn: Drawn, **options: Any) -> Runner:
    """A run with the e-stop clear and all joints homed and enabled."""
    run = run_virtual(leg_with_estop(), [drawn], rate_hz=100, **options)
    for name in ("JMC2", "JMC3"):
        for channel in run.world.twins[name].channels:
            channel.home = HOMED
    run.world.twins["IO"].put("di1", True)
    run.open()
    run.clock.wait(lambda: not run.rig.chain.pressed, 1_000 * MS)
    run.clock.wait(lambda: not run.rig.chain.missing(list(run.rig.devices.values())), 2_000 * MS)
    run.do("enable")
    return run


class Chain:
    """Notes when the e-stop tripped, and when somebody enabled or homed on purpose, to be compared with the wire."""

    def __init__(self, run: Runner) -> None:
        self.run = run
        self.trips: list[int] = []
        self.begun: list[int] = []
        self.node = ListeningNode(run.world.wires["lower"])
        self.scanner = make_scanner(bus_variants(run.rig.robot, "lower"), include_unknown=True)
        run.rig.on_event(self._happened)
        run.rig.events.acts.append(self._done)

    def _happened(self, event: Any) -> None:
        if event.kind == "estop":
            self.trips.append(event.instant)

    def _done(self, what: str, who: str, detail: str) -> None:
        if what in ("enable", "home") and not detail:
            assert not self.run.rig.chain.pressed, "begun while the e-stop is pressed"
            self.begun.append(self.run.clock.now())

    def broken(self) -> list[str]:
        """What moved or enabled a board after a trip although nobody had begun anew.

        A reference that was in an adapter's mailbox when its bus was lost may come behind the board's ControlOff.
        """
        found: list[str] = []
        off: dict[int, int] = {}
        for instant, frame in self.node.received:
            for record in self.scanner.feed([frame]):
                trip = max((at for at in self.trips if at + AT_ONCE < instant), default=None)
                name = type(record).__name__
                if name == "ControlOff":
                    off[record.board] = instant
                if name not in MOVING or trip is None or any(trip <= at <= instant for at in self.begun):
                    continue
                if name != "Reference" or off.get(record.board, 0) < trip:
                    found.append(f"{name} {(instant - trip) / MS:.1f} ms after the e-stop")
        return found


@pytest.mark.slow
@settings(max_examples=EXAMPLES)
@given(
    schedule=ESTOP_SCHEDULES,
    seconds=st.sampled_from([0.3, 0.6, 1.0]),
    reactions=REACTIONS,
    on_trip=st.sampled_from(["disable", "hold"]),
    at_end=st.sampled_from(["disable", "hold"]),
)
def test_an_estop_stops_all_whatever_happens(
    schedule: list[Act],
    seconds: float,
    reactions: dict[str, str],
    on_trip: Action,
    at_end: Literal["disable", "hold"],
) -> None:
    """After an e-stop nothing that moves or enables is sent until somebody begins anew; while it is pressed, nobody can.

    It trips in time, also by silence; and at the end all is off, or named.
    """
    drawn = Drawn()
    declared = Reaction.parse(reactions, kinds=KINDS_OF_FAULTS)
    run = begun_with_estop(drawn, reactions=declared, on_trip=on_trip, at_end=at_end)
    watcher, chain = Watcher(run.world), Chain(run)
    begun = run.clock.now()
    for at_ms, kind, what in schedule:
        run.clock.call_in(at_ms * MS, partial(carry_out, run, drawn, kind, what))
    run.start()
    run.world.clock.advance(round(seconds * 1e9))
    estops = sorted((at_ms, what) for at_ms, kind, what in schedule if kind == "estop")
    now_ms = (run.clock.now() - begun) // MS
    since = max((at_ms for at_ms, _ in estops if at_ms <= now_ms), default=now_ms)
    last = {what for at_ms, what in estops if at_ms == since}
    if last <= set(PRESSED) and now_ms - since > 150:
        assert run.rig.chain.pressed
        assert set(run.stopped) == {"drawn"}
    doubles = {name for name, device in run.rig.devices.items() if device.is_double and device.joints}
    was_tripped = bool(run.rig.chain.pressed)
    ended = run.stop()
    still_on = {
        name
        for name in ("JMC2", "JMC3")
        if (twin := run.world.twins[name]).is_powered and any(channel.control_on for channel in twin.channels)
    }
    assert still_on | doubles - set(ended.held) <= {*ended.not_stopped, *ended.held}
    if was_tripped:
        assert ended.held == []
    assert chain.broken() == []
    assert watcher.beyond() == []


def test_what_is_sent_after_an_estop_is_seen() -> None:
    """References of a run that goes on are found as soon as a trip is noted; those before it are not."""
    drawn = Drawn()
    run = begun_with_estop(drawn)
    chain = Chain(run)
    run.start()
    run.world.clock.advance(100 * MS)
    assert chain.broken() == []
    chain.trips.append(run.clock.now() - 50 * MS)
    assert any("Reference" in one for one in chain.broken())
    run.stop()


def test_the_watcher_sees_what_is_beyond() -> None:
    """References are read as they are: those of a swing, and one that is put on the bus behind the guard's back."""
    drawn = Drawn()
    drawn.what = "swing"
    run = run_virtual(lower_leg(), [drawn], rate_hz=100)
    watcher = Watcher(run.world)
    with run:
        run.do("enable")
        run.run(0.3)
    assert watcher.beyond() == []
    assert run.supervisors[0].guard.clips["RKN"].position > 5
    watcher.limits = dict.fromkeys(watcher.limits, (-1.0, 1.0))
    assert len(watcher.beyond()) > 20
