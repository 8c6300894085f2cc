"""Drawn schedules of what goes wrong on a serial line: after a stop a device is off or held, or the run names it.

Whatever the line does to packets, and however its neighbours behave: those that are well are confirmed soon.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aces_bus.device.stopping import stop_devices
from aces_bus.hardware import Noise
from aces_bus.robot import VirtualRobot
from tests.robot.stop_lines import KINDS, MS, NAMES, Act, Lines, robot_of

#: What a device of each kind is asked for.
ASKED: Mapping[str, tuple[str, dict[str, Any]]] = {
    **dict.fromkeys(KINDS, ("Ping", {})),
    "modbus": ("ReadRegisters", {"function": 3, "start": 10, "count": 1}),
    "qik": ("GetError", {}),
    "roboclaw": ("GetStatus", {}),
    "vesc": ("GetFirmware", {}),
}

#: As of `test_stop_schedules`.
WITHIN_NS = 2_600 * MS
IS_LONG = settings().max_examples > 100
EXAMPLES = settings().max_examples if IS_LONG else 24

RATES = (
    {"flip": 0.0005},
    {"flip": 0.005},
    {"flip": 0.05},
    {"drop": 0.002},
    {"drop": 0.02},
    {"insert": 0.002},
    {"insert": 0.02},
    {"flip": 0.01, "drop": 0.01, "insert": 0.01},
)
#: Seconds: within an answer's time, into the next one's, beyond it.
LATE_S = (0.005, 0.015, 0.022, 0.03, 0.05, 0.1, 0.3)
#: What happens to a line; a burst of noise has an end, another lasts.
OF_LINES: st.SearchStrategy[tuple[str, Any]] = st.one_of(
    st.tuples(st.just("noise"), st.tuples(st.sampled_from(RATES), st.sampled_from((20, 100, None)))),
    st.tuples(st.just("babble"), st.integers(0, 1000)),
    st.tuples(st.just("split"), st.none()),
    st.tuples(st.just("gathered"), st.sampled_from((1, 4, 16))),
    st.tuples(st.just("cable"), st.sampled_from((20, 200, None))),
)
OF_DEVICES: st.SearchStrategy[tuple[str, Any]] = st.one_of(
    st.tuples(st.just("late"), st.sampled_from(LATE_S)),
    st.tuples(st.just("loses"), st.sampled_from((2, 3))),
    st.tuples(st.sampled_from(("silent", "wrong_check", "short", "twice", "reboot", "second")), st.none()),
    st.tuples(st.just("wrong_number"), st.none()),
    st.tuples(st.just("power"), st.just(False)),
)
INSTANTS = st.integers(0, 400)


@st.composite
def schedules(draw: st.DrawFn) -> tuple[int, list[Act]]:
    """The device that is faulty, and what happens when: to it, and to the line."""
    victim = draw(st.sampled_from((1, 2, 3)))
    some = st.lists(st.one_of(OF_LINES, OF_DEVICES), min_size=1, max_size=3)
    of_lines = {"noise", "babble", "split", "gathered", "cable"}
    return victim, [
        (draw(INSTANTS), what, draw(st.sampled_from((1, 2, 3))) if what in of_lines else victim, how)
        for what, how in draw(some)
    ]


def cannot_be_known(kind: str, schedule: list[Act]) -> bool:
    """Whether what a device was sent cannot be known from what it answers."""
    acts = {what for _, what, _, _ in schedule}
    if (
        kind == "modbus"
    ):  # two devices of one number, of which one repeats old orders late: the other obeys its answers
        return {"second", "late"} <= acts
    if not KINDS[kind].is_checked:  # noise may make another command of a stop, or lose each of five
        return not acts.isdisjoint(("noise", "cable", "babble", "wrong_check", "short", "wrong_number"))
    return False


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=EXAMPLES)
@given(
    drawn=schedules(),
    seconds=st.sampled_from([0.1, 0.3, 0.5]),
    reactions=st.sampled_from([{}, {"*": "ignore"}]),
)
def test_after_a_stop_all_is_off_or_named(
    kind: str, drawn: tuple[int, list[Act]], seconds: float, reactions: dict[str, str]
) -> None:
    """Within the stated time. Devices that are well, on a line that is, are confirmed soon beside one that is not."""
    victim, schedule = drawn
    lines = Lines(kind, reactions)
    stopped = lines.stop_after(schedule, seconds)
    assert stopped.took_ns <= WITHIN_NS
    if not cannot_be_known(kind, schedule):
        assert stopped.still_on <= set(stopped.ended.not_stopped)
    acts = {what for _, what, _, _ in schedule}
    if not acts & {"noise", "babble", "cable", "wrong_number", "gathered"}:
        others = {f"D{n}" for n in (1, 2, 3) if n != victim}
        assert others.isdisjoint(stopped.ended.not_stopped)
        assert max(stopped.confirmed_ns[name] for name in others) <= lines.kind.healthy_ns


@pytest.mark.parametrize("kind", KINDS)
def test_they_move_and_stop(kind: str) -> None:
    """Without a schedule all of them are on before a stop, which is seen as such; and off behind it, confirmed."""
    lines = Lines(kind, {})
    lines.run.open()
    lines.run.do("enable")
    lines.run.start()
    lines.run.world.clock.advance(300 * MS)
    assert all(lines.kind.is_on(twin, 9.0) for twin in lines.twins.values())
    assert lines.run.stop().not_stopped == {}
    stopped = Lines(kind, {}).stop_after([], 0.3)
    assert (stopped.still_on, stopped.ended.not_stopped) == (set(), {})
    assert set(stopped.confirmed_ns) == set(NAMES)


# ---------------------------------------------------------------------- what such schedules have found


def test_a_lost_answer_does_not_bring_a_set_point_back() -> None:
    """A Modbus drive's answer to a set-point is lost: the set-point is not written again behind the stop."""
    lines = Lines("modbus", {"*": "ignore"})
    lines.run.open()
    lines.run.start()
    lines.run.world.clock.advance(200 * MS)
    twin = lines.twins["D1"]
    twin.fault("silent")
    lines.run.world.clock.advance(40 * MS)
    stopping = stop_devices(lines.clock, "D1", [lines.run.rig.devices["D1"]])
    lines.run.supervisors[0].guard.trip("by hand", "disable")
    twin.fault("silent", on=False)
    lines.run.world.clock.advance(2_000 * MS)
    assert stopping.state == "done"
    assert (twin.take("go"), twin.take("speed")) == (False, 0)


def test_a_late_confirmation_of_another_write_is_none() -> None:
    """A Modbus drive confirms late what it was set to before, and its stop is lost: that is not taken for the stop's."""
    with VirtualRobot(robot_of("modbus"), rate_hz=50) as robot:
        robot.advance(0.1)
        twin, drive = robot.twins["D1"], robot.devices["D1"]
        twin.fault("late", 0.06)
        drive["speed"].set(50)
        robot.advance(0.0525)
        stopping = stop_devices(robot.clock, "D1", [drive])
        while not drive.awaiting:
            robot.advance(0.0001)
        robot.wires["L1"].noise = Noise(flip=0.9)
        robot.advance(0.001)
        robot.wires["L1"].noise = None
        while not stopping.is_over:
            robot.advance(0.001)
        assert (stopping.state, twin.take("speed")) == ("done", 0)
        assert any("was another write" in event.detail for event in robot.events.last)


@pytest.mark.parametrize("kind", ["dynamixel wheels", "rx that answers reads alone", "feetech wheels"])
def test_a_stop_is_read_back_beside_a_silent_neighbour(kind: str) -> None:
    """Servos that acknowledge nothing are confirmed soon, though a neighbour's stop is sent again and again."""
    for victim in (1, 2, 3):
        lines = Lines(kind, {})
        stopped = lines.stop_after([(227, "short", victim, None)], 0.3)
        assert list(stopped.ended.not_stopped) == [f"D{victim}"]
        assert all(
            at <= lines.kind.healthy_ns for name, at in stopped.confirmed_ns.items() if name != f"D{victim}"
        )


@pytest.mark.parametrize("kind", ["qik", "vesc"])
def test_a_stop_without_acknowledgement_is_sent_again(kind: str) -> None:
    """A disturbance of 30 ms garbles the stop of devices that acknowledge none: they are off all the same."""
    for victim in (1, 2, 3):
        lines = Lines(kind, {"*": "ignore"})
        stopped = lines.stop_after([(299, "noise", victim, ({"flip": 0.5}, 30))], 0.3)
        assert (stopped.still_on, stopped.ended.not_stopped) == (set(), {})


def test_an_answer_behind_a_false_header_is_found() -> None:
    """Noise looks like the beginning of a long packet, and a good answer comes behind it: it answers what was asked."""
    lines = Lines("rx", {"*": "ignore"})
    lines.run.open()
    lines.run.world.clock.advance(100 * MS)
    device, host = lines.run.rig.devices["D1"], lines.run.rig.hosts["L1"]
    reading = device.read("present_temperature")  # type: ignore[attr-defined]
    while reading.state == "waiting" and not device.awaiting:
        lines.run.world.clock.advance(MS // 100)
    host.port.node.received(bytes.fromhex("ffff01f000"), lines.clock.now())  # type: ignore[attr-defined]
    lines.run.world.clock.advance(60 * MS)
    assert reading.state == "done"
    assert host.counts.missed == 0


@pytest.mark.parametrize("kind", KINDS)
@given(data=st.binary(max_size=300), seed=st.integers(0, 99))
def test_a_garbled_request_does_not_make_a_twin_deaf(kind: str, data: bytes, seed: int) -> None:
    """Whatever was sent to a device, it answers a request behind a pause as long as its protocol says."""
    with VirtualRobot(robot_of(kind), rate_hz=0, seed=seed) as robot:
        device, host = robot.devices["D1"], robot.rig.hosts["L1"]
        robot.wires["L1"].attach("noise", None).send(
            data[:1] + host.packet(device, *ASKED[kind])[: seed % 8] + data
        )
        robot.advance(0.3)
        replies = robot.twins["D1"].replies
        robot.wires["L1"].attach("other", None).send(host.packet(device, *ASKED[kind]))
        robot.advance(0.02)
        assert robot.twins["D1"].replies > replies
