"""Controllers on a robot: the same in virtual time, on real buses and on a recording; errors; the clean end."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from aces_bus import Frame
from aces_bus.controller import IGNORE, Controller, controller
from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.hardware import CanGate, ListeningNode
from aces_bus.hardware.ports import port_of
from aces_bus.robot import VirtualRobot, connect, parse_robot, run_real, run_replay, run_virtual
from aces_bus.robot.rig import simulate
from aces_bus.runtime.loop import Loop
from aces_devices.dynamixel import EXAMPLE as DYNAMIXEL
from tests.device.fan import ROBOT, drivers, robot_of

SPEEDS = ["A.left", "A.right", "B.left", "B.right"]


def follower(name: str = "follow", goal: float = 100.0) -> Any:
    @controller(name=name, rate_hz=50, states=SPEEDS, writes=SPEEDS)
    def follow(states: Any) -> Mapping[str, float]:
        return dict.fromkeys(SPEEDS, goal)

    return follow


def test_a_controller_runs_in_virtual_time() -> None:
    """A controller's set-points reach the twins, what is measured comes back, and at the end all is stopped."""
    run = run_virtual(robot_of(ROBOT), [follower()], load=drivers)
    with run:
        assert run.missing == []
        target = run.states["A.left.setpoint"]
        run.start()
        run.clock.wait(lambda: False, 500_000_000)
        assert run.states["A.left"][0] == pytest.approx(100, abs=0.1)
        assert target[0] == 100.0
        assert run.world.twins["B"].right > 900
        ended = run.stop()
        assert ended.reason == ""
        assert ended.tripped == {}
    assert run.world.twins["B"].right == 0


def test_the_same_seed_is_the_same_run() -> None:
    """Two runs of the same robot, seed and controllers put the same frames on the wire at the same instants."""

    def frames() -> list[Any]:
        robot = VirtualRobot(robot_of(ROBOT), rate_hz=100, seed=3, load=drivers)
        recorder = ListeningNode(robot.wires["line"])
        run_virtual(robot, [follower()]).run(0.3)
        return list(recorder.received)

    assert frames() == frames()


@pytest.mark.slow
def test_one_controller_runs_on_real_buses_too() -> None:
    """The same controller, unchanged, drives twins at a bus of this machine in real time, on threads."""
    robot = robot_of(ROBOT)
    options = {"interface": "aces", "channel": "test-runner", "bitrate": 500_000}
    with Loop() as loop, simulate(robot, {"line": port_of(CanGate(options), loop)}, load=drivers) as twins:
        run = run_real(
            robot,
            [follower()],
            buses={"line": options},
            transmit=True,
            load=drivers,
            reactions={"*": IGNORE},  # a busy machine is not a fault
        )
        ended = run.run(60.0, until=lambda: twins["A"].left > 900)  # type: ignore[attr-defined]
        assert ended.seconds < 60
        assert run.tasks.tasks[0].ticks >= 1
        assert loop.wait(lambda: twins["A"].left == 0, 20_000_000_000)  # type: ignore[attr-defined]


def test_a_recording_takes_the_robots_place() -> None:
    """A replay feeds the states from recorded frames; set-points are counted and go nowhere."""
    robot = VirtualRobot(robot_of(ROBOT), rate_hz=100, load=drivers)
    recorder = ListeningNode(robot.wires["line"])
    run_virtual(robot, [follower(goal=50.0)]).run(0.4)
    frames = [Frame(f.arbitration_id, f.data, instant / 1e9, "can0") for instant, f in recorder.received]
    seen: list[float] = []

    class Watch(Controller):
        def step(self, now_ns: int) -> Mapping[str, float]:
            seen.append(self.bound["A.left"][0])
            return {"A.left": 1.0}

    run = run_replay(robot_of(ROBOT), frames, [Watch("watch", rate_hz=50, states=["A.left"])], load=drivers)
    run.run(10.0, until=lambda: run.world.is_over)
    assert max(value for value in seen if value) == pytest.approx(50, abs=0.1)
    assert run.set_points > 10
    assert run.seconds == 0


def test_a_silent_device_stops_motion_with_the_reason() -> None:
    """A device that falls silent reaches the handler within a cycle, motion stops, and the end names it."""
    told: list[Any] = []

    class Handler(Controller):
        def step(self, now_ns: int) -> Mapping[str, float]:
            return dict.fromkeys(SPEEDS, 100.0)

        def handle(self, event: Any) -> None:
            told.append(event)

    run = run_virtual(robot_of(ROBOT), [Handler("walk", rate_hz=50, writes=SPEEDS)], load=drivers)
    with run:
        run.start()
        run.clock.wait(lambda: False, 300_000_000)
        run.world.twins["A"].fault("silent")
        run.clock.wait(lambda: False, 400_000_000)
        assert [event.kind for event in told] == ["silent"]
        assert run.world.twins["B"].left == 0
        ended = run.stop()
    assert "silent" in ended.tripped["walk"]


def test_a_controller_that_raises_is_stopped_and_named() -> None:
    """An exception in a controller stops motion, and the run ends by itself, telling what it was."""

    class Bad(Controller):
        def step(self, now_ns: int) -> Mapping[str, float]:
            if self.seconds(now_ns) > 0.2:
                raise ValueError("off the rails")
            return dict.fromkeys(SPEEDS, 100.0)

    run = run_virtual(robot_of(ROBOT), [Bad("bad", rate_hz=50, writes=SPEEDS)], load=drivers)
    ended = run.run(60.0)
    assert ended.seconds < 1
    assert "ValueError: off the rails" in ended.tripped["bad"]
    assert run.world.twins["A"].left == 0


def test_wrong_names_are_found_before_anything_moves() -> None:
    """Unknown states and set-points for what is read-only are refused when the run begins."""
    bad = follower()

    @controller(rate_hz=50, states=["A.lift"])
    def lift(states: Any) -> Mapping[str, float]:
        return {}

    @controller(rate_hz=50, writes=["A.temperature"])
    def heat() -> Mapping[str, float]:
        return {"A.temperature": 1.0}

    for one, error in ((lift, UnknownNameError), (heat, CallerError)):
        run = run_virtual(robot_of(ROBOT), [one], load=drivers)
        with pytest.raises(error, match=r"lift|read-only"):
            run.run(1.0)
        run.stop()
    with pytest.raises(CallerError, match="one name"):
        run_virtual(robot_of(ROBOT), [bad, bad], load=drivers)


def test_bus_off_reaches_the_supervisor() -> None:
    """What happens to the bus itself stops motion too."""
    reactions = {"error-passive": IGNORE}
    run = run_virtual(robot_of(ROBOT), [follower()], load=drivers, reactions=reactions)
    with run:
        run.start()
        run.clock.wait(lambda: False, 200_000_000)
        port: Any = run.rig.hosts["line"].port
        node = port.node
        for _ in range(40):
            node.count_errors(8, 0, Frame(1))
        run.clock.wait(lambda: False, 300_000_000)
        ended = run.stop()
    assert "bus-off" in ended.tripped["follow"]


def test_real_ports_serve_a_rig() -> None:
    """`connect` takes any ports: here gates of this machine's virtual bus, closed again without a thread left."""
    import threading

    before = threading.active_count()
    robot = robot_of(ROBOT)
    options = {"interface": "aces", "channel": "test-rig"}
    with Loop() as loop, connect(robot, {"line": port_of(CanGate(options), loop)}, rate_hz=100, load=drivers):
        pass
    assert threading.active_count() <= before


@pytest.mark.parametrize(
    ("rate_hz", "why"),
    [
        (1, "D1: it would be sent something every 1 s, and stops by itself after 0.5 s"),
        (1e5, "bus line: 100000 Hz are"),
    ],
)
def test_a_rate_that_cannot_be_is_refused(rate_hz: float, why: str) -> None:
    """At the start: one that does not feed a device's own watchdog, and one that its bus cannot carry."""
    robot = parse_robot(DYNAMIXEL)[0]
    assert robot is not None
    run = run_virtual(robot, [], rate_hz=rate_hz)
    with pytest.raises(CallerError, match=why):
        run.open()
