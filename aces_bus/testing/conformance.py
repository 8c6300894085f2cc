"""What every driver and twin must do, as tests: one line gives them all.

    from aces_bus.testing.conformance import driver_tests
    test_fan = driver_tests("fan")

1. Driver and twin meet on a virtual bus only, as they would on a real one; nothing is looked up inside them.
2. Each check is one sentence, on each device of the driver's example robot; what a driver is excused from is said with a
   reason in `excused`.
"""

from __future__ import annotations

import hashlib
import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any, Final

from ..device import UNKNOWN, Device, Driver, Job, Robot, Twin, load_driver
from ..device.host import Host
from ..device.signals import Signal
from ..device.ticket import Awaited
from ..errors import AcesError, DeviceError, SpecError, UnknownNameError
from ..hardware.simulated.bus import NO_FAULTS, Faults, ListeningNode, SimulatedBus
from ..hardware.simulated.serial_line import Noise
from ..robot.buses import VirtualRobot
from ..robot.file import parse_robot
from ..robot.rig import simulate

#: Seconds of virtual time in which whatever is polled must have been received.
SETTLE_S = 3.0


class TestBench:
    """A driver's example robot on virtual wires, ready to be looked at."""

    def __init__(
        self, driver: Driver, example: str, load: Callable[[str], Driver], excused: Mapping[str, str]
    ) -> None:
        self.driver, self.load, self.excused = driver, load, excused
        robot, problems = parse_robot(example, f"{driver.name}.toml")
        errors = [str(problem) for problem in problems if not problem.is_warning]
        if robot is None or errors:
            raise SpecError("\n".join(errors))
        self.robot: Robot = robot

    def made(self, *, seed: int = 1, faults: Faults = NO_FAULTS, noise: Noise | None = None) -> VirtualRobot:
        """Return the robot, not open yet."""
        return VirtualRobot(
            self.robot,
            rate_hz=self.robot.rate_hz or 50,
            seed=seed,
            load=self.load,
            faults=dict.fromkeys(self.robot.buses, faults),
            noise={} if noise is None else dict.fromkeys(self.robot.buses, noise),
        )

    def is_excused(self, check: str, name: str) -> bool:
        """Return whether a signal, action or device is excused from a check: a pattern "check: name" or "name"."""
        return any(
            fnmatchcase(name, pattern) or fnmatchcase(f"{check}: {name}", pattern) for pattern in self.excused
        )

    def mine(self, robot: VirtualRobot) -> list[tuple[Device, Twin]]:
        """Return the devices of this driver, with their twins."""
        return [
            (device, robot.twins[name])
            for name, device in robot.devices.items()
            if device.config.driver == self.driver.name
        ]


def known_signals(device: Device) -> list[Signal]:
    """Return the signals of a device that have been received at all."""
    return [signal for signal in device.signals.values() if signal.instant is not None]


def enable(robot: VirtualRobot) -> None:
    """Bring every device to where it follows set-points."""
    job = robot.rig.each("enable")
    job.wait(60)


def finish(started: Any, seconds: float = 120.0) -> None:
    """Let a ticket or job end. A `DeviceError` is an answer too; a job that never ends is not."""
    if isinstance(started, Awaited):
        try:
            started.wait(seconds)
        except DeviceError:
            assert started.is_over, f"{started!r} never ends"


# ---------------------------------------------------------------------- the checks


def check_declared(stand: TestBench) -> None:
    """Check that the driver says its kind and its sources; that its signals and actions have names and docs."""
    driver = stand.driver
    assert driver.doc, f"{driver.name} has no doc"
    assert driver.source, f"{driver.name} has no source"
    robot = stand.made()
    for device, _ in stand.mine(robot):
        for signal in device.signals.values():
            owner, _, name = signal.name.partition(".")
            assert owner, f"{signal.name} is not OWNER.name"
            assert name, f"{signal.name} is not OWNER.name"
            if signal.lower is not None and signal.upper is not None:
                assert signal.lower < signal.upper, f"{signal.name} has limits {signal.lower}…{signal.upper}"
        for action, doc in device.actions.items():
            assert callable(getattr(device, action, None)), f"{device.name} has no method {action}"
            assert doc, f"action {action} has no doc"


def check_quiet_before(stand: TestBench) -> None:
    """Check that nothing moves when a bus is opened: joints stay where they are until they are enabled and set."""
    with stand.made() as robot:
        joints = robot.simulation.world.joints
        robot.advance(0.01)
        before = {name: joint.position(robot.clock.now()) for name, joint in joints.items()}
        robot.advance(1.0)
        for name, joint in joints.items():
            moved = joint.position(robot.clock.now()) - before[name]
            assert abs(moved) < 1e-6, f"{name} moved by {moved} without a command"


def check_received(stand: TestBench) -> None:
    """Check that every signal that is read is known and finite soon after the bus was opened, and stays fresh."""
    with stand.made() as robot:
        robot.advance(SETTLE_S)
        for device, _ in stand.mine(robot):
            for signal in device.signals.values():
                if signal.name not in device.readable or stand.is_excused("received", signal.name):
                    continue
                assert signal.instant is not None, (
                    f"{signal.name} was never received: does an answer to a poll have it?"
                )
                assert signal.value is not UNKNOWN, (
                    f"{signal.name} is {signal.last!r} and stale: {(signal.age_ns or 0) / 1e9:.3f} s old, fresh for"
                    f" {(signal.stale_after_ns or 0) / 1e9:g} s; poll it more often, or say stale_s="
                )
                if isinstance(signal.value, float):
                    assert math.isfinite(signal.value), signal
        kinds = {event.kind for event in robot.events.last}
        assert not kinds & {
            "silent",
            "no reply",
            "duplicate reply",
            "two devices",
            "unknown device",
            "malformed",
            "garbled",
            "bug",
        }, list(robot.events.last)


def check_set(stand: TestBench) -> None:
    """Check that every signal that can be set is set: the twin receives it, and the reading goes there."""
    with stand.made() as robot:
        robot.advance(1.0)
        enable(robot)
        _hold_off(robot, stand)
        for device, twin in stand.mine(robot):
            goals: dict[str, tuple[Any, Any]] = {}
            requests = twin.requests
            for signal in device.signals.values():
                if signal.is_writable and not stand.is_excused("set", signal.name):
                    goals[signal.name] = _goal(signal)
                    signal.set(goals[signal.name][1])
            _until(
                robot,
                lambda goals=goals, device=device: all(  # type: ignore[misc]
                    name not in device.readable or _is_near(device.signals[name].value, goal)
                    for name, (_, goal) in goals.items()
                ),
                5.5,
            )
            if goals:
                assert twin.requests > requests, f"{device.name}: nothing reached the twin"
            for name, (start, goal) in goals.items():
                if name not in device.readable:
                    continue
                value = device.signals[name].value
                assert value is not UNKNOWN, f"{name} is not received"
                if not _is_number(goal):
                    assert value == goal, f"{name} was set from {start!r} to {goal!r} and is {value!r}"
                    continue
                assert _is_near(value, goal) or abs(value - goal) < abs(start - goal), (
                    f"{name} was set from {start} to {goal} and is {value}"
                )


def _hold_off(robot: VirtualRobot, stand: TestBench) -> None:
    """Wait until what was enabled takes set-points, at most for 4 s."""
    devices = [device for device, _ in stand.mine(robot)]
    _until(
        robot,
        lambda: all(d.takes(signal) for d in devices for signal in d.signals.values() if signal.is_writable),
        4.0,
    )


def _is_near(value: Any, goal: Any) -> bool:
    if value is UNKNOWN or not _is_number(goal):
        return bool(value == goal)
    return bool(abs(value - goal) <= 0.02 * max(1, abs(goal)))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _goal(signal: Signal) -> tuple[Any, Any]:
    """Return what it is, and another value: a number well inside the limits, not far away; yes for no; a name again."""
    value = signal.value
    if isinstance(value, bool):
        return value, not value
    if value is not UNKNOWN and not _is_number(value):
        return value, value
    if isinstance(value, int):  # a register may have whole numbers only
        steps = (1, -1) if signal.upper is None or value + 1 <= signal.upper else (-1,)
        return value, next(
            (value + n for n in steps if signal.lower is None or value + n >= signal.lower), value
        )
    start = float(value) if value is not UNKNOWN else 0.0
    return start, _near(signal, start)


def _near(signal: Signal, start: float) -> float:
    low = signal.lower if signal.lower is not None else start - 1.0
    high = signal.upper if signal.upper is not None else start + 1.0
    middle = (max(low, start - 0.5) + min(high, start + 0.5)) / 2
    return (
        middle if abs(middle - start) > 0.02 * (high - low) else start + 0.1 * (high - start or low - start)
    )


def check_limits(stand: TestBench) -> None:
    """Check that a set-point beyond a limit is limited, reported by name, and never exceeded."""
    with stand.made() as robot:
        units = {signal.unit for device, _ in stand.mine(robot) for signal in _limited(stand, device)}
    for unit in sorted(
        units
    ):  # each on a robot of its own: a speed may lead a position on, a torque past its limits
        with stand.made() as robot:
            robot.advance(1.0)
            enable(robot)
            _hold_off(robot, stand)
            for device, _ in stand.mine(robot):
                _go_beyond(
                    robot, device, [signal for signal in _limited(stand, device) if signal.unit == unit]
                )


def _limited(stand: TestBench, device: Device) -> list[Signal]:
    """Return the signals of a device that have an upper limit and can be set."""
    return [
        signal
        for signal in device.signals.values()
        if signal.is_writable and signal.upper is not None and not stand.is_excused("limits", signal.name)
    ]


def _go_beyond(robot: VirtualRobot, device: Device, signals: Sequence[Signal]) -> None:
    """Set signals beyond their upper limits: each is limited by name, and stays below."""
    most: dict[str, float] = {}
    for signal in signals:
        assert signal.upper is not None
        before = robot.events.count("limited", device.name)
        signal.set(signal.upper + 1.0 + abs(signal.upper))
        assert robot.events.count("limited", device.name) > before, f"{signal.name} takes anything"
        if signal.name in device.readable:
            span = signal.upper - (signal.lower if signal.lower is not None else 0)
            most[signal.name] = signal.upper + 0.02 * abs(span)
    for _ in range(4 if most else 0):
        robot.advance(0.5)
        for name, upper in most.items():
            signal = device.signals[name]
            assert signal.value is UNKNOWN or signal.value <= upper, signal


def check_silence(stand: TestBench) -> None:
    """Check that a silent device is reported by name and goes stale, that others stay fresh, and that it comes back."""
    with stand.made() as robot:
        _settle(robot, stand)
        for device, twin in stand.mine(robot):
            if not known_signals(device):
                continue
            twin.fault("silent")
            robot.advance(SETTLE_S)
            if device.polls:
                assert robot.events.count("silent", device.name) >= 1, (
                    f"no event says that {device.name} is silent"
                )
            for signal in known_signals(device):
                if signal.stale_after_ns is not None and signal.stale_after_ns < SETTLE_S * 1e9:
                    assert signal.value is UNKNOWN, f"{signal.name} passes for fresh at {signal.age_ns} ns"
            for other, _ in stand.mine(robot):
                if other is not device and other.polls:
                    assert not other.is_silent, f"{other.name} fell silent with {device.name}"
            twin.fault("silent", on=False)
            _recover(robot, device)
            assert not device.is_silent, f"{device.name} answers and counts as silent"
            fresh = [signal for signal in known_signals(device) if signal.value is not UNKNOWN]
            assert fresh, f"nothing of {device.name} is fresh again"


#: Fault → what must have been reported of it where there are polls; None: it need only be survived.
MISBEHAVIOUR: Final[Mapping[str, tuple[str, ...] | None]] = {
    "late": ("silent", "late reply", "duplicate reply"),
    "loses": None,
    # On a half-duplex line the second answer meets the next request.
    "twice": ("duplicate reply", "two devices", "malformed", "garbled"),
    "short": ("malformed", "garbled", "silent"),
    "wrong_check": None,
    "wrong_number": ("silent", "unknown device", "duplicate reply", "malformed"),
}


def check_misbehaviour(stand: TestBench) -> None:
    """Check that late, doubled, short, lost and wrong answers are reported by name and survived.

    The first device misbehaves in every way, the others in some ways each.
    """
    with stand.made() as robot:
        _settle(robot, stand)
        mine = [(device, twin) for device, twin in stand.mine(robot) if known_signals(device)]
        for number, (device, twin) in enumerate(mine):
            faults = list(MISBEHAVIOUR.items())
            for fault, kinds in faults[number :: len(mine)] if number else faults:
                if stand.is_excused("misbehaviour", f"{device.name} {fault}"):
                    continue
                twin.fault(fault, 0.23 if fault == "late" else None)
                if kinds is not None and device.polls:
                    reported = _reported(robot, kinds)
                    assert reported & set(kinds), (
                        f"{device.name} is {fault}, and that is reported as {reported or 'nothing'}"
                    )
                else:
                    robot.advance(1.0)
                twin.fault(fault, on=False)
                _recover(robot, device)
                assert not device.is_silent, f"{device.name} is silent after having been {fault}"
                assert any(signal.value is not UNKNOWN for signal in known_signals(device)), (
                    f"{device.name} after {fault}"
                )
        _no_bug(robot)


def _reported(robot: VirtualRobot, kinds: Sequence[str]) -> set[str]:
    """Return the kinds of events until one of `kinds` has occurred, at most for `SETTLE_S`."""
    before = dict(robot.events.counts)
    _until(robot, lambda: not _kinds_since(robot, before).isdisjoint(kinds))
    return _kinds_since(robot, before)


def _kinds_since(robot: VirtualRobot, before: Mapping[tuple[str, str], int]) -> set[str]:
    """Return the kinds of events that were counted since the counts were `before`."""
    return {kind for (kind, who), n in robot.events.counts.items() if n > before.get((kind, who), 0)}


def _bus_errors(robot: VirtualRobot) -> int:
    return sum(wire.load.errors for wire in robot.wires.values() if isinstance(wire, SimulatedBus))


def _until(robot: VirtualRobot, is_so: Callable[[], bool], most_s: float = SETTLE_S) -> None:
    """Wait until something is so, at most `most_s`; what was under way has half a second to end in any case."""
    end = robot.clock.now() + most_s * 1e9
    robot.advance(0.5)
    while robot.clock.now() < end and not is_so():
        robot.advance(0.25)


def _settle(robot: VirtualRobot, stand: TestBench) -> None:
    """Wait until something of each polled device is known, at most `SETTLE_S`."""
    polled = [device for device, _ in stand.mine(robot) if device.polls]
    _until(robot, lambda: all(map(known_signals, polled)))


def _recover(robot: VirtualRobot, device: Device) -> None:
    """Wait until a device answers again, at most `SETTLE_S`."""
    since = robot.clock.now()

    def is_back() -> bool:
        instants = [signal.instant for signal in known_signals(device) if signal.instant is not None]
        return not device.is_silent and max(instants, default=0) > since

    _until(robot, is_back)


#: What events say where two devices answer to one number.
OF_A_SECOND: Final = ("duplicate reply", "two devices", "malformed", "garbled", "silent", "late reply")


def check_two_of_one(stand: TestBench) -> None:
    """Check that a second device with the same number is noticed, and survived."""
    with stand.made() as robot:
        _settle(robot, stand)
        if not any(device.polls for device, _ in stand.mine(robot)):
            return
        double = simulate(robot.robot, robot.ports("double"), seed=2, load=stand.load)
        for twin in double.twins.values():
            twin.reply_delay_ns += 200_000
        errors, before = _bus_errors(robot), dict(robot.events.counts)

        def is_noticed() -> bool:
            return not _kinds_since(robot, before).isdisjoint(OF_A_SECOND) or _bus_errors(robot) > errors

        double.open()
        _until(robot, is_noticed)
        double.close()
        assert is_noticed(), "no event says that there is a second device"
        _until(robot, lambda: not any(device.is_silent for device, _ in stand.mine(robot)))
        for device, _ in stand.mine(robot):
            assert not device.is_silent, f"{device.name} is silent after the second one has gone"


def check_reboot(stand: TestBench) -> None:
    """Check that a device that was off and on answers again, and does not move by itself."""
    with stand.made() as robot:
        robot.advance(1.0)
        enable(robot)
        _settle(robot, stand)
        for device, twin in stand.mine(robot):
            twin.power(False)
            robot.advance(0.5)
            twin.power(True)
            _recover(robot, device)
            if known_signals(device):
                assert not device.is_silent, f"{device.name} is silent after its reboot"
        _no_bug(robot)


def check_absent(stand: TestBench) -> None:
    """Check that absent devices cost nothing but their values, and are received when they come."""
    with stand.made() as robot:
        for twin in robot.twins.values():
            twin.power(False)
        robot.advance(1.0)
        for device, _ in stand.mine(robot):
            assert not known_signals(device), f"{device.name} was received without being there"
        for twin in robot.twins.values():
            twin.power(True)
        _settle(robot, stand)
        for device, _ in stand.mine(robot):
            if device.polls:
                assert known_signals(device), f"{device.name} came and was not received"
        _no_bug(robot)


def check_actions(stand: TestBench) -> None:
    """Check that every action without arguments ends, with success or with a device's error; so does stopping."""
    with stand.made() as robot:
        _settle(robot, stand)
        _run_actions(stand, robot, pause_s=0.1, may_excuse=True)


def check_actions_of_the_absent(stand: TestBench) -> None:
    """Check that an action of an absent device fails with a `DeviceError`, and does not hang."""
    with stand.made() as robot:
        for twin in robot.twins.values():
            twin.power(False)
        robot.advance(0.2)
        _run_actions(stand, robot)


def _run_actions(
    stand: TestBench, robot: VirtualRobot, pause_s: float = 0.0, *, may_excuse: bool = False
) -> None:
    """Run every action that needs no argument, then stop; `pause_s` lies behind each of them."""
    for device, _ in stand.mine(robot):
        for action in device.actions:
            method = getattr(device, action)
            is_excused = may_excuse and stand.is_excused("actions", f"{device.name} {action}")
            if not is_excused and not _needs_arguments(method):
                finish(method())
                robot.advance(pause_s)
        finish(device.stop_motion())
    _no_bug(robot)


def _needs_arguments(method: Callable[..., Any]) -> bool:
    return any(
        parameter.default is inspect.Parameter.empty
        and parameter.kind not in (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
        for parameter in inspect.signature(method).parameters.values()
    )


def check_noise(stand: TestBench) -> None:
    """Check that on a wire with faults nothing raises, everything is counted, and what gets through is received."""
    with stand.made(faults=Faults(seed=3, corrupt=0.05), noise=Noise(seed=3, flip=0.002)) as robot:
        robot.advance(SETTLE_S)
        for device, _ in stand.mine(robot):
            if device.polls:
                assert known_signals(device), f"nothing of {device.name} gets through the noise"
        for host in robot.rig.hosts.values():
            counts = host.scanner.counts
            assert counts.total == counts.decoded + sum(counts.reasons.values())
        _no_bug(robot)


def check_same_again(stand: TestBench) -> None:
    """Check that the same seed gives the same packets at the same instants."""
    assert _trace(stand) == _trace(stand)


def _trace(stand: TestBench) -> str:
    """Return a hash of all that stood on the wires for a second."""
    robot = stand.made(seed=7)
    digest = hashlib.sha256()

    def note(packet: Any, instant: int) -> None:
        digest.update(f"{instant} {packet!r}\n".encode())

    recorders: list[ListeningNode] = []
    for wire in robot.wires.values():
        if isinstance(wire, SimulatedBus):
            recorders.append(ListeningNode(wire))
        else:
            wire.attach("recorder", note)
    with robot:
        robot.advance(0.5)
        enable(robot)
        robot.advance(1.0)
    for recorder in recorders:
        for instant, frame in recorder.received:
            note(frame, instant)
    return digest.hexdigest()


def check_scan(stand: TestBench) -> None:
    """Check that scanning the bus finds the devices that are there, by their numbers, and no others."""
    scan = stand.driver.scan
    if scan is None:
        return
    robot = stand.made()
    robot.simulation.open()
    for name, port in robot.ports("scan").items():
        expected = [c for c in robot.robot.devices_on(name) if c.driver == stand.driver.name and c.active]
        if not expected:
            continue
        host = Host(port, list(robot.rig.hosts[name].variants.values()))
        host.open()
        job = Job(robot.clock, "scan", lambda job, host=host: scan(host, job))  # type: ignore[misc]
        found = job.wait(600)
        numbers = sorted(sorted(config.credentials.items()) for config in found)
        assert numbers == sorted(sorted(config.credentials.items()) for config in expected)
        host.close()
    robot.simulation.close()


def _no_bug(robot: VirtualRobot) -> None:
    assert not robot.events.of("bug"), robot.events.of("bug")
    assert not robot.events.failures


CHECKS: Final[Mapping[str, Callable[[TestBench], None]]] = {
    check.__name__.removeprefix("check_"): check
    for check in (
        check_declared,
        check_quiet_before,
        check_received,
        check_set,
        check_limits,
        check_silence,
        check_misbehaviour,
        check_two_of_one,
        check_reboot,
        check_absent,
        check_actions,
        check_actions_of_the_absent,
        check_noise,
        check_same_again,
        check_scan,
    )
}


def run_check(
    name: str,
    driver: Driver | str,
    *,
    examples: Sequence[str] = (),
    excused: Mapping[str, str] | None = None,
    load: Callable[[str], Driver] | None = None,
) -> None:
    """Run one check on a driver's example robots, and on `examples`; raise `AssertionError` with what is wrong."""
    found = load_driver(driver) if isinstance(driver, str) else driver

    def loading(wanted: str) -> Driver:
        if wanted == found.name:
            return found
        try:
            return (load or load_driver)(wanted)
        except UnknownNameError as error:
            raise UnknownNameError("driver", wanted, [found.name, *error.known]) from None

    for example in (found.example, *examples):
        try:
            CHECKS[name](TestBench(found, example, loading, excused or {}))
        except AcesError as error:
            raise AssertionError(f"{found.name}, {name}: {type(error).__name__}: {error}") from error


def driver_tests(
    driver: Driver | str,
    *,
    examples: Sequence[str] = (),
    excused: Mapping[str, str] | None = None,
    load: Callable[[str], Driver] | None = None,
) -> Callable[[str], None]:
    """Return all checks of a driver, as one parametrised pytest test.

    `driver` is an installed one's name, or a `Driver`. `examples` are more robots (TOML). `excused` maps patterns
    ("received: *.temperature", "JMC0 wrong_check") to reasons. `load` gives other drivers of the examples.
    """
    import pytest

    @pytest.mark.parametrize("check", list(CHECKS))
    def test(check: str) -> None:
        run_check(check, driver, examples=examples, excused=excused, load=load)

    return test
