"""Drawn schedules of faults and commands, in virtual time: a stop is done, or the run says who has not stopped.

Whatever happens before and meanwhile. And no set-point that a board is sent is beyond its joint's limits.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from functools import cache, partial
from math import inf
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aces_bus import load_robot
from aces_bus.controller import ControlEvent, Controller, parse_reactions
from aces_bus.controller.trip import Action
from aces_bus.device import Robot
from aces_bus.errors import CallerError
from aces_bus.hardware import ListeningNode
from aces_bus.protocol import make_scanner
from aces_bus.robot import Runner, VirtualRobot, run_virtual
from aces_bus.robot.checks import KINDS_OF_FAULTS
from aces_bus.robot.rig import bus_variants
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
        case "second", (name, hears_ms):
            second = second_of(run.world, name)
            run.clock.call_in(hears_ms * MS, lambda: second.fault("can_error"))
        case _:
            pass


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
    declared = parse_reactions(reactions, kinds=KINDS_OF_FAULTS)
    run = run_virtual(lower_leg(), [drawn], rate_hz=100, reactions=declared, on_trip=on_trip, hold_s=hold_s)
    watcher = Watcher(run.world)
    run.open()
    run.do("enable")
    for at_ms, kind, what in schedule:
        run.clock.call_in(at_ms * MS, partial(carry_out, run, drawn, kind, what))
    run.start()
    run.world.clock.advance(round(seconds * 1e9))
    stopped_at = run.clock.now()
    doubles = {name for name, device in run.rig.devices.items() if device.is_double}
    ended = run.stop()
    assert run.clock.now() - stopped_at <= WITHIN_NS
    still_on = {
        name
        for name, twin in run.world.twins.items()
        if twin.is_powered and any(channel.control_on for channel in twin.channels)
    }
    assert still_on | doubles <= set(ended.not_stopped)
    assert watcher.beyond() == []


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
