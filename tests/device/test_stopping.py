"""A stop is immediate, repeated until the device has stopped, and says which did not."""

from __future__ import annotations

from typing import Any, ClassVar

import pytest

from aces_bus import Frame
from aces_bus.device import Driver, Job, MotorDevice, Poll, Steps, Ticket
from aces_bus.device.stopping import stop_devices, wait_stopped
from aces_bus.errors import DeviceError, NotStoppedError
from aces_bus.hardware import ListeningNode
from aces_bus.robot import VirtualRobot, connect
from aces_bus.robot.rig import Rig
from tests.device.fan import ROBOT, Fan, FanTwin, robot_of

SET = 0x111


class Asked(Fan, MotorDevice[Any]):  # pyright: ignore[reportIncompatibleVariableOverride]  # a fan says less of them
    """A fan that can be asked whether it stands still, and is told so before all else."""

    actions: ClassVar = {"off": "stop both"}

    def off(self) -> Ticket:
        self.drop("Set")
        return self.send_now("Set", left=0, right=0)

    stop_motion = off

    def confirm_stopped(self) -> Job:
        def steps(job: Job) -> Steps:
            state = yield self.ask("Ask", reply="State")
            if state.left or state.right:
                raise DeviceError(f"it still turns with {state.left:g} rpm")

        return self.job("look", steps)


def load(name: str) -> Driver:
    return Driver("fan", Asked, FanTwin, ROBOT, doc="", source="invented for tests")


@pytest.fixture
def robot() -> Any:
    with VirtualRobot(robot_of(ROBOT), load=load, rate_hz=100) as made:
        made.advance(0.05)
        for name in "AB":
            made[f"{name}.left"].set(20.0)
            made[f"{name}.right"].set(20.0)
        made.advance(0.05)
        assert made.twins["A"].left > 0 < made.twins["B"].left
        yield made


def data_of(recorder: ListeningNode, identifier: int) -> list[str]:
    return [frame.data.hex() for frame in recorder.frames() if frame.arbitration_id == identifier]


def stop(robot: VirtualRobot) -> Job:
    return stop_devices(robot.clock, "fans", robot.devices.values())


def test_a_stop_leaves_at_once(robot: VirtualRobot) -> None:
    """Before anything else happens in time, every device is told; it is over when each has said that it has stopped."""
    recorder = ListeningNode(robot.wires["line"])
    began = robot.clock.now()
    job = stop(robot)
    wait_stopped(job)
    first = [
        (now - began, frame.arbitration_id) for now, frame in recorder.received if frame.data == bytes(4)
    ]
    assert [identifier for _, identifier in first[:2]] == [SET, SET + 1]
    assert first[1][0] < 1_000_000
    assert (robot.twins["A"].left, robot.twins["B"].left) == (0, 0)
    assert not any(device.is_driven for device in robot.devices.values())


def test_a_stop_says_how_far_it_is(robot: VirtualRobot) -> None:
    """Its progress is the share of the devices that have stopped."""
    robot.twins["B"].power(False)
    job = stop(robot)
    assert job.progress == 0.0
    robot.advance(0.2)
    assert job.progress == 0.5


def test_a_stop_is_repeated_until_the_device_says_so(
    robot: VirtualRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A device that misses it twice is told a third time; each time is an event."""
    missed = [2]
    send = robot.rig.hosts["line"].port.send

    def lossy(frame: Frame, *how: Any, **more: Any) -> bool:
        if frame.arbitration_id == SET and not any(frame.data) and missed[0]:
            missed[0] -= 1
            more["report"]("sent", "")  # it left, and was not heard
            return True
        return send(frame, *how, **more)

    monkeypatch.setattr(robot.rig.hosts["line"].port, "send", lossy)
    recorder = ListeningNode(robot.wires["line"])
    wait_stopped(stop(robot))
    assert robot.twins["A"].left == 0
    assert data_of(recorder, SET).count("00000000") == 1
    assert robot.events.count("not stopped", "A") == 2
    assert "it still turns" in robot.events.of("not stopped")[0].detail
    assert robot.events.count("not stopped", "B") == 0


def test_who_has_not_stopped_is_named(robot: VirtualRobot) -> None:
    """Within its bound a stop fails with the devices that have not, and why; the others have."""
    robot.twins["A"].power(False)
    began = robot.clock.now()
    why = r"^NOT switched off: A \(.*no answer to Ask.*; last received 1\.\d s ago"
    with pytest.raises(NotStoppedError, match=why) as failed:
        wait_stopped(stop(robot))
    assert robot.clock.now() - began < 2_500_000_000
    assert list(failed.value.devices) == ["A"]
    assert robot.twins["B"].left == 0


@pytest.mark.parametrize("says", ["stop", "confirm"])
def test_either_answer_is_one_of_two_devices(robot: VirtualRobot, says: str) -> None:
    """Where two devices answer as one, neither the answer to a stop nor that to a question alone confirms it."""
    device: Any = robot.devices["A"]
    if says == "stop":
        device.confirm_stopped = lambda: None
    else:
        wait_stopped(stop(robot))
        device.stop_motion = lambda: None
    device.is_double = True
    with pytest.raises(NotStoppedError, match="two devices answer as node 0x01"):
        wait_stopped(stop_devices(robot.clock, "fans", [device]))
    device.stop_motion = device.confirm_stopped = lambda: None
    wait_stopped(stop_devices(robot.clock, "fans", [device]))  # nobody was asked: nothing was said


def test_answers_to_the_program_before_are_none_of_a_second_device() -> None:
    """A board that nobody has acknowledged repeats its answers until somebody is there, and that is at the opening."""
    with VirtualRobot(robot_of(ROBOT), load=load, rate_hz=100) as robot:
        for _ in range(5):
            robot.twins["A"].answer(None)
        robot.advance(0.05)
        assert robot.events.count("duplicate reply", "A") > 3
        robot.advance(0.1)
        assert robot.events.count("two devices") == 0
        wait_stopped(stop(robot))


@pytest.mark.parametrize(("every_s", "gap_s", "is_double"), [(None, 0.6, False), (1.0, 1.0, True)])
def test_second_answers_now_and_then_are_none_of_a_second_device(
    every_s: float | None, gap_s: float, is_double: bool
) -> None:
    """A frame that a receiver gets twice now and then stops nothing; three of five rounds are two devices', however slow."""

    class Slow(Asked):
        polls = (Poll("Ask", reply="State", every_s=every_s),)

    slow = Driver("fan", Slow, FanTwin, ROBOT, doc="", source="invented for tests")
    with VirtualRobot(robot_of(ROBOT), load=lambda name: slow, rate_hz=100) as robot:
        robot.advance(1.0)
        for _ in range(4):
            robot.twins["A"].fault("twice")
            robot.advance(gap_s if every_s else 0.01)
            robot.twins["A"].fault("twice", on=False)
            robot.advance(0 if every_s else gap_s)
        assert robot.events.count("duplicate reply", "A") >= 3
        assert robot.events.count("two devices") == is_double
        stopping = stop(robot)
        robot.advance(2.5)
        assert (stopping.error is not None) is is_double


def test_a_driver_that_raises_stops_nobody_else_s_stop(
    robot: VirtualRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The fault of a driver is the reason that is told of its device."""

    def broken() -> None:
        raise ValueError("no such thing")

    monkeypatch.setattr(robot.devices["A"], "stop_motion", broken)
    with pytest.raises(NotStoppedError) as failed:
        wait_stopped(stop(robot))
    assert failed.value.devices == {"A": "ValueError: no such thing"}
    assert robot.twins["B"].left == 0


def test_what_is_told_is_over_when_it_has_left(robot: VirtualRobot) -> None:
    """A ticket without an answer waits for its frame to leave, and fails when it does not."""
    device = robot.devices["A"]
    ticket = device.send("Set", left=0, right=0)
    assert not ticket.is_over
    robot.advance(0.001)
    assert ticket.state == "done"
    port: Any = robot.rig.hosts["line"].port
    port.node.is_connected = False
    ticket = device.send("Set", left=0, right=0)
    robot.advance(0.9)
    assert not ticket.is_over
    robot.advance(0.2)
    assert "Set was not sent: it was not taken" in str(ticket.error)
    port.node.is_connected = True
    recorder = ListeningNode(robot.wires["line"])
    robot.advance(0.005)
    assert "00000000" not in data_of(recorder, SET)  # nor does it leave late


def left(world: VirtualRobot, *, drives: bool, dies: bool = False, error: Exception | None = None) -> Rig:
    """A program with a rig of its own, which ends well or raises; the rig it has left."""
    rig = connect(world.robot, world.ports("second"), rate_hz=100, load=load)
    with rig:
        world.advance(0.05)
        if drives:
            rig["A.left"].set(20.0)
            rig["A.right"].set(20.0)
            world.advance(0.05)
            assert world.twins["A"].left > 0
        if dies:
            world.twins["A"].power(False)
        rigs.append(rig)  # whatever is raised
        if error is not None:
            raise error
    return rig


rigs: list[Rig] = []


@pytest.mark.parametrize("drives", [True, False])
def test_a_rig_stops_what_it_drove_when_it_is_left(drives: bool) -> None:
    """A program that ends, or raises, within `with connect(…)` leaves nothing moving; one that only looked sends nothing."""
    with VirtualRobot(
        robot_of(ROBOT), load=load
    ) as world:  # whose own rig does not ask: two that ask see two answers
        recorder = ListeningNode(world.wires["line"])
        with pytest.raises(ZeroDivisionError):
            left(world, drives=drives, error=ZeroDivisionError())
        assert world.twins["A"].left == 0
        assert bool(data_of(recorder, SET)) is drives
        assert not data_of(recorder, SET + 1)
        left(world, drives=drives)
        assert world.twins["A"].left == 0


def test_a_rig_that_is_left_says_who_did_not_stop() -> None:
    """The end of `with` raises it, unless something else was raised: then it is an event."""
    with VirtualRobot(robot_of(ROBOT), load=load, rate_hz=100) as world:
        with pytest.raises(NotStoppedError, match="NOT switched off: A"):
            left(world, drives=True, dies=True)
        world.twins["A"].power(True)
        with pytest.raises(ZeroDivisionError):
            left(world, drives=True, dies=True, error=ZeroDivisionError())
        assert rigs[-1].events.last[-1].detail.startswith("NOT switched off: A")


def test_ctrl_c_does_not_shorten_a_stop(robot: VirtualRobot, monkeypatch: pytest.MonkeyPatch) -> None:
    """An interrupt while a stop is waited for is raised when that is over."""
    wait, left = type(robot.clock).wait, [3]

    def interrupted(clock: Any, until: Any, timeout_ns: int) -> bool:
        if left[0]:
            left[0] -= 1
            raise KeyboardInterrupt
        return wait(clock, until, timeout_ns)

    monkeypatch.setattr(type(robot.clock), "wait", interrupted)
    with pytest.raises(KeyboardInterrupt):
        wait_stopped(stop(robot))
    assert (robot.twins["A"].left, robot.twins["B"].left) == (0, 0)
