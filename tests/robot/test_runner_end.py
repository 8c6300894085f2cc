# A command is given behind the runner's back.
# pyright: reportPrivateUsage=false
"""How runs end, whatever goes wrong: who is stopped, in which order, what is told, and that nothing hangs."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import pytest

from aces_bus import load_robot
from aces_bus.controller import IGNORE, Controller, Guard, Supervisor, stop
from aces_bus.controller.reactions import Reaction
from aces_bus.device import Job, Steps
from aces_bus.errors import CallerError, DeviceError, NotStoppedError
from aces_bus.hardware import CanGate
from aces_bus.hardware.ports import port_of
from aces_bus.robot import Runner, run_real, run_virtual
from aces_bus.robot.rig import simulate
from aces_bus.runtime import VirtualClock
from aces_bus.runtime.loop import Loop
from tests.device.fan import ROBOT, drivers, robot_of
from tests.interpreted import replaces_methods

#: On a busy machine other signs of trouble come before the one that is meant.
CALM: Mapping[str, Reaction] = {"*": IGNORE}
SPEEDS = ["A.left", "A.right", "B.left", "B.right"]


class Drive(Controller):
    """Gives one speed to all fans; `during(now)` is called in each step."""

    def __init__(self, during: Any = None, goal: float = 100.0, writes: list[str] = SPEEDS) -> None:
        super().__init__("drive", rate_hz=50, writes=writes)
        self.during, self.goal = during, goal

    def step(self, now_ns: int) -> Mapping[str, float]:
        if self.during is not None:
            self.during(now_ns)
        return dict.fromkeys(self.writes, self.goal)


class Log:
    """A logger that notes what is done with it, and fails where it is told to."""

    name, rate_hz, states = "log", 50.0, ("A.left",)

    def __init__(self, fails: str = "") -> None:
        self.fails, self.did, self.rows = fails, list[str](), 0

    def _do(self, what: str) -> None:
        self.did.append(what)
        if what == self.fails:
            raise OSError(28, "no space left on device")

    def bind(self, states: Mapping[str, Any]) -> None:
        self.state = states["A.left"]

    def start(self, now: int) -> None:
        self._do("start")

    def step(self, now: int) -> None:
        self.rows += 1
        self._do("step")

    def stop(self, now: int) -> None:
        self._do("stop")


@pytest.mark.slow
def test_a_controller_that_does_not_come_back_is_stopped() -> None:
    """On threads, the buses' thread finds a step that hangs, stops its devices and ends the run, with the reason."""
    robot = robot_of(ROBOT)
    options = {"interface": "aces", "channel": "test-hang", "bitrate": 500_000}
    release = threading.Event()
    with Loop() as loop, simulate(robot, {"line": port_of(CanGate(options), loop)}, load=drivers) as twins:

        def hang(now: int) -> None:
            if twins["A"].left > 0:  # type: ignore[attr-defined]
                release.wait(20)

        calm = {**CALM, "dead-man": stop()}
        run = run_real(
            robot, [Drive(hang)], buses={"line": options}, transmit=True, load=drivers, reactions=calm
        )
        run.handlers.append(lambda event: release.set() if event.kind == "trip" else None)
        ended = run.run(20.0)
        assert "has not come back" in ended.tripped["drive"]
        assert loop.wait(lambda: twins["A"].left == 0, 20_000_000_000)  # type: ignore[attr-defined]
    assert ended.failed == []


def test_states_are_bound_once() -> None:
    """Bound before the buses are opened, a controller is not bound again at the start."""
    bound: list[str] = []

    class Bound(Drive):
        def bind(self, states: Mapping[str, Any]) -> None:
            bound.append(self.name)
            super().bind(states)

    run = run_virtual(robot_of(ROBOT), [Bound()], load=drivers)
    run.bind()
    with run:
        run.run(0.1)
    assert bound == ["drive"]


def test_the_end_goes_on_whatever_fails() -> None:
    """A driver, a controller and a log that fail at the end are told, and keep nobody else from being stopped."""

    class Sour(Drive):
        def stop(self, now: int) -> None:
            raise RuntimeError("not now")

    logs = [Log("stop"), Log()]
    logs[1].name = "other"
    run = run_virtual(robot_of(ROBOT), [Sour()], load=drivers, loggers=logs)
    with run:
        run.start()
        run.clock.wait(lambda: False, 200_000_000)

        def broken() -> None:
            raise ValueError("no such thing")

        run.rig.devices["A"].stop_motion = broken  # type: ignore[method-assign]
        assert run.world.twins["B"].left > 0
        ended = run.stop("enough")
    assert run.world.twins["B"].left == 0
    assert [text.partition(":")[0] for text in ended.failed] == ["drive", "A", "log"]
    assert "no such thing" in ended.failed[1]
    assert logs[1].did[-1] == "stop"
    assert ended.reason == "enough"
    assert run.stop("again") is not ended
    assert logs[1].did.count("stop") == 1


def test_the_order_of_the_end() -> None:
    """Motion, controllers, buses, logs: in this order, each once; no stop waits for a controller."""
    order: list[str] = []

    class Last(Drive):
        def stop(self, now: int) -> None:
            order.append("controller")

    class Book(Log):
        def stop(self, now: int) -> None:
            order.append("log")

    run = run_virtual(robot_of(ROBOT), [Last()], load=drivers, loggers=[Book()])
    run.after.append(lambda: order.append("buses"))

    def noted(stop_motion: Any) -> Any:
        def do() -> Any:
            order.append("motion")
            return stop_motion()

        return do

    for device in run.rig.devices.values():
        device.stop_motion = noted(device.stop_motion)  # type: ignore[method-assign]
    run.run(0.2)
    assert order == ["motion", "motion", "controller", "buses", "log"]


def test_an_interrupt_ends_it_and_comes_out() -> None:
    """KeyboardInterrupt in a controller or at the end passes on, after motion was stopped and the log closed."""

    def interrupt(now: int) -> None:
        if now > 300_000_000:
            raise KeyboardInterrupt

    log = Log()
    run = run_virtual(robot_of(ROBOT), [Drive(interrupt)], load=drivers, loggers=[log])
    with pytest.raises(KeyboardInterrupt):
        run.run(10.0)
    assert run.world.twins["A"].left == 0
    assert log.did[-1] == "stop"
    assert run.ended().reason == "KeyboardInterrupt"


def test_what_a_log_cannot_take_stops_no_robot() -> None:
    """A log that raises in each step is told of once a second, and motion goes on; unless it is declared otherwise."""
    run = run_virtual(robot_of(ROBOT), [Drive()], load=drivers, loggers=[Log("step")])
    ended = run.run(1.5)
    told = [event for event in run.events if event.kind == "log-failed"]
    assert (len(told), ended.tripped) == (2, {})
    assert "no space left" in told[0].detail
    run = run_virtual(
        robot_of(ROBOT), [Drive()], load=drivers, loggers=[Log("step")], reactions={"log-failed": stop()}
    )
    ended = run.run(1.5)
    assert "no space left" in ended.tripped["drive"]
    assert ended.seconds < 0.1


def test_a_log_that_cannot_begin_ends_the_run() -> None:
    """What starting a log raises comes out, with all closed again."""
    logs = [Log(), Log("start")]
    logs[1].name = "other"
    run = run_virtual(robot_of(ROBOT), [Drive()], load=drivers, loggers=logs)
    with pytest.raises(OSError, match="no space"):
        run.run(1.0)
    assert logs[0].did == ["start", "stop"]
    assert run.world.twins["A"].left == 0


def test_a_bus_that_cannot_be_opened_is_named_and_leaves_nothing_behind() -> None:
    """The error names the bus; no thread stays."""
    before = threading.active_count()
    options = {"interface": "aces", "channel": "unix:/no/such.sock", "bitrate": 500_000}
    run = run_real(robot_of(ROBOT), [Drive()], buses={"line": options}, transmit=True, load=drivers)
    with pytest.raises(CallerError, match="bus line"):
        run.run(1.0)
    assert threading.active_count() == before


def test_missing_devices_are_named() -> None:
    """A device that never answers is among `missing`; the others are not."""
    run = run_virtual(robot_of(ROBOT), [Drive()], load=drivers)
    run.world.simulation["B"].fault("silent")
    with run:
        assert run.missing == ["B"]
        assert run.clock.now() / 1e9 == pytest.approx(5.0, abs=0.1)


def test_a_bus_that_cannot_be_closed_is_named_and_holds_up_no_other() -> None:
    """Each bus is closed for itself, within a time of its own."""
    run = run_virtual(load_robot("hubo2plus").part("RHP", "RSP"), [])
    run.open()
    lower, upper = run.rig.hosts.values()

    def hang() -> None:
        raise TimeoutError("not over after 2 s")

    lower.close = hang  # type: ignore[method-assign]
    ended = run.stop()
    assert [text.partition(" (")[0] for text in ended.failed] == [
        "bus lower: TimeoutError: not over after 2 s"
    ]
    assert not upper.is_open


def test_set_points_after_the_end_go_nowhere() -> None:
    """A step that ends after the run sets nothing: what was stopped stays so."""
    run = run_virtual(robot_of(ROBOT), [Drive()], load=drivers)
    run.run(0.2)
    supervisor = run.supervisors[0]
    run._pass_on(supervisor, run.clock.now(), {"A.left": 200.0})
    assert not run.rig.devices["A"]._given


def test_what_a_guard_changes_is_among_the_events() -> None:
    """Set-points that are clipped are told, and counted by state."""

    class Wild(Drive):
        def step(self, now_ns: int) -> Mapping[str, float]:
            return {"A.left": float("nan"), "A.right": 50.0}

    run = run_virtual(robot_of(ROBOT), [Wild()], load=drivers)
    run.run(0.2)
    assert "not finite" in {event.kind for event in run.events}
    assert run.supervisors[0].guard.clips["A.left"].not_finite == 5


def test_only_what_a_controller_drives_is_enabled() -> None:
    """`do` takes those devices that are named, and says which were able."""
    run = run_virtual(robot_of(ROBOT), [Drive(writes=["A.left"])], load=drivers)
    with run:
        driven = run.driven(run.supervisors[0])
        assert [device.name for device in driven] == ["A"]
        assert run.do("off", devices=driven) == ["A"]
        assert run.do("fly") == []


def test_what_is_left_by_an_exception_raises_that_and_not_the_stop() -> None:
    """Leaving a run with a device that did not stop says so, unless the program raised itself or has had it said."""

    def never() -> None:
        raise ValueError("no such thing")

    def left(ending: Any) -> None:
        with run_virtual(robot_of(ROBOT), [Drive()], load=drivers) as run:
            run.start()
            run.clock.wait(lambda: False, 100_000_000)
            run.rig.devices["A"].stop_motion = never  # type: ignore[method-assign]
            ending(run)

    def fails(run: Any) -> None:
        raise ZeroDivisionError("by zero")

    with pytest.raises(NotStoppedError, match="no such thing"):
        left(lambda run: None)
    with pytest.raises(ZeroDivisionError):
        left(fails)
    left(lambda run: run.stop())


def test_a_released_controller_is_no_longer_stopped() -> None:
    """What a trip has switched off counts as stopped until it is released."""
    run = run_virtual(robot_of(ROBOT), [Drive()], load=drivers)
    with run:
        run.start()
        run.clock.wait(lambda: False, 100_000_000)
        run.supervisors[0].guard.trip("by hand", "disable")
        run.clock.wait(lambda: False, 40_000_000)
        assert run.stopped == {"drive": "by hand"}
        run.release("drive")
        assert run.stopped == {}


def test_a_step_that_does_not_come_back_is_found_without_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """The buses' thread looks by itself: it names how long the step has taken, once, and looks no more after the end."""
    run = run_virtual(robot_of(ROBOT), [Drive()], load=drivers)
    with run:
        run.start()
        run.clock.wait(lambda: False, 100_000_000)
        run.tasks.stop()
        run._faults.inside["drive"] = run.clock.now()
        run._faults.watch()
        assert run.stopped == {}
        run.clock.wait(lambda: False, 300_000_000)
        assert "its step has not come back for 0.1" in run.stopped["drive"]
        assert run.supervisors[0].counts["dead-man"] == 1
        assert run.world.twins["A"].left == 0
    planned: list[Any] = []
    monkeypatch.setattr(
        run._run, "clock", SimpleNamespace(now=run.clock.now, call_in=lambda *what: planned.append(what))
    )
    run._faults.watch()
    assert planned == []


@pytest.mark.parametrize(("rate_hz", "seconds"), [(10.0, 0.5), (200.0, 0.1)])
def test_a_controller_is_dead_after_five_periods_and_a_tenth_of_a_second(
    rate_hz: float, seconds: float
) -> None:
    """One that gives nothing any more is stopped after the longer of the two."""

    class Quiet(Drive):
        def step(self, now_ns: int) -> Mapping[str, float]:
            if now_ns - run._run.began > 1_000_000_000:
                return {}
            given.append(now_ns)
            return super().step(now_ns)

    given: list[int] = []
    quiet = Quiet()
    quiet.rate_hz = rate_hz
    run = run_virtual(robot_of(ROBOT), [quiet], load=drivers, reactions={**CALM, "dead-man": stop()})
    run.run(5.0)
    trip = next(event for event in run.events if event.kind == "trip")
    assert (trip.instant - given[-1]) / 1e9 == pytest.approx(seconds, abs=1.1 / rate_hz)


def test_a_run_without_an_end_and_without_events_says_so() -> None:
    """Virtual time in which nothing is planned would never pass: the error says what to give."""
    with pytest.raises(CallerError, match="pass `seconds` or `until`"):
        Runner._let_pass(Still(), lambda: False, 1 << 62)  # type: ignore[arg-type]
    still = Still()
    Runner._let_pass(still, lambda: False, 5_000_000)  # type: ignore[arg-type]
    assert still.clock.now() == 5_000_000


class Still:
    """A run in which nothing is planned."""

    def __init__(self) -> None:
        self.clock = VirtualClock()


def test_an_action_has_a_minute() -> None:
    """`do` waits a minute for what never ends, and as long as it is told."""

    def spin(job: Job) -> Steps:
        yield 1 << 60

    run = run_virtual(robot_of(ROBOT), [Drive()], load=drivers)
    with run:
        device = run.rig.devices["A"]
        device.off = lambda: Job(run.clock, "spin", spin)  # type: ignore[attr-defined]
        for given, seconds in (((), 60.0), ((2.0,), 2.0)):
            began = run.clock.now()
            with pytest.raises(DeviceError, match="not over"):
                run.do("off", *given, devices=["A"])
            assert (run.clock.now() - began) / 1e9 == pytest.approx(seconds, abs=0.1)
        del device.off  # type: ignore[attr-defined]


@pytest.mark.slow
def test_steps_are_given_the_instants_that_they_were_due() -> None:
    """However late a thread wakes, the instants of a controller's steps are whole periods apart."""
    seen: list[int] = []
    robot = robot_of(ROBOT)
    options = {"interface": "aces", "channel": "test-due", "bitrate": 500_000}
    with Loop() as loop, simulate(robot, {"line": port_of(CanGate(options), loop)}, load=drivers):
        run = run_real(
            robot, [Drive(seen.append)], buses={"line": options}, transmit=True, load=drivers, reactions=CALM
        )
        run.run(60.0, until=lambda: len(seen) > 6)
    assert {(b - a) % 20_000_000 for a, b in pairwise(seen)} == {0}


@pytest.mark.slow
def test_what_raises_on_the_buses_thread_stops_motion() -> None:
    """A driver's fault is told as "bug" with what it was, and ends the run."""
    robot = robot_of(ROBOT)
    options = {"interface": "aces", "channel": "test-bug", "bitrate": 500_000}
    with Loop() as loop, simulate(robot, {"line": port_of(CanGate(options), loop)}, load=drivers):
        calm = {**CALM, "bug": stop()}
        run = run_real(robot, [Drive()], buses={"line": options}, transmit=True, load=drivers, reactions=calm)

        def broken(record: Any, instant: int) -> None:
            if run.set_points:
                raise RuntimeError("off by one")

        run.rig.devices["A"].received = broken  # type: ignore[method-assign]
        ended = run.run(60.0)
    assert ended.tripped["drive"].startswith("buses: bug: RuntimeError: off by one (")


def test_what_the_buses_raise_is_told_once_with_its_kind() -> None:
    """Told by the runner: a "bug" of the buses, whose reaction ends the run; a second at once is not another."""
    run = run_virtual(robot_of(ROBOT), [Drive()], load=drivers, reactions={**CALM, "bug": stop()})

    def broken(now_ns: int) -> None:
        if run.set_points:
            run.bus_failed(RuntimeError("off by one"))
            run.bus_failed(RuntimeError("off by two"))

    run.supervisors[0].controller.during = broken  # type: ignore[attr-defined]
    ended = run.run(60.0)
    assert ended.tripped["drive"].startswith("buses: bug: RuntimeError: off by one")
    assert [(e.source, e.kind) for e in run.events if e.kind == "bug"] == [("buses", "bug")]


@pytest.mark.slow
def test_users_code_is_never_on_a_receive_thread() -> None:
    """Steps run on their controller's thread, handlers on that of the buses; neither on a gate's."""
    threads: dict[str, set[str]] = {"step": set(), "handle": set()}

    class Where(Drive):
        def step(self, now_ns: int) -> Mapping[str, float]:
            threads["step"].add(threading.current_thread().name)
            return super().step(now_ns)

        def handle(self, event: Any) -> None:
            threads["handle"].add(threading.current_thread().name)

    robot = robot_of(ROBOT)
    options = {"interface": "aces", "channel": "test-threads", "bitrate": 500_000}
    with (
        Loop("twins") as loop,
        simulate(robot, {"line": port_of(CanGate(options), loop)}, load=drivers) as twins,
    ):

        def silence(now: int) -> None:
            if twins["A"].left > 0:  # type: ignore[attr-defined]
                twins["A"].fault("silent")

        calm = {**CALM, "silent": stop()}
        run = run_real(
            robot, [Where(silence)], buses={"line": options}, transmit=True, load=drivers, reactions=calm
        )
        ended = run.run(60.0)
    assert "silent" in ended.tripped["drive"]
    assert threads == {"step": {"drive"}, "handle": {"aces loop"}}


@pytest.mark.slow
def test_every_deadline_is_a_step_or_missed() -> None:
    """On threads, what a slow controller left out is counted, to the last deadline before the end."""
    robot = robot_of(ROBOT)
    options = {"interface": "aces", "channel": "test-count", "bitrate": 500_000}
    with Loop() as loop, simulate(robot, {"line": port_of(CanGate(options), loop)}, load=drivers):
        run = run_real(
            robot,
            [Drive(lambda now: threading.Event().wait(0.05))],
            buses={"line": options},
            transmit=True,
            load=drivers,
            reactions=CALM,
        )
        (task,) = run.tasks.tasks
        ended = run.run(60.0, until=lambda: task.missed > 20)
    assert task.missed > 20
    # On a busy machine some time passes between the last tick and the end.
    assert abs(task.ticks + task.missed - 1 - 50 * ended.seconds) <= 15


@replaces_methods
@pytest.mark.parametrize("second", [KeyboardInterrupt(), RuntimeError("no room")], ids=["Ctrl-C", "error"])
def test_a_stop_that_cannot_begin_names_every_device(
    monkeypatch: pytest.MonkeyPatch, second: BaseException
) -> None:
    """A stop that was interrupted is begun once more; where that fails too, every device counts as not stopped."""
    raised = [KeyboardInterrupt(), second]

    def interrupted(*_: Any) -> Any:
        raise raised.pop(0)

    log = Log()
    run = run_virtual(robot_of(ROBOT), [Drive()], load=drivers, loggers=[log])
    run.open()
    run.start()
    run.world.clock.advance(100_000_000)
    monkeypatch.setattr("aces_bus.robot.run_end.stop_devices", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run.stop()
    assert raised == []
    assert run.ended().not_stopped == dict.fromkeys(["A", "B"], "its stop could not begin")
    assert log.did[-1] == "stop"
    assert not run.rig.hosts["line"].is_open


@replaces_methods
def test_a_stop_that_cannot_be_waited_for_names_every_device(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where its end is not known, every device counts as not stopped, with the reason, and "stop" has failed."""

    def lost(_: Any) -> None:
        raise DeviceError("the buses' thread is gone")

    run = run_virtual(robot_of(ROBOT), [Drive()], load=drivers)
    run.open()
    run.start()
    run.world.clock.advance(100_000_000)
    monkeypatch.setattr("aces_bus.robot.run_end.wait_stopped", lost)
    run.stop()
    assert run.ended().not_stopped == dict.fromkeys(["A", "B"], "the buses' thread is gone")
    assert "stop: the buses' thread is gone" in run.ended().failed


@replaces_methods
def test_a_stop_that_was_interrupted_is_begun_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C while a stop begins comes out, and nobody counts as not stopped who was stopped after it."""
    from aces_bus.device.stopping import stop_devices

    raised = [KeyboardInterrupt()]

    def interrupted(*arguments: Any) -> Any:
        if raised:
            raise raised.pop()
        return stop_devices(*arguments)

    run = run_virtual(robot_of(ROBOT), [Drive()], load=drivers)
    run.open()
    run.start()
    run.world.clock.advance(100_000_000)
    assert run.world.twins["A"].left > 0
    monkeypatch.setattr("aces_bus.robot.run_end.stop_devices", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run.stop()
    assert (raised, run.ended().not_stopped) == ([], {})
    assert run.world.twins["A"].left == 0


def test_a_run_that_was_never_opened_has_nothing_to_stop() -> None:
    """Its end sends nothing, and names no device as not stopped."""
    run = run_virtual(robot_of(ROBOT), [Drive()], load=drivers)
    run.stop()
    assert (run.ended().failed, run.ended().not_stopped) == ([], {})
    assert run.clock.now() == 0


def test_a_bus_that_says_itself_why_it_cannot_be_opened_is_not_reworded() -> None:
    """An error of ours comes out as it is, with its class and text."""
    run = run_virtual(robot_of(ROBOT), [Drive()], load=drivers)

    def refuse(*, is_started: bool = False) -> None:
        raise DeviceError("line: another program drives it")

    run.rig.hosts["line"].open = refuse  # type: ignore[method-assign]
    with pytest.raises(DeviceError, match=r"^line: another program drives it$"):
        run.open()


def test_a_supervisor_s_own_dead_man_stays() -> None:
    """A program that has set the time after which its controller is dead keeps it; without one the run sets one."""
    for given, expected in ((0.7, 700_000_000), (None, 100_000_000)):
        supervisor = Supervisor(Drive(), Guard({}, period_s=0.02), dead_man_s=given)
        run = run_virtual(robot_of(ROBOT), [supervisor], load=drivers)
        assert run.supervisors == [supervisor]
        assert supervisor.dead_man_ns == expected


def test_a_forgotten_end_raises_for_what_was_not_stopped() -> None:
    """At the interpreter's exit nobody reads how the run ended: a device that did not stop is raised."""
    run = run_virtual(robot_of(ROBOT), [Drive()], load=drivers)
    run.open()
    run.start()
    run.world.clock.advance(100_000_000)

    def never() -> None:
        raise ValueError("no such thing")

    run.rig.devices["A"].stop_motion = never  # type: ignore[method-assign]
    with pytest.raises(NotStoppedError, match="no such thing"):
        run._end_at_exit()


def test_a_trip_is_obeyed_once() -> None:
    """Looked at again and again, a trip has its devices stopped once, and none where nothing has tripped."""
    run = run_virtual(robot_of(ROBOT), [Drive()], load=drivers, reactions={**CALM, "dead-man": stop()})
    stopped: list[str] = []
    with run:
        run.start()
        faults, supervisor = run._faults, run.supervisors[0]
        faults._stop = lambda name, devices: stopped.append(name)  # type: ignore[method-assign]
        faults.obey(supervisor)
        assert stopped == []
        supervisor.emit_dead(run.clock.now(), "on purpose")
        faults.obey(supervisor)
        faults.obey(supervisor)
        assert stopped == ["drive"]
        assert "on purpose" in faults.stopped["drive"]
