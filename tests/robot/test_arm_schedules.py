"""Drawn schedules of commands and faults for the arm of examples/arm.toml, in virtual time, against two laws.

1. No joint gets past its limits by more than v·(poll + reply + tick) + v²/2a, a from the robot's file; v is the fastest that
   it truly turned.
2. At the end each joint is off, parked and off, held, or named.

The first law is of joints whose position is known: a joint whose device or bus is at fault is left out of it, as what is
measured of it is not what is so.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from functools import partial
from types import SimpleNamespace
from typing import Any, Literal

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from aces_bus.controller.reactions import Reaction
from aces_bus.controller.trip import Action
from aces_bus.errors import CallerError
from aces_bus.robot import Runner, run_virtual
from aces_bus.robot.checks import KINDS_OF_FAULTS
from tests.robot.arm import BUS_OF, DEVICE_OF, MS, Drawn, Truth, Way, arm, is_driving, ways_of

IS_LONG = settings().max_examples > 100
EXAMPLES = settings().max_examples if IS_LONG else 16
DEVICES = tuple(DEVICE_OF.values())
CAN = ("lower", "middle", "upper")
#: Faults of any twin, and of one kind.
ANY = ("silent", "loses", "late", "twice", "short", "wrong_number", "power")
OWN: Mapping[str, tuple[str, ...]] = {
    "M": ("jam", "trip"),
    "O": ("over_temperature", "no_heartbeat"),
    "D": ("mos_over_temperature", "over_current"),
    "X": ("jam", "overload", "hot"),
}
#: An instant (ms) and what happens then: its kind, and what of it.
Act = tuple[int, str, Any]
FAULT = st.sampled_from(DEVICES).flatmap(
    lambda name: st.tuples(st.just(name), st.sampled_from((*ANY, *OWN[name[0]])), st.booleans())
)
HAPPENS: st.SearchStrategy[tuple[str, Any]] = st.one_of(
    st.tuples(
        st.just("gives"),
        st.tuples(
            st.sampled_from([*DEVICE_OF]),
            st.one_of(st.floats(-1, 1), st.sampled_from([1.0, -1.0, 0.0, float("nan"), float("inf"), None])),
        ),
    ),
    st.tuples(st.just("gives"), st.tuples(st.sampled_from([*DEVICE_OF]), st.sampled_from([1.0, -1.0]))),
    st.tuples(st.just("program"), st.sampled_from(["raises", "nothing", "gives"])),
    st.tuples(st.just("twin"), FAULT),
    st.tuples(st.just("cable"), st.tuples(st.sampled_from([*CAN, "tip"]), st.booleans())),
    st.tuples(st.just("bus-off"), st.tuples(st.sampled_from(CAN), st.sampled_from([0.01, 0.2, 60.0]))),
    st.tuples(st.just("do"), st.sampled_from(["release", "enable", "disable"])),
    st.tuples(st.just("trip"), st.sampled_from(["hold", "park", "disable"])),
    st.tuples(st.just("stop"), st.sampled_from([*CAN, "tip"])),
)
SCHEDULES: st.SearchStrategy[list[Act]] = st.lists(
    st.builds(lambda at_ms, happens: (at_ms, *happens), st.integers(0, 900), HAPPENS), max_size=8
)
REACTIONS = st.dictionaries(
    st.sampled_from(["*", "silent", "raised", "dead-man", "bus-off", "no reply", "alarm", "not finite"]),
    st.sampled_from(["ignore", "degrade:worse", "hold", "park", "disable"]),
    max_size=3,
)
WAYS = st.tuples(*(st.sampled_from(ways_of(joint)) for joint in DEVICE_OF))
POSITIONS = tuple(ways_of(joint)[0] for joint in DEVICE_OF)


def carry_out(run: Runner, drawn: Drawn, kind: str, what: Any) -> None:
    """Let something of a schedule happen."""
    match kind, what:
        case "gives", (joint, share):
            drawn.shares[joint] = share
        case "program", does:
            drawn.what = does
        case "twin", (name, "power", is_on):
            run.world.twins[name].power(is_on)
        case "twin", (name, fault, is_on):
            run.world.twins[name].fault(fault, on=is_on)
        case "cable", (bus, is_in):
            run.rig.hosts[bus].port.node.is_connected = is_in  # type: ignore[attr-defined]
        case "bus-off", (bus, away_s):
            node: Any = run.rig.hosts[bus].port.node  # type: ignore[attr-defined]
            node.restart_ns = None
            for _ in range(40):
                node.count_errors(8, 0, None)
            run.clock.call_in(round(away_s * 1e9), node.restart)
        case "do", "release":
            with suppress(CallerError):
                run.release("drawn")
        case "do", action if run.seconds:  # not behind the back of a run that is ending
            with suppress(CallerError):
                run.rig.each(action)
        case "trip", action if run.rig.robot.park is not None or action != "park":
            run.supervisors[0].guard.trip("by hand", action)
        case "stop", bus if run.seconds:
            request: Any = SimpleNamespace(who="aces stop (pid 7)", answer=lambda **_: None)
            run.rig.obey_stop(bus, request)
        case _:
            pass


def at_fault(schedule: list[Act]) -> set[str]:
    """Return the joints of which what is measured may not be so, or that get no command any more."""
    devices = {what[0] for _, kind, what in schedule if kind == "twin"}
    buses = {what[0] for _, kind, what in schedule if kind in ("cable", "bus-off")}
    return {joint for joint, name in DEVICE_OF.items() if name in devices or BUS_OF[name] in buses}


#: What other seeds drew: a joint by speed whose position was not known was set to 0.
LATE: list[Act] = [(0, "twin", ("M1", "late", True)), (20, "do", "enable")]


@pytest.mark.slow
@settings(max_examples=EXAMPLES)
@example(LATE, (ways_of("base")[1], *POSITIONS[1:]), 0.2, {"*": "hold"}, "disable", "disable", None)
@given(
    schedule=SCHEDULES,
    ways=st.one_of(st.just(POSITIONS), WAYS),
    seconds=st.sampled_from([0.2, 0.6, 1.5]),
    reactions=REACTIONS,
    on_trip=st.sampled_from(["disable", "hold", "park"]),
    at_end=st.sampled_from(["disable", "hold", "park"]),
    hold_s=st.sampled_from([None, 0.1]),
)
def test_no_joint_is_past_its_limits_and_all_are_off_parked_held_or_named(
    schedule: list[Act],
    ways: tuple[Way, ...],
    seconds: float,
    reactions: dict[str, str],
    on_trip: Action,
    at_end: Literal["disable", "hold", "park"],
    hold_s: float | None,
) -> None:
    """Whatever is commanded, fails, trips and stops, in whatever order."""
    can_park = all(way.command == "position" for way in ways)
    if not can_park:  # its file has no pose
        at_end = "disable" if at_end == "park" else at_end
        on_trip = "disable" if on_trip == "park" else on_trip
        reactions = {kind: "hold" if word == "park" else word for kind, word in reactions.items()}
    drawn = Drawn(dict(zip(DEVICE_OF, ways, strict=True)))
    run = run_virtual(
        arm(*(way.command for way in ways)),
        [drawn],
        reactions=Reaction.parse(reactions, kinds=KINDS_OF_FAULTS),
        on_trip=on_trip,
        at_end=at_end,
        hold_s=hold_s,
    )
    run.open()
    run.do("enable")
    truth = Truth(run.world)
    for at_ms, kind, what in schedule:
        run.clock.call_in(at_ms * MS, partial(carry_out, run, drawn, kind, what))
    ended = run.run(seconds)
    driving = {
        name for name in DEVICES if run.world.twins[name].is_powered and is_driving(run.world.twins[name])
    }
    assert driving <= {*ended.not_stopped, *ended.held}, ended
    parked = {DEVICE_OF[joint] for joint in ended.parked}
    assert not (parked & driving) - set(ended.not_stopped)
    run.world.clock.advance(300 * MS)  # what coasts has come to rest
    at = truth.now()
    run.world.clock.advance(300 * MS)
    here = truth.now()
    moving = {name for joint, name in DEVICE_OF.items() if abs(here[joint] - at[joint]) > 0.005}
    assert moving <= set(ended.not_stopped), ended
    assert truth.beyond(but=at_fault(schedule)) == {}
