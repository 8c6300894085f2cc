# Junk is planted where zenoh calls.
# pyright: reportPrivateUsage=false
"""States over zenoh: a robot here, a controller there; what is lost, what is refused, what is junk."""

from __future__ import annotations

import functools
import json
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from aces_bus.controller import Controller
from aces_bus.controller.base import NOTHING
from aces_bus.controller.log import Logger, read_log
from aces_bus.device import UNKNOWN
from aces_bus.errors import CallerError, NoReplyError, UnknownNameError
from aces_bus.robot import run_virtual
from aces_bus.runtime import RealClock, ThreadTasks, VirtualClock
from aces_bus.runtime.loop import Loop
from aces_bus.state import State
from aces_lab.zenoh import Publisher, RemoteStates
from aces_lab.zenoh.publisher import open_session
from aces_lab.zenoh.remote import RemoteClock
from tests.device.fan import ROBOT, drivers, robot_of

pytest.importorskip("zenoh")

MS = 1_000_000


@pytest.fixture
def endpoint() -> str:
    """An address on this machine where nobody listens."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{one.getsockname()[1]}"


@pytest.fixture
def loop() -> Iterator[Loop]:
    """The clock of the robot's side."""
    with Loop() as made:
        yield made


class Side:
    """The robot's side: two joints, published on a thread."""

    def __init__(self, loop: Loop, endpoint: str, **options: Any) -> None:
        self.loop = loop
        self.taken: list[float] = []
        self.hip = State("hip", unit="rad", clock=loop, stale_after_s=10)
        self.knee = State("knee", unit="rad", clock=loop, setter=self.taken.append)
        self.publisher = Publisher(["hip", "knee"], 200, endpoint, robot="leg", **options)
        self.publisher.bind({"hip": self.hip, "knee": self.knee})

    def __enter__(self) -> Side:
        self.publisher.start(self.loop.now())
        self.tasks = ThreadTasks(self.loop)
        self.tasks.add("publish", self.publisher.step, rate_hz=200)
        self.tasks.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.tasks.stop()
        self.publisher.stop(self.loop.now())


def soon(until: Callable[[], object], seconds: float = 5.0) -> bool:
    """Whether it comes to hold."""
    with Loop() as clock:
        return clock.wait(lambda: bool(until()), round(seconds * 1e9))


def has(state: State, instant: int) -> bool:
    """Whether the sample of an instant has come."""
    return state.instant == instant


def test_a_remote_state_is_a_state(loop: Loop, endpoint: str) -> None:
    """Value, unit, history, derivative and age are those of the robot's side, on its clock."""
    with Side(loop, endpoint) as side, RemoteStates(endpoint, robot="leg", lost_s=5) as states:
        assert set(states) == {"hip", "knee"}
        hip = states["hip"]
        rate = hip.rate()
        assert hip[0] is UNKNOWN
        start = loop.now()
        for i in range(3):
            instant = start + i * 10 * MS
            side.hip.push(1.0 + i, instant)
            assert soon(functools.partial(has, hip, instant))
        assert (hip.unit, hip.instant) == ("rad", start + 20 * MS)
        assert rate[0] == pytest.approx(100)
        assert hip[-0.005] == 2.5
        there, here = side.hip.age_s, hip.age_s
        assert there is not None
        assert here is not None
        assert abs(here - there) < 0.1
        assert states["knee"][0] is UNKNOWN
        assert (len(states), "hip" in states, "hop" in states, states.bad) == (2, True, False, 0)
        with pytest.raises(UnknownNameError, match="hip, knee"):
            states["hop"]


def test_remote_states_are_logged_in_local_time(loop: Loop, endpoint: str, tmp_path: Path) -> None:
    """A logger beside a remote controller counts from its own start, on the clock of its own machine."""
    with Side(loop, endpoint) as side, RemoteStates(endpoint, robot="leg", lost_s=5) as states:
        side.knee.push(0.5, loop.now())
        assert soon(lambda: states["knee"][0] == 0.5)
        logger = Logger(tmp_path / "a.db", ["knee", "knee(age)"])
        logger.bind(states)
        with logger:
            logger.step(states.local.now())
    log = read_log(logger.path)
    assert log["knee"].tolist() == [0.5]
    assert 0 <= log.time_s[0] < 5
    assert 0 <= log["knee(age)"][0] < 5
    assert log.about.clock == "monotonic"
    assert log.about.wall_ns is not None


def test_set_points_go_back(loop: Loop, endpoint: str) -> None:
    """`set` and `give` reach the setter on the robot's side; what is read-only there is read-only here."""
    with (
        Side(loop, endpoint, allow_set=True) as side,
        RemoteStates(endpoint, robot="leg", lost_s=5) as states,
    ):
        states["knee"].set(0.25)
        assert soon(lambda: side.taken == [0.25])
        states.give({"knee": 0.5})
        assert soon(lambda: side.taken == [0.25, 0.5])
        with pytest.raises(CallerError, match="read-only"):
            states["hip"].set(1.0)
        for values, message in (({"hip": 1.0}, "cannot be set"), ({"knee": float("nan")}, "not a finite")):
            with pytest.raises(CallerError, match=message):
                states.give(values)


def test_nothing_can_be_set_unless_it_is_allowed(loop: Loop, endpoint: str) -> None:
    """Without `allow_set` no state is writable from elsewhere."""
    with Side(loop, endpoint), RemoteStates(endpoint, robot="leg", lost_s=5) as states:
        assert not states.takes
        with pytest.raises(CallerError, match="read-only"):
            states["knee"].set(0.25)


@pytest.mark.slow
def test_a_lost_robot_is_unknown_and_comes_back(loop: Loop, endpoint: str) -> None:
    """When the robot's side ends its states become unknown and that is told; another run brings them back, anew."""
    kinds: list[str] = []
    states = RemoteStates(endpoint, robot="leg", lost_s=0.4)
    states.events.listeners.append(lambda event: kinds.append(event.kind))
    try:
        with Side(loop, endpoint) as side:
            states.open()
            side.knee.push(7.0, loop.now())
            assert soon(lambda: states["knee"][0] == 7.0)
        assert soon(lambda: kinds[-1:] == ["lost"])
        assert states["knee"][0] is UNKNOWN
        assert states["knee"].is_stale
        assert states["knee"].last == 7.0
        with Side(loop, endpoint, allow_set=True) as side:
            side.knee.push(8.0, loop.now())
            assert soon(lambda: kinds[-1:] == ["back"] and "restarted" in kinds)
            assert soon(lambda: states["knee"][0] == 8.0)
            assert states["knee"].span == (states["knee"].instant, states["knee"].instant)
            assert states["knee"].is_writable
    finally:
        states.close()
    assert states["knee"][0] is UNKNOWN
    with pytest.raises(CallerError, match="not open"):
        states.give({"knee": 1.0})


def test_a_controller_that_falls_silent_is_told_to_the_robot(loop: Loop, endpoint: str) -> None:
    """Where set-points came and come no more, `on_lost` is called once, on the robot's clock, and an event says so."""
    called: list[int] = []
    options = {"allow_set": True, "dead_man_s": 0.1, "on_lost": lambda: called.append(loop.now())}
    with Side(loop, endpoint, **options) as side, RemoteStates(endpoint, robot="leg", lost_s=5) as states:
        assert not called
        states["knee"].set(1.0)
        assert soon(lambda: called)
        assert [event.kind for event in side.publisher.events.last] == ["lost"]
        states["knee"].set(2.0)
        assert soon(lambda: side.taken == [1.0, 2.0])
        assert soon(lambda: len(called) >= 2, 30.0)


def test_junk_is_counted_on_both_sides(loop: Loop, endpoint: str) -> None:
    """Messages of anybody else are decoded strictly, bounded, counted, and do nothing."""
    with (
        Side(loop, endpoint, allow_set=True) as side,
        RemoteStates(endpoint, robot="leg", lost_s=5) as states,
    ):
        stranger = open_session([], [endpoint], {})
        sender = stranger.declare_publisher("aces/leg/set")
        assert soon(lambda: sender.matching_status.matching)
        junk = [
            b"",
            b"\xff",
            b"[1]",
            b"{",
            b'{"knee": "1"}',
            b'{"knee": null}',
            b"[" * 100_000,
            b"1" * 300_000,
        ]
        for data in junk:
            sender.put(data)  # zenoh drops what a busy machine does not take: counted is below
        good = json.dumps({"knee": 1e308, "elbow": 1, "hip": 1})

        def taken() -> bool:
            sender.put(good)
            return 1e308 in side.taken

        assert soon(taken)
        bad = side.publisher.bad
        for data in junk:
            side.publisher._set(Message(data))
        assert side.publisher.bad >= bad + len(junk)
        assert set(side.taken) == {1e308}
        inlet = side.publisher.inlet
        assert inlet is not None
        assert soon(lambda: inlet.refused >= 2)
        assert "no such state" in side.publisher.events.last[0].detail
        stranger.close()
        cycles = states.cycles
        wrong: list[Any] = [
            [],
            {"session": 1},
            {"session": "x", "now": 1, "states": {}},
            {"session": states._about.session if states._about else 0, "now": -1, "states": {}},
        ]
        for one in [*map(json.dumps, wrong), "\0"]:
            states._received(Message(one.encode()))
        assert states.bad == len(wrong) + 1
        session = states._about.session if states._about else 0
        odd = {"session": session, "now": loop.now(), "states": {"new": [1, 1], "hip": [1.5, 1 << 62]}}
        states._received(Message(json.dumps(odd).encode()))
        assert states.unannounced == 1
        assert states["hip"][0] is UNKNOWN
        assert soon(lambda: states.cycles > cycles + 1)


class Message:
    """A message as zenoh hands it over."""

    def __init__(self, payload: bytes) -> None:
        self.payload = payload


#: A robot of its own: a joint that follows its set-point at once.
ROBOT_PROGRAM = """
import sys
from aces_lab.zenoh import Publisher
from aces_bus.runtime.loop import Loop
from aces_bus.state import State
with Loop() as loop:
    joint = State("joint", unit="rad", clock=loop, sampled=False)
    joint.set(0.0)
    publisher = Publisher(["joint"], 200, sys.argv[1], robot="arm", allow_set=True)
    publisher.bind({"joint": joint})
    publisher.start(loop.now())
    print("ready", flush=True)
    while True:
        publisher.step(loop.now())
        loop.sleep_until(loop.now() + 5_000_000)
"""


@pytest.mark.slow
def test_a_controller_runs_in_another_process(endpoint: str) -> None:
    """States and set-points cross processes; when the robot's is killed, the controller's side knows nothing any more."""

    class Rise(Controller):
        def step(self, now_ns: int) -> Any:
            value: Any = self.bound["joint"][0]
            return NOTHING if value is UNKNOWN else {"joint": min(1.0, value + 0.1)}

    with subprocess.Popen(
        [sys.executable, "-c", ROBOT_PROGRAM, endpoint], stdout=subprocess.PIPE, text=True
    ) as robot:
        try:
            assert robot.stdout is not None
            assert robot.stdout.readline() == "ready\n"
            with RemoteStates(endpoint, robot="arm", lost_s=0.4) as states:
                rise = Rise("rise", rate_hz=100, states=["joint"])
                rise.bind(states)
                tasks = ThreadTasks(RealClock())
                tasks.add(rise.name, lambda now: states.give(rise.step(now)), rate_hz=100)
                with tasks:
                    assert soon(lambda: states["joint"][0] == 1.0)
                    robot.send_signal(signal.SIGKILL)
                    assert soon(lambda: states["joint"][0] is UNKNOWN)
                assert tasks.tasks[0].failures == 0
                assert soon(lambda: [event.kind for event in states.events.last][-1:] == ["lost"])
        finally:
            robot.kill()


def test_a_runner_publishes_in_virtual_time(endpoint: str) -> None:
    """A publisher is a runner's logger; set-points from elsewhere drive the virtual robot, in its own time."""
    publisher = Publisher(["A.left", "A.left.setpoint"], 50, endpoint, allow_set=True, dead_man_s=None)
    with run_virtual(robot_of(ROBOT), [], loggers=[publisher], load=drivers) as run:
        run.states["A.right"].set(0.0)
        run.start()
        with RemoteStates(endpoint, robot="fans", lost_s=5.0) as states:
            states["A.left"].set(50.0)

            def moves() -> bool:
                run.clock.wait(lambda: False, 20 * MS)
                value = states["A.left"][0]
                return value is not UNKNOWN and value > 49

            assert soon(moves)
            assert states["A.left"].unit == "rad/s"
            assert states["A.left.setpoint"].last == 50.0
        run.stop()
    assert publisher.sent > 1


@pytest.mark.slow
def test_wrong_calls_are_said(endpoint: str) -> None:
    """Nobody there, endpoints and names that cannot be, virtual time, a port that is taken: each is said with what next."""
    with pytest.raises(NoReplyError, match="there is no publisher"):
        RemoteStates(endpoint, timeout_s=0.1).open()
    with pytest.raises(CallerError, match="Endpoints must be of the form"):
        RemoteStates("here").open()
    with pytest.raises(CallerError, match="robot's name"):
        RemoteStates(endpoint, robot="a/**")
    with pytest.raises(CallerError, match="virtual time"):
        RemoteStates(endpoint, clock=VirtualClock())
    with pytest.raises(CallerError, match="rate"):
        Publisher(["X"], 0)
    with pytest.raises(CallerError, match="1 to 2000"):
        Publisher([])
    with pytest.raises(UnknownNameError, match="hop"):
        Publisher(["hop"], endpoint=endpoint).bind({})
    with pytest.raises(CallerError, match="bind"):
        Publisher(["hop"], endpoint=endpoint).start(0)
    state = State("X")
    with pytest.raises(CallerError, match="a Loop for example"):
        Publisher(["X"], endpoint=endpoint, allow_set=True).bind({"X": state})
    first, second = (Publisher(["X"], endpoint=endpoint) for _ in range(2))
    first.bind({"X": state})
    second.bind({"X": state})
    with first, pytest.raises(CallerError, match="in use"):
        second.start(0)
    first.step(0)
    assert first.sent == 1


def test_the_clock_elsewhere_is_guessed_by_the_quickest_message() -> None:
    """Messages that waited move nothing; another run's clock begins anew; a slow drift is followed."""
    local = VirtualClock(1_000_000 * MS)
    clock = RemoteClock(local, "x")
    assert (clock.now(), clock.silence_ns > 10**18) == (0, True)
    for sent, delay in ((0, 5), (10, 2), (20, 9)):
        local.sleep_until((1_000_000 + sent + delay) * MS)
        clock.received(sent * MS)
    assert clock.now() == (20 + 9 - 2) * MS
    local.advance(3 * MS)
    assert (clock.now(), clock.silence_ns) == (30 * MS, 3 * MS)
    for second in range(1, 20):  # 10 ms slower each second
        local.advance(1000 * MS)
        clock.received(30 * MS + second * 990 * MS)
    assert abs(clock.now() - (30 + 19 * 990) * MS) <= 101 * MS
    clock.sleep_until(clock.now() + 5 * MS)
    clock.forget()
    assert clock.now() == 0
